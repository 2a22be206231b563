"""Solve the coupled equations of a delta's carriages, effector, extruder and frame."""

from __future__ import annotations

import math

from models.arrays import FloatArray
from models.printer.kernels.record import (
    ACC,
    ARMS,
    CENTRIPETAL,
    DD,
    ETA,
    ETAD,
    F0,
    JOINTS,
    LANES,
    NOW,
    PULL,
    QD,
    RATE,
    RHO,
    XD,
    D,
    J,
    Q,
    Vector,
    X,
    parameter_rows,
)
from models.printer.kernels.vectors import add, at, combine, compiled, cross, dot, inlined, put, scale, solve, vector

TOWERS, ARMS_SQUARED, HEIGHT = parameter_rows("towers", "arms_squared", "height")
TO_PLANE, OFFSET = parameter_rows("to_plane", "offset")
CARRIAGE_MASS, SHARES, GRAVITY = parameter_rows("carriage_mass", "shares", "gravity")
HOLDER_MASS, EXTRUDER_MASS, MOUNT_K, MOUNT_B = parameter_rows("holder_mass", "extruder_mass", "mount_k", "mount_b")
DIRECTIONS, MASS_RATIO = parameter_rows("frame_directions", "frame_mass_ratio")
FRAME_K, FRAME_B, ARM_INERTIA = parameter_rows("frame_k", "frame_b", "arm_inertia")


@inlined
def _nozzle(m: FloatArray, l: int) -> Vector:
    """Return the nozzle's position: `models.kinematics.delta.forward` for one point."""
    q = vector(m, NOW + Q, l)
    rise_b, rise_c = q[1] - q[0], q[2] - q[0]
    off_b, off_c = at(m, OFFSET, l) + 0.5 * rise_b * rise_b, at(m, OFFSET + 1, l) + 0.5 * rise_c * rise_c
    xb, xc, yb, yc = at(m, TO_PLANE, l), at(m, TO_PLANE + 1, l), at(m, TO_PLANE + 2, l), at(m, TO_PLANE + 3, l)
    ux, uy = xb * off_b + xc * off_c, yb * off_b + yc * off_c
    vx, vy = -(xb * rise_b + xc * rise_c), -(yb * rise_b + yc * rise_c)
    a, b = 1.0 + vx * vx + vy * vy, ux * vx + uy * vy
    drop = -(b + math.sqrt(b * b - a * (ux * ux + uy * uy - at(m, ARMS_SQUARED, l)))) / a
    x, y = at(m, TOWERS, l) + ux + vx * drop, at(m, TOWERS + 1, l) + uy + vy * drop
    return x, y, q[0] - at(m, HEIGHT, l) + drop


@inlined
def _arm(m: FloatArray, i: int, x: Vector, l: int) -> Vector:
    """Return s_i with the nozzle at x."""
    sx, sy = x[0] - at(m, TOWERS + 2 * i, l), x[1] - at(m, TOWERS + 2 * i + 1, l)
    return sx, sy, -math.sqrt(at(m, ARMS_SQUARED + i, l) - sx * sx - sy * sy)


@compiled
def arm_kinematics(m: FloatArray) -> None:
    """Evaluate the nozzle's position and velocity, J, and w_i = |Ẋ − ẑ q̇_i|²/h_i."""
    for l in range(LANES):
        x, qd = _nozzle(m, l), vector(m, NOW + QD, l)
        a, b, c = _arm(m, 0, x, l), _arm(m, 1, x, l), _arm(m, 2, x, l)
        bc = cross(b, c)
        over_det = 1.0 / dot(a, bc)
        j_a, j_b = scale(a[2] * over_det, bc), scale(b[2] * over_det, cross(c, a))
        j_c = scale(c[2] * over_det, cross(a, b))
        xd = combine(qd, j_a, j_b, j_c)
        level = xd[0] * xd[0] + xd[1] * xd[1]
        sink_a, sink_b, sink_c = xd[2] - qd[0], xd[2] - qd[1], xd[2] - qd[2]
        w_a, w_b = -(level + sink_a * sink_a) / a[2], -(level + sink_b * sink_b) / b[2]
        put(m, CENTRIPETAL, l, (w_a, w_b, -(level + sink_c * sink_c) / c[2]))
        put(m, J, l, j_a)
        put(m, J + 3, l, j_b)
        put(m, J + 6, l, j_c)
        put(m, X, l, x)
        put(m, XD, l, xd)


@compiled
def holder_forces(m: FloatArray) -> None:
    """Evaluate f₀, ρ, and the extruder's own part of η̈."""
    for l in range(LANES):
        gravity, over = at(m, GRAVITY, l), 1.0 / at(m, EXTRUDER_MASS, l)
        for a in range(3):
            eta, etad = at(m, NOW + ETA + a, l), at(m, NOW + ETAD + a, l)
            mount = at(m, MOUNT_K + a, l) * eta + at(m, MOUNT_B + a, l) * etad
            m[(RATE + ETA + a) * LANES + l], m[(RATE + ETAD + a) * LANES + l] = etad, -over * mount
            m[(F0 + a) * LANES + l] = at(m, JOINTS + a, l) - mount
            d, dd = at(m, NOW + D + a, l), at(m, NOW + DD + a, l)
            m[(RHO + a) * LANES + l], m[(RATE + D + a) * LANES + l] = at(m, FRAME_K, l) * d + at(m, FRAME_B, l) * dd, dd
        m[(RATE + ETAD + 2) * LANES + l] -= gravity
        m[(F0 + 2) * LANES + l] += at(m, HOLDER_MASS, l) * gravity


@inlined
def _frame_directions(m: FloatArray, l: int) -> tuple[Vector, Vector]:
    """Return the two columns of D."""
    d_a = at(m, DIRECTIONS, l), at(m, DIRECTIONS + 1, l), 0.0
    d_b = at(m, DIRECTIONS + 2, l), at(m, DIRECTIONS + 3, l), 0.0
    return d_a, d_b


@inlined
def _with_frame_reaction(m: FloatArray, force: Vector, l: int) -> Vector:
    """Return R force, R = I − μ D Dᵀ."""
    mu, (d_a, d_b) = at(m, MASS_RATIO, l), _frame_directions(m, l)
    return combine((1.0, -mu * dot(d_a, force), -mu * dot(d_b, force)), force, d_a, d_b)


@inlined
def _load_row(m: FloatArray, i: int, j_i: Vector, l: int) -> Vector:
    """Return row J_iᵀ P_i of Γ."""
    share = SHARES + 9 * i
    return combine(j_i, vector(m, share, l), vector(m, share + 3, l), vector(m, share + 6, l))


@inlined
def _load(m: FloatArray, l: int) -> Vector:
    """Return R (M₁ J w + f₀) − M₁ (1 − μ) D ρ."""
    mass, rho, (d_a, d_b) = at(m, HOLDER_MASS, l), vector(m, RHO, l), _frame_directions(m, l)
    centripetal = combine(vector(m, CENTRIPETAL, l), vector(m, J, l), vector(m, J + 3, l), vector(m, J + 6, l))
    free = _with_frame_reaction(m, add(scale(mass, centripetal), vector(m, F0, l)), l)
    still = -mass * (1.0 - at(m, MASS_RATIO, l))
    return combine((1.0, still * rho[0], still * rho[1]), free, d_a, d_b)


@compiled
def mass_along_arms(m: FloatArray) -> None:
    """Evaluate −ν Σ R_iᵀ R_i = −ν (3 JᵀJ − z 1ᵀ − 1 zᵀ + I), z = Jᵀẑ, and add ν Σ R_iᵀ J w to the pull."""
    for l in range(LANES):
        j_a, j_b, j_c = vector(m, J, l), vector(m, J + 3, l), vector(m, J + 6, l)
        nu = at(m, ARM_INERTIA, l)
        put(m, ARMS, l, (_same_arm(nu, j_a), _same_arm(nu, j_b), _same_arm(nu, j_c)))
        put(m, ARMS + 3, l, (_both_arms(nu, j_a, j_b), _both_arms(nu, j_a, j_c), _both_arms(nu, j_b, j_c)))
        turn = scale(nu, combine(vector(m, CENTRIPETAL, l), j_a, j_b, j_c))
        by_a, by_b, by_c = 3.0 * dot(j_a, turn), 3.0 * dot(j_b, turn), 3.0 * dot(j_c, turn)
        put(m, PULL, l, add(vector(m, PULL, l), (by_a - turn[2], by_b - turn[2], by_c - turn[2])))


@inlined
def _same_arm(nu: float, j: Vector) -> float:
    return -nu * (3.0 * dot(j, j) - 2.0 * j[2] + 1.0)


@inlined
def _both_arms(nu: float, j: Vector, other: Vector) -> float:
    return -nu * (3.0 * dot(j, other) - j[2] - other[2])


@compiled
def solve_carriages(m: FloatArray) -> None:
    """Solve for q̈: (m I + Γ R M₁ J + arms) q̈ = pull − Γ (R (M₁ J w + f₀) − M₁ (1 − μ) D ρ)."""
    for l in range(LANES):
        j_a, j_b, j_c = vector(m, J, l), vector(m, J + 3, l), vector(m, J + 6, l)
        mass, inertia, load = at(m, HOLDER_MASS, l), vector(m, CARRIAGE_MASS, l), _load(m, l)
        a, b, c = scale(mass, j_a), scale(mass, j_b), scale(mass, j_c)
        a, b, c = _with_frame_reaction(m, a, l), _with_frame_reaction(m, b, l), _with_frame_reaction(m, c, l)
        g_a, g_b, g_c = _load_row(m, 0, j_a, l), _load_row(m, 1, j_b, l), _load_row(m, 2, j_c, l)
        pull = add(vector(m, PULL, l), (-dot(g_a, load), -dot(g_b, load), -dot(g_c, load)))
        put(m, PULL, l, pull)
        inertia, (ab, ac, bc) = add(inertia, vector(m, ARMS, l)), vector(m, ARMS + 3, l)
        row_a = dot(g_a, a) + inertia[0], dot(g_a, b) + ab, dot(g_a, c) + ac
        row_b = dot(g_b, a) + ab, dot(g_b, b) + inertia[1], dot(g_b, c) + bc
        row_c = dot(g_c, a) + ac, dot(g_c, b) + bc, dot(g_c, c) + inertia[2]
        put(m, RATE + QD, l, solve(row_a, row_b, row_c, pull))


@compiled
def effector_and_frame(m: FloatArray) -> None:
    """Evaluate what follows from q̈: a, η̈, and d̈ = −(1 − μ) ρ − μ Dᵀ (Ẍ + f₀/M₁)."""
    for l in range(LANES):
        mu, rho, (d_a, d_b) = at(m, MASS_RATIO, l), vector(m, RHO, l), _frame_directions(m, l)
        q_part = add(vector(m, RATE + QD, l), vector(m, CENTRIPETAL, l))
        acc = combine(q_part, vector(m, J, l), vector(m, J + 3, l), vector(m, J + 6, l))
        free = add(acc, scale(1.0 / at(m, HOLDER_MASS, l), vector(m, F0, l)))
        frame_a = -(1.0 - mu) * rho[0] - mu * dot(d_a, free)
        frame_b = -(1.0 - mu) * rho[1] - mu * dot(d_b, free)
        acc = combine((1.0, frame_a, frame_b), acc, d_a, d_b)
        put(m, ACC, l, acc)
        put(m, RATE + DD, l, (frame_a, frame_b, 0.0))
        put(m, RATE + ETAD, l, add(vector(m, RATE + ETAD, l), scale(-1.0, acc)))
