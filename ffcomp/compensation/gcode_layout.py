"""Where the lines of the original go out in a run: at their move's time, with the filament that had gone by then.

A long run is laid out and written tile by tile. No segment is joined across a knot whose number is a multiple of CUT,
and what is asked of the filament reaches no further than that: so tiles that end there say, with a little of what lies
around them in sight, what the whole run says.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import CUT
from ffcomp.planner.lifts import FLOWS_MM, even_wipes
from ffcomp.planner.trajectory import Section, Trajectory
from gcode.program import Event, Program
from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel

ROUNDING = 1e-9  # of a segment
KNOT_TOLERANCE = 0.1  # of a segment: so near to a knot, a line goes out at the knot
CONTEXT_KNOTS = 2 * CUT  # knots on either side of a tile, until which one junction of a wipe leans on the next
TILE_KNOTS = 64 * CUT


@dataclass(frozen=True, slots=True)
class Tile:
    """The part of a run that is written at one go: knots, all of them multiples of CUT or the run's ends.

    The context around it is not written, but decides how fast its ends are passed.
    """

    first: int  # its context begins here
    begin: int  # its first segment begins here,
    end: int  # and its last one ends here
    last: int  # its context ends here


def tiles(knots: int, length: int = TILE_KNOTS, begin: int = 0, end: int | None = None) -> list[Tile]:
    """Cut a section, or what lies between two of its knots, into tiles of `length` segments, a multiple of CUT."""
    if length % CUT:
        raise ValueError(f"A tile of {length} segments would end between two cuts; its length must divide by {CUT}.")
    end = knots if end is None else end
    edges = [*range(begin, max(end, begin + 1), length), end]
    return [Tile(max(a - CONTEXT_KNOTS, 0), a, b, min(b + CONTEXT_KNOTS, knots)) for a, b in pairwise(edges)]


@dataclass(frozen=True, slots=True)
class Timeline:
    """The points between which segments are written, all knots and the places where lines cut a segment; and the lines.

    m points, k lines of the original in the file's order.
    """

    tile: Tile
    at: FloatArray  # (m,) in knots of the run, strictly rising from tile.first to tile.last
    e: FloatArray  # (m,) mm of filament
    cut: BoolArray  # (m,) no segment is joined across it: a point with an event, every CUT-th knot, the end
    point: IntArray  # (k,) index into `at`: where the line goes out
    line: IntArray  # (k,) index into Program.lines
    event: IntArray  # (k,) index into `events`; -1: a move, kept as a comment
    events: list[Event]
    lead_s: float  # from the section's first knot to the beginning of its path


def timeline(
    program: Program,
    trajectory: Trajectory,
    run: Section,
    reference: Reference,
    vertices: FloatArray,
    inside: list[Event],
    tile: Tile,
) -> Timeline:
    """Lay the events inside a run, and its moves, on its knots.

    A line that stands where filament flows cuts its segment at the very moment, so that the filament between two lines
    is kept; other lines go out at the knot before.

    Parameters
    ----------
    vertices : (n + 1, 3) mm, columns X Y Z, at the knots tile.first … tile.last
    inside : all events of the run, in the file's order
    tile : the part of the run to lay out
    """
    e = reference.extrusion(tile.first, tile.last)
    if tile.last == reference.knots:
        e[-1] = program.moves.end[run.last - 1, 3]
    line, move, event, among = _lines_of(program, trajectory, run, reference, inside, tile)
    at = np.array([reference.knot_of(t) for t in trajectory.start_t[move].tolist()])
    knots, filament, cut, place, point = _lay_out(at, event >= 0, e, vertices, tile.first, reference.shortest_knots)
    cut[np.searchsorted(knots, tile.end)] = True  # where a motion is cut that had to be slowed down
    between = np.flatnonzero((event >= 0) & (move > run.first))
    if len(between):
        stand = [among[k] for k in event[between].tolist()]
        _meet_the_events(filament, program, move[between], stand, place[between], point[between])
    return Timeline(tile, knots, filament, cut, point, line, event, among, run.begin_t - reference.t0)


def _lines_of(
    program: Program, trajectory: Trajectory, run: Section, reference: Reference, inside: list[Event], tile: Tile
) -> tuple[IntArray, IntArray, IntArray, list[Event]]:
    """Return the k lines of the original whose time lies in a tile or its context, in the file's order.

    Before a run's first knot and after its last there may be lines too.

    Returns
    -------
    lines (k,); the moves they stand before, or are (k,); indices into the events (k,), -1: a move; the events
    """
    begun = trajectory.start_t[run.first : run.last]
    first, last = run.first, run.last
    if tile.first > 0:
        first += bisect_left(begun, float(tile.first), key=reference.knot_of)
    if tile.last < reference.knots:
        last = run.first + bisect_left(begun, float(tile.last), key=reference.knot_of)
    lines_in_file = program.moves.line[max(first - 1, run.first) : last]
    new = np.flatnonzero(lines_in_file[1:] != lines_in_file[:-1]) + 1  # the chords of an arc share a line
    if first == run.first:
        new = np.concatenate([[0], new])
    line, move, event = lines_in_file[new], max(first - 1, run.first) + new, np.full(len(new), -1)
    among = inside[_before(inside, first) : _before(inside, last)]
    if among:
        line = np.concatenate([line, np.array([each.line for each in among])])
        move = np.concatenate([move, np.array([each.move for each in among])])
        event = np.concatenate([event, np.arange(len(among))])
        order = np.argsort(line)
        line, move, event = line[order], move[order], event[order]
    return line, move, event, among


def _before(events: list[Event], move: int) -> int:
    return bisect_left(events, move, key=lambda event: event.move)


@kernel
def _lay_out(
    at: FloatArray, stands: BoolArray, e: FloatArray, vertices: FloatArray, first: int, shortest: float
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, IntArray]:
    """Lay k lines on the knots; those that stand where filament flows have points between the knots.

    Parameters
    ----------
    at : (k,) the lines' times in knots
    stands : (k,) whether it stands between moves (an event) or is one
    e : (n + 1,) mm of filament at the knots from `first` on; wipes are evened in place, but not across an event, at
        which the filament is known
    vertices : (n + 1, 3) mm
    shortest : knots that a segment must have

    Returns
    -------
    `at`, `e` and `cut` of `Timeline` (m,), where each line goes out (k,), in knots, and its index into `at` (k,)
    """
    place = _places(at, stands, e, first, shortest)
    n = len(e)
    known = (first + np.arange(n)) % CUT == 0
    for k in range(len(place)):
        if stands[k] and place[k] >= first:
            knot = place[k] - first
            known[int(np.floor(knot))] = known[int(np.ceil(knot))] = True
    even_wipes(e, vertices, known)
    points, filament, cut = np.empty(n + len(at)), np.empty(n + len(at)), np.zeros(n + len(at), dtype=np.bool_)
    point = np.empty(len(at), dtype=np.int64)
    m, line = 0, 0
    for k in range(n):
        points[m], filament[m], cut[m] = first + k, e[k], (first + k) % CUT == 0
        while line < len(place) and place[line] < first + k + 1:
            since = place[line] - (first + k)
            if since > 0.0 and place[line] > points[m]:
                m += 1
                points[m], filament[m] = place[line], (e[k + 1] - e[k]) * since + e[k]
            point[line] = m
            cut[m] |= stands[line]  # a move of ours is a comment: it does not matter which segment it stands before
            line += 1
        m += 1
    return points[:m], filament[:m], cut[:m], place, point


@kernel
def _places(at: FloatArray, stands: BoolArray, e: FloatArray, first: int, shortest: float) -> FloatArray:
    """Where lines go out, (k,) in knots, rising: at knots and at each other, or at least the shortest segment apart."""
    places = np.empty(len(at))
    last = first + len(e) - 1
    latest = pinned = 0.0
    for i in range(len(at)):
        # no event is the last line of a run: the move behind it has a segment of its own
        place = min(max(at[i], 0.0), last - shortest if stands[i] else float(last))
        place = max(place, np.floor(place + ROUNDING))  # a knot that rounding has put just before itself
        knot = int(place)
        flows = abs(e[min(knot + 1, last) - first] - e[knot - first]) > FLOWS_MM
        if not stands[i] or not flows:
            place = float(knot)  # never later than its time: the next line may need its exact place
        else:
            if 0.0 < place - pinned < shortest:
                place = pinned if place - pinned < 0.5 * shortest else pinned + shortest
            knot = int(np.rint(place))
            if abs(place - knot) < (
                shortest if knot in (0, last) or knot % CUT == 0 else min(KNOT_TOLERANCE, shortest)
            ):
                place = float(knot)
        latest = max(latest, place)
        if stands[i]:
            pinned = latest
        places[i] = latest
    return places


def _meet_the_events(
    filament: FloatArray, program: Program, move: IntArray, events: list[Event], place: FloatArray, point: IntArray
) -> None:
    """Restore the original's filament, in place, at events where a flow begins, ends or turns back.

    In the middle of a flow it is off by a micrometre: the plan does not run as evenly from knot to knot as the command.

    Parameters
    ----------
    filament : (m,) mm
    move, events, place, point : (k,) events between moves: the move behind each, its place in knots, its point
    """
    start, end = program.moves.start[:, 3], program.moves.end[:, 3]
    turns = np.flatnonzero(~((end[move - 1] - start[move - 1]) * (end[move] - start[move]) > 0.0))
    turns = turns[np.flatnonzero(np.diff(place[turns], append=np.inf))]  # the last at each place
    filament[point[turns]] = start[move[turns]]
    # where an event gives the filament's place another number (G92 E0), it must be exact: later it never would be
    frames = [program.frames[each.frame].base[3] for each in events]
    renamed = np.array([program.frames[k].base[3] for k in program.moves.frame[move - 1].tolist()]) != frames
    filament[point[renamed]] = start[move[renamed]]
