"""Execute the compensated file as a firmware does, and align it with the original's plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ffcomp.compensate.gcode_writer import GcodeRenderer
from ffcomp.compensate.plan import Context, PlannedChunk
from ffcomp.compensate.program import compensate
from ffcomp.compensate.statistics import Statistics
from ffcomp.compensate.text_stream import Stream
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.planner.machine_limits import known_to_the_firmware
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.reach import within_reach
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from ffcomp.simulate.alignment import SectionStarts, section_starts
from ffcomp.simulate.motion import Motion, SectionClock, motion_of
from gcode.reader import read_program
from models.arrays import FloatArray
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class Compensated:
    """A compensated file, and the plan of its original."""

    text: bytes
    planned: PlannedProgram  # the original
    settings: Settings
    flavor: str
    statistics: Statistics


def compensated(
    planned: PlannedProgram,
    machine: Machine,
    model: InverseModel,
    flavor: str,
    offset: tuple[float, float] = (0.0, 0.0),
    progress: Callable[[float], None] = lambda done_s: None,
) -> Compensated:
    """Compensate a planned program as the command line does.

    Parameters
    ----------
    planned : PlannedProgram
    machine : Machine
    model : InverseModel
    flavor : str
    offset : (float, float)
        By which the program's positions were shifted, mm.
    progress : callable
        Called with the print seconds done so far.
    """
    chunk, context = PlannedChunk.whole(planned), Context(machine, model.settings, flavor, offset)
    lines = Stream(compensate(chunk, context, model, GcodeRenderer(chunk, context), progress=progress))
    text = b"".join(lines)
    return Compensated(text, planned, model.settings, flavor, lines.value)


@dataclass(frozen=True, slots=True)
class Segments:
    """The compensated file as our own planner plans it."""

    trajectory: Trajectory  # of the moves that travel
    starts: SectionStarts  # of them

    def clock(self, start_t: FloatArray) -> SectionClock:
        """Return the clock of these segments when segment k begins at start_t[k], whoever planned them."""
        return self.starts.clock(start_t)


def segments(
    file: Compensated, machine: Machine, before: bytes = b"", start: tuple[float, float, float] | None = None
) -> Segments:
    """Read the compensated file as a firmware would, and find the sections in it.

    Parameters
    ----------
    file : Compensated
    machine : Machine
    before : bytes
        Lines that set what was in effect where it begins, if it is a slice of a print.
    start : (float, float, float), optional
        Where the nozzle is then, mm.
    """
    program = read_program(
        before + file.text, "compensated", start=start, flavor=file.flavor, **known_to_the_firmware(machine)
    )
    program = within_reach(program, machine.kinematics)
    trajectory = plan_program(program, machine).trajectory
    travels = np.any(trajectory.direction[:, :3] != 0.0, axis=1)
    starts = section_starts(program, file.planned)
    number = np.cumsum(travels) - 1
    starts = replace(starts, move=number[starts.move], passing=number[starts.passing])
    return Segments(pick(trajectory, travels), starts)


def segments_motion(own: Segments) -> Motion:
    """Execute the compensated file as our own planner plans it."""
    return motion_of(own.trajectory, own.clock(own.trajectory.start_t))


def pick(trajectory: PlannedMotion, which: NDArray[np.bool_] | slice) -> Trajectory:
    """Return some moves of a plan."""
    names = Trajectory.__dataclass_fields__
    return Trajectory(**{name: np.ascontiguousarray(getattr(trajectory, name)[which]) for name in names})
