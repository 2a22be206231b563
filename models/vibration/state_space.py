"""State spaces of a machine's vibrations, continuous and discrete, of any number of states n.

States are physical coordinates, so that matrices of neighbouring positions can be interpolated. mm for lengths.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import factorial

import numpy as np

from models.arrays import FloatArray, IntArray


def _none() -> IntArray:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class StateSpace:
    """ẋ = A x + B_u u_d + B_s u̇_d + B_f (J̇ q̇) at g positions; actuators q = C x."""

    a: FloatArray  # (g, n, n)
    b_command: FloatArray  # (g, n, 3), of u_d, mm
    b_slope: FloatArray  # (g, n, 3), of u̇_d, mm/s
    b_centripetal: FloatArray  # (g, n, 3), of J̇ q̇, mm/s²
    carriage: FloatArray  # (3, n), C
    names: tuple[str, ...]  # (n,) of the states
    drive_states: int = 0  # number of leading states that are the drives': nothing acts back on them
    # (n/2,) axis of each pair of states (p, ṗ), of oscillators that are the same at every position
    oscillators: IntArray = field(default_factory=_none)

    def everywhere(self, positions: int) -> StateSpace:
        """Return the plant of one position at so many, without J̇ q̇."""
        a, command, slope = (np.tile(each, (positions, 1, 1)) for each in (self.a, self.b_command, self.b_slope))
        return replace(self, a=a, b_command=command, b_slope=slope, b_centripetal=np.zeros_like(command))


@dataclass(frozen=True, slots=True)
class DiscretePlant:
    """x⁺ = A x + B₀ u(t) + B₁ u(t+h) + B_f (J̇ q̇): exact for a command that is linear between t and t+h."""

    step_s: float
    a: FloatArray  # (g, n, n)
    b0: FloatArray  # (g, n, 3)
    b1: FloatArray  # (g, n, 3)
    b_centripetal: FloatArray  # (g, n, 3); the term is held over the step (give its mean)
    carriage: FloatArray  # (3, n), as in `StateSpace`
    drive_states: int = 0
    oscillators: IntArray = field(default_factory=_none)


TERMS = 12  # of the series: for a norm of one half the next term is below 1e-16


def discretise(plant: StateSpace, step_s: float) -> DiscretePlant:
    """First-order hold at all positions at once (Franklin, Powell & Workman, Digital Control, 6.3.2).

    With Z = A h, φ₀ = exp Z, φ₁ = ∫₀¹ exp(sZ) ds and φ₂ = ∫₀¹ (1 − s) exp(sZ) ds are A and the factors of what is held
    and of what rises over the step. φ₂ is a Taylor series of Z/2ᵏ, and φ₁ = 1 + Z φ₂, φ₀ = 1 + Z φ₁; doubling the step
    gives φ₂ ← (φ₁² + 2 φ₂)/4, φ₁ ← (φ₀ + 1) φ₁/2, φ₀ ← φ₀² (Hochbruck & Ostermann, Acta Numerica 19 (2010) 209-286).
    """
    eye = np.eye(plant.a.shape[1])
    largest = np.abs(plant.a).max(axis=0)
    rows, columns = largest.max(axis=1), largest.max(axis=0)
    ratio = np.divide(rows, columns, out=np.ones(len(eye)), where=(rows > 0.0) & (columns > 0.0))
    scale = 2.0 ** np.round(0.25 * np.log2(ratio))  # of positions against rates: the norm is small, no digit is lost
    z = plant.a * step_s * (scale / scale[:, None])
    doublings = max(int(np.ceil(np.log2(2.0 * np.abs(z).sum(axis=2).max(initial=0.5)))), 0)
    z *= 0.5**doublings
    phi2 = eye / factorial(TERMS + 1)
    for k in range(TERMS, 1, -1):
        phi2 = z @ phi2 + eye / factorial(k)
    phi1 = z @ phi2 + eye
    phi0 = z @ phi1 + eye
    for _ in range(doublings):
        phi2, phi1, phi0 = 0.25 * (phi1 @ phi1 + 2.0 * phi2), 0.5 * (phi0 @ phi1 + phi1), phi0 @ phi0
    phi0, phi1, phi2 = (phi * (scale[:, None] / scale) for phi in (phi0, phi1, phi2))
    ramp = step_s * phi2 @ plant.b_command + phi1 @ plant.b_slope
    inputs = step_s * phi1 @ plant.b_command - ramp, ramp, step_s * phi1 @ plant.b_centripetal
    return DiscretePlant(step_s, phi0, *inputs, plant.carriage, plant.drive_states, plant.oscillators)
