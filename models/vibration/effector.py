"""Sub-model 2: the force the effector's motion asks for, and how the three carriages share it.

Paper, Eqs. 14-27 and 50-62. Two ways to share it, `force_map` in the machine file:

- `virtual_work`: F_q = Jᵀ F. Six two-force rods carry exactly this, wherever the centre of mass is.
- `paper`: F_qi = J_iᵀ P_i F (Eq. 25), with the minimum-norm P_i of Eq. 22 and J_i the column of J that is
  carriage i's. For a centred mass that is a third of the virtual-work load. For checking the paper's figures.
"""

from __future__ import annotations

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.machine import DeltaKinematics, Effector, Machine


def effector_impedance(machine: Machine, s: ComplexArray) -> ComplexArray:
    """The diagonal of W(s) = M₁s² + Bs + K − (Bs+K)(M₂s²+Bs+K)⁻¹(Bs+K) (Eq. 61), for three uncoupled axes.

    Parameters
    ----------
    s : (k,) 1/s.

    Returns
    -------
    (k, 3) N/m, columns X Y Z: nozzle position to force.
    """
    return s[:, None] ** 2 * _apparent_mass(machine.effector, machine.nozzle_side_mass_kg, s)


def struck_frf(machine: Machine, s: ComplexArray, with_arms: bool = False) -> ComplexArray:
    """Force on the nozzle holder to its acceleration, the effector hanging free, per axis (Eq. 45).

    Parameters
    ----------
    s : (k,) 1/s.
    with_arms : the arms' lower halves ride along, and this is s²/W; else it is Eq. 45, the effector by itself.

    Returns
    -------
    (k, 3) 1/kg, columns X Y Z.
    """
    nozzle_side = machine.nozzle_side_mass_kg if with_arms else machine.effector.nozzle_mass_kg
    return 1 / _apparent_mass(machine.effector, nozzle_side, s)


def _apparent_mass(effector: Effector, nozzle_side_kg: float, s: ComplexArray) -> ComplexArray:
    """W(s)/s², (k, 3) kg: what the effector seems to weigh when it is shaken."""
    s = s[:, None]
    mount = effector.extruder_damping_n_s_per_m * s + effector.extruder_stiffness_n_per_m
    # Eq. 61 with its two mount terms joined: Bs + K − (Bs+K)²/(M₂s²+Bs+K) = M₂s² (Bs+K)/(M₂s²+Bs+K),
    # which keeps its digits where stiffness cancels stiffness, at low frequency.
    return nozzle_side_kg + effector.extruder_mass_kg * mount / (effector.extruder_mass_kg * s**2 + mount)


def load_map(machine: Machine, xy: FloatArray) -> FloatArray:
    """Γ, the share of each carriage: F_q = Γ W X, with Γ = Jᵀ or rows J_iᵀ P_i (Eq. 27).

    Parameters
    ----------
    xy : (n, 2) mm, columns X Y.

    Returns
    -------
    (n, 3, 3) N/N, rows carriages A B C, columns X Y Z of the force.
    """
    j = machine.kinematics.jacobian(xy)
    if machine.effector.force_map == "virtual_work":
        return j.transpose(0, 2, 1)
    return np.einsum("nai,iab->nib", j, load_distribution(machine.delta, machine.effector))


def load_distribution(geometry: DeltaKinematics, effector: Effector) -> FloatArray:
    """The matrices P_i: arm i's share of the force on the effector, minimum norm (Eqs. 19-23).

    Returns
    -------
    (3, 3, 3) N/N: arms A B C, rows X Y Z of the arm's force, columns X Y Z of the whole force.
    """
    angles = geometry.tower_angles_rad
    joints = effector.joint_radius_mm * np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=-1)
    moments = [_cross_matrix(r) for r in joints - effector.center_of_mass_mm]  # S(r_i), Eq. 20
    balance = np.block([[np.eye(3)] * 3, moments])  # L of Eq. 21
    return np.linalg.pinv(balance)[:, :3].reshape(3, 3, 3)


def _cross_matrix(r: FloatArray) -> FloatArray:
    """S(r), with S(r) f = r × f."""
    x, y, z = r
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
