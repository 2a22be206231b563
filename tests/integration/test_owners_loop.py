"""The owner's loop up to the join: the real Kalico's plan of our file, an independent printer, captures, runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ffcomp.measurement.recording import read_recording
from ffcomp.record.gcode_writer import Recorder, gcode_lines
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import load_plan
from models.file import load_machine
from tests.support.hidden_delta import as_captures, firmware_plan, hidden, worst_offset
from tests.support.reference import call
from validation import judge
from validation.kalico import ARM_LENGTH_MM, RADIUS_MM, kalico_plan, sample


@pytest.mark.kalico
def test_captures_of_the_hosts_motion_are_joined_with_their_command(tmp_path: Path) -> None:
    """With 122 g hidden, lost rows, tilt and turned axes: two thirds of a sample at worst."""
    plan, told = tmp_path / "moves.gcode", ("-m", judge.MACHINE_FILE, "--json")
    call("record", "plan", "-o", plan, "--seconds", "2", "--at", "0,0", "--repeats", "1", *told)
    moves = load_plan(plan.with_suffix(".json"))
    _, real = hidden("effector_mass", 5)
    begun = as_captures(tmp_path / "captures", moves, firmware_plan(plan, moves), real)
    captures = [tmp_path / "captures" / name for name in begun]
    options = ("--plan", plan.with_suffix(".json"), "--output-dir", tmp_path / "runs", *told)
    joined = json.loads(call("record", "join", *captures, *options).stdout)
    assert len(joined["runs"]) == len(captures) == len(moves.runs()) and not joined["refused"], joined
    assert worst_offset(joined, begun) < 2e-4
    run = read_recording(Path(joined["files"][0]))
    assert not run.gaps.any() and max(float(np.ptp(x)) for x in run.acceleration.values()) > 5.0


# ---- record against kalico ----


NOT_MOTION = (b"G28", b"ACCELEROMETER", b"SET_INPUT", b"BED_MESH", b"SET_SKEW", b"M117", b"M220", b"FFCOMP", b"M400")


@pytest.mark.kalico
def test_every_experiment_takes_the_time_that_the_join_relies_on() -> None:
    machine = load_machine("kossel")
    plan = make_plan(machine, Request(seconds=2.0, repeats=1, places_mm=[(0.0, 0.0)], height_mm=12.0))
    lines = [x for x in gcode_lines(plan, machine, Recorder("klipper", ())) if not x.startswith((b";", *NOT_MOTION))]
    limits = machine.limits
    found = kalico_plan(
        b"".join(lines),
        max_velocity=1000,
        max_accel=limits.acceleration_mm_per_s2,
        max_z_velocity=300,
        delta_radius=RADIUS_MM,
        arm_length=ARM_LENGTH_MM,
    )["moves"]
    ends = found[:, 0] + found[:, 1:4].sum(axis=1)
    gaps = np.flatnonzero(found[1:, 0] - ends[:-1] > plan.rest_before_s - 1e-3) + 1  # a rest before each experiment
    assert len(gaps) == len(plan.experiments)
    for first, each in zip(gaps.tolist(), plan.experiments, strict=True):
        begin = found[first, 0]
        t = np.linspace(0.0, each.duration_s, 1000)
        np.testing.assert_allclose(sample(found, begin + t), each.motion.nozzle(t), atol=2e-4, err_msg=each.name)
        last = int(np.searchsorted(found[:, 0], begin + each.duration_s - 1e-6)) - 1
        assert ends[last] - begin == pytest.approx(each.duration_s, abs=2e-6), each.name
