"""Tell from captures whether the firmware's input shaper was left on: the commonest mistake of a recording.

A shaper takes out of the command what would make the printer ring, so the capture lacks what the machine file expects
around the shaper's frequency. Every kind of shaper at every frequency is tried, on x and y each by itself, on all
captures together; sizes of the motion and of unknown effects stay free (`ffcomp.record.expected`). A machine that
follows its command late is no shaper: shapers are centred on their command, so a delay is allowed for beforehand, and
what it explains without a shaper is no sign of one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.record.clock import without_gaps
from ffcomp.record.expected import Expectation
from ffcomp.record.result import Joined
from ffcomp.shapers.kinds import SHAPERS, USUAL
from ffcomp.shapers.pulses import DAMPING_RATIO
from models.arrays import ComplexArray, FloatArray

BAND_HZ = (3.0, 80.0)
FREQUENCIES_HZ = np.geomspace(15.0, 130.0, 60)
NORMAL = np.arange(0.0, BAND_HZ[1] / FREQUENCIES_HZ[0] + 0.01, 0.01)  # frequencies, in those of the shaper
EXPLAINED = 0.35  # of the power may be left with the shaper
BETTER = 2.5  # times less than without it; files with dampings off by 4, belts by 20 % or 120 g gave 1.4 at most
SURELY_EXPLAINED, SURELY_BETTER = 0.05, 5.0  # the same, of the captures of one experiment
AS_GOOD = 1.5  # times as much left: kinds that smooth alike are told apart by nothing else
LEAST_WITHOUT = 0.03  # of the power: less may be anything
LATE_S = np.arange(-2.5e-3, 7.51e-3, 2.5e-4)  # by which all captures may be late, or their clocks be early
LATE_SHAPED_S = LATE_S[::5]  # those with which shapers are tried

_Spectra = tuple[FloatArray, ComplexArray, ComplexArray]  # frequencies, measured, expected columns


@dataclass(frozen=True)
class FoundShaper:
    """A shaper on one axis, and the shares of the power that are left unexplained."""

    axis: str
    kind: str
    frequency_hz: float
    left: float  # with the shaper
    left_without: float  # with a delay alone

    @property
    def words(self) -> str:
        """Say it in a sentence."""
        return (
            f"The firmware's input shaper was on: {self.axis} moved as {self.kind.upper()} at about "
            f"{self.frequency_hz:.0f} Hz makes it move ({self.left:.0%} of the power is unexplained, and "
            f"{self.left_without:.0%} without a shaper)."
        )


def find_shapers(recorded: Sequence[tuple[Joined, Expectation]]) -> list[FoundShaper]:
    """Return the shaper of each axis that has one without doubt: by all captures, or by those of one experiment.

    A shaper on one axis leaves so little of it in some motions that all there is came from the other axis.
    """
    experiments: dict[str, list[tuple[Joined, Expectation]]] = {}
    for each in recorded:
        experiments.setdefault(each[0].experiment, []).append(each)
    found = []
    for i, axis in enumerate("xy" if recorded else ""):
        shaper = _found(recorded, i, axis, EXPLAINED, BETTER)
        ones = (_found(own, i, axis, SURELY_EXPLAINED, SURELY_BETTER) for own in experiments.values())
        found += [shaper] if shaper else [one for one in ones if one][:1]
    return found


def _found(
    recorded: Sequence[tuple[Joined, Expectation]], i: int, axis: str, explained: float, better: float
) -> FoundShaper | None:
    """Return the likeliest shaper of an axis, if it leaves little enough of the power; None otherwise."""
    left, without = _unexplained(recorded, i)
    best = _likeliest(left)
    if left[best] > explained or without < max(better * left[best], LEAST_WITHOUT):
        return None
    kind, at = divmod(best, len(FREQUENCIES_HZ))
    return FoundShaper(axis, [*SHAPERS][kind], float(FREQUENCIES_HZ[at]), float(left[best]), without)


def _likeliest(left: FloatArray) -> int:
    """Choose the candidate that leaves least; one of the usual kinds where it leaves hardly more."""
    usual = np.repeat([kind in USUAL for kind in SHAPERS], len(FREQUENCIES_HZ))
    best, common = int(left.argmin()), int(np.where(usual, left, np.inf).argmin())
    return common if left[common] < AS_GOOD * left[best] + 0.01 else best


def _unexplained(recorded: Sequence[tuple[Joined, Expectation]], axis: int) -> tuple[FloatArray, float]:
    """Return the share of the power along an axis that is left by each candidate (c,), and by none."""
    spectra = [_spectra(joined, expected, axis) for joined, expected in recorded]
    without = _left(spectra, lambda frequency: _delays(frequency, LATE_S)).min()
    shaped = np.min([_left(spectra, partial(_responses, late_s=float(late))) for late in LATE_SHAPED_S], axis=0)
    return shaped, float(without)


def _left(spectra: Sequence[_Spectra], responses: Callable[[FloatArray], ComplexArray]) -> FloatArray:
    """Return the share of the power that each of c responses (c, k) at (k,) Hz leaves, (c,): sizes are free."""
    total, count, tried = 0.0, spectra[0][2].shape[1], len(responses(spectra[0][0]))
    normal, right = np.zeros((tried, count, count)), np.zeros((tried, count))
    for frequency, measured, columns in spectra:
        response = responses(frequency)
        total += float((np.abs(measured) ** 2).sum())
        square = np.einsum("ki,kj->kij", columns.conj(), columns).real
        normal = normal + np.tensordot(np.abs(response) ** 2, square, axes=1)
        right = right + (response.conj() @ (columns.conj() * measured[:, None])).real
    ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(count)
    gains = np.linalg.solve(normal + ridge, right[..., None])[..., 0]
    return np.asarray(1.0 - np.einsum("ci,ci->c", right, gains) / max(total, 1e-300))


def _delays(frequency_hz: FloatArray, late_s: FloatArray) -> ComplexArray:
    return np.asarray(np.exp(-2j * np.pi * np.outer(late_s, frequency_hz)))


def _spectra(joined: Joined, expected: Expectation, axis: int) -> _Spectra:
    """Return frequencies (k,) Hz, the measured spectrum (k,), and those of what is expected, (k, 1 + s)."""
    recording = joined.recording
    felt = without_gaps(recording.time_s, recording.acceleration[f"acc_{'xyz'[axis]}"][:, None])[:, 0]
    t = joined.begin_s + recording.time_s
    parts = np.stack([expected.acceleration[:, axis], *expected.signatures[:, :, axis]], axis=1)
    inside = (t >= expected.time_s[0]) & (t <= expected.time_s[-1])
    ready = CubicSpline(expected.time_s, parts)(np.clip(t, expected.time_s[0], expected.time_s[-1]))
    frequency = np.asarray(np.fft.rfftfreq(len(t), 1.0 / recording.sample_rate_hz), dtype=np.float64)
    band = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
    columns = np.fft.rfft(ready * inside[:, None], axis=0)[band]
    return frequency[band], np.fft.rfft(felt)[band], columns


def _responses(frequency_hz: FloatArray, late_s: float) -> ComplexArray:
    """Return the response of each candidate with a delay, (c, k)."""
    relative = frequency_hz / FREQUENCIES_HZ[:, None]
    rows = [np.interp(relative, NORMAL, _of_one_hertz(kind)) for kind in SHAPERS]
    return np.concatenate(rows) * _delays(frequency_hz, np.array([late_s]))


@cache
def _of_one_hertz(kind: str) -> ComplexArray:
    """Return the response of a shaper for 1 Hz at `NORMAL`."""
    shaper = SHAPERS[kind](1.0, DAMPING_RATIO)
    return np.asarray(np.exp(-2j * np.pi * np.outer(NORMAL, shaper.time)) @ shaper.amplitude)
