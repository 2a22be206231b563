"""Where the residual lies: its size by signal and recording, its excess by frequency, signal, position and motion.

Size is √(Σ(measured − simulated)²/Σ measured²) inside the band. Excess is the mean square of the whitened error, less
one: 0 is noise alone, 3 means that the error is twice the noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.noise import NoiseFloor, Whitener, lines, taper
from ffcomp.diagnosis.problem import Problem
from ffcomp.numerics.serialise import keys
from models.arrays import FloatArray

EDGES_HZ = (1.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 130.0, 160.0, 200.0)
SLOW_SHARE = 0.05  # of a signal's largest speed: slower than that it is near a reversal
PHASE_BINS = 16
WORST = 2  # signals that are shown
BACKWARD, SLOW, FORWARD = MOTIONS = ("backward", "turning back or at rest", "forward")


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


@dataclass(frozen=True)
class Split:
    """The excess over one quantity it may depend on; a value for each label."""

    title: str
    labels: tuple[str, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]  # empty: of one simulation only
    weight: tuple[float, ...]  # share of all entries compared
    spans: tuple[tuple[float, float], ...] = ()  # from and to of each label, where labels follow one another
    unit: str = ""  # of the spans
    at: tuple[tuple[float, ...], ...] = ()  # places, where labels are places

    @property
    def shares(self) -> list[float]:
        """Each label's share of the excess before."""
        parts = np.maximum(self.before, 0.0) * self.weight
        return list((parts / max(parts.sum(), 1e-300)).tolist())


@dataclass(frozen=True, eq=False)
class ResidualBreakdown:
    """The residual of one simulation as a whole and in parts."""

    json_keys: ClassVar = keys(
        *("total", "signals", "near_reversals", "forwards"),
        frequency_hz="bands",
        runs="recordings",
        region="places",
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
        return self._in_motion(SLOW)

    @property
    def forwards(self) -> float:
        """Share of the excess while that part moves forwards, of all while it moves."""
        ahead, back = self._in_motion(FORWARD), self._in_motion(BACKWARD)
        return ahead / max(ahead + back, 1e-300)

    def _in_motion(self, label: str) -> float:
        split = self.splits["motion"]
        return split.shares[split.labels.index(label)] if label in split.labels else 0.0


def locate_residual(
    problem: Problem, whiten: Whitener, floor: NoiseFloor, simulated: Sequence[FloatArray]
) -> ResidualBreakdown:
    """Compare all observations of a problem with their simulation, (n, m) each."""
    observations = whiten.observations
    names = [name for o in observations for name in o.signals]
    each = [_powers(whiten, floor, i, y) for i, y in enumerate(simulated)]
    powers = np.concatenate(each)
    files = zip(observations, each, strict=True)
    residual = whiten([o.measured - y for o, y in zip(observations, simulated, strict=True)])
    return ResidualBreakdown(
        _size(powers),
        {name: _size(powers[[other == name for other in names]]) for name in sorted(set(names))},
        {Path(o.name).name: _size(part) for o, part in files},
        {split.title: split for split in split_residual(problem, whiten, residual)},
    )


def _powers(whiten: Whitener, floor: NoiseFloor, i: int, simulated: FloatArray) -> FloatArray:
    """Return the powers in the band of error, noise and measurement of each signal of observation i, (m, 3)."""
    o = whiten.observations[i]
    (error, frequency), (measured, _) = whiten.spectrum(o, o.measured - simulated), whiten.spectrum(o, o.measured)
    noise = [2 * whiten.power(o) * float(np.sum(floor.at(name, frequency))) for name in o.signals]
    return np.column_stack([np.sum(np.abs(error) ** 2, axis=1), noise, np.sum(np.abs(measured) ** 2, axis=1)])


def _size(powers: FloatArray) -> ResidualSize:
    error, noise, measured = powers.sum(axis=0).tolist()
    return ResidualSize(float(np.sqrt(error / measured)), float(np.sqrt(noise / measured)))


# ---- splits --------------------------------------------------------------------------------------


def split_residual(problem: Problem, whiten: Whitener, *residuals: FloatArray) -> list[Split]:
    """Split the excess of one or two whitened residuals (rows,) by all quantities it may depend on."""
    bands = np.digitize(whiten.frequencies(), EDGES_HZ[1:-1])
    edges = tuple(pairwise(EDGES_HZ))
    blank = Split("frequency", tuple(f"{a:g}-{b:g} Hz" for a, b in edges), (), (), (), edges, "Hz")
    splits = [_filled(blank, bands, np.ones(len(bands)), residuals)]
    joined = [np.concatenate([x.ravel() for x in series(whiten, residual)]) for residual in residuals]
    expected = np.concatenate([x.ravel() for x in _expected(whiten)])
    for empty, groups in _by(problem):
        splits.append(_filled(empty, np.concatenate([g.ravel() for g in groups]), expected, joined))
    return splits


def _filled(blank: Split, group: NDArray[np.int64], expected: FloatArray, residuals: Sequence[FloatArray]) -> Split:
    """Fill a split with values; labels without any entry are left out.

    expected : the square that noise alone has in each entry.
    """
    count = len(blank.labels)
    kept = np.flatnonzero(np.bincount(group, minlength=count))
    noise = np.bincount(group, expected, count)[kept]
    means = [np.bincount(group, x**2, count)[kept] / np.maximum(noise, 1e-300) - 1 for x in residuals]

    def of_kept(values: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(values[i] for i in kept) if values else ()

    return replace(
        blank,
        labels=of_kept(blank.labels),
        spans=of_kept(blank.spans),
        at=of_kept(blank.at),
        before=tuple(means[0].tolist()),
        after=tuple(means[1].tolist()) if len(means) > 1 else (),
        weight=tuple((noise / noise.sum()).tolist()),
    )


def _expected(whiten: Whitener) -> list[FloatArray]:
    """Return the square that noise alone has in `series`, (n, m) an observation; the ends are faded."""
    faded = [taper(len(r.measured), r.rate_hz) ** 2 for r in whiten.observations]
    return [np.outer(w / w.mean(), np.ones(len(r.signals))) for w, r in zip(faded, whiten.observations, strict=True)]


def series(whiten: Whitener, residual: FloatArray) -> list[FloatArray]:
    """Transform the whitened residual (rows,) back to time, (n, m) an observation; noise has a mean square of one."""
    series_of = []
    for observation, rows in zip(whiten.observations, whiten.rows, strict=True):
        _, keep = lines(observation, whiten.band_hz)
        real, imaginary = residual[rows].reshape(2, len(observation.signals), -1)
        spectrum = np.zeros((len(observation.signals), len(keep)), dtype=complex)
        spectrum[:, keep] = real + 1j * imaginary
        n = len(observation.measured)
        series_of.append(np.fft.irfft(spectrum, n, axis=1).T * n / (2 * np.sqrt(keep.sum())))
    return series_of


def _by(problem: Problem) -> list[tuple[Split, list[NDArray[np.int64]]]]:
    """List every split: its labels, and which of them each sample (n, m) of each observation has."""
    observations = problem.observations
    signals = sorted({s for r in observations for s in r.signals})
    positions = list(dict.fromkeys(r.position for r in observations))
    full: list[NDArray[np.int64]] = [np.ones(r.measured.shape, dtype=np.int64) for r in observations]
    by_signal = [
        one * np.array([signals.index(s) for s in r.signals]) for one, r in zip(full, observations, strict=True)
    ]
    by_position = [one * positions.index(r.position) for one, r in zip(full, observations, strict=True)]
    moved = [_direction(r.speed) for r in observations]
    return [
        (_named("signal", signals), by_signal),
        (_places(problem, positions), by_position),
        (_named("motion", MOTIONS), moved),
        *_by_phase(problem),
    ]


def _places(problem: Problem, positions: Sequence[tuple[float, ...]]) -> Split:
    return replace(
        _named("place" if problem.reach_mm else "window of time", [problem.place_name(p) for p in positions]),
        at=tuple(positions),
    )


def _named(title: str, labels: Sequence[str]) -> Split:
    return Split(title, tuple(labels), (), (), ())


def _shares(title: str, edges: Sequence[float] | FloatArray) -> Split:
    spans = tuple((100 * float(a), 100 * float(b)) for a, b in pairwise(edges))
    return Split(title, tuple(f"{a:.0f}-{b:.0f} %" for a, b in spans), (), (), (), spans, "%")


def _direction(speed: FloatArray) -> NDArray[np.int64]:
    slow = np.abs(speed) < SLOW_SHARE * np.max(np.abs(speed), axis=0)
    return np.where(slow, 1, np.where(speed > 0, 2, 0)).astype(np.int64)


def _by_phase(problem: Problem) -> list[tuple[Split, list[NDArray[np.int64]]]]:
    """Split by the phase of the signal's own motor; of motor A for the nozzle's."""
    if not problem.commands:
        return []
    phases, cycle = [], problem.cycle_mm
    for r, command in zip(problem.observations, problem.commands, strict=True):
        moved = command[:, ["ABC".find(s[-1]) if s[-1] in "ABC" else 0 for s in r.signals]]
        phases.append((np.mod(moved / cycle, 1.0) * PHASE_BINS).astype(np.int64) % PHASE_BINS)
    return [(_shares("motor's step cycle", np.linspace(0, 1, PHASE_BINS + 1)), phases)]


# ---- as the report draws it ----------------------------------------------------------------------


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


@dataclass(frozen=True, eq=False)
class DrawnResidual:
    """Where measurement and simulation differ, before and after the fit."""

    band_hz: tuple[float, float]  # where measurement and simulation are compared
    noise_from: str  # in words
    splits: tuple[Split, ...]
    overlays: tuple[Overlay, ...]


def drawn_residual(problem: Problem, diagnosis: Diagnosis) -> DrawnResidual:
    """Compare measurement and simulation: before with the machine file, after with the final fit."""
    estimation = diagnosis.estimation
    answers = problem.simulate({}), problem.simulate(diagnosis.final.values)
    before, after = (estimation.measured - estimation.whiten(simulated) for simulated in answers)
    return DrawnResidual(
        estimation.whiten.band_hz,
        diagnosis.noise.origin,
        tuple(split_residual(problem, estimation.whiten, before, after)),
        tuple(_overlays(problem, estimation.whiten, answers, before)),
    )


Answers = tuple[list[FloatArray], list[FloatArray]]  # (n, m) an observation, before and after


def _overlays(problem: Problem, whiten: Whitener, answers: Answers, before: FloatArray) -> list[Overlay]:
    """Select the signals with the largest excess, around the time where it was largest."""
    errors = series(whiten, before)
    ranked = sorted(
        ((float(np.mean(e[:, k] ** 2)), i, k) for i, e in enumerate(errors) for k in range(e.shape[1])), reverse=True
    )
    distinct = {problem.observations[i].signals[k]: (i, k) for _, i, k in reversed(ranked)}
    chosen = [(i, k) for _, i, k in ranked if distinct[problem.observations[i].signals[k]] == (i, k)]
    return [_overlay(problem, whiten, answers, errors[i][:, k], i, k) for i, k in chosen[:WORST]]


def _overlay(problem: Problem, whiten: Whitener, answers: Answers, error: FloatArray, i: int, k: int) -> Overlay:
    r = problem.observations[i]
    half = round(0.25 * r.rate_hz / 2)  # of a window of a quarter of a second
    power = np.convolve(error**2, np.ones(2 * half), "same")
    middle = min(max(int(power.argmax()), half), max(len(power) - half, half))
    part = slice(middle - half, middle + half)
    measured, before, after = (_in_band(whiten, i, x)[part, k] for x in (r.measured, answers[0][i], answers[1][i]))
    frequency, _ = lines(r, whiten.band_hz)
    noise = whiten.floor.at(r.signals[k], frequency)
    rms = float(np.sqrt(np.sum(noise) * (frequency[1] - frequency[0])))
    time = np.arange(part.start, part.stop) / r.rate_hz
    _, unit, scale = problem.names.quantities.signal(r.signals[k])
    shown = (scale * measured, scale * before, scale * after, scale * rms)
    return Overlay(Path(r.name).name, r.signals[k], time, *shown, unit)


def _in_band(whiten: Whitener, i: int, x: FloatArray) -> FloatArray:
    """Filter signals (n, m) of observation i to the compared band."""
    observation = whiten.observations[i]
    _, keep = lines(observation, whiten.band_hz)
    spectrum = np.zeros((len(keep), x.shape[1]), dtype=complex)
    spectrum[keep] = whiten.spectrum(observation, x)[0].T
    return np.asarray(np.fft.irfft(spectrum, len(x), axis=0))
