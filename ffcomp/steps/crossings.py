"""When each motor steps, exactly: where a straight piece of path crosses the middles between microsteps.

A carriage stands at b while the effector joint is within the arm's reach, so along a piece, with p the joint's place
seen from the tower, w = b − z − H_ez the height left for the arm at s = 0, and d the piece's direction,

    |p_xy + d_xy s|² + (w − d_z s)² = L²        α s² + 2 β s + γ = 0

    α = |d|²    β = p_xy·d_xy − w d_z    γ = |p_xy|² + w² − L² = δ (2 g + δ)

where g = √(L² − |p_xy|²) is the arm's height at the piece's origin and δ how far the crossing lies above the carriage
there: the difference of large squares is never formed. A carriage's height along a line is concave, so it rises before
its only turning point and falls after it; the smaller root is the crossing on the way up, the larger one on the way
down. Then s → τ is the quadratic v τ + a τ²/2 = s. Filament is linear in s.

Kinematics: Eqs. 3-5 of the delta paper (see models/kinematics/delta.py). The rule of stepping, the tolerance at a
reversal and the filter of rapid step-turn-step pairs are those that Klipper documents and shows (itersolve,
stepcompress), stated here without their iteration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.arrays import FloatArray, IntArray
from models.compiled import kernel

WayArray = NDArray[np.int8]
Columns = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
Arm = tuple[float, float, float, float, float, float, float, float]  # `Kinematics.motor_rows`
Rules = tuple[int, int, int]

REVERSAL_MM = 1e-8  # the command must pass a crossing by so much the other way: far above rounding, far below a step

# One motor's memory between chunks, whole numbers
LEVEL = 0  # microsteps from its start
WAY = 1  # ±1, of the last crossing; 0 before the first
HELD_TICK, HELD_WAY, HELD_KEPT = 2, 3, 4  # the last step: it may yet be dropped, unless it is kept
LAST_TICK, LAST_WAY = 5, 6  # of the last step that went out
LATEST, LATEST_TICK = 7, 8  # by how much a step was put off at most, and which
SWALLOWED = 9  # steps dropped
STATE_SIZE = 10


@kernel
def _line(origin: FloatArray, direction: FloatArray, k: int, arm: Arm) -> tuple[float, float, float, float, float]:
    """Return a motor's position at the origin, its slope but for the arm's, and of the arm |d_xy|², p·d_xy and g."""
    x, y, squared, place, slope = arm[0], arm[1], arm[2], arm[3], 0.0
    for axis in range(4):
        place += arm[4 + axis] * origin[k, axis]
        slope += arm[4 + axis] * direction[k, axis]
    if squared == 0.0:
        return place, slope, 0.0, 0.0, 0.0
    px, py, dx, dy = origin[k, 0] - x, origin[k, 1] - y, direction[k, 0], direction[k, 1]
    height = math.sqrt(squared - px * px - py * py)
    return place + height, slope, dx * dx + dy * dy, px * dx + py * dy, height


@kernel
def _rise(s: float, slope: float, a: float, b: float, g: float) -> float:
    """How far the motor has moved by s: d_z s + √(g² − 2 b s − a s²) − g."""
    if a == 0.0:
        return slope * s
    bent = (2.0 * b + a * s) * s
    return slope * s - bent / (math.sqrt(g * g - bent) + g)


@kernel
def _turn(slope: float, a: float, b: float, g: float) -> float:
    """Where the motor turns, from up to down: d_z √(g² − 2 b s − a s²) = b + a s. ±∞: it never does."""
    if a == 0.0:
        return math.inf if slope > 0.0 else -math.inf
    alpha = a + slope * slope
    u = slope * math.sqrt((a * g * g + b * b) / alpha)
    if u * b > 0.0:
        return (slope * slope * g * g - b * b) / (alpha * (u + b))
    return (u - b) / a


@kernel
def _crossing(rise: float, up: bool, slope: float, a: float, b: float, g: float) -> float:
    """Where the motor has moved by `rise`, on its way up or down."""
    if a == 0.0:
        return rise / slope
    alpha, beta, gamma = a + slope * slope, b - (g + rise) * slope, rise * (2.0 * g + rise)
    root = math.sqrt(max(beta * beta - alpha * gamma, 0.0))
    if (beta < 0.0) == up:
        sum_ = beta - root if up else beta + root
        return -gamma / sum_ if sum_ != 0.0 else 0.0
    return (-beta - root) / alpha if up else (root - beta) / alpha


@kernel
def _time_at(s: float, v: float, a: float, duration: float) -> float:
    """τ with v τ + a τ²/2 = s: the first one, without a difference of near numbers."""
    end_v_plus_v = v + math.sqrt(max(v * v + 2.0 * a * s, 0.0))
    if s <= 0.0 or end_v_plus_v == 0.0:
        return 0.0
    return min(2.0 * s / end_v_plus_v, duration)


@kernel
def _release(state: IntArray, rules: Rules, tick: IntArray, way: WayArray, n: int) -> int:
    """Write the held step, no sooner after the one before than the electronics can follow."""
    _, spacing, setup = rules
    wait = spacing if state[HELD_WAY] == state[LAST_WAY] else max(spacing, setup)
    at = max(state[HELD_TICK], state[LAST_TICK] + wait)
    if at - state[HELD_TICK] > state[LATEST]:
        state[LATEST], state[LATEST_TICK] = at - state[HELD_TICK], at
    tick[n], way[n] = at, state[HELD_WAY]
    state[LAST_TICK], state[LAST_WAY], state[HELD_WAY] = at, state[HELD_WAY], 0
    return n + 1


@kernel
def _step(at: int, up: int, state: IntArray, rules: Rules, tick: IntArray, way: WayArray, n: int) -> int:
    """One crossing: with the step held before it, it may be one that turns back too soon to be worth going."""
    state[LEVEL] += up
    state[WAY] = up
    if state[HELD_WAY] == -up and state[HELD_KEPT] == 0 and at - state[HELD_TICK] < rules[0]:
        state[HELD_WAY] = 0
        state[SWALLOWED] += 2
        return n
    if state[HELD_WAY] != 0:
        n = _release(state, rules, tick, way, n)
    state[HELD_TICK], state[HELD_WAY], state[HELD_KEPT] = at, up, 0
    return n


@kernel
def _room(array: NDArray[Any], used: int, more: int) -> NDArray[Any]:
    """Return the array itself, or a longer copy that `more` entries fit in."""
    if used + more <= len(array):
        return array
    longer = np.empty(2 * (used + more), array.dtype)
    longer[:used] = array[:used]
    return longer


@kernel
def step_times(
    pieces: Columns, arm: Arm, grid: tuple[float, float], clock_hz: float, rules: Rules, state: IntArray
) -> tuple[IntArray, WayArray]:
    """Compute the steps of one motor along a chunk of pieces; `state` goes on to the next chunk.

    Parameters
    ----------
    pieces : start_t, duration, origin, direction, start_v, acceleration, as in `Pieces`
    arm : the motor's row of `Kinematics.motor_rows`; without an arm (L² = 0) it moves evenly: an axis, or the filament
    grid : where the motor began, and one microstep, mm
    rules : ticks; a step that turns back sooner is dropped with the one before, pulses are no closer, and a step after
        a turn comes no sooner
    """
    start_t, duration, origin, direction, start_v, acceleration = pieces
    start, step = grid
    tick, way, n = np.empty(4096, np.int64), np.empty(4096, np.int8), 0
    for k in range(len(start_t)):
        t0, lasts, v, gain = start_t[k], duration[k], start_v[k], acceleration[k]
        place, slope, a, b, g = _line(origin, direction, k, arm)
        end = (v + 0.5 * gain * lasts) * lasts
        turn = _turn(slope, a, b, g)
        for up in (1, -1):
            if (up == 1 and turn <= 0.0) or (up == -1 and turn >= end):
                continue
            reached = place + _rise(min(turn, end) if up == 1 else end, slope, a, b, g)
            steps = int(abs(reached - start - state[LEVEL] * step) / step) + 2
            tick, way = _room(tick, n, steps), _room(way, n, steps)
            while True:
                border = start + (state[LEVEL] + 0.5 * up) * step
                if not up * (reached - border) >= (REVERSAL_MM if state[WAY] == -up else 0.0):
                    break
                s = _crossing(border - place, up == 1, slope, a, b, g)
                at = round((t0 + _time_at(s, v, gain, lasts)) * clock_hz)
                n = _step(at, up, state, rules, tick, way, n)
            if state[HELD_WAY] == up and up * (reached - start - state[LEVEL] * step) >= 0.0:
                state[HELD_KEPT] = 1  # the command reached the microstep itself: no flutter about a border
    return tick[:n], way[:n]


@kernel
def last_step(rules: Rules, state: IntArray) -> tuple[IntArray, WayArray]:
    """Return the step that is still held, if there is one."""
    tick, way = np.empty(1, np.int64), np.empty(1, np.int8)
    n = _release(state, rules, tick, way, 0) if state[HELD_WAY] != 0 else 0
    return tick[:n], way[:n]


GRID_MM = 2.0**-13  # 0.12 µm, a hundredth of a microstep: a command's knots lie on it, whatever is written of them


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """n pieces in order of time; between two of them the nozzle rests. It never moves backwards along a piece."""

    start_t: FloatArray  # (n,) s
    duration: FloatArray  # (n,) s
    origin: FloatArray  # (n, 4) mm, columns X Y Z E
    direction: FloatArray  # (n, 4) mm per unit of path
    start_v: FloatArray  # (n,) units of path per s
    acceleration: FloatArray  # (n,) units of path per s²

    def __len__(self) -> int:
        return len(self.start_t)

    def __getitem__(self, part: slice) -> Pieces:
        return Pieces(*(column[part] for column in self.columns))

    @property
    def columns(self) -> tuple[FloatArray, ...]:
        """All of them, in their order."""
        return self.start_t, self.duration, self.origin, self.direction, self.start_v, self.acceleration

    @property
    def path(self) -> FloatArray:
        """How far each piece goes, (n,) units of path."""
        return (self.start_v + 0.5 * self.acceleration * self.duration) * self.duration

    @property
    def end(self) -> FloatArray:
        """Where each piece ends, (n, 4) mm."""
        return self.origin + self.direction * self.path[:, None]


def on_grid(places: FloatArray) -> FloatArray:
    """Round coordinates to the grid of commands: a motion file and step timings then describe the same path."""
    return np.rint(places / GRID_MM) * GRID_MM


def knot_pieces(start_t: float, spacing_s: float, vertices: FloatArray, filament: FloatArray) -> Pieces:
    """Straight lines at constant speed from knot to knot, `spacing_s` apart in time.

    vertices : (n + 1, 3) mm, columns X Y Z;  filament : (n + 1,) mm
    """
    corners = np.column_stack([vertices, filament])
    n = len(corners) - 1
    return Pieces(
        start_t=start_t + spacing_s * np.arange(n, dtype=np.float64),
        duration=np.full(n, spacing_s),
        origin=corners[:-1],
        direction=np.diff(corners, axis=0) / spacing_s,  # the path is counted in seconds
        start_v=np.ones(n),
        acceleration=np.zeros(n),
    )
