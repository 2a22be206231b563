"""Check a machine's model all over the bed.

- Stability: every vibration decays (poles in the left half-plane).
- Passivity: no force at any frequency extracts more work from the machine than it supplies: the Hermitian part of the
  mobility jωY has no negative eigenvalue, with Y = Z⁻¹ of Eq. 29.

A force map by virtual work has both by construction. The paper's map (Eqs. 22-27) guarantees neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.arrays import FloatArray
from models.kinds import delta_vibration
from models.machine import Machine

RADII, DIRECTIONS = 6, 24  # of the grid; the centre is the first radius
FREQUENCIES_HZ = np.geomspace(1.0, 300.0, 120)
ROUNDING_RTOL = 1e-9  # relative to a norm: less than this is rounding


@dataclass(frozen=True)
class Extreme:
    """A largest or smallest value, with its position and frequency."""

    value: float  # number [of the quantity]: the worst over the bed
    x_mm: float  # where
    y_mm: float  # where
    frequency_hz: float | None = None  # null if the quantity does not depend on frequency


@dataclass(frozen=True)
class PhysicsChecks:
    """The worst values on the bed."""

    growth_per_s: Extreme  # largest real part of a pole: below zero, everything decays
    # smallest eigenvalue of the Hermitian part of jωY, relative to its 2-norm; below zero: it has a source
    dissipation: Extreme

    @property
    def is_passive(self) -> bool:
        """Whether the model generates no energy."""
        return self.dissipation.value > -ROUNDING_RTOL


def check_physics(machine: Machine) -> PhysicsChecks:
    """Check the model on a polar grid over the bed."""
    xy, model = machine.kinematics.rings(RADII - 1, DIRECTIONS), delta_vibration(machine)
    s = np.asarray(2j * np.pi * FREQUENCIES_HZ, dtype=np.complex128)
    y = np.stack([model.receptance(position, s) for position in xy])
    growth = _smallest(-machine.vibration.poles(xy).real.max(axis=1), xy)
    mobility = 1j * y  # ω scales both alike
    hermitian = (mobility + mobility.conj().swapaxes(-1, -2)) / 2
    dissipated = np.linalg.eigvalsh(hermitian)[..., 0] / np.linalg.norm(mobility, 2, axis=(-2, -1))
    return PhysicsChecks(replace(growth, value=-growth.value), _smallest(np.asarray(dissipated), xy))


def unstable_positions(machine: Machine) -> FloatArray:
    """Find the positions (k, 2) mm, on a polar grid over the bed, with a vibration that does not decay.

    The pole at zero of a free axis does not count.
    """
    kinematics, everywhere = machine.kinematics, machine.vibration.position_dependent
    xy = kinematics.rings(RADII - 1, DIRECTIONS) if everywhere else np.array([*kinematics.sample_positions.values()])
    poles = machine.vibration.poles(xy)
    vibrates = np.abs(poles) > ROUNDING_RTOL * np.abs(poles).max(axis=1, keepdims=True)
    return xy[np.any(vibrates & (poles.real >= 0), axis=1)]


def _smallest(values: FloatArray, xy: FloatArray) -> Extreme:
    """Find the smallest of values (n,), or (n, k) with frequencies."""
    at = np.unravel_index(int(np.argmin(values)), values.shape)
    x, y = (np.round(xy[at[0]], 3) + 0.0).tolist()  # + 0.0: no minus before a zero
    return Extreme(float(values[at]), x, y, float(FREQUENCIES_HZ[at[1]]) if values.ndim == 2 else None)
