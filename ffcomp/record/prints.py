"""A real print as the experiment: the moves between the commands of a capture.

A section is motion from rest to rest without a retraction inside: the firmware's plan of it is known exactly. The
file stays what it is; around each chosen section there are the commands of a capture, and rests.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ffcomp.errors import NothingToDo
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.program import firmware_plan
from ffcomp.planner.trajectory import Section, split_sections
from ffcomp.record.gcode_writer import Firmware, rest
from ffcomp.record.moves import MODES_HZ, MOST_EXPERIMENTS, rounding_share
from ffcomp.record.plan import LIMIT_COLUMNS, SETTLE_S, Experiment, Motion, Plan, run_name
from gcode.program import Program
from gcode.reader import read_program
from models.machine import Machine

SHORTEST_S, LONGEST_S = 1.5, 15.0  # of a section
WITHIN_S = 1800.0  # of the print: its first layers
REST_BEFORE_S, REST_AFTER_S = 0.5, 0.3  # shorter than elsewhere: filament oozes


def plan_print(path: Path, machine: Machine, flavor: str) -> tuple[Plan, Program]:
    """Choose up to twelve sections of a print, those with the hardest motion among its first layers.

    Raises NothingToDo if no section is long enough to be recorded.
    """
    program = read_program(path.read_bytes(), str(path), flavor=flavor or None)
    trajectory = firmware_plan(program, machine)
    stops, _ = stops_and_waits(program)
    sections = [each for each in split_sections(trajectory, stops) if _suits(each, program)]
    if not sections:
        raise NothingToDo(
            f"{path.name} has no motion of {SHORTEST_S:g} to {LONGEST_S:g} s without a stop or a retraction inside in "
            f"its first {WITHIN_S / 60:g} min; record another print, or ffcomp's own moves (without --print)."
        )
    motions = [_motion(each, program, machine) for each in sections]
    hardest = sorted(range(len(motions)), key=lambda k: -_hardness(motions[k]))[:MOST_EXPERIMENTS]
    experiments = []
    for place, k in enumerate(sorted(hardest)):
        x, y, z, _ = motions[k].start_mm.tolist()
        rounding = rounding_share(motions[k], machine.kinematics, machine.steps.per_motor, MODES_HZ)
        experiments.append(Experiment(f"ffcomp-print-{place}", "print", place, (x, y, z), motions[k], rounding))
    plan = Plan(machine.name, machine.sha256, tuple(experiments), 1, REST_BEFORE_S, REST_AFTER_S, print_file=path.name)
    return plan, program


def _suits(section: Section, program: Program) -> bool:
    lasting = section.end_t - section.begin_t
    lines = program.moves.line[section.first : section.last]
    whole = section.last >= len(program.moves) or program.moves.line[section.last] != lines[-1]
    return section.travels and SHORTEST_S <= lasting <= LONGEST_S and section.begin_t < WITHIN_S and bool(whole)


def _motion(section: Section, program: Program, machine: Machine) -> Motion:
    part, moves = slice(section.first, section.last), program.moves
    n = section.last - section.first
    return Motion(
        start_mm=moves.start[section.first],
        ends_mm=moves.end[part],
        speed=moves.speed[part],
        limits=planner_limits(machine),
        move_limits=np.column_stack([getattr(moves, name)[part] for name in LIMIT_COLUMNS]),
        stop_before=np.zeros(n, dtype=np.bool_),
        wait_before=np.zeros(n),
    )


def _hardness(motion: Motion) -> float:
    """Return the motion's acceleration, rms mm/s²."""
    t = np.arange(0.0, motion.duration_s, 1e-3)
    return float(np.sqrt((motion.trajectory.acceleration_at(t)[:, :2] ** 2).sum(axis=1).mean()))


def print_lines(plan: Plan, program: Program, firmware: Firmware) -> Iterator[bytes]:
    """Yield the print's lines, with captures around the plan's sections."""
    before: dict[int, list[str]] = {}
    after: dict[int, list[str]] = {}
    for each in plan.experiments:
        first, name, lasting = _first_move(each, program), run_name(each.name, 1), plan.capture_s(each)
        start, stop = firmware.start(name, lasting), firmware.stop(name, lasting)
        before[int(program.moves.line[first])] = ["M400", rest(SETTLE_S), *start, rest(plan.rest_before_s)]
        after[int(program.moves.line[first + len(each.motion.speed) - 1])] = [rest(plan.rest_after_s), *stop]
    yield from (f"; {sentence}\n".encode() for sentence in firmware.explained())
    yield from (f"{line}\n".encode() for line in firmware.shaper_off())
    for number, line in enumerate(program.lines):
        yield from (f"{text}\n".encode() for text in before.get(number, ()))
        yield line if line.endswith(b"\n") else line + b"\n"
        yield from (f"{text}\n".encode() for text in after.get(number, ()))
    yield from (f"{line}\n".encode() for line in firmware.shaper_on())


def _first_move(experiment: Experiment, program: Program) -> int:
    """Find where an experiment begins in the program: its end points are the program's own."""
    ends = program.moves.end
    n = len(experiment.motion.speed)
    for k in np.flatnonzero((ends == experiment.motion.ends_mm[0]).all(axis=1)).tolist():
        if np.array_equal(ends[k : k + n], experiment.motion.ends_mm):
            return int(k)
    raise ValueError(f"{experiment.name} is not in the print.")
