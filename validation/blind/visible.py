"""How much of a hidden effect the sensors can see, known before any verdict: simulated with and without it.

Everything in standard deviations of the noise, 1 to 200 Hz. `raw` is the rms of the difference over all rows. `left`
is what no retuning explains, dᵀ P d with P = I - N (NᵀN + I)⁻¹ Nᵀ, the columns of N the answers to one standard
deviation of each number of the machine file, and of each motion's delay where its clock is in doubt: twice the
log-likelihood that the right name is worth. Where numbers that are off by more than a little do better than N
foretells, what they leave counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from validation.blind.real import FloatArray, Reading
from validation.blind.sensors import Sensors

BAND_HZ = (1.0, 200.0)
LEAST_RAW, LEAST_LEFT = 0.1, 30.0
PROBE = 0.01
MOST_REFITS = 12  # steps; after half of them, half of what is left must be gone


@dataclass(frozen=True)
class Visibility:
    """How visible one hidden thing is."""

    raw: float
    left: float
    rows: int

    @property
    def visible(self) -> bool:
        """A tenth of the noise, and worth more than the few numbers of a name cost (ln rows each, and ten)."""
        return self.raw >= LEAST_RAW and self.left >= LEAST_LEFT


def whitened(sensors: Sensors, readings: Sequence[Reading], repeats: Sequence[int]) -> FloatArray:
    """(rows,): real and imaginary parts of every channel and motion, in noises; repeats weigh by their root."""
    parts = []
    for reading, count in zip(readings, repeats, strict=True):
        for name, values in sensors.perfect(reading).items():
            f = np.asarray(np.fft.rfftfreq(len(values), 1 / sensors.rate_hz), dtype=np.float64)
            inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
            scale = np.sqrt(2 * count / (len(values) * sensors.spectrum(name, f[inside])))
            spectrum = np.fft.rfft(values)[inside] * scale
            parts += [spectrum.real, spectrum.imag]
    return np.concatenate(parts)


def visibility(difference: FloatArray, n: FloatArray) -> Visibility:
    """Of a whitened difference : (rows,), given the answers to retuning : (rows, numbers)."""
    explained = difference @ n @ refitted(difference, n)
    rows = len(difference)
    return Visibility(float(np.sqrt(difference @ difference / rows)), float(difference @ difference - explained), rows)


def refitted(difference: FloatArray, n: FloatArray) -> FloatArray:
    """(numbers,): the numbers of the file that explain a difference best, in standard deviations."""
    return np.asarray(np.linalg.solve(n.T @ n + np.eye(n.shape[1]), n.T @ difference))


def visibility_by_refit(
    true: FloatArray, without: FloatArray, n: FloatArray, moved: Callable[[FloatArray], FloatArray]
) -> Visibility:
    """Of what differs from `without`, refitted step by step: the answer to a large change is no line.

    Its slope is brought up to date by what each step showed (Broyden, Mathematics of Computation 19, 1965).

    Parameters
    ----------
    moved : the whitened data where the numbers, and the delays, are off by so many standard deviations, (numbers,).
    """
    first = found = visibility(true - without, n)
    z, base = np.zeros(n.shape[1]), without
    for k in range(MOST_REFITS):
        if not found.visible or (k == MOST_REFITS // 2 and found.left > first.left / 2):
            break
        step = refitted(true - base + n @ z, n) - z
        z, there = z + step, moved(z + step)
        n = n + np.outer(there - base - n @ step, step) / (step @ step)
        base = there
        left = float((true - base) @ (true - base) + z @ z)
        found = replace(found, left=min(found.left, left))
    return found
