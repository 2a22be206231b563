"""Captures of `record plan` as frequency responses, which `identify fit` takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.identification.load import gather
from ffcomp.identification.predict import predicted
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import load_plan, save_plan
from models.file import load_machine
from tests.support.recordings import write_captures


@pytest.mark.slow
def test_captures_of_a_recording_give_responses(tmp_path: Path) -> None:
    machine = load_machine("mp-delta-pro")
    file = tmp_path / "moves.json"
    save_plan(make_plan(machine, Request(seconds=3.0)), file)
    plan = load_plan(file)
    place = next(each.place for each in plan.experiments if each.kind == "multisine")
    names = [each.name for each in plan.experiments if each.place == place]
    written = write_captures(file, machine, tmp_path, kinds=[e.kind for e in plan.experiments if e.place == place])
    captures = [path for path in written if any(f"{name}-1" in path.name for name in names)]
    found = gather(captures, machine, plan=file, band_hz=(8.0, 100.0)).responses
    assert {(r.input, r.output) for r in found} >= {("cmd_x", "acc_x"), ("cmd_y", "acc_y")}
    for r, model in zip(found, predicted(machine, found), strict=True):
        assert r.clock == f"place-{place}" and r.position_mm is not None
        error = np.sqrt(np.sum(np.abs(r.value - model) ** 2) / np.sum(np.abs(model) ** 2))
        assert error < 0.15, (r.input, r.output)


@pytest.mark.parametrize("lost", [0, 4])
def test_samples_that_reprapfirmware_lost_are_reported(tmp_path: Path, lost: int) -> None:
    rows = np.random.default_rng(1).normal((0.0, 0.0, 1.0), 0.2, (4000, 3))
    text = "".join(f"{n},{x:.4f},{y:.4f},{z:.4f}\n" for n, (x, y, z) in enumerate(rows.tolist()))
    path = tmp_path / "0_2026-11-22.csv"
    path.write_text(f"Sample,X,Y,Z\n{text}Rate 1344, overflows {lost}\n")
    found = gather([path], load_machine("voron-300"), band_hz=(10.0, 120.0), shaken_axis=["x"])
    assert any("lost samples (4 overflows" in each for each in found.skipped) == bool(lost)
