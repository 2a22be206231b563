"""A compensated file laid over its original: what was wanted, what would have come out, what will come out now.

Everything is read out of the compensated file: its segments are planned as the firmware plans them, the original is
restored from the comments that keep it, and the two clocks are tied together where the original's moves are noted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.metrics import contour_error
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.trajectory import PlannedMotion
from ffcomp.simulate.linear import simulate
from gcode.embedded import WAS, noted, original_lines
from gcode.program import Program
from gcode.reader import read_program
from models.arrays import FloatArray
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class Curve:
    """One simulated motion of the nozzle."""

    t: FloatArray  # (m,) s on its own plan's clock
    nozzle: FloatArray  # (m, 3) mm
    wanted: FloatArray  # (m, 3) mm, where the path is at that time
    contour: FloatArray  # (m,) mm, distance to the path


@dataclass(frozen=True, slots=True)
class Look:
    path: FloatArray  # (n, 3) mm, corners of the wanted path
    path_t: FloatArray  # (n,) s on the original plan's clock
    before: Curve
    after: Curve


def look(
    data: bytes, path: str, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), flavor: str | None = None
) -> Look:
    """Simulate the original and the compensated print with the design model."""
    lines = data.splitlines(keepends=True)
    original = read_program(b"".join(original_lines(lines)), path, offset_mm=offset, flavor=flavor)
    compensated = read_program(data, path, flavor=flavor)
    wanted, played = _plan(original, machine), _plan(compensated, machine)
    path_t, wanted_path = corners(wanted)
    clock, own = _clocks(original, wanted, compensated, played)
    before_t, before = simulate(machine, wanted)
    after_t, after = simulate(machine, played)
    return Look(
        wanted_path,
        path_t,
        Curve(before_t, before, wanted.position(before_t)[:, :3], contour_error(path_t, wanted_path, before_t, before)),
        Curve(
            after_t,
            after,
            wanted.position(np.interp(after_t, clock, own))[:, :3],
            contour_error(np.interp(path_t, own, clock), wanted_path, after_t, after),
        ),
    )


def _plan(program: Program, machine: Machine) -> PlannedMotion:
    stop_before, wait_before = stops_and_waits(program)
    return plan_moves(program.moves, planner_limits(machine), stop_before=stop_before, wait_before=wait_before)


def corners(plan: PlannedMotion) -> tuple[FloatArray, FloatArray]:
    """Where the path's straight moves begin and end, and when: a rest is a corner twice."""
    end_t = plan.start_t + plan.duration
    ends = plan.position(np.nextafter(end_t, -np.inf))[:, :3]
    t = np.stack([plan.start_t, end_t], axis=1).ravel()
    return t, np.stack([plan.origin[:, :3], ends], axis=1).reshape(-1, 3)


def _clocks(
    original: Program, wanted: PlannedMotion, compensated: Program, played: PlannedMotion
) -> tuple[FloatArray, FloatArray]:
    """Times at which the same move begins: in the compensated file, and in the original."""
    notes = np.array([e.move for e in compensated.events if compensated.lines[e.line].startswith(WAS)], dtype=np.int64)
    first = np.flatnonzero(np.diff(original.moves.line, prepend=-1))  # of each line that moves
    noted = noted_moves(original, compensated)
    moving = noted >= 0
    begins = np.append(played.start_t, played.end_t)[notes[moving]]
    return np.append(begins, played.end_t), np.append(wanted.start_t[first[noted[moving]]], wanted.end_t)


def noted_moves(original: Program, compensated: Program) -> NDArray[np.int64]:
    """Which of the original's moving lines each note stands for; -1 for a line that only sets a feed."""
    order = {line: i for i, line in enumerate(sorted(set(original.moves.line.tolist())))}
    texts = [text for line in compensated.lines if (text := noted(line)) is not None]
    out, at = [], 0
    for text in texts:
        while original.lines[at] != text and original.lines[at].rstrip() != text.rstrip():
            at += 1
        out.append(order.get(at, -1))
        at += 1
    return np.array(out, dtype=np.int64)
