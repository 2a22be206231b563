"""When each motor steps, exactly: where a straight piece of path crosses the middles between microsteps.

A carriage stands at b while the effector joint is within the arm's reach, so along a piece, with p the joint's place
seen from the tower, w = b − z − H_ez the height left for the arm at s = 0, and d the piece's direction,

    |p_xy + d_xy s|² + (w − d_z s)² = L²        α s² + 2 β s + γ = 0

    α = |d|²    β = p_xy·d_xy − w d_z    γ = |p_xy|² + w² − L² = δ (2 g + δ)

where g = √(L² − |p_xy|²) is the arm's height at the piece's origin and δ how far the crossing lies above the carriage
there: the difference of large squares is never formed. A carriage's height along a line is concave, so it rises before
its only turning point and falls after it; the smaller root is the crossing on the way up, the larger one on the way
down. Each piece is passed at one speed: s is the time since it began. Filament is linear in s.

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
def _line(places: FloatArray, spacing_s: float, k: int, arm: Arm) -> tuple[float, float, float, float, float]:
    """Return a motor's position at knot k, its slope but for the arm's, and of the arm |d_xy|², p·d_xy and g."""
    x, y, squared, place, slope = arm[0], arm[1], arm[2], arm[3], 0.0
    for axis in range(4):
        place += arm[4 + axis] * places[k, axis]
        slope += arm[4 + axis] * ((places[k + 1, axis] - places[k, axis]) / spacing_s)
    if squared == 0.0:
        return place, slope, 0.0, 0.0, 0.0
    px, py = places[k, 0] - x, places[k, 1] - y
    dx, dy = (places[k + 1, 0] - places[k, 0]) / spacing_s, (places[k + 1, 1] - places[k, 1]) / spacing_s
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
    places: FloatArray,
    times: tuple[float, float],
    knots: tuple[int, int],
    arm: Arm,
    grid: tuple[float, float],
    clock_hz: float,
    rules: Rules,
    state: IntArray,
) -> tuple[IntArray, WayArray]:
    """Compute the steps of one motor between two knots; `state` goes on to the next call.

    Parameters
    ----------
    places, times : see `Knots`: its places, first time and spacing
    knots : first and last
    arm : the motor's row of `Kinematics.motor_rows`; without an arm (L² = 0) it moves evenly: an axis, or the filament
    grid : where the motor began, and one microstep, mm
    rules : ticks; a step that turns back sooner is dropped with the one before, pulses are no closer, and a step after
        a turn comes no sooner
    """
    (start_t, lasts), (start, step) = times, grid
    tick, way, n = np.empty(4096, np.int64), np.empty(4096, np.int8), 0
    for k in range(knots[0], knots[1]):
        t0 = start_t + lasts * k
        place, slope, a, b, g = _line(places, lasts, k, arm)
        turn = _turn(slope, a, b, g)
        for up in (1, -1):
            if (up == 1 and turn <= 0.0) or (up == -1 and turn >= lasts):
                continue
            reached = place + _rise(min(turn, lasts) if up == 1 else lasts, slope, a, b, g)
            steps = int(abs(reached - start - state[LEVEL] * step) / step) + 2
            tick, way = _room(tick, n, steps), _room(way, n, steps)
            while True:
                border = start + (state[LEVEL] + 0.5 * up) * step
                if not up * (reached - border) >= (REVERSAL_MM if state[WAY] == -up else 0.0):
                    break
                s = _crossing(border - place, up == 1, slope, a, b, g)
                at = round((t0 + min(max(s, 0.0), lasts)) * clock_hz)
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
class Knots:
    """n straight pieces between n + 1 knots, each passed at one speed in the same time."""

    start_t: float  # s
    spacing_s: float
    places: FloatArray  # (n + 1, 4) mm, columns X Y Z E

    @property
    def end_t(self) -> float:
        """When the last one is reached, s."""
        return self.start_t + self.spacing_s * (len(self.places) - 1)


def on_grid(places: FloatArray) -> FloatArray:
    """Round coordinates to the grid of commands: a motion file and step timings then describe the same path."""
    return np.rint(places / GRID_MM) * GRID_MM
