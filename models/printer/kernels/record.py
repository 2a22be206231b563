"""Lay out the parameters of a printer and the rows of the kernels' array."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from models.arrays import FloatArray

LANES = 8  # doubles in a vector of 512 bits

# Rows, and whatever else is an argument, are of numpy: numba makes a Python constant part of a type, and would compile
# for each of them.
ZERO, ONE, TWO, THREE = np.arange(4)
YES, NO = cast("tuple[bool, bool]", (np.True_, np.False_))
# Parts of a state, three rows each: drive, carriages, extruder relative to nozzle, frame (its last row is idle),
# strain of the guides' and of the joints' dry friction.
V, VD, Q, QD, ETA, ETAD, D, DD, GUIDE, JOINT = np.arange(0, 30, 3)
STATES = 30

# The parameters of one printer.
PARAMETERS = np.dtype(
    [
        ("towers", "f8", (3, 2)),  # m, DeltaKinematics.towers_mm
        ("arms_squared", "f8", 3),  # m²
        ("height", "f8"),  # m, joint plane above the nozzle tip
        ("to_plane", "f8", (2, 2)),  # 1/m, inverse of the joints B and C seen from A
        ("offset", "f8", 2),  # m², constant part of the differences of the arms' spheres
        # of cartesian and CoreXY axes, see `axes.py`: T, motors from axes; T⁻¹; N/m, of each motor's belt
        ("motor_matrix", "f8", (3, 3)),
        ("axis_matrix", "f8", (3, 3)),
        ("motor_k", "f8", 3),
        ("carriage_mass", "f8", 3),  # kg, m = m_c + m_f/2; of straight axes all that moves
        ("weight", "f8", 3),  # N, m g
        ("belt_k", "f8", 3),  # N/m
        ("belt_c", "f8", 3),  # N s/m
        ("guide_b", "f8", 3),  # N s/m
        ("ideal_drive", "f8", 3),  # 1: u = u_d
        ("d0", "f8", 3),  # 1/s²
        ("lead", "f8", 3),  # s, d1/d0
        ("d2", "f8", 3),  # 1/s
        ("shares", "f8", (3, 3, 3)),  # P_i of Eq. 25: arm, component of its force, component of the total force
        ("holder_mass", "f8"),  # kg, M₁ = m_1 + 3 m_f/2
        ("arm_inertia", "f8"),  # kg, ν of each arm pair
        ("extruder_mass", "f8"),  # kg, m_2
        ("mount_k", "f8", 3),  # N/m
        ("mount_b", "f8", 3),  # N s/m
        ("gravity", "f8"),  # m/s²
        # effects; zero or neutral where absent
        ("cubic", "f8", 3),  # N/m³, belt_hardening
        ("quintic", "f8", 3),  # N/m⁵
        # m, peak-force stretch of a softening belt, k + 3 k₃ s² + 5 k₅ s⁴ = 0; beyond it the force is constant
        ("peak_stretch", "f8", 3),
        ("slope", "f8", 3),  # 1/m, belt_position_stiffness
        ("centre", "f8", 3),  # m
        ("half_backlash", "f8", 3),  # m, belt_backlash
        ("landing", "f8", 3),  # s/m, damping of its flanks
        ("inverse_amplitude", "f8", 3),  # 1/m, 1/a of torque_angle
        ("belt_share", "f8", 3),  # b of torque_angle
        ("delay", "f8", 3),  # s, command_delay
        ("ripple", "f8", 3),  # m, cogging
        ("wave", "f8", 3),  # rad/m
        ("phase", "f8", 3),  # rad, of the ripple
        ("second_sine", "f8", 3),  # of the second harmonic, relative to the ripple
        ("second_cosine", "f8", 3),
        ("dry", "f8", 3),  # N, coulomb_friction and stribeck_friction
        ("sticking", "f8", 3),  # N, additional friction at rest
        ("fading", "f8", 3),  # s/m, 1/v_s
        ("fading_power", "f8", 3),  # δ/2
        ("creep", "f8", 3),  # m/s, v₀ of the guides; larger where the integration step requires it
        ("hold", "f8", 3),  # 1/s, κ of the guides
        ("bristles", "f8", 3),  # 1/m, 1/s₀ of guides whose friction bends bristles; 0: it creeps and holds instead
        ("bending", "f8", 3),  # 1/s, largest |q̇|/s₀ that the integration step can follow
        ("joint_dry", "f8"),  # N, joint_friction
        ("joint_creep", "f8"),  # m/s
        ("joint_hold", "f8"),  # 1/s
        ("least_inertia", "f8"),  # kg, smallest effective inertia of the carriages over the bed
        ("frame_directions", "f8", (2, 2)),  # unit vectors along x and y, rows; frame_mode
        ("frame_mass_ratio", "f8"),  # μ = M₁/(M_f + M₁)
        ("frame_k", "f8"),  # 1/s², ω²
        ("frame_b", "f8"),  # 1/s, 2 ζ ω
        ("frame_inverse_mass", "f8"),  # 1/kg, 1/M_f
        # of straight axes only
        ("uneven", "f8", 3),  # of each belt's stiffness, belt_difference
        ("growth", "f8", 3),  # 1/m, of an axis' mass by the nozzle's height, growing_bed
        ("yaw_k", "f8"),  # 1/s², ω² of gantry_racking
        ("yaw_b", "f8"),  # 1/s, 2 ζ ω
        ("yaw_inertia", "f8"),  # m², the gantry's inertia over the toolhead's mass; 0: no yaw
        ("yaw_share", "f8"),  # of the mass that moves along y, the toolhead's
        ("yaw_centre", "f8"),  # m, x of the axis of yaw
        ("yaw_arm", "f8"),  # m, lever arm of the force along x on the gantry
        ("by_x", "f8", 3),  # 1/m, of ω² of each axis' highest mode by x, toolhead_mode
        ("by_x_squared", "f8", 3),  # 1/m²
        ("by_x_centre", "f8"),  # m
    ]
)
PrinterParameters: TypeAlias = np.record
COUNT = PARAMETERS.itemsize // 8

# The rows of m. Four states: at the step's start, where the rate is evaluated, the rate, the step's sum of rates.
BASE, NOW, RATE, SUM = np.arange(0, 4 * STATES, STATES)
# Commands: time since each tower's cubic began, the cubics, highest power first, their values, and the cogging ripple.
TIME, CUBIC, COMMAND, COMMAND_RATE, RIPPLE, RIPPLE_RATE = np.array([120, 123, 135, 138, 141, 144])
# Passed from loop to loop in one evaluation, A B C: m, m/s; a belt's stretch and its effective part, m; N; w.
MOTOR, MOTOR_RATE, STRETCH, SPRING, GUIDES, PULL, CENTRIPETAL = np.arange(147, 168, 3)
# X Y Z: m, m/s; relative to the ground, m/s²; N; f₀, N. ρ of the frame's two directions, m/s². J, column by column.
X, XD, ACC, JOINTS, F0, RHO, J = np.arange(168, 189, 3)
# kg, mass along the arms in the carriages' equations: its diagonal, then rows A B, A C, B C.
ARMS = 195
# The printer's parameters, in the order of `PARAMETERS`.
PRINTER = 201
ROWS = PRINTER + COUNT


def __getattr__(name: str) -> np.int64:
    """Return the first row in m of a parameter: with this module imported as r, `r.belt_k`."""
    fields: Mapping[str, Any] = PARAMETERS.fields or {}
    if name not in fields:
        raise AttributeError(name)
    return np.int64(PRINTER + fields[name][1] // 8)


Vector: TypeAlias = tuple[float, float, float]
Row: TypeAlias = int | np.signedinteger
Rows: TypeAlias = NDArray[np.int64]


def parameter_table(printers: Sequence[PrinterParameters]) -> FloatArray:
    """Stack the parameters of k printers : (k, COUNT)."""
    return np.array(printers, PARAMETERS).view(np.float64).reshape(len(printers), COUNT)


class ActiveEffects(NamedTuple):
    """The effects that are active in any lane; the loops of the others are skipped."""

    sticking: bool
    powers: bool  # friction near rest fades otherwise than by the square of the speed
    guides: bool
    joints: bool
    torque_angle: bool
    ripple: bool
    delay: bool
    arms: bool
    springs: bool  # a belt of straight axes has play, or pulls other than in proportion to its stretch
    swaying: bool  # a frame or a gantry moves, the mass grows with height, or a mode depends on x


def lanes(states: FloatArray, parameters: FloatArray, rows: int = ROWS) -> FloatArray:
    """Return m, as (rows, LANES), with these printers : (k, STATES) and (k, COUNT). Idle lanes repeat the last one."""
    m, each = np.zeros((rows, LANES)), np.minimum(np.arange(LANES), len(parameters) - 1)
    m[BASE : BASE + STATES] = m[NOW : NOW + STATES] = states[each].T
    m[PRINTER:ROWS] = parameters[each].T
    return m


def active_effects(parameters: FloatArray) -> ActiveEffects:
    """Return the effects that are active in any of these printers : (k, COUNT)."""
    p = parameters.view(PARAMETERS)

    def has(*names: str) -> bool:
        return any(bool(p[name].any()) for name in names)

    return ActiveEffects(
        sticking=has("sticking"),
        powers=bool(np.any((p["sticking"] != 0.0) & (p["fading_power"] != 1.0))),
        guides=has("dry", "sticking"),
        joints=has("joint_dry"),
        torque_angle=has("inverse_amplitude"),
        ripple=has("ripple"),
        delay=has("delay"),
        arms=has("arm_inertia"),
        springs=has("half_backlash", "landing", "slope", "cubic", "quintic"),
        swaying=has("frame_inverse_mass", "yaw_inertia", "growth", "by_x", "by_x_squared"),
    )
