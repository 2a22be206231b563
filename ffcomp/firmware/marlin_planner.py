"""Marlin's own plan: moves as its queue of blocks of whole motor steps plays them.

Where Klipper plans lines of mm as if it saw the whole print, Marlin 2.1 plans blocks of steps and looks ahead as far
as its queue (`marlin_queue`). What decides a print's time and its corners is therefore not the path alone: rates are
whole steps a second, a block with fewer steps than `minimum_steps` is left out and its target joined to the next one's,
the brake path in sight caps the speed of short segments, and the first blocks after a rest are slowed on purpose.

    cut        a delta's lines by time, as Marlin cuts them: each move within one block
    settings   what the file itself sets (M201, M203, M204, M205), in force at each move
    blocks     the queue
    share out  each block's trapezoid among the moves that it covers
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import ceil
from typing import NamedTuple

import numpy as np

from ffcomp.firmware import marlin_queue as q
from ffcomp.firmware.marlin_queue import Blocks, Singles, Targets, phases_of, plan_blocks
from ffcomp.firmware.settings_in_force import SettingsInForce, own_row
from ffcomp.planner.limits import lines_of
from ffcomp.planner.lookahead import timed
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Moves, Program
from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine, MarlinSettings

TURN_CHORDS = 72  # of an arc that turns once, at least (MIN_CIRCLE_SEGMENTS),
CHORD_MM = (0.1, 1.0)  # but none shorter or longer than this (MIN_ARC_SEGMENT_MM, MAX_ARC_SEGMENT_MM)
WHOLE_CHORD = 1e-3  # of a chord that is not missed
EXTRUDER_STEPS_PER_MM = 93.0  # where the machine file states none
STRAIGHT = 1.0 - 1e-9  # cosine between two pieces of a line that is no arc
EVEN_MM = 1e-4  # between the pieces of a line that is no arc
LOW_JERK = 0.25  # of x's and y's: below it a tower's jerk was meant for a lead screw


def on_delta(machine: Machine) -> bool:
    """Whether the motors are those of a delta's towers."""
    return isinstance(machine.kinematics, DeltaKinematics)


def marlin_settings(machine: Machine) -> MarlinSettings:
    """Return the planner's settings, Marlin's defaults where the machine file states none."""
    return machine.marlin or MarlinSettings.within(machine.limits, on_delta(machine))


@dataclass(frozen=True, slots=True)
class MarlinPlanner:
    """Plans moves of one program."""

    machine: Machine
    in_force: SettingsInForce
    filament_zeros: FloatArray  # (frames,) mm of filament at each frame's E0; empty: unknown
    within: bool  # the moves are part of a motion, so that nothing is slowed because the queue fills

    def __call__(
        self, moves: Moves, *, stop_before: BoolArray, wait_before: FloatArray, start_t: float = 0.0
    ) -> Trajectory:
        """Plan moves from rest to rest; parameters as of `lookahead.plan_moves`."""
        blocks, ends = self.blocks(moves, stop_before | (wait_before > 0.0))
        lines = lines_of(moves)
        of_blocks = (blocks.acceleration, blocks.events, tuple(phases_of(blocks)))
        columns = _shared_out(ends[blocks.target], lines.length, moves.speed, *of_blocks)
        return timed(moves, lines, columns, wait_before, start_t)

    def blocks(self, moves: Moves, rests: BoolArray) -> tuple[Blocks, IntArray]:
        """Return Marlin's queue for these moves, and for each target the move that ends there.

        rests : (n,) the queue is empty before the move
        """
        chords = _chords(moves)
        last = chords.last
        first = np.append(0, last[:-1] + 1)
        jumps = np.append(True, np.any(moves.start[1:] != moves.end[:-1], axis=1))[first]
        shift = self._filament_shift(moves)
        # a delta sums the pieces of a line in single precision
        reached = _summed(moves.line, moves.start, moves.end) if on_delta(self.machine) else moves.end
        start = np.full((len(first), 4), np.nan)
        start[jumps] = self._motors(moves.start[first[jumps]], shift[first[jumps]])
        begun = np.concatenate([[0], np.cumsum(rests)])
        by_motors = not (on_delta(self.machine) or self.machine.kinematics.shares_motors)
        length = np.where((chords.length == 0.0) | by_motors, np.nan, chords.length)
        targets = Targets(
            start,
            self._motors(reached[last], shift[last]),
            length,
            moves.speed[last],
            chords.radius,
            chords.arc_left,
            begun[last + 1] > begun[first],
            self.in_force.at(moves)[last],
        )
        s = marlin_settings(self.machine)
        slowdown = s.slowdown and not on_delta(self.machine) and not self.within
        return plan_blocks(targets, s.minimum_steps_per_segment, slowdown), last

    def _filament_shift(self, moves: Moves) -> FloatArray:
        """Return by how much Marlin's filament is off the moves', (n,) mm: after G92 E it counts on from a step."""
        steps_per_mm = settings_row(self.machine)[q.STEPS][3]
        zero = self.filament_zeros[moves.frame] if len(self.filament_zeros) else np.zeros(len(moves.frame))
        shift, count, before = np.zeros(len(zero)), 0.0, 0.0
        begins = np.flatnonzero(np.diff(zero, prepend=np.nan) != 0.0)
        for first, end in zip(begins.tolist(), np.append(begins[1:], len(zero)).tolist(), strict=True):
            at = float(moves.start[first, 3])
            count += np.rint((at - before) * steps_per_mm) - np.rint((at - zero[first]) * steps_per_mm)
            before = zero[first]
            shift[first:end] = count / steps_per_mm - before
        return shift

    def _motors(self, place: FloatArray, filament_shift: FloatArray) -> FloatArray:
        """Return (n, 4) mm of the motors at places (n, 4) of nozzle and filament.

        A delta's are seen from the nozzle's height, in float's digits.
        """
        kinematics, motors = self.machine.kinematics, np.array(np.nan)
        if isinstance(kinematics, DeltaKinematics):
            motors = _carriages(place[:, :3].astype(np.float32), kinematics.towers_mm, kinematics.arm_lengths_mm)
        if np.isnan(motors).any():
            motors = kinematics.inverse(place[:, :3]) @ kinematics.motors.T  # which says what cannot be reached
        return np.column_stack([motors, place[:, 3] + filament_shift])


@kernel
def _carriages(xyz: Singles, towers: FloatArray, arms: FloatArray) -> FloatArray:
    out = np.empty((len(xyz), 3))
    for k in range(3):
        x, y, rod2 = np.float32(towers[k, 0]), np.float32(towers[k, 1]), np.float32(arms[k] * arms[k])
        for i in range(len(xyz)):
            dx, dy = x - xyz[i, 0], y - xyz[i, 1]
            out[i, k] = xyz[i, 2] + np.sqrt(rod2 - (dx * dx + dy * dy))
    return out


@kernel
def _summed(line: IntArray, start: FloatArray, end: FloatArray) -> FloatArray:
    out, n = end.copy(), len(line)
    at, step = np.zeros(4, np.float32), np.zeros(4, np.float32)
    first = 0
    while first < n:
        last = first
        while last + 1 < n and line[last + 1] == line[first]:
            last += 1
        share = np.float32(1.0) / np.float32(last - first + 1)
        for k in range(4):
            at[k] = start[first, k]
            step[k] = (np.float32(end[last, k]) - at[k]) * share
        is_arc = False
        for i in range(first, last):
            for k in range(4):
                at[k] += step[k]
                is_arc |= abs(end[i, k] - at[k]) > EVEN_MM
            if is_arc:
                break
            for k in range(4):
                out[i, k] = at[k]
        first = last + 1
    return out


@kernel
def _shared_out(
    reached: IntArray,
    length: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    events: FloatArray,
    phases: tuple[FloatArray, ...],
) -> FloatArray:
    """Share each block out among the moves that it covers, by their lengths: (7, n), rows as of `lookahead.timed`.

    Moves that Marlin never executes, because nothing follows, count at their own speed.

    reached : (m,) the move at whose end each block ends
    """
    out = np.zeros((7, len(length)))
    first = 0
    for b in range(len(reached)):
        last = reached[b]
        whole = length[first : last + 1].sum()
        entry, level, leave = phases[3][b], phases[4][b], phases[5][b]
        a, scale, done = acceleration[b], whole / events[b], 0.0
        rise, fall = (level**2 - entry**2) / (2.0 * a), (level**2 - leave**2) / (2.0 * a)
        for i in range(first, last + 1):
            if length[i] == 0.0:
                continue
            until = done + length[i] / scale
            v0 = _rate(done, events[b], rise, fall, entry, level, leave, a)
            v1 = _rate(until, events[b], rise, fall, entry, level, leave, a)
            top = level if until > rise and done < events[b] - fall else max(v0, v1)
            out[0, i] = (top - v0) / a if done < rise else 0.0
            out[2, i] = (top - v1) / a if until > events[b] - fall else 0.0
            out[1, i] = max(min(until, events[b] - fall) - max(done, rise), 0.0) / level
            out[3, i], out[4, i], out[5, i], out[6, i] = v0 * scale, top * scale, v1 * scale, a * scale
            done = until
        first = last + 1
    for i in range(first, len(length)):
        out[1, i] = length[i] / speed[i]
        out[3, i], out[4, i], out[5, i], out[6, i] = speed[i], speed[i], speed[i], 1.0
    return out


@kernel
def _rate(
    done: float, events: float, rise: float, fall: float, entry: float, level: float, leave: float, a: float
) -> float:
    """Return the rate after so many events of a block."""
    if done < rise:
        return np.sqrt(entry * entry + 2.0 * a * done)
    left = events - done
    if left < fall:
        return np.sqrt(leave * leave + 2.0 * a * max(left, 0.0))
    return level


def extruder_steps_per_mm(machine: Machine) -> float:
    """Return the extruder's steps per mm of filament, usual ones where the machine file states none."""
    return machine.steps.extruder_steps_per_mm or EXTRUDER_STEPS_PER_MM


def settings_row(machine: Machine) -> FloatArray:
    """Return a machine's own settings as one row of numbers, (COLUMNS,)."""
    s = marlin_settings(machine)
    row = own_row(s)
    row[q.STEPS] = [*machine.steps.per_motor, extruder_steps_per_mm(machine)]
    row[q.RETRACT] = s.retract_acceleration_mm_per_s2
    row[q.DEVIATION] = -1.0 if s.junction_deviation_mm is None else s.junction_deviation_mm
    row[q.LEAST], row[q.LEAST_TRAVEL] = s.lowest_speed_mm_per_s, s.lowest_travel_speed_mm_per_s
    row[q.SHORTEST_US] = 1e6 * s.shortest_segment_s
    return row


# --- How Marlin cuts moves


def cut_moves(program: Program, machine: Machine) -> Program:
    """Cut a delta's lines by time, as Marlin does; arcs have been read as chords that meet where Marlin's do."""
    moves = program.moves
    if not len(moves):
        return program
    if on_delta(machine) and (warning := _low_jerk_warning(program, machine)):
        program = replace(program, warnings=[*program.warnings, warning])
    speed = np.array([frame.feed_mm_per_s for frame in program.frames])[moves.frame]  # M203 caps whole steps, later
    moves = replace(moves, speed=speed)
    change = (moves.end - moves.start)[:, :3]
    mm = np.linalg.norm(change, axis=1)
    count = np.ones(len(moves), dtype=np.int64)
    if on_delta(machine):
        aside = np.any(change[:, :2] != 0.0, axis=1)
        for begin, end in _arcs(moves.line, mm, change):
            aside[begin:end] = False
        per_s = marlin_settings(machine).segments_per_second
        count[aside] = np.maximum((per_s * mm / moves.speed)[aside].astype(np.int64), 1)
    if (count == 1).all():
        return replace(program, moves=moves)
    rows, before = np.repeat(np.arange(len(moves)), count), np.append(0, np.cumsum(count))
    shares = (np.arange(len(rows)) - before[rows] + 1) / count[rows]
    ends = moves.start[rows] + (moves.end - moves.start)[rows] * shares[:, None]
    whole = shares == 1.0
    ends[whole] = moves.end[rows[whole]]
    begins = np.append(True, whole[:-1])
    starts = np.where(begins[:, None], moves.start[rows], np.roll(ends, 1, axis=0))
    columns = {each.name: getattr(moves, each.name)[rows] for each in fields(Moves)} | {"start": starts, "end": ends}
    events = [event._replace(move=int(before[event.move])) for event in program.events]
    return replace(program, moves=Moves(**columns), events=events)


def _low_jerk_warning(program: Program, machine: Machine) -> str:
    """Say where a delta's print sets a jerk for Z that suits a lead screw; empty: nowhere."""
    in_force = SettingsInForce.of(program, machine, settings_row(machine))
    commands = ((event.line, event.limits) for event in program.events if event.limits is not None)
    for (line, command), row in zip(commands, in_force.rows[1:], strict=True):
        x, y, z = row[q.JERK][:3].tolist()
        if command.code == "M205" and "Z" in command.words and z < LOW_JERK * min(x, y):
            return (
                f"line {program.first_line + line + 1}: M205 sets the jerk of Z to {z:g} mm/s, and Z is a tower of "
                "this delta, so that Marlin slows down at nearly every joint of the path; set it to "
                f"{min(x, y):g} like those of X and Y, in the slicer's machine limits."
            )
    return ""


def _arcs(line: IntArray, mm: FloatArray, change: FloatArray) -> list[tuple[int, int]]:
    """Return the first chord of each arc and the one after its last: they share a line of the file, and turn."""
    cosine = np.sum(change[1:] * change[:-1], axis=1) / np.maximum(mm[1:] * mm[:-1], np.finfo(float).tiny)
    bends = np.flatnonzero((line[1:] == line[:-1]) & (cosine < STRAIGHT) & (mm[1:] > 0.0) & (mm[:-1] > 0.0))
    arcs = np.unique(line[bends])
    begin, end = np.searchsorted(line, arcs), np.searchsorted(line, arcs, side="right")
    return list(zip(begin.tolist(), end.tolist(), strict=True))


class _Chords(NamedTuple):
    """What Marlin makes of n moves before its queue: (k,) targets."""

    last: IntArray  # the move at whose end each one lies
    length: FloatArray  # mm
    radius: FloatArray  # mm, of the arc with a joint at its start; 0: none
    arc_left: FloatArray  # mm of the arc after it; 0: none


def _chords(moves: Moves) -> _Chords:
    change = (moves.end - moves.start)[:, :3]
    mm = np.linalg.norm(change, axis=1)
    radius, left, length, kept = np.zeros(len(mm)), np.zeros(len(mm)), mm.copy(), np.ones(len(mm), dtype=np.bool_)
    for begin, end in _arcs(moves.line, mm, change):
        total, turn = float(mm[begin:end].sum()), _turn(mm[begin:end], change[begin:end])
        nth = np.arange(1, arc_chords(total, turn) + 1)
        at = begin - 1 - (-(end - begin) * nth) // len(nth)  # the file's chords are a multiple, or a part of an arc's
        kept[begin:end] = False
        kept[at] = True
        length[at], radius[at] = total / len(nth), total / max(turn, 1e-9)
        left[at] = total * (1.0 - nth / len(nth))
        radius[at[0]], left[end - 1] = 0.0, 0.0
    last = np.flatnonzero(kept)
    return _Chords(last, length[last], radius[last], left[last])


def arc_chords(length: float, turn: float) -> int:
    """Return how many chords Marlin makes of an arc (plan_arc of G2_G3.cpp); length : mm;  turn : rad."""
    shortest, longest = CHORD_MM
    chord = 2.0 * np.pi * length / (TURN_CHORDS * turn) if turn > 0.0 else length
    return max(ceil(length / longest) if chord > longest else int(length / max(chord, shortest) + WHOLE_CHORD), 1)


def _turn(mm: FloatArray, change: FloatArray) -> float:
    """Return by how much an arc turns, rad: the angles between its chords, and half of those that its ends lean by."""
    cosine = np.sum(change[1:] * change[:-1], axis=1) / (mm[1:] * mm[:-1])
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)).sum()) / (1.0 - 0.5 * float(mm[0] + mm[-1]) / float(mm.sum()))
