"""The printer as bodies and joints in MuJoCo: an engine nobody here wrote, and arms that really have mass.

Only the parts' numbers come from the machine; no equation of `models` or of `delta_plant` is used. Each carriage is a
body on a vertical slide whose spring and damper are the belt's and the guide's; each rod is a body with a ball
joint at its carriage and a `connect` constraint at the effector; the extruder is a body on three sprung slides. What
the motor does is a force k u + c u̇ on the carriage, u and u̇ from the drive's transfer function.

    arms "lumped"   each rod's mass sits in two points, half at each end
    arms "uniform"  each rod is a thin uniform rod

The effector is free in all six directions, held by two rods a tower; its centre of mass is where the file says. A model
is built at a place: in its reference pose the printer stands there and all springs are at ease. m, s, kg.

MuJoCo's constraints give way: with impedance d and time constant T, an error r of a constraint obeys
r̈ + 2ṙ/T + r/T² = (1 − d) (what r̈ were without it) for d near 1 (MuJoCo documentation, "Computation").
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import StateSpace, lsim

from models.kinds import delta_vibration
from models.machine import Machine
from validation.plants import straight_plant

FloatArray = NDArray[np.float64]

GRAVITY_M_PER_S2 = 9.80665
STEP_S = 1 / 12800
IMPEDANCE = 0.9999  # the most that MuJoCo allows
TIGHT_STEPS = 2.0  # T in steps; the least that MuJoCo allows
ROD_RADIUS_M = 3e-3  # decides a rod's inertia about its own axis, about which nothing turns it
HALF_PAIR_M = 0.025  # between the two rods of a parallelogram, halved; no answer depends on it
EFFECTOR_GYRATION_M = 0.03  # radius of gyration; no answer depends on it
LIGHT = "1e-4 1e-4 1e-4"  # kg m², of bodies that never turn
MOST_M_PER_S2 = 1e-6  # acceleration of a printer that is said to be at rest

Arms = Literal["lumped", "uniform"]
AT_ENDS: Mapping[Arms, float] = {"lumped": 1.0, "uniform": 0.0}  # of a rod's mass


# ---- the machine's parts as MuJoCo reads them ----------------------------------------------------


def _document(machine: Machine, home: FloatArray, home_q: FloatArray, arms: Arms) -> Iterator[str]:
    solref = f"{TIGHT_STEPS * STEP_S!r} 1"
    solimp = f"{IMPEDANCE} {IMPEDANCE} 1"
    yield "<mujoco><compiler angle='radian' autolimits='false'/>"
    yield f"<option timestep='{STEP_S!r}' gravity='0 0 {-GRAVITY_M_PER_S2}' integrator='RK4' solver='Newton'"
    yield "tolerance='1e-15'><flag contact='disable' energy='enable'/></option>"
    yield f"<default><equality solref='{solref}' solimp='{solimp}'/></default><worldbody>"
    joints = list(_joints(machine, home, home_q))
    for tower in "ABC":
        yield from _carriage(machine, tower, [j for j in joints if j.tower == tower], arms)
    yield from _effector(machine, home, joints)
    yield "</worldbody><equality>"
    yield from (f"<connect site1='low_{j.name}' site2='seat_{j.name}'/>" for j in joints)
    yield "</equality>"
    yield "<actuator>"
    yield from (f"<motor joint='q_{tower}'/>" for tower in "ABC")
    yield "</actuator></mujoco>"


class Rod(NamedTuple):
    """One rod in the reference pose, from its joint on the carriage to its joint on the effector, (3,) m each."""

    tower: str
    name: str
    mass_kg: float
    upper: FloatArray
    lower: FloatArray
    seat: FloatArray  # the lower joint seen from the nozzle tip


def _joints(machine: Machine, home: FloatArray, home_q: FloatArray) -> Iterator[Rod]:
    own = delta_vibration(machine)
    geometry, ring = own.kinematics, own.effector.joint_radius_mm / 1e3
    mass, up = own.carriage.arm_pair_mass_kg / 2, np.array([0.0, 0.0, 1.0])
    parts = zip("ABC", geometry.tower_angles_rad, geometry.delta_radii_mm / 1e3, home_q, strict=True)
    for tower, angle, radius, height in parts:
        outward, tangent = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        for n, offset in enumerate((-HALF_PAIR_M, HALF_PAIR_M)):
            joint = ring * outward + offset * tangent
            seat = joint + geometry.effector_height_mm / 1e3 * up
            yield Rod(tower, f"{tower}{n}", mass, joint + radius * outward + height * up, home + seat, seat)


def _carriage(machine: Machine, tower: str, rods: list[Rod], arms: Arms) -> Iterator[str]:
    carriage = delta_vibration(machine).carriage
    damping = carriage.belt_damping_n_s_per_m + carriage.guide_damping_n_s_per_m
    axis = _sprung("z", f"q_{tower}", carriage.belt_stiffness_n_per_m, damping)
    middle = np.mean([rod.upper for rod in rods], axis=0)
    yield f"<body name='carriage_{tower}' pos='{_row(middle)}'>{axis}"
    yield _mass(carriage.mass_kg)
    for rod in rods:
        yield from _rod(rod, middle, AT_ENDS[arms])
    yield "</body>"


def _rod(rod: Rod, carriage: FloatArray, at_ends: float) -> Iterator[str]:
    """A body whose z axis runs down the rod; its inertia about the middle is m L²/12, m L²/4 of what is at the ends."""
    along = rod.lower - rod.upper
    length = float(np.linalg.norm(along))
    across = rod.mass_kg * length**2 * (at_ends / 4 + (1 - at_ends) / 12)
    inertia = _row(np.array([across, across, rod.mass_kg * ROD_RADIUS_M**2 / 2]))
    yield f"<body name='rod_{rod.name}' pos='{_row(rod.upper - carriage)}' zaxis='{_row(along)}'><joint type='ball'/>"
    yield f"<inertial pos='0 0 {length / 2!r}' mass='{rod.mass_kg}' diaginertia='{inertia}'/>"
    yield f"<site name='low_{rod.name}' pos='0 0 {length!r}'/></body>"


def _effector(machine: Machine, home: FloatArray, rods: list[Rod]) -> Iterator[str]:
    """The nozzle holder, its origin at the nozzle tip, and the extruder on its mount at the centre of mass."""
    own = delta_vibration(machine)
    effector, plane = own.effector, np.array([0.0, 0.0, own.kinematics.effector_height_mm / 1e3])
    centre = _row(plane + effector.center_of_mass_mm / 1e3)
    inertia = _row(np.full(3, effector.nozzle_mass_kg * EFFECTOR_GYRATION_M**2))
    yield f"<body name='effector' pos='{_row(home)}'><freejoint/>"
    yield f"<inertial pos='{centre}' mass='{effector.nozzle_mass_kg}' diaginertia='{inertia}'/>"
    yield from (f"<site name='seat_{rod.name}' pos='{_row(rod.seat)}'/>" for rod in rods)
    yield f"<body name='extruder' pos='{centre}'>"
    mount = zip("xyz", effector.extruder_stiffness_n_per_m, effector.extruder_damping_n_s_per_m, strict=True)
    yield from (_sprung(axis, f"eta_{axis}", k, b) for axis, k, b in mount)
    yield f"{_mass(effector.extruder_mass_kg)}</body></body>"


def _sprung(axis: str, name: str, stiffness: float, damping: float) -> str:
    direction = _row(np.eye(3)["xyz".index(axis)])
    return f"<joint name='{name}' type='slide' axis='{direction}' stiffness='{stiffness}' damping='{damping}'/>"


def _mass(kg: float) -> str:
    return f"<inertial pos='0 0 0' mass='{kg}' diaginertia='{LIGHT}'/>"


def _row(values: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)


# ---- rest --------------------------------------------------------------------------------


def _at_rest(model: Any) -> Any:
    """MuJoCo's data with all forces in balance."""
    data = mujoco.MjData(model)
    home = data.qpos.copy()

    def acceleration(moved: FloatArray) -> FloatArray:
        data.qpos[:] = home
        mujoco.mj_integratePos(model, data.qpos, moved, 1.0)
        mujoco.mj_forward(model, data)
        return np.array(data.qacc)

    found = least_squares(acceleration, np.zeros(model.nv), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    if np.max(np.abs(acceleration(found.x))) > MOST_M_PER_S2:
        raise ValueError(f"The printer finds no rest: it is accelerated by {found.fun} (m/s², rad/s²).")
    return data


# ---- motion --------------------------------------------------------------------------------------


def play(
    machine: Machine, nozzle_mm: FloatArray, command_mm: FloatArray, dt_s: float, arms: Arms
) -> tuple[FloatArray, FloatArray]:
    """Play a command from rest under the weight, as `simulate_printer` does: nozzle and carriages, (n + 1, 3) mm.

    Parameters
    ----------
    nozzle_mm : (3,) mm, the commanded nozzle at first.
    command_mm : (n, 3) mm, columns A B C, a row each `dt_s`; a cubic spline in between.
    """
    home, geometry = nozzle_mm / 1e3, delta_vibration(machine).kinematics
    away = home[:2] - geometry.towers_mm / 1e3
    heights = home[2] + geometry.effector_height_mm / 1e3
    home_q = heights + np.sqrt((geometry.arm_lengths_mm / 1e3) ** 2 - np.sum(away**2, axis=1))
    model = mujoco.MjModel.from_xml_string("\n".join(_document(machine, home, home_q, arms)))
    data = _at_rest(model)
    start = np.concatenate([[0.0], data.qpos, data.qvel])
    force = _motor_force(machine, command_mm / 1e3 - home_q, dt_s)
    states, _ = rollout.rollout(model, data, start[None], force[None])
    qpos = np.vstack([start[1 : 1 + model.nq], states[0, :, 1 : 1 + model.nq]])
    first = int(model.jnt_qposadr[model.body("effector").jntadr[0]])
    nozzle, carriages = slice(first, first + 3), [int(model.joint(f"q_{tower}").qposadr[0]) for tower in "ABC"]
    return 1e3 * (home + qpos[:, nozzle] - model.qpos0[nozzle]), 1e3 * (home_q + qpos[:, carriages])


def _motor_force(machine: Machine, told: FloatArray, dt_s: float) -> FloatArray:
    """k u + c u̇ in the middle of each step, (steps, 3) N, for commands (n, 3) m from home, each `dt_s`.

    u and u̇ are the drive's answers from rest, (d₁ s + d₀)/(s² + d₂ s + d₀) in controllable form.
    """
    carriage, rows = delta_vibration(machine).carriage, dt_s * np.arange(len(told))
    assert carriage.drive is not None
    d0, d1, d2 = carriage.drive.d0_per_s2, carriage.drive.d1_per_s, carriage.drive.d2_per_s
    drive = StateSpace([[0, 1], [-d0, -d2]], [[0], [1]], [[d0, d1], [-d0 * d1, d0 - d1 * d2]], [[0], [d1]])
    t = STEP_S / 2 * np.arange(round(2 * rows[-1] / STEP_S) + 1)
    u, speed = np.stack([lsim(drive, column, t)[1].T for column in CubicSpline(rows, told)(t).T], axis=-1)
    return (carriage.belt_stiffness_n_per_m * u + carriage.belt_damping_n_s_per_m * speed)[1::2]


# ---- straight axes -------------------------------------------------------------------------------


def play_straight(plant: straight_plant.Plant, command_mm: FloatArray, rate_hz: float) -> FloatArray:
    """Play x and y, (n, 2) mm with straight lines between, on carriages that slide, with tools; belts are tendons.

    Returns (n, 2) mm, where the tools are. Without what `plant` has beside masses, springs and dampers.
    """
    bodies, belts = "", ""
    for i, axis in enumerate("xy"):
        mount = _sprung(axis, f"tool_{axis}", plant.mount_n_per_m[i], plant.mount_n_s_per_m[i])
        bodies += f"<body>{_sprung(axis, axis, 0.0, plant.guide_n_s_per_m[i])}{_mass(plant.carriage_kg[i])}"
        bodies += f"<body>{mount}{_mass(plant.tool_kg[i])}</body></body>"
        of = f"stiffness='{plant.belt_n_per_m[i]}' damping='{plant.belt_n_s_per_m[i]}'"
        ends = (f"<joint joint='{a}' coef='{c}'/>" for a, c in zip("xy", plant.motors[i], strict=True))
        belts += f"<fixed name='{i}' springlength='0' {of}>{''.join(ends)}</fixed>"
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><option timestep='{STEP_S / 2!r}' gravity='0 0 0' integrator='RK4'/><worldbody>{bodies}</worldbody>"
        f"<tendon>{belts}</tendon><actuator><motor tendon='0'/><motor tendon='1'/></actuator></mujoco>"
    )
    every = round(2 / rate_hz / STEP_S)
    at = (np.arange(every * (len(command_mm) - 1)) + 0.5) / every  # in rows, in the middle of each step
    line, motors = np.diff(command_mm, axis=0)[at.astype(int)], np.array(plant.motors).T / 1e3
    told, speed = (command_mm[at.astype(int)] + (at % 1.0)[:, None] * line) @ motors, rate_hz * line @ motors
    force = told * plant.belt_n_per_m + speed * plant.belt_n_s_per_m
    start = np.zeros((1, 1 + model.nq + model.nv))
    states, _ = rollout.rollout(model, mujoco.MjData(model), start, force[None])
    qpos = np.vstack([start[0, 1 : 1 + model.nq], states[0, every - 1 :: every, 1 : 1 + model.nq]])
    return 1e3 * (qpos[:, ::2] + qpos[:, 1::2])
