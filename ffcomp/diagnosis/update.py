"""`identify update`: a machine file's numbers updated by recordings of prints, by Bayes' rule.

    prior        the file's numbers θ₀ with its `[uncertainty]`, widened by the drift between prints
    posterior    minimise |r(θ)|² + |z|², z = (θ − θ₀)/σ₀, by Gauss-Newton on the output error; r is whitened
    noise        raised to the residual's spectrum: no model has the machine's shape (Birge, Phys. Rev. 40, 1932)
    intervals    at least as wide as the scatter of blocks of 5 Hz, and of motions left out in turn
    innovation   zᵀ(I − C)⁻¹z, C the posterior covariance: χ² in the directions that the recordings determine
    held out     each layer is left out in turn; the numbers of the others must not simulate it worse than the file does

Between prints numbers drift: a random walk, so that what was learnt long ago counts less and less.

Motion determines combinations of numbers better than each by itself, and `[uncertainty]` cannot state that. So the file
states how well each number is known with the others given: of all independent standard deviations these are nearest to
the posterior (mean field: MacKay, Information Theory, Inference, and Learning Algorithms, 2003, 33), and they give the
modes their right uncertainty. The history keeps how well each is known by itself, as the next prior.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ffcomp.check.history import read_lines
from ffcomp.diagnosis.candidates import IN_FILE
from ffcomp.diagnosis.fit import EstimationProblem, Fit, deviations, estimation_problem, fit
from ffcomp.diagnosis.held_out import groups, hold_out
from ffcomp.diagnosis.noise import at_least, noise_floor, noise_share, raised_to_residual, whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Parameter, stem_of
from ffcomp.diagnosis.recording_clocks import belongs_to_recording
from ffcomp.errors import MeasurementError, NothingToDo, RequestError
from ffcomp.identification.machine_fit import hash_of, number_facts
from ffcomp.identification.page.fit import SCALE
from ffcomp.identification.request import UpdateRequest
from ffcomp.identification.uncertainty import Estimate, normal
from ffcomp.measurement.recording import Recording
from ffcomp.numerics.serialise import json_object, keys
from ffcomp.numerics.stages import Progress, Stage
from ffcomp.record.axes import turn_of
from ffcomp.record.join import load_recordings
from ffcomp.result import Fact, Result
from gcode.atomic_write import replace_atomically, replacing
from models.file import check_text, load_machine, updated_text
from models.finding import LIBRARY
from models.machine import Machine

SCHEMA = "ffcomp-update/1"
USUAL_S = (6.0, 8.0, 2.0)  # of CPU: reading, the fit, layers left out
HORIZON_S, MOST_LAYERS = 10.0, 12  # of each recording, and of a print, that are fitted
DAMPING_TIMES = 3.0  # as uncertain, and as quick to drift, as stiffness: damping is not known better
ITERATIONS = 30  # of a fit; from frequencies that are off by 13 % it takes more than 12
TOLD = 0.9  # of the prior's standard deviation: a number that stays wider keeps its value
FLOOR, DAMPING_FLOOR = 4e-3, 0.04  # relative standard deviations: towers that differ and friction, which no fit knows
UNLIKELY = 1e-4  # probability of an innovation that is refused
DETERMINED = 0.2  # 1 − C of a direction that the recordings determine
LEFT = 0.25  # of the signals' power: more that is left is another machine, or something is loose
CHANCE = 0.02  # of the squares of what is left of layers that were left out: no worse


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Updated(Result):
    """A machine file's numbers before and after some recordings."""

    schema = SCHEMA
    json_keys: ClassVar = keys("date", "data", "layers", prints="request.prints", drift="request.drift") | {
        **keys("numbers", "kept", machine="start"),
        "innovation.chi_squared": "innovation.0",
        "innovation.degrees_of_freedom": "innovation.1",
        "innovation.probability": "innovation.2",
        "held_out.before": "held_out.0",
        "held_out.after": "held_out.1",
        "held_out.noise": "held_out.2",
        **keys(output="request.output", written_sha256="written_sha256", history="request.history_file"),
    }

    request: UpdateRequest
    start: Machine
    numbers: Mapping[str, UpdatedNumber]  # that the recordings determine
    kept: Sequence[str]  # numbers that they do not determine
    innovation: tuple[float, int, float]  # χ², its degrees of freedom, the probability of more
    held_out: tuple[float, float, float]  # nrms of layers left out: with the starting file, updated; of noise alone
    layers: int
    data: Sequence[str]  # files with hashes
    date: str

    @property
    def headline(self) -> str:
        """How well layers that were left out are simulated, before and after."""
        before, after, noise = (100 * each for each in self.held_out)
        return (
            f"Updated by {self.layers} layers. With each left out in turn, the simulation's error is {after:.2g} % of "
            f"its motion; with the starting file {before:.2g} %, noise alone {noise:.2g} %."
        )

    @property
    def facts(self) -> list[Fact]:
        """Every parameter that moved, and the files."""
        after = {key: each.after for key, each in self.numbers.items()}
        files = ("Machine file", str(self.request.output)), ("History", str(self.request.history_file))
        return [*number_facts(after), *files]

    @property
    def warnings(self) -> list[str]:
        """Parameters that the recordings do not determine."""
        return [f"The recordings do not determine {', '.join(self.kept)}: unchanged."] if self.kept else []

    def file_text(self) -> str:
        """Return the text of the machine file: numbers, how well they are known, and where that is from."""
        machine, uncertainty = self.start, dict[str, float]()
        for key, each in self.numbers.items():
            uncertainty[stem_of(key)] = max(uncertainty.get(stem_of(key), 0.0), float(f"{each.given_others:.2g}"))
        if SCALE in machine.vibration.tunable:  # of all masses, stiffnesses, dampings: motion determines their ratios
            uncertainty[SCALE] = FLOOR
        entry = {
            "date": self.date,
            "data": list(self.data),
            "numbers": sorted(uncertainty),
            "held_out_nrms_before_after": [float(f"{x:.4g}") for x in self.held_out[:2]],
        }
        values = {key: float(f"{each.after.value:.6g}") for key, each in self.numbers.items()}
        source = Path(machine.path)
        name = self.request.output.stem if source.resolve().parent == LIBRARY.resolve() else None
        return updated_text(source, values, name=name, uncertainty=uncertainty, provenance={"updated": entry})

    @property
    def written_sha256(self) -> str:
        """Of the machine file."""
        return hashlib.sha256(self.file_text().encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class UpdatedNumber:
    """A number before and after."""

    before: Estimate  # the prior, drift included
    after: Estimate
    given_others: float  # relative standard deviation, the other numbers being given


def update_files(request: UpdateRequest, progress: Progress = lambda _: None) -> Updated:
    """Update a machine file's numbers by recordings; write the file and a line of its history, or nothing.

    Raises RequestError, MeasurementError or MachineFileError; NothingToDo if the file is as good as what the
    recordings say.
    """
    machine = load_machine(request.machine)
    data = [hash_of(path) for path in request.data]
    _check(request, machine, data)
    progress(Stage(1, "reading the recordings"))
    turn = turn_of(request.axes_map)
    recordings = load_recordings(request.data, machine, request.plan, turn, progress)
    updated = update(machine, recordings, request, data, progress)
    text = updated.file_text()
    check_text(text, str(request.output))
    line = json.dumps({"schema": updated.schema, **json_object(updated)}, ensure_ascii=False)
    earlier = request.history_file.read_bytes() if request.history_file.exists() else b""
    with replacing(request.output) as file:  # which is there when the history is, or neither
        file.write(text.encode())
        replace_atomically(request.history_file, [earlier, line.encode(), b"\n"])
    return updated


def _check(request: UpdateRequest, machine: Machine, data: Sequence[str]) -> None:
    """Refuse to overwrite another file, and to count recordings twice."""
    path = request.output
    if path.exists() and not (request.force or path.samefile(machine.path)):
        raise RequestError(f"{path} exists already; give another --output, or --force.")
    if path.exists() and path.resolve().parent == LIBRARY.resolve():
        raise RequestError(f"{path} is of the library; give a file of your own, with --output.")
    for each in read_history(request.history_file):
        if again := set(data) & set(each["data"]):
            raise MeasurementError(
                sorted(again)[0].partition(" sha256:")[0],
                [f"The file was updated by it on {each['date']} already. A recording counts once: give new ones."],
            )


def read_history(path: Path) -> list[dict[str, Any]]:
    """Read all updates, the oldest first; none where there is no file."""

    def checked(entry: dict[str, Any]) -> dict[str, Any]:
        _ = set(entry["data"]), entry["date"], entry["written_sha256"], _deviations(entry)
        return entry

    return read_lines(path, SCHEMA, "update", checked)


def _deviations(entry: Mapping[str, Any]) -> dict[str, float]:
    """Return how uncertain each number was after an update."""
    return {name: float(each["after"]["sd"]) for name, each in entry["numbers"].items()}


# ---- Bayes' rule ---------------------------------------------------------------------------------


def update(
    machine: Machine,
    recordings: Sequence[Recording],
    request: UpdateRequest,
    data: Sequence[str] = (),
    progress: Progress = lambda _: None,
) -> Updated:
    """Update a machine's numbers by recordings; nothing is written. See `update_files`."""
    problem = update_problem(machine, recordings, request)
    if not groups(problem):
        raise MeasurementError(
            ", ".join(Path(each.source).name for each in recordings),
            ["There is one layer only, so that nothing is left to test the numbers on: give captures of two or more."],
        )
    progress(Stage(2, f"fitting {len(problem.parameters)} numbers to {len(recordings)} layers"))
    floor = at_least(noise_floor(problem), problem.observations, problem.band_hz, problem.least_density)
    estimation = estimation_problem(problem, whitener(problem.observations, floor, problem.band_hz))
    share = noise_share(estimation.whiten, estimation.measured)
    fitted = fit(estimation, problem.parameters, np.zeros(len(problem.parameters)), iterations=ITERATIONS)
    simulated = problem.simulate(fitted.values)
    errors = [o.measured - y for o, y in zip(problem.observations, simulated, strict=True)]
    raised = raised_to_residual(floor, problem.observations, errors)
    estimation = estimation_problem(problem, whitener(problem.observations, raised, problem.band_hz))
    fitted = fit(estimation, problem.parameters, fitted.z, iterations=ITERATIONS)
    progress(Stage(3, "leaving out one layer after the other"))
    held_out = (*_held_out(estimation, fitted), share)
    of_machine = [i for i, n in enumerate(fitted.parameters) if not belongs_to_recording(n.name)]
    innovation = _innovation(fitted, of_machine)
    _refuse(request, machine, held_out, innovation)
    numbers = _posterior(estimation, fitted, of_machine)
    if not numbers:
        raise NothingToDo("The recordings add nothing to the file: nothing is written.")
    return Updated(
        request=request,
        start=machine,
        numbers=numbers,
        kept=[name for i in of_machine if (name := fitted.parameters[i].name) not in numbers],
        innovation=innovation,
        held_out=held_out,
        layers=len(problem.observations),
        data=data,
        date=date.today().isoformat(),
    )


def update_problem(machine: Machine, recordings: Sequence[Recording], request: UpdateRequest) -> PrinterProblem:
    """Return the problem of the machine whose numbers are as uncertain as before these prints."""
    chosen = np.unique(np.linspace(0, len(recordings) - 1, MOST_LAYERS).round().astype(int))
    problem = PrinterProblem(machine, [recordings[i] for i in chosen], ()).begun(HORIZON_S)
    last = next((e for e in read_history(request.history_file)[::-1] if e["written_sha256"] == machine.sha256), None)
    known = {} if last is None else _deviations(last)
    skipped = {SCALE, *machine.vibration.guessed}
    problem.parameters = tuple(
        each if belongs_to_recording(each.name) else _prior(each, machine, known, request)
        for each in problem.parameters
        if each.name not in skipped and not each.name.startswith(IN_FILE)
    )
    return problem


def _prior(n: Parameter, machine: Machine, known: Mapping[str, float], request: UpdateRequest) -> Parameter:
    """Return the prior of a number before these prints: from the history or the file, widened by its drift."""
    times = DAMPING_TIMES if "damping" in n.name else 1.0
    assumed = times if stem_of(n.name) not in machine.uncertainty else 1.0
    sd = known.get(n.name, assumed * n.sd)
    sd = float(np.hypot(sd, times * request.drift * np.sqrt(request.prints) * abs(n.start)))
    return Parameter.near(n.name, n.start, sd)


def _held_out(estimation: EstimationProblem, fitted: Fit) -> tuple[float, float]:
    """Return nrms of the layers left out in turn: with the file, and with what the others say.

    Raises NothingToDo where the others' numbers are worse than the file's.
    """
    clocks = tuple(n for n in fitted.parameters if belongs_to_recording(n.name))
    filed = Fit((), np.zeros(0), estimation.residual({}), np.zeros((len(fitted.residual), 0)))
    if clocks:
        filed = fit(estimation, clocks, np.zeros(len(clocks)))
    each = hold_out(estimation, filed, fitted)
    rows = np.array([one.rows for one in each])
    squares = [float(rows @ np.array([getattr(one, key) + 1.0 for one in each])) for key in ("before", "after")]
    power = np.sum([one.power for one in each], axis=0)
    after = float(np.sqrt(power[1] / power[2]))
    before = after * float(np.sqrt(squares[0] / squares[1]))
    if squares[1] > (1.0 + CHANCE) * squares[0]:
        raise NothingToDo(
            f"Layers that were left out of the fit are simulated no better with the numbers of the others ({after:.1%} "
            f"of the motion is left) than with the starting file ({before:.1%}): nothing is written. Record more "
            "layers, or harder motion."
        )
    return before, after


def _posterior(estimation: EstimationProblem, fitted: Fit, of_machine: Sequence[int]) -> dict[str, UpdatedNumber]:
    """Return the numbers that the recordings determine, before and after."""
    parameters = [fitted.parameters[i] for i in of_machine]
    covariance = fitted.covariance(estimation.blocks)[np.ix_(of_machine, of_machine)]
    sd, wide = np.sqrt(np.diag(covariance)), deviations(estimation, fitted)[of_machine]
    told = sd < TOLD
    wider = float(np.median((wide / sd)[told])) if told.any() else 1.0
    alone = np.minimum(wide, 1.0)
    given = wider / np.sqrt(np.diag(np.linalg.inv(covariance)))
    floor = np.array([DAMPING_FLOOR if "damping" in n.name else FLOOR for n in parameters])
    numbers = {}
    for k in np.flatnonzero(told).tolist():
        n, value = parameters[k], fitted.values[parameters[k].name]
        numbers[n.name] = UpdatedNumber(
            before=normal(n.start, n.sd),
            after=normal(value, float(np.hypot(n.sd * alone[k], floor[k] * abs(value)))),
            given_others=float(np.hypot(n.sd * min(given[k], alone[k]) / abs(value), floor[k])),
        )
    return numbers


def _innovation(fitted: Fit, of_machine: Sequence[int]) -> tuple[float, int, float]:
    """Test how far the numbers moved: before the recordings, z has the covariance I − C where these determine it."""
    from scipy.stats import chi2

    covariance = fitted.overdispersion * np.linalg.inv(fitted.information)[np.ix_(of_machine, of_machine)]
    told, directions = np.linalg.eigh(np.eye(len(of_machine)) - covariance)
    moved = directions.T @ fitted.z[list(of_machine)]
    counted = told > DETERMINED
    statistic = float(np.sum(moved[counted] ** 2 / told[counted]))
    return statistic, int(counted.sum()), float(chi2.sf(statistic, max(int(counted.sum()), 1)))


def _refuse(
    request: UpdateRequest,
    machine: Machine,
    held_out: tuple[float, float, float],
    innovation: tuple[float, int, float],
) -> None:
    """Refuse recordings of another printer, or of one that has changed."""
    (_, after, noise), (statistic, freedom, probability) = held_out, innovation
    if after**2 - noise**2 > LEFT:
        reason = (
            f"With any numbers that the file allows, {after:.0%} of the motion is left: the printer is another, or "
            "something is loose or lacks in the file."
        )
    elif probability < UNLIKELY:
        reason = (
            f"Its numbers would have to move farther than its [uncertainty] and the drift allow (χ² {statistic:.0f} "
            f"of {freedom}): something has changed, or the file is of another printer."
        )
    else:
        return
    plan = "" if request.plan is None else f" --plan {request.plan}"
    remedy = f"Nothing is written. See what the file lacks: ffcomp diagnose RUNS{plan} -m {request.machine}"
    raise MeasurementError(machine.name, [f"{reason} {remedy}"])
