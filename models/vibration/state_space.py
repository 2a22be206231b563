"""State spaces of a machine's vibrations, continuous and discrete, of any number of states n.

States are physical coordinates, so that matrices of neighbouring positions can be interpolated. mm for lengths.
"""

from __future__ import annotations

from dataclasses import dataclass, field

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
    oscillators: IntArray = field(
        default_factory=_none
    )  # (n/2,) axis of each pair of states (p, ṗ), of oscillators that are the same at every position


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


def discretise(plant: StateSpace, step_s: float) -> DiscretePlant:
    """First-order hold by one matrix exponential a position (Franklin, Powell & Workman, Digital Control, 6.3.2)."""
    from scipy.linalg import expm  # 0.3 s to import

    g, n = plant.a.shape[:2]
    block = np.zeros((g, n + 9, n + 9))
    block[:, :n, :n] = plant.a
    block[:, :n, n : n + 3] = plant.b_command
    block[:, :n, n + 3 : n + 6] = plant.b_slope / step_s  # unit of the third block: u(t+h) − u(t)
    block[:, :n, n + 6 :] = plant.b_centripetal
    block[:, n : n + 3, n + 3 : n + 6] = np.eye(3) / step_s
    e = expm(block * step_s)
    held, ramp = e[:, :n, n : n + 3], e[:, :n, n + 3 : n + 6]
    return DiscretePlant(
        step_s,
        e[:, :n, :n].copy(),
        held - ramp,
        ramp.copy(),
        e[:, :n, n + 6 :].copy(),
        plant.carriage,
        plant.drive_states,
        plant.oscillators,
    )
