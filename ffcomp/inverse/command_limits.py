"""The demand of a command on the carriages at every instant.

The command is a polygon of the nozzle: straight and even from knot to knot, S seconds each. On a straight line a
carriage stands at q = z + H + h, h² = L² − |d|², d the nozzle's place in the plane as seen from the tower. With the
segment's velocity v (v_xy in the plane)

    q̇ = v_z − d·v_xy / h            q̈ = −(|v_xy|² h² + (d·v_xy)²) / h³ ≤ 0

so inside a segment a carriage's velocity only falls: its extremes are at the two ends, each seen from inside, and of
its height the lowest point is an end, the highest an end or the one place where q̇ = 0: (d·v_xy)² = v_z² h².

Checked are the height, the velocity, and the acceleration as change of velocity over the time of one segment, for any
beginning inside one: (q̇(t + S) − q̇(t)) / S. It holds the jump at the knot and the curvature between. Both ends of the
range of t are checked; in between it can be higher by S |q⃛ − q⃛'| / 8 only, less than a mm/s². The firmware's ramps
around the knots are not included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.arrays import FloatArray
from models.compiled import kernel
from models.machine import Machine

VELOCITY, ACCELERATION, TRAVEL = 0, 1, 2
NAMES = ("velocity", "acceleration", "travel")
TOLERANCE = 1.03  # times a limit: a path within this is held under the limit all the same


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """The limits of every carriage's command."""

    velocity_mm_per_s: FloatArray  # (3,)
    acceleration_mm_per_s2: float
    travel_mm: tuple[float, float]  # lowest and highest place of a motor; infinite where it is not known
    segment_s: float
    rows: FloatArray  # (3, 8), `Kinematics.motor_rows`
    motors: FloatArray  # (3, 3) motors from carriages

    @classmethod
    def of(cls, machine: Machine, segment_s: float) -> CommandLimits:
        """Read the limits of a machine; a step rate is a velocity."""
        limits, geometry = machine.limits, machine.kinematics
        by_steps = np.inf if limits.step_rate_hz is None else limits.step_rate_hz / machine.steps.per_motor
        return cls(
            np.minimum(limits.carriage_velocity_mm_per_s, np.broadcast_to(by_steps, 3)),
            limits.carriage_acceleration_mm_per_s2,
            limits.carriage_travel_mm or (-np.inf, np.inf),
            segment_s,
            np.ascontiguousarray(geometry.motor_rows),
            geometry.motors,
        )

    @property
    def scales(self) -> tuple[FloatArray, float, float, float]:
        """What demands are divided by: velocities (3,), a segment's change of them, middle and half of the travel."""
        low, high = self.travel_mm
        middle, half = (0.5 * (low + high), 0.5 * (high - low)) if np.isfinite(high - low) else (0.0, np.inf)
        return self.velocity_mm_per_s, self.acceleration_mm_per_s2 * self.segment_s, middle, half

    def demand(self, vertices: FloatArray) -> Demand:
        """Return the demand of a command (n + 1, 3) mm, a nozzle polygon, on the carriages."""
        return Demand(*_demand(np.ascontiguousarray(vertices), self.rows, self.segment_s))


@dataclass(frozen=True, slots=True)
class Demand:
    """The demand of n segments on carriages A B C; the last axis holds both ends of a range, of time or of height."""

    velocity: FloatArray  # (n, 3, 2) mm/s, just after the segment's beginning and just before its end
    height: FloatArray  # (n, 3, 2) mm, lowest and highest

    def acceleration(self, segment_s: float) -> FloatArray:
        """(n - 1, 3, 2) mm/s²: from each segment to the next, from beginning to beginning and from end to end."""
        return np.asarray(np.diff(self.velocity, axis=0) / segment_s)

    def utilisation(self, limits: CommandLimits) -> FloatArray:
        """Return the demand over the limit, (n, 3, 3) of segment, limit (`NAMES`) and carriage.

        Acceleration is what leads into the segment, none into the first. Travel counts from its middle.
        """
        return np.asarray(_utilisation(self.velocity, self.height, *limits.scales))


def utilisation_from_rest(vertices: FloatArray, limits: CommandLimits) -> FloatArray:
    """Return the utilisation (n + 2, 3, 3) by a command (n + 1, 3) mm that rests for a segment before and after it."""
    resting = np.concatenate([vertices[:1], vertices, vertices[-1:]])
    return limits.demand(resting).utilisation(limits)


def peak_utilisation(vertices: FloatArray, limits: CommandLimits) -> float:
    """Return the peak demand over its limit of a command (n + 1, 3) mm from rest to rest; up to 1 is allowed."""
    return float(utilisation_from_rest(vertices, limits).max())


@kernel
def _utilisation(
    velocity: FloatArray, height: FloatArray, most: FloatArray, change: float, middle: float, half: float
) -> FloatArray:
    n = len(velocity)
    utilisation = np.zeros((n, 3, 3))
    for k in range(n):
        for i in range(3):
            v = velocity[k, i]
            utilisation[k, VELOCITY, i] = max(abs(v[0]), abs(v[1])) / most[i]
            utilisation[k, TRAVEL, i] = max(abs(height[k, i, 0] - middle), abs(height[k, i, 1] - middle)) / half
            if k > 0:
                before = velocity[k - 1, i]
                utilisation[k, ACCELERATION, i] = max(abs(v[0] - before[0]), abs(v[1] - before[1])) / change
    return utilisation


@kernel
def _demand(vertices: FloatArray, rows: FloatArray, segment_s: float) -> tuple[FloatArray, FloatArray]:
    n = len(vertices) - 1
    velocity, height = np.empty((n, 3, 2)), np.empty((n, 3, 2))
    for k in range(n):
        vx = (vertices[k + 1, 0] - vertices[k, 0]) / segment_s
        vy = (vertices[k + 1, 1] - vertices[k, 1]) / segment_s
        vz = (vertices[k + 1, 2] - vertices[k, 2]) / segment_s
        v2 = vx * vx + vy * vy
        for i in range(3):
            tower_x, tower_y, arm_squared, base, of_x, of_y, of_z, _ = rows[i]
            slope = of_x * vx + of_y * vy + of_z * vz
            for end in range(2):
                x, y, z = vertices[k + end]
                dx, dy = x - tower_x, y - tower_y
                height[k, i, end] = base + of_x * x + of_y * y + of_z * z
                velocity[k, i, end] = slope
                if arm_squared > 0.0:
                    h = np.sqrt(arm_squared - dx * dx - dy * dy)
                    velocity[k, i, end] -= (dx * vx + dy * vy) / h
                    height[k, i, end] += h
            first, last = height[k, i, 0], height[k, i, 1]
            height[k, i, 0], height[k, i, 1] = min(first, last), max(first, last)
            if velocity[k, i, 0] > 0.0 > velocity[k, i, 1]:
                # z + h is highest where both grow alike: along the line it is z₀ + √(1 + v_z²/v²) · the arm's reach
                dx, dy = vertices[k, 0] - tower_x, vertices[k, 1] - tower_y
                across = (dx * vy - dy * vx) ** 2 / v2
                level = vertices[k, 2] - vz * (dx * vx + dy * vy) / v2
                height[k, i, 1] = level + base + np.sqrt((arm_squared - across) * (1.0 + vz * vz / v2))
    return velocity, height
