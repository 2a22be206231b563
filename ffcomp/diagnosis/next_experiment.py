"""The next experiment: the recording that best separates the best explanation from its rivals.

Every explanation is played on the virtual printer: each kind of move of `ffcomp record plan` at the bed's centre, then
the best kind at the plan's other places, higher, and with a quarter of the acceleration. Two explanations differ by d,
the whitened difference of the simulated sensor signals. The best one may be retuned by δ as far as the given runs
allow, whose information about its parameters is H (a Gaussian posterior); with J the derivative of the new recording,
the difference that remains is

    min over δ of |d − Jδ|² + δᵀHδ = |d|² − (Jᵀd)ᵀ (H + JᵀJ)⁻¹ Jᵀd

and its root over the number of rows is promised, in units of the noise. All recordings last equally long.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import ClassVar

import numpy as np

from ffcomp.diagnosis.diagnosis import Outcome
from ffcomp.diagnosis.fit import EstimationProblem, Fit, derivatives, estimation_problem
from ffcomp.diagnosis.noise import whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.score_test import Screened, confounded_with, separated_by
from ffcomp.diagnosis.words import digits, joined
from ffcomp.errors import FfcompError
from ffcomp.numerics.serialise import keys
from ffcomp.record.gcode_writer import Recorder, gcode_lines
from ffcomp.record.moves import KINDS, Request, default_places, make_plan
from ffcomp.record.plan import Plan
from ffcomp.record.result import measured_run
from gcode.dialect import KLIPPER
from models.arrays import FloatArray
from models.finding import machine_paths
from models.machine import Machine

BEFORE_S, AFTER_S = 0.12, 0.3  # of rest in the recording: the printer rings for 0.2 s
OUTPUT, SECONDS = "separate.gcode", 2.5
SEPARATES_RMS = 0.3  # of the noise, between predictions: separates them in 1000 rows
INFEASIBLE = 1e11  # square of an entry: the residual of an infeasible printer is a million in every entry


@dataclass(frozen=True)
class Separation:
    """Two explanations that fit as well, and the recording where their predictions differ most.

    Differences are the rms, in units of the noise, over the band of the diagnosis. `there` excludes what retuning the
    best explanation, as far as the given runs allow, would make up for.
    """

    json_keys: ClassVar = keys("other", "kind", "position_mm") | keys(
        effects="ours",
        difference_now="now",
        difference_there="there",
        separates="tells",
        record="command",
        said="sentence",
    )

    ours: tuple[str, ...]  # the effects of the best explanation
    other: tuple[str, ...]
    now: float  # the difference in the given runs
    there: float  # the difference in the recording that is proposed
    kind: str  # of `ffcomp record plan`
    position_mm: tuple[float, ...]
    command: str  # that plans the recording
    gcode: str  # that the command writes

    @property
    def tells(self) -> bool:
        """Tell whether the recording separates them."""
        return self.there > max(SEPARATES_RMS, 2.0 * self.now)

    @property
    def sentence(self) -> str:
        """Say what to record, and what it promises; or that no move does."""
        ours = [name for name in self.ours if name not in self.other]
        theirs = [name for name in self.other if name not in self.ours]
        if ours and theirs:
            question = f"separate {joined(ours)} from {joined(theirs)}"
        else:
            question = f"show whether {joined(ours or theirs)} acts as well"
        now, there = digits(self.now, 2), digits(self.there, 2)
        if not self.tells:
            return (
                f"No move of ffcomp record plan can {question}: it shows at most {there} times the noise, beyond what "
                f"retuning makes up for. {separated_by(self.ours, self.other)}".rstrip()
            )
        return (
            f"Record {self.command} and give its captures along with these runs, to {question}: there the predictions "
            f"differ by {there} times the noise; in these runs by {now}."
        )


Rivals = Mapping[tuple[str, ...], Mapping[str, float]]  # explanations to be separated from the best: effects, values


@dataclass(frozen=True, eq=False)
class _Trial:
    """A recording, and by how much each rival differs there."""

    request: Request
    plan: Plan
    differences: Sequence[float]


def separations(problem: PrinterProblem, diagnosis: Outcome) -> list[Separation]:
    """Return the recording that best separates each rival, which fits as well, from the best explanation."""
    rivals = dict(islice(rivals_of(diagnosis).items(), 2))
    if diagnosis.best is None or not rivals:
        return []
    ours, best = diagnosis.best.names, diagnosis.best.fit
    now = _differences(replace(diagnosis.estimation, coarse=True), best, rivals, None)
    trials = _trials(problem, diagnosis, best, rivals)
    found, machine = [], problem.machine
    for i, other in enumerate(rivals if trials else []):
        trial = max(trials, key=lambda each, i=i: each.differences[i])  # type: ignore[misc]
        (experiment,), recorder = trial.plan.experiments, Recorder(machine.flavor or KLIPPER)
        found.append(
            Separation(
                ours=ours,
                other=other,
                now=now[i],
                there=trial.differences[i],
                kind=experiment.kind,
                position_mm=experiment.position_mm,
                command=command_of(machine, trial.request),
                gcode=b"".join(gcode_lines(trial.plan, machine, recorder)).decode(),
            )
        )
    return found


# ---- the rivals ----------------------------------------------------------------------------------


def rivals_of(diagnosis: Outcome) -> Rivals:
    """Return what fits as well as the best explanation, where that explains most of the discrepancy.

    Other effects that were fitted and are as likely; then the same with one more, where that is likelier but removes
    too little to be named; then effects of a like signature that were never fitted.
    """
    best = diagnosis.best
    if best is None or best.discrepancy > diagnosis.estimation.settings.left * diagnosis.base.discrepancy:
        return {}
    ours, limit = {*best.names}, -diagnosis.estimation.settings.significant
    larger = [h for h in diagnosis.tried if ours < {*h.names} and len(h.names) == len(ours) + 1]
    likelier = sorted((h for h in larger if diagnosis.behind(h) < limit), key=diagnosis.behind)[:1]
    fitted = [h for h in diagnosis.competing if h.names != best.names] + likelier
    rivals = {h.names: h.fit.values for h in fitted}
    alike = [name for name, _ in confounded_with(best.names, diagnosis.screened)]
    known = {name for h in diagnosis.tried for name in h.names}
    like = [s for s in diagnosis.screened if s.candidate.name in {*alike} - known and len(best.effects) == 1]
    return rivals | {(s.candidate.name,): _with(diagnosis, s) for s in like}


def _with(diagnosis: Outcome, screened: Screened) -> dict[str, float]:
    """Return the base fit's values with an effect, as large as it was estimated."""
    amplitudes = {
        a.name: float(np.clip(a.start + a.sd * x, a.low, a.high))
        for a, x in zip(screened.candidate.amplitudes, screened.estimate, strict=True)
    }
    return {**diagnosis.base.values, **screened.shape, **amplitudes}


# ---- the recordings that may be made -------------------------------------------------------------


def _trials(problem: PrinterProblem, diagnosis: Outcome, best: Fit, rivals: Rivals) -> list[_Trial]:
    """Try every kind at the centre, then the best kind at other places, higher, and softer."""
    machine, signals, rate = problem.machine, problem.observations[0].signals, problem.observations[0].rate_hz
    known = best.information / best.overdispersion

    def played(requests: Iterable[Request]) -> Iterator[_Trial]:
        """Play recordings on every explanation; those that the machine cannot make are left out."""
        for request in requests:
            try:
                plan = make_plan(machine, request)
            except FfcompError:
                continue
            (one,) = plan.experiments
            times = np.arange(0.0, one.duration_s + BEFORE_S + AFTER_S, 1 / rate) - BEFORE_S
            blank = measured_run(one.name, one.motion, times, dict.fromkeys(signals, np.zeros(len(times))), {})
            virtual = PrinterProblem(machine, [blank], ())
            whiten = whitener(virtual.observations, diagnosis.noise, virtual.band_hz)
            there = replace(estimation_problem(virtual, whiten, diagnosis.estimation.settings), coarse=True)
            yield _Trial(request, plan, _differences(there, best, rivals, known))

    centre, *others = default_places(machine)
    usual = Request(places_mm=[centre], seconds=SECONDS)
    trials = [*played(replace(usual, kinds=(kind,)) for kind in KINDS)]
    if not trials:
        return []
    top = max(trials, key=lambda trial: min(trial.differences)).request
    more = [replace(top, places_mm=[place]) for place in others]
    more.append(replace(top, height_mm=round(0.5 * machine.kinematics.height_mm)))
    more.append(replace(top, acceleration_mm_per_s2=round(0.25 * machine.limits.acceleration_mm_per_s2)))
    return [*trials, *played(more)]


def _differences(
    estimation: EstimationProblem, best: Fit, rivals: Rivals, information: FloatArray | None
) -> list[float]:
    """Return the rms difference of each rival's prediction from the best one's; zero where it has none.

    information : (p, p) that the given runs have of the best one's parameters; None: it is not retuned
    """
    ours, *others = estimation.residuals([best.values, *rivals.values()])
    apart = [ours - other for other in others]
    squares = [float(d @ d) for d in apart]
    if information is not None:
        columns = derivatives(estimation, best.parameters, best.z, ours, range(len(best.z)))
        absorbed = np.linalg.inv(information + columns.T @ columns)
        slopes = [columns.T @ d for d in apart]
        squares = [max(s - float(g @ absorbed @ g), 0.0) for s, g in zip(squares, slopes, strict=True)]
    return [float(np.sqrt(s / len(ours))) if s < INFEASIBLE * len(ours) else 0.0 for s in squares]


def command_of(machine: Machine, request: Request) -> str:
    """Return the command line that plans this recording."""
    path, (x, y) = Path(machine.path), request.places_mm[0]
    named = path.stem if machine_paths().get(path.stem) == path else str(path)
    words = ["ffcomp", "record", "plan", "-m", named, "--kind", request.kinds[0], "--at", f"{x:g},{y:g}"]
    words += ["--height-mm", f"{request.height_mm:g}"] if request.height_mm != Request().height_mm else []
    hard = request.acceleration_mm_per_s2
    words += [] if hard is None else ["--amplitude-mm-per-s2", f"{hard:g}"]
    return shlex.join([*words, "--seconds", f"{request.seconds:g}", "-o", OUTPUT])
