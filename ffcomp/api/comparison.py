"""Compare all methods on a print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ffcomp.api.machines import load_machine
from ffcomp.comparison import engine, sentences
from ffcomp.comparison.request import CompareRequest
from ffcomp.comparison.result import Comparison
from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.compensation.batch import workers
from ffcomp.compensation.placement import place_print
from ffcomp.errors import RequestError, missing_extras_explained
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import Track
from ffcomp.numerics.serialise import ALL_OF
from ffcomp.request import function
from ffcomp.result import Fact, Result
from ffcomp.simulation.playback import check_same_kinematics
from gcode.container import read_bytes
from gcode.embedded import STAMP_REACH, already_processed, find_offset, original

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class MethodComparison(Result):
    """Every method on one print."""

    schema = "ffcomp-compare/1"
    page_by = "ffcomp.report.compare:page_of"
    json_keys: ClassVar = {ALL_OF: "comparison"}

    comparison: Comparison
    notes: Sequence[str] = ()  # sentences on the compared print, if it is not the file itself

    @property
    def tracks(self) -> dict[str, Track]:
        """Errors by method."""
        return {name: method.track for name, method in self.comparison.methods.items()}

    @property
    def headline(self) -> str:
        """Whether it is worth it, and why."""
        return sentences.answer_of(self.comparison).headline

    @property
    def facts(self) -> list[Fact]:
        """The findings, and each method's errors."""
        return list(sentences.answer_of(self.comparison).facts)

    @property
    def warnings(self) -> list[str]:
        """Whether another file is compared, and the limits of the result."""
        return [*self.notes, *sentences.answer_of(self.comparison).warnings]

    @property
    def next_steps(self) -> Sequence[str]:
        """A measurement, where the machine file is not known well enough."""
        return sentences.answer_of(self.comparison).next_steps

    def figures(self) -> list[str]:
        """Return the names of the figures that `plot` draws; it needs Matplotlib."""
        from ffcomp.report.compare import drawings

        return [each.name for each in drawings(self.comparison)]

    @missing_extras_explained()
    def plot(self, name: str = "methods", **options: Any) -> Figure:
        """Draw one of the figures; RequestError if there is none of that name."""
        from ffcomp.report.compare import figure

        return figure(self.comparison, name or "methods")


def compare_print(request: CompareRequest) -> MethodComparison:
    """Compare every method on the print of a request."""
    options, notes = _options(request), list[str]()
    machine = load_machine(request.machine)
    plant = load_machine(request.plant) if request.plant else None
    data, offset = read_bytes(Path(request.file), request.plate), request.offset_mm
    if already_processed(data) is not None:
        notes.append(f"{request.file} is already compensated: the comparison uses the original that it contains.")
        offset = find_offset(data[:STAMP_REACH]) if offset is None else offset
        data = original(data)
    if offset is None:
        placed = place_print(data, str(request.file), machine, request.flavor)
        offset = placed.offset
        if placed.notable:
            notes.append(placed.reason)
    if plant is not None:
        check_same_kinematics(machine, plant)
    printed = Print(data, str(request.file), machine, offset, request.flavor)
    settings = settings_for(machine, request.max_segments_per_second)
    with workers(request.jobs, request.scheduler) as at_once:
        done = engine.compare(printed, plant, options, settings=settings, jobs=at_once, progress=request.progress)
    return MethodComparison(done, notes=notes)


def _options(request: CompareRequest) -> engine.Request:
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

    Examples
    --------
    >>> ffcomp.compare("print.gcode", "mp-delta-pro", only=["mzv"]).headline
    """
    return compare_print(request)


compare = function(CompareRequest, _compare)
