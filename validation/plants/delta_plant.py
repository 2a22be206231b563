"""The judge: a nonlinear delta printer with its own equations, sharing no line with `models` or `ffcomp`.

Lagrange's equations in the nozzle's position X (the design model lives in the carriages' coordinates
instead). The carriages follow from X in closed form,

    q_i = z + H + s_i,    s_i = √(L_i² - |xy - p_i|²),    q̇ = A Ẋ,    q̈ = A Ẍ + a(X, Ẋ),

with the row A_i = (-(x - p_ix)/s_i, -(y - p_iy)/s_i, 1) and a_i = -(ẋ² + ẏ² + ṡ_i²)/s_i. Half of each arm
pair rides on its carriage, half on the nozzle holder: m = m_c + m_f/2, M = m_1 + 3 m_f/2. The
extruder m_2 hangs on three springs, η is its displacement relative to the holder. Kinetic energy ½m|q̇|² +
½M|Ẋ|² + ½m_2|Ẋ + η̇|², potential ½k|u - q|² + ½ηᵀKη (+ weight), dissipation ½c|u̇ - q̇|² + ½b|q̇|² +
½η̇ᵀBη̇ give

    (m AᵀA + M I) Ẍ = Aᵀ(k(u - q) + c(u̇ - q̇) - b q̇ - m a) + Kη + Bη̇
    η̈ = -Ẍ - (Kη + Bη̇)/m_2

Each motor turns its command u_d into u = (d_1 s + d_0)/(s² + d_2 s + d_0) u_d. The load map is virtual
work, whatever the file's `force_map` says; the holder never tilts, so its centre of mass does no work and
does not enter.

A printer is never quite even. A machine dictionary may hold a table `towers`, three values each, that stand in
place of the common ones (`carriage_mass_kg`, `belt_stiffness_n_per_m`, `belt_damping_n_s_per_m`,
`guide_damping_n_s_per_m`), and dry friction in the guides, `friction_n`, which falls with speed from
1 + `stiction` times that much (Stribeck) and turns over within 1 mm/s: F (1 + e exp(-(v/v_s)²)) tanh(v/v_0).

Timing: `command_q_mm[i]` is the command at t = i h/2 exactly, so that classical Runge-Kutta of order 4
reads it at its own nodes t, t + h/2, t + h and nothing is held or interpolated. Inside SI; mm at the edges.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

STATES = 18
X, V, ETA, ETA_V, DRIVE, DRIVE_V = (slice(i, i + 3) for i in range(0, STATES, 3))  # parts of a state, SI
GRAVITY_M_PER_S2 = 9.80665


# The numbers of one machine, SI. A record and no class: numba's cache then holds however this is imported.
PLANT = np.dtype(
    [
        ("towers", "f8", (3, 2)),  # m, the carriages' joints seen from the effector's: effective radius
        ("arms", "f8", 3),  # m
        ("height", "f8"),  # m, joint plane above the nozzle tip
        ("carriage_mass", "f8", 3),  # kg, m = m_c + m_f/2
        ("holder_mass", "f8"),  # kg, M = m_1 + 3 m_f/2
        ("arm_inertia", "f8"),  # kg, ν = (1 − share at the ends) m_f/6
        ("extruder_mass", "f8"),  # kg, m_2
        ("belt_k", "f8", 3),  # N/m
        ("belt_c", "f8", 3),  # N s/m
        ("guide_b", "f8", 3),  # N s/m
        ("friction", "f8", 3),  # N
        ("stiction", "f8"),  # surplus at rest, as a share
        ("extruder_k", "f8", 3),  # N/m
        ("extruder_b", "f8", 3),  # N s/m
        ("ideal_drive", "?"),  # u = u_d
        ("drive", "f8", 3),  # d0 1/s², d1 1/s, d2 1/s; zeros if ideal
        ("gravity", "f8"),  # m/s²
    ]
)
Plant: TypeAlias = np.record
CREEP_M_PER_S, STRIBECK_M_PER_S = 1e-3, 5e-3  # v_0 and v_s of the friction


def load_machine(path: Path | str) -> dict[str, Any]:
    """The machine file as a plain dictionary."""
    return tomllib.loads(Path(path).read_text(encoding="utf-8"))


def plant_of(machine: dict[str, Any], *, gravity: bool = False) -> Plant:
    """Read the tables this judge knows; effects are refused: without them it judges another machine."""
    if machine.get("effects"):
        raise ValueError(f"The plant has no effects, but the machine lists {sorted(machine['effects'])}.")
    geometry, carriage, effector = machine["kinematics"], machine["carriage"], machine["effector"]
    drive = carriage.get("drive", {})
    half_arms = carriage["arm_pair_mass_kg"] / 2
    angles = np.radians(np.asarray(geometry["tower_angles_deg"], dtype=float))
    radii = _per_tower(geometry, "delta_radii_mm", "delta_radius_mm") / 1e3
    loose = effector["extruder_mass_kg"] == 0.0  # no extruder: a unit mass that no spring ties to anything
    spring = 0.0 if loose else 1.0

    def each(key: str, common: float) -> FloatArray:
        return np.array(machine.get("towers", {}).get(key, [common] * 3), dtype=float)

    numbers = {
        "towers": radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]),
        "arms": _per_tower(geometry, "arm_lengths_mm", "arm_length_mm") / 1e3,
        "height": geometry["effector_height_mm"] / 1e3,
        "carriage_mass": each("carriage_mass_kg", carriage["mass_kg"]) + half_arms,
        "holder_mass": effector["nozzle_mass_kg"] + 3 * half_arms,
        "arm_inertia": (1.0 - carriage.get("arm_mass_share_at_ends", 1.0)) * half_arms / 3,
        "extruder_mass": 1.0 if loose else float(effector["extruder_mass_kg"]),
        "belt_k": each("belt_stiffness_n_per_m", carriage["belt_stiffness_n_per_m"]),
        "belt_c": each("belt_damping_n_s_per_m", carriage["belt_damping_n_s_per_m"]),
        "guide_b": each("guide_damping_n_s_per_m", carriage["guide_damping_n_s_per_m"]),
        "friction": each("friction_n", 0.0),
        "stiction": float(machine.get("towers", {}).get("stiction", 0.0)),
        "extruder_k": spring * np.asarray(effector["extruder_stiffness_n_per_m"], dtype=float),
        "extruder_b": spring * np.asarray(effector["extruder_damping_n_s_per_m"], dtype=float),
        "ideal_drive": not drive,
        "drive": np.array([float(drive.get(key, 0.0)) for key in ("d0_per_s2", "d1_per_s", "d2_per_s")]),
        "gravity": GRAVITY_M_PER_S2 if gravity else 0.0,
    }
    return np.rec.array([tuple(numbers[name] for name in PLANT.names or ())], dtype=PLANT)[0]


def _per_tower(geometry: dict[str, Any], each: str, common: str) -> FloatArray:
    """Three numbers, one a tower : (3,), from the optional list or the common value."""
    return np.array(np.broadcast_to(np.asarray(geometry.get(each, geometry.get(common)), dtype=float), 3))


# ---- geometry ------------------------------------------------------------------------------------


def carriages_of(machine: dict[str, Any], xyz_mm: ArrayLike) -> FloatArray:
    """Inverse kinematics: carriage heights : (n, 3) mm, columns A B C, for nozzles : (n, 3) mm."""
    return _carriages(plant_of({**machine, "effects": {}}), np.asarray(xyz_mm, dtype=float) / 1e3) * 1e3


def _carriages(p: Plant, xyz: FloatArray) -> FloatArray:
    reach2 = p.arms**2 - np.sum((xyz[..., None, :2] - p.towers) ** 2, axis=-1)
    if np.any(reach2 <= 0.0):
        worst = np.unravel_index(np.argmin(reach2), reach2.shape)
        raise ValueError(
            f"The nozzle {xyz[worst[:-1]] * 1e3} mm is farther from tower {'ABC'[worst[-1]]} than its arm."
        )
    return xyz[..., 2:] + p.height + np.sqrt(reach2)


def _slope(p: Plant, xyz: FloatArray) -> FloatArray:
    """A = dq/dX : (3, 3), row a tower."""
    away = xyz[:2] - p.towers
    return np.column_stack([-away / np.sqrt(p.arms**2 - np.sum(away**2, axis=1))[:, None], np.ones(3)])


def _nozzle(p: Plant, q: FloatArray) -> FloatArray:
    """Forward kinematics of one pose by Newton's method : (3,) m."""
    xyz = np.array([0.0, 0.0, np.mean(q) - np.mean(_carriages(p, np.zeros(3)))])
    for _ in range(50):
        step = np.linalg.solve(_slope(p, xyz), q - _carriages(p, xyz))
        xyz = xyz + step
        if np.max(np.abs(step)) < 1e-14:
            return xyz
    raise ValueError(f"The carriages {q * 1e3} mm hold no nozzle position that Newton's method finds.")


def rest_state(p: Plant, command: FloatArray) -> FloatArray:
    """The state : (18,) SI in which the machine stands still under the command : (3,) m.

    Without weight the carriages stand at the command. With it every belt gives way by its share of the load:
    k (u - q) = m g + A⁻ᵀ e_z (M + m_2) g, by fixed point (each pass gains four digits).
    """
    sag = np.zeros(3)
    lifted = (p.holder_mass + p.extruder_mass) * p.gravity * np.array([0.0, 0.0, 1.0])
    for _ in range(6):
        slope = _slope(p, _nozzle(p, command - sag))
        sag = (p.carriage_mass * p.gravity + np.linalg.solve(slope.T, lifted)) / p.belt_k
    state = np.zeros(STATES)
    state[X], state[DRIVE] = _nozzle(p, command - sag), command
    if p.gravity:
        state[ETA.start + 2] = -p.extruder_mass * p.gravity / p.extruder_k[2]
    return state


# ---- motion --------------------------------------------------------------------------------------


@njit(cache=True)
def _solve3(m: FloatArray, r: FloatArray, out: FloatArray) -> None:
    """m out = r for a symmetric 3x3, by cofactors."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    c11 = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    c12 = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    c22 = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    det = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    out[0] = (c00 * r[0] + c01 * r[1] + c02 * r[2]) / det
    out[1] = (c01 * r[0] + c11 * r[1] + c12 * r[2]) / det
    out[2] = (c02 * r[0] + c12 * r[1] + c22 * r[2]) / det


@njit(cache=True)
def _motor(y: FloatArray, ud: FloatArray, dud: FloatArray, i: int, p: Plant) -> tuple[float, float, float]:
    """(u, u̇, v̈) of motor i. With v'' = d_0 (u_d - v) - d_2 v' the filter's output is u = v + d_1/d_0 v'."""
    if p.ideal_drive:
        return ud[i], dud[i], 0.0
    d0, d1, d2 = p.drive[0], p.drive[1], p.drive[2]
    v, dv = y[12 + i], y[15 + i]
    ddv = d0 * (ud[i] - v) - d2 * dv
    return v + d1 / d0 * dv, dv + d1 / d0 * ddv, ddv


@njit(cache=True)
def _friction(v: float, i: int, p: Plant) -> float:
    """Dry friction of guide i, N."""
    if p.friction[i] == 0.0:
        return 0.0
    level = p.friction[i] * (1.0 + p.stiction * np.exp(-((v / STRIBECK_M_PER_S) ** 2)))
    return level * np.tanh(v / CREEP_M_PER_S)


@njit(cache=True)
def _tower(y: FloatArray, i: int, p: Plant) -> tuple[float, float, float, float, float]:
    """(A_i0, A_i1, q_i, q̇_i, a_i) of tower i."""
    dx, dy = y[0] - p.towers[i, 0], y[1] - p.towers[i, 1]
    s = np.sqrt(p.arms[i] ** 2 - dx * dx - dy * dy)
    ds = -(dx * y[3] + dy * y[4]) / s
    bend = -(y[3] ** 2 + y[4] ** 2 + ds * ds) / s
    return -dx / s, -dy / s, y[2] + p.height + s, y[5] + ds, bend


@njit(cache=True)
def _rate(
    y: FloatArray,
    ud: FloatArray,
    dud: FloatArray,
    p: Plant,
    mass: FloatArray,
    force: FloatArray,
    acc: FloatArray,
    dy: FloatArray,
) -> None:
    """dy = d(state)/dt. mass : (3, 3), force, acc : (3,) are work space; acc leaves as Ẍ."""
    for j in range(3):
        for k in range(3):
            mass[j, k] = 0.0
        mass[j, j] = p.holder_mass
        force[j] = p.extruder_k[j] * y[6 + j] + p.extruder_b[j] * y[9 + j]
        dy[9 + j] = -force[j] / p.extruder_mass
    force[2] -= p.holder_mass * p.gravity
    dy[11] -= p.gravity
    for i in range(3):
        ax, ay, q, dq, bend = _tower(y, i, p)
        u, du, ddv = _motor(y, ud, dud, i, p)
        pull = p.belt_k[i] * (u - q) + p.belt_c[i] * (du - dq) - p.guide_b[i] * dq - _friction(dq, i, p)
        pull -= p.carriage_mass[i] * (bend + p.gravity)
        row = (ax, ay, 1.0)
        for j in range(3):
            up = 1.0 if j == 2 else 0.0
            force[j] += row[j] * pull + p.arm_inertia * bend * (row[j] - up)
            mass[j, j] -= p.arm_inertia
            mass[j, 2] += p.arm_inertia * row[j]
            mass[2, j] += p.arm_inertia * row[j]
            for k in range(3):
                mass[j, k] += (p.carriage_mass[i] - p.arm_inertia) * row[j] * row[k]
        dy[12 + i], dy[15 + i] = y[15 + i], ddv
    _solve3(mass, force, acc)
    for j in range(3):
        dy[j], dy[3 + j] = y[3 + j], acc[j]
        dy[6 + j] = y[9 + j]
        dy[9 + j] -= acc[j]


@njit(cache=True)
def _observe(
    y: FloatArray,
    acc: FloatArray,
    p: Plant,
    nozzle: FloatArray,
    carriage: FloatArray,
    nozzle_acc: FloatArray,
    carriage_acc: FloatArray,
) -> None:
    for i in range(3):
        ax, ay, q, _, bend = _tower(y, i, p)
        nozzle[i], nozzle_acc[i] = y[i], acc[i]
        carriage[i], carriage_acc[i] = q, ax * acc[0] + ay * acc[1] + acc[2] + bend


@njit(cache=True)
def _run(
    y: FloatArray, command: FloatArray, command_v: FloatArray, h: float, keep_every: int, p: Plant
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Classical RK4 from y : (18,), left as the last state. command, command_v : (2 n + 1, 3) m, m/s."""
    steps = (len(command) - 1) // 2
    kept = steps // keep_every + 1
    nozzle, carriage = np.empty((kept, 3)), np.empty((kept, 3))
    nozzle_acc, carriage_acc = np.empty((kept, 3)), np.empty((kept, 3))
    mass, force, acc = np.empty((3, 3)), np.empty(3), np.empty(3)
    k1, k2, k3, k4 = np.empty(18), np.empty(18), np.empty(18), np.empty(18)
    for n in range(steps + 1):
        a = 2 * n
        _rate(y, command[a], command_v[a], p, mass, force, acc, k1)
        if n % keep_every == 0:
            m = n // keep_every
            _observe(y, acc, p, nozzle[m], carriage[m], nozzle_acc[m], carriage_acc[m])
        if n == steps:
            break
        _rate(y + h / 2 * k1, command[a + 1], command_v[a + 1], p, mass, force, acc, k2)
        _rate(y + h / 2 * k2, command[a + 1], command_v[a + 1], p, mass, force, acc, k3)
        _rate(y + h * k3, command[a + 2], command_v[a + 2], p, mass, force, acc, k4)
        for j in range(18):
            y[j] += h / 6 * (k1[j] + 2 * k2[j] + 2 * k3[j] + k4[j])
    return nozzle, carriage, nozzle_acc, carriage_acc


def simulate(
    machine: dict[str, Any],
    command_q_mm: ArrayLike,
    h_s: float,
    *,
    gravity: bool = False,
    keep_every: int = 1,
    start: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Play a command on the machine, from rest (or from the `state` an earlier call ended in).

    Parameters
    ----------
    command_q_mm : (2 n + 1, 3) mm, columns A B C; row i is the command at t = i h/2.
    h_s : step of the integration; 1/12800 s is ample for printers.
    keep_every : every so many steps are kept in the answer, the first among them.
    start : (18,) SI, `state` of the call before. Chunks of a command share their border row.

    Returns
    -------
    t : (m,) s;  nozzle_mm, carriage_mm : (m, 3);  nozzle_acc_m_per_s2, carriage_acc_m_per_s2 : (m, 3), the
    plain second derivatives of position (at rest zero, also under gravity);  state : (18,) at the command's
    last row.
    """
    command = np.ascontiguousarray(command_q_mm, dtype=float) / 1e3
    if command.ndim != 2 or command.shape[1] != 3 or len(command) % 2 == 0:
        raise ValueError(f"The command has shape {command.shape}; it must be (2 n + 1, 3), a row each half step.")
    p = plant_of(machine, gravity=gravity)
    state = rest_state(p, command[0]) if start is None else np.array(start, dtype=float)
    speed = _speed(command, h_s / 2) if p.ideal_drive else command  # a real drive never asks for the speed
    nozzle, carriage, nozzle_acc, carriage_acc = _run(state, command, speed, h_s, keep_every, p)
    if not np.all(np.isfinite(nozzle)):
        lost = int(np.argmax(~np.isfinite(nozzle).all(axis=1))) * keep_every * h_s
        raise ValueError(f"The nozzle has left the arms' reach {lost:.4f} s after the start of this command.")
    return {
        "t": keep_every * h_s * np.arange(len(nozzle), dtype=np.float64),
        "nozzle_mm": nozzle * 1e3,
        "carriage_mm": carriage * 1e3,
        "nozzle_acc_m_per_s2": nozzle_acc,
        "carriage_acc_m_per_s2": carriage_acc,
        "state": state,
    }


def _speed(command: FloatArray, dt: float) -> FloatArray:
    """Fourth-order differences of the command : (n, 3) 1/s; second order in the two rows at each end."""
    speed = np.gradient(command, dt, axis=0)
    if len(command) > 4:
        near, far = command[3:-1] - command[1:-3], command[4:] - command[:-4]
        speed[2:-2] = (8 * near - far) / (12 * dt)
    return speed
