"""Real files and odd ones: compensated, or refused with a place and a rule. Nothing else."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ffcomp.compensation.gcode_writer import STILL_MOVE
from ffcomp.compensation.job import Job, Options
from ffcomp.errors import NothingToDo
from gcode.container import read_bytes
from gcode.errors import GcodeError
from gcode.program import Program
from gcode.reader import read_program
from models.file import load_machine

DATA = Path(os.environ.get("FFCOMP_DATA", Path(__file__).parents[3] / "shared" / "data")) / "gcode"
OFFSETS = {  # beds with their origin in a corner; the vase's start moves need more room than its bed's centre leaves
    "ender3_ringing_tower.gcode": (-110.0, -110.0),
    "gcodepreview_benchy_arcs.gcode": (-100.0, -100.0),
    "gcodepreview_vase.gcode": (-70.0, -75.0),
    "makreeltje_orca_slicer.gcode": (-150.0, -150.0),
    "makreeltje_cura_slicer.gcode": (-150.0, -150.0),
}

needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no G-code of others at {DATA}; FFCOMP_DATA names its folder"
)
REAL = sorted(DATA.glob("*.gcode")) if DATA.is_dir() else []
ODD = sorted((DATA / "odd").iterdir()) if DATA.is_dir() else []


def job(data: bytes, path: Path) -> Job:
    options = Options(offset=OFFSETS.get(path.name, (0.0, 0.0)), predict=False)
    return Job(data, str(path), load_machine("mp-delta-pro"), options)


@needs_data
@pytest.mark.parametrize("path", ODD, ids=lambda p: p.name)
def test_an_odd_file_gives_a_result_or_a_place_and_a_rule(path: Path) -> None:
    out, refused = b"", None
    try:
        out = b"".join(job(read_bytes(path), path).lines())
    except (NothingToDo, GcodeError) as error:
        refused = error
    if refused is None:
        assert passed(read_program(path.read_bytes())) == [a for a in out.splitlines(keepends=True) if a in kept(path)]
    elif isinstance(refused, GcodeError):
        assert refused.path and refused.rule.endswith((".", "?", ")"))
        assert refused.line is not None or path.stat().st_size == 0
    else:
        assert str(path) in str(refused)


def kept(path: Path) -> set[bytes]:
    return set(passed(read_program(path.read_bytes())))


def passed(program: Program) -> list[bytes]:
    """Lines that are no moves, in order."""
    return [program.lines[e.line] for e in program.events if not STILL_MOVE.match(program.lines[e.line])]
