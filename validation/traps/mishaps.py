"""What goes wrong while an owner records: in the firmware, on the bench, in the chip, and with the files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from ffcomp.record.plan import Experiment
from ffcomp.shapers.smooth import SHAPERS
from validation.blind.real import FloatArray
from validation.plants.accelerometer import GRAVITY_M_PER_S2, Chip
from validation.traps.bench import ChipOf, Feels, Moved, Nozzle, Run, Taken, Writes, klipper_text, phone_text

# ---- the firmware does not move as planned ------------------------------------------------------


def replanned(speed: float = 1.0, **limits: float) -> Moved:
    """Plan the same moves with a speed factor, or with other limits: each times its factor."""

    def moved(experiment: Experiment) -> Nozzle:
        motion = experiment.motion
        own = replace(motion.limits, **{key: factor * getattr(motion.limits, key) for key, factor in limits.items()})
        return replace(motion, speed=speed * motion.speed, limits=own).nozzle

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


def shaped(**kinds: tuple[str, float]) -> Moved:
    """The input shaper of x, of y or of both was left on."""

    def moved(experiment: Experiment) -> Nozzle:
        def nozzle(t: FloatArray) -> FloatArray:
            found = experiment.motion.nozzle(t).copy()
            for axis, (kind, hertz) in kinds.items():
                shaper, column = SHAPERS[kind](hertz, 0.1), "xy".index(axis)
                pulses = zip(shaper.amplitude.tolist(), shaper.time.tolist(), strict=True)
                found[:, column] = sum(a * experiment.motion.nozzle(t - late)[:, column] for a, late in pulses)
            return found

        return nozzle

    return moved


def bent(change: Callable[[FloatArray], FloatArray]) -> Moved:
    """The path goes elsewhere: a skew, mirrored axes. (n, 3) mm → (n, 3) mm."""

    def moved(experiment: Experiment) -> Nozzle:
        return lambda t: change(experiment.motion.nozzle(t))

    return moved


def mirrored(xyz: FloatArray) -> FloatArray:
    """The motors of A and B are exchanged: x runs the wrong way."""
    return xyz * np.array([-1.0, 1.0, 1.0])


def skewed(xyz: FloatArray) -> FloatArray:
    """A skew correction of 1.5° is left on."""
    return np.column_stack([xyz[:, 0] + np.tan(np.deg2rad(1.5)) * xyz[:, 1], xyz[:, 1:]])


@dataclass(frozen=True)
class Slips:
    """An order: a motor loses steps at such times of the bench, mm each."""

    at_s: tuple[float, ...]
    mm: float
    tower: int = 0

    def __call__(self, t: FloatArray, command: FloatArray) -> FloatArray:
        out = command.copy()
        for at in self.at_s:
            x = np.clip((t - at) / 0.006, 0.0, 1.0)
            out[:, self.tower] += self.mm * x**2 * (3 - 2 * x)
        return out


# ---- on the bench -------------------------------------------------------------------------------


def tone(hertz: float, m_per_s2: float) -> Feels:
    """A fan, the mains, stepper motors of a neighbour: always there, its phase by chance."""

    def feels(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
        phase, share = run.rng.uniform(0, 2 * np.pi, 3), np.array([1.0, 0.7, 0.5])
        return felt + m_per_s2 * share * np.sin(2 * np.pi * hertz * t[:, None] + phase)

    return feels


def bumped(once: int, m_per_s2: float = 25.0) -> Feels:
    """Somebody bumps the table while one capture is taken; it rings at 22 Hz."""

    def feels(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
        since = np.maximum(t - 0.9, 0.0)
        ring = np.exp(-since / 0.12) * np.sin(2 * np.pi * 22.0 * since)
        return felt + (run.index == once) * m_per_s2 * ring[:, None] * np.array([0.8, 0.5, 0.3])

    return feels


def on_bracket(hertz: float, ratio: float = 0.04, rattle: float = 0.0) -> Feels:
    """The chip sits on a bracket that rings, or rattles where it is loose."""

    def feels(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
        w, dt = 2 * np.pi * hertz, float(t[1] - t[0])
        a1, a2 = -2 * np.exp(-ratio * w * dt) * np.cos(w * dt), np.exp(-2 * ratio * w * dt)
        rung = np.asarray(lfilter([1 + a1 + a2], [1, a1, a2], felt, axis=0))
        return rung + rattle * np.abs(rung) * run.rng.standard_normal(felt.shape)

    return feels


def elsewhere(share: float) -> Feels:
    """The chip lies on the frame or the bed: it feels only what the frame passes on."""

    def feels(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
        rate = (len(t) - 1) / (t[-1] - t[0])
        return np.asarray(share * sosfilt(butter(2, (15.0, 60.0), "bandpass", fs=rate, output="sos"), felt, axis=0))

    return feels


def whining(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
    """Motors whine above the chip's rate while they turn: it comes back at frequencies that are not there."""
    moving = np.minimum(np.linalg.norm(felt, axis=1, keepdims=True) / 10.0, 1.0)
    phase = run.rng.uniform(0, 2 * np.pi, 3)
    sweep = 2 * np.pi * (1640.0 * t[:, None] + 25.0 * np.sin(2 * np.pi * 0.7 * t[:, None]))
    return felt + 5.0 * moving * np.sin(sweep + phase)


# ---- the chip -----------------------------------------------------------------------------------


def low_pass(hertz: float) -> Feels:
    """The chip's own digital filter is on."""

    def feels(t: FloatArray, felt: FloatArray, run: Run) -> FloatArray:
        rate = (len(t) - 1) / (t[-1] - t[0])
        return np.asarray(sosfilt(butter(1, hertz, fs=rate, output="sos"), felt, axis=0))

    return feels


def gains(x: float, y: float, z: float) -> Feels:
    """A clone whose axes measure too much or too little."""
    return lambda t, felt, run: felt * np.array([x, y, z])


def turned(degrees: float, only_repeat: int | None = None) -> ChipOf:
    """The chip is turned about the vertical, perhaps between the repeats."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def chip_of(chip: Chip, run: Run) -> Chip:
        return chip if only_repeat not in (None, run.repeat) else replace(chip, turn=about @ chip.turn)

    return chip_of


def at_rate(hertz: float) -> ChipOf:
    """A slow sensor, without a filter of its own."""
    return lambda chip, run: replace(chip, rate_hz=hertz)


# ---- the files ----------------------------------------------------------------------------------


def _each(change: Callable[[Taken, np.random.Generator], Taken], only: Sequence[int] = ()) -> Writes:
    def writes(taken: list[Taken]) -> list[Taken]:
        return [change(x, x.run.rng) if not only or x.run.index in only else x for x in taken]

    return writes


def clipped(g: float) -> Writes:
    """The range is too small."""
    top = g * GRAVITY_M_PER_S2
    return _each(lambda x, rng: replace(x, values=np.clip(x.values, -top, top)))


def scaled(factor: float, only: Sequence[int] = ()) -> Writes:
    """Another unit than the file says."""
    return _each(lambda x, rng: replace(x, values=factor * x.values), only)


def cut(from_s: float = -9.0, share: float = 1.0, only: Sequence[int] = ()) -> Writes:
    """Rows before a time, or after a share of them, are missing."""

    def change(x: Taken, rng: np.random.Generator) -> Taken:
        kept = (x.time_s >= from_s) & (np.arange(len(x.time_s)) < share * len(x.time_s))
        return replace(x, time_s=x.time_s[kept], values=x.values[kept])

    return _each(change, only)


def lost_rows(share: float) -> Writes:
    """The host was too busy."""

    def change(x: Taken, rng: np.random.Generator) -> Taken:
        kept = rng.uniform(size=len(x.time_s)) > share
        return replace(x, time_s=x.time_s[kept], values=x.values[kept])

    return _each(change)


def by_phone(gravity: bool = True, change: Callable[[str], str] = lambda text: text) -> Writes:
    """An app's table instead of the firmware's."""

    def written(x: Taken, rng: np.random.Generator) -> Taken:
        own = x.values if gravity else x.values - x.values[x.time_s < -0.1].mean(axis=0)
        return replace(x, text=change(phone_text(replace(x, values=own))))

    return _each(written)


def with_comment(line: str) -> Writes:
    """The firmware says something above the header."""
    return _each(lambda x, rng: replace(x, comments=line + "\n"))


def swapped(first: str, second: str) -> Writes:
    """The captures of two experiments bear each other's names."""
    other = {first: second, second: first}

    def writes(taken: list[Taken]) -> list[Taken]:
        return [replace(x, run=replace(x.run, experiment=other.get(x.run.experiment, x.run.experiment))) for x in taken]

    return writes


def copied(taken: list[Taken]) -> list[Taken]:
    """The second repeats are copies of the first ones' files."""
    firsts = {(x.chip, x.run.experiment): klipper_text(x) for x in taken if x.run.repeat == 1}
    return [replace(x, text=firsts[x.chip, x.run.experiment]) for x in taken]


def twice_the_same_axis(taken: list[Taken]) -> list[Taken]:
    """A script exports y in place of z."""
    return [replace(x, values=x.values[:, [0, 1, 1]]) for x in taken]


def in_ms(text: str) -> str:
    """Turn the times of a table into ms, and leave its header unchanged."""
    head, *rows = text.splitlines()
    return (
        "\n".join([head, *(f"{1e3 * float(t):.3f},{rest}" for t, rest in (row.split(",", 1) for row in rows))]) + "\n"
    )
