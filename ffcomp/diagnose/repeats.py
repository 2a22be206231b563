"""What repeats of one experiment say of each other: how late one is against the other, and whether they repeat at all.

The noise floor is half of what repeats differ by. That is noise only if they were recorded on one clock, and if the
printer did the same twice: a repeat that lies a millisecond late, or a printer that warms up in between, differs by
far more than its sensors' noise. The rest before and after the motion tells how loud the sensors are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ffcomp.diagnose.noise import fill_gaps
from ffcomp.diagnose.problem import Observation
from ffcomp.numerics.delay import delayed, moved_columns
from models.arrays import ComplexArray, FloatArray

LAG_S = 1e-4  # by which repeats may lie apart before it is said, and their delays are fitted
MOST_LAG_S, LAG_STEP_S = 0.012, 2e-4  # that is looked for; of the first search
LAG_BAND_HZ, BAND_HZ = (2.0, 60.0), (2.0, 200.0)  # where lags are told best; where repeats are compared
CERTAIN = 5.0  # standard deviations of a lag
REST_S, SETTLED_S = 0.04, 0.15  # of rest that tells the sensors' noise; after a motion, until it has rung out
FIFTH = 0.2  # of the signals: repeats that differ by more do not repeat
LOUDER, NOTICED = 10.0, 0.03  # times the rest, and of the signals: what differs by more is no sensor's noise
UNEXPLAINED = 2.0  # times the rest, from which a large difference is not the sensors'


@dataclass(frozen=True)
class Repeats:
    """One experiment that was recorded several times."""

    experiment: str
    members: tuple[int, ...]  # indices of its observations
    files: tuple[str, ...]
    lag_s: tuple[float, ...]  # of each behind their mean
    certain: bool  # whether the lags are more than noise
    share: float  # rms by which one differs from their mean, of the signals, lags taken out
    over_rest: float | None  # the same as a multiple of the noise at rest; None: nothing rests long enough
    signals: tuple[str, ...] = ()  # that were compared, of one clock; none named: all

    @property
    def apart(self) -> bool:
        """Whether they lie so far apart in time that it matters."""
        return self.certain and max(self.lag_s) - min(self.lag_s) > LAG_S

    @property
    def differ(self) -> bool:
        """Whether they differ by more than any noise of sensors."""
        if self.over_rest is None:
            return self.share > FIFTH
        louder = self.over_rest > LOUDER and self.share > NOTICED
        return louder or (self.share > FIFTH and self.over_rest > UNEXPLAINED)

    def late(self) -> str:
        """Say how far apart they lie, in a sentence."""
        first, last = (self.files[int(f(self.lag_s))] for f in (np.argmin, np.argmax))
        apart = 1e3 * (max(self.lag_s) - min(self.lag_s))
        return f"{last} lies {apart:.2g} ms late against {first}, which repeats the same motion"

    def trouble(self) -> str:
        """Say that they do not repeat, and what to do, in full sentences."""
        rest = "" if self.over_rest is None else f", {self.over_rest:.0f} times what the sensors show at rest"
        return (
            f"{' and '.join(self.files[:2])} are named as repeats, but these repeats do not repeat: they differ by "
            f"{100 * self.share:.0f} % of the signals{rest}. The printer itself changed between them (it warmed up, "
            "something is loose, slips or rubs now and then), or they are not of the same motion. Move the printer "
            "for five minutes, record both again, and leave these files out."
        )


def repeats_of(observations: Sequence[Observation]) -> list[Repeats]:
    """Compare all experiments that were recorded more than once, in files of equal length, each clock by itself."""
    members: dict[tuple[str, int], list[int]] = {}
    for i, o in enumerate(observations):
        members.setdefault((o.repeat_of, len(o.measured)), []).append(i)
    several = [tuple(found) for found in members.values() if len(found) > 1]
    return [_compared(observations, found, own) for found in several for own in _of_clocks(observations, found)]


def _of_clocks(observations: Sequence[Observation], members: Sequence[int]) -> list[tuple[str, ...]]:
    """Return the signals that all have, by the clocks of the first."""
    first = observations[members[0]]
    shared = [[first.signals[k] for k in columns] for columns in first.by_clock.values()]
    common = [tuple(s for s in own if all(s in observations[i].signals for i in members)) for own in shared]
    return [own for own in common if own]


def aligned(observations: Sequence[Observation], found: Sequence[Repeats]) -> list[Observation]:
    """Move repeats that lie apart onto their mean, so that they differ by noise."""
    moved = list(observations)
    for repeats in found:
        if repeats.apart:
            for i, lag in zip(repeats.members, repeats.lag_s, strict=True):
                o = moved[i]
                own = [k for k, s in enumerate(o.signals) if s in repeats.signals or not repeats.signals]
                moved[i] = replace(o, measured=moved_columns(o.measured, own, -lag, o.rate_hz))
    return moved


def _compared(observations: Sequence[Observation], members: tuple[int, ...], common: tuple[str, ...]) -> Repeats:
    first = observations[members[0]]
    columns = [_columns(observations[i], common) for i in members]
    scale = np.maximum(np.std(columns[0], axis=0), 1e-12)
    spectra = [np.fft.rfft(x / scale, axis=0) for x in columns]
    lags, certain = _lags(spectra, first)
    together = [delayed(x, -lag, first.rate_hz) for x, lag in zip(columns, lags, strict=True)]
    known = np.all([np.isfinite(observations[i].measured).all(axis=1) for i in members], axis=0)
    together = [x * known[:, None] for x in together]  # what one of them lacks tells nothing
    differences = _in_band(np.stack(together) - np.mean(together, axis=0), first.rate_hz)
    differences *= np.sqrt(len(members) / (len(members) - 1))
    size = np.sqrt(np.mean(_in_band(np.stack(columns), first.rate_hz) ** 2))
    files = tuple(Path(observations[i].name).name for i in members)
    share = float(np.sqrt(np.mean(differences**2)) / max(size, 1e-12))
    over_rest = _over_rest(differences / scale, first)
    return Repeats(first.repeat_of, members, files, tuple(lags), certain, share, over_rest, common)


def _columns(observation: Observation, names: Sequence[str]) -> FloatArray:
    """Return some signals (n, m) without their means, gaps bridged."""
    x = observation.measured[:, [observation.signals.index(s) for s in names]]
    return np.column_stack([fill_gaps(column) for column in (x - np.nanmean(x, axis=0)).T])


def _lags(spectra: Sequence[ComplexArray], observation: Observation) -> tuple[list[float], bool]:
    """Return each repeat's lag behind the mean of all, s, and whether they are more than noise."""
    n = len(observation.measured)
    w: FloatArray = 2 * np.pi * np.asarray(np.fft.rfftfreq(n, 1 / observation.rate_hz), dtype=np.float64)
    keep = (w >= 2 * np.pi * LAG_BAND_HZ[0]) & (w <= 2 * np.pi * LAG_BAND_HZ[1])
    reference = spectra[0][keep]
    lags, sds = [0.0], [0.0]
    for other in spectra[1:]:
        lag, sd = _lag(reference, other[keep], w[keep])
        lags.append(lag)
        sds.append(sd)
    middle = float(np.mean(lags))
    certain = any(abs(lag) > CERTAIN * sd for lag, sd in zip(lags[1:], sds[1:], strict=True))
    return [lag - middle for lag in lags], certain


def _lag(reference: ComplexArray, other: ComplexArray, w: FloatArray) -> tuple[float, float]:
    """Return how much later `other` (k, m) is than the reference, and its standard deviation, s."""
    cross = np.sum(np.conj(other) * reference, axis=1)
    tries = np.arange(-MOST_LAG_S, MOST_LAG_S + LAG_STEP_S / 2, LAG_STEP_S)
    lag = float(tries[int(np.argmax([_alike(cross, w, x) for x in tries]))])
    for _ in range(4):  # Newton's steps to the top
        turned = cross * np.exp(-1j * w * lag)
        slope, curvature = float(np.sum(w * turned.imag)), -float(np.sum(w**2 * turned.real))
        if curvature >= 0:
            break
        lag -= float(np.clip(slope / curvature, -LAG_STEP_S, LAG_STEP_S))
    left = np.sum(np.abs(other * np.exp(1j * w * lag)[:, None] - reference) ** 2, axis=1)
    information = np.sum(w**2 * np.sum(np.abs(reference) ** 2, axis=1))
    return lag, float(np.sqrt(np.sum(w**2 * left) / 2) / max(information, 1e-300) * np.sqrt(w @ w))


def _alike(cross: ComplexArray, w: FloatArray, lag: float) -> float:
    return float(np.sum((cross * np.exp(-1j * w * lag)).real))


def _in_band(x: FloatArray, rate_hz: float) -> FloatArray:
    """Keep signals (…, n, m) within the band."""
    frequency = np.fft.rfftfreq(x.shape[-2], 1 / rate_hz)
    inside = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
    return np.asarray(np.fft.irfft(np.fft.rfft(x, axis=-2) * inside[:, None], x.shape[-2], axis=-2))


def _over_rest(differences: FloatArray, observation: Observation) -> float | None:
    """Return the size of the differences (r, n, m) in motion over that at rest; None where nothing rests."""
    moving = np.abs(observation.speed).max(axis=1) > 1e-3 * float(np.abs(observation.speed).max())
    if not moving.any():
        return None
    n, (first, last) = len(moving), np.flatnonzero(moving)[[0, -1]]
    edge = round(0.01 * observation.rate_hz)
    rests = np.zeros(n, dtype=bool)
    rests[edge : max(first - edge, edge)] = True
    rests[min(last + round(SETTLED_S * observation.rate_hz), n) : max(n - edge, 0)] = True
    if rests.sum() < REST_S * observation.rate_hz:
        return None
    loud, quiet = (np.sqrt(np.mean(differences[:, part] ** 2, axis=(0, 1))) for part in (moving, rests))
    return float(np.sqrt(np.mean(loud**2) / max(float(np.mean(quiet**2)), 1e-30)))
