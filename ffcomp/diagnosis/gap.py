"""The verb `gap`: how much recordings and simulation disagree, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, cast

from ffcomp.diagnosis.noise import NoiseFloor, at_least, noise_floor, whitener
from ffcomp.diagnosis.problem import Problem, Repeats
from ffcomp.diagnosis.problems import Recorded, check_alike, plant_of, problem_of, recordings_of
from ffcomp.diagnosis.request import GapRequest
from ffcomp.diagnosis.where import ResidualBreakdown, locate_residual
from ffcomp.errors import RequestError
from ffcomp.numerics.serialise import keys
from ffcomp.record.axes import turn_of
from ffcomp.result import Fact, Result
from models.machine import Machine


@dataclass(frozen=True, eq=False, repr=False)
class Discrepancy(Result):
    """The model discrepancy of a machine file on some recordings."""

    title = "Simulation against measurement"
    schema = "ffcomp-gap/1"
    page_by = "ffcomp.report.diagnose:gap_page"
    json_keys: ClassVar = keys("compared", "notes", noise_from_repeats="floor.from_repeats") | keys(
        nrms="residual.total.nrms", noise_nrms="residual.total.noise_nrms", where="residual"
    )

    residual: ResidualBreakdown
    floor: NoiseFloor
    notes: tuple[str, ...] = ()  # faults of the repeats, in full sentences
    compared: str = "signals"  # or "forces": the drive's, and those that the measured motion needs

    @property
    def headline(self) -> str:
        """How large the disagreement is, and what noise alone would leave."""
        total, noise = self.residual.total, "; that is noise" if self.is_noise else ""
        compared = "the drive's forces" if self.compared == "forces" else "the signals"
        return (
            f"Simulation and measurement differ by {100 * total.nrms:.2f} % of {compared}; noise alone would leave "
            f"{100 * total.noise_nrms:.2f} % (known from {self.floor.origin}){noise}."
        )

    @property
    def is_noise(self) -> bool:
        """Whether there is nothing else."""
        return self.residual.total.over_noise < 1.1 and not self.notes

    @property
    def facts(self) -> list[Fact]:
        """The disagreement by signal and run, and where most of it is."""
        sizes = [*self.residual.signals.items(), *self.residual.recordings.items()]
        facts = [(name, f"{100 * e.nrms:.2f} %, {e.over_noise:.1f} times the noise") for name, e in sizes]
        return facts if self.is_noise else [*facts, *self.residual.facts]

    @property
    def warnings(self) -> Sequence[str]:
        """The faults of the repeats."""
        return self.notes


def gap_request(request: GapRequest) -> Discrepancy:
    """Measure where and how much recordings and simulation disagree.

    Raises
    ------
    MeasurementError, MachineFileError

    Examples
    --------
    >>> ffcomp.gap(["run-1.csv", "run-2.csv"], "mp-delta-pro").headline
    """
    plant = plant_of(request.machine)
    given = cast("tuple[object, ...]", request.recordings)
    recordings = [each for each in given if isinstance(each, Recorded)]
    files = [each for each in given if isinstance(each, Path)]
    if len(recordings) + len(files) < len(given):
        raise RequestError("recordings: each must be the path of a file, or a recording that has been read.")
    if files:
        recordings += recordings_of(plant, files, request.plan, turn_of(request.axes_map), request.progress)
    return measure_gap(plant, recordings)


def measure_gap(machine: Machine, recordings: Sequence[Recorded]) -> Discrepancy:
    """Simulate the recordings with the machine and its effects, and compare; MeasurementError if they cannot be its."""
    problem = problem_of(machine, recordings, ())
    check_alike(recordings)
    return gap_of(problem.compared())


def gap_of(problem: Problem) -> Discrepancy:
    """Compare a problem's observations with its simulation by the machine file."""
    simulated = problem.simulate({})
    floor = noise_floor(problem, simulated)
    if problem.forces:  # one that a command repeats shows nothing of the noise of the motion
        floor = at_least(floor, problem.observations, problem.band_hz, problem.least_density)
    whiten = whitener(problem.observations, floor, problem.band_hz)
    residual = locate_residual(problem, whiten, floor, simulated)
    return Discrepancy(residual, floor, tuple(_notes(problem.repeats)), "forces" if problem.forces else "signals")


def _notes(repeats: Sequence[Repeats]) -> list[str]:
    late = [f"{each.late()}; they were aligned before they were compared." for each in repeats if each.apart]
    return [*late, *(each.trouble() for each in repeats if each.differ)]
