"""A whole simulation: a file through the virtual printer, judged, and written down as a measured run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path

from ffcomp.errors import NothingToDo
from ffcomp.metrics import Track
from ffcomp.simulate.command import Command
from ffcomp.simulate.compatibility import check_same_kinematics
from ffcomp.simulate.evaluation import Judge
from ffcomp.simulate.gcode_command import read_gcode
from ffcomp.simulate.playback import Piece, play
from ffcomp.simulate.run_file import KINDS, run_lines
from ffcomp.simulate.steps_command import steps_command
from ffcomp.steps.reader import is_step_archive, read_steps
from ffcomp.version import __version__
from gcode.atomic_write import replace_atomically
from gcode.container import read_bytes
from gcode.errors import GcodeError
from gcode.text import check_regular
from models.errors import UnreachableError
from models.machine import Machine

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Request:
    """What is simulated, and how it is written down."""

    rate_hz: float = 1600.0
    from_s: float = 0.0
    to_s: float = inf
    gravity: bool = True
    kinds: Sequence[str] = KINDS  # of the sensors in the run file


@dataclass(frozen=True)
class Simulated:
    """What came of it."""

    track: Track
    peak_carriage_velocity_mm_per_s: float
    simulated_s: float  # print time
    seconds: float  # that it took
    rows: int


def read_command(
    path: str | Path,
    machine: Machine,
    offset: tuple[float, float] = (0.0, 0.0),
    flavor: str = "",
    plate: int | None = None,
) -> tuple[Command, list[str]]:
    """A G-code file or a step archive, told apart by their content, and what was odd about it, in sentences.

    plate : of an archive that holds several prints
    """
    check_regular(Path(path))
    if is_step_archive(path):
        return steps_command(read_steps(path), machine, str(path)), []
    command, program = read_gcode(read_bytes(path, plate), str(path), machine, offset, flavor)
    return command, program.warnings


def simulate_command(
    command: Command,
    machine: Machine,
    plant: Machine,
    request: Request,
    *,
    path: str = "",
    target: Path | None = None,
    progress: Progress = lambda done_s: None,
) -> Simulated:
    """Play a command, judge it, and write it into `target` (None: nowhere), which is replaced whole or not at all.

    Parameters
    ----------
    machine : what the command was computed with;  plant : the printer that moves
    path : the command's file, as the user named it
    progress : called with the print-seconds done so far
    """
    check_same_kinematics(machine, plant)
    started = time.perf_counter()
    parts = command.between(request.from_s, request.to_s)
    played_s = sum(end - begin for _, begin, end in parts)
    judge = Judge(plant, request.rate_hz, request.gravity)
    if not judge.enough(len(parts), played_s):
        part = f"from {request.from_s:g} to {request.to_s:g} s, {played_s:g} s of motion are too few"
        raise NothingToDo(f"{path}: {part} to simulate; the motion ends at {command.stretches[-1].end_s:.3f} s.")
    count = _Count()
    pieces = play(command, plant, request.rate_hz, request.from_s, request.to_s, gravity=request.gravity)
    watched = _watched(pieces, judge, count, request.rate_hz, progress)
    try:
        _write(watched, target, plant, _comments(path, machine, plant, request), request.kinds)
    except UnreachableError as error:
        raise GcodeError(str(error), path=path) from error
    return Simulated(*judge.track(), played_s, time.perf_counter() - started, count.rows)


@dataclass
class _Count:
    rows: int = 0


def _watched(
    pieces: Iterable[Piece], judge: Judge, count: _Count, rate_hz: float, progress: Progress
) -> Iterator[Piece]:
    for piece in pieces:
        judge.add(piece)
        yield piece
        count.rows += len(piece.t_s)
        progress(count.rows / rate_hz)


def _write(
    pieces: Iterable[Piece], target: Path | None, plant: Machine, comments: dict[str, str], kinds: Sequence[str]
) -> None:
    if target is None:
        for _ in pieces:
            pass
    else:
        replace_atomically(target, run_lines(pieces, plant, comments, kinds))


def _comments(path: str, machine: Machine, plant: Machine, request: Request) -> dict[str, str]:
    return {
        "made by": f"ffcomp v{__version__} simulate",
        "command": Path(path).name,
        "machine": f"{machine.name}, sha256 {machine.sha256}",
        "plant": f"{plant.name}, sha256 {plant.sha256}",
        "effects": ", ".join(plant.effects) or "none",
        "gravity": "yes" if request.gravity else "no",
    }
