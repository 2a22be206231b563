"""A whole simulation: a file executed on the simulated printer, evaluated, and written as a recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from ffcomp.errors import NothingToDo
from ffcomp.metrics import Track
from ffcomp.numerics.serialise import to_json
from ffcomp.simulate.command import Command
from ffcomp.simulate.compatibility import check_same_kinematics
from ffcomp.simulate.evaluation import Evaluation, Evaluator
from ffcomp.simulate.gcode_command import read_gcode
from ffcomp.simulate.playback import Chunk, play
from ffcomp.simulate.recording import KINDS, recording_lines
from ffcomp.simulate.steps_command import steps_command
from ffcomp.steps.reader import is_step_archive, read_steps
from ffcomp.version import __version__
from gcode.atomic_write import replace_atomically
from gcode.container import read_bytes
from gcode.errors import GcodeError
from gcode.text import check_regular
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.machine import Machine
from models.provenance import identity

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Request:
    """The part of the command that is simulated, and how it is recorded."""

    rate_hz: float = 1600.0
    from_s: float = 0.0
    to_s: float = inf
    gravity: bool = True
    kinds: Sequence[str] = KINDS  # of the sensors in the recording


@dataclass(frozen=True, eq=False)
class SimulationResult:
    """A simulated command and its evaluation; arrays hold m samples of all sections."""

    machine: Machine  # the one that the command was computed with
    plant: Machine  # the printer that moves
    request: Request
    reference: str  # a sentence: the path that the nozzle is evaluated against
    evaluation: Evaluation
    simulated_s: float  # print time
    seconds: float  # of computing
    rows: int

    @property
    def time_s(self) -> FloatArray:
        """(m,) s, on the command's clock."""
        return self.evaluation.time_s

    @property
    def reference_mm(self) -> FloatArray:
        """(m, 3) mm, where the nozzle should be."""
        return self.evaluation.reference_mm

    @property
    def nozzle_mm(self) -> FloatArray:
        """(m, 3) mm, where it is."""
        return self.evaluation.nozzle_mm

    @property
    def error_um(self) -> FloatArray:
        """(m,) µm, contour error."""
        return self.evaluation.error_um

    @property
    def track(self) -> Track:
        """The TRACK of all samples."""
        return self.evaluation.track

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of `ffcomp simulate --json`, without names of files and without samples."""
        return {
            "machine": identity(self.machine),
            "plant": identity(self.plant),
            "effects": list(self.plant.effects),
            "gravity": self.request.gravity,
            "rate_hz": self.request.rate_hz,
            "rows": self.rows,
            "simulated_s": self.simulated_s,
            "wall_s": self.seconds,
            "print_s_per_wall_s": self.simulated_s / self.seconds,
            "reference": self.reference,
            "track": to_json(self.track),
            "peak_carriage_velocity_mm_per_s": self.evaluation.peak_actuator_velocity_mm_per_s,
        }


def read_command(
    path: str | Path,
    machine: Machine,
    offset: tuple[float, float] = (0.0, 0.0),
    flavor: str = "",
    plate: int | None = None,
) -> tuple[Command, list[str]]:
    """Read a G-code file or a step archive, recognised by their content.

    Parameters
    ----------
    path : path
    machine : Machine
        The one that the command was computed with.
    offset : (float, float)
        Added to every position, mm.
    flavor : str
        "" for what the machine file says, or else the file.
    plate : int, optional
        Of an archive that holds several prints.

    Returns
    -------
    Command, list of str
        The command, and the reader's warnings.
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
) -> SimulationResult:
    """Execute a command, evaluate it, and record it.

    Parameters
    ----------
    command : Command
    machine, plant : Machine
        The one that the command was computed with, and the printer that moves.
    request : Request
    path : str
        The command's file, as the user named it.
    target : Path, optional
        The recording, which is replaced whole or not at all. None: nothing is recorded.
    progress : callable
        Called with the print seconds done so far.

    Raises
    ------
    NothingToDo
        If the part holds too little motion.
    MachineFileError
        If the plant's kinematics are not the machine's, or it cannot rest.
    GcodeError
        If the nozzle leaves the reach of its arms.
    """
    check_same_kinematics(machine, plant)
    started = time.perf_counter()
    parts = command.between(request.from_s, request.to_s)
    simulated_s = sum(end - begin for _, begin, end in parts)
    evaluator = Evaluator(plant, request.rate_hz, request.gravity)
    if not evaluator.enough(len(parts), simulated_s):
        part = f"from {request.from_s:g} to {request.to_s:g} s, {simulated_s:g} s of motion are too few"
        raise NothingToDo(f"{path}: {part} to simulate; the motion ends at {command.sections[-1].end_s:.3f} s.")
    count = _Count()
    chunks = play(command, plant, request.rate_hz, request.from_s, request.to_s, gravity=request.gravity)
    watched = _watched(chunks, evaluator, count, request.rate_hz, progress)
    try:
        _write(watched, target, plant, _comments(path, machine, plant, request), request.kinds)
    except UnreachableError as error:
        raise GcodeError(str(error), path=path) from error
    evaluation, seconds = evaluator.evaluation(), time.perf_counter() - started
    return SimulationResult(machine, plant, request, command.reference, evaluation, simulated_s, seconds, count.rows)


@dataclass
class _Count:
    rows: int = 0


def _watched(
    chunks: Iterable[Chunk], evaluator: Evaluator, count: _Count, rate_hz: float, progress: Progress
) -> Iterator[Chunk]:
    for chunk in chunks:
        evaluator.add(chunk)
        yield chunk
        count.rows += len(chunk.t_s)
        progress(count.rows / rate_hz)


def _write(
    chunks: Iterable[Chunk], target: Path | None, plant: Machine, comments: dict[str, str], kinds: Sequence[str]
) -> None:
    if target is None:
        for _ in chunks:
            pass
    else:
        replace_atomically(target, recording_lines(chunks, plant, comments, kinds))


def _comments(path: str, machine: Machine, plant: Machine, request: Request) -> dict[str, str]:
    return {
        "made by": f"ffcomp v{__version__} simulate",
        "command": Path(path).name,
        "machine": f"{machine.name}, sha256 {machine.sha256}",
        "plant": f"{plant.name}, sha256 {plant.sha256}",
        "effects": ", ".join(plant.effects) or "none",
        "gravity": "yes" if request.gravity else "no",
    }
