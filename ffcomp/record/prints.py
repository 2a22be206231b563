"""A real print as the experiment: the moves between the commands of a capture.

A section is motion from rest to rest without a retraction inside: the firmware's plan of it is known exactly. The
file stays what it is; around each chosen section there are the commands of a capture, and rests.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ffcomp.errors import MeasurementError, NothingToDo
from ffcomp.firmware.program import firmware_plan
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.trajectory import Section, split_sections
from ffcomp.record.gcode_writer import Recorder, lines, rest
from ffcomp.record.moves import MODES_HZ, MOST_EXPERIMENTS, rounding_share
from ffcomp.record.plan import LIMIT_COLUMNS, SETTLE_S, Experiment, Motion, Plan, load_plan, run_name
from gcode.container import read_bytes
from gcode.program import EventKind, Program
from gcode.reader import read_program
from models.machine import Machine

SHORTEST_S, LONGEST_S = 1.5, (15.0, 60.0)  # of a section; longer where there are hardly any
FEW = 3
WITHIN_S = 1800.0  # of the print: its first layers
REST_BEFORE_S, REST_AFTER_S = 0.5, 0.3  # shorter than elsewhere: filament oozes


def plan_print(path: Path, machine: Machine, flavor: str) -> tuple[Plan, Program]:
    """Choose up to twelve sections of a print, those with the hardest motion among its first layers.

    Raises NothingToDo if no section is long enough to be recorded, or captures are commanded already.
    """
    data = read_bytes(path)
    if TOGGLE.search(data):
        raise NothingToDo(
            f"{path.name} holds the commands of captures already: print it unchanged, and give it to ffcomp record "
            "join as the plan of the captures."
        )
    program = read_program(data, str(path), flavor=flavor or None)
    trajectory = firmware_plan(program, machine)
    stops, _ = stops_and_waits(program)
    sections: list[Section] = []
    for longest_s in LONGEST_S:
        if len(sections) < FEW:
            sections = [each for each in split_sections(trajectory, stops) if _suits(each, program, longest_s)]
    if not sections:
        raise NothingToDo(
            f"{path.name} has no motion of {SHORTEST_S:g} to {LONGEST_S[-1]:g} s without a stop or a retraction inside "
            f"in its first {WITHIN_S / 60:g} min; record another print, or ffcomp's own moves (without --print)."
        )
    motions = [_motion(program, machine, each.first, each.last) for each in sections]
    hardest = sorted(range(len(motions)), key=lambda k: -_hardness(motions[k]))[:MOST_EXPERIMENTS]
    experiments = []
    for place, k in enumerate(sorted(hardest)):
        x, y, z, _ = motions[k].start_mm.tolist()
        rounding = rounding_share(motions[k], machine.kinematics, machine.steps.per_motor, MODES_HZ)
        experiments.append(Experiment(f"ffcomp-print-{place}", "print", place, (x, y, z), motions[k], rounding))
    plan = Plan(machine.name, machine.sha256, tuple(experiments), 1, REST_BEFORE_S, REST_AFTER_S, print_file=path.name)
    return plan, program


def _suits(section: Section, program: Program, longest_s: float) -> bool:
    lasting = section.end_t - section.begin_t
    lines = program.moves.line[section.first : section.last]
    whole = section.last >= len(program.moves) or program.moves.line[section.last] != lines[-1]
    return section.travels and SHORTEST_S <= lasting <= longest_s and section.begin_t < WITHIN_S and bool(whole)


def _motion(program: Program, machine: Machine, first: int, last: int) -> Motion:
    """Return some of the program's moves, with the rests between them."""
    part, moves = slice(first, last), program.moves
    stops, waits = stops_and_waits(program)
    stops[first], waits[first] = False, 0.0
    return Motion(
        start_mm=moves.start[first],
        ends_mm=moves.end[part],
        speed=moves.speed[part],
        limits=planner_limits(machine),
        move_limits=np.column_stack([getattr(moves, name)[part] for name in LIMIT_COLUMNS]),
        stop_before=stops[part],
        wait_before=waits[part],
    )


def _hardness(motion: Motion) -> float:
    """Return the motion's acceleration, rms mm/s²."""
    t = np.arange(0.0, motion.duration_s, 1e-3)
    return float(np.sqrt((motion.trajectory.acceleration_at(t)[:, :2] ** 2).sum(axis=1).mean()))


def print_lines(plan: Plan, program: Program, recorder: Recorder) -> Iterator[bytes]:
    """Yield the print's lines, with captures around the plan's sections."""
    before: dict[int, list[str]] = {}
    after: dict[int, list[str]] = {}
    for each in plan.experiments:
        first, name, lasting = _first_move(each, program), run_name(each.name, 1), plan.capture_s(each)
        start, stop = recorder.capture(name, lasting)
        before[int(program.moves.line[first])] = ["M400", rest(SETTLE_S), *start, rest(plan.rest_before_s)]
        after[int(program.moves.line[first + len(each.motion.speed) - 1])] = [rest(plan.rest_after_s), *stop]
    yield from (f"; {sentence}\n".encode() for sentence in recorder.explained())
    yield from lines(recorder.shaper_off())
    for number, line in enumerate(program.lines):
        yield from lines(before.get(number, ()))
        yield line if line.endswith(b"\n") else line + b"\n"
        yield from lines(after.get(number, ()))
    yield from lines(recorder.shaper_on())


def _first_move(experiment: Experiment, program: Program) -> int:
    """Find where an experiment begins in the program: its end points are the program's own."""
    ends = program.moves.end
    n = len(experiment.motion.speed)
    for k in np.flatnonzero((ends == experiment.motion.ends_mm[0]).all(axis=1)).tolist():
        if np.array_equal(ends[k : k + n], experiment.motion.ends_mm):
            return int(k)
    raise ValueError(f"{experiment.name} is not in the print.")


# ---- the print itself as the plan ----------------------------------------------------------------

TOGGLE = re.compile(rb"^[ \t]*(ACCELEROMETER_MEASURE\b|M956\b)[^\r\n]*", re.IGNORECASE | re.MULTILINE)
MARK = b"M400 ;capture "  # which waits as these commands do, and is known to a reader
NAMED = re.compile(rb'(?:\bNAME=|\bF")"?([^"\s;]+?)(?:\.csv)?(?:["\s;]|$)', re.IGNORECASE)
OF_PLAN = re.compile(rb'(?:NAME=|F")ffcomp-(?!print-)')  # captures of moves that are no print's
LEAST_REST_S = 0.2


def plan_of(path: str | Path, machine: Machine) -> Plan:
    """Load the plan of captures: the file of `ffcomp record plan`, or a print with the commands of captures in it.

    Raises MeasurementError for a file that is neither.
    """
    data = Path(path).read_bytes()
    if Path(path).suffix.lower() == ".json" or data.lstrip()[:1] == b"{":
        return load_plan(path)
    if OF_PLAN.search(data):  # by `record plan`, which knows what repeats what
        return load_plan(Path(path).with_suffix(".json"))
    return plan_of_print(Path(path).name, data, machine)


def plan_of_print(name: str, data: bytes, machine: Machine) -> Plan:
    """Make each capture's moves an experiment, as the print's own commands begin and end the capture.

    Whether `ffcomp record plan --print` has written these commands, or a slicer's G-code of layer changes.
    """
    program = read_program(TOGGLE.sub(MARK + rb"\g<0>", data), name, flavor=machine.flavor or None)
    captures = _captures(program)
    if captures:
        firmware_plan(program, machine)  # it reports moves out of reach
    usual, _ = Counter(each.rests_s for each in captures).most_common(1)[0] if captures else ((0.0, 0.0), 0)
    if min(usual) < LEAST_REST_S:
        what = "no captures between two rests" if captures else "no captures: no ACCELEROMETER_MEASURE and no M956"
        raise MeasurementError(
            name,
            [
                f"It holds {what}. `ffcomp record plan --print {name} -o recorded.gcode` writes them, with "
                f"rests of {LEAST_REST_S:g} s or more; print that file, and give it here."
            ],
        )
    experiments = []
    for place, each in enumerate(capture for capture in captures if capture.rests_s == usual):
        motion = _motion(program, machine, each.first, each.last)
        x, y, z, _ = motion.start_mm.tolist()
        experiments.append(Experiment(each.name, "print", place, (x, y, z), motion, 0.0))
    return Plan(machine.name, "", tuple(experiments), 1, *usual, print_file=name)


class _Capture(NamedTuple):
    """The moves of one capture, by index, and how long it rests before and after them."""

    name: str
    first: int
    last: int  # the move after them
    rests_s: tuple[float, float]


def _captures(program: Program) -> list[_Capture]:
    begun: dict[bytes, int] = {}
    captures: dict[str, _Capture] = {}  # by name: several chips record the same
    rests = [(each.line, each.dwell_s) for each in program.events if each.kind is EventKind.DWELL]
    for number, line in enumerate(program.lines):
        named = NAMED.search(line) if line.startswith(MARK) else None
        if named is None:
            continue
        begin, end = begun.pop(line.strip(), None), number
        if b"M956" in line.upper():  # it ends by itself, in the rest behind
            begin, moved = number, program.moves.line[program.moves.line > number][:1]
            end = next((at + 1 for at, dwell_s in rests if len(moved) and at > moved[0] and dwell_s >= LEAST_REST_S), 0)
        if begin is None:
            begun[line.strip()] = number
            continue
        first, last = np.searchsorted(program.moves.line, [begin, end]).tolist()
        if last > first:
            edges = int(program.moves.line[first]), int(program.moves.line[last - 1])
            before = sum(dwell_s for at, dwell_s in rests if begin < at < edges[0])
            after = sum(dwell_s for at, dwell_s in rests if edges[1] < at < end)
            name = re.sub("-1$", "", named[1].decode(errors="replace"))
            captures.setdefault(name, _Capture(name, first, last, (round(before, 3), round(after, 3))))
    return sorted(captures.values(), key=lambda each: each.first)
