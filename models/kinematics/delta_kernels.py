"""The delta's equations compiled, for inner loops. See `delta.py` for the maths.

`towers` (3, 2) mm are DeltaKinematics.towers_mm, `arms_squared` (3,) mm². Points out of reach become NaN.
"""

from __future__ import annotations

import math

import numpy as np

from models.arrays import FloatArray
from models.compiled import kernel


@kernel
def inverse_point(
    x: float, y: float, z: float, towers: FloatArray, arms_squared: FloatArray, effector_height: float
) -> tuple[float, float, float]:
    """Return carriage heights A B C, mm, of one nozzle position."""
    base = z + effector_height
    return (
        base + math.sqrt(arms_squared[0] - (x - towers[0, 0]) ** 2 - (y - towers[0, 1]) ** 2),
        base + math.sqrt(arms_squared[1] - (x - towers[1, 0]) ** 2 - (y - towers[1, 1]) ** 2),
        base + math.sqrt(arms_squared[2] - (x - towers[2, 0]) ** 2 - (y - towers[2, 1]) ** 2),
    )


@kernel
def _inverse(xyz: FloatArray, towers: FloatArray, arms_squared: FloatArray, effector_height: float) -> FloatArray:
    out = np.empty((len(xyz), 3))
    for n in range(len(xyz)):
        a, b, c = inverse_point(xyz[n, 0], xyz[n, 1], xyz[n, 2], towers, arms_squared, effector_height)
        out[n, 0], out[n, 1], out[n, 2] = a, b, c
    return out


@kernel
def _forward(q: FloatArray, towers: FloatArray, arms_squared: FloatArray, effector_height: float) -> FloatArray:
    """Compute the lower of the two points where the arms' spheres meet (Eqs. 3-5, solved exactly).

    With r the effector seen from joint A, differences of the spheres are linear, r_xy = u + v r_z; that makes sphere A
    a quadratic in r_z.
    """
    bx, by = towers[1, 0] - towers[0, 0], towers[1, 1] - towers[0, 1]
    cx, cy = towers[2, 0] - towers[0, 0], towers[2, 1] - towers[0, 1]
    scale = 1.0 / (bx * cy - by * cx)
    out = np.empty((len(q), 3))
    for n in range(len(q)):
        rise_b, rise_c = q[n, 1] - q[n, 0], q[n, 2] - q[n, 0]
        off_b = 0.5 * (bx * bx + by * by + rise_b * rise_b + arms_squared[0] - arms_squared[1])
        off_c = 0.5 * (cx * cx + cy * cy + rise_c * rise_c + arms_squared[0] - arms_squared[2])
        ux, uy = (off_b * cy - off_c * by) * scale, (off_c * bx - off_b * cx) * scale
        vx, vy = (rise_c * by - rise_b * cy) * scale, (rise_b * cx - rise_c * bx) * scale
        a, b = 1.0 + vx * vx + vy * vy, ux * vx + uy * vy
        rz = -(b + math.sqrt(b * b - a * (ux * ux + uy * uy - arms_squared[0]))) / a
        out[n, 0] = towers[0, 0] + ux + vx * rz
        out[n, 1] = towers[0, 1] + uy + vy * rz
        out[n, 2] = q[n, 0] - effector_height + rz
    return out


@kernel
def _rate_term(xyz: FloatArray, velocity: FloatArray, towers: FloatArray, arms_squared: FloatArray) -> FloatArray:
    """Compute J̇ q̇, the part of Ẍ = J q̈ + J̇ q̇ that remains without carriage acceleration, by cofactors.

    Differentiating s_i·(Ẋ − ẑ q̇_i) = 0 once more: s_i·(Ẍ − ẑ q̈_i) + |Ẋ − ẑ q̇_i|² = 0, so J̇ q̇ = −S⁻¹ |ṡ_i|². NOTE:
    Eq. 13 of the paper has the opposite sign; finite differences agree with ours.
    """
    out = np.empty((len(xyz), 3))
    s, w = np.empty((3, 3)), np.empty(3)
    for n in range(len(xyz)):
        vx, vy = velocity[n, 0], velocity[n, 1]
        for i in range(3):
            x, y = xyz[n, 0] - towers[i, 0], xyz[n, 1] - towers[i, 1]
            h = math.sqrt(arms_squared[i] - x * x - y * y)
            s[i, 0], s[i, 1], s[i, 2] = x, y, -h
            sink = (x * vx + y * vy) / h  # ż − q̇_i
            w[i] = vx * vx + vy * vy + sink * sink
        c0 = s[1, 1] * s[2, 2] - s[1, 2] * s[2, 1]
        c1 = s[1, 2] * s[2, 0] - s[1, 0] * s[2, 2]
        c2 = s[1, 0] * s[2, 1] - s[1, 1] * s[2, 0]
        k = -1.0 / (s[0, 0] * c0 + s[0, 1] * c1 + s[0, 2] * c2)
        d0, d1, d2 = w[0], w[1], w[2]
        out[n, 0] = (d0 * c0 + s[0, 1] * (s[1, 2] * d2 - d1 * s[2, 2]) + s[0, 2] * (d1 * s[2, 1] - s[1, 1] * d2)) * k
        out[n, 1] = (s[0, 0] * (d1 * s[2, 2] - s[1, 2] * d2) + d0 * c1 + s[0, 2] * (s[1, 0] * d2 - d1 * s[2, 0])) * k
        out[n, 2] = (s[0, 0] * (s[1, 1] * d2 - d1 * s[2, 1]) + s[0, 1] * (d1 * s[2, 0] - s[1, 0] * d2) + d0 * c2) * k
    return out


class FastDelta:
    """`inverse`, `forward` and J̇ q̇ of one delta, compiled and unchecked: (n, 3) in and out."""

    def __init__(self, towers_mm: FloatArray, arm_lengths_mm: FloatArray, effector_height_mm: float) -> None:
        self._towers = np.ascontiguousarray(towers_mm)
        self._arms = np.ascontiguousarray(arm_lengths_mm**2)
        self._height = float(effector_height_mm)

    def inverse(self, xyz: FloatArray) -> FloatArray:
        """Return carriages of nozzle positions, mm."""
        return _inverse(np.ascontiguousarray(xyz), self._towers, self._arms, self._height)

    def forward(self, q: FloatArray) -> FloatArray:
        """Return nozzle positions of carriages, mm."""
        return _forward(np.ascontiguousarray(q), self._towers, self._arms, self._height)

    def rate_term(self, xyz: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return J̇ q̇, mm/s²."""
        return _rate_term(np.ascontiguousarray(xyz), np.ascontiguousarray(velocity), self._towers, self._arms)
