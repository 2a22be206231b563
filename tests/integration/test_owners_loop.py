"""The owner's loop up to the join: the real Kalico's plan of our file, an independent printer, captures, runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ffcomp.measurement.recording import read_recording
from ffcomp.record.plan import load_plan
from tests.support.hidden_delta import as_captures, firmware_plan, hidden, worst_offset
from tests.support.reference import call
from validation import judge


@pytest.mark.kalico
def test_captures_of_the_hosts_motion_are_joined_with_their_command(tmp_path: Path) -> None:
    """With 122 g hidden, lost rows, tilt and turned axes: two thirds of a sample at worst."""
    plan, told = tmp_path / "moves.gcode", ("-m", judge.MACHINE_FILE, "--json")
    call("record", "plan", "-o", plan, "--seconds", "2", "--at", "0,0", "--repeats", "1", *told)
    moves = load_plan(plan.with_suffix(".json"))
    _, real = hidden("effector_mass", 5)
    begun = as_captures(tmp_path / "captures", moves, firmware_plan(plan, moves), real)
    captures = [tmp_path / "captures" / name for name in begun]
    options = ("--plan", plan.with_suffix(".json"), "-o", tmp_path / "runs", *told)
    joined = json.loads(call("record", "join", *captures, *options).stdout)
    assert len(joined["runs"]) == len(captures) == len(moves.runs()) and not joined["refused"], joined
    assert worst_offset(joined, begun) < 2e-4
    run = read_recording(Path(joined["files"][0]))
    assert not run.gaps.any() and max(float(np.ptp(x)) for x in run.acceleration.values()) > 5.0
