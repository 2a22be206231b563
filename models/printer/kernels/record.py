"""The array of the kernels: its rows, and the record of one printer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from models.arrays import FloatArray

LANES = 8  # numbers in a vector of 512 bits

# Every row is a numpy integer: a Python one is part of a type to numba, and each would be compiled for by itself.
# Parts of a state, three numbers each: drive, carriages, extruder against nozzle, frame (its last two idle),
# strain of the guides' and of the joints' dry friction.
V, VD, Q, QD, ETA, ETAD, D, DD, GUIDE, JOINT = np.arange(0, 30, 3)
STATES = 30

# The numbers of one printer.
PARAMETERS = np.dtype(
    [
        ("towers", "f8", (3, 2)),  # m, DeltaKinematics.towers_mm
        ("arms_squared", "f8", 3),  # m²
        ("height", "f8"),  # m, joint plane above the nozzle tip
        ("to_plane", "f8", (2, 2)),  # 1/m, inverse of the joints B and C seen from A
        ("offset", "f8", 2),  # m², what is constant in the spheres' differences
        ("first_share", "f8", 3),  # σ₁ of straight axes, `models/vibration/modal.py`
        ("carriage_mass", "f8", 3),  # kg, m = m_c + m_f/2
        ("weight", "f8", 3),  # N, m g
        ("belt_k", "f8", 3),  # N/m
        ("belt_c", "f8", 3),  # N s/m
        ("guide_b", "f8", 3),  # N s/m
        ("ideal_drive", "f8", 3),  # 1: u = u_d
        ("d0", "f8", 3),  # 1/s²
        ("lead", "f8", 3),  # s, d1/d0
        ("d2", "f8", 3),  # 1/s
        ("shares", "f8", (3, 3, 3)),  # P_i of Eq. 25: arm, component of its force, component of the whole force
        ("holder_mass", "f8"),  # kg, M₁ = m_1 + 3 m_f/2
        ("extruder_mass", "f8"),  # kg, m_2
        ("mount_k", "f8", 3),  # N/m
        ("mount_b", "f8", 3),  # N s/m
        ("gravity", "f8"),  # m/s²
        # effects; zero, or what does nothing, where absent
        ("cubic", "f8", 3),  # N/m³, belt_hardening
        ("quintic", "f8", 3),  # N/m⁵
        # m, stretch at which a softening belt pulls its most, k + 3 k₃ s² + 5 k₅ s⁴ = 0: beyond, no more, no less
        ("give", "f8", 3),
        ("slope", "f8", 3),  # 1/m, belt_position_stiffness
        ("centre", "f8", 3),  # m
        ("half_backlash", "f8", 3),  # m, belt_backlash
        ("landing", "f8", 3),  # s/m, of its flanks
        ("bend", "f8", 3),  # 1/m, 1/a of torque_angle
        ("delay", "f8", 3),  # s, command_delay
        ("ripple", "f8", 3),  # m, cogging
        ("wave", "f8", 3),  # rad/m
        ("ahead", "f8", 3),  # rad, of the ripple
        ("second_sine", "f8", 3),  # of twice the wave, shares of the ripple
        ("second_cosine", "f8", 3),
        ("dry", "f8", 3),  # N, coulomb_friction and stribeck_friction
        ("sticking", "f8", 3),  # N, surplus at rest
        ("fading", "f8", 3),  # s/m, 1/v_s
        ("fading_power", "f8", 3),  # δ/2
        ("creep", "f8", 3),  # m/s, v₀ of the guides: wider where the run's step is too long for it
        ("hold", "f8", 3),  # 1/s, κ of the guides
        ("joint_dry", "f8"),  # N, joint_friction
        ("joint_creep", "f8"),  # m/s
        ("joint_hold", "f8"),  # 1/s
        ("least_inertia", "f8"),  # kg, that a force on one carriage moves, anywhere
        ("sway", "f8", (2, 2)),  # unit vectors along x and y, rows; frame_mode
        ("sway_share", "f8"),  # μ = M₁/(M_f + M₁)
        ("sway_k", "f8"),  # 1/s², ω²
        ("sway_b", "f8"),  # 1/s, 2 ζ ω
    ]
)
PrinterParameters: TypeAlias = np.record
COUNT = PARAMETERS.itemsize // 8

# The rows of m. Four states: at the step's beginning, where the rate is asked for, the rate, the sum of a step's rates.
BASE, NOW, RATE, SUM = np.arange(0, 4 * STATES, STATES)
# What the motors are told: time since each tower's cubic began, the cubics, highest power first, and their values.
TIME, CUBIC, TOLD, TOLD_RATE, RIPPLE, RIPPLE_RATE = np.array([120, 123, 135, 138, 141, 144])
# What one evaluation hands from loop to loop, A B C: m, m/s; a belt's stretch, m, and what of it pulls; ℓ, N; N; w.
MOTOR, MOTOR_RATE, STRETCH, SPRING, LEVEL, GUIDES, PULL, BENDING = np.arange(147, 171, 3)
# X Y Z: m, m/s; against the ground, m/s²; N; f₀, N. ρ of the frame's two directions, m/s². J, column by column.
X, XD, ACC, JOINTS, F0, RHO, J = np.arange(171, 192, 3)
# The printer's numbers, as `PARAMETERS` has them.
PRINTER = 198
ROWS = PRINTER + COUNT


def parameter_rows(*names: str) -> list[np.int64]:
    fields: Mapping[str, Any] = PARAMETERS.fields or {}
    return [np.int64(PRINTER + fields[name][1] // 8) for name in names]


Vector: TypeAlias = tuple[float, float, float]
Row: TypeAlias = int | np.signedinteger
Rows: TypeAlias = NDArray[np.int64]


def table(printers: Sequence[PrinterParameters]) -> FloatArray:
    """(k, COUNT): a printer a row."""
    return np.array(printers, PARAMETERS).view(np.float64).reshape(len(printers), COUNT)


class Acting(NamedTuple):
    """What any lane has; where none has it, a loop is left out."""

    sticking: bool
    guides: bool
    joints: bool
    bending: bool
    ripple: bool
    delay: bool
    arms: bool
