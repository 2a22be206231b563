"""How long moves take that go out as they are: planned as the firmware plans them, as far as they are known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import hypot, nan

import numpy as np

from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves
from gcode.program import Event, EventKind, Moves, RawMove
from models.arrays import FloatArray


def raw_durations(events: Iterable[Event], limits: PlannerLimits) -> dict[int, float]:
    """Return how long each move that goes out as it is takes, s, by its line's index.

    Coordinates that are not known do not move. Consecutive moves are planned together, from rest to rest.
    """
    return {
        line: seconds
        for run in _runs(events)
        for line, seconds in zip(
            (event.line for event in run), _durations([event.raw for event in run if event.raw], limits), strict=True
        )
    }


def _runs(events: Iterable[Event]) -> Iterator[list[Event]]:
    """Group raw moves between which nothing rests."""
    run: list[Event] = []
    for event in events:
        apart = event.kind is not EventKind.PASS if event.raw is None else bool(run) and event.move != run[-1].move
        if run and apart:
            yield run
            run = []
        if event.raw is not None:
            run.append(event)
    if run:
        yield run


def _durations(raw: Sequence[RawMove], limits: PlannerLimits) -> FloatArray:
    n = len(raw)
    end = np.nan_to_num(np.array([each.end for each in raw]))
    start = np.array([each.start for each in raw])
    start = np.where(np.isnan(start), end, start)
    moves = Moves(
        line=np.arange(n),
        start=start,
        end=end,
        speed=np.array([each.speed for each in raw]),
        frame=np.zeros(n, dtype=np.int64),
        velocity_limit=np.array([each.velocity_limit for each in raw]),
        acceleration=np.array([each.acceleration for each in raw]),
        square_corner_velocity=np.array([each.square_corner_velocity for each in raw]),
        minimum_cruise_ratio=np.full(n, nan),
    )
    plan = plan_moves(moves, limits, stop_before=np.zeros(n, dtype=np.bool_), wait_before=np.zeros(n))
    straight = [hypot(*(b - a)[:3]) for a, b in zip(start, end, strict=True)]
    longer = [each.path_mm / way if way > 0.0 else 1.0 for each, way in zip(raw, straight, strict=True)]  # arcs
    return np.asarray(plan.duration * np.array(longer))
