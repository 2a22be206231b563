"""What must hold of every compensated file, whatever went in: `violations` says in sentences what does not.

Text: own lines are short plain decimals; every other line is there, in order, at its place along the filament (but for
those that state the print's time, which are ours to change).
Motion: every segment within reach, within the carriages' travel, velocity and acceleration; the filament of the
original, evenly.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ffcomp.compensation.net import FARTHEST_MM, TIMES
from ffcomp.firmware.marlin_planner import MarlinPlanner
from ffcomp.firmware.program import known_to_the_firmware, plan_program, planner_of
from ffcomp.inverse.settings import SEGMENTS_PER_SECOND, nozzle_compliance
from ffcomp.metrics import contour_error
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.reach import within_reach
from gcode.dialect import MARLIN
from gcode.embedded import OURS, TIME_WAS, WAS, original, section_times
from gcode.metadata import tells
from gcode.program import Program
from gcode.reader import read_program
from models.effects.catalogue import design_machine
from models.errors import UnreachableError
from models.machine import Machine

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LONGEST_SEGMENT = 96  # bytes: Marlin's MAX_CMD_SIZE, the shortest of the firmwares'
LONGEST_LINE = 255  # bytes, of Klipper's own commands
FILAMENT_MM = 1e-4  # how far the whole may be from what it was,
HALF_A_COUNT = 5e-6  # and half of the last decimal in the file's own unit
LINE_MM = 5e-3  # how far a line may be from its place: lines that stand close together share a segment's end,
STEPS_MM = 1e-2  # and more where a firmware drops a segment of few steps: six of them move a delta's nozzle 0.2 mm
WAY_MM, WAY_SHARE = 2e-3, 1e-5  # of the filament's way there and back: its last decimal may go to and fro
TURN_MM = 5e-3  # of filament, where it turns back: a segment may hold a little of both ways
BLOCK_ENDS_MM = 0.02  # of a block from its path: what `net` allows, and the last decimal in inches
PLACES = 2e-4  # in the file's own unit: how far the print may end from where it did
VELOCITY_SHARE = 1.02  # of the limit: the file states its numbers with four decimals
ACCELERATION_SHARE = 1.06
SEGMENT_S = 1.0 / SEGMENTS_PER_SECOND

_STAMPS = b"; Processed by ffcomp", b"; ffcomp offset_mm=", b"; ffcomp forecast="
_SEGMENT = re.compile(rb"G1(?: [XYZEF]-?(?:\d+(?:\.\d+)?|\.\d+))+")
_MOVE = re.compile(rb"\s*(?:N\d+\s*)?G0*[0-3](?!\d)|\s*[XYZEFIJKR]\s*[-+.\d]", re.IGNORECASE)
_NOT_A_NUMBER = re.compile(rb"nan|inf|\d[eE][-+]?\d", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Text:
    """A compensated file's lines by their kind."""

    segments: IntArray  # indices of the lines that are segments of ours
    own: list[bytes]  # all other lines of ours
    others: list[int]  # indices of the lines that are the original's


def told_apart(lines: list[bytes]) -> Text:
    """Segments stand between a line of ours that opens a block and the feed that closes it."""
    segments, own, others, is_open = list[int](), list[bytes](), list[int](), False
    for i, line in enumerate(lines):
        if line.startswith((WAS, TIME_WAS, *_STAMPS)):
            continue
        if line.rstrip().endswith(OURS):
            own.append(line)
            is_open = (is_open or not line.startswith(b"G")) and not line.startswith(b"G1 F")
        elif is_open and line.startswith(b"G1 "):
            segments.append(i)
        else:
            others.append(i)
    return Text(np.array(segments, dtype=np.int64), own, others)


def violations(
    before: bytes,
    after: bytes,
    machine: Machine,
    offset_mm: tuple[float, float] = (0.0, 0.0),
    flavor: str | None = None,
) -> list[str]:
    """What is wrong with a compensated file, in sentences; `before` is the file it was made of."""
    known, lines = known_to_the_firmware(machine), after.splitlines(keepends=True)
    read = read_program(before, offset_mm=offset_mm, flavor=flavor, **known)
    written, text = read_program(after, flavor=flavor, **known), told_apart(lines)
    found = [] if original(after) == before else ["The original cannot be read out of the file byte for byte."]
    return [
        *found,
        *_of_text(lines, text),
        *_of_lines(read, written, text),
        *_of_filament(read, written),
        *_of_motion(written, text, machine),
        *_of_path(read, written, text, machine),
    ]


def _of_text(lines: list[bytes], text: Text) -> Iterator[str]:
    kept = max((len(lines[i]) for i in text.others), default=0)  # limits are put back in the file's own words
    for line in text.own:
        if len(line) > max(LONGEST_LINE, kept + len(OURS)) or _NOT_A_NUMBER.search(line.partition(OURS)[0]):
            yield f"A line of ours is too long, or holds a number that is no plain decimal: {line!r}."
    for i in text.segments:
        if len(lines[i]) > LONGEST_SEGMENT or not _SEGMENT.fullmatch(lines[i].rstrip()):
            yield f"A segment is too long, or no plain G1: {lines[i]!r}."


def _of_lines(read: Program, written: Program, text: Text) -> Iterator[str]:
    """Heaters, fans, tools, comments: all that is not a move goes out as it came, where it came."""
    mine, theirs = _places(read, set(range(len(read.lines)))), _places(written, set(text.others))
    if [line for line, _ in mine] != [line for line, _ in theirs]:
        yield "The lines that are not moves are not those of the original."
        return
    most = LINE_MM + (STEPS_MM if read.flavor == MARLIN else 0.0)
    for (line, a), (_, b) in zip(mine, theirs, strict=True):
        if not abs(a - b) <= most:
            yield f"{line!r} stood after {a:.5f} mm of filament and stands after {b:.5f} mm."


def _places(program: Program, kept: set[int]) -> list[tuple[bytes, float]]:
    """Each line that is not a move and tells no time, and how much filament has been moved before it."""
    moved = np.concatenate([[0.0], np.cumsum(program.moves.end[:, 3] - program.moves.start[:, 3])])
    return [
        (program.lines[e.line], float(moved[e.move]))
        for e in program.events
        if e.line in kept and not _MOVE.match(program.lines[e.line]) and not tells(program.lines[e.line])
    ]


def _of_filament(read: Program, written: Program) -> Iterator[str]:
    before, after = (p.moves.end[:, 3] - p.moves.start[:, 3] for p in (read, written))
    way, turns = (np.abs(before).sum(), np.abs(after).sum()), np.count_nonzero(np.diff(np.sign(before[before != 0.0])))
    unit_mm = max(frame.unit_mm for frame in read.frames)
    if not abs(before.sum() - after.sum()) <= FILAMENT_MM + HALF_A_COUNT * unit_mm:
        yield f"The filament was {before.sum():.5f} mm and is {after.sum():.5f} mm."
    if not abs(way[0] - way[1]) <= WAY_MM + WAY_SHARE * way[0] + TURN_MM * turns:
        yield f"There and back the filament went {way[0]:.5f} mm and goes {way[1]:.5f} mm."
    if not np.abs(read.moves.end[-1] - written.moves.end[-1])[:3].max() <= PLACES * unit_mm:
        yield f"The print ended at {read.moves.end[-1, :3]} and ends at {written.moves.end[-1, :3]}."


def _of_motion(written: Program, text: Text, machine: Machine) -> Iterator[str]:
    moves = written.moves
    own = np.isin(moves.line, text.segments)
    if not (np.isfinite(moves.end).all() and np.isfinite(moves.speed).all() and (moves.speed > 0).all()):
        yield "A move goes to, or at, a number that is not finite."
        return
    try:
        machine.kinematics.check_reach(moves.end[own, :3])
    except UnreachableError as error:
        yield str(error)
        return
    yield from _of_carriages(written, own, machine)


def _of_path(read: Program, written: Program, text: Text, machine: Machine) -> Iterator[str]:
    """Sections begin and end where their paths do, leave them by no more than `net` allows, and take little longer."""
    read = within_reach(read, machine.kinematics)  # moves outside the print volume are passed through unchanged
    plan = plan_program(read, machine)
    lasts_s = plan_program(within_reach(written, machine.kinematics), machine).trajectory.end_t
    if lasts_s > 2.0 * plan.trajectory.end_t + 5.0:
        yield f"The print lasted {plan.trajectory.end_t:.1f} s and lasts {lasts_s:.1f} s."
    by_line = {int(read.moves.line[each.first]): each for each in plan.sections if each.travels}
    times = [time for time in section_times(written.lines) if time.line in by_line]
    own = np.flatnonzero(np.isin(written.moves.line, text.segments))
    own = own[np.abs(written.moves.end[own, :3] - written.moves.start[own, :3]).max(axis=1) > PLACES]
    edges = np.searchsorted(written.moves.line[own], [*(time.at for time in times), len(written.lines)])
    compliance_s2 = max(nozzle_compliance(design_machine(machine)[0]))
    for time, (first, last) in zip(times, pairwise(edges), strict=True):
        if first == last:
            continue
        section = by_line[time.line]
        within = slice(section.first, section.last)
        path = np.vstack([read.moves.start[within, :3], read.moves.end[section.last - 1, :3]])
        places = np.vstack([written.moves.start[own[first], :3], written.moves.end[own[first:last], :3]])
        away = contour_error(np.arange(len(path), dtype=np.float64), path, np.zeros(len(places)), places, np.inf)
        most = max(FARTHEST_MM, TIMES * compliance_s2 * float(plan.trajectory.acceleration[within].max()))
        if away.max() > most:
            yield f"line {time.line + 1}: a segment is {away.max():.3f} mm from the path; {most:.2g} mm are allowed."
        begun, ended = (float(np.abs(places[k] - path[k]).max()) for k in (0, -1))
        if max(begun, ended) > BLOCK_ENDS_MM:
            yield f"line {time.line + 1}: the block begins {begun:.4f} mm and ends {ended:.4f} mm beside its path."


def _of_carriages(written: Program, own: NDArray[np.bool_], machine: Machine) -> Iterator[str]:
    """Mean velocities of the segments as the firmware plays them, and their changes."""
    limits, moves = machine.limits, written.moves
    stop_before, wait_before = stops_and_waits(written)
    planner = planner_of(written, machine)
    plan = planner(moves, stop_before=stop_before, wait_before=wait_before)
    low, high = limits.carriage_travel_mm or (-np.inf, np.inf)
    start, end = (machine.kinematics.inverse(places[own, :3]) for places in (moves.start, moves.end))
    if (end < low - PLACES).any() or (end > high + PLACES).any():
        yield f"A carriage goes to {end.min():.3f} … {end.max():.3f} mm; its travel is {low:g} … {high:g} mm."
    block = np.arange(len(moves))  # that each move is executed in
    if isinstance(planner, MarlinPlanner):  # it joins a segment of few steps to the next one
        blocks, ends = planner.blocks(moves, stop_before | (wait_before > 0.0))
        block = np.minimum(np.searchsorted(ends[blocks.target], block), len(blocks.target) - 1)
    jumps = np.append(True, np.abs(start[1:] - end[:-1]).max(axis=1, initial=0.0) > PLACES)[: len(start)]
    changes = (np.diff(block[own], prepend=-1) != 0) | jumps
    first = np.flatnonzero(changes)  # of each block's own segments
    last, duration = np.append(first[1:], len(start)) - 1, np.add.reduceat(plan.duration[own], first)
    velocity = (end[last] - start[first]) / duration[:, None]
    follows = np.flatnonzero(own)[first[1:]] - np.flatnonzero(own)[last[:-1]] == 1
    follows &= ~(stop_before | (wait_before > 0.0))[own][first[1:]]
    # a change counts over a segment's time, as in `invert/limits.py`: a line of the original may have cut one in two
    apart = np.maximum(0.5 * (duration[1:] + duration[:-1]), SEGMENT_S)
    acceleration = (np.diff(velocity, axis=0) / apart[:, None])[follows]
    for name, values, limit, share in (
        ("velocity", velocity, limits.carriage_velocity_mm_per_s, VELOCITY_SHARE),
        ("acceleration", acceleration, limits.carriage_acceleration_mm_per_s2, ACCELERATION_SHARE),
    ):
        if np.abs(values).max(initial=0.0) > share * limit:
            yield f"A carriage's {name} reaches {np.abs(values).max():.0f}; its limit is {limit:g}."
