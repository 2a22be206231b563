"""What of a printer may change between two checks, fitted to the difference of their signals: one change at a time.

A change is one number: belts (all, or each), mass on the nozzle holder, damping and dry friction of the guides; of
straight axes frequency and damping of each mode. The difference is added to what the machine of the earlier check would
feel, so that a change is simulated like any other machine. Each experiment may be late by what its clock allows.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag

from ffcomp.check.signals import DEPENDENT, RATE_HZ, SensorSignal, in_band, rows_of, share_apart
from ffcomp.inference.fit import FitResult, Settings, fit
from ffcomp.inference.problem import EstimationProblem, Observation, Unknown
from ffcomp.numerics.serialise import keys
from ffcomp.record.clock import RATE_HZ as SIMULATED_HZ
from ffcomp.record.clock import simulated
from ffcomp.record.plan import Experiment
from models.arrays import FloatArray
from models.effects.catalogue import effects_of, measured
from models.machine import Machine, value_of, with_values

SPARE_S = 0.4  # simulated before and after
GUIDES = "ABC"  # each has a belt
HIGHER, STIFFER, MORE = ("higher", "lower"), ("stiffer", "softer"), ("more", "less")
TURN, GAIN = "turn", "gain"  # of the sensor, about the vertical
UNSEEN = 1e-3  # of the signal, by a step of a change: less is left out
AS_NOISE = 1.25  # times the noise: nothing has changed
TRIED, WORTHWHILE = 3, 0.5  # changes that are simulated as far as they go; of what the best one explains at first
SIZES = np.array([-0.6, 0.6])  # of their usual sizes: how far changes are simulated at first
DERIVATIVES, EARLIER = Settings(steps=0), Settings(steps=2, keep=True)
ONE_CHANGE = Settings(steps=6, share=5e-4, keep=True)


@dataclass(frozen=True)
class Change:
    """One number of the printer, as a change from the machine file."""

    unknown: Unknown  # its prior is how far it is from printer to file
    changed: Callable[[Machine, float], Machine]
    sentence: str  # with {size} and {way}
    unit: str = ""  # empty: a relative change
    scale: float = 100.0  # of the size in the sentence
    ways: tuple[str, str] = HIGHER
    worth: float | None = None  # a check that would miss so much is inconclusive
    special: bool = False  # a case of another change: one belt of all

    def words(self, value: float) -> str:
        """Say that the printer has changed by so much."""
        return self.sentence.format(size=self.scale * abs(value), way=self.ways[value <= 0])


Pair = tuple[SensorSignal, SensorSignal]  # today and then


def changes_of(machine: Machine) -> list[Change]:
    """List the possible changes, the simple before the special."""
    modes = [name for name in machine.vibration.tunable if "frequency_hz[" in name or "damping_ratio[" in name]
    guides: list[int | None] = [None, *range(3)]
    changes = [_belts(only) for only in guides]
    changes += [_friction(machine, only) for only in (guides[:1] if modes else guides)]
    if "effector_mass" in effects_of(machine.vibration.moves):
        unknown = Unknown("mass on the nozzle holder", 0.0, 0.1, -0.3, 1.0, 0.02)
        words, heavier = "the nozzle holder carries {size:.0f} g {way}", _effect("effector_mass", "added_kg")
        changes.append(Change(unknown, heavier, words, "kg", 1e3, MORE, worth=0.1))
    if not modes:
        unknown = Unknown("damping of the guides", 0.0, 15.0, -100.0, 300.0, 3.0)
        words = "damping is {way}, as by {size:.0f} N s/m in all guides"
        changes.append(Change(unknown, _effect("guide_damping", "added_n_s_per_m"), words, "N s/m", 1.0))
    return [*changes, *(_mode(machine, name) for name in modes)]


def _belts(only: int | None) -> Change:
    name, what = ("belts", "all belts are") if only is None else (f"belt {GUIDES[only]}", f"belt {GUIDES[only]} is")
    changed = _effect("belt_stiffness", "relative_change", np.ones(3) if only is None else np.eye(3)[only])
    unknown, special = Unknown(name, 0.0, 0.2, -0.6, 1.5, 0.02), only is not None
    words = what + " {size:.0f} % {way}"
    return Change(unknown, changed, words, ways=STIFFER, worth=None if special else 0.1, special=special)


def _friction(machine: Machine, only: int | None) -> Change:
    name, what = ("friction", "the guides") if only is None else (f"friction {GUIDES[only]}", f"guide {GUIDES[only]}")
    unit, special = "N/kg" if machine.vibration.per_kilogram else "N", only is not None
    already = float(np.min(machine.effects.get("coulomb_friction", {}).get("force_n", 0.0)))
    unknown = Unknown(name, 0.0, 3.0, -already, 20.0, 0.5)
    changed = _effect("coulomb_friction", "force_n", np.eye(3)[only] if special else 1.0)
    words = f"dry friction of {what} is {{size:.1f}} {unit} {{way}}"
    return Change(unknown, changed, words, unit, 1.0, worth=None if special else 3.0, special=special)


def _mode(machine: Machine, name: str) -> Change:
    """Make a change of `axes.x.frequency_hz[0]` or its like."""
    hertz = value_of(machine, name.replace("damping_ratio", "frequency_hz"))
    damping = "damping_ratio" in name
    unknown = Unknown(name, 0.0, 0.5, -0.95, 4.0, 0.2) if damping else Unknown(name, 0.0, 0.1, -0.5, 0.8, 0.01)

    def changed(machine: Machine, relative: float) -> Machine:
        return with_values(machine, {name: value_of(machine, name) * (1.0 + relative)})

    what = "the damping of the mode" if damping else "the mode"
    return Change(unknown, changed, f"{what} of {name.split('.')[1]} near {hertz:.0f} Hz is {{size:.0f}} % {{way}}")


def _effect(effect: str, key: str, which: FloatArray | float = 1.0) -> Callable[[Machine, float], Machine]:
    """Return what adds so much to an effect of a machine, in the guides that are marked by 1."""

    def changed(machine: Machine, added: float) -> Machine:
        known = machine.effects.get(effect, {})
        more = np.asarray(known.get(key, 0.0), dtype=np.float64) + added * which
        return replace(machine, effects={**machine.effects, effect: {**known, key: more.tolist()}})

    return changed


def expected_signals(machines: Sequence[Machine], experiments: Sequence[Experiment]) -> list[FloatArray]:
    """Simulate what the sensor feels, of each experiment (m, n, 3) m/s² at its rows, thinned as recordings are.

    Raises
    ------
    UnreachableError
        If a machine cannot execute a motion.
    """
    signals = []
    for each in experiments:
        t = np.arange(-SPARE_S, each.duration_s + SPARE_S, 1.0 / SIMULATED_HZ)
        command = machines[0].kinematics.inverse(each.motion.nozzle(t))
        motions = zip(machines, simulated(machines, [command] * len(machines)), strict=True)
        sensed = [in_band(measured(machine, played.signals).nozzle, SIMULATED_HZ) for machine, played in motions]
        signals.append(np.array([CubicSpline(t, rows)(rows_of(each.duration_s)) for rows in sensed]))
    return signals


# ---- the fit -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Problem(EstimationProblem):
    """Unknowns are the changes, then a delay of each experiment, a turn of the sensor and its gain, all linear."""

    machine: Machine
    experiments: Sequence[Experiment]
    changes: Sequence[Change]
    unchanged: FloatArray  # (rows,) expected without a change
    linear: FloatArray  # (rows, ·)
    unknowns: Sequence[Unknown]
    observations: Sequence[Observation]

    def changed(self, values: Iterable[float]) -> Machine:
        """Return the machine with changes that are not zero."""
        machine = self.machine
        for change, value in zip(self.changes, values, strict=False):
            machine = change.changed(machine, float(value)) if value else machine
        return machine

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        """Simulate each different machine once."""
        count = len(self.changes)
        machines = {tuple(lane[:count]): self.changed(lane[:count]) for lane in lanes if lane[:count].any()}
        signals = expected_signals(list(machines.values()), self.experiments) if machines else []
        played = {key: np.concatenate([each[k].ravel() for each in signals]) for k, key in enumerate(machines)}
        for lane in lanes:
            yield played.get(tuple(lane[:count]), self.unchanged) + self.linear @ lane[count:]

    def with_free(self, names: Container[str], prior: bool = False) -> _Problem:
        """Hold all changes and the sensor at zero but those named; their priors are left out unless wanted."""
        late = {each.name for each in self.experiments}
        held = [
            each if each.name in names or each.name in late else replace(each, low=0.0, high=0.0)
            for each in self.unknowns
        ]
        wide = [each if prior or each.name in late else replace(each, sd=np.inf) for each in held]
        return replace(self, unknowns=wide)


def _problem(
    machine: Machine,
    experiments: Sequence[Experiment],
    unchanged: Sequence[FloatArray],
    signals: Sequence[SensorSignal],
    then: Sequence[SensorSignal],
) -> _Problem:
    """Observe signals; delays, turn and gain are those of the sensor's signals of then."""
    changes, felt = changes_of(machine), [each.acceleration for each in then]
    slopes = block_diag(*(np.gradient(each, 1.0 / RATE_HZ, axis=0).reshape(-1, 1) for each in felt))
    turned = np.concatenate([np.column_stack([each[:, 1], -each[:, 0], 0.0 * each[:, 2]]).ravel() for each in felt])
    gained = np.concatenate([each.ravel() for each in felt])
    late = [Unknown(each.name, sd=each.clock_sd_s) for each in signals]
    return _Problem(
        machine,
        experiments,
        changes,
        np.concatenate([each.ravel() for each in unchanged]),
        np.column_stack([slopes, turned, gained]),
        [*(each.unknown for each in changes), *late, Unknown(TURN), Unknown(GAIN)],
        [
            Observation(each.acceleration.ravel(), DEPENDENT * np.tile(each.noise**2, len(each.acceleration)))
            for each in signals
        ],
    )


def earlier_machine(machine: Machine, experiments: Sequence[Experiment], then: Sequence[SensorSignal]) -> Machine:
    """Fit the printer of an earlier check, whose machine file is only near it."""
    expected = expected_signals([machine], experiments)
    signals = [each.less(each.silent, each.acceleration) for each in then]
    problem = _problem(machine, experiments, expected, signals, then)
    problem = problem.with_free({each.unknown.name for each in problem.changes if not each.special}, prior=True)
    return problem.changed(fit(problem, np.zeros(len(problem.unknowns)), EARLIER).values)


@dataclass(frozen=True)
class Explanation:
    """One change, fitted to the difference."""

    json_keys: ClassVar = keys("sd", "explains", "said", part="change.unknown.name", change="value", unit="change.unit")

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


def compare(machine: Machine, experiments: Sequence[Experiment], pairs: Sequence[Pair]) -> Difference:
    """Explain what differs between today and then, by changes of the machine of then."""
    base = expected_signals([machine], experiments)
    differing = [now.less(then, felt[0]) for (now, then), felt in zip(pairs, base, strict=True)]
    whole = _problem(machine, experiments, base, differing, [then for _, then in pairs])
    names = [each.unknown.name for each in whole.changes]
    here = fit(whole.with_free({*names, TURN, GAIN}), np.zeros(len(whole.unknowns)), DERIVATIVES)
    rows = len(here.residual) / DEPENDENT

    def freed(*free: str) -> FitResult[_Problem]:
        """Return the derivatives with the other unknowns held at zero."""
        problem = whole.with_free(free)
        moves = np.array([each.high > each.low for each in problem.unknowns])
        return replace(here, problem=problem, jacobian=here.jacobian * moves)

    left = _best(freed())[1]
    changed = max(left - rows, 1e-9 * left)

    def explained(change: Change, at: FitResult[_Problem]) -> Explanation:
        values, cost = _best(at)
        k = names.index(change.unknown.name)
        return Explanation(change, float(values[k]), float(np.sqrt(at.covariance[k, k])), (left - cost) / changed)

    seen = np.linalg.norm(here.jacobian * here.sd[:, None], axis=0) * [each.step for each in whole.unknowns]
    least = UNSEEN * float(np.linalg.norm(whole.unchanged))
    felt = [each for each, moved in zip(whole.changes, seen.tolist(), strict=False) if moved > least]
    begun = {each: freed(each.unknown.name) for each in felt}
    differs = left > AS_NOISE**2 * rows
    if differs:
        begun |= _far(felt, begun, freed())
    found = sorted((explained(each, at) for each, at in begun.items()), key=lambda each: -each.share)
    if differs:
        likely = [each for each in found[:TRIED] if each.share > WORTHWHILE * found[0].share]
        for k, each in enumerate(likely):
            start, problem = begun[each.change], whole.with_free({each.change.unknown.name})
            jacobian = None if start.values.any() else start.jacobian
            found[k] = explained(each.change, fit(problem, start.values, ONE_CHANGE, jacobian=jacobian))
    turn, gain = _best(freed(TURN, GAIN))[0][-2:].tolist()
    signal = np.sqrt(np.mean([now.size**2 for now, _ in pairs]))
    apart = np.sqrt(np.mean([(now.size * share_apart(now, then.acceleration)) ** 2 for now, then in pairs]))
    noise = np.sqrt(np.mean([np.mean(now.noise**2 + then.noise**2) for now, then in pairs]))
    return Difference(
        size=float(apart / signal),
        noise=float(noise / signal),
        times=float(np.sqrt(left / rows)),
        rows=rows,
        explanations=tuple(sorted(found, key=lambda each: -each.share)),
        turned_deg=float(np.rad2deg(turn)),
        gain=gain,
        sensor_share=(left - _best(freed(TURN, GAIN))[1]) / changed,
    )


def _far(
    changes: Sequence[Change], near: Mapping[Change, FitResult[_Problem]], here: FitResult[_Problem]
) -> dict[Change, FitResult[_Problem]]:
    """Simulate changes of several sizes, and return those that explain more than their derivatives do.

    A sharp mode that has moved by its own width hardly shows in its derivative.
    """
    tried = list[tuple[Change, FloatArray]]()
    for change in changes:
        k, unknown = here.problem.changes.index(change), change.unknown
        for size in np.clip(SIZES * unknown.sd, unknown.low, unknown.high).tolist():
            tried.append((change, size * np.eye(len(here.values))[k]))
    better, costs = dict[Change, FitResult[_Problem]](), {each: _best(near[each])[1] for each in changes}
    simulated = here.problem.simulate([values for _, values in tried])
    for (change, values), signals in zip(tried, simulated, strict=True):
        there = replace(here, values=values, residual=here.problem.whitened(signals, here.sd))
        if (cost := _best(there)[1]) < costs[change]:
            better[change], costs[change] = there, cost
    return better


def _best(at: FitResult[_Problem]) -> tuple[FloatArray, float]:
    """Return where the best step leads, (p,), and the cost there."""
    return at.values + at.step(), at.cost - at.predicted_gain
