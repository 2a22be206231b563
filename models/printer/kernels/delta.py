"""Solve the coupled equations of a delta's carriages, effector, extruder and frame."""

from __future__ import annotations

import math

from models.arrays import FloatArray
from models.printer.kernels import record as r
from models.printer.kernels.record import LANES, Vector
from models.printer.kernels.vectors import add, at, combine, compiled, cross, dot, inlined, put, scale, solve, vector


@inlined
def _nozzle(m: FloatArray, l: int) -> Vector:
    """Return the nozzle's position: `models.kinematics.delta.forward` for one point."""
    q = vector(m, r.NOW + r.Q, l)
    rise_b, rise_c = q[1] - q[0], q[2] - q[0]
    off_b, off_c = at(m, r.offset, l) + 0.5 * rise_b * rise_b, at(m, r.offset + 1, l) + 0.5 * rise_c * rise_c
    xb, xc, yb, yc = at(m, r.to_plane, l), at(m, r.to_plane + 1, l), at(m, r.to_plane + 2, l), at(m, r.to_plane + 3, l)
    ux, uy = xb * off_b + xc * off_c, yb * off_b + yc * off_c
    vx, vy = -(xb * rise_b + xc * rise_c), -(yb * rise_b + yc * rise_c)
    a, b = 1.0 + vx * vx + vy * vy, ux * vx + uy * vy
    drop = -(b + math.sqrt(b * b - a * (ux * ux + uy * uy - at(m, r.arms_squared, l)))) / a
    x, y = at(m, r.towers, l) + ux + vx * drop, at(m, r.towers + 1, l) + uy + vy * drop
    return x, y, q[0] - at(m, r.height, l) + drop


@inlined
def _arm(m: FloatArray, i: int, x: Vector, l: int) -> Vector:
    """Return s_i with the nozzle at x."""
    sx, sy = x[0] - at(m, r.towers + 2 * i, l), x[1] - at(m, r.towers + 2 * i + 1, l)
    return sx, sy, -math.sqrt(at(m, r.arms_squared + i, l) - sx * sx - sy * sy)


@compiled
def arm_kinematics(m: FloatArray) -> None:
    """Evaluate the nozzle's position and velocity, J, and w_i = |Ẋ − ẑ q̇_i|²/h_i."""
    for l in range(LANES):
        x, qd = _nozzle(m, l), vector(m, r.NOW + r.QD, l)
        a, b, c = _arm(m, 0, x, l), _arm(m, 1, x, l), _arm(m, 2, x, l)
        bc = cross(b, c)
        over_det = 1.0 / dot(a, bc)
        j_a, j_b = scale(a[2] * over_det, bc), scale(b[2] * over_det, cross(c, a))
        j_c = scale(c[2] * over_det, cross(a, b))
        xd = combine(qd, j_a, j_b, j_c)
        level = xd[0] * xd[0] + xd[1] * xd[1]
        sink_a, sink_b, sink_c = xd[2] - qd[0], xd[2] - qd[1], xd[2] - qd[2]
        w_a, w_b = -(level + sink_a * sink_a) / a[2], -(level + sink_b * sink_b) / b[2]
        put(m, r.CENTRIPETAL, l, (w_a, w_b, -(level + sink_c * sink_c) / c[2]))
        put(m, r.J, l, j_a)
        put(m, r.J + 3, l, j_b)
        put(m, r.J + 6, l, j_c)
        put(m, r.X, l, x)
        put(m, r.XD, l, xd)


@compiled
def holder_forces(m: FloatArray) -> None:
    """Evaluate f₀, ρ, and the extruder's own part of η̈."""
    for l in range(LANES):
        gravity, over = at(m, r.gravity, l), 1.0 / at(m, r.extruder_mass, l)
        for a in range(3):
            eta, etad = at(m, r.NOW + r.ETA + a, l), at(m, r.NOW + r.ETAD + a, l)
            mount = at(m, r.mount_k + a, l) * eta + at(m, r.mount_b + a, l) * etad
            m[(r.RATE + r.ETA + a) * LANES + l], m[(r.RATE + r.ETAD + a) * LANES + l] = etad, -over * mount
            m[(r.F0 + a) * LANES + l] = at(m, r.JOINTS + a, l) - mount
            d, dd = at(m, r.NOW + r.D + a, l), at(m, r.NOW + r.DD + a, l)
            m[(r.RHO + a) * LANES + l], m[(r.RATE + r.D + a) * LANES + l] = (
                at(m, r.frame_k, l) * d + at(m, r.frame_b, l) * dd,
                dd,
            )
        m[(r.RATE + r.ETAD + 2) * LANES + l] -= gravity
        m[(r.F0 + 2) * LANES + l] += at(m, r.holder_mass, l) * gravity


@inlined
def _frame_directions(m: FloatArray, l: int) -> tuple[Vector, Vector]:
    """Return the two columns of D."""
    d_a = at(m, r.frame_directions, l), at(m, r.frame_directions + 1, l), 0.0
    d_b = at(m, r.frame_directions + 2, l), at(m, r.frame_directions + 3, l), 0.0
    return d_a, d_b


@inlined
def _with_frame_reaction(m: FloatArray, force: Vector, l: int) -> Vector:
    """Return R force, R = I − μ D Dᵀ."""
    mu, (d_a, d_b) = at(m, r.frame_mass_ratio, l), _frame_directions(m, l)
    return combine((1.0, -mu * dot(d_a, force), -mu * dot(d_b, force)), force, d_a, d_b)


@inlined
def _load_row(m: FloatArray, i: int, j_i: Vector, l: int) -> Vector:
    """Return row J_iᵀ P_i of Γ."""
    share = r.shares + 9 * i
    return combine(j_i, vector(m, share, l), vector(m, share + 3, l), vector(m, share + 6, l))


@inlined
def _load(m: FloatArray, l: int) -> Vector:
    """Return R (M₁ J w + f₀) − M₁ (1 − μ) D ρ."""
    mass, rho, (d_a, d_b) = at(m, r.holder_mass, l), vector(m, r.RHO, l), _frame_directions(m, l)
    centripetal = combine(vector(m, r.CENTRIPETAL, l), vector(m, r.J, l), vector(m, r.J + 3, l), vector(m, r.J + 6, l))
    free = _with_frame_reaction(m, add(scale(mass, centripetal), vector(m, r.F0, l)), l)
    still = -mass * (1.0 - at(m, r.frame_mass_ratio, l))
    return combine((1.0, still * rho[0], still * rho[1]), free, d_a, d_b)


@compiled
def mass_along_arms(m: FloatArray) -> None:
    """Evaluate −ν Σ R_iᵀ R_i = −ν (3 JᵀJ − z 1ᵀ − 1 zᵀ + I), z = Jᵀẑ, and add ν Σ R_iᵀ J w to the pull."""
    for l in range(LANES):
        j_a, j_b, j_c = vector(m, r.J, l), vector(m, r.J + 3, l), vector(m, r.J + 6, l)
        nu = at(m, r.arm_inertia, l)
        put(m, r.ARMS, l, (_same_arm(nu, j_a), _same_arm(nu, j_b), _same_arm(nu, j_c)))
        put(m, r.ARMS + 3, l, (_both_arms(nu, j_a, j_b), _both_arms(nu, j_a, j_c), _both_arms(nu, j_b, j_c)))
        turn = scale(nu, combine(vector(m, r.CENTRIPETAL, l), j_a, j_b, j_c))
        by_a, by_b, by_c = 3.0 * dot(j_a, turn), 3.0 * dot(j_b, turn), 3.0 * dot(j_c, turn)
        put(m, r.PULL, l, add(vector(m, r.PULL, l), (by_a - turn[2], by_b - turn[2], by_c - turn[2])))


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
        j_a, j_b, j_c = vector(m, r.J, l), vector(m, r.J + 3, l), vector(m, r.J + 6, l)
        mass, inertia, load = at(m, r.holder_mass, l), vector(m, r.carriage_mass, l), _load(m, l)
        a, b, c = scale(mass, j_a), scale(mass, j_b), scale(mass, j_c)
        a, b, c = _with_frame_reaction(m, a, l), _with_frame_reaction(m, b, l), _with_frame_reaction(m, c, l)
        g_a, g_b, g_c = _load_row(m, 0, j_a, l), _load_row(m, 1, j_b, l), _load_row(m, 2, j_c, l)
        pull = add(vector(m, r.PULL, l), (-dot(g_a, load), -dot(g_b, load), -dot(g_c, load)))
        put(m, r.PULL, l, pull)
        inertia, (ab, ac, bc) = add(inertia, vector(m, r.ARMS, l)), vector(m, r.ARMS + 3, l)
        row_a = dot(g_a, a) + inertia[0], dot(g_a, b) + ab, dot(g_a, c) + ac
        row_b = dot(g_b, a) + ab, dot(g_b, b) + inertia[1], dot(g_b, c) + bc
        row_c = dot(g_c, a) + ac, dot(g_c, b) + bc, dot(g_c, c) + inertia[2]
        put(m, r.RATE + r.QD, l, solve(row_a, row_b, row_c, pull))


@compiled
def effector_and_frame(m: FloatArray) -> None:
    """Evaluate what follows from q̈: a, η̈, and d̈ = −(1 − μ) ρ − μ Dᵀ (Ẍ + f₀/M₁)."""
    for l in range(LANES):
        mu, rho, (d_a, d_b) = at(m, r.frame_mass_ratio, l), vector(m, r.RHO, l), _frame_directions(m, l)
        q_part = add(vector(m, r.RATE + r.QD, l), vector(m, r.CENTRIPETAL, l))
        acc = combine(q_part, vector(m, r.J, l), vector(m, r.J + 3, l), vector(m, r.J + 6, l))
        free = add(acc, scale(1.0 / at(m, r.holder_mass, l), vector(m, r.F0, l)))
        frame_a = -(1.0 - mu) * rho[0] - mu * dot(d_a, free)
        frame_b = -(1.0 - mu) * rho[1] - mu * dot(d_b, free)
        acc = combine((1.0, frame_a, frame_b), acc, d_a, d_b)
        put(m, r.ACC, l, acc)
        put(m, r.RATE + r.DD, l, (frame_a, frame_b, 0.0))
        put(m, r.RATE + r.ETAD, l, add(vector(m, r.RATE + r.ETAD, l), scale(-1.0, acc)))
