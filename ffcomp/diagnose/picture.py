"""A diagnosis as something to look at: where the gap was and is, curves, the evidence, what to measure next.

Numbers only; drawing is for `ffcomp.report`. Excess is the mean square of the whitened error, less one: 0 is noise
alone, 3 means that the error is twice as large as the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnose.delta import Delta
from ffcomp.diagnose.engine import Diagnosis
from ffcomp.diagnose.fit import Bench
from ffcomp.diagnose.gates import Place
from ffcomp.diagnose.noise import lines, taper
from ffcomp.diagnose.search import Hypothesis, gap_of
from ffcomp.diagnose.where import EDGES_HZ, SLOW_SHARE
from ffcomp.measured.frf import FloatArray

TIME_BINS = 24
PHASE_BINS = 16
CYCLE_STEPS = 4.0  # full steps of a motor's electrical cycle
QUANTILES = (0.0, 0.25, 0.5, 0.75, 0.9, 0.98, 1.0)  # of the size of motion
OVERLAYS = 4
WINDOW_S = 0.25  # of an overlay


@dataclass(frozen=True)
class Split:
    """The excess over one thing it may depend on; a bar for each label."""

    title: str
    labels: tuple[str, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Overlay:
    """One signal of one run where the gap was largest."""

    run: str
    signal: str
    time_s: FloatArray  # (n,)
    measured: FloatArray  # (n,) inside the band, as the others
    before: FloatArray
    after: FloatArray
    noise_rms: float


@dataclass(frozen=True)
class Evidence:
    """One hypothesis that was tried."""

    effects: tuple[str, ...]
    left: float  # gap, of the noise
    against_best: float  # −2 ln Z more than the best's
    numbers: int
    named: bool


@dataclass(frozen=True)
class Next:
    """The run among those there are that tells the named effects and a rival apart best."""

    rival: tuple[str, ...]
    run: str
    sigmas_per_second: float


@dataclass(frozen=True, eq=False)
class Picture:
    splits: tuple[Split, ...]
    overlays: tuple[Overlay, ...]
    evidence: tuple[Evidence, ...]
    places: tuple[Place, ...]
    next: tuple[Next, ...]


def picture(plant: Delta, found: Diagnosis) -> Picture:
    """What a report shows of a diagnosis: before is the machine file as it is, after with what was found."""
    desk = found.bench
    before, after = desk.residual({}), found.final.residual
    return Picture(
        tuple(_splits(plant, desk, before, after)),
        tuple(_overlays(plant, found, before)),
        tuple(_evidence(found)),
        tuple(found.places),
        tuple(_next(found)),
    )


# ---- where ---------------------------------------------------------------------------------------


def _splits(plant: Delta, desk: Bench, before: FloatArray, after: FloatArray) -> list[Split]:
    frequency = desk.whiten.frequencies()
    bands = np.digitize(frequency, EDGES_HZ[1:-1])
    named = [f"{a:g}-{b:g} Hz" for a, b in pairwise(EDGES_HZ)]
    found = [_split("frequency", named, bands, np.ones(len(bands)), before, after)]
    parts = (_expected(desk), series(desk, before), series(desk, after))
    for title, labels, groups in _labelled(plant):
        joined = [np.concatenate([x.ravel() for x in part]) for part in parts]
        found.append(_split(title, labels, np.concatenate([g.ravel() for g in groups]), *joined))
    return found


def _split(
    title: str,
    labels: Sequence[str],
    group: NDArray[np.int64],
    expected: FloatArray,
    before: FloatArray,
    after: FloatArray,
) -> Split:
    """expected : the square that noise alone has in each entry."""
    noise = np.maximum(np.bincount(group, expected, len(labels)), 1e-300)
    means = [np.bincount(group, x**2, len(labels)) / noise - 1 for x in (before, after)]
    kept = [i for i in range(len(labels)) if np.any(group == i)]
    return Split(
        title,
        tuple(labels[i] for i in kept),
        tuple(float(means[0][i]) for i in kept),
        tuple(float(means[1][i]) for i in kept),
    )


def _expected(desk: Bench) -> list[FloatArray]:
    """(n, m) a recording: the square that noise alone has in `series`; the ends are faded."""
    faded = [taper(len(r.measured), r.rate_hz) ** 2 for r in desk.whiten.recordings]
    return [np.outer(w / w.mean(), np.ones(len(r.signals))) for w, r in zip(faded, desk.whiten.recordings, strict=True)]


def series(desk: Bench, residual: FloatArray) -> list[FloatArray]:
    """The whitened residual (rows,) back in time, (n, m) a recording: noise alone has a mean square of one."""
    found = []
    for recording, rows in zip(desk.whiten.recordings, desk.whiten.rows, strict=True):
        _, keep = lines(recording, desk.whiten.band_hz)
        real, imaginary = residual[rows].reshape(2, len(recording.signals), -1)
        spectrum = np.zeros((len(recording.signals), len(keep)), dtype=complex)
        spectrum[:, keep] = real + 1j * imaginary
        n = len(recording.measured)
        found.append(np.fft.irfft(spectrum, n, axis=1).T * n / (2 * np.sqrt(keep.sum())))
    return found


Labelled = tuple[str, list[str], list[NDArray[np.int64]]]


def _labelled(plant: Delta) -> list[Labelled]:
    """For every thing to split by: its labels, and which of them each sample (n, m) of each recording has."""
    recordings = plant.recordings
    signals = sorted({s for r in recordings for s in r.signals})
    places = list(dict.fromkeys(r.place for r in recordings))
    full: list[NDArray[np.int64]] = [np.ones(r.measured.shape, dtype=np.int64) for r in recordings]
    by_signal = [one * np.array([signals.index(s) for s in r.signals]) for one, r in zip(full, recordings, strict=True)]
    by_place = [one * places.index(r.place) for one, r in zip(full, recordings, strict=True)]
    by_run = [one * i for i, one in enumerate(full)]
    by_time = [one * (np.arange(len(one)) * TIME_BINS // len(one))[:, None] for one in full]
    return [
        ("signal", signals, by_signal),
        ("place", ["(" + ", ".join(f"{x:g}" for x in p) + ") mm" for p in places], by_place),
        ("run", [r.name for r in recordings], by_run),
        ("share of the run's time", [f"{i / TIME_BINS:.0%}" for i in range(TIME_BINS)], by_time),
        ("motion", ["backward", "turning back or at rest", "forward"], [_direction(r.speed) for r in recordings]),
        ("size of motion", _quantile_names(), [_size(r.measured) for r in recordings]),
        ("motor's step cycle", [f"{i / PHASE_BINS:.0%}" for i in range(PHASE_BINS)], _phases(plant)),
    ]


def _direction(speed: FloatArray) -> NDArray[np.int64]:
    slow = np.abs(speed) < SLOW_SHARE * np.max(np.abs(speed), axis=0)
    return np.where(slow, 1, np.where(speed > 0, 2, 0)).astype(np.int64)


def _size(measured: FloatArray) -> NDArray[np.int64]:
    size = np.abs(np.nan_to_num(measured))
    edges = np.quantile(size, QUANTILES[1:-1], axis=0)
    return np.sum(size[None] > edges[:, None], axis=0).astype(np.int64)


def _quantile_names() -> list[str]:
    return [f"{100 * a:g}-{100 * b:g} % of its samples" for a, b in pairwise(QUANTILES)]


def _phases(plant: Delta) -> list[NDArray[np.int64]]:
    """Of the signal's own motor; of motor A for the nozzle's."""
    cycle = CYCLE_STEPS / plant.machine.steps.full_steps_per_mm
    found = []
    for r, command in zip(plant.recordings, plant.commands, strict=True):
        own = command[:, ["ABC".find(s[-1]) if s[-1] in "ABC" else 0 for s in r.signals]]
        found.append((np.mod(own / cycle, 1.0) * PHASE_BINS).astype(np.int64) % PHASE_BINS)
    return found


# ---- curves --------------------------------------------------------------------------------------


def _overlays(plant: Delta, found: Diagnosis, before: FloatArray) -> list[Overlay]:
    """The signals with the largest excess, around the moment where it was largest."""
    desk, answers = found.bench, (plant.simulate({}), plant.simulate(found.final.values))
    errors = series(desk, before)
    ranked = sorted(
        ((float(np.mean(e[:, k] ** 2)), i, k) for i, e in enumerate(errors) for k in range(e.shape[1])), reverse=True
    )
    distinct = {plant.recordings[i].signals[k]: (i, k) for _, i, k in reversed(ranked)}
    chosen = [(i, k) for _, i, k in ranked if distinct[plant.recordings[i].signals[k]] == (i, k)]
    return [_overlay(plant, desk, answers, errors[i][:, k], i, k) for i, k in chosen[:OVERLAYS]]


def _overlay(
    plant: Delta, desk: Bench, answers: tuple[list[FloatArray], ...], error: FloatArray, i: int, k: int
) -> Overlay:
    r = plant.recordings[i]
    half = round(WINDOW_S * r.rate_hz / 2)
    power = np.convolve(error**2, np.ones(2 * half), "same")
    middle = min(max(int(power.argmax()), half), max(len(power) - half, half))
    part = slice(middle - half, middle + half)
    measured, before, after = (_in_band(desk, i, x)[part, k] for x in (r.measured, answers[0][i], answers[1][i]))
    frequency, _ = lines(r, desk.whiten.band_hz)
    noise = desk.whiten.floor.at(r.signals[k], frequency)
    rms = float(np.sqrt(np.sum(noise) * (frequency[1] - frequency[0])))
    time = np.arange(part.start, part.stop) / r.rate_hz
    return Overlay(r.name, r.signals[k], time, measured, before, after, rms)


def _in_band(desk: Bench, i: int, x: FloatArray) -> FloatArray:
    """(n, m) of recording i inside the band, as it is compared."""
    recording = desk.whiten.recordings[i]
    _, keep = lines(recording, desk.whiten.band_hz)
    spectrum = np.zeros((len(keep), x.shape[1]), dtype=complex)
    spectrum[keep] = desk.whiten.spectrum(recording, x)[0].T
    return np.asarray(np.fft.irfft(spectrum, len(x), axis=0))


# ---- evidence and what to measure next -----------------------------------------------------------


def _evidence(found: Diagnosis) -> list[Evidence]:
    if found.best is None:
        return []
    best = found.best.fit.evidence
    rows = [Evidence(h.names, h.gap, h.fit.evidence - best, len(h.fit.numbers), h is found.named) for h in found.tried]
    base = found.base
    nothing = Evidence((), gap_of(base), base.evidence - best, len(base.numbers), False)
    return [*rows, nothing]


def _next(found: Diagnosis) -> list[Next]:
    """For each rival, the kind of run in which the two differ most per second: repeat it, or more of its kind."""
    if found.best is None:
        return []
    return [_telling(found.bench, found.best, rival) for rival in found.tried[1:4] if rival.names != found.best.names]


def _telling(desk: Bench, best: Hypothesis, rival: Hypothesis) -> Next:
    difference = best.fit.residual - rival.fit.residual
    rates = []
    for recording, rows in zip(desk.whiten.recordings, desk.whiten.rows, strict=True):
        seconds = len(recording.measured) / recording.rate_hz
        rates.append(float(np.linalg.norm(difference[rows])) / np.sqrt(seconds))
    most = int(np.argmax(rates))
    return Next(rival.names, desk.whiten.recordings[most].name, float(rates[most]))
