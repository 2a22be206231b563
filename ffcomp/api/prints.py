"""Prints: compensate, simulate, estimate and compare them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from ffcomp.api.machines import load_machine
from ffcomp.comparison import engine
from ffcomp.comparison.quickest_plans import Known, worth_knowing
from ffcomp.comparison.request import CompareRequest
from ffcomp.comparison.result import Comparison
from ffcomp.comparison.sampling import Sampling
from ffcomp.compensation.batch import size_of, workers
from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.compensation.request import CompensateRequest
from ffcomp.compensation.result import CompensatedFile
from ffcomp.errors import RequestError, extras_told
from ffcomp.estimation import engine as estimation
from ffcomp.estimation.request import EstimateRequest
from ffcomp.estimation.statistics import Statistics
from ffcomp.integrations.slicer import Bed
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import Track
from ffcomp.numerics.serialise import to_json
from ffcomp.request import function
from ffcomp.simulation.command import Command
from ffcomp.simulation.request import SimulateRequest
from ffcomp.simulation.simulation import Request as Part
from ffcomp.simulation.simulation import SimulationResult, read_command, simulate_command
from gcode.container import opened, read_bytes
from gcode.embedded import STAMP_REACH, already_processed, find_offset, original
from gcode.text import PART_BYTES
from models.arrays import FloatArray
from models.machine import Machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Compensation:
    """A compensated print and what it took.

    Attributes
    ----------
    machine : Machine
    file : CompensatedFile
        What was done, print by print.
    if_known : tuple of Known
        What the quicker print would take if the machine were known better.
    """

    machine: Machine
    file: CompensatedFile
    if_known: tuple[Known, ...] = ()

    @property
    def output(self) -> Path | None:
        """The compensated file; None: nothing was written."""
        return None if self.file.output is None else Path(self.file.output)

    @property
    def print_time_s(self) -> float:
        """Print time of the compensated file in s."""
        return self.file.result.statistics.print_time_s

    @property
    def original_print_time_s(self) -> float:
        """Print time of the original in s."""
        return self.file.result.statistics.original_print_time_s

    @property
    def segments(self) -> int:
        """Number of segments written."""
        return self.file.result.statistics.segments

    @property
    def warnings(self) -> list[str]:
        """Sentences about what was odd or had to be changed."""
        return self.file.warnings

    @property
    def uncompensated(self) -> Track | None:
        """Predicted errors of the original; None: not predicted."""
        return self.file.result.predicted.get("uncompensated")

    @property
    def compensated(self) -> Track | None:
        """Predicted errors of the compensated print; None: not predicted."""
        return self.file.result.predicted.get("compensated")

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-compensate/1."""
        answer = self.file.to_dict()
        if self.if_known:
            answer["faster"] |= {"if_known": to_json(self.if_known)}
        return answer

    @extras_told()
    def plot(self, *, z_mm: float | None = None) -> Figure:
        """Draw the reference, the uncompensated and the compensated path.

        Parameters
        ----------
        z_mm : height of the layer; None: the layer that vibrates most

        Raises
        ------
        RequestError
            If no file was written.
        """
        from ffcomp.report.show import show_figure
        from ffcomp.simulation.preview import preview

        if self.output is None:
            raise RequestError("Nothing was written, so there is nothing to draw: name an output.")
        data = read_bytes(self.output, None)
        stamp = already_processed(data)
        flavor = stamp.flavor if stamp else None
        seen = preview(data, str(self.output), self.machine, find_offset(data[:STAMP_REACH]), flavor)
        return show_figure(seen, f"{self.output.name} on {self.machine.name}", z_mm=z_mm)


def compensate_print(
    request: CompensateRequest, name: str = "", advice: Sequence[str] = (), bed: Bed | None = None
) -> Compensation:
    """Compensate a print; one that is compensated already is left alone.

    Parameters
    ----------
    request : CompensateRequest
    name : the file, as messages call it; "": its path
    advice : warnings about how the file was made
    bed : the slicer's, if it has stated it otherwise than in the file
    """
    machine, file = load_machine(request.machine), Path(request.file)
    options = Options.of(request, machine, bed)
    target = None if request.output is None else Path(request.output)
    data = _original(file) if request.if_known else b""  # the file may be replaced
    jobs = min(request.jobs, max(size_of(file) // PART_BYTES, 1))  # chunks
    with workers(jobs, request.scheduler) as at_once:
        done = compensate_file(
            file, name or str(file), machine, options, target, jobs=at_once, progress=request.progress
        )
    output = str(file) if done.already and done.output == done.path else done.output
    done = replace(done, path=str(file), output=output, advice=tuple(advice))
    if not request.if_known or done.already:
        return Compensation(machine, done)
    assert options.bound is not None and options.settings is not None
    result = done.result
    known = worth_knowing(
        data,
        name or str(file),
        machine,
        options.settings,
        options.bound,
        request.if_known,
        result.statistics.print_time_s,
        offset=result.placement.offset,
        flavor=result.flavor.flavor,
    )
    return Compensation(machine, done, tuple(known))


def _original(file: Path) -> bytes:
    data = read_bytes(file, None)
    return data if already_processed(data) is None else original(data)


def _compensate(request: CompensateRequest) -> Compensation:
    """Compensate a print for a printer's vibration.

    Parameters
    ----------
    progress : Called with the share of the file that is done.

    Raises
    ------
    GcodeError, MachineFileError, LimitsError, SolverError, NothingToDo, RequestError
    """
    done = compensate_print(request)
    if done.file.already:
        raise RequestError(f"{done.file.already} With force=True it is compensated again.")
    return done


compensate = function(CompensateRequest, _compensate)


@dataclass(frozen=True, eq=False)
class Simulation(SimulationResult):
    """A simulated command: arrays `time_s`, `reference_mm`, `nozzle_mm` and `error_um`, and their `track`."""

    @extras_told()
    def plot(self) -> Figure:
        """Draw the position of the largest error close up, and the contour error along the time."""
        from ffcomp.report.show import simulation_figure

        return simulation_figure(self)

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame with a row for each sample; needs pandas."""
        import pandas as pd

        columns: dict[str, FloatArray] = {"time_s": self.time_s}
        for name, points in (("reference", self.reference_mm), ("nozzle", self.nozzle_mm)):
            columns |= {f"{name}_{axis}_mm": points[:, k] for k, axis in enumerate("xyz")}
        return pd.DataFrame({**columns, "error_um": self.error_um})


def read_simulation(request: SimulateRequest) -> tuple[Command, Machine, Machine, list[str]]:
    """Read what is to be simulated: the command, the machine that made it, the printer that moves, and warnings."""
    machine = load_machine(request.machine)
    plant = load_machine(request.plant) if request.plant else machine
    command, warnings = read_command(request.file, machine, request.offset_mm, request.flavor, request.plate)
    return command, machine, plant, warnings


def run_simulation(request: SimulateRequest, command: Command, machine: Machine, plant: Machine) -> Simulation:
    """Simulate a command, and record it where that is requested."""
    part = Part(request.rate_hz, request.from_s, request.to_s, request.gravity, request.signals)
    target = None if request.recording is None else Path(request.recording)
    result = simulate_command(
        command, machine, plant, part, path=str(request.file), target=target, progress=request.progress
    )
    return Simulation(**{name: getattr(result, name) for name in SimulationResult.__dataclass_fields__})


def _simulate(request: SimulateRequest) -> Simulation:
    """Simulate a print or step timings on the nonlinear printer.

    Parameters
    ----------
    progress : Called with the print seconds done so far.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo, RequestError
    """
    command, machine, plant, _ = read_simulation(request)
    return run_simulation(request, command, machine, plant)


simulate = function(SimulateRequest, _simulate)


@dataclass(frozen=True, eq=False)
class PrintTime:
    """Times of a print, as it is written and, of a compensated one, as it was."""

    estimate: estimation.Estimate

    @property
    def time_s(self) -> float:
        """Print time in s, without heating, homing and macros."""
        return self.estimate.time_s

    @property
    def statistics(self) -> Statistics:
        """Times by layer, feature and activity."""
        return self.estimate.statistics

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-estimate/1."""
        return self.estimate.to_dict()

    @extras_told()
    def plot(self) -> Figure:
        """Draw the time by layer and by feature."""
        from ffcomp.report.estimate import estimate_figure

        return estimate_figure(self.estimate)


def _estimate(request: EstimateRequest) -> PrintTime:
    """Estimate how long a print takes.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo
    """
    with opened(Path(request.file)) as container:
        source, machine = next(iter(container.prints.values())), load_machine(request.machine)
        options: dict[str, Any] = {"flavor": request.flavor, "offset": request.offset_mm}
        return PrintTime(estimation.estimate(source, str(request.file), machine, **options))


estimate = function(EstimateRequest, _estimate)


@dataclass(frozen=True, eq=False)
class MethodComparison:
    """Every method on one print."""

    comparison: Comparison

    @property
    def tracks(self) -> dict[str, Track]:
        """Errors by method."""
        return {name: method.track for name, method in self.comparison.methods.items()}

    @property
    def verdict(self) -> list[str]:
        """The answer in sentences."""
        from ffcomp.report.compare.sentences import verdict

        return list(verdict(self.comparison))

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-compare/1."""
        return self.comparison.to_dict()

    @extras_told()
    def plot(self, name: Literal["close-up", "methods"] | str = "methods") -> Figure:
        """Draw one figure of the report.

        Raises
        ------
        RequestError
            If the report has no figure of that name.
        """
        from ffcomp.report.compare.figures import comparison_figures

        figures = comparison_figures(self.comparison)
        if name not in figures:
            raise RequestError(f"There is no figure {name!r}, but {', '.join(figures)}.")
        return figures[name]()

    @extras_told()
    def write_report(self, path: str | Path) -> None:
        """Write one HTML page that opens offline."""
        from ffcomp.report.compare.html import write_report

        write_report(self.comparison, Path(path))


def evaluate_print(
    request: CompareRequest,
    evaluate: Callable[..., T],
    options: Any,
    note: Callable[[str], None] = lambda sentence: None,
) -> T:
    """Let an engine of `ffcomp/comparison` evaluate the print of a request.

    Parameters
    ----------
    request : CompareRequest
    evaluate, options : the engine and its own request
    note : called with a sentence on what is compared, where that is not the file itself
    """
    machine = load_machine(request.machine)
    plant = load_machine(request.plant) if request.plant else None
    data, offset = read_bytes(Path(request.file), request.plate), request.offset_mm
    if already_processed(data) is not None:
        note(f"{request.file} is compensated already: what is compared is the original that it holds.")
        offset = offset if any(offset) else find_offset(data[:STAMP_REACH])
        data = original(data)
    return evaluate(
        data,
        str(request.file),
        machine,
        plant,
        options,
        settings=settings_for(machine, request.max_segments_per_second),
        offset=offset,
        flavor=request.flavor,
        progress=request.progress,
    )


def comparison_options(request: CompareRequest) -> engine.Request:
    """Return the engine's options; RequestError: there is no such method."""
    seeds = request.seeds if request.mismatch else 0
    sampling = Sampling(*request.layers, request.sample)
    options = engine.Request(sampling, request.mismatch, seeds, request.quality_um, request.only)
    try:
        engine.names(options)
    except ValueError as error:
        raise RequestError(f"--only {','.join(request.only)}: {error}") from None
    return options


def _compare(request: CompareRequest) -> MethodComparison:
    """Compare ffcomp with every input shaper on a print.

    Parameters
    ----------
    progress : Called with the current step and the share of it that is done.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo, RequestError
    """
    options = comparison_options(request)
    with workers(request.jobs, request.scheduler) as at_once:
        return MethodComparison(evaluate_print(request, partial(engine.compare, jobs=at_once), options))


compare = function(CompareRequest, _compare)
