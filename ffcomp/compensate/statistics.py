"""Count what a compensation does: values of sections, chunks and files that add up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from ffcomp.compensate.faster import Faster
from ffcomp.compensate.prediction import Samples
from ffcomp.compensate.share import Shares, of_moves, of_raw_moves
from ffcomp.compensate.solve import SolvedSection
from ffcomp.inverse.command_limits import utilisation_from_rest
from ffcomp.inverse.extent import Extent
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.time_scaling import TimeScaling
from ffcomp.planner.path_position import PathPosition
from ffcomp.planner.program import PlannedProgram
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.program import Event, Program
from gcode.slicing import some

BEYOND = 1.001  # times a limit, above which there is a warning


@dataclass(frozen=True, slots=True)
class Statistics:
    """What a compensation has done."""

    moves: int = 0
    segments: int = 0
    windows: int = 0
    limited_windows: int = 0
    original_print_time_s: float = 0.0
    print_time_s: float = 0.0
    warnings: tuple[str, ...] = ()
    slowed: tuple[TimeScaling, ...] = ()
    predicted: Samples | None = None
    shares: Shares = field(default_factory=Shares)
    settlings: int = 0  # waits until the ringing of what the firmware has moved by itself has died away
    settling_s: float = 0.0
    faster: Faster | None = None  # None: no bound was asked for

    def __add__(self, later: Statistics) -> Statistics:
        """Add what comes after this; a warning is kept once."""
        samples = [each.predicted for each in (self, later) if each.predicted is not None]
        return Statistics(
            self.moves + later.moves,
            self.segments + later.segments,
            self.windows + later.windows,
            self.limited_windows + later.limited_windows,
            self.original_print_time_s + later.original_print_time_s,
            self.print_time_s + later.print_time_s,
            tuple(dict.fromkeys(self.warnings + later.warnings)) if later.warnings else self.warnings,
            self.slowed + later.slowed,
            samples[0] + samples[1] if len(samples) > 1 else next(iter(samples), None),
            self.shares + later.shares,
            self.settlings + later.settlings,
            self.settling_s + later.settling_s,
            self.faster + later.faster if self.faster and later.faster else self.faster or later.faster,
        )


def of_plan(planned: PlannedProgram, extent: Extent) -> Statistics:
    """Count what a program, or what is written of it, takes by its plan."""
    moves, plan = planned.program.moves, planned.trajectory
    begin = _on(extent.begin, plan, 0.0)
    first = int(np.searchsorted(plan.start_t, begin))
    if extent.end is not None:
        end = _on(extent.end, plan, 0.0)
        last = int(np.searchsorted(plan.start_t, end))
        shares = Shares(of_moves(some(moves, slice(first, last))))
        return Statistics(moves=last - first, original_print_time_s=end - begin, shares=shares)
    original_s, print_s = planned.firmware_s - begin, float(plan.end_t) - begin
    shares = Shares(of_moves(some(moves, slice(first, None))))
    return Statistics(moves=len(moves) - first, original_print_time_s=original_s, print_time_s=print_s, shares=shares)


def of_raw(events: list[Event], seconds: Mapping[int, float]) -> Statistics:
    """Count moves that go out as they were, which take as long before and after."""
    shares = of_raw_moves(events, seconds)
    lasting_s = shares.uncompensated.seconds
    return Statistics(original_print_time_s=lasting_s, print_time_s=lasting_s, shares=shares)


def of_waits(waits_s: Mapping[int, float]) -> Statistics:
    """Count waits until ringing has died away."""
    total_s = sum(waits_s.values())
    return Statistics(print_time_s=total_s, settlings=len(waits_s), settling_s=total_s)


def of_section(
    section: Section, solved: SolvedSection, planned: PlannedProgram, extent: Extent, model: InverseModel
) -> Statistics:
    """Count a solved section, which lasts longer than it was planned."""
    begin, end = solved.knots
    longer_s = (end - begin) * model.settings.segment_s - _counted_s(section, planned, extent)
    result = solved.solution
    warnings = tuple(_excesses(solved, planned.program, model)) if result.utilisation > BEYOND else ()
    return Statistics(
        windows=result.windows,
        limited_windows=len(result.constrained),
        print_time_s=longer_s,
        warnings=warnings,
        slowed=solved.slowed,
    )


def _counted_s(section: Section, planned: PlannedProgram, extent: Extent) -> float:
    """Return how much of a section's time `of_plan` has counted as print time."""
    if extent.end is not None:
        return 0.0
    first = section is planned.sections[0]
    return section.end_t - (_on(extent.begin, planned.trajectory, section.begin_t) if first else section.begin_t)


def _on(position: PathPosition | None, plan: PlannedMotion, otherwise: float) -> float:
    return otherwise if position is None else position.time_in(cast(Trajectory, plan))


def _excesses(solved: SolvedSection, program: Program, model: InverseModel) -> Iterator[str]:
    """Warn if more than a limit is demanded where the section is written."""
    begin, end = solved.knots
    demand = utilisation_from_rest(solved.solution.vertices, model.limits)[begin : end + 2].max(axis=(1, 2))
    worst = int(demand.argmax())
    if demand[worst] > BEYOND:
        t = solved.reference.t0 + (begin + worst) * model.settings.segment_s
        move = min(max(int(solved.trajectory.move_at(t)), solved.section.first), solved.section.last - 1)
        line = program.first_line + int(program.moves.line[move]) + 1
        yield f"line {line}: the command needs {demand[worst]:.2f} times a carriage's limit here."
