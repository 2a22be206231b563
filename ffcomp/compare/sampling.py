"""What part of a print is looked at: all of it, some layers, or short stretches spread evenly over its time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import NothingToDo
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.trajectory import PlannedMotion
from ffcomp.simulate.motion import Motion, path_corners, planned_motion
from gcode.dialects import detect_flavor
from gcode.layers import Labels, labels
from gcode.program import Program
from gcode.reader import read_program
from gcode.slicing import part, preamble
from models.arrays import FloatArray, IntArray
from models.machine import Machine

LONGEST_S = 120.0  # of print time that is judged if nothing else is asked for
PIECE_S = 10.0  # length of one stretch of a sampled print


@dataclass(frozen=True, slots=True)
class Sampling:
    """What the user asks for."""

    first_layer: int = 0
    last_layer: int | None = None  # the last one looked at
    share: float | None = None  # of these layers' time; None: all, but no more than LONGEST_S


@dataclass(frozen=True, eq=False)
class Stretch:
    """n moves of a print, planned from rest to rest."""

    machine: Machine
    planned: PlannedProgram
    flavor: str
    offset: tuple[float, float]
    layer: IntArray  # (n,) of each move
    feature: IntArray  # (n,) of each move
    begin_t: float = 0.0  # s, on the whole print's clock
    before: bytes = b""  # lines that set what is in force where it begins
    start: tuple[float, float, float] | None = None  # mm, where the nozzle is then; None: as the file says

    @property
    def trajectory(self) -> PlannedMotion:
        return self.planned.trajectory

    @cached_property
    def corners(self) -> tuple[FloatArray, FloatArray]:
        """When each corner of the path is due (n + 1,) s, and where it is (n + 1, 3) mm."""
        return path_corners(self.trajectory)

    @cached_property
    def motion(self) -> Motion:
        """The plan as it stands."""
        return planned_motion(self.trajectory)

    @property
    def extrudes(self) -> NDArray[np.bool_]:
        """(n,) moves that lay plastic down."""
        direction = self.trajectory.direction
        return (direction[:, 3] > 0.0) & np.any(direction[:, :3] != 0.0, axis=1)

    def with_acceleration(self, acceleration: float) -> Stretch:
        """The same moves, planned with another acceleration, mm/s²."""
        return replace(self, planned=accelerated(self.planned, self.machine, acceleration, self.offset))


def accelerated(
    planned: PlannedProgram, machine: Machine, acceleration: float, offset: tuple[float, float]
) -> PlannedProgram:
    """The same moves, planned with one acceleration (mm/s²) for all that travel."""
    program = planned.program
    moves = program.moves
    travels = np.any(moves.end[:, :3] != moves.start[:, :3], axis=1)
    changed = replace(moves, acceleration=np.where(travels, acceleration, moves.acceleration))
    return plan_program(replace(program, moves=changed), machine, offset)


class Print:
    """A sliced print on a machine."""

    def __init__(
        self, data: bytes, path: str, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), flavor: str = ""
    ) -> None:
        self.path, self.machine, self.offset = path, machine, offset
        program = read_program(data, path, offset_mm=offset, flavor=flavor or None)
        self.flavor = flavor or detect_flavor(program.lines)
        self.planned = plan_program(program, machine, offset)
        self.labels: Labels = labels(program)

    @property
    def program(self) -> Program:
        return self.planned.program

    @property
    def print_time_s(self) -> float:
        return self.planned.trajectory.end_t

    def stretches(
        self, sampling: Sampling, piece_s: float = PIECE_S, at_most_s: float = np.inf
    ) -> tuple[list[Stretch], str]:
        """The parts to be judged, and a sentence that says which they are.

        piece_s : how long the stretches of a sampled print are, s
        at_most_s : how long they all are together, s
        """
        first, last = self._layers(sampling)
        start_t = np.append(self.planned.trajectory.start_t, self.print_time_s)
        seconds = float(start_t[last] - start_t[first])
        whole = first == 0 and last == len(self.program.moves)
        wanted = min(LONGEST_S, seconds) if sampling.share is None else sampling.share * seconds
        wanted = min(wanted, at_most_s)
        what = "the whole print" if whole else _layers_named(sampling)
        cuts = [] if wanted >= seconds - piece_s / 2 else list(self._pieces(first, last, wanted, piece_s))
        if not cuts:  # all is asked for, or it is a single arc, which is not cut
            found = [self._whole()] if whole else [self._part(first, last)]
            return found, f"{what[0].upper()}{what[1:]} was judged, {seconds:.0f} s."
        found = [self._part(a, b) for a, b in cuts]
        judged = sum(each.trajectory.end_t for each in found)
        told = f"{len(found)} stretches of some {judged / len(found):.0f} s, spread evenly over {what}"
        if len(found) == 1:
            told = f"One stretch in the middle of {what}"
        return found, f"{told}: {judged:.0f} of {seconds:.0f} s ({judged / seconds:.0%}) were judged."

    def _layers(self, sampling: Sampling) -> tuple[int, int]:
        """The moves of the layers asked for."""
        layer = self.labels.layer
        chosen = layer >= sampling.first_layer
        if sampling.last_layer is not None:
            chosen &= layer <= sampling.last_layer
        numbers = np.flatnonzero(chosen)
        if not numbers.size:
            raise NothingToDo(
                f"{self.path}: no move lies in the layers asked for; the print has {self.labels.layers} layers, "
                f"0 to {self.labels.layers - 1}."
            )
        return self._line_begins(int(numbers[0])), self._line_begins(int(numbers[-1]) + 1)

    def _line_begins(self, move: int) -> int:
        """This move, or the first one of the same line: arcs are not cut."""
        line = self.program.moves.line
        while 0 < move < len(line) and line[move] == line[move - 1]:
            move -= 1
        return move

    def _pieces(self, first: int, last: int, wanted_s: float, piece_s: float) -> Iterator[tuple[int, int]]:
        """Stretches from `first` to `last` that take `wanted_s` together; each begins at rest if it can."""
        start_t = np.append(self.planned.trajectory.start_t, self.print_time_s)
        begin, end = float(start_t[first]), float(start_t[last])
        count = max(1, round(wanted_s / piece_s))
        length, period = wanted_s / count, (end - begin) / count
        rests = np.array([run.first for run in self.planned.runs])
        for k in range(count):
            t = begin + k * period + (period - length) / 2
            a = int(np.searchsorted(start_t, t))
            resting = rests[(rests >= a) & (start_t[rests] < t + (period - length) / 2)]
            a = self._line_begins(int(resting[0]) if resting.size else a)
            b = self._line_begins(min(int(np.searchsorted(start_t, start_t[a] + length)), last))
            if b > a:
                yield a, b

    def _whole(self) -> Stretch:
        kinds = self.labels
        return Stretch(self.machine, self.planned, self.flavor, self.offset, kinds.layer, kinds.feature)

    def _part(self, first: int, last: int) -> Stretch:
        planned = plan_program(part(self.program, first, last), self.machine, self.offset)
        x, y, z, _ = self.program.moves.start[first]
        return Stretch(
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
