"""G-code as a command: planned as the firmware plans it, and sent through the kinematics that it believes in.

A compensated file is judged against the original that its comments keep. Both clocks are tied together where a run of
the original begins: the compensated file keeps its pace inside one.
"""

from __future__ import annotations

import numpy as np

from ffcomp.inverse.settings import Settings
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion
from ffcomp.simulate.command import Command, Goal, Stretch
from ffcomp.simulate.linear import sections
from ffcomp.simulate.motion import Clock, own_clock
from ffcomp.simulate.preview import corners, noted_moves
from gcode.embedded import WAS, original
from gcode.program import Program
from gcode.reader import read_program
from gcode.stamp import STAMP_REACH, already_processed, find_offset
from models.arrays import FloatArray
from models.machine import Machine

FEWEST_HZ, MOST_HZ = 125.0, 500.0  # of segments
OWN_PLAN = "the planned path of the file itself"
ORIGINAL = "the planned path of the original print, which the compensated file keeps in its comments"


def read_gcode(
    data: bytes, path: str, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), flavor: str = ""
) -> tuple[Command, Program]:
    """A sliced or a compensated file, and what was read.

    Parameters
    ----------
    offset : mm, added to every position; a compensated file says its own.
    """
    stamp = already_processed(data)
    if stamp is None:
        program = read_program(data, path, offset_mm=offset, flavor=flavor or None)
        return gcode_command(plan_program(program, machine, offset), machine), program
    program = read_program(data, path, flavor=stamp.flavor)
    offset = find_offset(data[:STAMP_REACH])
    wanted = read_program(original(data), path, offset_mm=offset, flavor=stamp.flavor)
    played = plan_program(program, machine)
    return compensated_command(played, plan_program(wanted, machine, offset), machine), program


def gcode_command(planned: PlannedProgram, machine: Machine) -> Command:
    """A planned program, judged against its own path."""
    trajectory = planned.trajectory
    return _command(trajectory, trajectory, own_clock(trajectory), machine, OWN_PLAN)


def compensated_command(planned: PlannedProgram, wanted: PlannedProgram, machine: Machine) -> Command:
    """A compensated program, judged against the original's path."""
    return _command(planned.trajectory, wanted.trajectory, _clock(planned, wanted), machine, ORIGINAL)


def _command(played: PlannedMotion, wanted: PlannedMotion, clock: Clock, machine: Machine, reference: str) -> Command:
    stretches = [_stretch(played, begin, end, wanted, clock, machine) for begin, end in sections(played)]
    return Command(stretches, "cubic", reference)


def _stretch(
    played: PlannedMotion, begin_s: float, end_s: float, wanted: PlannedMotion, clock: Clock, machine: Machine
) -> Stretch:
    delta = machine.kinematics.compiled()
    last = np.nextafter(end_s, -np.inf)  # at the end itself the next stretch may have begun
    path_t, path = corners(wanted)

    def carriages(t: FloatArray) -> FloatArray:
        return delta.inverse(np.ascontiguousarray(played.position(np.clip(t, begin_s, last))[:, :3]))

    def due(t: FloatArray) -> FloatArray:
        return clock.plan_time(np.clip(t, begin_s, last))

    def nozzle(t: FloatArray) -> FloatArray:
        return np.ascontiguousarray(wanted.position(due(t))[:, :3])

    def between(from_s: float, to_s: float) -> tuple[FloatArray, FloatArray]:
        part = slice(max(int(np.searchsorted(path_t, from_s)) - 1, 0), int(np.searchsorted(path_t, to_s, "right")) + 1)
        return path_t[part], path[part]

    return Stretch(begin_s, end_s, lambda t, step_s: carriages(t), carriages, Goal(nozzle, due, between))


def _clock(planned: PlannedProgram, wanted: PlannedProgram) -> Clock:
    """When in the compensated file each run of the original begins: told by where its first move is noted.

    The note stands at the knot at or before the run's beginning, `lead_s` after the first knot. NOTE: where both fall
    together, rounding may have put it one knot early; the time left until the run's end tells.
    """
    runs, note_t, played_end_t = _noted_runs(planned, wanted)
    begin_t, end_t = np.array([run.begin_t for run in runs]), np.array([run.end_t for run in runs])
    usual, segment_s = Settings(), _segment_s(planned)
    knots = np.ceil((usual.lead_s + (end_t - begin_t) + usual.tail_s) / segment_s - 1e-9)
    before = np.floor(usual.lead_s / segment_s + 1e-9)
    early = played_end_t - note_t > (knots - before + 0.5) * segment_s
    played_t = note_t + segment_s * early + (usual.lead_s - before * segment_s)
    return Clock(played_t, begin_t, begin_t, end_t)


def _noted_runs(planned: PlannedProgram, wanted: PlannedProgram) -> tuple[list[Section], FloatArray, FloatArray]:
    """The original's runs that travel, m of them; when each is noted in the compensated file, and has ended there."""
    program, played = planned.program, planned.trajectory
    notes = np.array([e.move for e in program.events if program.lines[e.line].startswith(WAS)], dtype=np.int64)
    noted = noted_moves(wanted.program, program)
    moves = np.flatnonzero(np.diff(wanted.program.moves.line, prepend=-1))[noted[noted >= 0]]
    note_of = dict(zip(moves.tolist(), notes[noted >= 0].tolist(), strict=True))
    runs = [run for run in wanted.runs if run.travels and run.first in note_of]
    note_t = np.append(played.start_t, played.end_t)[[note_of[run.first] for run in runs]]
    ends = np.array([run.end_t for run in planned.runs if run.travels])
    return runs, note_t, ends[np.minimum(np.searchsorted(ends, note_t, side="right"), len(ends) - 1)]


def _segment_s(planned: PlannedProgram) -> float:
    """The length of the compensated file's segments: the most frequent one, of those that can be asked for."""
    a_second = np.round(1 / np.maximum(planned.trajectory.duration, 1e-9), 1)
    rate, count = np.unique(a_second[(a_second >= FEWEST_HZ) & (a_second <= MOST_HZ)], return_counts=True)
    return 1 / float(rate[int(count.argmax())]) if len(rate) else Settings().segment_s
