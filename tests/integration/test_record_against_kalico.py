"""The real Kalico host plans a recording as its plan says: every experiment takes its time and goes its way."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.record.gcode_writer import Recorder, gcode_lines
from ffcomp.record.moves import Request, make_plan
from models.file import load_machine
from validation.kalico import ARM_LENGTH_MM, RADIUS_MM, kalico_plan, sample

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
