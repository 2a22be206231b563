"""Choose the part of a print that is evaluated: all of it, some layers, or short slices spread evenly over its time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import NothingToDo
from ffcomp.planner.machine_limits import known_to_the_firmware
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.reach import within_reach
from ffcomp.planner.trajectory import PlannedMotion
from ffcomp.simulate.motion import Motion, path_corners, planned_motion
from gcode.dialects import detect_flavor
from gcode.layers import Labels, labels
from gcode.program import Program
from gcode.reader import read_program
from gcode.slicing import part, preamble
from models.arrays import FloatArray, IntArray
from models.machine import Machine

LONGEST_S = 120.0  # of print time that is evaluated unless more is requested
SLICE_S = 10.0  # length of one slice of a sampled print


@dataclass(frozen=True, slots=True)
class Sampling:
    """The layers, and the share of their time, that are evaluated."""

    first_layer: int = 0
    last_layer: int | None = None  # the last one evaluated
    share: float | None = None  # of these layers' time; None: all, but no more than LONGEST_S


@dataclass(frozen=True, eq=False)
class PrintSlice:
    """n moves of a print, planned from rest to rest."""

    machine: Machine
    planned: PlannedProgram
    flavor: str
    offset: tuple[float, float]
    layer: IntArray  # (n,) of each move
    feature: IntArray  # (n,) of each move
    begin_t: float = 0.0  # s, on the whole print's clock
    before: bytes = b""  # lines that set what is in effect where it begins
    start: tuple[float, float, float] | None = None  # mm, where the nozzle is then; None: as the file says

    @property
    def trajectory(self) -> PlannedMotion:
        """The plan of its moves."""
        return self.planned.trajectory

    @cached_property
    def corners(self) -> tuple[FloatArray, FloatArray]:
        """Times (n + 1,) s at which the corners of the path are due, and the corners (n + 1, 3) mm."""
        return path_corners(self.trajectory)

    @cached_property
    def motion(self) -> Motion:
        """The plan as it stands."""
        return planned_motion(self.trajectory)

    @property
    def extrudes(self) -> NDArray[np.bool_]:
        """(n,) moves that extrude along a path."""
        direction = self.trajectory.direction
        return (direction[:, 3] > 0.0) & np.any(direction[:, :3] != 0.0, axis=1)

    def with_acceleration(self, acceleration: float) -> PrintSlice:
        """Plan the same moves with another acceleration, mm/s²."""
        return replace(self, planned=accelerated(self.planned, self.machine, acceleration))


def accelerated(planned: PlannedProgram, machine: Machine, acceleration: float) -> PlannedProgram:
    """Plan the same moves with one acceleration (mm/s²) for all that travel."""
    program = planned.program
    moves = program.moves
    travels = np.any(moves.end[:, :3] != moves.start[:, :3], axis=1)
    changed = replace(moves, acceleration=np.where(travels, acceleration, moves.acceleration))
    return plan_program(replace(program, moves=changed), machine)


class Print:
    """A sliced print on a machine."""

    def __init__(
        self, data: bytes, path: str, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), flavor: str = ""
    ) -> None:
        self.path, self.machine, self.offset = path, machine, offset
        stated = flavor or machine.flavor
        program = read_program(data, path, offset_mm=offset, flavor=stated or None, **known_to_the_firmware(machine))
        self.flavor = stated or detect_flavor(program.lines)
        self.planned = plan_program(within_reach(program, machine.kinematics), machine)
        self.labels: Labels = labels(self.program)

    @property
    def program(self) -> Program:
        """The whole program."""
        return self.planned.program

    @property
    def print_time_s(self) -> float:
        """Of the whole print."""
        return self.planned.trajectory.end_t

    def slices(
        self, sampling: Sampling, slice_s: float = SLICE_S, at_most_s: float = np.inf
    ) -> tuple[list[PrintSlice], str]:
        """Return the slices to be evaluated, and a sentence that says which they are.

        sampling : Sampling
        slice_s, at_most_s : float
            Length of one slice of a sampled print and of all together, s.
        """
        first, last = self._layers(sampling)
        start_t = np.append(self.planned.trajectory.start_t, self.print_time_s)
        seconds = float(start_t[last] - start_t[first])
        whole = first == 0 and last == len(self.program.moves)
        evaluated = min(LONGEST_S, seconds) if sampling.share is None else sampling.share * seconds
        evaluated = min(evaluated, at_most_s)
        what = "the whole print" if whole else _layers_named(sampling)
        cuts = [] if evaluated >= seconds - slice_s / 2 else list(self._cuts(first, last, evaluated, slice_s))
        if not cuts:  # all is requested, or it is a single arc, which is not cut
            found = [self._whole()] if whole else [self._part(first, last)]
            return found, f"{what[0].upper()}{what[1:]} was evaluated, {seconds:.0f} s."
        found = [self._part(a, b) for a, b in cuts]
        covered = sum(each.trajectory.end_t for each in found)
        chosen = f"{len(found)} slices of about {covered / len(found):.0f} s, spread evenly over {what}"
        if len(found) == 1:
            chosen = f"One slice in the middle of {what}"
        return found, f"{chosen}: {covered:.0f} of {seconds:.0f} s ({covered / seconds:.0%}) were evaluated."

    def _layers(self, sampling: Sampling) -> tuple[int, int]:
        """Return the first move of the chosen layers and the one after their last."""
        layer = self.labels.layer
        chosen = layer >= sampling.first_layer
        if sampling.last_layer is not None:
            chosen &= layer <= sampling.last_layer
        numbers = np.flatnonzero(chosen)
        if not numbers.size:
            raise NothingToDo(
                f"{self.path}: no move lies in the chosen layers; the print has {self.labels.layers} layers, "
                f"0 to {self.labels.layers - 1}."
            )
        return self._line_begins(int(numbers[0])), self._line_begins(int(numbers[-1]) + 1)

    def _line_begins(self, move: int) -> int:
        """Return this move, or the first one of the same line: arcs are not cut."""
        line = self.program.moves.line
        while 0 < move < len(line) and line[move] == line[move - 1]:
            move -= 1
        return move

    def _cuts(self, first: int, last: int, evaluated_s: float, slice_s: float) -> Iterator[tuple[int, int]]:
        """Yield slices from `first` to `last` that take `evaluated_s` together; each begins at rest if it can."""
        start_t = np.append(self.planned.trajectory.start_t, self.print_time_s)
        begin, end = float(start_t[first]), float(start_t[last])
        count = max(1, round(evaluated_s / slice_s))
        length, period = evaluated_s / count, (end - begin) / count
        rests = np.array([run.first for run in self.planned.sections])
        for k in range(count):
            t = begin + k * period + (period - length) / 2
            a = int(np.searchsorted(start_t, t))
            resting = rests[(rests >= a) & (start_t[rests] < t + (period - length) / 2)]
            a = self._line_begins(int(resting[0]) if resting.size else a)
            b = self._line_begins(min(int(np.searchsorted(start_t, start_t[a] + length)), last))
            if b > a:
                yield a, b

    def _whole(self) -> PrintSlice:
        kinds = self.labels
        return PrintSlice(self.machine, self.planned, self.flavor, self.offset, kinds.layer, kinds.feature)

    def _part(self, first: int, last: int) -> PrintSlice:
        planned = plan_program(part(self.program, first, last), self.machine)
        x, y, z, _ = self.program.moves.start[first]
        return PrintSlice(
            self.machine,
            planned,
            self.flavor,
            self.offset,
            self.labels.layer[first:last],
            self.labels.feature[first:last],
            float(self.planned.trajectory.start_t[first]),
            preamble(self.program, first),
            (float(x), float(y), float(z)),
        )


def _layers_named(sampling: Sampling) -> str:
    last = "the last" if sampling.last_layer is None else f"{sampling.last_layer}"
    return f"layers {sampling.first_layer} to {last}"
