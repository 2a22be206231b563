"""A measured frequency response with its variance.

Signals are named as the columns of a recording, without the unit: `cmd_A` `cmd_x` (commanded position), `pos_A` `pos_x`
(position), `acc_A` `acc_x` (acceleration), `force_x` (a hammer on the effector). Values are SI: position to
position is dimensionless, position to acceleration 1/s², force to acceleration 1/kg.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray

# The measured setup: the carriage alone on its belt (with the arms' upper halves, Eq. 30), the same with a known
# mass added, the effector alone, taken off its arms, or the whole printer.
Setup = Literal["carriage", "carriage+mass", "effector", "assembly"]


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """The response of `output` to `input`."""

    input: str
    output: str
    frequency_hz: FloatArray  # (k,) Hz, rising, above zero
    value: ComplexArray  # (k,) SI
    variance: FloatArray  # (k,) of the complex value, E|δ|², SI²; half of it in each of real and imaginary part
    setup: Setup = "assembly"
    position_mm: tuple[float, float, float] | None = None  # of the nozzle; None where nothing depends on it
    added_mass_kg: float = 0.0  # on the carriage
    coherence: FloatArray | None = None  # (k,) if it was measured
    source: str = ""  # file name
    clock: str = ""  # responses with the same clock share one unknown delay; empty: measured with the command's own

    @property
    def s(self) -> ComplexArray:
        """(k,) jω, 1/s."""
        return np.asarray(2j * np.pi * self.frequency_hz, dtype=np.complex128)

    def between(self, lowest_hz: float, highest_hz: float) -> FrequencyResponse:
        """Restrict to a band, both ends included."""
        keep = (self.frequency_hz >= lowest_hz) & (self.frequency_hz <= highest_hz)
        return replace(
            self,
            frequency_hz=self.frequency_hz[keep],
            value=self.value[keep],
            variance=self.variance[keep],
            coherence=None if self.coherence is None else self.coherence[keep],
        )


def variance_from_coherence(value: ComplexArray, coherence: FloatArray, averages: float) -> FloatArray:
    """Compute E|δH|² = |H|² (1 − γ²)/(γ² n) of an H1 estimate from n independent averages (Bendat & Piersol, 2010).

    Parameters
    ----------
    value : (k,) complex.
    coherence : (k,) γ², between 0 and 1.

    Returns
    -------
    (k,)
    """
    gamma2 = np.clip(coherence, 1e-12, 1.0)
    return np.asarray(np.abs(value) ** 2 * (1 - gamma2) / (gamma2 * averages))
