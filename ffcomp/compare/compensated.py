"""The compensated file as a firmware plays it, and where on the original's plan each instant of it is."""

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
    """A compensated file, and where in it the runs of the original are."""

    text: bytes
    begins_at: IntArray  # (m,) line at which each run begins
    plan_t: FloatArray  # (m,) plan time of each run's knot 0
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
    """The file as the command line writes it."""
    settings, summary = inverter.settings, Summary()
    text: list[bytes] = []
    lines = 0
    seen: list[tuple[int, FloatArray]] = []

    def watch(run: Section, result: Solution) -> None:
        seen.append((lines, result.vertices))

    for piece in compensate(planned, machine, inverter, flavor, summary, progress, offset, watch):
        text.append(piece)
        lines += piece.count(b"\n")  # `watch` looks how many there are
    runs = [run for run in planned.runs if run.travels]
    return Compensated(
        b"".join(text),
        np.array([at for at, _ in seen], dtype=np.int64),
        np.array([run.begin_t - settings.lead_s for run in runs]),
        np.array([run.begin_t for run in runs]),
        np.array([run.end_t for run in runs]),
        [vertices for _, vertices in seen],
        settings,
        flavor,
        summary,
    )


@dataclass(frozen=True, slots=True)
class Segments:
    """The compensated file as our own planner plans it; `first` are the moves with which runs begin."""

    trajectory: Trajectory  # of the moves that travel
    run: IntArray  # (m,) the runs that have segments
    first: IntArray  # (m,) move at which each of them begins
    plan_t: FloatArray  # (m,) plan time at which that move begins

    def clock(self, ours: Compensated, start_t: FloatArray) -> Clock:
        """For these segments when segment k begins at start_t[k], whoever planned them."""
        return Clock(start_t[self.first], self.plan_t, ours.begin_t[self.run], ours.end_t[self.run])


def segments(
    ours: Compensated, machine: Machine, before: bytes = b"", start: tuple[float, float, float] | None = None
) -> Segments:
    """Read the compensated file as a firmware would, and find the runs in it.

    before : lines that set what was in force where it begins, if it is part of a print
    start : mm, where the nozzle is then
    """
    program = read_program(before + ours.text, "compensated", start=start, flavor=ours.flavor)
    planned = plan_program(program, machine)
    travels = np.any(planned.trajectory.direction[:, :3] != 0.0, axis=1)
    trajectory = pick(planned.trajectory, travels)
    firsts = np.searchsorted(program.moves.line[travels], ours.begins_at + before.count(b"\n"))
    run = np.flatnonzero(np.diff(firsts, append=len(trajectory)))
    ends = program.moves.end[travels, :3]
    at = [_knot(ours.vertices[i], ends[firsts[i]]) for i in run]
    return Segments(trajectory, run, firsts[run], ours.plan_t[run] + ours.settings.segment_s * np.array(at))


def segments_motion(ours: Compensated, own: Segments) -> Motion:
    """The compensated file played straight from our own plan of it."""
    return motion_of(own.trajectory, own.clock(ours, own.trajectory.start_t))


def _knot(vertices: FloatArray, first_end: FloatArray) -> int:
    """The knot at which a run's first written segment begins: segments that go nowhere are not written."""
    there = np.abs(np.round(vertices[1:], 4) - first_end).max(axis=1)
    exact = np.flatnonzero(there < 1e-6)
    return int(exact[0]) if len(exact) else int(np.argmin(there))  # in inches, four decimals are coarser


def pick(trajectory: PlannedMotion, which: NDArray[np.bool_] | slice) -> Trajectory:
    """Some of a firmware's plan's moves."""
    names = Trajectory.__dataclass_fields__
    return Trajectory(**{name: np.ascontiguousarray(getattr(trajectory, name)[which]) for name in names})
