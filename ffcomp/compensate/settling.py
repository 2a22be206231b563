"""How long to wait until the ringing of a motion that is not compensated has died away.

What the firmware moves by itself (homing, macros, moves from a place not known) ends in a plain ramp. A ramp of
acceleration a leaves at most 2 a / ω² of vibration: a / ω² for its beginning, as much for its end. It decays with
exp(-ζ ω t), so that after

    t = ln(2 a / (ω² r)) / (ζ ω)

no more than r is left. Travel between that motion and the first extrusion counts; only what is missing is waited for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.program import PlannedProgram
from ffcomp.planner.raw_moves import raw_durations
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion
from gcode.program import Event, Moves
from models.arrays import BoolArray, FloatArray
from models.machine import Machine
from models.vibration.base import Modes

LEFT_MM = 1e-3  # of vibration, when the first compensated extrusion begins
SHARE = 0.05  # of the largest motion of the nozzle in a mode: below it, motion along an axis does not excite the mode
SHORTEST_S = 0.002  # not worth a line


def settling_waits(
    planned: PlannedProgram,
    machine: Machine,
    raw_s: Mapping[int, float],
    sections: Iterable[Section],
    earlier: Sequence[Event] = (),
) -> dict[int, float]:
    """Return how long to wait before sections, s, by their first move; sections without a wait are left out.

    Parameters
    ----------
    planned : PlannedProgram
    machine : Machine
        Its modes say how long it rings.
    raw_s : mapping
        How long moves take that go out as they are, s, by their line's index.
    sections : iterable of Section
        Those that are written from their beginning, in order.
    earlier : sequence of Event
        The lines just before the program, after the last move.
    """
    moves, events = planned.program.moves, planned.program.events
    extruding = np.flatnonzero((moves.end[:, 3] > moves.start[:, 3]) & _travels(moves))
    disturbed = [event.move for event in events if event.moves_itself]
    pending = _lasting(earlier, raw_durations(earlier, planner_limits(machine)))
    waits = {}
    at = 0
    for section in sections:
        since = at
        while at < len(events) and events[at].move <= section.first:
            at += 1
        pending += _lasting(events[since:at], raw_s)
        needed = _needed_s(pending, machine, moves.start[section.first, :2])
        pending = []
        if needed <= 0.0:
            continue
        k = int(np.searchsorted(extruding, section.first))
        if k == len(extruding) or any(section.first < move <= extruding[k] for move in disturbed):
            continue  # nothing is extruded before the firmware moves by itself again
        wait = needed - _between_s(planned.trajectory, section, int(extruding[k]))
        if wait > SHORTEST_S:
            waits[section.first] = math.ceil(1e3 * wait) / 1e3
    return waits


def ringing_s(machine: Machine, xy: FloatArray, acceleration: float, axes: Iterable[int]) -> float:
    """Return how long a ramp along some axes of the nozzle is felt, s.

    Parameters
    ----------
    xy : (2,) array
        Where the nozzle is, mm.
    acceleration : float
        Of the ramp, mm/s².
    axes : of 0, 1, 2
        Along which it may have moved.
    """
    (modes,) = machine.vibration.modes(xy[None])
    return max((_mode_s(*mode, acceleration) for mode in _excited(modes, list(axes))), default=0.0)


def _excited(modes: Modes, axes: list[int]) -> list[tuple[float, float]]:
    """Return angular frequency and damping ratio of the modes that move the nozzle along one of the axes."""
    motion = np.abs(modes.nozzle)
    takes_part = (motion[:, axes] > SHARE * motion.max(initial=0.0)).any(axis=1)
    w = 2.0 * np.pi * modes.frequencies_hz[takes_part]
    return list(zip(w.tolist(), modes.damping_ratios[takes_part].tolist(), strict=True))


def _mode_s(w: float, damping: float, acceleration: float) -> float:
    too_much = 2.0 * acceleration / (w * w * LEFT_MM)
    return math.log(too_much) / (damping * w) if too_much > 1.0 and damping > 0.0 else 0.0


def _lasting(events: Iterable[Event], raw_s: Mapping[int, float]) -> list[tuple[Event, float]]:
    """Return events with what they take, s, as far as it is known."""
    return [(event, event.dwell_s + raw_s.get(event.line, 0.0)) for event in events]


def _needed_s(events: list[tuple[Event, float]], machine: Machine, xy: FloatArray) -> float:
    """Return how long what these events move still rings after the last of them, s."""
    needed = since = 0.0
    for event, seconds in reversed(events):
        if event.moves_itself:
            axes = (0, 1, 2) if event.raw is None else event.raw.axes
            own = machine.limits.acceleration_mm_per_s2
            acceleration = own if event.raw is None or math.isnan(event.raw.acceleration) else event.raw.acceleration
            if axes:
                needed = max(needed, ringing_s(machine, xy, acceleration, axes) - since)
        since += seconds
    return needed


def _between_s(plan: PlannedMotion, section: Section, move: int) -> float:
    """Return the time from a section's beginning to that of a move."""
    return float(plan.start_t[move]) - section.begin_t


def _travels(moves: Moves) -> BoolArray:
    return np.any(moves.end[:, :3] != moves.start[:, :3], axis=1)
