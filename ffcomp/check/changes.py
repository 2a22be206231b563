"""What of a printer may change between two checks, each change fitted by itself to the difference of their signals.

A change is one number: belts (all, or each), mass on the nozzle holder, damping and dry friction of the guides; of
straight axes frequency and damping of each mode. Each experiment may be late by as much as its clock allows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag
from scipy.signal import butter, sosfiltfilt

from ffcomp.errors import MeasurementError
from ffcomp.inference.fit import FitSettings, fit
from ffcomp.inference.problem import EstimationProblem, Observation, Unknown
from ffcomp.measurement.faults import fault
from ffcomp.numerics.serialise import keys
from ffcomp.record.clock import RATE_HZ as SIMULATED_HZ
from ffcomp.record.clock import simulated, without_gaps
from ffcomp.record.plan import Experiment, Plan
from ffcomp.record.result import Joined
from models.arrays import FloatArray
from models.effects.catalogue import effects_of, measured
from models.machine import Machine, value_of, with_values

# ---- the sensor's signals ------------------------------------------------------------------------
#
# Motion is compared with motion. So all checks of one plan have their rows at the same times of the experiment, between
# 2 and 150 Hz, and each repeat is moved by its lag before the mean is taken.

BAND_HZ = (2.0, 150.0)
RATE_HZ = 400.0
DEPENDENT = RATE_HZ / (2.0 * (BAND_HZ[1] - BAND_HZ[0]))  # rows for one that is independent
BEFORE_S = 0.15  # kept of the rest before the motion
REST_S = 0.05  # before the motion: no filter rings earlier
LEAST_NOISE_M_PER_S2 = 0.01  # of chips that round
FROM_DAY_TO_DAY = 0.01  # of the signal: no printer repeats better after homing
SURE_CLOCK_S = 5e-5


@dataclass(frozen=True, eq=False)
class SensorSignal:
    """One experiment of a check."""

    name: str
    acceleration: FloatArray  # (n, 3) m/s² at `rows_of` the experiment, the mean of its repeats
    noise: FloatArray  # (3,) m/s², standard deviations of that mean
    clock_sd_s: float  # all of it may be early or late by so much

    @property
    def size(self) -> float:
        """Root mean square, m/s², of all axes together."""
        return float(np.sqrt(np.mean(self.acceleration**2)))


def share_apart(felt: SensorSignal, other: FloatArray) -> float:
    """Return what differs from (n, 3) m/s² without a delay, as a share of the signal."""
    slope = np.gradient(felt.acceleration, 1.0 / RATE_HZ, axis=0)
    apart = felt.acceleration - other
    apart = apart - slope * (np.sum(slope * apart) / max(float(np.sum(slope**2)), 1e-300))
    return float(np.sqrt(np.mean(apart**2))) / felt.size


def rows_of(duration_s: float) -> FloatArray:
    """Return the times (n,) s of an experiment whose motion lasts from 0 to `duration_s`."""
    return np.arange(-round(BEFORE_S * RATE_HZ), np.floor(duration_s * RATE_HZ) + 1) / RATE_HZ


def in_band(rows: FloatArray, rate_hz: float) -> FloatArray:
    """Filter (n, m) without delay."""
    band = butter(4, (BAND_HZ[0], min(BAND_HZ[1], 0.45 * rate_hz)), "bandpass", fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(band, rows, axis=0))


def signals_of(joined: Sequence[Joined], plan: Plan) -> list[SensorSignal]:
    """Thin joined captures, in the order of the plan; an experiment without any recording is missing."""
    signals = []
    for experiment in plan.experiments:
        repeats = [each for each in joined if each.experiment == experiment.name]
        if repeats:
            signals.append(_of_repeats(repeats, rows_of(experiment.duration_s)))
    return signals


def _of_repeats(repeats: Sequence[Joined], rows: FloatArray) -> SensorSignal:
    filtered = [_filtered(each) for each in repeats]
    each = np.array([CubicSpline(t, signal)(rows) for t, signal in filtered])
    slope = np.gradient(each.mean(axis=0), 1.0 / RATE_HZ, axis=0)
    lags = -np.einsum("nk,rnk->r", slope, each - each.mean(axis=0)) / max(float(np.sum(slope**2)), 1e-300)
    each = each + lags[:, None, None] * slope
    if len(repeats) > 1:
        noise = np.sqrt(np.var(each, axis=0, ddof=1).mean(axis=0) / len(repeats))
    else:
        t, signal = filtered[0]
        noise = np.sqrt(np.mean(signal[t < -REST_S] ** 2, axis=0))
    clock = float(np.sqrt(np.mean([one.clock.offset_sd_s**2 for one in repeats])))
    noise = np.maximum(noise, LEAST_NOISE_M_PER_S2)
    return SensorSignal(repeats[0].experiment, each.mean(axis=0), noise, max(clock, SURE_CLOCK_S))


def _filtered(each: Joined) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) s of the experiment and the record (n, 3) in the band."""
    recording = each.recording
    if missing := {f"acc_{axis}" for axis in "xyz"} - set(recording.acceleration):
        raise MeasurementError(each.source, [fault("deaf check", axis=min(missing)[-1])])
    rows = np.column_stack([recording.acceleration[f"acc_{axis}"] for axis in "xyz"])
    whole = without_gaps(recording.time_s, rows)
    return each.begin_s + recording.time_s, in_band(whole, recording.sample_rate_hz)


# ---- the changes ---------------------------------------------------------------------------------

SPARE_S = 0.4  # simulated before and after
AS_NOISE = 1.25  # times the noise: nothing has changed
STEP = 0.1  # of a change's usual size: of differences
EARLIER = FitSettings(steps=2, keep=True)  # from the machine file to the printer of an earlier check
ALONE = FitSettings(steps=8, share=0.02, keep=True)


@dataclass(frozen=True, eq=False)
class Change:
    """One number of the printer, as a change from the machine file: of an effect in some guides, or of a mode."""

    name: str
    sentence: str  # with {size} and {way}
    which: FloatArray | float = 1.0  # (3,) guides, marked by 1
    _: KW_ONLY
    key: tuple[str, ...]  # effect and parameter; or a number of the machine file alone, which changes by a share
    sd: float  # its usual size, which is how far the printer is from its file
    low: float
    high: float
    unit: str = ""  # empty: a relative change
    scale: float = 100.0  # of the size in the sentence
    ways: tuple[str, str] = ("higher", "lower")
    worth: float | None = None  # a check that would miss so much is inconclusive
    special: bool = False  # a case of others: one belt of all, all belts of modes

    def changed(self, machine: Machine, by: float) -> Machine:
        """Return the machine with so much more."""
        effect, *parameter = self.key
        if not parameter:
            return with_values(machine, {effect: value_of(machine, effect) * (1.0 + by)})
        known = machine.effects.get(effect, {})
        more = np.asarray(known.get(parameter[0], 0.0), dtype=np.float64) + by * self.which
        return replace(machine, effects={**machine.effects, effect: {**known, parameter[0]: more.tolist()}})

    def words(self, value: float) -> str:
        """Say that the printer has changed by so much."""
        return self.sentence.format(size=self.scale * abs(value), way=self.ways[value <= 0])


def changes_of(machine: Machine) -> list[Change]:
    """List the possible changes, the simple before the special."""
    modes = [name for name in machine.vibration.tunable if "frequency_hz[" in name or "damping_ratio[" in name]
    rubs = float(np.min(machine.effects.get("coulomb_friction", {}).get("force_n", 0.0)))
    unit = "N/kg" if machine.vibration.per_kilogram else "N"
    belts = partial(
        Change, key=("belt_stiffness", "relative_change"), sd=0.2, low=-0.6, high=1.5, ways=("stiffer", "softer")
    )
    rubbing = partial(Change, key=("coulomb_friction", "force_n"), sd=3.0, low=-rubs, high=20.0, unit=unit, scale=1.0)
    more = f"is {{size:.1f}} {unit} {{way}}"
    changes = [
        belts("belts", "all belts are {size:.0f} % {way}", np.ones(3), worth=0.1, special=bool(modes)),
        rubbing("friction", f"dry friction of the guides {more}", worth=3.0),
    ]
    for guide, alone in zip("ABC", np.eye(3), strict=True):  # each has a belt
        changes.append(belts(f"belt {guide}", f"belt {guide} is {{size:.0f}} % {{way}}", alone, special=True))
        if not modes:
            sentence = f"dry friction of guide {guide} {more}"
            changes.append(rubbing(f"friction {guide}", sentence, alone, special=True))
    if "effector_mass" in effects_of(machine.vibration.moves):
        heavier = partial(Change, key=("effector_mass", "added_kg"), sd=0.1, low=-0.3, high=1.0, unit="kg", scale=1e3)
        sentence = "the nozzle holder carries {size:.0f} g {way}"
        changes.append(heavier("mass on the nozzle holder", sentence, ways=("more", "less"), worth=0.1))
    if not modes:
        damped = partial(Change, key=("guide_damping", "added_n_s_per_m"), sd=15.0, low=-100.0, high=300.0, scale=1.0)
        sentence = "damping is {way}, as by {size:.0f} N s/m per guide"
        changes.append(damped("damping of the guides", sentence, unit="N s/m"))
    for name in modes:
        hertz, damping = value_of(machine, name.replace("damping_ratio", "frequency_hz")), "damping_ratio" in name
        of = f"{'the damping of ' * damping}the mode of {name.split('.')[1]} near {hertz:.0f} Hz"
        sd, low, high = (0.5, -0.95, 4.0) if damping else (0.1, -0.5, 0.8)
        changes.append(Change(name, f"{of} is {{size:.0f}} % {{way}}", key=(name,), sd=sd, low=low, high=high))
    return sorted(changes, key=lambda each: each.special)


def expected_signals(machines: Sequence[Machine], experiments: Sequence[Experiment]) -> list[FloatArray]:
    """Simulate what the sensor feels, of each experiment (m, n, 3) m/s² at its rows, thinned as recordings are.

    Raises UnreachableError if a machine cannot execute a motion.
    """
    times = [np.arange(-SPARE_S, each.duration_s + SPARE_S, 1.0 / SIMULATED_HZ) for each in experiments]
    paths = [each.motion.nozzle(t) for each, t in zip(experiments, times, strict=True)]
    commands = [machines[0].kinematics.inverse(path) for path in paths for _ in machines]
    motions, signals = iter(simulated([*machines] * len(experiments), commands)), list[FloatArray]()
    for each, t in zip(experiments, times, strict=True):
        sensed = [in_band(measured(machine, next(motions).signals).nozzle, SIMULATED_HZ) for machine in machines]
        signals.append(np.array([CubicSpline(t, rows)(rows_of(each.duration_s)) for rows in sensed]))
    return signals


# ---- the fit -------------------------------------------------------------------------------------


class _Changes(EstimationProblem):
    """How large some changes of a machine are, by the signals of experiments, whose delays are fitted too."""

    def __init__(
        self,
        machine: Machine,
        experiments: Sequence[Experiment],
        felt: Sequence[SensorSignal],
        changes: Sequence[Change],
    ) -> None:
        self.machine, self.experiments, self.changes = machine, experiments, changes
        self.unknowns = [Unknown(each.name, 0.0, each.sd, each.low, each.high, STEP * each.sd) for each in changes]
        variances = [np.tile(DEPENDENT * each.noise**2, len(each.acceleration)) for each in felt]
        self.observations = [Observation(f.acceleration.ravel(), v) for f, v in zip(felt, variances, strict=True)]
        self.sd = self.deviations(np.zeros(len(felt)))
        slopes = block_diag(*(np.gradient(f.acceleration, 1.0 / RATE_HZ, axis=0).reshape(-1, 1) for f in felt))
        clocks = np.diag([1.0 / each.clock_sd_s for each in felt])
        self.late = np.linalg.qr(np.vstack([slopes / self.sd[:, None], clocks]))[0]

    def machine_at(self, values: FloatArray) -> Machine:
        machine = self.machine
        for change, value in zip(self.changes, values.tolist(), strict=True):
            machine = change.changed(machine, value) if value else machine
        return machine

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        signals = expected_signals([self.machine_at(values) for values in lanes], self.experiments)
        yield from np.concatenate([each.reshape(len(lanes), -1) for each in signals], axis=1)

    def whitened(self, simulated: FloatArray, sd: FloatArray) -> FloatArray:
        return self.without_delays(self.measured - simulated)

    def without_delays(self, signals: FloatArray) -> FloatArray:
        """Return signals (rows,) in units of their noise, then the delays in units of their clocks, both fitted."""
        whole = np.append(signals / self.sd, np.zeros(len(self.late) - len(self.sd)))
        return whole - self.late @ (self.late.T @ whole)


def earlier_machine(machine: Machine, experiments: Sequence[Experiment], then: Sequence[SensorSignal]) -> Machine:
    """Fit the printer of an earlier check, whose machine file is only near it: small changes all at once."""
    changes = [each for each in changes_of(machine) if not each.special]
    felt = [replace(each, noise=np.hypot(each.noise, FROM_DAY_TO_DAY * each.size)) for each in then]
    problem = _Changes(machine, experiments, felt, changes)
    return problem.machine_at(fit(problem, np.zeros(len(changes)), EARLIER).values)


@dataclass(frozen=True)
class Explanation:
    """One change, fitted to the difference."""

    json_keys: ClassVar = keys("sd", "explains", "said", part="change.name", change="value", unit="change.unit")

    change: Change
    value: float  # of the change's unit
    sd: float
    share: float  # of the difference that is not noise

    @property
    def explains(self) -> float:
        """The share of the difference, 0 to 1."""
        return min(self.share, 1.0)

    @property
    def said(self) -> str:
        """The change in words."""
        return self.change.words(self.value)


@dataclass(frozen=True)
class Difference:
    """What differs between two checks."""

    size: float  # of the difference, as a share of the signal
    noise: float  # what noise alone would leave, as a share of the signal
    times: float  # the weighed difference, in times the noise
    rows: float  # that are independent
    explanations: tuple[Explanation, ...]  # the best first
    turned_deg: float  # of the sensor about the vertical, if that and its gain were all that changed
    gain: float  # of the sensor, relative
    sensor_share: float  # of the difference, that both explain


def compare(
    machine: Machine, experiments: Sequence[Experiment], pairs: Sequence[tuple[SensorSignal, SensorSignal]]
) -> Difference:
    """Explain the difference of pairs, today and then, by changes of the machine of then."""
    changes, felt = changes_of(machine), list[SensorSignal]()
    for unchanged, (now, then) in zip(expected_signals([machine], experiments), pairs, strict=True):
        noise = np.sqrt(now.noise**2 + then.noise**2 + (FROM_DAY_TO_DAY * now.size) ** 2)
        clock = float(np.hypot(now.clock_sd_s, then.clock_sd_s))
        changed_to = unchanged[0] + now.acceleration - then.acceleration
        felt.append(replace(now, acceleration=changed_to, noise=noise, clock_sd_s=clock))
    problem = partial(_Changes, machine, experiments, felt)
    here = fit(problem(changes), np.zeros(len(changes)), FitSettings(steps=0))
    rows, left = len(here.sd) / DEPENDENT, float(here.residual @ here.residual)
    changed, found = max(left - rows, 1e-9 * left), list[Explanation]()
    sizes = np.diag(here.information).tolist()
    for i, (change, slope, size) in enumerate(zip(changes, here.gradient.tolist(), sizes, strict=True)):
        value, sd, rest = slope / size, size**-0.5, left - slope**2 / size  # as far as it is in proportion
        if left > AS_NOISE**2 * rows:
            one = fit(problem([change]), np.zeros(1), ALONE, jacobian=here.jacobian[:, [i]])
            value, sd, rest = one.values.item(), one.information.item() ** -0.5, float(one.residual @ one.residual)
        found.append(Explanation(change, value, sd, (left - rest) / changed))
    before = np.concatenate([then.acceleration for _, then in pairs])
    turned = np.column_stack([before[:, 1], -before[:, 0], 0.0 * before[:, 2]])
    sensor = np.column_stack([here.problem.without_delays(each.ravel()) for each in (turned, before)])
    turn, gain = np.linalg.lstsq(sensor, here.residual)[0].tolist()
    signal = np.sqrt(np.mean([now.size**2 for now, _ in pairs]))
    differs = np.sqrt(np.mean([(now.size * share_apart(now, then.acceleration)) ** 2 for now, then in pairs]))
    quiet = np.sqrt(np.mean([np.mean(now.noise**2 + then.noise**2) for now, then in pairs]))
    return Difference(
        size=float(differs / signal),
        noise=float(quiet / signal),
        times=float(np.sqrt(left / rows)),
        rows=rows,
        explanations=tuple(sorted(found, key=lambda each: -each.share)),
        turned_deg=float(np.rad2deg(turn)),
        gain=gain,
        sensor_share=float(here.residual @ sensor @ [turn, gain]) / changed,
    )
