"""How runs of an axis are compared with its simulation: shots, windows, band and scales, all taken from the data.

Where nothing holds an axis, a missing force adds up in its position without bound. So the simulation restarts at every
shot from the measured position and speed (multiple shooting; Bock, 1981): its error is the effect of a missing force in
that time. An axis that the spring of its drive holds is simulated from the beginning to the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import MeasurementError
from ffcomp.measurement.axis_run import AxisRun
from ffcomp.measurement.clock import fill_gaps
from models.arrays import FloatArray
from models.effects.effect import MotionScales
from models.kinds import driven_axis
from models.machine import Machine
from models.printer.one_axis import AxisMotion, simulate_axis
from models.vibration.driven_axis import DrivenAxis

SHOT = 0.4  # of the time that the motion takes to change its speed by its own size
PERIODS = 2.0  # of a load on its coupling, in a shot: its beginning takes two numbers of each
SHORTEST, LINES_A_SHOT = 20, 5.0  # samples of a shot; its inverse times that is where the band ends
WINDOWS, LEAST_ROWS = 6, 200  # of time, in a run; rows of a window
MOST_OF_POWER, BEYOND = 0.998, 1.25  # of the signals: the band ends so much beyond the frequency that holds it
LAST = 0.4  # of the sample rate: there every band ends
LEAST_REST, STILL, CERTAIN = 8, 1e-6, 4.0  # samples at rest; share of the way that is none; standard deviations
HOLDING = frozenset({"pendulum_gravity", "ground_spring"})  # effects that hold an axis, where they pull it back
PULL, STILL_PULLS = 0.1, 0.3  # of the acceleration, that a pull explains; of the pull near its middle, at the end
SPANS = (5, 7, 11, 15, 21, 31, 45, 63)  # samples over which a speed may be taken


@dataclass(frozen=True, eq=False)
class Shots:
    """One run with the states where its simulation restarts."""

    run: AxisRun
    length: int  # samples of a shot; 0: there is one
    begin: FloatArray  # (shots, 4) mm and mm/s of the last mass and of the first one; NaN where one is not known
    speed: FloatArray  # (n,) mm/s
    began: Mapping[str, FloatArray] = field(
        default_factory=dict
    )  # position -> (length, k), what beginnings may do to it

    def simulate(self, machine: Machine, *, coarse: bool = False) -> AxisMotion:
        """Simulate the run; ValueError if the axis moves to infinity."""
        dt_s = 1 / self.run.sample_rate_hz
        return simulate_axis(
            machine,
            self.run.drive,
            dt_s,
            shot=self.length,
            begin=self.begin,
            coarse=coarse,
            supply_v=self.run.supply_v,
            extra=self.run.extra,
        )

    def without_beginnings(self, signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return signals, (n,) each, with the start of each shot projected out of the positions.

        That is measured, and so as noisy as anything: left in what is compared, twenty samples would be wrong by the
        noise of one. It is fitted where the sensors spoke.
        """
        result, names = dict(signals), [name for name in self.began if name in signals]
        if not names:
            return result
        gone = -len(self.run.drive) % self.length
        known_rows = [np.pad(np.isfinite(self.run.signals[name]), (0, gone)) for name in names]
        kept = _by_shots(known_rows, self.length)
        x = _by_shots([np.pad(signals[name], (0, gone)) for name in names], self.length)
        out = _without(np.concatenate([self.began[name] for name in names]), x, kept)
        for i, name in enumerate(names):
            result[name] = out[:, i * self.length : (i + 1) * self.length].ravel()[: len(signals[name])]
        return result

    def forced_motion(self, name: str) -> FloatArray:
        """Return what of a signal, (n,), the forces of a shot make: without its beginning, or without its command."""
        x = self.run.signals[name]
        if not name.startswith("pos"):
            return x
        if not self.length:
            return x - (np.nanmean(x) if self.run.by_force else self.run.drive)
        k = np.arange(len(x)) % self.length
        first = np.arange(len(x)) // self.length
        speed = self.begin[first, 3 if name == "pos_motor" else 1]
        return np.asarray(x - x[first * self.length] - speed * k / self.run.sample_rate_hz)


def shots_of(machine: Machine, runs: Sequence[AxisRun]) -> list[Shots]:
    """Choose where the simulation of each run restarts; one length for all.

    Raises MeasurementError for a run that is driven by something else than the axis.
    """
    wanted = driven_axis(machine).input
    for run in runs:
        if run.command_space != wanted:
            given = f"The run gives a {run.command_space}, but axis.input of {machine.name} is {wanted!r}"
            raise MeasurementError(run.source, [f"{given}: change one of the two."])
    mean = [_mean(runs, i) for i in range(len(runs))]
    speeds = [speed_of(fill_gaps(_place(run)), run.sample_rate_hz) for run in mean]
    held = not driven_axis(machine).free or (HOLDING & machine.effects.keys() and _pulled_back(mean, speeds))
    needed = not held and any(run.position for run in runs)
    seconds = max(_shot_s(runs, speeds), PERIODS * _period_s(driven_axis(machine))) if needed else 0.0
    result = [_shots(*each, seconds) for each in zip(runs, mean, speeds, strict=True)]
    return [replace(one, began=_began(machine, one)) for one in result]


def _pulled_back(runs: Sequence[AxisRun], speeds: Sequence[FloatArray]) -> bool:
    """Tell whether the motion is pulled back to one place, as an arm that hangs is and one that stands up is not.

    The acceleration is regressed on drive, speed and place, with a cube of the place: the pull must explain a part of
    it, and still pull back at the farthest place.
    """
    drive = np.concatenate([run.drive for run in runs])
    speed = np.concatenate(speeds)
    change = np.concatenate([np.gradient(v, 1 / run.sample_rate_hz) for v, run in zip(speeds, runs, strict=True)])
    place = np.concatenate([fill_gaps(_place(run)) for run in runs])
    place = (place - place.mean()) / max(float(np.abs(place - place.mean()).max()), 1e-12)
    without = np.column_stack([np.ones(len(drive)), drive, speed])
    columns = np.column_stack([without, place, place**3])
    found = np.linalg.lstsq(columns, change, rcond=1e-12)[0]
    near, far = float(found[-2]), float(found[-2] + found[-1])
    left, alone = (
        float(np.sum((change - each @ np.linalg.lstsq(each, change, rcond=1e-12)[0]) ** 2))
        for each in (columns, without)
    )
    return near < 0.0 and far < STILL_PULLS * near and left < (1 - PULL) * alone


def _began(machine: Machine, one: Shots) -> dict[str, FloatArray]:
    """Return what an error of where a shot begins does to each position, (length, k): lines, and a load that rings."""
    names, axis = list(one.run.position) if one.length else [], driven_axis(machine)
    t = np.arange(one.length) / one.run.sample_rate_hz
    line = np.column_stack([np.ones(one.length), t - t.mean()]) if names else np.empty((0, 2))
    result = {}
    for i, name in enumerate(names):
        lines = [line if i == k else np.zeros((one.length, 2)) for k in range(len(names))]
        result[name] = np.hstack([*lines, _ringing(axis, t, name)])
    return result


def _ringing(axis: DrivenAxis, t: FloatArray, name: str) -> FloatArray:
    """Return how a load that began elsewhere than it seemed rings on the first mass: (n, 2); (n, 0) without one."""
    if not axis.load_mass_kg:
        return np.empty((len(t), 0))
    omega, decay = _coupling(axis)
    share = axis.mass_kg if name == "pos_q" else -axis.load_mass_kg
    shape = np.exp(-0.5 * decay * t)[:, None] * np.column_stack([np.cos(omega * t), np.sin(omega * t)])
    return np.asarray(share / axis.moved_kg * shape)


def load_began(axis: DrivenAxis, one: Shots) -> FloatArray:
    """Return what an error of where a load begins does to its place while its motor moves as measured: (length, 2)."""
    t, mass = np.arange(one.length) / one.run.sample_rate_hz, float(axis.load_mass_kg or 1.0)
    omega = np.sqrt((axis.coupling_stiffness_n_per_m or 0.0) / mass)
    decay = np.exp(-0.5 * axis.coupling_damping_n_s_per_m / mass * t)
    return np.asarray(decay[:, None] * np.column_stack([np.cos(omega * t), np.sin(omega * t)]))


def _by_shots(columns: Sequence[NDArray[Any]], length: int) -> NDArray[Any]:
    """Return signals as rows of shots: (shots, signals * length)."""
    return np.hstack([x.reshape(-1, length) for x in columns])


def _without(basis: FloatArray, x: FloatArray, known_rows: NDArray[np.bool_]) -> FloatArray:
    """Return rows x (shots, n) without their parts along a basis (n, k), by the known values of each."""
    out, whole = np.zeros_like(x), known_rows.all(axis=1)
    directions = np.linalg.qr(basis)[0]
    out[whole] = x[whole] - x[whole] @ directions @ directions.T
    for row in np.flatnonzero(~whole):
        known = known_rows[row]
        if known.sum() > basis.shape[1]:
            part = np.linalg.lstsq(basis[known], x[row][known], rcond=1e-9)[0]
            out[row] = x[row] - basis @ part
    return out


def _mean(runs: Sequence[AxisRun], i: int) -> AxisRun:
    """Return the mean of the runs that the same input drives: it shows best where each shot begins."""
    run = runs[i]
    same = [r for r in runs if r.repeat_of == run.repeat_of and np.array_equal(r.drive, run.drive)]
    kept = [r for r in same if r.position.keys() == run.position.keys()]
    return replace(run, position={k: np.mean([fill_gaps(r.position[k]) for r in kept], axis=0) for k in run.position})


def _shots(run: AxisRun, mean: AxisRun, speed: FloatArray, seconds: float) -> Shots:
    rate = run.sample_rate_hz
    length = max(round(min(seconds * rate, len(run.drive))), SHORTEST) if seconds and run.position else 0
    at = np.arange(0, len(run.drive), length) if length else np.zeros(1, dtype=int)
    begin = np.full((len(at), 4), np.nan)
    for column, name in ((0, "pos_q"), (2, "pos_motor")):
        if name in mean.position:
            place = mean.position[name]
            begin[:, column], begin[:, column + 1] = place[at], speed_of(place, rate)[at]
            if not (length or run.by_force) and (rested := _rested(run.drive)) >= LEAST_REST:
                begin[0, column : column + 2] = _resting(run.drive[0], place[:rested]), 0.0
    if not run.position:  # who measures no position begins at rest
        begin[:] = np.column_stack([_place(run)[at], np.zeros(len(at))] * 2)
    return Shots(run, length, begin, speed)


def _rested(command: FloatArray) -> int:
    """Count the samples before a command first moves."""
    moved = np.flatnonzero(np.abs(command - command[0]) > STILL * np.ptp(command))
    return int(moved[0]) if len(moved) else len(command)


def _resting(commanded: float, place: FloatArray) -> float:
    """Return where an axis rests, (n,) mm measured: as commanded, unless friction holds it elsewhere.

    A single sample is off by the sensor's noise, and would set a sprung axis ringing.
    """
    middle = float(place.mean())
    return commanded if abs(middle - commanded) < CERTAIN * float(place.std()) / np.sqrt(len(place)) else middle


def _place(run: AxisRun) -> FloatArray:
    """Return where the axis was, (n,) mm: measured; else as commanded, or where it began."""
    commanded = np.zeros(len(run.drive)) if run.by_force else run.drive
    return run.place if run.position else commanded


def speed_of(place: FloatArray, rate: float) -> FloatArray:
    """Return the speed, (n,) mm/s: the slope over as many samples as the noise needs and the motion allows.

    The span grows as long as what it changes is explained by the noise of the positions (Lepski's rule).
    """
    from scipy.signal import savgol_filter

    sd = noise_sd(place)
    chosen = np.gradient(place, 1 / rate)
    for span in SPANS:
        if span > len(place):
            break
        smooth = np.asarray(savgol_filter(place, span, 2, deriv=1, delta=1 / rate))
        before = np.sqrt(12.0) * sd * rate / (span - 2) ** 1.5
        if span > SPANS[0] and np.sqrt(np.mean((smooth - chosen) ** 2)) > before:
            break
        chosen = smooth
    return chosen


def noise_sd(position: FloatArray) -> float:
    """Return the standard deviation of a position's noise: of its digits, or of what changes from sample to sample."""
    steps = np.diff(np.unique(position))
    digit = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    coarse = digit if digit > 1e-9 * max(float(np.ptp(position)), 1e-12) and len(steps) < len(position) / 2 else 0.0
    rough = float(np.median(np.abs(np.diff(position, 4)))) / 0.6745 / np.sqrt(70.0)
    return max(coarse / np.sqrt(12.0), rough, 1e-12)


def _shot_s(runs: Sequence[AxisRun], speeds: Sequence[FloatArray]) -> float:
    """Return how long a shot lasts, s, by how quickly the motion changes its speed."""
    change = [np.gradient(v, 1 / run.sample_rate_hz) for v, run in zip(speeds, runs, strict=True)]
    v = float(np.sqrt(np.mean(np.concatenate(speeds) ** 2)))
    a = float(np.sqrt(np.mean(np.concatenate(change) ** 2)))
    return SHOT * v / max(a, 1e-12)


def _period_s(axis: DrivenAxis) -> float:
    """Return how long a load takes to ring once on its coupling, s; 0 without one.

    In a shorter shot a coupling looks like a load that began elsewhere.
    """
    omega = _coupling(axis)[0]
    return 2 * np.pi / omega if omega else 0.0


def _coupling(axis: DrivenAxis) -> tuple[float, float]:
    """Return how a load rings on its coupling, rad/s, and how it decays, 1/s; zeros without one."""
    if not axis.load_mass_kg:
        return 0.0, 0.0
    softness = 1 / axis.mass_kg + 1 / axis.load_mass_kg
    stiffness = axis.coupling_stiffness_n_per_m or 0.0
    return float(np.sqrt(stiffness * softness)), float(axis.coupling_damping_n_s_per_m * softness)


def band_of(shots: Sequence[Shots]) -> tuple[float, float]:
    """Return the frequencies that are compared, Hz: from less than a line of a window to where the motion ends."""
    rate = min(one.run.sample_rate_hz for one in shots)
    low = 0.5 / max((part.stop - part.start) / one.run.sample_rate_hz for one in shots for part in windows(one))
    if shots[0].length:
        return low, min(LINES_A_SHOT * shots[0].run.sample_rate_hz / shots[0].length, LAST * rate)
    high = max(_where_it_ends(one, name) for one in shots for name in one.run.signals)
    return low, min(max(BEYOND * high, 20 * low), LAST * rate)


def _where_it_ends(one: Shots, name: str) -> float:
    x = fill_gaps(one.forced_motion(name))
    power = np.cumsum(np.abs(np.fft.rfft((x - np.mean(x)) * np.hanning(len(x)))) ** 2)
    return float(np.searchsorted(power, MOST_OF_POWER * power[-1]) * one.run.sample_rate_hz / len(x))


def windows(one: Shots) -> list[slice]:
    """Cut a run into windows of time, of whole shots; the last one takes the rest."""
    rows = len(one.run.drive)
    unit = one.length or 1
    size = max(rows // WINDOWS, LEAST_ROWS) // unit * unit or unit
    starts = list(range(0, max(rows - size, 0) + 1, size))
    return [slice(a, a + size) for a in starts[:-1]] + [slice(starts[-1], rows)]


def scales_of(machine: Machine, shots: Sequence[Shots]) -> MotionScales:
    """Take the sizes of the motion from the runs."""
    places = np.concatenate([1e-3 * (p - np.mean(p)) for p in (fill_gaps(_place(one.run)) for one in shots)])
    speed = float(np.sqrt(np.mean(np.concatenate([one.speed for one in shots]) ** 2))) / 1e3
    force = _force(machine, shots)
    way, k = float(np.std(places)), driven_axis(machine).last_stiffness
    stretch = force / k if k else way
    return MotionScales(
        force_n=force,
        speed_m_per_s=max(speed, 1e-9),
        way_m=max(way, 1e-9),
        travel_m=max(float(np.ptp(places)), 1e-9),
        stretch_m=max(stretch, 1e-12),
        stiffness_n_per_m=k,
    )


def _force(machine: Machine, shots: Sequence[Shots]) -> float:
    """Return the size of the forces, N: of the drive; of inertia, where a position drives or nothing does."""
    axis = driven_axis(machine)
    runs = [one.run for one in shots]
    drive = float(np.std(np.concatenate([axis.force_of(r.drive, r.supply_v) for r in runs]))) if axis.by_force else 0.0
    if drive > 0.0:
        return drive
    change = [np.gradient(one.speed, 1 / one.run.sample_rate_hz) / 1e3 for one in shots]
    return axis.moved_kg * float(np.std(np.concatenate(change)))
