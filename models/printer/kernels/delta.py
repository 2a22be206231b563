"""Arms, effector and frame of a delta."""

from __future__ import annotations

import math

from models.arrays import FloatArray
from models.printer.kernels.jit import compiled, inlined
from models.printer.kernels.record import (
    ACC,
    BENDING,
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
from models.printer.kernels.vectors import at, cross, dot, mixed, plus, put, scaled, solved, three

TOWERS, ARMS_SQUARED, HEIGHT, TO_PLANE, OFFSET = parameter_rows(
    "towers", "arms_squared", "height", "to_plane", "offset"
)
(CARRIAGE_MASS,) = parameter_rows("carriage_mass")
(SHARES,) = parameter_rows("shares")
HOLDER_MASS, EXTRUDER_MASS, MOUNT_K, MOUNT_B = parameter_rows("holder_mass", "extruder_mass", "mount_k", "mount_b")
(GRAVITY,) = parameter_rows("gravity")
SWAY, SWAY_SHARE, SWAY_K, SWAY_B = parameter_rows("sway", "sway_share", "sway_k", "sway_b")


@inlined
def _placed(m: FloatArray, l: int) -> Vector:
    """The nozzle of the carriages: `models.kinematics.delta.forward` for one point."""
    q = three(m, NOW + Q, l)
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
    """s_i with the nozzle at x."""
    sx, sy = x[0] - at(m, TOWERS + 2 * i, l), x[1] - at(m, TOWERS + 2 * i + 1, l)
    return sx, sy, -math.sqrt(at(m, ARMS_SQUARED + i, l) - sx * sx - sy * sy)


@compiled
def arms(m: FloatArray) -> None:
    """Where the nozzle is and how it moves, J, and w_i = |Ẋ − ẑ q̇_i|²/h_i."""
    for l in range(LANES):
        x, qd = _placed(m, l), three(m, NOW + QD, l)
        a, b, c = _arm(m, 0, x, l), _arm(m, 1, x, l), _arm(m, 2, x, l)
        bc = cross(b, c)
        over_det = 1.0 / dot(a, bc)
        j_a, j_b = scaled(a[2] * over_det, bc), scaled(b[2] * over_det, cross(c, a))
        j_c = scaled(c[2] * over_det, cross(a, b))
        xd = mixed(qd, j_a, j_b, j_c)
        level = xd[0] * xd[0] + xd[1] * xd[1]
        sink_a, sink_b, sink_c = xd[2] - qd[0], xd[2] - qd[1], xd[2] - qd[2]
        w_a, w_b = -(level + sink_a * sink_a) / a[2], -(level + sink_b * sink_b) / b[2]
        put(m, BENDING, l, (w_a, w_b, -(level + sink_c * sink_c) / c[2]))
        put(m, J, l, j_a)
        put(m, J + 3, l, j_b)
        put(m, J + 6, l, j_c)
        put(m, X, l, x)
        put(m, XD, l, xd)


@compiled
def holder(m: FloatArray) -> None:
    """f₀, ρ, and the extruder's own part of η̈."""
    for l in range(LANES):
        gravity, over = at(m, GRAVITY, l), 1.0 / at(m, EXTRUDER_MASS, l)
        for a in range(3):
            eta, etad = at(m, NOW + ETA + a, l), at(m, NOW + ETAD + a, l)
            mount = at(m, MOUNT_K + a, l) * eta + at(m, MOUNT_B + a, l) * etad
            m[(RATE + ETA + a) * LANES + l], m[(RATE + ETAD + a) * LANES + l] = etad, -over * mount
            m[(F0 + a) * LANES + l] = at(m, JOINTS + a, l) - mount
            d, dd = at(m, NOW + D + a, l), at(m, NOW + DD + a, l)
            m[(RHO + a) * LANES + l], m[(RATE + D + a) * LANES + l] = at(m, SWAY_K, l) * d + at(m, SWAY_B, l) * dd, dd
        m[(RATE + ETAD + 2) * LANES + l] -= gravity
        m[(F0 + 2) * LANES + l] += at(m, HOLDER_MASS, l) * gravity


@inlined
def _directions(m: FloatArray, l: int) -> tuple[Vector, Vector]:
    """The two columns of D."""
    return (at(m, SWAY, l), at(m, SWAY + 1, l), 0.0), (at(m, SWAY + 2, l), at(m, SWAY + 3, l), 0.0)


@inlined
def _swayed(m: FloatArray, vector: Vector, l: int) -> Vector:
    """R vector, R = I − μ D Dᵀ."""
    share, (d_a, d_b) = at(m, SWAY_SHARE, l), _directions(m, l)
    return mixed((1.0, -share * dot(d_a, vector), -share * dot(d_b, vector)), vector, d_a, d_b)


@inlined
def _felt(m: FloatArray, i: int, j_i: Vector, l: int) -> Vector:
    """Γ's row J_iᵀ P_i."""
    share = SHARES + 9 * i
    return mixed(j_i, three(m, share, l), three(m, share + 3, l), three(m, share + 6, l))


@inlined
def _load(m: FloatArray, l: int) -> Vector:
    """R (M₁ J w + f₀) − M₁ (1 − μ) D ρ."""
    mass, rho, (d_a, d_b) = at(m, HOLDER_MASS, l), three(m, RHO, l), _directions(m, l)
    bent = mixed(three(m, BENDING, l), three(m, J, l), three(m, J + 3, l), three(m, J + 6, l))
    free = _swayed(m, plus(scaled(mass, bent), three(m, F0, l)), l)
    still = -mass * (1.0 - at(m, SWAY_SHARE, l))
    return mixed((1.0, still * rho[0], still * rho[1]), free, d_a, d_b)


@compiled
def coupled(m: FloatArray) -> None:
    """Solve for q̈: (m I + Γ R M₁ J) q̈ = pull − Γ (R (M₁ J w + f₀) − M₁ (1 − μ) D ρ)."""
    for l in range(LANES):
        j_a, j_b, j_c = three(m, J, l), three(m, J + 3, l), three(m, J + 6, l)
        mass, own, load = at(m, HOLDER_MASS, l), three(m, CARRIAGE_MASS, l), _load(m, l)
        a, b, c = scaled(mass, j_a), scaled(mass, j_b), scaled(mass, j_c)
        a, b, c = _swayed(m, a, l), _swayed(m, b, l), _swayed(m, c, l)
        g_a, g_b, g_c = _felt(m, 0, j_a, l), _felt(m, 1, j_b, l), _felt(m, 2, j_c, l)
        pull = plus(three(m, PULL, l), (-dot(g_a, load), -dot(g_b, load), -dot(g_c, load)))
        put(m, PULL, l, pull)
        row_a = dot(g_a, a) + own[0], dot(g_a, b), dot(g_a, c)
        row_b = dot(g_b, a), dot(g_b, b) + own[1], dot(g_b, c)
        row_c = dot(g_c, a), dot(g_c, b), dot(g_c, c) + own[2]
        put(m, RATE + QD, l, solved(row_a, row_b, row_c, pull))


@compiled
def followers(m: FloatArray) -> None:
    """What q̈ brings with it: a, and of frame and extruder d̈ = −(1 − μ) ρ − μ Dᵀ (Ẍ + f₀/M₁) and η̈."""
    for l in range(LANES):
        share, rho, (d_a, d_b) = at(m, SWAY_SHARE, l), three(m, RHO, l), _directions(m, l)
        speeding = plus(three(m, RATE + QD, l), three(m, BENDING, l))
        acc = mixed(speeding, three(m, J, l), three(m, J + 3, l), three(m, J + 6, l))
        shake = plus(acc, scaled(1.0 / at(m, HOLDER_MASS, l), three(m, F0, l)))
        sway_a = -(1.0 - share) * rho[0] - share * dot(d_a, shake)
        sway_b = -(1.0 - share) * rho[1] - share * dot(d_b, shake)
        acc = mixed((1.0, sway_a, sway_b), acc, d_a, d_b)
        put(m, ACC, l, acc)
        put(m, RATE + DD, l, (sway_a, sway_b, 0.0))
        put(m, RATE + ETAD, l, plus(three(m, RATE + ETAD, l), scaled(-1.0, acc)))
