"""What goes wrong while an owner records: in the firmware, on the bench, in the chip, and with the files.

Numbers of a mishap are keyword arguments, which `catalogue` sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from ffcomp.record.plan import Experiment
from ffcomp.shapers.apply import shape
from ffcomp.shapers.smooth import SHAPERS
from validation.blind.real import FloatArray, Order
from validation.plants.accelerometer import GRAVITY_M_PER_S2, Chip
from validation.traps.bench import Nozzle, Run, Taken

# ---- the firmware does not move as planned ------------------------------------------------------


def replanned(experiment: Experiment, *, speed: float = 1.0, **limits: float) -> Nozzle:
    """Plan the same moves with a speed factor, or with other limits: each times its factor."""
    motion = experiment.motion
    own = replace(motion.limits, **{key: factor * getattr(motion.limits, key) for key, factor in limits.items()})
    return replace(motion, speed=speed * motion.speed, limits=own).nozzle


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


def shaped(experiment: Experiment, **kinds: tuple[str, float]) -> Nozzle:
    """The input shaper of x, of y or of both was left on."""
    shapers = {axis: SHAPERS[kind](hertz, 0.1) for axis, (kind, hertz) in kinds.items()}
    return lambda t: shape(experiment.motion.nozzle, t, **shapers)


def bent(experiment: Experiment, *, by: Sequence[Sequence[float]]) -> Nozzle:
    """The path goes elsewhere, (x, y, z) times this matrix: a skew, mirrored axes."""
    return lambda t: np.asarray(experiment.motion.nozzle(t) @ np.array(by).T)


def slips(at_s: Sequence[float], mm: float) -> Order:
    """Motor A loses steps at such times of the bench, mm each."""

    def slipping(t: FloatArray, command: FloatArray) -> FloatArray:
        out = command.copy()
        for at in at_s:
            x = np.clip((t - at) / 0.006, 0.0, 1.0)
            out[:, 0] += mm * x**2 * (3 - 2 * x)
        return out

    return slipping


# ---- on the bench -------------------------------------------------------------------------------


def tone(t: FloatArray, felt: FloatArray, run: Run, *, hertz: float, m_per_s2: float) -> FloatArray:
    """A fan, the mains, stepper motors of a neighbour: always there, its phase by chance."""
    phase, share = run.rng.uniform(0, 2 * np.pi, 3), np.array([1.0, 0.7, 0.5])
    return felt + m_per_s2 * share * np.sin(2 * np.pi * hertz * t[:, None] + phase)


def bumped(t: FloatArray, felt: FloatArray, run: Run, *, once: int, m_per_s2: float = 25.0) -> FloatArray:
    """Somebody bumps the table while one capture is taken; it rings at 22 Hz."""
    since = np.maximum(t - 0.9, 0.0)
    ring = np.exp(-since / 0.12) * np.sin(2 * np.pi * 22.0 * since)
    return felt + (run.index == once) * m_per_s2 * ring[:, None] * np.array([0.8, 0.5, 0.3])


def on_bracket(t: FloatArray, felt: FloatArray, run: Run, *, hertz: float, rattle: float = 0.0) -> FloatArray:
    """The chip sits on a bracket that rings, with 4 % of damping, or rattles where it is loose."""
    w, dt, ratio = 2 * np.pi * hertz, float(t[1] - t[0]), 0.04
    a1, a2 = -2 * np.exp(-ratio * w * dt) * np.cos(w * dt), np.exp(-2 * ratio * w * dt)
    rung = np.asarray(lfilter([1 + a1 + a2], [1, a1, a2], felt, axis=0))
    return rung + rattle * np.abs(rung) * run.rng.standard_normal(felt.shape)


def elsewhere(t: FloatArray, felt: FloatArray, run: Run, *, share: float) -> FloatArray:
    """The chip lies on the frame or the bed: it feels only what the frame passes on."""
    return share * _filtered(t, felt, 2, (15.0, 60.0), "bandpass")


def low_pass(t: FloatArray, felt: FloatArray, run: Run, *, hertz: float) -> FloatArray:
    """The chip's own digital filter is on."""
    return _filtered(t, felt, 1, hertz, "lowpass")


def _filtered(t: FloatArray, felt: FloatArray, order: int, hertz: object, kind: str) -> FloatArray:
    rate = (len(t) - 1) / (t[-1] - t[0])
    return np.asarray(sosfilt(butter(order, hertz, kind, fs=rate, output="sos"), felt, axis=0))


def whining(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
    """Motors whine above the chip's rate while they turn: it comes back at frequencies that are not there."""
    moving = np.minimum(np.linalg.norm(felt, axis=1, keepdims=True) / 10.0, 1.0)
    phase = run.rng.uniform(0, 2 * np.pi, 3)
    sweep = 2 * np.pi * (1640.0 * t[:, None] + 25.0 * np.sin(2 * np.pi * 0.7 * t[:, None]))
    return felt + 5.0 * moving * np.sin(sweep + phase)


# ---- the chip -----------------------------------------------------------------------------------


def gains(t: FloatArray, felt: FloatArray, run: Run, *, xyz: Sequence[float]) -> FloatArray:
    """A clone whose axes measure too much or too little."""
    return felt * np.array(xyz)


def turned(chip: Chip, run: Run, *, degrees: float, repeats: Sequence[int] = (1, 2)) -> Chip:
    """The chip is turned about the vertical, perhaps between the repeats."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return replace(chip, turn=about @ chip.turn) if run.repeat in repeats else chip


def at_rate(chip: Chip, run: Run, *, hertz: float) -> Chip:
    """A slow sensor, without a filter of its own."""
    return replace(chip, rate_hz=hertz)


# ---- the files ----------------------------------------------------------------------------------


def clipped(x: Taken, _: list[Taken], *, g: float) -> Taken:
    """The range is too small."""
    return replace(x, values=np.clip(x.values, -g * GRAVITY_M_PER_S2, g * GRAVITY_M_PER_S2))


def scaled(x: Taken, _: list[Taken], *, factor: float, only: Sequence[int] = range(6)) -> Taken:
    """Another unit than the file says."""
    return replace(x, values=factor * x.values) if x.run.index in only else x


def cut(x: Taken, _: list[Taken], *, from_s: float = -9.0, share: float = 1.0) -> Taken:
    """Rows before a time, or after a share of them, are missing."""
    return _kept(x, (x.time_s >= from_s) & (np.arange(len(x.time_s)) < share * len(x.time_s)))


def lost_rows(x: Taken, _: list[Taken], *, share: float) -> Taken:
    """The host was too busy."""
    return _kept(x, x.run.rng.uniform(size=len(x.time_s)) > share)


def _kept(x: Taken, rows: np.ndarray) -> Taken:
    return replace(x, time_s=x.time_s[rows], values=x.values[rows])


def by_phone(
    x: Taken, _: list[Taken], *, gravity: bool = True, change: Callable[[str], str] = lambda text: text
) -> Taken:
    """An app's table instead of the firmware's."""
    own = x.values if gravity else x.values - x.values[x.time_s < -0.1].mean(axis=0)
    return replace(x, text=change(replace(x, values=own).by_phone()))


def with_comment(x: Taken, _: list[Taken], *, line: str) -> Taken:
    """The firmware says something above the header."""
    return replace(x, comments=line + "\n")


def swapped(x: Taken, _: list[Taken], *, names: Sequence[str]) -> Taken:
    """The captures of two experiments bear each other's names."""
    other = dict(zip(names, reversed(names), strict=True))
    return replace(x, run=replace(x.run, experiment=other.get(x.run.experiment, x.run.experiment)))


def copied(x: Taken, taken: list[Taken]) -> Taken:
    """The second repeats are copies of the first ones' files."""
    first = next(each for each in taken if each.run.repeat == 1 and each.run.experiment == x.run.experiment)
    return replace(x, text=first.by_klipper())


def twice_the_same_axis(x: Taken, _: list[Taken]) -> Taken:
    """A script exports y in place of z."""
    return replace(x, values=x.values[:, [0, 1, 1]])


def in_ms(text: str) -> str:
    """Turn the times of a table into ms, and leave its header unchanged."""
    head, *rows = text.splitlines()
    timed = (f"{1e3 * float(t):.3f},{rest}" for t, rest in (row.split(",", 1) for row in rows))
    return "\n".join([head, *timed]) + "\n"
