"""What of a printer may change between two checks, each change fitted by itself to the difference of their signals.

A change is one number: belts (all, or each), mass on the nozzle holder, damping and dry friction of the guides; of
straight axes frequency and damping of each mode. A few sizes of each are simulated; between them the response is
interpolated. Each experiment may be late by what its clock allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from ffcomp.check.signals import DEPENDENT, FROM_DAY_TO_DAY, RATE_HZ, SensorSignal, in_band, rows_of, share_apart
from ffcomp.numerics.serialise import keys
from ffcomp.record.clock import RATE_HZ as SIMULATED_HZ
from ffcomp.record.clock import simulated
from ffcomp.record.plan import Experiment
from models.arrays import FloatArray
from models.effects.catalogue import effects_of, measured
from models.machine import Machine, value_of, with_values

SPARE_S = 0.4  # simulated before and after
AS_NOISE = 1.25  # times the noise: nothing has changed
SIZES = np.array([-0.6, 0.6])  # of their usual sizes: how far changes are simulated at first
TRIED, ROUNDS = 3, 3  # changes whose best size is simulated too, and how often
BEYOND = 2.5  # times the simulated sizes may the best size lie beyond them
EARLIER_STEPS = 2  # from the machine file to the printer of an earlier check


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


def _flat(signals: Sequence[FloatArray]) -> FloatArray:
    """Join the experiments of m machines, (m, n, 3) each, to (m, rows)."""
    return np.concatenate([each.reshape(len(each), -1) for each in signals], axis=1)


# ---- the fit -------------------------------------------------------------------------------------


class _Weighing:
    """Inner products of signals in units of their noise, with the delay of each experiment fitted."""

    def __init__(self, felt: Sequence[SensorSignal], noise: Sequence[FloatArray], clock_sd_s: Sequence[float]) -> None:
        self.sd = np.concatenate(
            [np.sqrt(DEPENDENT) * np.tile(n, len(f.acceleration)) for f, n in zip(felt, noise, strict=True)]
        )
        slopes = block_diag(*(np.gradient(each.acceleration, 1.0 / RATE_HZ, axis=0).reshape(-1, 1) for each in felt))
        known = np.vstack([slopes / self.sd[:, None], np.diag(1.0 / np.array(clock_sd_s))])
        self.late = np.linalg.qr(known)[0][: len(slopes)]

    def __call__(self, signals: FloatArray) -> FloatArray:
        """Return the products (k, k) of signals (k, rows)."""
        weighed = signals / self.sd
        late = weighed @ self.late
        return weighed @ weighed.T - late @ late.T


def earlier_machine(machine: Machine, experiments: Sequence[Experiment], then: Sequence[SensorSignal]) -> Machine:
    """Fit the printer of an earlier check, whose machine file is only near it: small changes all at once."""
    changes = [each for each in changes_of(machine) if not each.special]
    noise = [np.hypot(each.noise, FROM_DAY_TO_DAY * each.size) for each in then]
    products = _Weighing(then, noise, [each.clock_sd_s for each in then])
    felt, values = np.concatenate([each.acceleration.ravel() for each in then]), np.zeros(len(changes))
    sd, low, high = (np.array([getattr(each, key) for each in changes]) for key in ("sd", "low", "high"))
    steps = np.where(high > 0.0, 0.1, -0.1) * sd
    for _ in range(EARLIER_STEPS):
        machines = [_changed(machine, changes, values + row) for row in np.vstack([0.0 * steps, np.diag(steps)])]
        here, *moved = _flat(expected_signals(machines, experiments))
        square = products(np.vstack([felt - here, *(each - here for each in moved)]))
        normal = square[1:, 1:] / np.outer(steps, steps) + np.diag(sd**-2.0)
        root = np.linalg.cholesky(normal)
        right = np.linalg.solve(root, square[1:, 0] / steps - values / sd**2)
        values = values + lsq_linear(root.T, right, (low - values - 1e-12, high - values + 1e-12)).x
        values = np.clip(values, low, high)
    return _changed(machine, changes, values)


def _changed(machine: Machine, changes: Sequence[Change], values: FloatArray) -> Machine:
    for change, value in zip(changes, values.tolist(), strict=True):
        machine = change.changed(machine, value) if value else machine
    return machine


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
    noise = [np.sqrt(now.noise**2 + then.noise**2 + (FROM_DAY_TO_DAY * now.size) ** 2) for now, then in pairs]
    clocks = [float(np.hypot(now.clock_sd_s, then.clock_sd_s)) for now, then in pairs]
    products = _Weighing([then for _, then in pairs], noise, clocks)
    apart = np.concatenate([(now.acceleration - then.acceleration).ravel() for now, then in pairs])
    rows, left = len(apart) / DEPENDENT, float(products(apart[None])[0, 0])
    changed = max(left - rows, 1e-9 * left)
    tried = {each: [(0.0, 0.0 * apart)] for each in changes_of(machine)}
    unchanged = _flat(expected_signals([machine], experiments))[0]

    def simulate(wanted: Sequence[tuple[Change, float]]) -> None:
        machines = [change.changed(machine, size) for change, size in wanted]
        for (change, size), felt in zip(wanted, _flat(expected_signals(machines, experiments)), strict=True):
            tried[change].append((size, felt - unchanged))

    def explained() -> list[Explanation]:
        found = []
        for change, responses in tried.items():
            value, sd, cost = _best_size(change, responses, apart, products)
            found.append(Explanation(change, value, sd, (left - cost) / changed))
        return sorted(found, key=lambda each: -each.share)

    simulate(
        [(each, size) for each in tried for size in np.clip(SIZES * each.sd, each.low, each.high).tolist() if size]
    )
    found = explained()
    for _ in range(ROUNDS if left > AS_NOISE**2 * rows else 0):
        simulate([(each.change, each.value) for each in found[:TRIED]])
        found = explained()
    felt = np.concatenate([then.acceleration for _, then in pairs])
    turned = np.column_stack([felt[:, 1], -felt[:, 0], 0.0 * felt[:, 2]])
    square = products(np.stack([apart, turned.ravel(), felt.ravel()]))
    turn, gain = np.linalg.solve(square[1:, 1:], square[1:, 0])
    signal = np.sqrt(np.mean([now.size**2 for now, _ in pairs]))
    size = np.sqrt(np.mean([(now.size * share_apart(now, then.acceleration)) ** 2 for now, then in pairs]))
    quiet = np.sqrt(np.mean([np.mean(now.noise**2 + then.noise**2) for now, then in pairs]))
    return Difference(
        size=float(size / signal),
        noise=float(quiet / signal),
        times=float(np.sqrt(left / rows)),
        rows=rows,
        explanations=tuple(found),
        turned_deg=float(np.rad2deg(turn)),
        gain=float(gain),
        sensor_share=float(square[0, 1:] @ [turn, gain]) / changed,
    )


def _best_size(
    change: Change, responses: Sequence[tuple[float, FloatArray]], apart: FloatArray, products: _Weighing
) -> tuple[float, float, float]:
    """Return the size whose interpolated response fits the difference best, its standard deviation, and the cost."""
    nodes = dict(sorted(responses, key=lambda each: each[0]))
    sizes = np.array(list(nodes))
    weights = CubicSpline(sizes, np.eye(len(sizes)))
    square = products(np.stack([apart, *nodes.values()]))
    values = np.linspace(max(BEYOND * sizes[0], change.low), min(BEYOND * sizes[-1], change.high), 1001)
    left = np.column_stack([np.ones(len(values)), -weights(values)])
    costs = np.einsum("vi,ij,vj->v", left, square, left)
    best = int(costs.argmin())
    slope = weights(values[best], 1)
    information = float(slope @ square[1:, 1:] @ slope)
    return float(values[best]), max(information, 1e-300) ** -0.5, float(costs[best])
