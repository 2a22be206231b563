"""Plan a program as the firmware will, and cut the plan into sections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import hypot, nan
from typing import Any

import numpy as np

from ffcomp.errors import NothingToDo
from ffcomp.firmware.base import Firmware, Planner
from ffcomp.firmware.table import FIRMWARES
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.reach import check_moves
from ffcomp.planner.trajectory import Section, Trajectory, split_sections
from gcode.program import Event, EventKind, Moves, Program
from gcode.reader import read_parts
from gcode.slicing import portions
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class PlannedProgram:
    """A program with the firmware's plan for it."""

    program: Program
    trajectory: Trajectory
    sections: list[Section]
    firmware_s: float  # what the firmware's own plan takes


def firmware_of(program: Program) -> Firmware:
    """Return the firmware that a program was read for."""
    return FIRMWARES[program.flavor]


def planner_of(program: Program, machine: Machine) -> Planner:
    """Return the planner of the firmware that a program was read for."""
    return firmware_of(program).planner(program, machine)


def known_to_the_firmware(machine: Machine) -> dict[str, Any]:
    """Return what a G-code reader must know besides the file, as its keyword arguments."""

    def cut(program: Program) -> Program:
        return firmware_of(program).cut(program, machine)

    def arc_chords(flavor: str, length: float, turn: float) -> int:
        return FIRMWARES[flavor].arc_chords(length, turn)

    return {"returns": machine.returns, "arc_chords": arc_chords, "cut": cut}


def read_as_planned(
    blocks: Iterable[bytes], path: str, machine: Machine, flavor: str, **settings: Any
) -> Iterator[Program]:
    """Read a file in parts (`gcode.reader.read_parts`), cut as the firmware cuts its moves."""
    known = known_to_the_firmware(machine)
    cut = known.pop("cut")
    longest_s = FIRMWARES[flavor].longest_part_s(machine)
    for program in read_parts(blocks, path, flavor=flavor, **known, **settings):
        yield from map(cut, portions(program, longest_s))


def plan_program(program: Program, machine: Machine) -> PlannedProgram:
    """Check that every move can be reached, and plan them all."""
    plan = firmware_plan(program, machine)
    stop_before, _ = stops_and_waits(program)
    return PlannedProgram(program, plan, split_sections(plan, stop_before), plan.end_t)


def firmware_plan(program: Program, machine: Machine) -> Trajectory:
    """Plan every move, once it is known that the nozzle can get there; what need not is out of it (`Reach`)."""
    moves = program.moves
    if not len(moves):
        raise NothingToDo(f"{program.path or 'The file'} holds no move whose start is known: nothing to compensate.")
    check_moves(program, machine.kinematics)
    stop_before, wait_before = stops_and_waits(program)
    return planner_of(program, machine)(moves, stop_before=stop_before, wait_before=wait_before)


def plan_section(limits: PlannerLimits, moves: Moves, begin_t: float) -> Trajectory:
    """Plan the moves of one section as Klipper does, from rest to rest."""
    return _from_rest_to_rest(partial(plan_moves, limits=limits), moves, begin_t)


def section_planner(program: Program, machine: Machine) -> Callable[[Moves, float], Trajectory]:
    """Return what plans the moves of one section of a program again, from a time on (s), from rest to rest."""
    return partial(_from_rest_to_rest, firmware_of(program).planner(program, machine, within=True))


def _from_rest_to_rest(planner: Planner, moves: Moves, begin_t: float) -> Trajectory:
    n = len(moves)
    return planner(moves, stop_before=np.zeros(n, dtype=np.bool_), wait_before=np.zeros(n), start_t=begin_t)


def raw_durations(events: Iterable[Event], planner: Planner) -> dict[int, float]:
    """Return the duration of each move passed through unchanged, s, by its line's index.

    Coordinates that are not known do not move. Consecutive moves are planned together, from rest to rest.
    """
    return {
        line: seconds
        for run in _runs(events)
        for line, seconds in zip((event.line for event in run), _durations(run, planner), strict=True)
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


def _durations(run: Sequence[Event], planner: Planner) -> FloatArray:
    raw, n = [event.raw for event in run if event.raw], len(run)
    end = np.nan_to_num(np.array([each.end for each in raw]))
    start = np.array([each.start for each in raw])
    start = np.where(np.isnan(start), end, start)
    moves = Moves(
        line=np.array([event.line for event in run]),
        start=start,
        end=end,
        speed=np.array([each.speed for each in raw]),
        frame=np.zeros(n, dtype=np.int64),
        velocity_limit=np.array([each.velocity_limit for each in raw]),
        acceleration=np.array([each.acceleration for each in raw]),
        square_corner_velocity=np.array([each.square_corner_velocity for each in raw]),
        minimum_cruise_ratio=np.full(n, nan),
    )
    try:
        plan = _from_rest_to_rest(planner, moves, 0.0)
    except UnreachableError:  # a planner of motor steps cannot plan what no joint reaches: at its speed, then
        return np.array([max(each.path_mm, abs(each.filament_mm)) / each.speed for each in raw])
    straight = [hypot(*(b - a)[:3]) for a, b in zip(start, end, strict=True)]
    longer = [each.path_mm / way if way > 0.0 else 1.0 for each, way in zip(raw, straight, strict=True)]  # arcs
    return np.asarray(plan.duration * np.array(longer))
