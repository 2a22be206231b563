"""The nonlinear printer, compiled. SI throughout; towers and carriages A, B, C; `printer.py` is the way in.

The unknowns are the carriages' heights q. With s_i the joint vector of arm i, h_i = −s_i·ẑ, and −h_i (s_j × s_k)/det S
the column of J = −S⁻¹ diag(h) (paper, Eq. 12) that is carriage i's,

    Ẍ = J (q̈ + w),   w_i = |Ẋ − ẑ q̇_i|²/h_i         (J̇ q̇ = J w; Eq. 13 with its sign put right)
    a = Ẍ + D d̈                                     the nozzle seen from the ground, d the frame's sway along D
    F = M₁ a + M₁ g ẑ − K η − B η̇ + joint friction   what the arms must give to the nozzle holder (Eqs. 50-55)
    m q̈ = belt(s, ṡ) − b q̇ − friction − m g − Γ F,   s = u − q (Eqs. 32, 44); Γ = Jᵀ, or rows J_iᵀ P_i (Eq. 25)
    η̈ = −a − g ẑ − (K η + B η̇)/m₂
    M_f (d̈ + 2 ζ ω ḋ + ω² d) = −Dᵀ F

d̈ is eliminated by hand: with μ = M₁/(M_f + M₁), R = I − μ D Dᵀ and ρ = 2 ζ ω ḋ + ω² d

    F = R (M₁ J (q̈ + w) + f₀) − M₁ (1 − μ) D ρ,   f₀ = M₁ g ẑ − K η − B η̇ + joint friction,

so three equations for q̈ remain. The drive (Eq. 34) is v̈ = d₀ (u_d − v) − d₂ v̇, u = v + (d₁/d₀) v̇.

Dry friction of force ℓ has a memory φ of how far it has been strained. With r = q̇/v₀,

    F = ℓ tanh(r + φ),   φ̇ = κ (r − |r| φ/φ_m − r² φ)/(1 + r²)

In quick motion φ vanishes and this is ℓ tanh(q̇/v₀), odd about the reversal. Below v₀ strain builds up over v₀/κ, ten
micrometres as in rolling guides, and then holds a carriage truly at rest under any load up to ℓ tanh φ_m. Steady
sliding, however slow, feels at least 0.93 ℓ. (Dahl's presliding, 1968, that lets go at speed.) It is smooth, and as
stiff as ℓ/v₀: `printer.py` sees to the step. With κ = 0 nothing ever holds: any load creeps.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numba import njit

from models.machine import FloatArray

# Parts of a state, three numbers each: drive, carriages, extruder against nozzle, frame (its last two idle),
# strain of the guides' and of the joints' dry friction.
V, VD, Q, QD, ETA, ETAD, D, DD, GUIDE, JOINT = range(0, 30, 3)
STATES = 30

MOST_STRAIN = 3.0  # φ_m

REST_PASSES = 2000
REST_TOLERANCE_M = 1e-13
PROBE_M = 1e-8

# The numbers of one printer. A record and no class: plain memory for the loops, and numba can keep what it compiled.
NUMBERS = np.dtype(
    [
        ("towers", "f8", (3, 2)),  # m, DeltaGeometry.towers_mm
        ("arms_squared", "f8", 3),  # m²
        ("height", "f8"),  # m, joint plane above the nozzle tip
        ("to_plane", "f8", (2, 2)),  # 1/m, inverse of the joints B and C seen from A
        ("offset", "f8", 2),  # m², what is constant in the spheres' differences
        ("carriage_mass", "f8", 3),  # kg, m = m_c + m_f/2
        ("belt_k", "f8", 3),  # N/m
        ("belt_c", "f8", 3),  # N s/m
        ("guide_b", "f8", 3),  # N s/m
        ("ideal_drive", "?"),  # u = u_d
        ("drive", "f8", 3),  # d0 1/s², d1 1/s, d2 1/s
        ("shares", "f8", (3, 3, 3)),  # P_i of Eq. 25: arm, component of its force, component of the whole force
        ("holder_mass", "f8"),  # kg, M₁ = m_1 + 3 m_f/2
        ("extruder_mass", "f8"),  # kg, m_2
        ("mount_k", "f8", 3),  # N/m
        ("mount_b", "f8", 3),  # N s/m
        ("gravity", "f8"),  # m/s²
        # effects; zero, or what does nothing, where absent
        ("cubic", "f8", 3),  # N/m³, belt_hardening
        (
            "give",
            "f8",
            3,
        ),  # m, stretch at which a softening belt pulls its most, √(k/(−3 k₃)): beyond, no more, no less
        ("slope", "f8", 3),  # 1/m, belt_position_stiffness
        ("centre", "f8", 3),  # m
        ("half_play", "f8", 3),  # m, belt_backlash
        ("bend", "f8", 3),  # 1/m, 1/a of torque_angle
        ("delay", "f8", 3),  # s, command_delay
        ("ripple", "f8", 3),  # m, cogging
        ("wave", "f8", 3),  # rad/m
        ("dry", "f8", 3),  # N, coulomb_friction and stribeck_friction
        ("sticking", "f8", 3),  # N, surplus at rest
        ("fading", "f8", 3),  # s/m, 1/v_s
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
Numbers: TypeAlias = np.record


@njit(cache=True, error_model="numpy", nogil=True)
def command(u: FloatArray, pieces: FloatArray, interval: int, since: float, dt: float, p: Numbers) -> None:
    """What the motors are told at the time `since` the beginning of an interval.

    pieces : (n, 3, 4) cubics of each interval and tower, m, highest power first.
    u : (3, 4), filled with the command, its rate, and the ripple of the motor's position and its rate.
    """
    for i in range(3):
        j, t = interval, since - p.delay[i]
        while t < 0.0 and j > 0:
            j -= 1
            t += dt
        if t < 0.0:  # before the first row: at rest there
            u[i, 0], u[i, 1] = pieces[0, i, 3], 0.0
        else:
            a, b, c, d = pieces[j, i, 0], pieces[j, i, 1], pieces[j, i, 2], pieces[j, i, 3]
            u[i, 0] = ((a * t + b) * t + c) * t + d
            u[i, 1] = (3.0 * a * t + 2.0 * b) * t + c
        if p.ripple[i] != 0.0:
            u[i, 2] = p.ripple[i] * math.sin(p.wave[i] * u[i, 0])
            u[i, 3] = p.ripple[i] * p.wave[i] * math.cos(p.wave[i] * u[i, 0]) * u[i, 1]


@njit(cache=True, error_model="numpy", nogil=True)
def motor(y: FloatArray, u: FloatArray, i: int, p: Numbers) -> tuple[float, float, float]:
    """(u, u̇, v̈) of motor i."""
    if p.ideal_drive:
        return u[i, 0] + u[i, 2], u[i, 1] + u[i, 3], 0.0
    lead = p.drive[1] / p.drive[0]
    v, vd = y[V + i], y[VD + i]
    vdd = p.drive[0] * (u[i, 0] - v) - p.drive[2] * vd
    return v + lead * vd + u[i, 2], vd + lead * vdd + u[i, 3], vdd


@njit(cache=True, error_model="numpy", nogil=True)
def belt_force(stretch: float, rate: float, height: float, i: int, p: Numbers) -> float:
    """Of belt and motor i on its carriage: slack, hardening, the motor's sine, stiffness by height."""
    if abs(stretch) < p.half_play[i]:
        return 0.0
    s = stretch - math.copysign(p.half_play[i], stretch)
    s = min(max(s, -p.give[i]), p.give[i])
    spring = math.sin(p.bend[i] * s) / p.bend[i] if p.bend[i] != 0.0 else s
    stiffness = p.belt_k[i] * (1.0 + p.slope[i] * (height - p.centre[i]))
    return stiffness * spring + p.cubic[i] * s * s * s + p.belt_c[i] * rate


@njit(cache=True, error_model="numpy", nogil=True)
def strain_rate(hold: float, ratio: float, speed: float, strain: float) -> float:
    """φ̇ along one direction: `hold` = κ, `ratio` = r along it, `speed` = |r|."""
    return hold * (ratio - (speed / MOST_STRAIN + speed * speed) * strain) / (1.0 + speed * speed)


@njit(cache=True, error_model="numpy", nogil=True)
def guide_friction(y: FloatArray, i: int, p: Numbers, dy: FloatArray) -> float:
    """Dry friction against carriage i: positive when it moves up. Fills dy with the rate of its strain."""
    level, speed = p.dry[i], y[QD + i]
    if p.sticking[i] != 0.0:
        level += p.sticking[i] * math.exp(-((speed * p.fading[i]) ** 2))
    if level == 0.0:
        return 0.0
    ratio = speed / p.creep[i]
    dy[GUIDE + i] = strain_rate(p.hold[i], ratio, abs(ratio), y[GUIDE + i])
    return level * math.tanh(ratio + y[GUIDE + i])


@njit(cache=True, error_model="numpy", nogil=True)
def joint_friction(y: FloatArray, p: Numbers, w: Work, dy: FloatArray) -> None:
    """w.friction = dry friction against the nozzle holder, along its motion; dy: the rate of its strain."""
    over = 1.0 / p.joint_creep
    speed = over * math.sqrt(w.xd[0] * w.xd[0] + w.xd[1] * w.xd[1] + w.xd[2] * w.xd[2])
    squared = 0.0
    for a in range(3):
        dy[JOINT + a] = strain_rate(p.joint_hold, over * w.xd[a], speed, y[JOINT + a])
        w.friction[a] = over * w.xd[a] + y[JOINT + a]
        squared += w.friction[a] * w.friction[a]
    size = math.sqrt(squared)
    scale = p.joint_dry * math.tanh(size) / size if size > 0.0 else 0.0
    for a in range(3):
        w.friction[a] *= scale


@njit(cache=True, error_model="numpy", nogil=True)
def place(y: FloatArray, p: Numbers, w: Work) -> None:
    """w.x = the nozzle of the carriages y[Q:Q+3]: `models.kinematics.delta.forward` for one point."""
    rise_b, rise_c = y[Q + 1] - y[Q], y[Q + 2] - y[Q]
    off_b, off_c = p.offset[0] + 0.5 * rise_b * rise_b, p.offset[1] + 0.5 * rise_c * rise_c
    ux, uy = p.to_plane[0, 0] * off_b + p.to_plane[0, 1] * off_c, p.to_plane[1, 0] * off_b + p.to_plane[1, 1] * off_c
    vx = -(p.to_plane[0, 0] * rise_b + p.to_plane[0, 1] * rise_c)
    vy = -(p.to_plane[1, 0] * rise_b + p.to_plane[1, 1] * rise_c)
    a, b = 1.0 + vx * vx + vy * vy, ux * vx + uy * vy
    drop = -(b + math.sqrt(b * b - a * (ux * ux + uy * uy - p.arms_squared[0]))) / a
    w.x[0], w.x[1] = p.towers[0, 0] + ux + vx * drop, p.towers[0, 1] + uy + vy * drop
    w.x[2] = y[Q] - p.height + drop


@njit(cache=True, error_model="numpy", nogil=True)
def jacobian(p: Numbers, w: Work) -> None:
    """s_i and J at the nozzle w.x."""
    s, j = w.arms, w.j
    for i in range(3):
        sx, sy = w.x[0] - p.towers[i, 0], w.x[1] - p.towers[i, 1]
        s[i, 0], s[i, 1], s[i, 2] = sx, sy, -math.sqrt(p.arms_squared[i] - sx * sx - sy * sy)
    for i in range(3):
        b, c = (i + 1) % 3, (i + 2) % 3
        j[0, i] = s[b, 1] * s[c, 2] - s[b, 2] * s[c, 1]
        j[1, i] = s[b, 2] * s[c, 0] - s[b, 0] * s[c, 2]
        j[2, i] = s[b, 0] * s[c, 1] - s[b, 1] * s[c, 0]
    over_det = 1.0 / (s[0, 0] * j[0, 0] + s[0, 1] * j[1, 0] + s[0, 2] * j[2, 0])
    for i in range(3):
        scale = s[i, 2] * over_det
        j[0, i], j[1, i], j[2, i] = scale * j[0, i], scale * j[1, i], scale * j[2, i]


@njit(cache=True, error_model="numpy", nogil=True)
def solve3(m: FloatArray, r: FloatArray, out: FloatArray, at: int) -> None:
    """m out[at:at+3] = r by cofactors; m : (3, 3) need not be symmetric."""
    c0 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    c1 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c2 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    over_det = 1.0 / (m[0, 0] * c0 + m[0, 1] * c1 + m[0, 2] * c2)
    d0 = m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]
    d1 = m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]
    d2 = m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]
    e0 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    e1 = m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]
    e2 = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    out[at] = (c0 * r[0] + d0 * r[1] + e0 * r[2]) * over_det
    out[at + 1] = (c1 * r[0] + d1 * r[1] + e1 * r[2]) * over_det
    out[at + 2] = (c2 * r[0] + d2 * r[1] + e2 * r[2]) * over_det


# What one evaluation hands from function to function.
WORK = np.dtype(
    [
        ("x", "f8", 3),  # m, nozzle against the bed
        ("xd", "f8", 3),  # m/s
        ("acc", "f8", 3),  # m/s², nozzle against the ground, a
        ("arms", "f8", (3, 3)),  # m, rows s_i
        ("j", "f8", (3, 3)),  # J, rows X Y Z, columns A B C
        ("gamma", "f8", (3, 3)),  # Γ, rows A B C, columns X Y Z
        ("bend", "f8", 3),  # m/s², w
        ("pull", "f8", 3),  # N, all forces on the carriages but the effector's; then those too
        ("f0", "f8", 3),  # N
        ("friction", "f8", 3),  # N, of the joints
        ("load", "f8", 3),  # N, R (M₁ J w + f₀) − M₁ (1 − μ) D ρ
        ("column", "f8", 3),
        ("mass", "f8", (3, 3)),  # kg
    ]
)
Work: TypeAlias = np.record


@njit(cache=True, error_model="numpy", nogil=True)
def _towers(y: FloatArray, u: FloatArray, p: Numbers, w: Work, dy: FloatArray) -> None:
    """Drives, belts, guides: w.pull = all forces on the carriages but the effector's."""
    for i in range(3):
        q, qd = y[Q + i], y[QD + i]
        position, speed, vdd = motor(y, u, i, p)
        dy[V + i], dy[VD + i], dy[Q + i] = y[VD + i], vdd, qd
        friction = guide_friction(y, i, p, dy)
        belt = belt_force(position - q, speed - qd, q, i, p)
        w.pull[i] = belt - p.guide_b[i] * qd - friction - p.carriage_mass[i] * p.gravity


@njit(cache=True, error_model="numpy", nogil=True)
def _arms(y: FloatArray, p: Numbers, w: Work) -> None:
    """Where the nozzle is and how it moves, J, Γ, and w_i = |Ẋ − ẑ q̇_i|²/h_i."""
    place(y, p, w)
    jacobian(p, w)
    for a in range(3):
        w.xd[a] = w.j[a, 0] * y[QD] + w.j[a, 1] * y[QD + 1] + w.j[a, 2] * y[QD + 2]
    for i in range(3):
        sink = w.xd[2] - y[QD + i]
        w.bend[i] = -(w.xd[0] * w.xd[0] + w.xd[1] * w.xd[1] + sink * sink) / w.arms[i, 2]
        for b in range(3):
            along = w.j[0, i] * p.shares[i, 0, b] + w.j[1, i] * p.shares[i, 1, b]
            w.gamma[i, b] = along + w.j[2, i] * p.shares[i, 2, b]


@njit(cache=True, error_model="numpy", nogil=True)
def _holder(y: FloatArray, p: Numbers, w: Work, dy: FloatArray) -> None:
    """f₀, the extruder's own part of η̈, and the joints' friction."""
    if p.joint_dry != 0.0:
        joint_friction(y, p, w, dy)
    for a in range(3):
        mount = p.mount_k[a] * y[ETA + a] + p.mount_b[a] * y[ETAD + a]
        dy[ETA + a], dy[ETAD + a] = y[ETAD + a], -mount / p.extruder_mass
        w.f0[a] = w.friction[a] - mount
    dy[ETAD + 2] -= p.gravity
    w.f0[2] += p.holder_mass * p.gravity


@njit(cache=True, error_model="numpy", nogil=True)
def _swayed(vector: FloatArray, p: Numbers) -> None:
    """vector ← R vector, R = I − μ D Dᵀ."""
    for n in range(2):
        along = p.sway_share * (p.sway[n, 0] * vector[0] + p.sway[n, 1] * vector[1])
        vector[0] -= along * p.sway[n, 0]
        vector[1] -= along * p.sway[n, 1]


@njit(cache=True, error_model="numpy", nogil=True)
def _coupled(y: FloatArray, p: Numbers, w: Work, dy: FloatArray) -> None:
    """Solve for q̈: (m I + Γ R M₁ J) q̈ = pull − Γ (R (M₁ J w + f₀) − M₁ (1 − μ) D ρ)."""
    for a in range(3):
        along = w.j[a, 0] * w.bend[0] + w.j[a, 1] * w.bend[1] + w.j[a, 2] * w.bend[2]
        w.load[a] = p.holder_mass * along + w.f0[a]
    _swayed(w.load, p)
    for n in range(2):
        rho = p.holder_mass * (1.0 - p.sway_share) * (p.sway_k * y[D + n] + p.sway_b * y[DD + n])
        w.load[0] -= rho * p.sway[n, 0]
        w.load[1] -= rho * p.sway[n, 1]
    for k in range(3):
        for a in range(3):
            w.column[a] = p.holder_mass * w.j[a, k]
        _swayed(w.column, p)
        for i in range(3):
            w.mass[i, k] = w.gamma[i, 0] * w.column[0] + w.gamma[i, 1] * w.column[1] + w.gamma[i, 2] * w.column[2]
        w.mass[k, k] += p.carriage_mass[k]
        w.pull[k] -= w.gamma[k, 0] * w.load[0] + w.gamma[k, 1] * w.load[1] + w.gamma[k, 2] * w.load[2]
    solve3(w.mass, w.pull, dy, QD)


@njit(cache=True, error_model="numpy", nogil=True)
def _followers(y: FloatArray, p: Numbers, w: Work, dy: FloatArray) -> None:
    """What q̈ brings with it: a, and the frame's and the extruder's accelerations."""
    b0, b1, b2 = dy[QD] + w.bend[0], dy[QD + 1] + w.bend[1], dy[QD + 2] + w.bend[2]
    for a in range(3):
        w.acc[a] = w.j[a, 0] * b0 + w.j[a, 1] * b1 + w.j[a, 2] * b2
    if p.sway_share != 0.0:
        _sway(y, p, w, dy)
    for a in range(3):
        dy[ETAD + a] -= w.acc[a]


@njit(cache=True, error_model="numpy", nogil=True)
def _sway(y: FloatArray, p: Numbers, w: Work, dy: FloatArray) -> None:
    """d̈ = −(1 − μ) ρ − μ Dᵀ (Ẍ + f₀/M₁) along each D; the nozzle's acceleration is then seen from the ground."""
    shake_x, shake_y = w.acc[0] + w.f0[0] / p.holder_mass, w.acc[1] + w.f0[1] / p.holder_mass
    for n in range(2):
        rho = p.sway_k * y[D + n] + p.sway_b * y[DD + n]
        along = p.sway[n, 0] * shake_x + p.sway[n, 1] * shake_y
        dy[D + n] = y[DD + n]
        dy[DD + n] = -(1.0 - p.sway_share) * rho - p.sway_share * along
        w.acc[0] += p.sway[n, 0] * dy[DD + n]
        w.acc[1] += p.sway[n, 1] * dy[DD + n]


@njit(cache=True, error_model="numpy", nogil=True)
def rate(y: FloatArray, u: FloatArray, p: Numbers, w: Work, dy: FloatArray) -> None:
    """dy = d(state)/dt; w keeps the nozzle's motion."""
    _towers(y, u, p, w, dy)
    _arms(y, p, w)
    _holder(y, p, w, dy)
    _coupled(y, p, w, dy)
    _followers(y, p, w, dy)


@njit(cache=True, error_model="numpy", nogil=True)
def _keep(y: FloatArray, dy: FloatArray, u: FloatArray, p: Numbers, w: Work, out: FloatArray) -> None:
    """out : (7, 3): carriages' and nozzle's position, velocity, acceleration, and the motors' positions."""
    for i in range(3):
        out[0, i], out[1, i], out[2, i] = y[Q + i], y[QD + i], dy[QD + i]
        out[3, i], out[4, i], out[5, i] = w.x[i], w.xd[i], w.acc[i]
        out[6, i] = motor(y, u, i, p)[0]


@njit(cache=True, error_model="numpy", nogil=True)
def _advance(y: FloatArray, by: float, slope: FloatArray, out: FloatArray) -> None:
    for n in range(STATES):
        out[n] = y[n] + by * slope[n]


@njit(cache=True, error_model="numpy", nogil=True)
def run(y: FloatArray, pieces: FloatArray, first: int, dt: float, substeps: int, p: Numbers) -> FloatArray:
    """Classical Runge-Kutta of order 4 from interval `first` to the last; y is left as the last state.

    Returns
    -------
    (n + 1, 7, 3) SI for n intervals: a row at each interval's beginning and one at the end; see `_keep`.
    """
    count = len(pieces) - first
    out = np.empty((count + 1, 7, 3))
    u, w = np.zeros((3, 3, 4)), np.zeros(1, dtype=WORK)[0]
    k, between = np.zeros((4, STATES)), np.empty(STATES)
    h = dt / substeps
    for n in range(count):
        interval = first + n
        for sub in range(substeps):
            since = sub * h
            if sub == 0:
                command(u[0], pieces, interval, since, dt, p)
            else:
                u[0] = u[2]
            command(u[1], pieces, interval, since + 0.5 * h, dt, p)
            command(u[2], pieces, interval, since + h, dt, p)
            rate(y, u[0], p, w, k[0])
            if sub == 0:
                _keep(y, k[0], u[0], p, w, out[n])
            _advance(y, 0.5 * h, k[0], between)
            rate(between, u[1], p, w, k[1])
            _advance(y, 0.5 * h, k[1], between)
            rate(between, u[1], p, w, k[2])
            _advance(y, h, k[2], between)
            rate(between, u[2], p, w, k[3])
            for m in range(STATES):
                y[m] += h / 6.0 * (k[0, m] + 2.0 * (k[1, m] + k[2, m]) + k[3, m])
    rate(y, u[2], p, w, k[0])
    _keep(y, k[0], u[2], p, w, out[count])
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def rest(y: FloatArray, p: Numbers) -> float:
    """From y with the drives at their command: let belts and extruder give way until all forces balance.

    Each pass lets every carriage yield by what its forces leave over, divided by its belt's stiffness there.

    Returns
    -------
    m, how far the last pass still moved a carriage.
    """
    u, w, dy = np.zeros((3, 4)), np.zeros(1, dtype=WORK)[0], np.zeros(STATES)
    for i in range(3):
        u[i, 0], u[i, 2] = y[V + i], p.ripple[i] * math.sin(p.wave[i] * y[V + i])
    y[ETA + 2] = -p.extruder_mass * p.gravity / p.mount_k[2]
    moved = np.inf
    for _ in range(REST_PASSES):
        rate(y, u, p, w, dy)
        moved = 0.0
        for i in range(3):
            height, stretch = y[Q + i], motor(y, u, i, p)[0] - y[Q + i]
            gain = belt_force(stretch + PROBE_M, 0.0, height, i, p) - belt_force(stretch, 0.0, height, i, p)
            move = w.pull[i] / max(p.belt_k[i], gain / PROBE_M)
            y[Q + i] += move
            if not abs(move) <= moved:  # NaN too
                moved = abs(move)
        if moved < REST_TOLERANCE_M:
            break
    return moved
