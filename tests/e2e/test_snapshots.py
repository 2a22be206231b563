"""What verbs print to people: files in `snapshots`, which FFCOMP_SNAPSHOTS=write writes; then look at the diff."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.support.cli import ffcomp

ROOT, FOLDER = Path(__file__).parents[2], Path(__file__).parent / "snapshots"
PRINT = (
    "G28\nM109 S200\nG90\nM83\nG1 X0 Y0 Z0.2 F6000\nSET_VELOCITY_LIMIT ACCEL=2000 MINIMUM_CRUISE_RATIO=0\n"
    ";LAYER_CHANGE\n;TYPE:Skirt\nG1 X40 E2 F3000\nG1 E-1 F1200\nG4 P1500\n;TYPE:Infill\nG1 X0 F6000\nG1 E1 F1200\n"
    ";LAYER_CHANGE\nG1 Z0.4 F600\nM400\nG1 Y40 E3 F3000\nSTART_FAN_DANCE\nM109 S210\n"
)
CALLS = {
    "estimate": "estimate print.gcode -m mp-delta-pro",
    "machines-show": "machines show ender-3",
    "record-plan": "record plan -m ender-3 -o plan.gcode",
}


@pytest.mark.parametrize("name", CALLS)
def test_a_verb_prints_what_it_printed(name: str, tmp_path: Path) -> None:
    (tmp_path / "print.gcode").write_text(PRINT, encoding="utf-8")
    done = ffcomp(*CALLS[name].split(), cwd=tmp_path)
    assert done.exit_code == 0, done.output
    output = done.output.replace(str(tmp_path), "FOLDER").replace(str(ROOT), "ROOT")
    printed = "\n".join(line.rstrip() for line in output.splitlines()) + "\n"
    snapshot = FOLDER / f"{name}.txt"
    if os.environ.get("FFCOMP_SNAPSHOTS") == "write":
        snapshot.write_text(printed, encoding="utf-8")
    assert printed == snapshot.read_text(encoding="utf-8")
