"""When segments end and at which whole motor steps, chosen together so that the nozzle errs least.

Marlin rounds the end of every block to whole steps, and drops a block of fewer than `minimum`. Rounding is white noise
up to half the rate of the segments, and the machine's resonances lie there; where the nozzle is slow, a block that is
long enough lasts ten times as long as a knot, and the command turns meanwhile. Both are one choice: of an end's time,
every `RESOLUTION` steps of the command, and of its steps. The error e of the executed polyline against the command
rings in the machine's model,

    x_{k+1} = A x_k + B₀ e_k + B₁ e_{k+1}    y_k = C x_k    cost  Σ |W y_k|² + penalty · e²

at the knots k, with W taking away most of what lies along the path. The cheapest sequence of ends is sought by the
Viterbi algorithm: every end keeps the best ways to get there, as many as it has whole steps around it. Each ends at
other steps and has its own ringing (per-survivor processing: R. Raheli, A. Polydoros & C. K. Tzou, IEEE Trans.
Communications 43 (1995) 354-364; for quantisers D. E. Quevedo & G. C. Goodwin, IEEE Trans. Automatic Control 50 (2005)
1184-1196).

If steps had no size that were a linear-quadratic regulator, which leaves zᵀ P z from an end on, z = (x, e), with P by
the Riccati equation for more segments like the one at hand. What still rings at an end counts with that. The next end
is sought around the place that costs least with it, up to `BEYOND` from the command, to work against what rings.

An end is due when the command passes its place, not at its own knot: then e holds only its distance from the command.

The choice is a quantiser with feedback: a command that is 0.1 µm off (windows at limits lie elsewhere where a motion is
cut) gets other steps until the next beginning, ends of segments up to 65 µm away, and the nozzle's error is as large.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil

import numpy as np

from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import CUT
from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import fast_kernel, kernel
from models.kinematics.base import Kinematics
from models.kinematics.delta import DeltaKinematics
from models.vibration.scheduled import PlantTable

ALONG = 0.3  # of an error along the path, that counts
MISS_COST = 0.3  # of e², in squares of what a step moves: with less, misses become many steps
SEGMENT_COST = 1e-4  # mm² knots, of one more segment: each 10 µm all along a knot
SETTLE = 12  # segments, after which what follows an end is known well enough
AROUND = 4  # segments on either side of one that is too short: their ends are chosen again with its own
RESOLUTION = 2.0  # steps between points that are tried: closer ones differ by less than the rounding
FAR = 2.0  # times the steps that a segment must have, beyond which no longer one is tried there
MOST_KNOTS = 60  # and how long one may last
BEYOND = 3.0  # steps from the command, at most
LEAST_KNOTS = 1.0  # that a segment lasts at least, if it ends at no fixed point
MOST_SHIFT = 0.4  # of the time to the next point: an end becomes due so much earlier or later at most
SPARE = 0.9  # of the motors' acceleration, because Marlin's times are not quite ours
REFUSED = 1e6  # mm², what a segment beyond that costs, or one that is dropped


@dataclass(frozen=True, eq=False)
class WholeSteps:
    """Chooses the ends of segments for one machine's motors."""

    kinematics: Kinematics
    table: PlantTable  # by rows
    rows: int  # of a knot
    steps_per_mm: FloatArray  # (3,) of the motors
    free: BoolArray  # (3,) which motors may be moved off the command: no lead screw
    minimum: int  # steps that a segment must have
    most: FloatArray  # (3,) steps a knot², of the motors' acceleration
    _plants: dict[tuple[int, int], list[FloatArray]] = field(default_factory=dict)
    _rest: dict[tuple[int, int, int], tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    @classmethod
    def of(cls, model: InverseModel, steps_per_mm: FloatArray, free: BoolArray, minimum: int) -> WholeSteps:
        """Return those of a machine, from its inverse model."""
        settings, limits = model.settings, model.machine.limits
        most = SPARE * limits.carriage_acceleration_mm_per_s2 * settings.segment_s**2 * steps_per_mm
        per_knot = settings.rows_per_segment
        return cls(model.machine.kinematics, model.row_table, per_knot, steps_per_mm, free, minimum, most)

    def ends(
        self, at: FloatArray, points: FloatArray, kept: IntArray, pinned: BoolArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return which points end segments, (k,); when they are due, (k,) knots; and where, (k, 3) mm.

        Parameters
        ----------
        at : (n,) times of the points, in knots; at multiples of CUT one begins again, so that tiles say the same
        points : (n, 3) mm
        kept : (m,) the ends that would do if steps had no size; others are tried where segments have too few steps
        pinned : (n,) which of them end segments in any case, and do not move
        """
        steps = self.motors(points)
        knots = np.arange(int(np.floor(at[0])), ceil(at[-1]) + 1)
        command, path = (np.stack([np.interp(knots, at, x) for x in columns.T], axis=1) for columns in (steps, points))
        toward = np.gradient(path, axis=0)
        toward /= np.maximum(np.linalg.norm(toward, axis=1), 1e-9)[:, None]
        t = self.table
        near = np.clip(np.rint((points[:, :2] - t.x0_mm) / t.pitch_mm), 0, t.nodes - 1).astype(np.int64)
        places, node = np.unique(near[:, 0] * t.nodes + near[:, 1], return_inverse=True)
        reach = MOST_KNOTS * ceil(np.diff(at[kept]).max(initial=1.0) / MOST_KNOTS)
        plants = [np.array(each) for each in zip(*(self._plant(int(place), reach) for place in places), strict=True)]
        fixed = pinned.copy()
        fixed[[0, -1]] = True
        lasting = np.diff(at[kept])[np.searchsorted(kept[1:-1], np.arange(len(at)), side="right")]
        on = np.clip(np.rint(lasting), 1, MOST_KNOTS).astype(np.int64)
        pairs, which = np.unique(np.column_stack([places[node.ravel()], on]), axis=0, return_inverse=True)
        rest = (self._to_go(int(place), int(knots), reach) for place, knots in pairs)
        to_go = [np.array(each) for each in zip(*rest, strict=True)]
        chosen, due, whole = _search(
            at,
            steps,
            command,
            toward,
            int(knots[0]),
            node.ravel(),
            *_tried(steps, kept, fixed, float(self.minimum + 1)),
            fixed,
            at % CUT == 0.0,
            which.ravel(),
            *to_go,
            *plants,
            self._penalty,
            self.free,
            self.minimum,
            self.most,
            float(MOST_KNOTS),
        )
        whole[:, ~self.free] = steps[chosen][:, ~self.free]
        return chosen, due, np.where(fixed[chosen][:, None], points[chosen], self._nozzle(whole))

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
    def _lift_mm(self) -> float:
        """Marlin counts a delta's carriages from the nozzle's height, not from that of the effector's joints."""
        return self.kinematics.effector_height_mm if isinstance(self.kinematics, DeltaKinematics) else 0.0

    @property
    def _penalty(self) -> FloatArray:
        return MISS_COST / self.steps_per_mm**2

    def _plant(self, node: int, reach: int) -> list[FloatArray]:
        """Return A (N, N), B₀, B₁ (N, 3) and C (3, N) of a knot, and what begins at rest in `reach` knots.

        That is x (reach + 1, N, 6) after a ramp of one step a knot, and after a step that rises within the first.
        """
        if (node, reach) not in self._plants:
            p, to_carriages = self.table.plant, np.linalg.inv(self.kinematics.motors) / self.steps_per_mm
            n = len(p.a[node])
            x = _ramped(p.a[node], p.b0[node] @ to_carriages, p.b1[node] @ to_carriages, self.rows)[-1]
            a, b0, b1 = x[:, :n], x[:, n : n + 3], x[:, n + 3 :]
            c = self.table.jacobian[node] @ p.carriage
            begun = np.zeros((reach + 1, n, 6))
            for k in range(reach):
                begun[k + 1] = a @ begun[k]
                begun[k + 1, :, :3] += k * b0 + (k + 1) * b1
                begun[k + 1, :, 3:] += min(k, 1) * b0 + b1
            self._plants[node, reach] = [a, b0, b1, c, begun, c @ begun]
        return self._plants[node, reach]

    def _to_go(self, node: int, knots: int, reach: int) -> tuple[FloatArray, FloatArray]:
        """Return P (N + 3, N + 3) at an end, if segments of so many knots follow, of any direction.

        The second array, (reach + 1, 3, 3, 3), is RᵀPR = [0] - f [1] + f² [2] of a ramp that begins f after a knot.
        """
        key = node, knots, reach
        if key not in self._rest:
            a, b0, b1, c, begun = self._plant(node, reach)[:5]
            n = len(a)
            states = _ramped(a, b0, b1, knots)
            cost = sum((c @ x).T @ (c @ x) for x in states) + np.diag(np.append(np.zeros(n + 3), self._penalty))
            forward = np.vstack([states[-1], np.eye(3, n + 6, n + 3)])
            p = np.zeros((n + 3, n + 3))
            for _ in range(SETTLE):
                whole = cost + forward.T @ p @ forward
                g, h = np.split(whole[n + 3 :], [n + 3], axis=1)
                p = whole[:-3, :-3] - g.T @ np.linalg.solve(h, g)
            k = np.arange(reach + 1)[:, None, None]
            ramp = np.concatenate([begun[:, :, :3], k * np.eye(3)], axis=1)
            late = np.concatenate([begun[:, :, 3:], np.minimum(k, 1) * np.eye(3)], axis=1)
            both = np.swapaxes(ramp, 1, 2) @ p @ late
            alone = (np.swapaxes(each, 1, 2) @ p @ each for each in (ramp, late))
            self._rest[key] = p, np.stack([next(alone), both + np.swapaxes(both, 1, 2), next(alone)], axis=1)
        return self._rest[key]


def _ramped(a: FloatArray, b0: FloatArray, b1: FloatArray, count: int) -> list[FloatArray]:
    """Return x after each of so many intervals, (N, N + 6): of x before them, and of e before and after, linear."""
    n = len(a)
    states = [np.eye(n, n + 6)]
    for k in range(count):
        since, until = (
            np.hstack([np.zeros((3, n)), (1.0 - f) * np.eye(3), f * np.eye(3)]) for f in (k / count, (k + 1) / count)
        )
        states.append(a @ states[-1] + b0 @ since + b1 @ until)
    return states[1:]


@kernel
def _tried(steps: FloatArray, kept: IntArray, fixed: BoolArray, enough: float) -> tuple[BoolArray, BoolArray]:
    """Return which points may end segments, (n,), and which of them must.

    Around segments with too few steps all may; elsewhere those that are kept must.
    """
    m, may, must = len(kept), fixed.copy(), fixed.copy()
    again = np.zeros(m + 1, dtype=np.bool_)  # the segment before each
    for k in range(m - 1):
        if _apart(steps, kept[k], kept[k + 1]) < enough:
            again[max(k + 1 - AROUND, 1) : min(k + 2 + AROUND, m)] = True
    last = 0
    for k in range(m):
        if again[k]:
            for j in range(kept[k - 1] + 1, kept[k] + 1):
                if fixed[j] or _apart(steps, last, j) >= RESOLUTION:
                    may[j], last = True, j
        if not (again[k] and again[k + 1]):
            may[kept[k]], must[kept[k]], last = True, True, kept[k]
    return may, must


@kernel
def _apart(steps: FloatArray, a: int, b: int) -> float:
    """Return the most steps between two points, of any motor."""
    most = 0.0
    for i in range(3):
        most = max(most, abs(steps[b, i] - steps[a, i]))
    return most


@fast_kernel
def _search(
    at: FloatArray,
    steps: FloatArray,
    command: FloatArray,
    toward: FloatArray,
    first: int,
    node: IntArray,
    may: BoolArray,
    must: BoolArray,
    fixed: BoolArray,
    begins: BoolArray,
    which: IntArray,
    go: FloatArray,
    ramped: FloatArray,
    a: FloatArray,
    b0: FloatArray,
    b1: FloatArray,
    c: FloatArray,
    begun: FloatArray,
    shown: FloatArray,
    penalty: FloatArray,
    free: BoolArray,
    minimum: int,
    most: FloatArray,
    longest: float,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return which points end segments, when they are due, and their whole steps, from the first point to the last.

    command, toward (K, 3): steps, and the direction of the path, at knots from `first` on.
    node, which (n,): the plant (g, …) of a point, and its P.
    may, must (n,): which points may end segments, and which must.   begins (n,): where earlier errors no longer count.
    """
    n, size = len(at), a.shape[1]
    motors = int(free[0]) + int(free[1]) + int(free[2])
    around, blocks = 1 << motors, 2 * motors + 2
    count = np.zeros(n, dtype=np.int64)
    place, speed, off = np.zeros((n, around, 3)), np.zeros((n, around, 3)), np.zeros((n, around, 3))
    x, cost, rank = np.zeros((n, around, size)), np.zeros((n, around)), np.zeros((n, around))
    due, lasted = np.zeros((n, around)), np.zeros((n, around))
    came, by = np.zeros((n, around), dtype=np.int64), np.zeros((n, around), dtype=np.int64)
    sight = begun.shape[1]
    state, passed, squares = np.zeros((sight, size)), np.zeros((sight, 4, 4)), np.zeros((2, 4, 4))
    wanted, tried, pace, way = np.zeros(3), np.zeros(3), np.zeros(3), np.ones(4)
    z, pz = np.zeros(size + 3), np.zeros(size + 3)
    count[0] = 1
    for i in range(3):
        place[0, 0, i] = np.floor(steps[0, i] + 0.5) if free[i] else steps[0, i]
        off[0, 0, i] = place[0, 0, i] - steps[0, i]
    due[0, 0] = at[0]
    for p in range(n - 1):
        if count[p] == 0:
            continue
        if begins[p]:
            for i in range(size):
                x[p, 0, i] = 0.0
            cost[p, 0], lasted[p, 0] = 0.0, 0.0
        g = node[p]
        plant, begun_here, shown_here = (a[g], b0[g], b1[g], c[g]), begun[g], shown[g]
        left_on, ramped_on = go[which[p]], ramped[which[p]]
        for h in range(count[p]):
            last, last_speed, last_off = place[p, h], speed[p, h], off[p, h]
            last_due, last_cost, last_lasted = due[p, h], cost[p, h], lasted[p, h]
            origin = int(np.floor(last_due))
            phase = last_due - origin
            known, found = 0, False
            for r in range(size):
                state[0, r] = x[p, h, r]
            at_knot, along = command[origin - first :], toward[origin - first :]
            for j in range(p + 1, n):
                if not may[j]:
                    continue
                if found and at[j] - at[p] > longest:
                    break
                step, ahead = steps[j], 0.0
                for i in range(3):
                    ahead = max(ahead, abs(step[i] - last[i]))
                if ahead < minimum - BEYOND and not fixed[j]:
                    continue
                knots = min(int(np.floor(at[j])) - origin, sight - 1)
                _held(known, knots, last, last_off, at_knot, along, plant, shown_here, phase, state, passed)
                known = max(known, knots)
                bend = earliest = latest = 0.0
                if not fixed[j]:
                    bend, earliest, latest = _slack(at, steps, j, free, last_due, pace)
                    if earliest > latest:
                        continue
                for m in range(max(knots - int(not fixed[j]), 0), knots + 1):
                    for r in range(size):
                        z[r] = state[m, r]
                    for i in range(3):
                        z[size + i] = last[i] - at_knot[m, i] if m > 0 else last_off[i]
                    square = squares[m & 1]
                    _left(m, z, begun_here[m], phase, left_on, ramped_on[m], pz, square)
                    for q in range(4):
                        for r in range(4):
                            square[q, r] += passed[m, q, r]
                if not fixed[j]:
                    _seek(square, last, at[j] - last_due, step, penalty, free, wanted)
                aim, near = step if fixed[j] else wanted, False
                numbers = 1 if fixed[j] else blocks * around
                for number in range(numbers):
                    if near and number >= around:
                        break
                    if not _candidate(number, aim, last, fixed[j], free, minimum, tried):
                        continue
                    near = True
                    shift = 0.0
                    if bend > 0.0:
                        for i in range(3):
                            shift += (tried[i] - step[i]) * pace[i] / bend
                        shift = min(max(shift, earliest), latest)
                    lasting = at[j] + shift - last_due
                    if lasting <= 0.0:
                        continue
                    total, apart = last_cost + SEGMENT_COST, 0.0
                    for i in range(3):
                        way[i] = (tried[i] - last[i]) / lasting
                        apart = max(apart, abs(tried[i] - last[i]))
                        miss = tried[i] - step[i] - shift * pace[i]
                        total += penalty[i] * miss * miss
                        change = most[i] * max(0.5 * (lasting + last_lasted), 1.0)
                        if free[i] and last_lasted > 0.0 and abs(way[i] - last_speed[i]) > change:
                            total += REFUSED
                    if apart < minimum:
                        total += REFUSED
                    m = max(int(np.floor(at[j] + shift)) - origin, knots - 1, 0)
                    square = squares[m & 1]
                    found, left = True, total
                    for q in range(4):
                        for r in range(4):
                            left += square[q, r] * way[q] * way[r]
                    slot = _slot(place[j], rank[j], count[j], tried, left)
                    if slot < 0:
                        continue
                    for q in range(4):
                        for r in range(4):
                            total += passed[m, q, r] * way[q] * way[r]
                    count[j] = max(count[j], slot + 1)
                    rank[j, slot], cost[j, slot], due[j, slot], lasted[j, slot] = left, total, at[j] + shift, lasting
                    came[j, slot], by[j, slot] = p, h
                    for r in range(size):
                        value = state[m, r]
                        for i in range(3):
                            value += (begun_here[m, r, i] - phase * begun_here[m, r, 3 + i]) * way[i]
                        x[j, slot, r] = value
                    for i in range(3):
                        place[j, slot, i], speed[j, slot, i] = tried[i], way[i]
                        if m > 0:
                            off[j, slot, i] = last[i] + way[i] * (m - phase) - at_knot[m, i]
                        else:
                            off[j, slot, i] = last_off[i]
                if must[j] or (found and ahead > FAR * minimum):
                    break
    return _traced(count, rank, came, by, due, place)


@fast_kernel
def _held(
    known: int,
    knots: int,
    place: FloatArray,
    off: FloatArray,
    command: FloatArray,
    toward: FloatArray,
    plant: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    shown: FloatArray,
    phase: float,
    state: FloatArray,
    passed: FloatArray,
) -> None:
    """Fill in x (…, N) at the knots after an end as if its place (3,) were held, and what they cost with a ramp.

    That is wᵀ passed w (…, 4, 4) with w = (steps a knot, 1).

    known, knots: up to where they are filled in, and shall be.   off (3,): e at the first of them.
    command, toward (…, 3): steps and direction from there on.
    """
    a, b0, b1, c = plant[0], plant[1], plant[2], plant[3]
    y, along = np.zeros((3, 4)), np.zeros(4)
    for k in range(known, knots):
        for r in range(a.shape[0]):
            value = 0.0
            for q in range(a.shape[0]):
                value += a[r, q] * state[k, q]
            for i in range(3):
                since = place[i] - command[k, i] if k > 0 else off[i]
                value += b0[r, i] * since + b1[r, i] * (place[i] - command[k + 1, i])
            state[k + 1, r] = value
        along[:] = 0.0
        for r in range(3):
            y[r, 3] = 0.0
            for q in range(a.shape[0]):
                y[r, 3] += c[r, q] * state[k + 1, q]
            for q in range(3):
                y[r, q] = shown[k + 1, r, q] - phase * shown[k + 1, r, 3 + q]
            for q in range(4):
                along[q] += toward[k + 1, r] * y[r, q]
        for q in range(4):
            for r in range(4):
                square = y[0, q] * y[0, r] + y[1, q] * y[1, r] + y[2, q] * y[2, r]
                passed[k + 1, q, r] = passed[k, q, r] + square - (1.0 - ALONG**2) * along[q] * along[r]


@fast_kernel
def _left(
    m: int,
    z: FloatArray,
    begun: FloatArray,
    phase: float,
    go: FloatArray,
    ramped: FloatArray,
    pz: FloatArray,
    out: FloatArray,
) -> None:
    """Fill in zᵀ P z at an end as wᵀ out w (4, 4), w = (steps a knot, 1), after m knots of a ramp.

    z (N + 3,): with the place before held.   go: P.   ramped (3, 3, 3): of the ramp alone.   pz: scratch
    """
    size = len(begun)
    out[3, 3] = 0.0
    for r in range(size + 3):
        pz[r] = 0.0
        for q in range(size + 3):
            pz[r] += go[r, q] * z[q]
        out[3, 3] += z[r] * pz[r]
    for q in range(3):
        cross = (m - phase) * pz[size + q] if m > 0 else 0.0
        for r in range(size):
            cross += (begun[r, q] - phase * begun[r, 3 + q]) * pz[r]
        out[q, 3] = out[3, q] = cross
        for r in range(3):
            out[q, r] = ramped[0, q, r] - phase * ramped[1, q, r] + phase * phase * ramped[2, q, r]


@fast_kernel
def _seek(
    cost: FloatArray,
    last: FloatArray,
    lasting: float,
    step: FloatArray,
    penalty: FloatArray,
    free: BoolArray,
    out: FloatArray,
) -> None:
    """Fill in where an end costs least if steps have no size, (3,), near the command; cost (4, 4): as of `_left`."""
    h, g = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        h[i, i] = penalty[i]
        if free[i]:
            g[i] = -cost[i, 3] / lasting
            for c in range(3):
                g[i] -= cost[i, c] * (step[c] - last[c]) / lasting**2
                if free[c]:
                    h[i, c] += cost[i, c] / lasting**2
    for i in range(3):
        for r in range(3):
            if r != i:
                factor = h[r, i] / h[i, i]
                g[r] -= factor * g[i]
                for c in range(3):
                    h[r, c] -= factor * h[i, c]
    for i in range(3):
        out[i] = step[i] + min(max(g[i] / h[i, i], -BEYOND), BEYOND)


@kernel
def _slack(
    at: FloatArray, steps: FloatArray, j: int, free: BoolArray, last_due: float, pace: FloatArray
) -> tuple[float, float, float]:
    """Fill in the steps a knot at a point; return how it bends there, and how much earlier or later it may be due."""
    whole, bend = at[j + 1] - at[j - 1], 0.0
    for i in range(3):
        pace[i] = (steps[j + 1, i] - steps[j - 1, i]) / whole if free[i] else 0.0
        turn = (steps[j + 1, i] - steps[j, i]) / (at[j + 1] - at[j]) - pace[i] if free[i] else 0.0
        bend += pace[i] * pace[i] + turn * turn
    earliest = max(-MOST_SHIFT * (at[j] - at[j - 1]), last_due + LEAST_KNOTS - at[j])
    return bend, earliest, MOST_SHIFT * (at[j + 1] - at[j])


@kernel
def _candidate(
    number: int, step: FloatArray, last: FloatArray, fixed: bool, free: BoolArray, minimum: int, tried: FloatArray
) -> bool:
    """Fill in the whole steps to try with a number; False: there is none.

    Below 2 to the power of the free motors: around the command. Then one motor is as far from the last end as it must.

    step, last (3,): steps of the command, and of the last end.   fixed: only the nearest
    """
    motors = int(free[0]) + int(free[1]) + int(free[2])
    block = number >> motors  # 0: around; 2 k and 2 k + 1: motor k less or more
    motor, apart = 0, 0.0
    for i in range(3):
        if not free[i]:
            tried[i] = step[i]
            apart = max(apart, abs(tried[i] - last[i]))
            continue
        digit = number >> motor & 1
        motor += 1
        if fixed:
            tried[i] = np.floor(step[i] + 0.5)
        elif motor == block >> 1:
            if digit:
                return False
            tried[i] = last[i] + (minimum if block & 1 else -minimum)
            if abs(tried[i] - step[i]) > BEYOND:
                return False
        else:
            tried[i] = np.floor(step[i]) + digit
        apart = max(apart, abs(tried[i] - last[i]))
    return fixed or apart >= minimum


@kernel
def _slot(place: FloatArray, rank: FloatArray, count: int, tried: FloatArray, left: float) -> int:
    """Return where to keep a way to a point, of those kept so far; -1: nowhere."""
    worst = -1
    for k in range(count):
        if place[k, 0] == tried[0] and place[k, 1] == tried[1] and place[k, 2] == tried[2]:
            return k if left < rank[k] else -1
        if worst < 0 or rank[k] > rank[worst]:
            worst = k
    if count < len(place):
        return count
    return worst if left < rank[worst] else -1


@kernel
def _traced(
    count: IntArray, rank: FloatArray, came: IntArray, by: IntArray, due: FloatArray, place: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the points of the best way to the last point, when they are due, and their steps."""
    n = len(count)
    chosen, times, whole = np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros((n, 3))
    p, h, m = n - 1, 0, n
    for k in range(1, count[p]):
        if rank[p, k] < rank[p, h]:
            h = k
    while True:
        m -= 1
        chosen[m], times[m] = p, due[p, h]
        for i in range(3):
            whole[m, i] = place[p, h, i]
        if p == 0:
            return chosen[m:].copy(), times[m:].copy(), whole[m:].copy()
        p, h = came[p, h], by[p, h]
