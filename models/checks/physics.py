"""Check a model's stability, reciprocity, passivity and load all over the bed.

- Stability: every vibration decays (poles in the left half-plane).
- Reciprocity: with the motors at rest, a force on one carriage moves another as much as vice versa, Y = Yᵀ,
  Y = Z⁻¹ of Eq. 29 (Rayleigh, The Theory of Sound, 1877, §§ 107-109).
- Passivity: no force at any frequency extracts more work from the machine than it supplies: the Hermitian part of the
  mobility jωY has no negative eigenvalue.
- Load: the load of a rigid effector on the carriages, Γ J, against virtual work's Jᵀ J.

A map by virtual work has all of these by construction. The paper's map (Eqs. 22-27) guarantees none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.kinds import delta_vibration
from models.machine import Machine

FREQUENCIES_HZ = np.geomspace(1.0, 300.0, 120)
ROUNDING = 1e-9  # relative to a norm: less than this is rounding


@dataclass(frozen=True)
class Extreme:
    """A largest or smallest value, with its position and frequency."""

    value: float
    x_mm: float
    y_mm: float
    frequency_hz: float | None = None  # None: independent of frequency


@dataclass(frozen=True)
class PhysicsChecks:
    """The worst values on the bed, relative to the 2-norm (dissipation, asymmetry) or the Frobenius norm (load)."""

    growth_per_s: Extreme  # largest real part of a pole: below zero, everything decays
    dissipation: (
        Extreme  # smallest eigenvalue of the Hermitian part of jωY, relative to jωY: below zero, energy is generated
    )
    asymmetry: Extreme  # largest skew part of Y, relative to Y
    load_asymmetry: Extreme  # largest skew part of Γ J, relative to Γ J
    least_load: Extreme  # of one carriage moving by itself: (Γ J)_ii / (Jᵀ J)_ii; 1 by virtual work
    most_load: Extreme

    @property
    def is_stable(self) -> bool:
        """Whether every vibration decays."""
        return self.growth_per_s.value < 0

    @property
    def is_passive(self) -> bool:
        """Whether the model generates no energy."""
        return self.dissipation.value > -ROUNDING

    @property
    def is_reciprocal(self) -> bool:
        """Whether Y = Yᵀ."""
        return self.asymmetry.value < ROUNDING


def check_physics(machine: Machine) -> PhysicsChecks:
    """Check the model on a polar grid over the bed."""
    xy, model = bed(machine), delta_vibration(machine)
    s = np.asarray(2j * np.pi * FREQUENCIES_HZ, dtype=np.complex128)
    y = np.stack([model.receptance(position, s) for position in xy])
    j = machine.kinematics.jacobian(xy)
    load = model.load_map(xy) @ j
    ratio = np.diagonal(load, axis1=1, axis2=2) / np.sum(j**2, axis=1)
    return PhysicsChecks(
        _largest(machine.vibration.poles(xy).real.max(axis=1), xy),
        _smallest(_dissipation(y), xy),
        _largest(_skew(y, 2), xy),
        _largest(_skew(load, "fro"), xy),
        _smallest(ratio.min(axis=1), xy),
        _largest(ratio.max(axis=1), xy),
    )


def unstable_positions(machine: Machine, radii: int = 6, directions: int = 24) -> FloatArray:
    """Find the positions, on a polar grid over the bed, at which a vibration of the model does not decay.

    Returns
    -------
    (k, 2) mm, columns X Y; empty for a stable machine.
    """
    xy = bed(machine, radii, directions)
    return xy[machine.vibration.poles(xy).real.max(axis=1) >= 0]


def bed(machine: Machine, radii: int = 6, directions: int = 24) -> FloatArray:
    """Return the centre and rings around it out to the print radius : (n, 2) mm, columns X Y."""
    return machine.kinematics.rings(radii - 1, directions)


def _dissipation(y: ComplexArray) -> FloatArray:
    """Return the smallest eigenvalue of the Hermitian part of jωY over its norm : (n, k) for y (n, k, 3, 3)."""
    mobility = 1j * y  # ω scales both alike
    hermitian = (mobility + mobility.conj().swapaxes(-1, -2)) / 2
    return np.asarray(np.linalg.eigvalsh(hermitian)[..., 0] / np.linalg.norm(mobility, 2, axis=(-2, -1)))


def _skew(a: FloatArray | ComplexArray, norm: Literal[2, "fro"]) -> FloatArray:
    """Return the norm of the skew part over the norm of the whole : (...,) for (..., 3, 3)."""
    skew = (a - a.swapaxes(-1, -2)) / 2
    return np.asarray(np.linalg.norm(skew, norm, axis=(-2, -1)) / np.linalg.norm(a, norm, axis=(-2, -1)))


def _smallest(values: FloatArray, xy: FloatArray) -> Extreme:
    """Find the smallest of values (n,), or (n, k) with frequencies."""
    at = np.unravel_index(int(np.argmin(values)), values.shape)
    x, y = (np.round(xy[at[0]], 3) + 0.0).tolist()  # + 0.0: no minus before a zero
    return Extreme(float(values[at]), x, y, float(FREQUENCIES_HZ[at[1]]) if values.ndim == 2 else None)


def _largest(values: FloatArray, xy: FloatArray) -> Extreme:
    found = _smallest(-values, xy)
    return Extreme(-found.value, found.x_mm, found.y_mm, found.frequency_hz)
