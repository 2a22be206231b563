"""What goes wrong while an owner records: in the firmware, on the bench, in the chip, and with the files.

Each returns what a field of `bench.Trap` takes; what is one expression stands in `catalogue` itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from ffcomp.record.plan import Experiment
from validation.blind.delta import OUTSIDE
from validation.blind.real import FloatArray, Real
from validation.plants.accelerometer import Chip, klipper_text
from validation.traps.bench import Feels, Moved, Nozzle, Run, Spoiled, Taken, Writes

# ---- the printer --------------------------------------------------------------------------------


def with_camera(real: Real, _: int) -> Real:
    """128 g on the nozzle holder."""
    return real.changed("effector", nozzle_mass_kg=real.machine["effector"]["nozzle_mass_kg"] + 0.128)


def rubbing(until: int = 6) -> Spoiled:
    """2.5 N of dry friction at each guide, perhaps in the first runs only."""
    friction = {"dry": np.full(3, 2.52), "dry_kind": 2, "bristle": 2e-5, "dry_v": 1.5e-3}
    return lambda real, run: real.having(**friction) if run < until else real


def softening(real: Real, run: int) -> Real:
    """Belts that warm up from run to run: 15 % in the end."""
    return real.having(warm_share=0.03 * run, warm_s=1e-3)


def slipping(real: Real, run: int) -> Real:
    """Motor A loses steps twice in the second run, 0.64 mm each time."""

    def slips(t: FloatArray, command: FloatArray) -> FloatArray:
        out = command.copy()
        for at in (1.9, 2.4):
            x = np.clip((t - at) / 0.006, 0.0, 1.0)
            out[:, 0] += 0.64 * x**2 * (3 - 2 * x)
        return out

    return real.ordered(slips) if run == 1 else real


def hiding(name: str) -> Spoiled:
    """Something outside the catalogue of effects."""
    return lambda real, _: OUTSIDE[name](np.random.default_rng(1), 1.0, real)[1]


# ---- the firmware does not move as planned ------------------------------------------------------


def replanned(acceleration: float) -> Moved:
    """Plan the same moves with another limit of acceleration: times its factor."""

    def moved(experiment: Experiment) -> Nozzle:
        motion, limits = experiment.motion, experiment.motion.limits
        own = replace(limits, acceleration_mm_per_s2=acceleration * limits.acceleration_mm_per_s2)
        return replace(motion, limits=own).nozzle

    return moved


def s_curve(experiment: Experiment) -> Nozzle:
    """Ramps whose acceleration rises and falls smoothly, each in the time of the trapezoid's."""
    plan = experiment.motion.trajectory

    def nozzle(t: FloatArray) -> FloatArray:
        move = plan.move_at(np.clip(t, 0.0, plan.end_t))
        up, cruise, down = plan.accel_t[move], plan.cruise_t[move], plan.decel_t[move]
        since = np.clip(np.clip(t, 0.0, plan.end_t) - plan.start_t[move], 0.0, up + cruise + down)
        v0, v, v1 = plan.start_v[move], plan.cruise_v[move], plan.end_v[move]
        gone = _ramp(np.minimum(since, up), up, v0, v) + v * np.clip(since - up, 0.0, cruise)
        gone = gone + _ramp(np.clip(since - up - cruise, 0.0, down), down, v, v1)
        return np.asarray(plan.origin[move, :3] + plan.direction[move, :3] * gone[:, None])

    return nozzle


def _ramp(since: FloatArray, lasting: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Distance in a ramp whose speed follows a polynomial of degree 5."""
    u = since / np.maximum(lasting, 1e-12)
    return np.asarray(begin * since + (end - begin) * lasting * (u**6 - 3 * u**5 + 2.5 * u**4))


def bent(by: FloatArray) -> Moved:
    """The path goes elsewhere, (x, y, z) times this matrix: a skew, mirrored axes."""
    return lambda experiment: lambda t: np.asarray(experiment.motion.nozzle(t) @ by.T)


# ---- around the chip ----------------------------------------------------------------------------


def tone(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
    """A fan at 83 Hz: always there, its phase by chance."""
    phase, level = run.rng.uniform(0, 2 * np.pi, 3), 2.0 * np.array([1.0, 0.7, 0.5])
    return felt + level * np.sin(2 * np.pi * 83.0 * t[:, None] + phase)


def bumped(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
    """Somebody bumps the table while the second capture is taken; it rings at 22 Hz."""
    since = np.maximum(t - 0.9, 0.0)
    ring = np.exp(-since / 0.12) * np.sin(2 * np.pi * 22.0 * since)
    return felt + (run.index == 1) * 25.0 * ring[:, None] * np.array([0.8, 0.5, 0.3])


def on_bracket(hertz: float, rattle: float = 0.0) -> Feels:
    """The chip sits on a bracket that rings, with 4 % of damping, or rattles where it is loose."""

    def feels(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
        w, dt, ratio = 2 * np.pi * hertz, float(t[1] - t[0]), 0.04
        a1, a2 = -2 * np.exp(-ratio * w * dt) * np.cos(w * dt), np.exp(-2 * ratio * w * dt)
        rung = np.asarray(lfilter([1 + a1 + a2], [1, a1, a2], felt, axis=0))
        return rung + rattle * np.abs(rung) * run.rng.standard_normal(felt.shape)

    return feels


def filtered(order: int, hertz: object, kind: str, share: float = 1.0) -> Feels:
    """The chip's own filter is on; or it lies on the bed, which passes on a share of some frequencies."""

    def feels(t: FloatArray, felt: FloatArray, _: Run) -> FloatArray:
        sections = butter(order, hertz, kind, fs=(len(t) - 1) / (t[-1] - t[0]), output="sos")
        return share * np.asarray(sosfilt(sections, felt, axis=0))

    return feels


def whining(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
    """Motors whine above the chip's rate while they turn: it comes back at frequencies that are not there."""
    moving = np.minimum(np.linalg.norm(felt, axis=1, keepdims=True) / 10.0, 1.0)
    phase = run.rng.uniform(0, 2 * np.pi, 3)
    sweep = 2 * np.pi * (1640.0 * t[:, None] + 25.0 * np.sin(2 * np.pi * 0.7 * t[:, None]))
    return felt + 5.0 * moving * np.sin(sweep + phase)


def turned(degrees: float) -> Callable[[Chip, Run], Chip]:
    """The chip is turned about the vertical."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return lambda chip, _: replace(chip, turn=about @ chip.turn)


# ---- the files ----------------------------------------------------------------------------------


def scaled(factor: float, only: Sequence[int] = range(6)) -> Writes:
    """Another unit than the file says."""
    return lambda x, _: replace(x, values=factor * x.values) if x.run.index in only else x


def cut(from_s: float) -> Writes:
    """Rows before a time are missing."""

    def written(x: Taken, _: list[Taken]) -> Taken:
        rows = x.time_s >= from_s
        return replace(x, time_s=x.time_s[rows], values=x.values[rows])

    return written


def by_phone(gravity: bool = True) -> Writes:
    """An app's table instead of the firmware's: its own time, m/s²."""
    header = "Time (s),Acceleration x (m/s^2),Acceleration y (m/s^2),Acceleration z (m/s^2)\n"

    def writes(x: Taken, _: list[Taken]) -> Taken:
        own = x.values if gravity else x.values - x.values[x.time_s < -0.1].mean(axis=0)
        rows = klipper_text(x.time_s - x.time_s[0], own).partition("\n")[2]
        return replace(x, text=header + rows)

    return writes


def swapped(x: Taken, _: list[Taken]) -> Taken:
    """The captures of two experiments bear each other's names."""
    names = ("ffcomp-zigzag-0", "ffcomp-reversals-1")
    other = dict(zip(names, reversed(names), strict=True))
    return replace(x, run=replace(x.run, experiment=other.get(x.run.experiment, x.run.experiment)))
