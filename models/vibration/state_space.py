"""The position-scheduled plant: commanded carriage heights in, carriage heights and nozzle out.

State of 18, in physical coordinates so that matrices of neighbouring places can be interpolated, three entries each
(carriages A B C, or nozzle axes X Y Z):

    [ w, ẇ, q, q̇, η, η̇ ]

    w   drive filter:            ẅ = u_d − d₂ ẇ − d₀ w,   u = d₀ w + d₁ ẇ                     (Eq. 34)
    q   carriages:               m q̈ = k (u − q) + c (u̇ − q̇) − b q̇ − F_q                      (Eqs. 32, 44)
    η   extruder against nozzle: η̈ = −Ẍ − (B η̇ + K η)/m₂                                      (Eqs. 53-55, η = X₂ − X)
    load of the effector:        F_q = Γ (m₁ Ẍ − B η̇ − K η),   Ẍ = J q̈ + J̇ q̇                   (Eqs. 25, 50-52)

Γ = Jᵀ by virtual work, or the rows J_iᵀ P_i of Eq. 25. The centripetal term J̇ q̇ of the planned motion is a known
input. Only accelerations and relative displacements of the effector enter, so the model holds for large motion.

mm for lengths; stiffness N/m over mass kg is 1/s² all the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.arrays import FloatArray
from models.machine import Machine
from models.vibration.effector import load_map
from models.vibration.modal import oscillators

STATES = 18
W, WD, Q, QD, ETA, ETAD = (slice(3 * i, 3 * i + 3) for i in range(6))


@dataclass(frozen=True, slots=True)
class ContinuousPlant:
    """ẋ = A x + B_u u_d + B_s u̇_d + B_f (J̇ q̇) at g places."""

    a: FloatArray  # (g, 18, 18)
    b_command: FloatArray  # (g, 18, 3), of u_d, mm
    b_slope: FloatArray  # (g, 18, 3), of u̇_d, mm/s (only without a drive filter)
    b_centripetal: FloatArray  # (g, 18, 3), of J̇ q̇, mm/s²


def continuous_plant(machine: Machine, xy: FloatArray) -> ContinuousPlant:
    """The plant frozen at each of the places `xy`.

    Parameters
    ----------
    xy : (g, 2) mm, columns X Y. (Nothing depends on z: J does not.)
    """
    if machine.has_straight_axes:
        return _with_drive(machine, _straight(machine, len(xy)))
    j = machine.kinematics.jacobian(xy)
    gamma = load_map(machine, xy)
    return _with_drive(machine, _mechanics(machine, j, gamma))


def _straight(machine: Machine, g: int) -> ContinuousPlant:
    """Axes with modes of their own (`models/vibration/modal.py`), the same at all of g places."""
    (first, second), share = oscillators(machine)  # of q, q̇, η, η̇, u, u̇
    axes = np.arange(3)
    a, b_command, b_slope = np.zeros((STATES, STATES)), np.zeros((STATES, 3)), np.zeros((STATES, 3))
    a[axes + Q.start, axes + QD.start] = a[axes + ETA.start, axes + ETAD.start] = 1.0
    rows = ((QD.start, first + second), (ETAD.start, share[:, None] * second - (1.0 - share)[:, None] * first))
    for begin, row in rows:
        for states, column in zip((Q, QD, ETA, ETAD), range(4), strict=True):
            a[begin + axes, states.start + axes] = row[:, column]
        b_command[begin + axes, axes], b_slope[begin + axes, axes] = row[:, 4], row[:, 5]
    return ContinuousPlant(*(np.tile(each, (g, 1, 1)) for each in (a, b_command, b_slope, np.zeros((STATES, 3)))))


def _mechanics(machine: Machine, j: FloatArray, gamma: FloatArray) -> ContinuousPlant:
    """Carriages and effector driven by the belt's motor end u: columns of u and u̇ stand in for the command."""
    g = len(j)
    carriage, effector = machine.carriage, machine.effector
    eye = np.eye(3)
    m1, m2 = machine.nozzle_side_mass_kg, effector.extruder_mass_kg
    k, c, b = (
        carriage.belt_stiffness_n_per_m,
        carriage.belt_damping_n_s_per_m,
        carriage.guide_damping_n_s_per_m,
    )
    spring = np.diag(effector.extruder_stiffness_n_per_m)
    damper = np.diag(effector.extruder_damping_n_s_per_m)

    inverse_mass = np.linalg.inv(carriage.moving_mass_kg * eye + m1 * gamma @ j)
    qdd = np.zeros((g, 3, STATES))  # q̈ as a row of the state
    qdd[:, :, Q] = -k * inverse_mass
    qdd[:, :, QD] = -(c + b) * inverse_mass
    qdd[:, :, ETA] = inverse_mass @ gamma @ spring
    qdd[:, :, ETAD] = inverse_mass @ gamma @ damper
    qdd_u, qdd_slope, qdd_f = k * inverse_mass, c * inverse_mass, -m1 * inverse_mass @ gamma

    a = np.zeros((g, STATES, STATES))
    a[:, Q, QD] = a[:, ETA, ETAD] = eye
    a[:, QD, :] = qdd
    a[:, ETAD, :] = -j @ qdd
    a[:, ETAD, ETA] -= spring / m2
    a[:, ETAD, ETAD] -= damper / m2

    def driven(rows: NDArray[np.floating], direct: FloatArray | float = 0.0) -> FloatArray:
        columns = np.zeros((g, STATES, 3))
        columns[:, QD] = rows
        columns[:, ETAD] = -(j @ rows) - direct
        return columns

    return ContinuousPlant(a, driven(qdd_u), driven(qdd_slope), driven(qdd_f, eye))


def _with_drive(machine: Machine, ideal: ContinuousPlant) -> ContinuousPlant:
    """Put the drive filter between the command and the belt: u = d₀ w + d₁ ẇ, u̇ = d₀ ẇ + d₁ (u_d − d₂ ẇ − d₀ w)."""
    a = ideal.a.copy()
    eye = np.eye(3)
    a[:, W, WD] = eye
    drive = machine.carriage.drive
    if drive is None:  # an ideal drive: the filter's states idle, decoupled and stable
        a[:, WD, W], a[:, WD, WD] = -eye * 1e4, -eye * 200.0
        return ContinuousPlant(a, ideal.b_command, ideal.b_slope, ideal.b_centripetal)
    d0, d1, d2 = drive.d0_per_s2, drive.d1_per_s, drive.d2_per_s
    u, slope = ideal.b_command, ideal.b_slope
    a[:, WD, W], a[:, WD, WD] = -d0 * eye, -d2 * eye
    a[:, :, W] += d0 * u - d1 * d0 * slope
    a[:, :, WD] += d1 * u + (d0 - d1 * d2) * slope
    b_command = d1 * slope
    b_command[:, WD] += eye
    return ContinuousPlant(a, b_command, np.zeros_like(slope), ideal.b_centripetal)


@dataclass(frozen=True, slots=True)
class DiscretePlant:
    """x⁺ = A x + B₀ u(t) + B₁ u(t+h) + B_f (J̇ q̇): exact for a command that is linear between t and t+h."""

    step_s: float
    a: FloatArray  # (g, 18, 18)
    b0: FloatArray  # (g, 18, 3)
    b1: FloatArray  # (g, 18, 3)
    b_centripetal: FloatArray  # (g, 18, 3); the term is held over the step (give its mean)


def discretise(plant: ContinuousPlant, step_s: float) -> DiscretePlant:
    """First-order hold by one matrix exponential a place (Franklin, Powell & Workman, Digital Control, 1998, 6.3.2)."""
    from scipy.linalg import expm  # 0.3 s to import: only when a plant is really built

    g = len(plant.a)
    n = STATES
    block = np.zeros((g, n + 9, n + 9))
    block[:, :n, :n] = plant.a
    block[:, :n, n : n + 3] = plant.b_command
    block[:, :n, n + 3 : n + 6] = plant.b_slope / step_s  # unit of the third block: u(t+h) − u(t)
    block[:, :n, n + 6 :] = plant.b_centripetal
    block[:, n : n + 3, n + 3 : n + 6] = np.eye(3) / step_s
    e = expm(block * step_s)
    held, ramp = e[:, :n, n : n + 3], e[:, :n, n + 3 : n + 6]
    return DiscretePlant(step_s, e[:, :n, :n].copy(), held - ramp, ramp.copy(), e[:, :n, n + 6 :].copy())


@dataclass(frozen=True, slots=True)
class PlantTable:
    """Discrete plants on a square grid over the bed; everything between is interpolated bilinearly."""

    x0_mm: float  # the grid's first node, both axes
    pitch_mm: float
    nodes: int  # per axis; node (ix, iy) is place ix * nodes + iy
    plant: DiscretePlant
    jacobian: FloatArray  # (nodes², 3, 3)

    def frozen(self) -> PlantTable:
        """As if the plant were everywhere what it is in the middle of the bed; the kinematics stay what they are."""
        middle = len(self.jacobian) // 2
        values = {each.name: getattr(self.plant, each.name) for each in fields(self.plant)}
        same: dict[str, Any] = {
            name: np.repeat(value[middle : middle + 1], len(value), axis=0)
            for name, value in values.items()
            if np.ndim(value)
        }
        return replace(self, plant=replace(self.plant, **same))

    def arrays(self) -> dict[str, FloatArray]:
        """All of it, to be kept."""
        p = self.plant
        grid = np.array([self.x0_mm, self.pitch_mm, self.nodes, p.step_s])
        return dict(zip(TABLE_ARRAYS, (grid, p.a, p.b0, p.b1, p.b_centripetal, self.jacobian), strict=True))

    @classmethod
    def of_arrays(cls, kept: Mapping[str, FloatArray]) -> PlantTable:
        grid, *plant, jacobian = (kept[name] for name in TABLE_ARRAYS)
        x0, pitch, nodes, step_s = grid.tolist()
        return cls(x0, pitch, int(nodes), DiscretePlant(step_s, *plant), jacobian)


TABLE_ARRAYS = ("grid", "a", "b0", "b1", "b_centripetal", "jacobian")


def plant_table(machine: Machine, step_s: float, pitch_mm: float = 10.0) -> PlantTable:
    """The plant over the whole bed, once per machine. Nodes outside the print radius repeat the rim's plant."""
    reach = machine.kinematics.model_reach_mm
    half = int(np.ceil(reach / pitch_mm)) + 1
    axis = pitch_mm * np.arange(-half, half + 1)
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    radius = np.hypot(*xy.T)
    rim = reach + min(pitch_mm, 0.9 * machine.kinematics.spare_reach_mm)
    xy = xy * np.minimum(1.0, rim / np.maximum(radius, 1e-9))[:, None]
    plant = discretise(continuous_plant(machine, xy), step_s)
    return PlantTable(float(axis[0]), pitch_mm, len(axis), plant, machine.kinematics.jacobian(xy))
