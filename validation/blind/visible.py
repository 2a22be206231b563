"""How much of a hidden effect the sensors can see, known before any verdict: simulated with and without it.

Everything in standard deviations of the noise, 1 to 200 Hz. `raw` is the rms of the difference over all rows. `left`
is what no retuning explains, dᵀ P d with P = I - N (NᵀN + I)⁻¹ Nᵀ, the columns of N the answers to one standard
deviation of each number of the machine file: twice the log-likelihood that the right name is worth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from validation.blind.printer.real import FloatArray, Reading
from validation.blind.sensors import Sensors

BAND_HZ = (1.0, 200.0)
LEAST_RAW, LEAST_LEFT = 0.1, 30.0
PROBE = 0.01


@dataclass(frozen=True)
class Visibility:
    """What can be seen of one hidden thing."""

    raw: float
    left: float
    rows: int

    @property
    def visible(self) -> bool:
        """A tenth of the noise, and worth more than the few numbers of a name cost (ln rows each, and ten)."""
        return self.raw >= LEAST_RAW and self.left >= LEAST_LEFT


def samples(sensors: Sensors, readings: Sequence[Reading]) -> list[int]:
    """Return how many samples the sensors take of each reading: of coarse steps perhaps one more."""
    return [min(len(values) for values in sensors.perfect(reading).values()) for reading in readings]


def whitened(
    sensors: Sensors, readings: Sequence[Reading], repeats: Sequence[int], counts: Sequence[int]
) -> FloatArray:
    """(rows,): real and imaginary parts of every channel and motion, in noises; repeats weigh by their root.

    Parameters
    ----------
    counts : samples of each reading that are taken, from its beginning.
    """
    parts = []
    for reading, count, length in zip(readings, repeats, counts, strict=True):
        for name, whole in sensors.perfect(reading).items():
            values = whole[:length]
            f = np.asarray(np.fft.rfftfreq(len(values), 1 / sensors.rate_hz), dtype=np.float64)
            inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
            scale = np.sqrt(2 * count / (len(values) * sensors.spectrum(name, f[inside])))
            spectrum = np.fft.rfft(values)[inside] * scale
            parts += [spectrum.real, spectrum.imag]
    return np.concatenate(parts)


def retuning(
    plain: Callable[[], list[Reading]],
    probed: Sequence[Callable[[], list[Reading]]],
    sensors: Sensors,
    repeats: Sequence[int],
    counts: Sequence[int],
    spreads: Sequence[float],
) -> FloatArray:
    """N : (rows, numbers), the answers of the plain printer to one standard deviation of each number."""
    base = whitened(sensors, plain(), repeats, counts)
    answers = [(whitened(sensors, each(), repeats, counts) - base) / PROBE for each in probed]
    return np.column_stack(answers) * spreads


def visibility(difference: FloatArray, n: FloatArray) -> Visibility:
    """Of a whitened difference : (rows,), given the answers to retuning : (rows, numbers)."""
    slope = n.T @ difference
    explained = slope @ np.linalg.solve(n.T @ n + np.eye(n.shape[1]), slope)
    rows = len(difference)
    return Visibility(float(np.sqrt(difference @ difference / rows)), float(difference @ difference - explained), rows)
