"""Which whole motor steps the ends of segments are rounded to, so that the machine answers least: noise shaping.

Marlin rounds the end of every block to whole steps. Of a delta with 80 steps/mm that alone makes a nozzle far from the
centre swing by 24 µm rms: rounding is white noise up to half the rate of the segments, and the machine's resonances lie
there. So the ends are written where steps are, and which ones is chosen one after the other with the machine's model:
what the steps before have missed still rings, x, and the next miss e is the one that costs least from now on,

    e_j = steps − command     z_j = (x_j, e_j)     z_{j+1} = F_j (z_j, e_{j+1})     cost  Σ ‖R_j (z_j, e_{j+1})‖²

with R_j the nozzle's error at a few moments of segment j, most of it across its direction. Without whole numbers that
is a linear-quadratic regulator: e* = −K z, by the Riccati equation backwards over the segments as they come. With them,
of the whole steps around the command and e* the ones are taken whose distance from e* costs least. (The optimal noise
shaper for a plant: D. E. Quevedo & G. C. Goodwin, IEEE Trans. Automatic Control 50 (2005) 1184-1196.)

An end is due when the command passes its place, not at its own old time: then e holds only its distance from the
command.

The choice is a quantiser with feedback: a command that is 0.1 µm off (windows at limits lie elsewhere where a motion is
cut) gets other steps until the next beginning, ends of segments up to 65 µm away, and the nozzle's error is as large.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import CUT
from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel
from models.kinematics.base import Kinematics
from models.kinematics.delta import DeltaKinematics
from models.vibration.scheduled import PlantTable

MOST_ROWS = 8  # moments of a segment when the nozzle's error counts
ALONG = 0.3  # of an error along the path, that counts
MISS_COST = 0.2  # of e², in squares of what a step moves: with less, misses become many steps
SETTLE = 12  # segments like the last, after which what follows it is known well enough
WIDER = 4  # steps beyond the nearest, where there and back in two segments is within the motors' acceleration
LEAST_KNOTS = 1.0  # that a segment lasts at least whose end becomes due earlier or later, if it did before,
MOST_SHIFT = 0.4  # of its time: the largest such shift
SPARE = 0.9  # of that acceleration, because Marlin's times are not quite ours


@dataclass(frozen=True, eq=False)
class WholeSteps:
    """Chooses the steps of one machine's motors."""

    kinematics: Kinematics
    table: PlantTable  # by rows
    rows: int  # of a knot
    steps_per_mm: FloatArray  # (3,) of the motors
    free: BoolArray  # (3,) which motors may be moved off the command: no lead screw
    minimum: int  # steps that a segment must have
    wider: int  # steps beyond the nearest that are tried for a segment that would be too short
    most: FloatArray  # (3,) steps a knot², of the motors' acceleration
    _intervals: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    @classmethod
    def of(cls, model: InverseModel, steps_per_mm: FloatArray, free: BoolArray, minimum: int) -> WholeSteps:
        """Return those of a machine, from its inverse model."""
        settings, limits = model.settings, model.machine.limits
        most = SPARE * limits.carriage_acceleration_mm_per_s2 * settings.segment_s**2 * steps_per_mm
        wider = WIDER if 2.0 * minimum <= float(most[free].min()) else 0
        per_knot = settings.rows_per_segment
        return cls(model.machine.kinematics, model.row_table, per_knot, steps_per_mm, free, minimum, wider, most)

    def placed(self, at: FloatArray, points: FloatArray, fixed: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the ends of segments where whole steps are, (n, 3) mm, and when they are due, (n,) knots.

        Parameters
        ----------
        at : (n,) times of the points, in knots; at multiples of CUT one begins again, so that tiles say the same
        points : (n, 3) mm
        fixed : (n,) which of them do not move
        """
        steps = self.motors(points)
        t = self.table
        node = np.clip(np.rint((points[1:, :2] - t.x0_mm) / t.pitch_mm), 0, t.nodes - 1).astype(np.int64)
        rows = np.maximum(np.rint(np.diff(at) * self.rows), 1).astype(np.int64)
        pairs, kind = np.unique(np.column_stack([node[:, 0] * t.nodes + node[:, 1], rows]), axis=0, return_inverse=True)
        intervals = [self._interval(int(place), int(count)) for place, count in pairs]
        move = np.diff(points, axis=0)
        unit = move / np.maximum(np.linalg.norm(move, axis=1), 1e-9)[:, None]
        chosen, due = _chosen(
            at,
            steps,
            kind.ravel(),
            unit,
            fixed,
            at % CUT == 0.0,
            np.array([each[0] for each in intervals]),
            np.array([each[1] for each in intervals]),
            MISS_COST / self.steps_per_mm**2,
            self.free,
            self.minimum,
            self.wider,
            self.most,
        )
        chosen[:, ~self.free] = steps[:, ~self.free]
        return np.where(fixed[:, None], points, self._nozzle(chosen)), due

    def nearest(self, points: FloatArray) -> FloatArray:
        """Return where the nozzle is at the whole steps that are nearest to points, (n, 3) mm."""
        return self._nozzle(np.rint(self.motors(points)))

    def _nozzle(self, steps: FloatArray) -> FloatArray:
        k = self.kinematics
        return k.forward((steps / self.steps_per_mm + self._lift_mm) @ np.linalg.inv(k.motors).T)

    def motors(self, points: FloatArray) -> FloatArray:
        """Return the motors' steps, not rounded, at points (n, 3) mm."""
        motors: FloatArray = self.kinematics.inverse(points) @ self.kinematics.motors.T
        return (motors - self._lift_mm) * self.steps_per_mm

    @property
    def enough(self) -> int:
        """Steps of a segment that suffice to find ends far enough apart, whichever motor moves far enough."""
        return self.minimum + 1 - (int(np.count_nonzero(self.free)) if self.wider else 0)

    @property
    def _lift_mm(self) -> float:
        """Marlin counts a delta's carriages from the nozzle's height, not from that of the effector's joints."""
        return self.kinematics.effector_height_mm if isinstance(self.kinematics, DeltaKinematics) else 0.0

    def _interval(self, node: int, rows: int) -> tuple[FloatArray, FloatArray]:
        """Return F (N, N + 3) and R (3 · MOST_ROWS, N + 3) of a segment of so many rows, e linear between its ends."""
        if (node, rows) not in self._intervals:
            p = self.table.plant
            to_carriages = np.linalg.inv(self.kinematics.motors) / self.steps_per_mm
            a, b0, b1 = p.a[node], p.b0[node] @ to_carriages, p.b1[node] @ to_carriages
            to_nozzle = self.table.jacobian[node] @ p.carriage
            n, none = len(a), np.zeros((3, len(a)))
            x, errors = np.eye(n, n + 6), []
            for k in range(rows):
                since, until = (
                    np.hstack([none, (1.0 - f) * np.eye(3), f * np.eye(3)]) for f in (k / rows, (k + 1) / rows)
                )
                x = a @ x + b0 @ since + b1 @ until
                errors.append(to_nozzle @ x)
            count = min(rows, MOST_ROWS)
            weighed = [errors[(k + 1) * rows // count - 1] * np.sqrt(rows / count) for k in range(count)]
            weighed += [np.zeros((3, n + 6))] * (MOST_ROWS - count)
            carried = np.hstack([np.zeros((3, n + 3)), np.eye(3)])
            self._intervals[node, rows] = np.vstack([x, carried]), np.vstack(weighed)
        return self._intervals[node, rows]


@kernel
def _chosen(
    at: FloatArray,
    steps: FloatArray,
    kind: IntArray,
    unit: FloatArray,
    fixed: BoolArray,
    begins: BoolArray,
    forward: FloatArray,
    errors: FloatArray,
    penalty: FloatArray,
    free: BoolArray,
    minimum: int,
    wider: int,
    most: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return whole steps (n, 3) for a command in steps (n, 3) at times (n,), in knots, and when they are due.

    kind (n - 1,): which of forward (g, N, N + 3) and errors (g, 3 · MOST_ROWS, N + 3) a segment is of.
    unit (n - 1, 3): its direction.   begins (n,): where earlier errors no longer count.   penalty (3,): of e².
    """
    n, size = len(steps), forward.shape[1]
    gain, cost = _regulator(kind, unit, begins, forward, errors, penalty)
    z, missed, off, tried = np.zeros(size), np.zeros(size + 3), np.zeros(3), np.zeros(3)
    low, high = np.zeros(3), np.zeros(3)
    pace = np.zeros(4)  # of the command, steps a knot on average of both segments; and what a turn takes off a shift
    out, due = np.floor(steps + 0.5), at.copy()
    for j in range(n):
        if j > 0 and not fixed[j]:
            _reach(at, out, j, begins, most, low, high)
            earlier, later = 0.0, 0.0  # by how many knots it may be
            if j + 1 < n:
                earlier = min(max(at[j] - due[j - 1] - LEAST_KNOTS, 0.0), MOST_SHIFT * (at[j] - at[j - 1]))
                later = min(max(at[j + 1] - at[j] - LEAST_KNOTS, 0.0), MOST_SHIFT * (at[j + 1] - at[j]))
            pace[3] = 0.0
            for i in range(3):
                if free[i] and j + 1 < n:
                    pace[i] = (steps[j + 1, i] - steps[j - 1, i]) / (at[j + 1] - at[j - 1])
                    turn = (steps[j + 1, i] - steps[j, i]) / (at[j + 1] - at[j]) - pace[i]
                    pace[3] += pace[i] * pace[i] + turn * turn
                off[i] = steps[j, i]
                for c in range(size):
                    off[i] -= gain[j, i, c] * z[c]
                if np.ceil(low[i]) <= np.floor(high[i]):
                    off[i] = min(max(off[i], np.ceil(low[i])), np.floor(high[i]))
            _nearest(off, cost[j], j, free, minimum, wider, low, high, steps, pace, earlier, later, tried, out)
            due[j] += _shift(out[j], steps[j], pace, earlier, later)
        for i in range(3):
            missed[size + i] = out[j, i] - steps[j, i] - (due[j] - at[j]) * pace[i]
        if j == 0 or begins[j]:
            for i in range(size):
                z[i] = missed[i + 3] if i >= size - 3 else 0.0
            continue
        for i in range(size):
            missed[i], z[i] = z[i], 0.0
        for i in range(size):
            for c in range(size + 3):
                z[i] += forward[kind[j - 1], i, c] * missed[c]
    return out, due


@kernel
def _shift(place: FloatArray, step: FloatArray, pace: FloatArray, earlier: float, later: float) -> float:
    """Return by how many knots later an end is due at a place, at most so much earlier or later.

    An end that goes on along a command that turns cuts the turn off. Summed over time that is as much as on a straight
    command with the average pace of both segments; how much sharper it is, is what keeps an end at its time there.

    place, step (3,): steps, where it is wanted and at its own time.   pace (4,): the command's, and its square with
    that of the turn
    """
    ahead = 0.0
    for i in range(3):
        ahead += (place[i] - step[i]) * pace[i]
    return min(max(ahead / pace[3], -earlier), later) if pace[3] > 0.0 else 0.0


@kernel
def _reach(
    at: FloatArray, out: FloatArray, j: int, begins: BoolArray, most: FloatArray, low: FloatArray, high: FloatArray
) -> None:
    """Fill in the steps that motors reach at point j, by their acceleration from the last segment and into the next.

    The next rows of `out` are the command. Behind a cut the last segment does not count: another tile may hold it.
    """
    last = at[j] - at[j - 1]
    for i in range(3):
        low[i], high[i] = -np.inf, np.inf
        if j > 1 and not begins[j - 1]:
            before = at[j - 1] - at[j - 2]
            on = out[j - 1, i] + (out[j - 1, i] - out[j - 2, i]) * last / before
            change = most[i] * max(0.5 * (last + before), 1.0) * last
            low[i], high[i] = on - change, on + change
        if j + 1 < len(at):
            then = at[j + 1] - at[j]
            between = (out[j - 1, i] * then + out[j + 1, i] * last) / (last + then)
            change = most[i] * max(0.5 * (last + then), 1.0) * last * then / (last + then)
            low[i], high[i] = max(low[i], between - change), min(high[i], between + change)


@kernel
def _regulator(
    kind: IntArray,
    unit: FloatArray,
    begins: BoolArray,
    forward: FloatArray,
    errors: FloatArray,
    penalty: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return K (n, 3, N) and H (n, 3, 3) at the end of each segment, by the Riccati equation backwards."""
    n, size = len(begins), forward.shape[1]
    gain, cost = np.empty((n, 3, size)), np.empty((n, 3, 3))
    p, ahead, across = np.zeros((size, size)), np.empty((size, size + 3)), np.empty(errors.shape[1:])
    whole = np.empty((size + 3, size + 3))
    for j in range(n - 1, 0, -1):
        k, passes = kind[j - 1], 1
        if begins[j] or j == n - 1:
            passes = SETTLE
            p[:, :] = 0.0
        _across(errors[k], unit[j - 1], across)
        for _ in range(passes):
            ahead[:, :] = 0.0
            _add_product(p, forward[k], ahead)
            whole[:, :] = 0.0
            _add_product(across, across, whole)
            _add_product(forward[k], ahead, whole)
            for i in range(3):
                whole[size + i, size + i] += penalty[i]
                for c in range(3):
                    cost[j, i, c] = whole[size + i, size + c]
            _solve(cost[j], whole, gain[j])
            for r in range(size):
                for c in range(r + 1):
                    value = whole[r, c]
                    for i in range(3):
                        value -= whole[size + i, r] * gain[j, i, c]
                    p[r, c] = p[c, r] = value
    return gain, cost


@kernel
def _add_product(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Add aᵀ b, in place."""
    for k in range(a.shape[0]):
        for i in range(a.shape[1]):
            factor = a[k, i]
            if factor != 0.0:
                for c in range(b.shape[1]):
                    out[i, c] += factor * b[k, c]


@kernel
def _across(errors: FloatArray, unit: FloatArray, out: FloatArray) -> None:
    """Take away most of what lies along the path."""
    for r in range(0, errors.shape[0], 3):
        for c in range(errors.shape[1]):
            along = unit[0] * errors[r, c] + unit[1] * errors[r + 1, c] + unit[2] * errors[r + 2, c]
            for i in range(3):
                out[r + i, c] = errors[r + i, c] - (1.0 - ALONG) * along * unit[i]


@kernel
def _solve(h: FloatArray, whole: FloatArray, gain: FloatArray) -> None:
    """H K = G for a symmetric H (3, 3), by cofactors; G (3, N): the last rows of `whole` (N + 3, N + 3)."""
    size = gain.shape[1]
    inverse = np.empty((3, 3))
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for c in range(3):
            d, e = (c + 1) % 3, (c + 2) % 3
            inverse[i, c] = h[a, d] * h[b, e] - h[a, e] * h[b, d]
    determinant = h[0, 0] * inverse[0, 0] + h[0, 1] * inverse[0, 1] + h[0, 2] * inverse[0, 2]
    for i in range(3):
        for c in range(size):
            gain[i, c] = 0.0
            for k in range(3):
                gain[i, c] += inverse[i, k] / determinant * whole[size + k, c]


@kernel
def _nearest(
    wanted: FloatArray,
    cost: FloatArray,
    j: int,
    free: BoolArray,
    minimum: int,
    most_wider: int,
    low: FloatArray,
    high: FloatArray,
    steps: FloatArray,
    pace: FloatArray,
    earlier: float,
    later: float,
    tried: FloatArray,
    out: FloatArray,
) -> None:
    """Put the whole steps that cost least near `wanted` into row j: of those that motors reach, and are not dropped.

    low, high (3,): the reach of the motors.   pace, earlier, later: see `_shift`.   minimum: steps of one motor since
    the last row; fewer are dropped.
    """
    least, best, missed = np.inf, -1, np.zeros(3)
    for wider in range(most_wider + 1):
        width, farthest = 2 + 2 * wider, 0.0
        for i in range(3):
            if free[i]:
                ahead = np.floor(wanted[i]) - out[j - 1, i]
                farthest = max(farthest, wider - ahead, ahead + wider + 1)
        if wider > 0 and farthest < minimum:  # nor do so many more make the segment long enough
            continue
        for number in range(width * width * width):
            rest, apart, usable, within = number, 0.0, True, True
            for i in range(3):
                digit = rest % width
                rest //= width
                tried[i] = np.floor(wanted[i]) - wider + digit if free[i] else out[j, i]
                usable &= free[i] or digit == 0
                within &= not free[i] or low[i] <= tried[i] <= high[i]
                apart = max(apart, abs(tried[i] - out[j - 1, i]))
            rank = 2 * int(within) + int(apart >= minimum)
            if not usable or rank < best or (wider > 0 and rank < 3):
                continue
            shift, total = _shift(tried, steps[j], pace, earlier, later), 0.0
            for i in range(3):
                missed[i] = tried[i] - wanted[i] - shift * pace[i]
            for i in range(3):
                for c in range(3):
                    total += missed[i] * cost[i, c] * missed[c]
            if total < least or rank > best:
                least, best = total, rank
                for i in range(3):
                    out[j, i] = tried[i]
        if best != 2:  # not dropped, or beyond the motors whatever is tried
            return
