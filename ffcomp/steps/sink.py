"""A nozzle path in, an archive of step timings out, as it comes: memory does not grow with the print."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ffcomp.errors import LimitsError
from ffcomp.steps.archive import FOLLOWING, MOTORS, Column, StepsError, TextColumn, number_npy, write_archive
from ffcomp.steps.compress import Compressor
from ffcomp.steps.crossings import (
    LATEST,
    LATEST_TICK,
    STATE_SIZE,
    SWALLOWED,
    Arm,
    Knots,
    Rules,
    last_step,
    step_times,
)
from models.arrays import FloatArray, IntArray
from models.machine import Machine

WayArray = NDArray[np.int8]

BEFORE_S = 0.1  # at rest before the first motion
BLOCK_PIECES = 1024  # at a time: a few megabytes of steps
JUMP_MM = 1e-3  # between two parts of a path: less than this is rounding
OVERLAP_S = 1e-7
MOST_ERROR_S = 25e-6  # FORMATS.md


@dataclass(frozen=True, slots=True)
class Board:
    """What the electronics that will play the steps are like.

    Motors do not wait for each other: only the pulses of one motor keep their distance.
    """

    extruder_steps_per_mm: float  # of filament; the machine file knows the carriages' own
    clock_hz: float = 16_000_000.0  # of the ticks; a board's own, if the rows are sent to one
    pulse_spacing_s: float = 2e-6  # 1 µs high and 1 µs low, as an A4988 asks; a DRV8825 needs 3.8 µs, a TMC 0.2
    direction_setup_s: float = 5e-6  # from the last step one way to the first one the other way
    shortest_turn_s: float = 750e-6  # a step taken back sooner is left out, as Klipper does
    most_late_s: float = 25e-6  # delay of a pulse for its spacing that is allowed

    def ticks(self, seconds: float) -> int:
        """Convert seconds to ticks of the board's clock."""
        return max(round(seconds * self.clock_hz), 1)


@dataclass(frozen=True, slots=True)
class MotorTotal:
    """Totals of one motor's steps."""

    steps: int  # with `--kind steps`: of motors a, b, c, e
    rows: int  # after compression; 0 without
    swallowed: int  # left out because they turned back at once
    latest_s: float  # the longest that a pulse was put off to keep its distance


class _Motor:
    """One motor between chunks, and the output of its steps: each of them, or compressed rows."""

    def __init__(self, name: str, machine: Machine, board: Board, folder: Path, error_s: float | None) -> None:
        self.name, self._board, place = name, board, (MOTORS + FOLLOWING).index(name)
        filament = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        self._arm = cast(Arm, tuple([*machine.kinematics.motor_rows.tolist(), filament][place]))
        per_mm = [*machine.steps.per_motor.tolist(), board.extruder_steps_per_mm][place]
        self.start_mm, self.step_mm, self.steps = 0.0, 1.0 / per_mm, 0
        seconds = (board.shortest_turn_s, board.pulse_spacing_s, board.direction_setup_s)
        self._rules = cast(Rules, tuple(map(board.ticks, seconds)))
        self._state = np.zeros(STATE_SIZE, dtype=np.int64)
        self._compressor: Compressor | None = None
        types: dict[str, DTypeLike] = {"tick": np.int64, "direction": np.int8}
        if error_s is not None:
            self._compressor = Compressor(int(error_s * board.clock_hz), self._rules[1])
            types = {"interval": np.int64, "count": np.uint16, "add": np.int16, "direction": np.int8}
        self.columns = {key: Column(dtype, folder) for key, dtype in types.items()}

    def add(self, knots: Knots, first: int, last: int) -> None:
        times, grid = (knots.start_t, knots.spacing_s), (self.start_mm, self.step_mm)
        how = self._arm, grid, self._board.clock_hz, self._rules, self._state
        self._take(*step_times(knots.places, times, (first, last), *how))

    def finish(self) -> None:
        self._take(*last_step(self._rules, self._state))
        if self._compressor is not None:
            self._append(self._compressor.finish())

    def _take(self, tick: IntArray, way: WayArray) -> None:
        late, most = self._state[LATEST] / self._board.clock_hz, self._board.most_late_s
        if late > most:
            at, rate = self._state[LATEST_TICK] / self._board.clock_hz, 1.0 / self._board.pulse_spacing_s
            problem = f"Motor {self.name} needs more than {rate:.0f} steps a second at t = {at:.3f} s"
            raise LimitsError(
                f"{problem}: a pulse would come {late * 1e6:.0f} µs late, at most {most * 1e6:.0f} µs are allowed. "
                f"Use fewer microsteps than {1.0 / self.step_mm:g} a millimetre, or a shorter pulse spacing."
            )
        self.steps += len(tick)
        self._append((tick, way) if self._compressor is None else self._compressor.add(tick, way))

    def _append(self, columns: tuple[NDArray[Any], ...]) -> None:
        for column, values in zip(self.columns.values(), columns, strict=True):
            column.append(values)

    def total(self) -> MotorTotal:
        late = float(self._state[LATEST]) / self._board.clock_hz
        rows = self.columns["count"].length if "count" in self.columns else 0
        return MotorTotal(self.steps, rows, int(self._state[SWALLOWED]), late)


def _shown(place: FloatArray) -> str:
    return " ".join(f"{axis} = {mm:.4f}" for axis, mm in zip("XYZE", place, strict=True)) + " mm"


class StepSink:
    """Writes the archive of FORMATS.md, section 5: `steps`, or `klipper-steps` if an error is allowed.

        with closing(StepSink(machine, Board(extruder_steps_per_mm=415.0), target)) as sink:
            sink.knots(Knots(0.1, 0.004, places))
            sink.event(12.5, b"M106 S255")
            totals = sink.finish()

    Time runs on one clock from 0 s; between pieces the nozzle rests. The target is replaced by `finish`, whole, and
    without it nothing is left behind, whatever happens.

    target : the archive
    error_s : None writes every step exactly. Otherwise rows of steps, none of them off by more than this or by a
        quarter of the way to its neighbours. 12.5 µs is a window as wide as Klipper's, which is 25 µs on one side.
        The archive says it, as `error_s`.
    """

    clock_s = BEFORE_S  # of the path so far; whoever gives the path counts on

    def __init__(self, machine: Machine, board: Board, target: str | Path, error_s: float | None = None) -> None:
        if error_s is not None and not 0.0 <= error_s <= MOST_ERROR_S:
            raise ValueError(f"error_s is {error_s:g} s; steps may be off by 0 to {MOST_ERROR_S:g} s.")
        self._target, self._board, self._geometry = Path(target), board, machine.kinematics
        self._error_s = error_s
        folder = self._target.resolve().parent
        self._motors = [_Motor(name, machine, board, folder, error_s) for name in MOTORS + FOLLOWING]
        self._event_tick, self._event_line = Column(np.int64, folder), TextColumn(folder)
        self._end_t = 0.0
        self._end: FloatArray | None = None  # (4,) mm, where the last piece ended
        self._last_event_t = 0.0

    def knots(self, knots: Knots) -> None:
        """Take the next part of the path; how a path is cut into calls changes nothing.

        Raises StepsError if the path jumps or time runs backwards; UnreachableError if an arm is too short for the
        path; LimitsError if pulses would follow each other faster than the board allows.
        """
        places = knots.places
        carriages = self._geometry.inverse(places[:, :3])  # it refuses what is out of reach
        if self._end is None:
            begins = [*(self._geometry.motors @ carriages[0]).tolist(), float(places[0, 3])]
            for motor, start_mm in zip(self._motors, begins, strict=True):
                motor.start_mm = start_mm
        self._check_joint(knots.start_t, places[0])
        for first in range(0, len(places) - 1, BLOCK_PIECES):
            for motor in self._motors:
                motor.add(knots, first, min(first + BLOCK_PIECES, len(places) - 1))
        self._end, self._end_t = places[-1], knots.end_t

    def _check_joint(self, start_t: float, begin: FloatArray) -> None:
        """Require that a path begins where and when the one before it ended, or later."""
        if self._end is not None and np.abs(begin - self._end).max() > JUMP_MM:
            jump = f"from {_shown(self._end)} to {_shown(begin)}"
            raise StepsError(f"At t = {start_t:.4f} s the path jumps {jump}; steps go on from where motors are.")
        if start_t < self._end_t - OVERLAP_S:
            raise StepsError(f"A piece begins at t = {start_t:.7f} s, before {self._end_t:.7f} s; time goes on.")

    def event(self, t: float, line: bytes, *, still: bool = False) -> None:
        """Add a G-code line to run at the time t, s, no earlier than the event before it; `still` changes nothing."""
        if t < self._last_event_t:
            last = self._last_event_t
            raise StepsError(f"An event at t = {t:g} s comes after one at {last:g} s; events are given in order.")
        self._last_event_t = t
        self._event_tick.append(np.array([round(t * self._board.clock_hz)]))
        self._event_line.append(line.rstrip(b"\r\n"))

    def rest(self, until: float) -> None:
        """Do nothing: a rest has no steps."""

    def factors(self, t: float, speed: float, flow: float) -> None:
        """Do nothing: an archive holds the steps that are made."""

    def height(self, known: bool) -> None:
        """Do nothing: whoever plays an archive begins where it begins."""

    def finish(self) -> dict[str, MotorTotal]:
        """Write the archive, and return what became of each motor's steps, by its letter."""
        for motor in self._motors:
            motor.finish()
        write_archive(self._target, dict(self._members()))
        self.close()
        return {motor.name: motor.total() for motor in self._motors}

    def _members(self) -> Iterator[tuple[str, Iterator[bytes]]]:
        yield "clock_hz", number_npy(self._board.clock_hz)
        if self._error_s is not None:
            yield "error_s", number_npy(self._error_s)
        for motor in self._motors:
            yield f"{motor.name}_start_mm", number_npy(motor.start_mm)
            yield f"{motor.name}_step_mm", number_npy(motor.step_mm)
            yield from ((f"{motor.name}_{key}", column.npy()) for key, column in motor.columns.items())
        yield "events_tick", self._event_tick.npy()
        yield "events_line", self._event_line.npy()

    def close(self) -> None:
        """Discard the temporary files; `finish` does so itself."""
        for motor in self._motors:
            for column in motor.columns.values():
                column.close()
        self._event_tick.close()
        self._event_line.close()
