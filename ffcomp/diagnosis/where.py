"""Where the residual lies: its size, its excess by frequency, signal, place and motion, and its shape.

**Size** is √(Σ(measured − simulated)²/Σ measured²) inside the band. **Excess** is the mean square of the whitened
error, less one: 0 is noise alone, 3 means that the error is twice the noise.

**Curves** are the mean residual against position, speed and the drive's force: the shape of what the machine file
lacks. Of an axis whose force and position are known, the residual is a force: the drive's less the one that the
measured motion needs (inverse dynamics). Otherwise it is measured less simulated, as recorded: an acceleration or a
position. Each quantity is cut into bins of equally many rows. A bin's value is its mean; its band is the 90 % interval
from the scatter of the sums over motions and places about that mean, which may have any correlation within them (the
cluster sandwich: Liang & Zeger, Biometrika 73, 1986, with Student's t for few), and never less than the noise alone
allows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffcomp.diagnosis.fit import EstimationProblem, student_share
from ffcomp.diagnosis.noise import NoiseFloor, Whitener, lines, noise_floor, taper
from ffcomp.diagnosis.problem import Observation, Problem
from ffcomp.diagnosis.words import digits, percent
from ffcomp.identification.uncertainty import NINETY_PERCENT
from ffcomp.numerics.serialise import keys
from ffcomp.result import Fact
from models.arrays import FloatArray
from models.quantities import Quantities

MOST_SHOWN = 3  # bands, and places

# ---- size ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ResidualSize:
    """√(Σ(measured − simulated)²/Σ measured²) inside the band, and the same of noise alone."""

    json_keys: ClassVar = keys("nrms", "noise_nrms", "over_noise")

    nrms: float
    noise_nrms: float

    @property
    def over_noise(self) -> float:
        """How many times the noise it is."""
        return self.nrms / self.noise_nrms


@dataclass(frozen=True, eq=False)
class ResidualBreakdown:
    """The residual of one simulation as a whole and in parts."""

    json_keys: ClassVar = keys(
        "total", "signals", "near_reversals", frequency_hz="bands", runs="recordings", region="places"
    )

    total: ResidualSize
    signals: Mapping[str, ResidualSize]
    recordings: Mapping[str, ResidualSize]
    splits: Mapping[str, Split]  # by title

    @property
    def bands(self) -> list[tuple[float, float, float]]:
        """From Hz, to Hz, share of the excess."""
        split = self.splits["frequency"]
        return [(*span, share) for span, share in zip(split.spans, split.shares, strict=True)]

    @property
    def places(self) -> list[tuple[tuple[float, ...], str, float]]:
        """Each place, its name, and its share of the excess."""
        split = self.splits.get("place") or self.splits["window of time"]
        return list(zip(split.at, split.labels, split.shares, strict=True))

    @property
    def near_reversals(self) -> float:
        """Share of the excess while the part that carries the sensor reverses or rests."""
        split = self.splits["motion"]
        return dict(zip(split.labels, split.shares, strict=True)).get(SLOW, 0.0)

    @property
    def facts(self) -> list[Fact]:
        """Where most of the excess is: bands, places, reversals."""
        bands = sorted(self.bands, key=lambda band: -band[2])[:MOST_SHOWN]
        places = sorted(self.places, key=lambda place: -place[2])[:MOST_SHOWN]
        of_bands = ", ".join(f"{low:g}-{high:g} Hz {100 * x:.0f} %" for low, high, x in bands if x >= 0.005)
        of_places = ", ".join(f"{name} {100 * x:.0f} %" for _, name, x in places if x >= 0.005)
        slow = ("Excess near reversals and at rest", f"{100 * self.near_reversals:.0f} %")
        return [("Excess by frequency", of_bands), ("Excess by place", of_places), slow]


def locate_residual(
    problem: Problem, whiten: Whitener, floor: NoiseFloor, simulated: Sequence[FloatArray]
) -> ResidualBreakdown:
    """Compare all observations of a problem with their simulation, (n, m) each."""
    observations = whiten.observations
    names = [name for o in observations for name in o.signals]
    each = [_powers(whiten, floor, o, y) for o, y in zip(observations, simulated, strict=True)]
    powers = np.concatenate(each)
    residual = whiten([o.measured - y for o, y in zip(observations, simulated, strict=True)])
    return ResidualBreakdown(
        _size(powers),
        {name: _size(powers[[other == name for other in names]]) for name in sorted(set(names))},
        {Path(o.name).name: _size(part) for o, part in zip(observations, each, strict=True)},
        {split.title: split for split in split_residual(problem, whiten, residual)},
    )


def _powers(whiten: Whitener, floor: NoiseFloor, o: Observation, simulated: FloatArray) -> FloatArray:
    """Return the powers in the band of error, noise and measurement of each signal, (m, 3)."""
    error, measured = (whiten.band_power(o, x) for x in (o.measured - simulated, o.measured))
    return np.column_stack([error, whiten.noise_power(o, floor), measured])


def _size(powers: FloatArray) -> ResidualSize:
    error, noise, measured = powers.sum(axis=0).tolist()
    return ResidualSize(float(np.sqrt(error / measured)), float(np.sqrt(noise / measured)))


def _rows(values: Iterable[ArrayLike], observations: Sequence[Observation]) -> NDArray[Any]:
    """Return a row for each sample of each signal, (rows,): values (n, m) an observation, or what makes these."""
    parts = zip(values, observations, strict=True)
    return np.concatenate([np.broadcast_to(x, o.measured.shape).ravel() for x, o in parts])


# ---- excess by what it may depend on -------------------------------------------------------------

EDGES_HZ = (1.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 130.0, 160.0, 200.0)
SLOW_SHARE = 0.05  # of a signal's largest speed: slower than that it is near a reversal
PHASE_BINS = 16
SLOW = "turning back or at rest"


@dataclass(frozen=True)
class Split:
    """The excess over one quantity it may depend on; a value for each label."""

    title: str
    labels: tuple[str, ...]
    spans: tuple[tuple[float, float], ...] = ()  # from and to of each label, where labels follow one another
    unit: str = ""  # of the spans
    at: tuple[tuple[float, ...], ...] = ()  # places, where labels are places
    excess: tuple[float, ...] = ()
    weight: tuple[float, ...] = ()  # share of all entries compared

    @property
    def shares(self) -> list[float]:
        """Each label's share of the excess."""
        parts = np.maximum(self.excess, 0.0) * self.weight
        return list((parts / max(parts.sum(), 1e-300)).tolist())


def split_residual(problem: Problem, whiten: Whitener, residual: FloatArray) -> list[Split]:
    """Split the excess of a whitened residual (rows,) by all quantities it may depend on."""
    observations, bands = problem.observations, np.digitize(whiten.frequencies(), EDGES_HZ[1:-1])
    splits = [_filled(_spanned("frequency", EDGES_HZ, "Hz"), bands, np.ones(len(bands)), residual)]
    rows = _rows(series(whiten, residual), observations)
    faded = [taper(len(o.measured), o.rate_hz)[:, None] ** 2 for o in observations]
    noise = _rows((w / w.mean() for w in faded), observations)  # the square that noise alone has; the ends are faded
    signals = tuple(sorted({s for o in observations for s in o.signals}))
    places = tuple(dict.fromkeys(o.position for o in observations))
    place = "place" if len(places[0]) > 1 else "window of time"
    groups: list[tuple[Split, Callable[[int, Observation], ArrayLike]]] = [
        (Split("signal", signals), lambda _, o: [signals.index(s) for s in o.signals]),
        (Split(place, tuple(map(_place_name, places)), at=places), lambda _, o: places.index(o.position)),
        (Split("motion", ("backward", SLOW, "forward")), lambda _, o: _direction(o.speed)),
    ]
    if problem.commands:
        edges = np.linspace(0, 100, PHASE_BINS + 1)
        groups.append((_spanned("motor's step cycle", edges, "%"), lambda i, o: _phase(problem, i, o)))
    for split, group in groups:
        group_of = _rows((group(i, o) for i, o in enumerate(observations)), observations)
        splits.append(_filled(split, group_of, noise, rows))
    return splits


def _place_name(position: tuple[float, ...]) -> str:
    """Name a place of a recording, or a window of time."""
    return f"({', '.join(f'{x:g}' for x in position)}) mm" if len(position) > 1 else f"from {position[0]:g} s"


def _spanned(title: str, edges: Sequence[float] | FloatArray, unit: str) -> Split:
    spans = tuple((float(a), float(b)) for a, b in pairwise(edges))
    return Split(title, tuple(f"{a:.0f}-{b:.0f} {unit}" for a, b in spans), spans, unit)


def _filled(blank: Split, group: NDArray[np.int64], expected: FloatArray, residual: FloatArray) -> Split:
    """Fill a split with values; labels without any entry are left out.

    expected : the square that noise alone has in each entry.
    """
    count = len(blank.labels)
    kept = np.flatnonzero(np.bincount(group, minlength=count))
    noise = np.bincount(group, expected, count)[kept]
    excess = np.bincount(group, residual**2, count)[kept] / np.maximum(noise, 1e-300) - 1
    return replace(
        blank,
        labels=tuple(blank.labels[i] for i in kept),
        spans=tuple(blank.spans[i] for i in kept if blank.spans),
        at=tuple(blank.at[i] for i in kept if blank.at),
        excess=tuple(excess.tolist()),
        weight=tuple((noise / noise.sum()).tolist()),
    )


def series(whiten: Whitener, residual: FloatArray) -> list[FloatArray]:
    """Transform the whitened residual (rows,) back to time, (n, m) an observation; noise has a mean square of one."""
    series_of = []
    for observation, rows in zip(whiten.observations, whiten.rows, strict=True):
        real, imaginary = residual[rows].reshape(2, len(observation.signals), -1)
        keep, n = lines(observation, whiten.band_hz)[1], len(observation.measured)
        series_of.append(_in_time(whiten, observation, real + 1j * imaginary) * n / (2 * np.sqrt(keep.sum())))
    return series_of


def _in_time(whiten: Whitener, observation: Observation, spectrum: NDArray[np.complex128]) -> FloatArray:
    """Transform lines inside the band, (m, k), back to time: (n, m)."""
    keep = lines(observation, whiten.band_hz)[1]
    whole = np.zeros((len(spectrum), len(keep)), dtype=complex)
    whole[:, keep] = spectrum
    return np.asarray(np.fft.irfft(whole, len(observation.measured), axis=1).T)


def _direction(speed: FloatArray) -> NDArray[np.int64]:
    slow = np.abs(speed) < SLOW_SHARE * np.max(np.abs(speed), axis=0)
    return np.where(slow, 1, np.where(speed > 0, 2, 0)).astype(np.int64)


def _phase(problem: Problem, i: int, o: Observation) -> NDArray[np.int64]:
    """Return the phase of the signal's own motor, (n, m); of motor A for the nozzle's."""
    moved = problem.commands[i][:, ["ABC".find(s[-1]) if s[-1] in "ABC" else 0 for s in o.signals]]
    cycle_mm = 4.0 / problem.machine.steps.full_per_motor[0]
    return (np.mod(moved / cycle_mm, 1.0) * PHASE_BINS).astype(np.int64) % PHASE_BINS


# ---- curves of the residual ----------------------------------------------------------------------

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
        size = f"{digits(min(self.residual), 2)} to {digits(max(self.residual), 2)} {self.unit}"
        share = f"{percent(self.share)} of its power"
        if self.share < WEAK_SHARE:
            return f"residual {self.signal} depends little on {self.against}: {share}, {size}"
        return f"residual {self.signal} against {self.against}: {share}, {self.regime}; {size}"


def residual_curves(
    problem: Problem, values: Mapping[str, float], floor: NoiseFloor | None = None
) -> list[ResidualCurve]:
    """Return for each quantity the curve of the signal where it holds most, the largest share first.

    values : parameters of the simulation
    floor : noise of the problem's own signals; None: it is estimated
    """
    forces = problem.by_force()
    floor = floor if forces is problem and floor is not None else noise_floor(forces)
    observations = forces.observations
    signals = list(dict.fromkeys(s for o in observations for s in o.signals))
    signal = _rows(([signals.index(s) for s in o.signals] for o in observations), observations)
    residual = _rows(map(_residual, observations, forces.simulate(values)), observations)
    places = [(motion, o.position) for motion, o in zip(forces.motions, observations, strict=True)]
    cluster = _rows(map(places.index, places), observations)
    moved = [forces.moved(i) for i in range(len(observations))]
    quantities = {kind: _rows((m.get(kind, np.nan) for m in moved), observations) for m in moved for kind in m}
    best: dict[str, ResidualCurve] = {}
    for s, name in enumerate(signals):
        first = next(o for o in observations if name in o.signals)
        noise = _noise_of_a_row(floor, first, name, forces.band_hz)
        for kind, quantity in quantities.items():
            known = np.flatnonzero((signal == s) & np.isfinite(quantity) & np.isfinite(residual))
            curve = _curve(forces.quantities, (name, kind), quantity[known], residual[known], cluster[known], noise)
            if curve is not None and (kind not in best or curve.share > best[kind].share):
                best[kind] = curve
    return sorted((c for c in best.values() if c.share > SHOWN_SHARE), key=lambda c: -c.share)


def _residual(o: Observation, simulated: FloatArray) -> FloatArray:
    """Return measured less simulated, (n, m); an accelerometer's zero is not known."""
    apart = o.measured - simulated
    return np.asarray(apart - np.where([s.startswith("acc") for s in o.signals], np.nanmean(apart, axis=0), 0.0))


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
    count = min(max(len(quantity) // ROWS_A_BIN, FEWEST), MOST)
    edges = np.unique(np.quantile(quantity, np.linspace(0, 1, count + 1))) if len(quantity) else np.zeros(0)
    if len(edges) < FEWEST:
        return None
    group = np.clip(np.searchsorted(edges, quantity, "right") - 1, 0, len(edges) - 2)
    members = [np.flatnonzero(group == b) for b in np.unique(group)]
    bins = np.array([_mean_and_error(quantity[m], residual[m], cluster[m], noise) for m in members])
    rows, at = np.array([(len(m), quantity[m].mean()) for m in members]).T
    kept = np.isfinite(bins[:, 1])
    if kept.sum() < FEWEST:
        return None
    (mean, error, wider), rows, at = bins[kept].T, rows[kept], at[kept]
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

    rows, power : (k,) shares of each bin
    """
    size = np.abs(at)
    limits, edges = ([0.5 * (a + b) for a, b in pairwise(x)] for x in (np.sort(size), at))
    regimes = [(f"below {digits(x, 2)}", size < x) for x in limits]
    regimes += [(f"above {digits(x, 2)}", size > x) for x in limits]
    regimes += [(f"beyond {digits(x, 2)}", at > x) for x in edges]
    regimes += [(f"up to {digits(x, 2)}", at < x) for x in edges]
    pairs = combinations(edges, 2)
    regimes += [(f"from {digits(a, 2)} to {digits(b, 2)}", (at > a) & (at < b)) for a, b in pairs]
    gains = np.array([power[inside].sum() - rows[inside].sum() for _, inside in regimes])
    words, inside = regimes[int(np.argmax(gains > gains.max() - SIMPLER))]
    if gains.max() < REGIME_GAIN or power[inside].sum() < IN_REGIME:
        return "over the whole range"
    return f"most of it {words} {unit}"


# ---- as the report draws it ----------------------------------------------------------------------

WORST = 2  # signals that are shown
SHOWN_S = 0.25  # of each


@dataclass(frozen=True, eq=False)
class Overlay:
    """One signal of one recording where the residual was largest."""

    recording: str
    signal: str
    time_s: FloatArray  # (n,)
    measured: FloatArray  # (n,) inside the band, as the others
    before: FloatArray
    after: FloatArray
    noise_rms: float
    unit: str


def overlays_of(estimation: EstimationProblem, values: Mapping[str, float]) -> list[Overlay]:
    """Show the signals with the largest excess: before with the machine file, after with these values."""
    problem, whiten = estimation.problem, estimation.whiten
    answers = [problem.simulate({}), problem.simulate(values)]
    errors = series(whiten, estimation.measured - whiten(answers[0]))
    loudest: dict[str, tuple[float, int, int]] = {}
    for i, (o, error) in enumerate(zip(problem.observations, errors, strict=True)):
        for k, signal in enumerate(o.signals):
            loudest[signal] = max(loudest.get(signal, (0.0, 0, 0)), (float(np.mean(error[:, k] ** 2)), i, k))
    worst = sorted(loudest.values(), reverse=True)[:WORST]
    return [_overlay(problem, whiten, answers, errors[i][:, k], i, k) for _, i, k in worst]


def _overlay(
    problem: Problem, whiten: Whitener, answers: Sequence[Sequence[FloatArray]], error: FloatArray, i: int, k: int
) -> Overlay:
    """Show signal k of observation i around the time where its whitened error (n,) was largest."""
    o = problem.observations[i]
    half = round(SHOWN_S * o.rate_hz / 2)
    power = np.convolve(error**2, np.ones(2 * half), "same")
    middle = min(max(int(power.argmax()), half), max(len(power) - half, half))
    part = slice(middle - half, middle + half)
    _, unit, scale = problem.quantities.signal(o.signals[k])
    signals = (o.measured, *(simulated[i] for simulated in answers))
    measured, before, after = (scale * _in_time(whiten, o, whiten.spectrum(o, x)[0])[part, k] for x in signals)
    frequency, _ = lines(o, whiten.band_hz)
    noise = scale * float(np.sqrt(np.sum(whiten.floor.at(o.signals[k], frequency)) * (frequency[1] - frequency[0])))
    time = np.arange(part.start, part.stop) / o.rate_hz
    return Overlay(Path(o.name).name, o.signals[k], time, measured, before, after, noise, unit)
