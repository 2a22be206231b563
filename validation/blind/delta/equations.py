"""A delta printer that hides something: its own equations, sharing no line with `models` or `ffcomp`.

The unknowns are the nozzle's position X over the bed, the sway d of the frame (mass M_f, along unit vectors D), the
extruder's displacement η on its mount, and whatever an effect brings along. With s_i = √(L_i² - |xy - p_i|²) the
carriages stand at q_i = z + H + s_i, so that q̇ = A Ẋ and q̈ = A Ẍ + a, a_i = -(ẋ² + ẏ² + ṡ_i²)/s_i. F is what the arms
do to the effector, Γ_i·F what carriage i feels of it:

    F      = M (Ẍ + D d̈) + f,   f = M g ẑ - (Kη + Bη̇) - (what hangs on the holder) + friction of the joints
    m q̈_i  = belt_i - guide_i - m g - Γ_i·F
    M_f d̈  = -k_f d - c_f ḋ - Dᵀ F
    m_2 η̈  = -(Kη + Bη̇) - m_2 (g ẑ + Ẍ + D d̈)

Mass along the arms takes ν/2 Σ |Ẋ − ẑ q̇_i|² from the kinetic energy: ν Σ (Ẍ − ẑ q̈_i) from F, ν (q̈_i − z̈) from m q̈_i.

Γ = A⁻ᵀ by virtual work, or Γ_i = (column i of A⁻¹)ᵀ P_i after Eqs. 20-25 of the paper. Ẍ and d̈ come from one 5 x 5
system. The shapes of the effects are on purpose not those of the machine files: friction is a bristle (Canudas de Wit,
Olsson, Åström & Lischinsky, 1995) or a tanh, play has soft flanks and a damped landing, a hardening belt has a fifth
power, a stepper's sine acts in series with its belt.

A command's row i holds at t = i h/2 (classical Runge-Kutta reads its own nodes); bristles take an exponential step of
their own, so that they cannot turn unstable. SI throughout; the fields of a printer are
explained in `numbers`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from validation.blind.delta.numbers import FloatArray, Printer
from validation.blind.printer.shapes import DAHL, belt, bent, guide, slid

GRAVITY = 9.80665
# where the parts of a state begin
X, V, ETA, ETAV, U, UV, SWAY, SWAYV, CABLE, CABLEV, MOUNT, MOUNTV, ARM = 0, 3, 6, 9, 12, 15, 18, 20, 22, 24, 26, 27, 28
ROTOR, ROTORV, STATES = 31, 34, 37


@njit(cache=True, error_model="numpy")
def _motor(y: FloatArray, ud: FloatArray, dud: FloatArray, i: int, p: Printer) -> tuple[float, float, float]:
    """(u, u̇, v̈), (d_1 s + d_0)/(s² + d_2 s + d_0) on the command, and the ripple of the command's own position."""
    u, du, bend = ud[i], dud[i], 0.0
    if not p.ideal:
        v, dv = y[U + i], y[UV + i]
        bend = p.drive[0] * (ud[i] - v) - p.drive[2] * dv
        u, du = v + p.drive[1] / p.drive[0] * dv, dv + p.drive[1] / p.drive[0] * bend
    if p.ripple[i] != 0.0:
        w = p.ripple_wave[i]
        first, second = w * ud[i], 2.0 * w * ud[i] + p.ripple_phase
        u += p.ripple[i] * (np.sin(first) + p.ripple_second * np.sin(second))
        du += p.ripple[i] * w * dud[i] * (np.cos(first) + 2.0 * p.ripple_second * np.cos(second))
    return u, du, bend


# ---- the whole -----------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def _arms(y: FloatArray, p: Printer, a: FloatArray, q: FloatArray, dq: FloatArray, bend: FloatArray) -> None:
    """Evaluate A : (3, 3), q, q̇, and what q̈ has beside A Ẍ."""
    for i in range(3):
        dx, dy = y[X] - p.towers[i, 0], y[X + 1] - p.towers[i, 1]
        s = np.sqrt(p.arms[i] ** 2 - dx * dx - dy * dy)
        a[i, 0], a[i, 1], a[i, 2] = -dx / s, -dy / s, 1.0
        sink = a[i, 0] * y[V] + a[i, 1] * y[V + 1]
        q[i], dq[i] = y[X + 2] + p.height + s, y[V + 2] + sink
        bend[i] = -(y[V] ** 2 + y[V + 1] ** 2 + sink * sink) / s


@njit(cache=True, error_model="numpy")
def _load_shares(a: FloatArray, p: Printer, gamma: FloatArray) -> None:
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
    """R ← m⁻¹ r by elimination with row pivots; m is spent."""
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
def _mount(y: FloatArray, j: int, p: Printer) -> float:
    """Force of the extruder's mount along axis j, N; beyond a gap it meets a stop."""
    force = p.mount_k[j] * y[ETA + j] + p.mount_b[j] * y[ETAV + j]
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
    y: FloatArray, z: FloatArray, t: float, ud: FloatArray, dud: FloatArray, p: Printer, w: FloatArray, dy: FloatArray
) -> None:
    """Dy = d(state)/dt. z : (6,) bristles of guides and joints. w : (16, 5) work space; row 0 leaves as Ẍ, d̈."""
    r, q, dq, bend, f = w[0], w[1, :3], w[2, :3], w[3, :3], w[4, :3]
    m, a, gamma = w[5:10], w[10:13, :3], w[13:16, :3]
    _arms(y, p, a, q, dq, bend)
    _load_shares(a, p, gamma)
    for j in range(3):
        f[j] = p.joint * z[3 + j] - _mount(y, j, p)
    f[2] += p.holder * GRAVITY
    for j in range(2):
        f[j] -= p.cable_k * y[CABLE + j] + p.cable_b * y[CABLEV + j]
    for i in range(3):
        u, du, bends = _motor(y, ud, dud, i, p)
        if i == p.soft_tower:
            u, du = u + y[MOUNT], du + y[MOUNTV]
        sent, turned = u, du
        if p.rotor[i] > 0.0:
            u, du = y[ROTOR + i], y[ROTORV + i]
        pull = belt(u - q[i], du - dq[i], q[i], ud[i], y[ARM + i], t, i, p)
        if p.rotor[i] > 0.0:
            dy[ROTOR + i] = du
            dy[ROTORV + i] = (p.rotor_k[i] * (sent - u) + p.rotor_b[i] * (turned - du) - pull) / p.rotor[i]
        if i == p.soft_tower:
            dy[MOUNT] = y[MOUNTV]
            dy[MOUNTV] = -(pull + p.soft_k * y[MOUNT] + p.soft_b * y[MOUNTV]) / p.soft_mass
        dy[U + i], dy[UV + i] = y[UV + i], bends
        dy[ARM + i] = (u - q[i] - y[ARM + i]) / p.visco_s if p.visco_k[i] > 0.0 else 0.0
        r[i] = pull - guide(dq[i], q[i], z[i], i, p) - p.carriage[i] * (GRAVITY + bend[i])
        for j in range(3):
            m[i, j] = p.carriage[i] * a[i, j] + p.holder * gamma[i, j]
            r[i] -= gamma[i, j] * f[j]
        for n in range(2):
            m[i, 3 + n] = p.holder * (gamma[i, 0] * p.sway_dir[n, 0] + gamma[i, 1] * p.sway_dir[n, 1])
    if p.rods != 0.0:
        _rods(p.rods, a, gamma, bend, m, r)
    for n in range(2):
        dx, dyy = p.sway_dir[n, 0], p.sway_dir[n, 1]
        m[3 + n, 0], m[3 + n, 1], m[3 + n, 2] = p.holder * dx, p.holder * dyy, 0.0
        for k in range(2):
            m[3 + n, 3 + k] = p.holder * (dx * p.sway_dir[k, 0] + dyy * p.sway_dir[k, 1])
        m[3 + n, 3 + n] += p.sway_mass[n]
        r[3 + n] = -p.sway_k[n] * y[SWAY + n] - p.sway_b[n] * y[SWAYV + n] - dx * f[0] - dyy * f[1]
    _eliminate(m, r)
    _follow(y, r, p, dy)


@njit(cache=True, error_model="numpy")
def _follow(y: FloatArray, r: FloatArray, p: Printer, dy: FloatArray) -> None:
    """Everything that Ẍ and d̈ bring with them."""
    for n in range(2):
        dy[SWAY + n], dy[SWAYV + n] = y[SWAYV + n], r[3 + n]
    for j in range(3):
        felt = r[j]
        if j < 2:
            felt += r[3] * p.sway_dir[0, j] + r[4] * p.sway_dir[1, j]
            hang = p.cable_k * y[CABLE + j] + p.cable_b * y[CABLEV + j]
            dy[CABLE + j], dy[CABLEV + j] = y[CABLEV + j], -felt - hang / p.cable_mass
        dy[X + j], dy[V + j] = y[V + j], r[j]
        dy[ETA + j], dy[ETAV + j] = y[ETAV + j], -_mount(y, j, p) / p.extruder - felt
    dy[ETAV + 2] -= GRAVITY


@njit(cache=True, error_model="numpy")
def _bristles(y: FloatArray, z: FloatArray, span: float, p: Printer, w: FloatArray, out: FloatArray) -> None:
    """Every bristle after `span`, its slider going on at the same speed: ż = v/b - |v| z/b, solved exactly."""
    a, q, dq, bend = w[10:13, :3], w[1, :3], w[2, :3], w[3, :3]
    if p.dry_kind >= DAHL:
        _arms(y, p, a, q, dq, bend)
        for i in range(3):
            out[i] = bent(z[i], dq[i], span, p)
    if p.joint > 0.0:
        speed = np.sqrt(y[V] ** 2 + y[V + 1] ** 2 + y[V + 2] ** 2)
        for j in range(3):
            out[3 + j] = slid(z[3 + j], y[V + j], speed, span, p.joint_bristle)


@njit(cache=True, error_model="numpy")
def _keep(y: FloatArray, w: FloatArray, p: Printer, out: FloatArray) -> None:
    """Out : (4, 3): carriages and nozzle, positions; then their accelerations, the nozzle's against the ground."""
    for i in range(3):
        acc = w[10 + i, 0] * w[0, 0] + w[10 + i, 1] * w[0, 1] + w[0, 2] + w[3, i]
        out[0, i], out[1, i], out[2, i], out[3, i] = w[1, i], y[X + i], acc, w[0, i]
    for n in range(2):
        out[3, 0] += p.sway_dir[n, 0] * w[0, 3 + n]
        out[3, 1] += p.sway_dir[n, 1] * w[0, 3 + n]


@njit(cache=True, error_model="numpy")
def _ahead(y: FloatArray, by: float, slope: FloatArray, out: FloatArray) -> None:
    for j in range(STATES):
        out[j] = y[j] + by * slope[j]


@njit(cache=True, error_model="numpy")
def run(command: FloatArray, speed: FloatArray, h: float, every: int, y: FloatArray, p: Printer) -> FloatArray:
    """Play a command from a state of rest; y : (STATES,) is left as the last state.

    command, speed : (2 n + 1, 3) m, m/s at half steps. Returns (n // every + 1, 4, 3), see `_keep`.
    """
    steps = (len(command) - 1) // 2
    out = np.empty((steps // every + 1, 4, 3))
    w = np.zeros((16, 5))
    z, half, full = np.zeros(6), np.zeros(6), np.zeros(6)
    k1, k2, k3, k4 = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    mid = np.zeros(STATES)
    bristly = p.dry_kind >= DAHL or p.joint > 0.0
    for n in range(steps + 1):
        b, t = 2 * n, n * h
        _rate(y, z, t, command[b], speed[b], p, w, k1)
        if n % every == 0:
            _keep(y, w, p, out[n // every])
        if n == steps:
            break
        _ahead(y, h / 2, k1, mid)
        if bristly:
            _bristles(mid, z, h / 2, p, w, half)
            _bristles(mid, z, h, p, w, full)
        _rate(mid, half, t + h / 2, command[b + 1], speed[b + 1], p, w, k2)
        _ahead(y, h / 2, k2, mid)
        _rate(mid, half, t + h / 2, command[b + 1], speed[b + 1], p, w, k3)
        _ahead(y, h, k3, mid)
        _rate(mid, full, t + h, command[b + 2], speed[b + 2], p, w, k4)
        for j in range(STATES):
            y[j] += h / 6 * (k1[j] + 2 * k2[j] + 2 * k3[j] + k4[j])
        z[:] = full
    return out


# ---- rest ----------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def _solved(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return x of a x = b, (3,), by Cramer's rule: numba takes five seconds to compile `np.linalg.solve`."""
    x, whole = np.empty(3), 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        whole += a[0, i] * (a[1, j] * a[2, k] - a[1, k] * a[2, j])
        x[i] = 0.0
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            x[i] += b[r] * (a[s, j] * a[t, k] - a[s, k] * a[t, j])
    return x / whole


@njit(cache=True, error_model="numpy")
def rest(xyz: FloatArray, command: FloatArray, p: Printer) -> FloatArray:
    """Evaluate the state : (STATES,) of rest under a command : (3,) m, near the nozzle xyz : (3,) m, loaded."""
    y = np.zeros(STATES)
    y[X : X + 3], y[U : U + 3] = xyz, command
    y[ETA + 2] = -p.extruder * GRAVITY / p.mount_k[2]
    a, gamma, target = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    q, dq, bend = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(8):
        for _ in range(20):  # Newton: the nozzle of the wanted carriages
            _arms(y, p, a, q, dq, bend)
            _load_shares(a, p, gamma)
            wanted = target if target[0] != 0.0 else command
            step = _solved(a, wanted - q)
            y[X : X + 3] += step
            if np.max(np.abs(step)) < 1e-15:
                break
        for i in range(3):
            load = (p.carriage[i] + gamma[i, 2] * (p.holder + p.extruder)) * GRAVITY + guide(0.0, q[i], 0.0, i, p)
            target[i] = _hung(y, command, q[i], load, i, p)
    return y


@njit(cache=True, error_model="numpy")
def _hung(y: FloatArray, command: FloatArray, q: float, load: float, i: int, p: Printer) -> float:
    """Height of carriage i at which its belt bears a load, by bisection. Fills what else has moved at rest."""
    u = _motor(y, command, np.zeros(3), i, p)[0]
    if i == p.soft_tower:
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
