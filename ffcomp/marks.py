"""Where the lines of the original go out in a run: at their move's time, with the filament that had gone by then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.plan.trajectory import Trajectory
from ffcomp.runs import Reference, Run
from gcode.program import Event, Program

FloatArray = NDArray[np.float64]

ROUNDING = 1e-9  # of a segment
NEAR = 0.1  # of a segment: so near to a knot, a line goes out at the knot; shorter pieces cannot be played in time
FLOWS_MM = 1e-6  # filament per segment from which on the exact place of a line matters
STEEPEST = 0.1  # by which share the flow may be changed between two lines to meet both
SPREAD = 10  # segments' worth of flow over which a difference of filament is spread


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


def timeline(
    program: Program, trajectory: Trajectory, run: Run, wanted: Reference, vertices: FloatArray, inside: list[Event]
) -> Timeline:
    """Lay the events inside a run, and its moves, on its knots, whose vertices are (n + 1, 3) mm.

    A line that stands where filament flows cuts its segment at the very moment, so that the filament between two lines
    is kept; other lines go out at the knot before.
    """
    e = wanted.extrusion()
    e[-1] = program.moves.end[run.last - 1, 3]
    e = _even_wipes(e, vertices)
    lines = _lines_of(program, run, inside)
    places: list[float] = []
    for _, move, event in lines:
        at = min(max(wanted.knot_of(float(trajectory.start_t[move])), 0.0), float(wanted.knots))
        at = max(at, float(int(at + ROUNDING)))  # a knot that rounding has put just before itself
        flows = abs(e[min(int(at) + 1, wanted.knots)] - e[int(at)]) > FLOWS_MM
        if event is None or not flows:
            at = float(int(at))  # never later than its time: what follows may need its exact place
        elif abs(at - round(at)) < NEAR:
            at = float(round(at))
        places.append(max(at, places[-1] if places else 0.0))
    points = np.union1d(np.arange(wanted.knots + 1, dtype=np.float64), np.array(places))
    flowing: dict[float, float] = {}  # point → filament, in the middle of a flow
    turning: dict[float, float] = {}  # where it begins or ends
    for at, (_, move, event) in zip(places, lines, strict=True):
        if event is not None and move > run.first:
            kind = flowing if _extrudes(program, move - 1) and _extrudes(program, move) else turning
            kind[at] = float(program.moves.start[move, 3])
    filament = _filament(e, points, flowing)
    filament[np.searchsorted(points, list(turning))] = list(turning.values())
    marks = [
        Mark(int(np.searchsorted(points, at)), line, event) for at, (line, _, event) in zip(places, lines, strict=True)
    ]
    return Timeline(points, filament, marks)


def _even_wipes(e: FloatArray, vertices: FloatArray) -> FloatArray:
    """Filament that is pulled back while the nozzle moves, shared out by the command's path: (n + 1,) mm at the knots.

    When exactly a retraction pulls does not matter; but firmwares hold its acceleration down and slow down wherever it
    changes against the path, and a wipe pulls so hard that every unevenness would cost time.
    """
    falls = np.flatnonzero(np.diff(e) < -FLOWS_MM)
    if not falls.size:
        return e
    even = e.copy()
    gone = np.concatenate([[0.0], np.cumsum(np.sqrt((np.diff(vertices, axis=0) ** 2).sum(axis=1)))])
    for wipe in np.split(falls, np.flatnonzero(np.diff(falls) > 1) + 1):
        part = slice(int(wipe[0]), int(wipe[-1]) + 2)
        s = gone[part] - gone[part.start]
        if s[-1] > 0.0:
            even[part] = e[part.start] + (e[part.stop - 1] - e[part.start]) * s / s[-1]
    return even


def _extrudes(program: Program, move: int) -> bool:
    return bool(program.moves.end[move, 3] != program.moves.start[move, 3])


def _filament(e: FloatArray, points: FloatArray, known: dict[float, float]) -> FloatArray:
    """Filament at the points, (m,) mm: what is known of it is met exactly, and the flow stays even.

    Between knots the command runs evenly, the plan need not: the difference, a ten-thousandth of a mm, is spread
    over the flow around it. Met in one short segment it would be a jump of flow, and firmwares slow down at those.

    Parameters
    ----------
    e : (n + 1,) mm at the knots;  points : (m,) in knots;  known : point → mm
    """
    knots = np.arange(len(e), dtype=np.float64)
    even = np.interp(points, knots, e)
    if not known:
        return even
    flow = np.abs(np.diff(e))
    gone = np.concatenate([[0.0], np.cumsum(flow)])  # where nothing flows, nothing is spread
    reach = SPREAD * float(np.median(flow[flow > FLOWS_MM])) if (flow > FLOWS_MM).any() else 1.0
    at = np.array(sorted(known))
    place = np.interp(at, knots, gone)
    missing = np.array([known[a] for a in at.tolist()]) - np.interp(at, knots, e)
    nodes, values = [0.0], [0.0]
    for s, m in zip(place.tolist(), missing.tolist(), strict=True):
        # lines close together, or close to the run's end: one is met, the flow stays even
        since, left = s - nodes[-1], float(gone[-1]) - s
        if abs(m - values[-1]) <= STEEPEST * since + FLOWS_MM and abs(m) <= STEEPEST * left + FLOWS_MM:
            if since > 2 * reach:
                nodes += [nodes[-1] + reach, s - reach]
                values += [0.0, 0.0]
            nodes.append(s)
            values.append(m)
    nodes += [min(nodes[-1] + reach, gone[-1]), gone[-1]]
    values += [0.0, 0.0]
    return even + np.interp(np.interp(points, knots, gone), nodes, values)


def _lines_of(program: Program, run: Run, inside: list[Event]) -> list[tuple[int, int, Event | None]]:
    """(line, move, event) of every original line in a run, in file order; a move's own line has no event."""
    own = program.moves.line[run.first : run.last]
    new = np.flatnonzero(np.diff(own, prepend=-1))  # the chords of an arc share a line
    moves = [(int(own[i]), run.first + int(i), None) for i in new]
    return sorted([*moves, *((event.line, event.move, event) for event in inside)], key=lambda each: each[0])
