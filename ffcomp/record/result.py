"""The result of a recording: joined captures with their clocks, and refused ones with the reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import ClockKind
from ffcomp.measurement.recording import Recording
from ffcomp.numerics.serialise import keys
from ffcomp.record.clock import ClockFit
from ffcomp.record.plan import Motion, Plan, run_name
from ffcomp.result import Fact, Result
from models.arrays import FloatArray
from models.machine import Machine

KEPT_REST_S = (0.5, 0.4)  # before and after the motion, in a recording
DELAY_SD_S = {"log": 5e-5, "firmware": 3e-4, "free": 1e-3}
DRIFT_SD = 5e-5


@dataclass(frozen=True, eq=False)
class Joined:
    """One execution of an experiment on one clock."""

    json_keys: ClassVar = keys("name", "experiment", "repeat", "overflows", "axes_map") | keys(
        offset_s="clock.offset_s",
        offset_sd_s="clock.offset_sd_s",
        clock_ratio="clock.ratio",
        clock_sd="clock.ratio_sd",
        correlation="clock.correlation",
        capture="source",
    )

    recording: Recording
    experiment: str
    repeat: int
    clock: ClockFit
    overflows: int
    source: str
    axes_map: str
    begin_s: float  # of the recording, on the experiment's clock: its motion begins at 0
    felt: tuple[float, ...] = (1.0, 1.0, 1.0)  # of the expected motion along x, y, z

    @property
    def name(self) -> str:
        """The stem of its file."""
        return Path(self.recording.source).stem


@dataclass(frozen=True)
class Refused:
    """A capture that cannot be joined."""

    file: str
    why: str


@dataclass(frozen=True, eq=False)
class JoinResult:
    """The joined and the refused captures."""

    joined: tuple[Joined, ...]
    refused: tuple[Refused, ...]
    remarks: tuple[str, ...] = ()  # sentences about the joined runs

    @property
    def recordings(self) -> list[Recording]:
        """The recordings, repeats next to each other."""
        return [each.recording for each in self.joined]

    def check(self) -> None:
        """Raise a MeasurementError with every reason if nothing could be joined."""
        if self.joined:
            return
        if len({each.file for each in self.refused}) == 1:
            raise MeasurementError(self.refused[0].file, [each.why for each in self.refused])
        reasons = [f"{each.file}: {each.why}" for each in self.refused]
        raise MeasurementError("captures", ["None of them could be joined.", *reasons])

    def notes(self, plan: Plan, machine: Machine) -> list[str]:
        """Say in sentences what the user should know, though it is no reason to refuse anything."""
        notes = list(self.remarks)
        if plan.machine_sha256 and plan.machine_sha256 != machine.sha256:
            notes.append(
                f"The plan was made with another machine file ({plan.machine}, sha256 {plan.machine_sha256[:8]}); the "
                "command is the plan's own all the same."
            )
        got = {(each.experiment, each.repeat) for each in self.joined}
        missing = [run_name(each.name, repeat) for each, repeat in plan.runs() if (each.name, repeat) not in got]
        if missing and self.joined:
            notes.append(f"No recording of {len(missing)} executions of the plan: {', '.join(missing)}.")
        return notes


@dataclass(frozen=True, eq=False, repr=False)
class JoinedRuns(Result):
    """Captures that were joined with their commands, and the measured runs that were written."""

    schema = "ffcomp-join/1"
    json_keys: ClassVar = keys("files", runs="result.joined", refused="result.refused")

    result: JoinResult
    plan: Plan
    machine: Machine
    called: str  # how the machine was named
    folder: Path
    files: Sequence[Path]  # in the order of the joined runs

    @property
    def headline(self) -> str:
        """How much of the plan was joined."""
        joined = self.result.joined
        executions = len({(each.experiment, each.repeat) for each in joined})
        axes = f"; axes {joined[0].axes_map}" if joined and joined[0].axes_map else ""
        return f"{executions} of {len(self.plan.runs())} executions joined in {self.folder}{axes}."

    @property
    def facts(self) -> list[Fact]:
        """Each run's clock, and each refused capture's reason."""
        joined = [
            (
                each.name,
                f"offset {each.clock.offset_s:.6f} ± {each.clock.offset_sd_s:.6f} s, ratio {each.clock.ratio:.6f}, "
                f"correlation below 20 Hz {each.clock.correlation:.3f}",
            )
            for each in self.result.joined
        ]
        return [*joined, *((each.file, f"refused: {each.why}") for each in self.result.refused)]

    @property
    def warnings(self) -> list[str]:
        """Faulty and missing captures, where others were joined."""
        return self.result.notes(self.plan, self.machine)

    @property
    def next_steps(self) -> list[str]:
        """Diagnose the joined files."""
        if not self.files:
            return []
        once = "" if self.plan.repeats > 1 else " --without-repeats"
        return [f"Then: ffcomp diagnose {self.folder}/*.csv -m {self.called}{once}"]

    @property
    def failure(self) -> MeasurementError | None:
        """Nothing could be joined; the facts have the reasons."""
        return None if self.result.joined else MeasurementError("captures", ["None of them could be joined."])


def measured_run(
    name: str, motion: Motion, tau: FloatArray, sensors: Mapping[str, FloatArray], comments: Mapping[str, str]
) -> Recording:
    """Make a measured run of signals (n,) at the times (n,) s of an experiment: the command is the motion's."""
    return Recording(
        source=f"{name}.csv",
        time_s=tau - tau[0],
        command=motion.nozzle(tau),
        command_space="nozzle",
        acceleration={signal: values for signal, values in sensors.items() if signal.startswith("acc_")},
        position={signal: values for signal, values in sensors.items() if signal.startswith("pos_")},
        comments=dict(comments),
    )


def joined_comments(
    clock: ClockFit, source: str, experiment: str, repeat: int, kind: ClockKind, overflows: int = 0
) -> dict[str, str]:
    """Say where a measured run is from, and how well its clock is known."""
    return {
        "joined": f"offset_s {clock.offset_s:.6f} ± {clock.offset_sd_s:.6f}, ratio {clock.ratio:.7f} ± "
        f"{clock.ratio_sd:.7f}, correlation below 20 Hz {clock.correlation:.4f}, overflows {overflows}",
        "experiment": experiment,
        "repeat": str(repeat),
        "capture": Path(source).name,
        "delay_sd_s": f"{DELAY_SD_S[kind]:g}",
        "drift_sd": f"{DRIFT_SD:g}",
    }


def recording_lines(recording: Recording) -> list[bytes]:
    """Write a recording as a measured run."""
    head = "".join(f"# {key}: {text}\n" for key, text in recording.comments.items())
    columns = {f"{name}_mm": recording.command[:, i] for i, name in enumerate(recording.inputs)}
    columns |= {f"{name}_m_per_s2": values for name, values in recording.acceleration.items()}
    columns |= {f"{name}_mm": values for name, values in recording.position.items()}
    table = np.column_stack([recording.time_s, *columns.values()])
    row = ",".join(["%.7f", *["%.6f"] * len(columns)]) + "\n"
    text = (row * len(table) % tuple(table.ravel().tolist())).replace("nan", "")
    return [head.encode(), (",".join(["t_s", *columns]) + "\n").encode(), text.encode()]
