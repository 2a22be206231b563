"""The residual against position, speed and the drive's force: the shape of what the machine file lacks.

Of an axis whose force and position are known, the residual is a force: the drive's less the one that the measured
motion needs (inverse dynamics). Otherwise it is measured less simulated, as recorded: an acceleration or a position.

Each quantity is cut into bins of equally many rows. A bin's value is its mean; its band is the 90 % interval from the
scatter of the sums over motions and places about that mean, which may have any correlation within them (the cluster
sandwich: Liang & Zeger, Biometrika 73, 1986, with Student's t for few), and never less than the noise alone allows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.fit import student_share
from ffcomp.diagnosis.noise import NoiseFloor, noise_floor
from ffcomp.diagnosis.problem import Observation, Problem
from ffcomp.diagnosis.words import digits, percent
from ffcomp.identification.uncertainty import NINETY_PERCENT
from models.arrays import FloatArray
from models.quantities import Quantities

ROWS_A_BIN, FEWEST, MOST = 100, 6, 40  # bins
LEAST_CLUSTERS = 3  # with rows in a bin: fewer give no band
SHOWN_SHARE = 0.02  # of the residual's power: a curve that holds less is not shown
WEAK_SHARE = 0.1  # below it, the residual depends little on the quantity
IN_REGIME, REGIME_GAIN = 0.75, 0.25  # share of a curve's power in a regime; more than its share of the rows
SIMPLER = 0.05  # less gain: a regime that takes fewer words is preferred
NOUNS = {"pos": "position", "vel": "speed", "acc": "acceleration", "force": "the drive's force"}


@dataclass(frozen=True)
class ResidualCurve:
    """The mean residual in k bins of one quantity, in the units of the machine file."""

    signal: str  # whose residual it is: `force`, `acc_x`
    unit: str
    against: str  # `position`, `speed`, `acceleration`, `the drive's force`
    against_unit: str
    at: tuple[float, ...]  # (k,) mean of the quantity in each bin
    residual: tuple[float, ...]  # (k,)
    half_width: tuple[float, ...]  # (k,) of the 90 % band
    share: float  # of the residual's power that the curve holds, beyond what its uncertainty alone gives
    regime: str  # where most of that lies

    @property
    def sentence(self) -> str:
        """Say where the residual lies."""
        low, high = min(self.residual), max(self.residual)
        size = f"{digits(low, 2)} to {digits(high, 2)} {self.unit}"
        if self.share < WEAK_SHARE:
            return (
                f"residual {self.signal} depends little on {self.against}: {percent(self.share)} of its power, {size}"
            )
        return (
            f"residual {self.signal} against {self.against}: {percent(self.share)} of its power, {self.regime}; {size}"
        )


def residual_curves(
    problem: Problem, values: Mapping[str, float], floor: NoiseFloor | None = None
) -> list[ResidualCurve]:
    """Return for each quantity the curve of the signal where it holds most, the largest share first.

    Parameters
    ----------
    values : parameters of the simulation
    floor : noise of the problem's own signals; None: it is estimated
    """
    forces = problem.by_force()
    floor = floor if forces is problem and floor is not None else noise_floor(forces)
    observations = forces.observations
    residuals = [o.measured - y for o, y in zip(observations, forces.simulate(values), strict=True)]
    moved = [forces.moved(i) for i in range(len(observations))]
    places = [(motion, o.position) for motion, o in zip(forces.motions, observations, strict=True)]
    best: dict[str, ResidualCurve] = {}
    for signal in dict.fromkeys(s for o in observations for s in o.signals):
        holding = [(i, o.signals.index(signal)) for i, o in enumerate(observations) if signal in o.signals]
        if signal.startswith("acc"):  # an accelerometer's zero is not known
            rows = [residuals[i][:, k] - np.nanmean(residuals[i][:, k]) for i, k in holding]
        else:
            rows = [residuals[i][:, k] for i, k in holding]
        cluster = np.concatenate(
            [np.full(len(x), places.index(places[i])) for (i, _), x in zip(holding, rows, strict=True)]
        )
        noise = _noise_of_a_row(floor, observations[holding[0][0]], signal, forces.band_hz)
        for kind in set.intersection(*({*moved[i]} for i, _ in holding)):
            quantity = np.concatenate([moved[i][kind][:, k] for i, k in holding])
            curve = _curve(forces.names.quantities, (signal, kind), quantity, np.concatenate(rows), cluster, noise)
            if curve is not None and (kind not in best or curve.share > best[kind].share):
                best[kind] = curve
    return sorted((c for c in best.values() if c.share > SHOWN_SHARE), key=lambda c: -c.share)


def curves_of(diagnosis: Diagnosis) -> list[ResidualCurve]:
    """Return the curves of what a diagnosis leaves; none where it leaves nothing, or the recordings are at fault.

    Where one effect is named and leaves a rest, that rest; else the residual of the original machine file.
    """
    if diagnosis.finding not in ("dominant", "unproven", "unexplained"):
        return []
    values = diagnosis.final.values if diagnosis.finding == "dominant" else {}
    return residual_curves(diagnosis.estimation.problem, values, diagnosis.noise)


def _noise_of_a_row(floor: NoiseFloor, observation: Observation, signal: str, band_hz: tuple[float, float]) -> float:
    """Return the noise's variance in the band, per row: the variance of a mean of n rows is 1/n of that."""
    low, high = band_hz
    frequency = np.linspace(max(low, 1e-3), high, 200)
    power = float(np.mean(floor.at(signal, frequency))) * (high - low)
    return power * max(observation.rate_hz / (2 * (high - low)), 1.0)  # fewer rows are independent


def _curve(
    quantities: Quantities,
    names: tuple[str, str],
    quantity: FloatArray,
    residual: FloatArray,
    cluster: NDArray[np.int64],
    noise: float,
) -> ResidualCurve | None:
    """Average the residual (n,) in bins of a quantity (n,); None where too little was recorded for a band."""
    known = np.isfinite(quantity) & np.isfinite(residual)
    quantity, residual, cluster = quantity[known], residual[known], cluster[known]
    count = min(max(len(quantity) // ROWS_A_BIN, FEWEST), MOST)
    edges = np.unique(np.quantile(quantity, np.linspace(0, 1, count + 1))) if len(quantity) else np.zeros(0)
    if len(edges) < FEWEST:
        return None
    group = np.clip(np.searchsorted(edges, quantity, "right") - 1, 0, len(edges) - 2)
    bins = [
        _mean_and_error(quantity[group == b], residual[group == b], cluster[group == b], noise)
        for b in range(len(edges) - 1)
    ]
    kept = [b for b, (_, error, _) in enumerate(bins) if np.isfinite(error)]
    if len(kept) < FEWEST:
        return None
    at = np.array([quantity[group == b].mean() for b in kept])
    mean, error, wider = np.array([bins[b] for b in kept]).T
    rows = np.bincount(group, minlength=len(edges) - 1)[kept]
    power = rows * np.maximum(mean**2 - error**2, 0.0)
    signal, kind = names
    _, unit, scale = quantities.signal(signal)
    _, against_unit, along = quantities.signal(kind)
    return ResidualCurve(
        signal,
        unit,
        NOUNS[kind],
        against_unit,
        tuple((along * at).tolist()),
        tuple((scale * mean).tolist()),
        tuple((scale * NINETY_PERCENT * wider * error).tolist()),
        float(power.sum() / max(residual @ residual, 1e-300)),
        _regime(along * at, rows / rows.sum(), power / max(power.sum(), 1e-300), against_unit),
    )


def _mean_and_error(
    quantity: FloatArray, residual: FloatArray, cluster: NDArray[np.int64], noise: float
) -> tuple[float, float, float]:
    """Return the mean of n rows, its standard error (infinite with too few clusters), and Student's share for it.

    The law's slope within the bin is no error of the mean, and is taken out of the scatter.
    """
    n, members = len(residual), np.unique(cluster)
    if len(members) < LEAST_CLUSTERS:
        return 0.0, float("inf"), 1.0
    mean, x = float(residual.mean()), quantity - quantity.mean()
    slope = float(x @ residual) / max(float(x @ x), 1e-300)
    sums = np.bincount(cluster, residual - mean - slope * x)
    scatter = float(sums @ sums) / n**2 * len(members) / (len(members) - 1)
    return mean, float(np.sqrt(max(scatter, noise / n))), student_share(len(members) - 1)


def _regime(at: FloatArray, rows: FloatArray, power: FloatArray, unit: str) -> str:
    """Return the part of a quantity's range, (k,), that holds most of a curve's power, but few of its rows.

    Parameters
    ----------
    rows, power : (k,) shares of each bin
    """
    limits = [0.5 * (low + high) for low, high in pairwise(np.sort(np.abs(at)))]
    regimes = [(f"most of it below {digits(x, 2)} {unit}", np.abs(at) < x) for x in limits]
    regimes += [(f"most of it above {digits(x, 2)} {unit}", np.abs(at) > x) for x in limits]
    edges = [0.5 * (low + high) for low, high in pairwise(at)]
    regimes += [(f"most of it beyond {digits(x, 2)} {unit}", at > x) for x in edges]
    regimes += [(f"most of it up to {digits(x, 2)} {unit}", at < x) for x in edges]
    regimes += [
        (f"most of it from {digits(a, 2)} to {digits(b, 2)} {unit}", (at > a) & (at < b))
        for a, b in combinations(edges, 2)
    ]
    gains = np.array([power[inside].sum() - rows[inside].sum() for _, inside in regimes])
    words, inside = regimes[int(np.argmax(gains > gains.max() - SIMPLER))]
    if gains.max() < REGIME_GAIN or power[inside].sum() < IN_REGIME:
        return "over the whole range"
    return words
