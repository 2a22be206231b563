"""Does a model hold still, and does it keep the books of energy? Looked at all over the bed.

- Stability: every vibration decays (poles in the left half-plane).
- Reciprocity: with the motors held, a force on one carriage moves another as much as the other way round, Y = Yᵀ,
  Y = Z⁻¹ of Eq. 29 (Rayleigh, The Theory of Sound, 1877, §§ 107-109).
- Passivity: no force at any frequency gets more work out of the machine than it puts in: the Hermitian part of the
  mobility jωY has no negative eigenvalue.
- Load: what the carriages feel of a rigid effector, Γ J, against virtual work's Jᵀ J.

A map by virtual work has all of these by construction. The paper's map (Eqs. 22-27) has none for certain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.machine import Machine
from models.vibration.effector import load_map
from models.vibration.receptance import poles, receptance

FREQUENCIES_HZ = np.geomspace(1.0, 300.0, 120)
ROUNDING = 1e-9  # of a norm: less than this is not the model's doing


@dataclass(frozen=True)
class Extreme:
    """A largest or smallest value, and where it is."""

    value: float
    x_mm: float
    y_mm: float
    frequency_hz: float | None = None  # None: nothing depends on it


@dataclass(frozen=True)
class PhysicsChecks:
    """The worst of the whole bed; shares are of the 2-norm (dissipation, asymmetry) or Frobenius norm (load)."""

    growth_per_s: Extreme  # largest real part of a pole: below zero, everything decays
    dissipation: (
        Extreme  # smallest eigenvalue of the Hermitian part of jωY, as a share of jωY: below zero, energy is made
    )
    asymmetry: Extreme  # largest skew part of Y, as a share of Y
    load_asymmetry: Extreme  # largest skew part of Γ J, as a share of Γ J
    least_load: Extreme  # of one carriage moving by itself: (Γ J)_ii / (Jᵀ J)_ii; 1 by virtual work
    most_load: Extreme

    @property
    def is_stable(self) -> bool:
        return self.growth_per_s.value < 0

    @property
    def is_passive(self) -> bool:
        return self.dissipation.value > -ROUNDING

    @property
    def is_reciprocal(self) -> bool:
        return self.asymmetry.value < ROUNDING


def check_physics(machine: Machine) -> PhysicsChecks:
    """Look at the model on a polar grid over the bed."""
    xy = bed(machine)
    y = np.stack([receptance(machine, place, FREQUENCIES_HZ) for place in xy])
    j = machine.kinematics.jacobian(xy)
    load = load_map(machine, xy) @ j
    ratio = np.diagonal(load, axis1=1, axis2=2) / np.sum(j**2, axis=1)
    return PhysicsChecks(
        _largest(poles(machine, xy).real.max(axis=1), xy),
        _smallest(_dissipation(y), xy),
        _largest(_skew(y, 2), xy),
        _largest(_skew(load, "fro"), xy),
        _smallest(ratio.min(axis=1), xy),
        _largest(ratio.max(axis=1), xy),
    )


def unstable_positions(machine: Machine, radii: int = 6, directions: int = 24) -> FloatArray:
    """Where, on a polar grid over the bed, a vibration of the model grows (or never decays).

    Returns
    -------
    (k, 2) mm, columns X Y; empty for a sound machine.
    """
    xy = bed(machine, radii, directions)
    return xy[poles(machine, xy).real.max(axis=1) >= 0]


def bed(machine: Machine, radii: int = 6, directions: int = 24) -> FloatArray:
    """The centre and rings around it out to the print radius, (n, 2) mm, columns X Y."""
    return machine.kinematics.rings(radii - 1, directions)


def _dissipation(y: ComplexArray) -> FloatArray:
    """Smallest eigenvalue of the Hermitian part of jωY over its norm, (n, k) for y (n, k, 3, 3)."""
    mobility = 1j * y  # ω scales both alike
    hermitian = (mobility + mobility.conj().swapaxes(-1, -2)) / 2
    return np.asarray(np.linalg.eigvalsh(hermitian)[..., 0] / np.linalg.norm(mobility, 2, axis=(-2, -1)))


def _skew(a: FloatArray | ComplexArray, norm: Literal[2, "fro"]) -> FloatArray:
    """Norm of the skew part over norm of the whole, (...,) for (..., 3, 3)."""
    skew = (a - a.swapaxes(-1, -2)) / 2
    return np.asarray(np.linalg.norm(skew, norm, axis=(-2, -1)) / np.linalg.norm(a, norm, axis=(-2, -1)))


def _smallest(values: FloatArray, xy: FloatArray) -> Extreme:
    """Of values (n,) or (n, k) with frequencies."""
    at = np.unravel_index(int(np.argmin(values)), values.shape)
    x, y = (np.round(xy[at[0]], 3) + 0.0).tolist()  # + 0.0: no minus before a zero
    return Extreme(float(values[at]), x, y, float(FREQUENCIES_HZ[at[1]]) if values.ndim == 2 else None)


def _largest(values: FloatArray, xy: FloatArray) -> Extreme:
    found = _smallest(-values, xy)
    return Extreme(-found.value, found.x_mm, found.y_mm, found.frequency_hz)
