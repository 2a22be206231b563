"""Execute the compensated file as a firmware does, and align it with the original's plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.compensate.program import Summary, compensate
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.inverse.solve import Solution
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from ffcomp.simulate.motion import Clock, Motion, motion_of
from gcode.reader import read_program
from models.arrays import FloatArray, IntArray
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class Compensated:
    """A compensated file, and where in it the sections of the original are."""

    text: bytes
    begins_at: IntArray  # (m,) line at which each section begins
    plan_t: FloatArray  # (m,) plan time of each section's knot 0
    begin_t: FloatArray  # (m,) plan time at which its path begins
    end_t: FloatArray  # (m,) and ends
    vertices: list[FloatArray]  # m × (knots + 1, 3) mm
    settings: Settings
    flavor: str
    summary: Summary


def compensated(
    planned: PlannedProgram,
    machine: Machine,
    inverter: InverseModel,
    flavor: str,
    offset: tuple[float, float] = (0.0, 0.0),
    progress: Callable[[float], None] = lambda done_s: None,
) -> Compensated:
    """Compensate a planned program as the command line does, and note where its sections begin.

    Parameters
    ----------
    planned : PlannedProgram
    machine : Machine
    inverter : InverseModel
    flavor : str
    offset : (float, float)
        By which the program's positions were shifted, mm.
    progress : callable
        Called with the print seconds done so far.
    """
    settings, summary = inverter.settings, Summary()
    text: list[bytes] = []
    lines = 0
    seen: list[tuple[int, FloatArray]] = []

    def watch(section: Section, result: Solution) -> None:
        seen.append((lines, result.vertices))

    for part in compensate(planned, machine, inverter, flavor, summary, progress, offset, watch):
        text.append(part)
        lines += part.count(b"\n")  # `watch` looks how many there are
    sections = [section for section in planned.runs if section.travels]
    return Compensated(
        b"".join(text),
        np.array([at for at, _ in seen], dtype=np.int64),
        np.array([section.begin_t - settings.lead_s for section in sections]),
        np.array([section.begin_t for section in sections]),
        np.array([section.end_t for section in sections]),
        [vertices for _, vertices in seen],
        settings,
        flavor,
        summary,
    )


@dataclass(frozen=True, slots=True)
class Segments:
    """The compensated file as our own planner plans it; `first` are the moves with which sections begin."""

    trajectory: Trajectory  # of the moves that travel
    section: IntArray  # (m,) the sections that have segments
    first: IntArray  # (m,) move at which each of them begins
    plan_t: FloatArray  # (m,) plan time at which that move begins

    def clock(self, file: Compensated, start_t: FloatArray) -> Clock:
        """Return the clock of these segments when segment k begins at start_t[k], whoever planned them."""
        return Clock(start_t[self.first], self.plan_t, file.begin_t[self.section], file.end_t[self.section])


def segments(
    file: Compensated, machine: Machine, before: bytes = b"", start: tuple[float, float, float] | None = None
) -> Segments:
    """Read the compensated file as a firmware would, and find the sections in it.

    Parameters
    ----------
    file : Compensated
    machine : Machine
    before : bytes
        Lines that set what was in force where it begins, if it is a slice of a print.
    start : (float, float, float), optional
        Where the nozzle is then, mm.
    """
    program = read_program(before + file.text, "compensated", start=start, flavor=file.flavor)
    planned = plan_program(program, machine)
    travels = np.any(planned.trajectory.direction[:, :3] != 0.0, axis=1)
    trajectory = pick(planned.trajectory, travels)
    firsts = np.searchsorted(program.moves.line[travels], file.begins_at + before.count(b"\n"))
    section = np.flatnonzero(np.diff(firsts, append=len(trajectory)))
    ends = program.moves.end[travels, :3]
    at = [_knot(file.vertices[i], ends[firsts[i]]) for i in section]
    return Segments(trajectory, section, firsts[section], file.plan_t[section] + file.settings.segment_s * np.array(at))


def segments_motion(file: Compensated, own: Segments) -> Motion:
    """Execute the compensated file as our own planner plans it."""
    return motion_of(own.trajectory, own.clock(file, own.trajectory.start_t))


def _knot(vertices: FloatArray, first_end: FloatArray) -> int:
    """Return the knot at which a section's first written segment begins: segments that go nowhere are not written."""
    there = np.abs(np.round(vertices[1:], 4) - first_end).max(axis=1)
    exact = np.flatnonzero(there < 1e-6)
    return int(exact[0]) if len(exact) else int(np.argmin(there))  # in inches, four decimals are coarser


def pick(trajectory: PlannedMotion, which: NDArray[np.bool_] | slice) -> Trajectory:
    """Return some moves of a plan."""
    names = Trajectory.__dataclass_fields__
    return Trajectory(**{name: np.ascontiguousarray(getattr(trajectory, name)[which]) for name in names})
