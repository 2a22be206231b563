"""Align the clock of a compensated file with that of its original, which its comments keep.

A note stands in the compensated file where each line of the original was; the moves of both are tied together there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.inverse.settings import Settings
from ffcomp.planner.program import PlannedProgram
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion
from ffcomp.simulate.motion import Clock
from gcode.embedded import WAS, noted
from gcode.program import Program
from models.arrays import FloatArray, IntArray

FEWEST_HZ, MOST_HZ = 125.0, 500.0  # of segments


def section_clock(compensated: PlannedProgram, original: PlannedProgram) -> Clock:
    """Return when each section of the original begins in the compensated file: where its first move is noted.

    The note stands at the knot at or before the section's beginning, `lead_s` after the first knot. NOTE: where both
    fall together, rounding may have put it one knot early; the time left until the section's end tells.
    """
    sections, note_t, executed_end_t = _noted_sections(compensated, original)
    begin_t, end_t = np.array([s.begin_t for s in sections]), np.array([s.end_t for s in sections])
    usual, segment_s = Settings(), _segment_s(compensated)
    knots = np.ceil((usual.lead_s + (end_t - begin_t) + usual.tail_s) / segment_s - 1e-9)
    before = np.floor(usual.lead_s / segment_s + 1e-9)
    early = executed_end_t - note_t > (knots - before + 0.5) * segment_s
    executed_t = note_t + segment_s * early + (usual.lead_s - before * segment_s)
    return Clock(executed_t, begin_t, begin_t, end_t)


@dataclass(frozen=True, slots=True)
class MoveTimes:
    """Times at which the same k moves begin, a knot early at most, and at which both files end."""

    compensated_t: FloatArray  # (k + 1,) s
    original_t: FloatArray  # (k + 1,) s


def move_times(compensated: Program, executed: PlannedMotion, original: Program, reference: PlannedMotion) -> MoveTimes:
    """Return the times of every noted move on both plans."""
    notes, moves = _noted_moves(compensated, original)
    begins = np.append(executed.start_t, executed.end_t)[notes]
    return MoveTimes(np.append(begins, executed.end_t), np.append(reference.start_t[moves], reference.end_t))


def _noted_sections(
    compensated: PlannedProgram, original: PlannedProgram
) -> tuple[list[Section], FloatArray, FloatArray]:
    """Return the original's sections that travel, m of them, when each is noted, and when its command has ended."""
    executed = compensated.trajectory
    notes, moves = _noted_moves(compensated.program, original.program)
    note_of = dict(zip(moves.tolist(), notes.tolist(), strict=True))
    sections = [section for section in original.runs if section.travels and section.first in note_of]
    note_t = np.append(executed.start_t, executed.end_t)[[note_of[section.first] for section in sections]]
    ends = np.array([section.end_t for section in compensated.runs if section.travels])
    return sections, note_t, ends[np.minimum(np.searchsorted(ends, note_t, side="right"), len(ends) - 1)]


def _noted_moves(compensated: Program, original: Program) -> tuple[IntArray, IntArray]:
    """Return the moves of the compensated file before which moves of the original are noted, and those, (k,) each."""
    notes = np.array([e.move for e in compensated.events if compensated.lines[e.line].startswith(WAS)], dtype=np.int64)
    first = np.flatnonzero(np.diff(original.moves.line, prepend=-1))  # of each line that moves
    moving_line = _moving_lines(compensated, original)
    moves = moving_line >= 0
    return notes[moves], first[moving_line[moves]]


def _moving_lines(compensated: Program, original: Program) -> IntArray:
    """Return which of the original's moving lines each note stands for; -1 for a line that only sets a feed."""
    order = {line: i for i, line in enumerate(sorted(set(original.moves.line.tolist())))}
    texts = [text for line in compensated.lines if (text := noted(line)) is not None]
    out, at = [], 0
    for text in texts:
        while original.lines[at] != text and original.lines[at].rstrip() != text.rstrip():
            at += 1
        out.append(order.get(at, -1))
        at += 1
    return np.array(out, dtype=np.int64)


def _segment_s(compensated: PlannedProgram) -> float:
    """Return the time of a segment: the most frequent one, of those that can be asked for."""
    a_second = np.round(1 / np.maximum(compensated.trajectory.duration, 1e-9), 1)
    rate, count = np.unique(a_second[(a_second >= FEWEST_HZ) & (a_second <= MOST_HZ)], return_counts=True)
    return 1 / float(rate[int(count.argmax())]) if len(rate) else Settings().segment_s
