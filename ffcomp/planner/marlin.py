"""Marlin's own plan: blocks of whole motor steps through a queue of sixteen.

Where Klipper plans lines of mm as if it saw the whole print, Marlin 2.1 plans blocks of steps and looks ahead as far
as its queue. What decides a print's time and its corners is therefore not the path alone: rates are whole steps a
second, a block with fewer steps than `minimum_steps` is left out and its target joined to the next one's, the brake
path in sight caps the speed of short segments, and the first blocks after a rest are slowed on purpose.

The rules are those of Marlin 2.1.2 (`planner.cpp`, GPL: described, not copied), as far as the real planner's own
blocks show them; the tests compare with these block by block. Speeds mm/s along the block, rates steps/s of its
fastest motor ("events"), s and mm.

    populate   length, nominal speed, acceleration, the speed allowed at its beginning
    look-ahead backwards what each block can brake from, forwards what it can reach; entry speeds in v²
    trapezoid  whole events of speeding up and braking, no rate below 120 a second
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from ffcomp.planner.lookahead import stops_and_waits
from gcode.program import Moves, Program
from models.arrays import BoolArray, FloatArray, IntArray
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine, MarlinSettings

QUEUE = 16  # blocks in Marlin's buffer, of which one is always empty
LOWEST_RATE = 120.0  # steps/s (MINIMAL_STEP_RATE): the timer goes no slower
LOWEST_V2 = 0.05**2  # (mm/s)², MINIMUM_PLANNER_SPEED: how a stop is planned
STRAIGHT, REVERSED = -0.999999, 0.999999  # cosines beyond which two lines are one, or there and back
SHORT_MM, SHORT_COSINE = 1.0, -np.sqrt(0.5)  # where a junction deviation also looks at the arc that lines may be of
TURN_CHORDS = 72  # of an arc that turns once, at least (MIN_CIRCLE_SEGMENTS)
EXTRUDER_STEPS_PER_MM = 93.0  # where the machine file states none
_NUMBER = re.compile(rb"[-+]?\d*\.?\d+")
LEAST_TURN = 0.033  # rad, below which Marlin's arc cosine does not go


@dataclass(frozen=True, slots=True)
class Orders:
    """n targets as Marlin's motion queue gets them, each with the settings in force."""

    start: FloatArray  # (n, 4) mm of the motors, where the place is named anew; NaN: where the last one ended
    target: FloatArray  # (n, 4) mm of the motors, columns X Y Z E (or A B C E)
    length: FloatArray  # (n,) mm that the block shall count as long; NaN: by its motors
    speed: FloatArray  # (n,) mm/s
    radius: FloatArray  # (n,) mm of the arc at a joint of which it begins; 0: none
    arc_left: FloatArray  # (n,) mm of the arc that follow and are not queued yet; 0: none
    waits: FloatArray  # (n,) s of rest before it, the queue empty; NaN: none
    settings: FloatArray  # (n, 22), rows as `_row` makes them


@dataclass(frozen=True, slots=True)
class Blocks:
    """m blocks as the planner leaves them."""

    order: IntArray  # (m,) whose target the block reaches
    start: FloatArray  # (m, 4) whole steps
    end: FloatArray  # (m, 4) whole steps
    length: FloatArray  # (m,) mm
    events: FloatArray  # (m,) steps of the fastest motor
    nominal: FloatArray  # (m,) events/s
    entry: FloatArray  # (m,) events/s
    exit: FloatArray  # (m,) events/s
    acceleration: FloatArray  # (m,) events/s²
    accelerate: FloatArray  # (m,) events
    decelerate: FloatArray  # (m,) events


# columns of a row of settings
_STEPS, _SPEED, _ACCELERATION, _PRINT, _RETRACT, _TRAVEL, _DEVIATION, _JUMP, _LEAST, _LEAST_TRAVEL = (
    0, 4, 8, 12, 13, 14, 15, 16, 20, 21,
)  # fmt: skip


def _row(settings: MarlinSettings, steps_per_mm: FloatArray) -> FloatArray:
    """Return the settings as one row of numbers, (22,)."""
    s = settings
    return np.array(
        [
            *steps_per_mm,
            *s.speed_mm_per_s,
            *s.acceleration_mm_per_s2,
            s.printing_acceleration_mm_per_s2,
            s.retract_acceleration_mm_per_s2,
            s.travel_acceleration_mm_per_s2,
            -1.0 if s.junction_deviation_mm is None else s.junction_deviation_mm,
            *s.jerk_mm_per_s,
            s.lowest_speed_mm_per_s,
            s.lowest_travel_speed_mm_per_s,
        ]
    )


def _changed(row: FloatArray, line: bytes) -> FloatArray:
    """Return the settings after a line that sets some (M200-M205.cpp)."""
    code, _, words = line.partition(b";")[0].strip().upper().partition(b" ")
    values = {word[:1].decode(): float(word[1:]) for word in words.split() if _NUMBER.fullmatch(word[1:])}
    row = row.copy()
    if code in (b"M201", b"M203"):
        first = _ACCELERATION if code == b"M201" else _SPEED
        for k, letter in enumerate("XYZE"):
            row[first + k] = values.get(letter, row[first + k])
    elif code == b"M204":
        both = values.get("S")
        row[_PRINT] = values.get("P", both or row[_PRINT])
        row[_TRAVEL] = values.get("T", both or row[_TRAVEL])
        row[_RETRACT] = values.get("R", row[_RETRACT])
    elif code == b"M205":
        row[_LEAST], row[_LEAST_TRAVEL] = values.get("S", row[_LEAST]), values.get("T", row[_LEAST_TRAVEL])
        if row[_DEVIATION] < 0.0:
            for k, letter in enumerate("XYZE"):
                row[_JUMP + k] = values.get(letter, row[_JUMP + k])
        elif 0.01 <= values.get("J", 0.0) <= 0.3:
            row[_DEVIATION] = values["J"]
    return row


class MarlinPlanner:
    """Plans programs that follow each other; settings of one hold in the next."""

    def __init__(self, machine: Machine, settings: MarlinSettings) -> None:
        self.settings, self.kinematics = settings, machine.kinematics
        self.delta = isinstance(machine.kinematics, DeltaKinematics)
        extruder = machine.steps.extruder_steps_per_mm or EXTRUDER_STEPS_PER_MM
        self._in_force = _row(settings, np.append(machine.steps.per_motor, extruder))

    def plan(self, program: Program) -> MarlinPlan:
        """Plan a program as Marlin's queue does, from rest to rest."""
        moves = program.moves
        pieces = self._pieces(moves)
        move, first = pieces.move, pieces.first
        target = moves.start[move] + (moves.end - moves.start)[move] * pieces.share[:, None]
        target[pieces.share == 1.0] = moves.end[move[pieces.share == 1.0]]
        begins = first >= 0
        jumps = np.append(True, np.any(moves.start[1:] != moves.end[:-1], axis=1))
        start = np.where((begins & jumps[first])[:, None], self._motors(moves.start)[first], np.nan)
        stop_before, wait_before = stops_and_waits(program)
        waits = np.where(begins & (stop_before | (wait_before > 0.0))[first], wait_before[first], np.nan)
        orders = Orders(
            start,
            self._motors(target),
            pieces.length,
            moves.speed[move],
            pieces.radius,
            pieces.arc_left,
            waits,
            self._settings_of(program)[move],
        )
        s = self.settings
        slow_s = s.shortest_segment_s if s.slowdown and not self.delta else 0.0
        blocks = plan_blocks(orders, s.minimum_steps_per_segment, slow_s)
        duration = np.bincount(move[blocks.order], durations(blocks), minlength=len(moves)).astype(np.float64)
        return MarlinPlan(blocks, duration, np.cumsum(wait_before + np.append(0.0, duration[:-1])))

    def _settings_of(self, program: Program) -> FloatArray:
        """Return the settings in force at each move, (n, 22), and keep those at the end."""
        rows, changes = [self._in_force], [0]
        for event in program.events:
            if event.touches_limits:
                rows.append(_changed(rows[-1], program.lines[event.line]))
                changes.append(event.move)
        self._in_force = rows[-1]
        return np.repeat(np.array(rows), np.diff(np.append(changes, len(program.moves))), axis=0)

    def _pieces(self, moves: Moves) -> _Pieces:
        """Cut moves as Marlin does: a delta's lines by time, arcs by length and turn; other lines stay whole."""
        change = (moves.end - moves.start)[:, :3]
        mm = np.linalg.norm(change, axis=1)
        count = np.ones(len(moves), dtype=np.int64)
        if self.delta:
            aside = np.any(change[:, :2] != 0.0, axis=1)
            count[aside] = np.maximum((self.settings.segments_per_second * mm / moves.speed)[aside].astype(int), 1)
        by_motors = not (self.delta or self.kinematics.shares_motors)
        parts, done = [], 0
        for begin, end in _arcs(moves, mm):
            parts += [
                _lines(done, begin, count, mm, by_motors),
                _arc(begin, change[begin:end], mm[begin:end], by_motors),
            ]
            done = end
        parts.append(_lines(done, len(moves), count, mm, by_motors))
        return _Pieces(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _motors(self, place: FloatArray) -> FloatArray:
        """Return (n, 4) mm of the motors at places (n, 4) of nozzle and filament."""
        if not len(place):
            return place
        return np.column_stack([self.kinematics.inverse(place[:, :3]) @ self.kinematics.motors.T, place[:, 3]])


class _Pieces(NamedTuple):
    """What Marlin makes of moves before its queue: (k,) arrays."""

    move: IntArray  # in which the piece ends
    share: FloatArray  # of that move which is done then
    first: IntArray  # the move at whose beginning it begins, -1: at none
    length: FloatArray  # mm; NaN: by its motors
    radius: FloatArray  # mm of the arc at a joint of which it begins; 0: none
    arc_left: FloatArray  # mm of the arc after it; 0: none


def _lines(begin: int, end: int, count: IntArray, mm: FloatArray, by_motors: bool) -> _Pieces:
    count = count[begin:end]
    move = np.repeat(np.arange(begin, end), count)
    nth = np.arange(len(move)) - np.repeat(np.cumsum(count) - count, count) + 1
    of_move = count[move - begin]
    length = np.where((mm[move] == 0.0) | by_motors, np.nan, mm[move] / of_move)
    zero = np.zeros(len(move))
    return _Pieces(move, nth / of_move, np.where(nth == 1, move, -1), length, zero, zero)


def _arcs(moves: Moves, mm: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield the first chord of each arc and the one after its last: they share a line of the file."""
    ends = np.flatnonzero(np.append(moves.line[1:] != moves.line[:-1], True)) + 1 if len(moves) else np.zeros(0, int)
    begins = np.append(0, ends[:-1])
    for begin, end in zip(begins[ends - begins > 1].tolist(), ends[ends - begins > 1].tolist(), strict=True):
        if np.all(mm[begin:end] > 0.0):
            yield begin, end


def _arc(begin: int, change: FloatArray, mm: FloatArray, by_motors: bool) -> _Pieces:
    """Cut an arc anew (plan_arc of G2_G3.cpp): chords of 1 mm at most, 72 or more a turn."""
    chords, total = len(mm), float(mm.sum())
    cosine = np.sum(change[1:] * change[:-1], axis=1) / (mm[1:] * mm[:-1])
    turn = float(np.arccos(np.clip(cosine, -1.0, 1.0)).sum()) * chords / (chords - 1)
    count = int(max(np.floor(total), np.ceil(TURN_CHORDS * turn / (2 * np.pi)), 1))
    count = int(np.ceil(total)) if total / count > 1.0 else count
    done = total * np.arange(1, count + 1) / count
    until = np.append(0.0, np.cumsum(mm))
    chord = np.minimum(np.searchsorted(until, done - 1e-9) - 1, chords - 1)
    share = np.minimum((done - until[chord]) / mm[chord], 1.0)
    share[-1] = 1.0
    first = np.full(count, -1)
    first[0] = begin
    length = np.full(count, np.nan if by_motors else total / count)
    radius = np.full(count, total / max(turn, 1e-9))
    radius[0] = 0.0
    return _Pieces(begin + chord, share, first, length, radius, total - done)


@dataclass(frozen=True, slots=True)
class MarlinPlan:
    """n moves as Marlin's queue plays them."""

    blocks: Blocks
    duration: FloatArray  # (n,) s; of what was too short for a block: in the next move's
    start_t: FloatArray  # (n,) s

    @property
    def end_t(self) -> float:
        """When the last move ends, s."""
        return float(self.start_t[-1] + self.duration[-1]) if len(self.duration) else 0.0

    def move_at(self, t: float) -> int:
        """Return the move under way at a time, s."""
        return max(int(np.searchsorted(self.start_t, t, side="right")) - 1, 0)


def plan_blocks(orders: Orders, minimum_steps: int, shortest_segment_s: float) -> Blocks:
    """Plan targets as Marlin's queue does.

    orders : targets in order; the first one says where it starts
    minimum_steps : what has fewer steps of every motor is joined to what follows
    shortest_segment_s : s, to which SLOWDOWN stretches moves while the queue fills; 0: it does not
    """
    raw, order, count = _blocks(
        orders.start,
        orders.target,
        orders.length,
        orders.speed,
        orders.radius,
        orders.arc_left,
        orders.waits,
        orders.settings,
        minimum_steps,
        1e6 * shortest_segment_s,
    )
    return Blocks(order[:count], raw[:count, 0:4], raw[:count, 4:8], *raw[:count, 8:].T)


def durations(blocks: Blocks) -> FloatArray:
    """Return how long each block takes, (m,) s, by its trapezoid over whole events."""
    up, cruise, down = _phases(blocks)
    return up + cruise + down


def _phases(b: Blocks) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Seconds of speeding up, cruising and braking."""
    entry = np.minimum(b.entry, b.nominal)
    free = np.sqrt(entry**2 + 2.0 * b.acceleration * b.accelerate)
    top = np.minimum(free, b.nominal)
    ramp = (top**2 - entry**2) / (2.0 * b.acceleration)  # events; at the nominal rate what is left of them
    up = (top - entry) / b.acceleration + (b.accelerate - ramp) / top
    level = np.where(b.decelerate > b.accelerate, b.nominal, top)
    last = np.sqrt(np.maximum(level**2 - 2.0 * b.acceleration * (b.events - b.decelerate), 0.0))
    return up, (b.decelerate - b.accelerate) / level, (level - last) / b.acceleration


@njit(cache=True, nogil=True)
def _blocks(
    start: FloatArray,
    target: FloatArray,
    length: FloatArray,
    speed: FloatArray,
    radius: FloatArray,
    arc_left: FloatArray,
    waits: FloatArray,
    settings: FloatArray,
    minimum_steps: int,
    slow_us: float,
) -> tuple[FloatArray, IntArray, int]:
    n = len(target)
    out = np.zeros((n, 16))
    order = np.zeros(n, np.int64)
    entry2, most2, accel = np.zeros(n), np.zeros(n), np.zeros(n)  # (mm/s)², mm/s²
    nominal_v = np.zeros(n)
    surely, stale = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    place = np.zeros(4)
    behind_unit, behind_v = np.zeros(4), np.zeros(4)
    behind_nominal, behind_safe = 0.0, 0.0
    tail, planned, head = 0, 0, 0
    for i in range(n):
        s = settings[i]
        if not np.isnan(waits[i]):
            tail = planned = head
        steps = np.empty(4)
        for k in range(4):
            steps[k] = np.floor(target[i, k] * s[k] + 0.5)
        if not np.isnan(start[i, 0]):
            for k in range(4):
                place[k] = np.floor(start[i, k] * s[k] + 0.5)
        d = steps - place
        count = np.abs(d)
        events = max(count[0], count[1], count[2], count[3])
        if events < minimum_steps or events == 0:
            continue
        if head - tail >= QUEUE - 1:  # the oldest block leaves
            if planned == tail:
                planned += 1
            tail += 1
        moved = d / s[:_SPEED]
        still = count[0] < minimum_steps and count[1] < minimum_steps and count[2] < minimum_steps
        mm = abs(moved[3]) if still else np.sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2)
        if not still and not np.isnan(length[i]):
            mm = length[i]
        v = max(speed[i], s[_LEAST] if count[3] > 0 else s[_LEAST_TRAVEL])
        per_s = float(np.float32(v) * (np.float32(1.0) / np.float32(mm)))  # as Marlin's floats round it
        waiting = head - tail
        if slow_us > 0.0 and 2 <= waiting <= QUEUE // 2 - 1:
            us = np.floor(1e6 / per_s + 0.5)
            if us < slow_us:
                per_s = 1e6 / (us + np.floor(2.0 * (slow_us - us) / waiting + 0.5))
        v = mm * per_s
        rate = np.ceil(np.float64(np.float32(events) * np.float32(per_s)))
        factor = 1.0
        axis_v = moved * per_s
        for k in range(4):
            if abs(axis_v[k]) > s[_SPEED + k]:
                factor = min(factor, s[_SPEED + k] / abs(axis_v[k]))
        if factor < 1.0:
            axis_v *= factor
            rate, v = np.floor(rate * factor), v * factor
        per_mm = events / mm
        if count[0] == 0 and count[1] == 0 and count[2] == 0:
            a = np.ceil(s[_RETRACT] * per_mm)
        else:
            a = np.ceil((s[_PRINT] if count[3] > 0 else s[_TRAVEL]) * per_mm)
            for k in range(4):
                most = np.floor(s[_ACCELERATION + k] * s[k])
                if count[k] > 0 and most < a:
                    a = min(a, np.floor(most * events / count[k]))
        acc = a / per_mm
        unit = moved / mm
        safe = v
        if s[_DEVIATION] >= 0.0:
            if count[3] > 0:
                unit = moved / np.sqrt(np.sum(moved**2))
            limit2 = 0.0
            if waiting > 0 and behind_nominal > 1e-6:
                limit2 = min(_deviation(unit, behind_unit, acc, mm, s, radius[i]), v * v, behind_nominal**2)
        else:
            limit, safe = _jerk(
                axis_v, behind_v, v, behind_nominal, behind_safe, s, waiting > 0 and behind_nominal > 1e-6
            )
            limit2 = limit * limit
            behind_safe = safe
        b = head
        order[b] = i
        out[b, 0:4], out[b, 4:8] = place, steps
        out[b, 8], out[b, 9], out[b, 10], out[b, 13] = mm, events, rate, a
        nominal_v[b], most2[b], accel[b] = v, limit2, acc
        entry2[b] = LOWEST_V2
        surely[b] = v * v <= LOWEST_V2 + 2.0 * acc * mm
        stale[b] = True
        behind_unit, behind_v, behind_nominal = unit, axis_v, v
        place[:] = steps
        head += 1
        leaving2 = LOWEST_V2
        if arc_left[i] > 0.0:
            leaving2 = max(min(acc * radius[i], 2.0 * acc * arc_left[i]), LOWEST_V2)
        planned = _look_ahead(tail, planned, head, leaving2, entry2, most2, accel, surely, stale, out)
        _trapezoids(tail, head, np.sqrt(leaving2), entry2, nominal_v, stale, out)
    return out, order, head


@njit(cache=True, nogil=True)
def _deviation(unit: FloatArray, behind: FloatArray, acc: float, mm: float, s: FloatArray, radius: float) -> float:
    """Return the highest v² at the joint of two blocks by junction deviation."""
    cosine = -float(np.sum(unit * behind))
    if cosine > REVERSED:
        return LOWEST_V2
    change = unit - behind
    size = np.sqrt(np.sum(change**2))
    a = acc
    for k in range(4):
        along = abs(change[k]) / size if size > 0.0 else 0.0
        if a * along > s[_ACCELERATION + k]:
            a = s[_ACCELERATION + k] / along
    if radius > 0.0:
        return a * radius
    cosine = max(cosine, STRAIGHT)
    half = float(np.sqrt(0.5 * (1.0 - cosine)))
    v2 = a * float(s[_DEVIATION]) * half / (1.0 - half)
    if mm < SHORT_MM and cosine < SHORT_COSINE:
        v2 = min(v2, mm * a / max(np.arccos(-cosine), LEAST_TURN))
    return v2


@njit(cache=True, nogil=True)
def _jerk(
    axis_v: FloatArray,
    behind: FloatArray,
    v: float,
    behind_nominal: float,
    behind_safe: float,
    s: FloatArray,
    joined: bool,
) -> tuple[float, float]:
    """Return the highest speed at the joint by classic jerk, and from which this block may stop or start at once."""
    safe, limited = v, False
    for k in range(4):
        jump, most = abs(axis_v[k]), s[_JUMP + k]
        if jump > most:
            if limited:
                if jump * safe > most * v:
                    safe = most * v / jump
            else:
                safe, limited = safe * most / jump, True
    if not joined:
        return safe, safe
    smaller = v / behind_nominal if v < behind_nominal else 1.0
    junction = min(v, behind_nominal)
    share, limited = 1.0, False
    for k in range(4):
        leave, enter = behind[k] * smaller * share, axis_v[k] * share
        if leave > enter:
            jump = leave - enter if enter > 0.0 or leave < 0.0 else max(leave, -enter)
        else:
            jump = enter - leave if enter < 0.0 or leave > 0.0 else max(-leave, enter)
        if jump > s[_JUMP + k]:
            share, limited = share * s[_JUMP + k] / jump, True
    if limited:
        junction *= share
    if behind_safe > 0.99 * junction and safe > 0.99 * junction:
        junction = safe
    return junction, safe


@njit(cache=True, nogil=True)
def _look_ahead(
    tail: int,
    planned: int,
    head: int,
    leaving2: float,
    entry2: FloatArray,
    most2: FloatArray,
    accel: FloatArray,
    surely: BoolArray,
    stale: BoolArray,
    out: FloatArray,
) -> int:
    """Backwards: what each block can brake from; forwards: what it can reach. Return the first that may change."""
    if head - 1 == planned:
        return planned
    for b in range(head - 1, planned, -1):
        if entry2[b] != most2[b] or (b + 1 < head and stale[b + 1]):
            after2 = leaving2 if b + 1 == head else entry2[b + 1]
            new = most2[b] if surely[b] else min(most2[b], after2 + 2.0 * accel[b] * out[b, 8])
            if new != entry2[b]:
                entry2[b], stale[b] = new, True
    for b in range(planned + 1, head):
        p = b - 1
        if not surely[p] and entry2[p] < entry2[b]:
            new = entry2[p] + 2.0 * accel[p] * out[p, 8]
            if new < entry2[b]:
                entry2[b], stale[b] = new, True
                planned = b
        if entry2[b] == most2[b]:
            planned = b
    return planned


@njit(cache=True, nogil=True)
def _trapezoids(
    tail: int, head: int, leaving: float, entry2: FloatArray, nominal_v: FloatArray, stale: BoolArray, out: FloatArray
) -> None:
    """Lay out anew the blocks whose ends have changed, and the newest one."""
    for b in range(tail, head - 1):
        if stale[b + 1]:
            stale[b] = True
        if stale[b]:
            _trapezoid(out[b], np.sqrt(entry2[b]) / nominal_v[b], np.sqrt(entry2[b + 1]) / nominal_v[b])
            stale[b] = False
    b = head - 1
    _trapezoid(out[b], np.sqrt(entry2[b]) / nominal_v[b], leaving / nominal_v[b])
    stale[b] = False


@njit(cache=True, nogil=True)
def _trapezoid(block: FloatArray, entry: float, leave: float) -> None:
    """Whole events of speeding up and braking between two shares of the nominal rate."""
    events, nominal, a = block[9], block[10], block[13]
    first = max(np.ceil(nominal * min(entry, 1.0)), min(LOWEST_RATE, nominal))
    last = max(np.ceil(nominal * min(leave, 1.0)), min(LOWEST_RATE, nominal))
    up, down = 0.5 * (nominal**2 - first**2) / a, 0.5 * (nominal**2 - last**2) / a
    rising, falling = np.ceil(up), np.trunc(down)
    if rising < 0.0:
        rising = 0.0
    if falling < 0.0:
        falling = 0.0
    if events - rising - falling < 0.0:
        rising = min(max(np.ceil(0.5 * (events + up - down)), 0.0), events)
        falling = events - rising
    block[11], block[12], block[14], block[15] = first, last, rising, events - falling
