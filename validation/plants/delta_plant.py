"""The independent delta printer: the judge of compensated prints, the laboratory, and the printer that hides effects.

It has its own equations and shares no line with `models` or `ffcomp`. The unknowns are the nozzle's position X over
the bed, the sway d of the frame (mass M_f, along unit vectors D), the extruder's displacement η on its mount, and
whatever an effect adds. With s_i = √(L_i² - |xy - p_i|²) the carriages stand at q_i = z + H + s_i, so that q̇ = A Ẋ
and q̈ = A Ẍ + a, with rows A_i = (-(x - p_ix)/s_i, -(y - p_iy)/s_i, 1) and a_i = -(ẋ² + ẏ² + ṡ_i²)/s_i. Half of each
arm pair rides on its carriage (mass m), half on the holder (mass M). F is what the arms do to the effector, Γ_i·F what
carriage i feels of it:

    F      = M (Ẍ + D d̈) + f,   f = M g ẑ - (Kη + Bη̇) - (what hangs on the holder) + friction of the joints
    m q̈_i  = belt_i - guide_i - m g - Γ_i·F
    M_f d̈  = -k_f d - c_f ḋ - Dᵀ F
    m_2 η̈  = -(Kη + Bη̇) - m_2 (g ẑ + Ẍ + D d̈)

Mass along the arms takes ν/2 Σ |Ẋ − ẑ q̇_i|² from the kinetic energy: ν Σ (Ẍ − ẑ q̈_i) from F, ν (q̈_i − z̈) from m
q̈_i. Γ = A⁻ᵀ by virtual work, or Γ_i = (column i of A⁻¹)ᵀ P_i after Eqs. 20-25 of the paper (`paper_shares`). Each
motor turns its command u_d into u = (d_1 s + d_0)/(s² + d_2 s + d_0) u_d. Belts and guides are those of `shapes`.

`plant_of` reads a machine file's tables. What a machine file cannot state are fields of PLANT, the argument `hidden`,
and a table `towers` with three values for `carriage_mass_kg`, `belt_stiffness_n_per_m`, `belt_damping_n_s_per_m`,
`guide_damping_n_s_per_m`, `friction_n`, and `stiction`: N friction (1 + stiction e^{-(v/v_s)²}) tanh(v/v_0).

A command's row i holds at t = i h/2 (classical Runge-Kutta reads its own nodes); bristles take an exponential step of
their own, so that they cannot turn unstable. SI inside, mm outside.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from validation.plants import shapes
from validation.plants.shapes import (
    BELTS,
    DAHL,
    GUIDES,
    SHAPED,
    TANH,
    belt,
    bent,
    driven,
    guide,
    record_of,
    rippled,
    slid,
)

FloatArray = NDArray[np.float64]

GRAVITY_M_PER_S2 = 9.80665
CHUNK_STEPS = 40_000
CREEP_M_PER_S, STRIBECK_M_PER_S = 1e-3, 5e-3  # v_0 and v_s of the friction of `towers`
# where the parts of a state begin; bristles last
X, V, ETA, ETA_V, U, UV, SWAY, SWAYV, CABLE, CABLEV, MOUNT, ARM = 0, 3, 6, 9, 12, 15, 18, 20, 22, 24, 26, 28
ROTOR, ROTORV, BRISTLE, STATES = 31, 34, 37, 43
MOTORS = (ROTOR, ROTORV, MOUNT, ARM)
PLANT = np.dtype(
    [
        ("towers", "f8", (3, 2)),  # m
        ("arms", "f8", 3),  # m
        ("height", "f8"),  # m
        ("carriage", "f8", 3),  # kg, with half an arm pair
        ("holder", "f8"),  # kg, with three halves
        ("rods", "f8"),  # kg, by how much mass along the arms is less than at their ends
        ("extruder", "f8"),  # kg
        ("mount_k", "f8", 3),  # N/m
        ("mount_b", "f8", 3),  # N s/m
        ("shares", "f8", (3, 3, 3)),  # P_i; unit matrices for virtual work, zeros for carriages without arms
        ("gravity", "f8"),  # m/s²
        ("ideal", "?"),  # u = u_d
        ("drive", "f8", 3),  # d0 1/s², d1 1/s, d2 1/s
        *((name, "f8", 3) for name in f"{BELTS} {GUIDES}".split()),
        *((name, "f8") for name in SHAPED.split()),
        ("dry_kind", "i8"),  # friction of the guides: 0 none, else of `shapes`
        ("soft_motor", "i8"),  # whose bracket gives way; -1 for none
        ("joint", "f8"),  # N, friction of the joints
        ("joint_bristle", "f8"),  # m
        ("sway_dir", "f8", (2, 2)),  # of the frame
        ("sway_mass", "f8", 2),  # kg
        ("sway_k", "f8", 2),
        ("sway_b", "f8", 2),
        ("cable_mass", "f8"),
        ("cable_k", "f8"),
        ("cable_b", "f8"),
        ("stop_gap", "f8"),  # m, of the extruder's mount
        ("stop_k", "f8"),  # N/m
    ]
)
Plant: TypeAlias = np.record
Work: TypeAlias = tuple[FloatArray, ...]  # Ẍ and d̈ (5,), q, q̇, a, f (3,), the system (5, 5), A and Γ (3, 3)
NEUTRAL: Mapping[str, Any] = {
    **shapes.NEUTRAL,
    **{"joint_bristle": 1e-5, "sway_mass": 1.0, "cable_mass": 1.0},
}


def load_machine(path: Path | str) -> dict[str, Any]:
    """Return the machine file as a plain dictionary."""
    return tomllib.loads(Path(path).read_text(encoding="utf-8"))


def plant_of(machine: Mapping[str, Any], *, gravity: bool = False, hidden: Mapping[str, Any] | None = None) -> Plant:
    """Return the numbers of a printer, with fields of PLANT set by what is hidden.

    Loads go by virtual work, whatever `force_map` the file states. A file with effects is refused: without them it
    would be another machine.
    """
    if machine.get("effects"):
        raise ValueError(f"The plant has no effects, but the machine lists {sorted(machine['effects'])}.")
    geometry, parts, effector = machine["kinematics"], machine["carriage"], machine["effector"]
    drive, towers, half_arms = parts.get("drive"), machine.get("towers", {}), parts["arm_pair_mass_kg"] / 2
    places, arms = _geometry(geometry)
    mounted = float(effector["extruder_mass_kg"] > 0.0)  # else a unit mass that no spring ties to anything
    friction = np.array(towers.get("friction_n", np.zeros(3)))
    numbers = {
        **NEUTRAL,
        "towers": places,
        "arms": arms,
        "height": geometry["effector_height_mm"] / 1e3,
        "carriage": np.asarray(towers.get("carriage_mass_kg", parts["mass_kg"])) + half_arms,
        "holder": effector["nozzle_mass_kg"] + 3 * half_arms,
        "rods": (1.0 - parts.get("arm_mass_share_at_ends", 1.0)) * half_arms / 3,
        "extruder": effector["extruder_mass_kg"] or 1.0,
        "belt_k": towers.get("belt_stiffness_n_per_m", parts["belt_stiffness_n_per_m"]),
        "belt_c": towers.get("belt_damping_n_s_per_m", parts["belt_damping_n_s_per_m"]),
        "guide_b": towers.get("guide_damping_n_s_per_m", parts["guide_damping_n_s_per_m"]),
        "mount_k": mounted * np.asarray(effector["extruder_stiffness_n_per_m"]),
        "mount_b": mounted * np.asarray(effector["extruder_damping_n_s_per_m"]),
        "shares": np.eye(3),
        "gravity": GRAVITY_M_PER_S2 if gravity else 0.0,
        "ideal": not drive,
        "drive": [drive[key] for key in ("d0_per_s2", "d1_per_s", "d2_per_s")] if drive else 0.0,
    }
    if friction.any():
        surplus = friction * towers.get("stiction", 0.0)
        numbers |= {"dry_kind": TANH, "dry": friction, "stick": surplus}
        numbers |= {"dry_v": CREEP_M_PER_S, "stick_v": STRIBECK_M_PER_S, "stick_power": 2.0}
    return record_of(PLANT, {**numbers, **(hidden or {})})


def paper_shares(effector: Mapping[str, Any], tower_angles_deg: ArrayLike) -> FloatArray:
    """P_i : (3, 3, 3). Six balances, nine unknown components, the smallest norm (Eqs. 20-22)."""
    joints = np.column_stack([effector["joint_radius_mm"] * _directions(tower_angles_deg), np.zeros(3)])
    balance = np.zeros((6, 9))
    for i, lever in enumerate(joints - np.asarray(effector["center_of_mass_mm"])):
        for n, unit in enumerate(np.eye(3)):
            balance[:3, 3 * i + n], balance[3:, 3 * i + n] = unit, np.cross(lever, unit)
    found, *_ = np.linalg.lstsq(balance, np.vstack([np.eye(3), np.zeros((3, 3))]), rcond=None)
    return np.ascontiguousarray(found.reshape(3, 3, 3))


# ---- geometry ------------------------------------------------------------------------------------


def _directions(angles_deg: ArrayLike) -> FloatArray:
    angles = np.radians(np.asarray(angles_deg, dtype=float))
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _geometry(tables: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Return the towers (3, 2) m and the arms (3,) m; a file may state each of them or a common number."""
    radii, arms = (
        np.broadcast_to(np.asarray(tables.get(each, tables.get(common)), dtype=float) / 1e3, 3)
        for each, common in (("delta_radii_mm", "delta_radius_mm"), ("arm_lengths_mm", "arm_length_mm"))
    )
    return radii[:, None] * _directions(tables["tower_angles_deg"]), arms


def carriages_of(machine: Mapping[str, Any], xyz_mm: ArrayLike) -> FloatArray:
    """Return carriage heights (n, 3) mm, columns A B C, for nozzles (n, 3) mm, of a machine or of its kinematics."""
    tables, xyz = machine.get("kinematics", machine), np.asarray(xyz_mm, dtype=float)
    towers, arms = _geometry(tables)
    reach2 = (1e3 * arms) ** 2 - np.sum((xyz[..., None, :2] - 1e3 * towers) ** 2, axis=-1)
    if np.any(reach2 <= 0.0):
        at = np.unravel_index(np.argmin(reach2), reach2.shape)
        raise ValueError(f"The nozzle {xyz[at[:-1]]} mm is farther from tower {'ABC'[at[-1]]} than its arm.")
    return np.asarray(xyz[..., 2:] + tables["effector_height_mm"] + np.sqrt(reach2))


# ---- motion --------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def _motor(y: FloatArray, ud: FloatArray, dud: FloatArray, i: int, p: Plant) -> tuple[float, float, float]:
    """(u, u̇, v̈) of motor i; with v̈ = d_0 (u_d - v) - d_2 v̇ its filter gives u = v + d_1/d_0 v̇."""
    u, du, ddv = ud[i], dud[i], 0.0
    if not p.ideal:
        v, dv = y[U + i], y[UV + i]
        ddv = p.drive[0] * (ud[i] - v) - p.drive[2] * dv
        u, du = v + p.drive[1] / p.drive[0] * dv, dv + p.drive[1] / p.drive[0] * ddv
    u, du = rippled(u, du, ud[i], dud[i], i, p)
    return u, du, ddv


@njit(cache=True, error_model="numpy")
def _arms(y: FloatArray, p: Plant, a: FloatArray, q: FloatArray, dq: FloatArray, bend: FloatArray) -> None:
    """Evaluate A : (3, 3), q, q̇, and what q̈ has in addition to A Ẍ."""
    for i in range(3):
        dx, dy = y[X] - p.towers[i, 0], y[X + 1] - p.towers[i, 1]
        s = np.sqrt(p.arms[i] ** 2 - dx * dx - dy * dy)
        a[i, 0], a[i, 1], a[i, 2] = -dx / s, -dy / s, 1.0
        sink = a[i, 0] * y[V] + a[i, 1] * y[V + 1]
        q[i], dq[i] = y[X + 2] + p.height + s, y[V + 2] + sink
        bend[i] = -(y[V] ** 2 + y[V + 1] ** 2 + sink * sink) / s


@njit(cache=True, error_model="numpy")
def _load_shares(a: FloatArray, p: Plant, gamma: FloatArray) -> None:
    """Γ : (3, 3), row a carriage; column i of A⁻¹ is the cross product of the two other rows of A over det A."""
    for i in range(3):
        b, c = (i + 1) % 3, (i + 2) % 3
        n0 = a[b, 1] * a[c, 2] - a[b, 2] * a[c, 1]
        n1 = a[b, 2] * a[c, 0] - a[b, 0] * a[c, 2]
        n2 = a[b, 0] * a[c, 1] - a[b, 1] * a[c, 0]
        det = a[i, 0] * n0 + a[i, 1] * n1 + a[i, 2] * n2
        for k in range(3):
            gamma[i, k] = (n0 * p.shares[i, 0, k] + n1 * p.shares[i, 1, k] + n2 * p.shares[i, 2, k]) / det


@njit(cache=True, error_model="numpy")
def _eliminate(m: FloatArray, r: FloatArray) -> None:
    """R ← m⁻¹ r, by elimination with row pivots; m is spent."""
    n = len(r)
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(m[i, k]) > abs(m[best, k]):
                best = i
        if best != k:
            for j in range(k, n):
                m[k, j], m[best, j] = m[best, j], m[k, j]
            r[k], r[best] = r[best], r[k]
        for i in range(k + 1, n):
            share = m[i, k] / m[k, k]
            if share != 0.0:
                for j in range(k, n):
                    m[i, j] -= share * m[k, j]
                r[i] -= share * r[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            r[k] -= m[k, j] * r[j]
        r[k] /= m[k, k]


@njit(cache=True, error_model="numpy")
def _mount(y: FloatArray, j: int, p: Plant) -> float:
    """Force of the extruder's mount along axis j, N; beyond a gap it meets a stop."""
    force = p.mount_k[j] * y[ETA + j] + p.mount_b[j] * y[ETA_V + j]
    if p.stop_k > 0.0 and j < 2:
        force += p.stop_k * (max(y[ETA + j] - p.stop_gap, 0.0) + min(y[ETA + j] + p.stop_gap, 0.0))
    return force


@njit(cache=True, error_model="numpy")
def _rods(nu: float, a: FloatArray, gamma: FloatArray, bend: FloatArray, m: FloatArray, r: FloatArray) -> None:
    """Take from the carriages' equations what mass along the arms does not weigh at their ends."""
    for i in range(3):
        r[i] += nu * (bend[i] - gamma[i, 2] * (bend[0] + bend[1] + bend[2]))
        for j in range(3):
            m[i, j] -= nu * (a[i, j] + 3.0 * gamma[i, j] - gamma[i, 2] * (a[0, j] + a[1, j] + a[2, j]))
        m[i, 2] += nu


@njit(cache=True, error_model="numpy")
def _rate(
    y: FloatArray, t: float, ud: FloatArray, dud: FloatArray, p: Plant, w: Work, dy: FloatArray, z: FloatArray
) -> None:
    """Dy = d(state)/dt but for bristles z : (6,) of guides and joints; w[0] leaves as Ẍ, d̈."""
    r, q, dq, bend, f, m, a, gamma = w
    _arms(y, p, a, q, dq, bend)
    _load_shares(a, p, gamma)
    for j in range(3):
        f[j] = p.joint * z[3 + j] - _mount(y, j, p)
        if j < 2:
            f[j] -= p.cable_k * y[CABLE + j] + p.cable_b * y[CABLEV + j]
    f[2] += p.holder * p.gravity
    for i in range(3):
        u, du, dy[UV + i] = _motor(y, ud, dud, i, p)
        dy[U + i] = y[UV + i]
        pull = driven(y, t, u, du, ud[i], q[i], dq[i], i, MOTORS, p, dy)
        r[i] = pull - guide(dq[i], q[i], z[i], i, p) - p.carriage[i] * (p.gravity + bend[i])
        for j in range(3):
            m[i, j] = p.carriage[i] * a[i, j] + p.holder * gamma[i, j]
            r[i] -= gamma[i, j] * f[j]
    if p.rods != 0.0:
        _rods(p.rods, a, gamma, bend, m, r)
    _frame(y, p, gamma, f, m, r)
    _eliminate(m, r)
    for j in range(3):
        felt = r[j]
        if j < 2:
            felt += r[3] * p.sway_dir[0, j] + r[4] * p.sway_dir[1, j]
            hang = p.cable_k * y[CABLE + j] + p.cable_b * y[CABLEV + j]
            dy[CABLE + j], dy[CABLEV + j] = y[CABLEV + j], -felt - hang / p.cable_mass
            dy[SWAY + j], dy[SWAYV + j] = y[SWAYV + j], r[3 + j]
        dy[X + j], dy[V + j] = y[V + j], r[j]
        dy[ETA + j], dy[ETA_V + j] = y[ETA_V + j], -_mount(y, j, p) / p.extruder - felt
    dy[ETA_V + 2] -= p.gravity


@njit(cache=True, error_model="numpy")
def _frame(y: FloatArray, p: Plant, gamma: FloatArray, f: FloatArray, m: FloatArray, r: FloatArray) -> None:
    """Enter the sway of the frame into the system of equations."""
    for n in range(2):
        dx, dyy = p.sway_dir[n, 0], p.sway_dir[n, 1]
        for i in range(3):
            m[i, 3 + n] = p.holder * (gamma[i, 0] * dx + gamma[i, 1] * dyy)
        m[3 + n, 0], m[3 + n, 1], m[3 + n, 2] = p.holder * dx, p.holder * dyy, 0.0
        for k in range(2):
            m[3 + n, 3 + k] = p.holder * (dx * p.sway_dir[k, 0] + dyy * p.sway_dir[k, 1])
        m[3 + n, 3 + n] += p.sway_mass[n]
        r[3 + n] = -p.sway_k[n] * y[SWAY + n] - p.sway_b[n] * y[SWAYV + n] - dx * f[0] - dyy * f[1]


@njit(cache=True, error_model="numpy")
def _bristles(y: FloatArray, z: FloatArray, span: float, p: Plant, w: Work, out: FloatArray) -> None:
    """Every bristle after `span`, its slider going on at the same speed: ż = v/b - |v| z/b, solved exactly."""
    if p.dry_kind >= DAHL:
        dq = w[2]
        _arms(y, p, w[6], w[1], dq, w[3])
        for i in range(3):
            out[i] = bent(z[i], dq[i], span, i, p)
    if p.joint > 0.0:
        speed = np.sqrt(y[V] ** 2 + y[V + 1] ** 2 + y[V + 2] ** 2)
        for j in range(3):
            out[3 + j] = slid(z[3 + j], y[V + j], speed, span, p.joint_bristle)


@njit(cache=True, error_model="numpy")
def run(command: FloatArray, speed: FloatArray, h: float, every: int, y: FloatArray, p: Plant) -> FloatArray:
    """Play a command from a state y : (STATES,), which is left as the last one.

    command, speed : (2 n + 1, 3) m, m/s at half steps. Returns (n // every + 1, 4, 3): positions of carriages and
    nozzle, then their accelerations, the nozzle's against the ground.
    """
    steps = (len(command) - 1) // 2
    out = np.empty((steps // every + 1, 4, 3))
    acc, q, dq, bend, f = np.zeros(5), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    a = np.zeros((3, 3))
    w = (acc, q, dq, bend, f, np.zeros((5, 5)), a, np.zeros((3, 3)))
    z, half, full, mid = y[BRISTLE:].copy(), np.zeros(6), np.zeros(6), np.zeros(BRISTLE)
    k1, k2, k3, k4 = np.zeros(BRISTLE), np.zeros(BRISTLE), np.zeros(BRISTLE), np.zeros(BRISTLE)
    bristly = p.dry_kind >= DAHL or p.joint > 0.0
    for n in range(steps + 1):
        b, t = 2 * n, n * h
        _rate(y, t, command[b], speed[b], p, w, k1, z)
        if n % every == 0:
            kept = out[n // every]
            for i in range(3):
                kept[0, i], kept[1, i], kept[3, i] = q[i], y[X + i], acc[i]
                kept[2, i] = a[i, 0] * acc[0] + a[i, 1] * acc[1] + acc[2] + bend[i]
            for j in range(2):
                kept[3, j] += p.sway_dir[0, j] * acc[3] + p.sway_dir[1, j] * acc[4]
        if n == steps:
            break
        for j in range(BRISTLE):
            mid[j] = y[j] + h / 2 * k1[j]
        if bristly:
            _bristles(mid, z, h / 2, p, w, half)
            _bristles(mid, z, h, p, w, full)
        _rate(mid, t + h / 2, command[b + 1], speed[b + 1], p, w, k2, half)
        for j in range(BRISTLE):
            mid[j] = y[j] + h / 2 * k2[j]
        _rate(mid, t + h / 2, command[b + 1], speed[b + 1], p, w, k3, half)
        for j in range(BRISTLE):
            mid[j] = y[j] + h * k3[j]
        _rate(mid, t + h, command[b + 2], speed[b + 2], p, w, k4, full)
        for j in range(BRISTLE):
            y[j] += h / 6 * (k1[j] + 2 * k2[j] + 2 * k3[j] + k4[j])
        z[:] = full
    y[BRISTLE:] = z
    return out


def simulate(
    machine: Mapping[str, Any],
    command_q_mm: ArrayLike,
    h_s: float,
    *,
    gravity: bool = False,
    keep_every: int = 1,
    start: FloatArray | None = None,
    hidden: Mapping[str, Any] | None = None,
) -> dict[str, FloatArray]:
    """Play a command on the machine, from rest (or from the `state` an earlier call ended in).

    Parameters
    ----------
    command_q_mm : (2 n + 1, 3) mm, columns A B C; row i is the command at t = i h/2.
    h_s : step of the integration; 1/12800 s is ample for printers.
    keep_every : every so many steps are kept in the answer, the first among them.
    start : (STATES,) SI, `state` of the call before. Chunks of a command share their border row.
    hidden : fields of PLANT, in SI.

    Returns
    -------
    t : (m,) s;  nozzle_mm, carriage_mm : (m, 3);  nozzle_acc_m_per_s2, carriage_acc_m_per_s2 : (m, 3), the
    plain second derivatives of position (at rest zero, also under gravity);  state : (STATES,) at the command's
    last row.
    """
    command = np.ascontiguousarray(command_q_mm, dtype=float) / 1e3
    if command.ndim != 2 or command.shape[1] != 3 or len(command) % 2 == 0:
        raise ValueError(f"The command has shape {command.shape}; it must be (2 n + 1, 3), a row each half step.")
    p = plant_of(machine, gravity=gravity, hidden=hidden)
    state = rest(command[0], p) if start is None else np.array(start, dtype=float)
    found = run(command, _speed(command, h_s / 2), h_s, keep_every, state, p)
    if not np.all(np.isfinite(found)):
        lost = int(np.argmax(~np.isfinite(found).all(axis=(1, 2)))) * keep_every * h_s
        raise ValueError(f"The nozzle has left the arms' reach {lost:.4f} s after the start of this command.")
    names = ("carriage_mm", "nozzle_mm", "carriage_acc_m_per_s2", "nozzle_acc_m_per_s2")
    return {
        "t": keep_every * h_s * np.arange(len(found), dtype=np.float64),
        **{name: found[:, i] * (1e3 if i < 2 else 1.0) for i, name in enumerate(names)},
        "state": state,
    }


def followed(
    machine: Mapping[str, Any],
    position: Callable[[FloatArray], FloatArray],
    span_s: tuple[float, float],
    step_s: float,
    keep_every: int,
) -> tuple[FloatArray, FloatArray]:
    """Play a nozzle's motion, (k,) s → (k, 3) mm, from rest: t (m,) s and the nozzle (m, 3) mm, after the first."""
    begin, end = span_s
    steps, parts, state = int((end - begin) / step_s) // keep_every * keep_every, list[FloatArray](), None
    for first in range(0, steps, CHUNK_STEPS):
        count = min(CHUNK_STEPS, steps - first)
        t = begin + (2 * first + np.arange(2 * count + 1, dtype=np.float64)) * (step_s / 2)
        answer = simulate(machine, carriages_of(machine, position(t)), step_s, keep_every=keep_every, start=state)
        state = answer["state"]
        parts.append(answer["nozzle_mm"][1:])
    kept = np.arange(1, steps // keep_every + 1, dtype=np.float64)
    return begin + keep_every * step_s * kept, np.concatenate(parts)


def _speed(command: FloatArray, dt: float) -> FloatArray:
    """Fourth-order differences of the command : (n, 3) 1/s; second order in the two rows at each end."""
    speed = np.gradient(command, dt, axis=0)
    if len(command) > 4:
        speed[2:-2] = (8 * (command[3:-1] - command[1:-3]) - (command[4:] - command[:-4])) / (12 * dt)
    return speed


# ---- rest ----------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def rest(command: FloatArray, p: Plant) -> FloatArray:
    """Return the state : (STATES,) in which the machine stands still under the command : (3,) m, loaded by its weight.

    Newton's method finds the nozzle of given carriages; each of the outer passes gains four digits of the sag.
    """
    y = np.zeros(STATES)
    y[U : U + 3] = command
    hung = p.holder
    if p.mount_k[2] > 0.0:
        y[ETA + 2], hung = -p.extruder * p.gravity / p.mount_k[2], p.holder + p.extruder
    a, gamma, target = np.zeros((3, 3)), np.zeros((3, 3)), command.copy()
    q, dq, bend = np.zeros(3), np.zeros(3), np.zeros(3)
    _arms(y, p, a, q, dq, bend)
    y[X + 2] = np.mean(command) - np.mean(q)
    for _ in range(8):
        for _ in range(50):
            _arms(y, p, a, q, dq, bend)
            step = target - q
            _eliminate(a, step)
            y[X : X + 3] += step
            if np.max(np.abs(step)) < 1e-15:
                break
        _arms(y, p, a, q, dq, bend)
        _load_shares(a, p, gamma)
        for i in range(3):
            load = (p.carriage[i] + gamma[i, 2] * hung) * p.gravity + guide(0.0, q[i], 0.0, i, p)
            target[i] = _hung(y, command, q[i], load, i, p)
    return y


@njit(cache=True, error_model="numpy")
def _hung(y: FloatArray, command: FloatArray, q: float, load: float, i: int, p: Plant) -> float:
    """Height of carriage i at which its belt bears a load, by bisection. Fills in what else has moved at rest."""
    u = _motor(y, command, np.zeros(3), i, p)[0]
    if i == p.soft_motor:
        y[MOUNT] = -load / p.soft_k
        u += y[MOUNT]
    if p.rotor[i] > 0.0:
        u -= load / p.rotor_k[i]
        y[ROTOR + i] = u
    low, high, s = -2e-3, 2e-3, 0.0
    for _ in range(60):
        s = (low + high) / 2
        if belt(s, 0.0, q, command[i], s, 0.0, i, p) < load:
            low = s
        else:
            high = s
    y[ARM + i] = s
    return u - s
