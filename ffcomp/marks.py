"""Where the lines of the original go out in a run: at their move's time, with the filament that had gone by then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.plan.trajectory import Trajectory
from ffcomp.runs import Reference, Run
from gcode.program import Event, Program

FloatArray = NDArray[np.float64]

NEAR = 0.05  # of a segment: so near to a knot, a line goes out at the knot
FLOWS_MM = 1e-6  # filament per segment from which on the exact place of a line matters


@dataclass(frozen=True, slots=True)
class Mark:
    """A line of the original that goes out at a point of the run."""

    point: int  # index into Timeline.at
    line: int
    event: Event | None  # None: a move, kept as a comment


@dataclass(frozen=True, slots=True)
class Timeline:
    """The points of a run between which segments are written: all its knots, and places where lines cut a segment."""

    at: FloatArray  # (m,) in knots, strictly rising from 0 to the last
    e: FloatArray  # (m,) mm of filament
    marks: list[Mark]


def timeline(program: Program, trajectory: Trajectory, run: Run, wanted: Reference, inside: list[Event]) -> Timeline:
    """Lay the events inside a run, and its moves, on its knots.

    A line that stands where filament flows cuts its segment at the very moment, so that the filament between two lines
    is kept to the last digit and the flow stays even; others go out at the knot before.
    """
    e = wanted.extrusion()
    e[-1] = program.moves.end[run.last - 1, 3]
    places: list[float] = []
    exact = {float(k): filament for k, filament in enumerate(e.tolist())}
    last = 0.0
    lines = _lines_of(program, run, inside)
    for _, move, event in lines:
        at = min(max(wanted.knot_of(float(trajectory.start_t[move])), last), float(wanted.knots))
        flows = abs(e[min(int(at) + 1, wanted.knots)] - e[int(at)]) > FLOWS_MM
        if event is None or not flows:
            at = max(float(int(at)), last)  # never later than its time: what follows may need its exact place
        elif abs(at - round(at)) < NEAR:
            at = max(float(round(at)), last)
        if event is not None and move > run.first:
            filament = float(program.moves.start[move, 3])
            if at == last and abs(exact[at] - filament) > FLOWS_MM and (places and at < wanted.knots):
                at = min(at + NEAR, float(wanted.knots))  # two lines at one point with filament between them
            exact[at] = filament
        places.append(at)
        last = at
    points = sorted(exact)
    index = {at: i for i, at in enumerate(points)}
    marks = [Mark(index[at], line, event) for at, (line, _, event) in zip(places, lines, strict=True)]
    return Timeline(np.array(points), np.array([exact[at] for at in points]), marks)


def _lines_of(program: Program, run: Run, inside: list[Event]) -> list[tuple[int, int, Event | None]]:
    """(line, move, event) of every original line in a run, in file order; a move's own line has no event."""
    own = program.moves.line[run.first : run.last]
    new = np.flatnonzero(np.diff(own, prepend=-1))  # the chords of an arc share a line
    moves = [(int(own[i]), run.first + int(i), None) for i in new]
    return sorted([*moves, *((event.line, event.move, event) for event in inside)], key=lambda each: each[0])
