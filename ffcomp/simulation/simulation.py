"""A whole simulation: a file executed on the simulated printer, evaluated, and written as a recording."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ffcomp.errors import NothingToDo
from ffcomp.metrics import Track, build_track, contour_error, end_to_end, tracking
from ffcomp.numerics.serialise import keys
from ffcomp.result import Fact, Result, clock
from ffcomp.simulation.command import Command, CommandSection, command_peaks, read_gcode, steps_command
from ffcomp.simulation.playback import PlayedPart, check_same_kinematics, levelled, play
from ffcomp.simulation.request import SIGNALS, SimulateRequest
from ffcomp.steps.archive import is_step_archive, read_steps
from ffcomp.version import __version__
from gcode.atomic_write import replace_atomically
from gcode.container import read_bytes
from gcode.errors import GcodeError
from gcode.text import check_regular
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE, measured
from models.effects.effect import Signals
from models.errors import UnreachableError
from models.machine import Machine

EVALUATED_HZ = 1600.0  # no more samples than that are kept, 0.2 GB for an hour of print
FEWEST_SAMPLES = 4


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The executed path against its reference at m samples of all sections, and its statistics."""

    time_s: FloatArray  # (m,) on the command's clock
    reference_mm: FloatArray  # (m, 3) where the nozzle should be
    nozzle_mm: FloatArray  # (m, 3) where it is, static deflection taken out
    error_um: FloatArray  # (m,) contour error
    track: Track
    peak_actuator_velocity_mm_per_s: float


class Evaluator:
    """Collect chunks of an executed command and evaluate them all.

    Static deflection is taken out (unless there is no gravity), as bed levelling does. The ringing after a section's
    end is not evaluated.
    """

    def __init__(self, plant: Machine, rate_hz: float, gravity: bool = True) -> None:
        self._plant, self._rate_hz, self._gravity = plant, rate_hz, gravity
        self._every = max(1, round(rate_hz / EVALUATED_HZ))
        self._sample_s = self._every / rate_hz
        self._parts: dict[CommandSection, list[tuple[FloatArray, FloatArray]]] = {}  # times and nozzle of its chunks
        self._skip = 0  # samples until the next that is kept
        self.rows = 0  # samples so far

    def over(self, chunks: Iterable[PlayedPart], progress: Callable[[float], None]) -> Iterator[PlayedPart]:
        """Yield the same chunks, and take them in."""
        for chunk in chunks:
            self._add(chunk)
            yield chunk
            self.rows += len(chunk.t_s)
            progress(self.rows / self._rate_hz)

    def _add(self, chunk: PlayedPart) -> None:
        if chunk.section not in self._parts:
            self._parts[chunk.section], self._skip = [], 0
        kept = slice(self._skip, None, self._every)
        t, nozzle = chunk.t_s[kept], chunk.nozzle_mm[kept]
        self._skip = (self._skip - len(chunk.t_s)) % self._every
        inside = t <= chunk.section.end_s
        nozzle = levelled(self._plant, nozzle[inside]) if self._gravity else nozzle[inside]
        self._parts[chunk.section].append((t[inside], nozzle))

    def enough(self, sections: int, seconds: float) -> bool:
        """Tell whether a motion of so many sections and seconds can be evaluated at all."""
        return seconds > (FEWEST_SAMPLES + sections) * self._sample_s

    def evaluation(self) -> Evaluation:
        """Evaluate all chunks."""
        times: list[FloatArray] = []
        nozzles: list[FloatArray] = []
        contours: list[FloatArray] = []
        for section, parts in self._parts.items():
            t, nozzle = (np.concatenate(part) for part in zip(*parts, strict=True))
            plan_t = section.plan_time(t)
            corners = section.corners(float(plan_t[0]), float(plan_t[-1]))
            times.append(t)
            nozzles.append(nozzle)
            contours.append(contour_error(*corners, plan_t, nozzle))
        references = [each.due(t) for each, t in zip(self._parts, times, strict=True)]
        spans = [(float(t[0]), float(t[-1])) for t in times]
        peaks = [command_peaks(each.actuators, *span) for each, span in zip(self._parts, spans, strict=True)]
        speeds, accelerations = zip(*peaks, strict=True)
        contour, seconds = np.concatenate(contours), sum(end - begin for begin, end in spans)
        follows = tracking(*end_to_end(references, nozzles), self._sample_s)
        return Evaluation(
            time_s=np.concatenate(times),
            reference_mm=np.concatenate(references),
            nozzle_mm=np.concatenate(nozzles),
            error_um=1e3 * contour,
            track=build_track(follows, contour, seconds, max(accelerations)),
            peak_actuator_velocity_mm_per_s=max(speeds),
        )


def recording_lines(
    chunks: Iterable[PlayedPart], plant: Machine, comments: Mapping[str, str], kinds: Sequence[str] = SIGNALS
) -> Iterator[bytes]:
    """Yield the file chunk by chunk: comments, header, rows.

    chunks : of one section
    plant : the printer whose sensors record
    kinds : of "acc" and "pos", accelerations (m/s², gravity removed) and positions (mm)
    """
    yield "".join(f"# {key}: {' '.join(text.split())}\n" for key, text in comments.items()).encode()
    channels, units = plant.vibration.channels, {"acc": "m_per_s2", "pos": "mm"}
    carriages = [name for name in channels if name not in "xyz"]  # straight axes are their own carriages
    sensors = [f"{kind}_{axis}_{units[kind]}" for kind in kinds for axis in (*carriages, *"xyz")]
    columns = ["t_s", *(f"cmd_{axis}_mm" for axis in channels), *sensors]
    yield (",".join(columns) + "\n").encode()
    row = ",".join(["%.7f"] * len(columns)) + "\n"
    if any(CATALOGUE[name].shifts_time for name in plant.effects):
        chunks = [_joined(list(chunks))]
    for chunk in chunks:
        felt = measured(plant, replace(chunk.signals, t_s=chunk.t_s - chunk.t_s[0]))
        blocks = {"acc": (felt.carriage, felt.nozzle), "pos": (chunk.carriage_mm, chunk.nozzle_mm)}
        recorded = [block for kind in kinds for block in blocks[kind][0 if carriages else 1 :]]
        values = np.column_stack([chunk.t_s, chunk.section.actuators(chunk.t_s), *recorded])
        yield (row * len(values) % tuple(values.ravel().tolist())).encode()


def _joined(chunks: Sequence[PlayedPart]) -> PlayedPart:
    t_s, carriage_mm, nozzle_mm, carriage, nozzle = (
        np.concatenate(parts)
        for parts in zip(
            *((c.t_s, c.carriage_mm, c.nozzle_mm, c.signals.carriage, c.signals.nozzle) for c in chunks), strict=True
        )
    )
    return PlayedPart(chunks[0].section, t_s, carriage_mm, nozzle_mm, Signals(t_s, carriage, nozzle))


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Evaluation, Result):
    """A simulated command and its evaluation."""

    title = "Simulated print"

    drawn_by: ClassVar = {"path": "ffcomp.report.show:simulation_figure"}
    schema = "ffcomp-simulate/1"
    json_keys: ClassVar = keys("machine", "plant", "reference", "track", "simulated_s", "rows", "warnings") | keys(
        input="path",
        output="recording",
        gravity="request.gravity",
        rate_hz="request.rate_hz",
        wall_s="seconds",
        peak_carriage_velocity_mm_per_s="peak_actuator_velocity_mm_per_s",
    )

    machine: Machine  # the one that the command was computed with
    plant: Machine  # the printer that moves
    request: SimulateRequest
    reference: str  # a sentence: the path that the nozzle is evaluated against
    simulated_s: float  # print time
    seconds: float  # of computing
    rows: int
    path: str = ""  # the command's file
    recording: Path | None = None  # the run that was written
    warnings: Sequence[str] = ()

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame with a row for each sample; needs pandas."""
        import pandas as pd

        columns: dict[str, FloatArray] = {"time_s": self.time_s}
        for name, points in (("reference", self.reference_mm), ("nozzle", self.nozzle_mm)):
            columns |= {f"{name}_{axis}_mm": points[:, k] for k, axis in enumerate("xyz")}
        return pd.DataFrame({**columns, "error_um": self.error_um})

    @property
    def headline(self) -> str:
        """The contour error on this printer."""
        track = self.track
        return (
            f"{self.plant.name}: contour error {track.contour_rms_um:.2f} µm rms, 99 % below "
            f"{track.contour_p99_um:.1f} µm, largest {track.contour_max_um:.1f} µm."
        )

    @property
    def facts(self) -> list[Fact]:
        """The simulated motion, and the demand on the carriages."""
        track = self.track
        facts = [
            ("Reference", self.reference),
            ("Effects", ", ".join(self.plant.effects) or "none"),
            (
                "Tracking error",
                f"{track.tracking_rms_um:.1f} µm rms; {track.tracking_rms_no_delay_um:.2f} µm without a delay of "
                f"{1e3 * track.delay_s:.3f} ms",
            ),
            (
                "Carriages",
                f"{self.peak_actuator_velocity_mm_per_s:.0f} mm/s and "
                f"{track.peak_command_acceleration_mm_per_s2 / 1e3:.1f} m/s² at most",
            ),
            ("Simulated", f"{clock(self.simulated_s)} in {self.seconds:.1f} s"),
        ]
        written = f"{self.rows} samples at {self.request.rate_hz:g} Hz: {self.recording}"
        return facts if self.recording is None else [*facts, ("Recording", written)]


def read_command(
    path: str | Path,
    machine: Machine,
    offset: tuple[float, float] = (0.0, 0.0),
    flavor: str = "",
    plate: int | None = None,
) -> tuple[Command, list[str]]:
    """Read a G-code file or a step archive, recognised by their content; return the command and the reader's warnings.

    machine : the one that the command was computed with
    offset : (float, float), added to every position, mm
    flavor : "" for what the machine file says, or else the file
    plate : of an archive that holds several prints
    """
    check_regular(Path(path))
    if is_step_archive(path):
        return steps_command(read_steps(path), machine, str(path)), []
    command, program = read_gcode(read_bytes(path, plate), str(path), machine, offset, flavor)
    return command, program.warnings


def simulate_command(
    request: SimulateRequest, command: Command, machine: Machine, plant: Machine, warnings: Sequence[str] = ()
) -> Simulation:
    """Execute a command, evaluate it, and record it.

    Raises NothingToDo if the part holds too little motion, MachineFileError if the plant's kinematics are not the
    machine's, or it cannot rest, and GcodeError if the nozzle leaves the reach of its arms.

    request : the part of the command, and its recording
    machine, plant : the one that the command was computed with, and the printer that moves
    warnings : about the command
    """
    check_same_kinematics(machine, plant)
    started, path = time.perf_counter(), str(request.file)
    target = None if request.recording is None else Path(request.recording)
    parts = command.between(request.from_s, request.to_s)
    simulated_s = sum(end - begin for _, begin, end in parts)
    evaluator = Evaluator(plant, request.rate_hz, request.gravity)
    if not evaluator.enough(len(parts), simulated_s):
        part = f"from {request.from_s:g} to {request.to_s:g} s, {simulated_s:g} s of motion are too few"
        raise NothingToDo(f"{path}: {part} to simulate; the motion ends at {command.sections[-1].end_s:.3f} s.")
    played = play(command, plant, request.rate_hz, request.from_s, request.to_s, gravity=request.gravity)
    chunks = evaluator.over(played, request.progress)
    comments = {
        "made by": f"ffcomp v{__version__} simulate",
        "command": Path(path).name,
        "machine": f"{machine.name}, sha256 {machine.sha256}",
        "plant": f"{plant.name}, sha256 {plant.sha256}",
        "effects": ", ".join(plant.effects) or "none",
        "gravity": "yes" if request.gravity else "no",
    }
    try:
        if target is None:
            deque(chunks, maxlen=0)
        else:
            replace_atomically(target, recording_lines(chunks, plant, comments, request.signals))
    except UnreachableError as error:
        raise GcodeError(str(error), path=path) from error
    return Simulation(
        **vars(evaluator.evaluation()),
        machine=machine,
        plant=plant,
        request=request,
        reference=command.reference,
        simulated_s=simulated_s,
        seconds=time.perf_counter() - started,
        rows=evaluator.rows,
        path=path,
        recording=target,
        warnings=warnings,
    )
