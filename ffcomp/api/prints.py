"""Prints: compensate, simulate, estimate and compare them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ffcomp.api.machines import load_machine
from ffcomp.compare import engine
from ffcomp.compare.result import Comparison
from ffcomp.compare.sampling import Sampling
from ffcomp.compensate.batch import workers
from ffcomp.compensate.file import compensate_file
from ffcomp.compensate.job import Options
from ffcomp.errors import RequestError, extras_told
from ffcomp.estimate import engine as estimation
from ffcomp.estimate.statistics import Statistics
from ffcomp.inverse.robust import choose_robust
from ffcomp.inverse.settings import SEGMENTS_PER_SECOND, settings_for
from ffcomp.metrics import Track
from ffcomp.simulate.simulation import Request, SimulationResult, read_command, simulate_command
from gcode.container import opened, read_bytes
from gcode.embedded import STAMP_REACH, already_processed, find_offset, original
from models.arrays import FloatArray
from models.machine import Machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Offset = tuple[float, float]
Named = str | Path | Machine


@dataclass(frozen=True, eq=False)
class Compensation:
    """A compensated print and what it took.

    Attributes
    ----------
    machine : Machine
    output : Path or None
        The compensated file; None: nothing was written.
    """

    machine: Machine
    output: Path | None
    answer: dict[str, Any]  # ffcomp-compensate/1

    @property
    def print_time_s(self) -> float:
        """Print time of the compensated file in s."""
        return float(self.answer["print_time_s"])

    @property
    def original_print_time_s(self) -> float:
        """Print time of the original in s."""
        return float(self.answer["original_print_time_s"])

    @property
    def segments(self) -> int:
        """Number of segments written."""
        return int(self.answer["segments"])

    @property
    def warnings(self) -> list[str]:
        """Sentences about what was odd or had to be changed."""
        return list(self.answer["warnings"])

    @property
    def uncompensated(self) -> Track | None:
        """Predicted errors of the original; None: not predicted."""
        return self._track("uncompensated")

    @property
    def compensated(self) -> Track | None:
        """Predicted errors of the compensated print; None: not predicted."""
        return self._track("compensated")

    def _track(self, which: str) -> Track | None:
        predicted = self.answer.get("predicted") or {}
        return Track(**predicted[which]) if which in predicted else None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-compensate/1."""
        return dict(self.answer)

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
        from ffcomp.simulate.preview import preview

        if self.output is None:
            raise RequestError("Nothing was written, so there is nothing to draw: name an output.")
        data = read_bytes(self.output, None)
        stamp = already_processed(data)
        flavor = stamp.flavor if stamp else None
        seen = preview(data, str(self.output), self.machine, find_offset(data[:STAMP_REACH]), flavor)
        return show_figure(seen, f"{self.output.name} on {self.machine.name}", z_mm=z_mm)


def compensate(
    file: str | Path,
    machine: Named,
    output: str | Path | None = None,
    *,
    offset_mm: Offset | None = None,
    flavor: str = "",
    shaper_off: bool = False,
    robust: bool | None = None,
    s_curve: bool = False,
    strict: bool = False,
    tolerance_um: float = 25.0,
    max_segments_per_second: float = SEGMENTS_PER_SECOND,
    embed: bool = True,
    predict: bool = True,
    force: bool = False,
    jobs: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> Compensation:
    """Compensate a print for a printer's vibration.

    Parameters
    ----------
    file : sliced print: G-code, also in .gz, .gcode.3mf or .bgcode
    machine : a machine, its name or its file
    output : compensated file to write; None: write nothing. It may be `file` itself.
    offset_mm : shift added to every position; None: none where the print lies inside as it is, else one that brings it
        inside
    flavor : "klipper", "marlin" or "reprapfirmware"; "": what the machine file says, or else the file
    shaper_off : switch the firmware's input shaper off in the file
    robust : minimise the expected contour error over the machine file's uncertainties; None: where they make it pay
    s_curve : limit the jerk of the ramps
    strict : raise LimitsError where a limit would slow the print down
    tolerance_um : largest path error that an active limit may cause before the print is slowed down
    max_segments_per_second : highest segment rate
    embed : keep the original's moves in the file as comments
    predict : simulate the print before and after with the design model
    force : compensate a file that is compensated already
    jobs : number of processes
    progress : called with the share of the file that is done

    Raises
    ------
    GcodeError, MachineFileError, LimitsError, SolverError, NothingToDo
    """
    loaded, source = load_machine(machine), Path(file)
    settings = replace(
        settings_for(loaded, max_segments_per_second),
        s_curve=s_curve,
        strict=strict,
        tolerance_um=tolerance_um,
        embed=embed,
    )
    chosen = choose_robust(loaded, settings, robust)
    settings = replace(settings, robust=chosen.robust)
    options = Options(offset_mm, flavor, settings, predict, shaper_off, force, robust=chosen)
    target = None if output is None else Path(output)
    with workers(jobs) as at_once:
        answer = compensate_file(source, str(file), loaded, options, target, jobs=at_once, progress=progress)
    if "already" in answer:
        raise RequestError(f"{answer['already']} With force=True it is compensated again.")
    return Compensation(loaded, target, answer)


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


def simulate(
    file: str | Path,
    machine: Named,
    plant: Named | None = None,
    *,
    from_s: float = 0.0,
    to_s: float = inf,
    rate_hz: float = 1600.0,
    gravity: bool = True,
    offset_mm: Offset = (0.0, 0.0),
    flavor: str = "",
    recording: str | Path | None = None,
    progress: Callable[[float], None] = lambda done_s: None,
) -> Simulation:
    """Simulate a print or step timings on the nonlinear printer.

    Parameters
    ----------
    file : print (sliced or compensated) or step-timing archive
    machine : the machine that the command was computed with
    plant : the printer that moves, with its effects; None: `machine`
    from_s, to_s : part of the command's time
    rate_hz : sample rate
    gravity : let the weight deflect the belts and the extruder's mount
    offset_mm, flavor : as of `compensate`
    recording : file to write what its sensors would record; None: nothing
    progress : called with the print seconds done so far

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo
    """
    believed = load_machine(machine)
    true = believed if plant is None else load_machine(plant)
    command, _ = read_command(file, believed, offset_mm, flavor)
    request = Request(rate_hz, from_s, to_s, gravity)
    target = None if recording is None else Path(recording)
    found = simulate_command(command, believed, true, request, path=str(file), target=target, progress=progress)
    return Simulation(**{name: getattr(found, name) for name in SimulationResult.__dataclass_fields__})


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


def estimate(file: str | Path, machine: Named, *, offset_mm: Offset = (0.0, 0.0), flavor: str = "") -> PrintTime:
    """Estimate how long a print takes.

    Parameters
    ----------
    file : print, compensated or not; of a container with several prints the first
    machine : a machine, its name or its file
    offset_mm, flavor : as of `compensate`

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo
    """
    with opened(Path(file)) as container:
        source = next(iter(container.prints.values()))
        found = estimation.estimate(source, str(file), load_machine(machine), flavor=flavor, offset=offset_mm)
    return PrintTime(found)


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


def compare(
    file: str | Path,
    machine: Named,
    plant: Named | None = None,
    *,
    layers: tuple[int, int | None] = (0, None),
    sample: float | None = None,
    mismatch: float = 0.0,
    seeds: int = 20,
    quality_um: float = 25.0,
    only: Sequence[str] = (),
    offset_mm: Offset = (0.0, 0.0),
    flavor: str = "",
    jobs: int = 1,
    progress: Callable[[str, float], None] = lambda step, share: None,
) -> MethodComparison:
    """Compare ffcomp with every input shaper on a print.

    Parameters
    ----------
    file : sliced print; of a compensated one the original is compared
    machine : the machine file that every method uses
    plant : the printer that evaluates; None: `machine`, nonlinear
    layers : first and last layer, counted from 0; None: to the end
    sample : share of the time that is evaluated; None: 2 minutes at most
    mismatch : relative standard deviation of Monte-Carlo plants; 0: none
    seeds : number of Monte-Carlo plants
    quality_um : bound of the contour error for which the highest acceleration is sought; 0: skip
    only : methods beside none and ffcomp; none given: all
    offset_mm, flavor : as of `compensate`
    jobs : number of processes that share the Monte-Carlo plants
    progress : called with the current step and the share of it that is done

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo, ValueError
    """
    data, believed = read_bytes(Path(file), None), load_machine(machine)
    if already_processed(data) is not None:
        offset_mm = offset_mm if any(offset_mm) else find_offset(data[:STAMP_REACH])
        data = original(data)
    request = engine.Request(Sampling(*layers, sample), mismatch, seeds if mismatch else 0, quality_um, tuple(only))
    true = None if plant is None else load_machine(plant)
    options: dict[str, Any] = {"offset": offset_mm, "flavor": flavor, "progress": progress}
    with workers(jobs) as at_once:
        found = engine.compare(data, str(file), believed, true, request, jobs=at_once, **options)
    return MethodComparison(found)
