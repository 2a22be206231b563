"""A print of any length in chapters: cut where the nozzle rests, so that each can be planned and compensated alone.

A chapter brings along what the ones before it leave behind: the moves of which the printer may still ring, and what the
file has said of limits. So chapters can be worked at side by side, and what comes out does not depend on how many are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.plan.limits import lines_of
from ffcomp.plan.lookahead import stops_and_waits
from ffcomp.writer import limits_said
from gcode.cutting import join, split
from gcode.labels import layer_starts
from gcode.program import EventKind, Program

IntArray = NDArray[np.int64]

REMEMBERED_S = 0.5  # of motion before a chapter: more than twice what the printer remembers


@dataclass(frozen=True, slots=True)
class Chapter:
    """A program from rest to rest."""

    program: Program
    before: Program | None  # the moves just before it, from a rest on; None: nothing of ours has moved the nozzle
    said: dict[bytes, bytes]  # of limits, in the lines before
    layers: int  # that have begun in them
    last: bool


def chapters(parts: Iterable[Program]) -> Iterator[Chapter]:
    """Programs that follow each other, cut anew at rests. A part without any goes together with the next one."""
    said: dict[bytes, bytes] = {}
    layers = 0
    before: Program | None = None
    pending: Program | None = None
    for program in parts:
        pending = program if pending is None else join(pending, program)
        rests = _rests(pending)
        if rests.size:
            chapter, pending = split(pending, int(rests[-1]))
            yield Chapter(chapter, before, said, layers, last=False)
            layers += len(layer_starts(chapter))
            said = limits_said(chapter, said)
            before = _remembered(chapter)
    if pending is not None:
        yield Chapter(pending, before, said, layers, last=True)


def _rests(program: Program) -> IntArray:
    """The moves before whose lines the nozzle rests, but for the first."""
    moves = program.moves
    stops, _ = stops_and_waits(program)
    travels = lines_of(moves).travels
    rests = stops | ~travels
    rests[1:] |= ~travels[:-1]
    rests[1:] &= moves.line[1:] != moves.line[:-1]
    rests[:1] = False
    return np.flatnonzero(rests)


def _remembered(chapter: Program) -> Program | None:
    """The last moves of a chapter, from a rest on, that take half a second at least."""
    moves = chapter.moves
    if any(e.move == len(moves) and e.kind in (EventKind.STOP, EventKind.RAW_MOVE) for e in reversed(chapter.events)):
        return None
    quickest = lines_of(moves).length / moves.speed
    left = np.cumsum(quickest[::-1])[::-1]  # until the end, at least
    rests = _rests(chapter)
    enough = rests[left[rests] >= REMEMBERED_S]
    return split(chapter, int(enough[-1]))[1] if enough.size else chapter
