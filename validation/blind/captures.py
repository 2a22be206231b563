"""An owner's recordings: the moves of `ffcomp record plan`, measured by one chip and joined with their plan.

The benchmark has its own printer and its own chip, with counts, noise that is partly coloured, gravity, a tilt, turned
axes, a clock that is off and lost rows. The plan and the join are ffcomp's, as an owner uses them; the results are
measured runs like any other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.record.join import join_captures
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Experiment, Plan
from ffcomp.record.result import recording_lines
from models.file import machine_of_text
from models.machine import Machine
from validation.blind.motions import Motion
from validation.blind.real import FloatArray, Reading, Rng
from validation.plants.accelerometer import Chip, draw_chip, klipper_text

BEFORE_S, AFTER_S = 1.2, 0.7  # of the motion that is simulated around an experiment
RATE_HZ = 1600.0
LOST = 1 / 2000  # of the rows
TURNS = np.array(
    [np.eye(3), [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1, 0]]]
)


def planned_motions(machine_file: str, seed: int, seconds: float) -> tuple[tuple[Motion, ...], tuple[int, ...]]:
    """Return the motions of an owner's plan, with what is before and after them, and how often each is made."""
    _, plan = _planned(machine_file, seed, seconds)
    motions = [around(each, each.motion.nozzle) for each in plan.experiments]
    return tuple(motions), tuple(plan.repeats for _ in motions)


@lru_cache(maxsize=2)
def _planned(machine_file: str, seed: int, seconds: float) -> tuple[Machine, Plan]:
    machine = machine_of_text(machine_file, "machine.toml")
    middle = np.array(machine.kinematics.centre_mm)
    places = [tuple((middle + at).tolist()) for at in ((0.0, 0.0), (50.0, 20.0), (-40.0, -45.0))]
    request = Request(
        places_mm=places, seconds=seconds, seed=seed, acceleration_mm_per_s2=6000.0, kinds=("reversals", "multisine")
    )
    return machine, make_plan(machine, request)


def around(each: Experiment, nozzle: Callable[[FloatArray], FloatArray]) -> Motion:
    """Return an experiment's motion with what is before and after it: `nozzle` from the experiment's begin on."""

    def path(t: FloatArray) -> FloatArray:
        return np.asarray(nozzle(np.clip(t - BEFORE_S, -0.9, each.duration_s + 1.0)))

    return Motion(each.name, path, BEFORE_S + each.duration_s + AFTER_S)


def joined_runs(machine_file: str, readings: Sequence[Reading], seed: int, rng: Rng, seconds: float) -> dict[str, str]:
    """Return the texts of the runs by file name."""
    machine, plan = _planned(machine_file, seed, seconds)
    by_name = dict(zip([each.name for each in plan.experiments], readings, strict=True))
    chip = draw_chip(rng, TURNS[rng.integers(len(TURNS))], rng.uniform(0.3, 2.0), RATE_HZ)
    chip = replace(chip, noise_m_per_s2=rng.uniform(0.1, 0.2), coloured=True)
    with TemporaryDirectory() as folder:
        captures = []
        for each, repeat in plan.runs():
            path = Path(folder) / f"adxl345-{each.name}-{repeat}.csv"
            path.write_text(_capture(chip, by_name[each.name], each.duration_s, plan, rng), encoding="utf-8")
            captures.append(path)
        found = join_captures(captures, plan, machine)
        found.check()
        return {f"{each.name}.csv": b"".join(recording_lines(each.recording)).decode() for each in found.joined}


def _capture(chip: Chip, reading: Reading, duration_s: float, plan: Plan, rng: Rng) -> str:
    """Return the text of a capture; some rows are lost."""
    begin, end = BEFORE_S - plan.rest_before_s, BEFORE_S + duration_s + plan.rest_after_s
    t, values = chip.sampled(CubicSpline(reading.t, reading.nozzle), begin, end, rng)
    kept = rng.random(len(t)) > LOST
    return klipper_text(t[kept] + 50.0, 1e3 * values[kept], digits=4)
