"""Which recording of `ffcomp record plan` tells explanations apart that fit the given runs equally.

Every explanation is played on the virtual printer: each kind of move at the bed's centre, then the best kind at the
plan's other places, higher, and with a quarter of the acceleration. Two explanations differ by d, the whitened
difference of what the sensors would say. The best one may be retuned by δ as far as the given runs allow, whose
information of its parameters is H (a Gaussian posterior); with J the derivative of the new recording, what remains is

    min over δ of |d − Jδ|² + δᵀHδ = |d|² − (Jᵀd)ᵀ (H + JᵀJ)⁻¹ Jᵀd

and its root over the number of rows is what is promised, in units of the noise.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.fit import EstimationProblem, Fit, derivatives, estimation_problem
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.next_experiment import blank_recording, linear_estimate
from ffcomp.diagnosis.noise import whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.score_test import confounded_with, separated_by
from ffcomp.diagnosis.words import digits, joined
from ffcomp.errors import FfcompError
from ffcomp.record.moves import KINDS, Request, default_places, make_plan
from ffcomp.record.plan import Experiment
from models.arrays import FloatArray
from models.finding import machine_paths
from models.machine import Machine


@dataclass(frozen=True)
class Separation:
    """Two explanations, and where their predicted recordings differ most.

    Differences are the rms, in units of the noise, over the band of the diagnosis. What retuning within what the given
    runs allow would make up for is left out of `there`.
    """

    ours: tuple[str, ...]  # the effects of the best explanation
    other: tuple[str, ...]
    now: float  # the difference in the given runs
    there: float  # the difference in the recording that is proposed
    kind: str  # of `ffcomp record plan`
    position_mm: tuple[float, ...]
    command: str  # that plans the recording; "": the given runs tell them apart already
    otherwise: str = ""  # how to tell them apart by other means

    @property
    def tells(self) -> bool:
        """Tell whether the recording separates them."""
        return not self.command or self.there > max(SEPARATES_RMS, 2.0 * self.now)

    def sentence(self) -> str:
        """Say what to record, and what it promises; or that no move does."""
        question = self._question()
        if not self.command:
            return (
                f"These runs {question} already, though the signatures are alike: the predictions, each at its best, "
                f"differ by {digits(self.now, 2)} times the noise."
            )
        if not self.tells:
            return (
                f"No move of ffcomp record plan can {question}: it shows {digits(self.there, 2)} times the noise at "
                f"most, beyond what retuning makes up for. {self.otherwise}".rstrip()
            )
        return (
            f"Record {self.command} and give its captures along with these runs, to {question}: there the predictions "
            f"differ by {digits(self.there, 2)} times the noise; in these runs by {digits(self.now, 2)}."
        )

    def _question(self) -> str:
        ours, theirs = _without(self.ours, self.other), _without(self.other, self.ours)
        if ours and theirs:
            return f"tell {joined(ours)} from {joined(theirs)}"
        return f"show whether {joined(ours or theirs)} acts as well"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON's entry of `separate`."""
        return {
            "effects": list(self.ours),  # list of text: the best explanation: names of its effects
            "other": list(self.other),  # list of text: another one that fits these runs as well
            "difference_now": self.now,  # number: rms by which their predictions differ in these runs, times the noise
            # number: the same in the recording that `record` plans, beyond what retuning makes up for
            "difference_there": self.there,
            "separates": self.tells,  # true or false: whether that is enough to tell them apart
            "kind": self.kind,  # of its moves
            "position_mm": list(self.position_mm),  # list of numbers: where
            # the command that plans it; empty where these runs tell them apart already, and so are `kind` and
            # `position_mm`
            "record": self.command,
            "said": self.sentence(),  # all of that in a sentence
        }


def _without(names: Sequence[str], others: Sequence[str]) -> list[str]:
    return [name for name in names if name not in others]


OUTPUT = "separate.gcode"
SEPARATES_RMS = 0.3  # of the noise, between predictions: tells them apart in 1000 rows

Values = Mapping[str, float]


@dataclass(frozen=True)
class Rival:
    """An explanation that cannot be told from the best one."""

    names: tuple[str, ...]
    values: Values
    beaten: bool = False  # it is alike to first order, but fits these runs less well


@dataclass(frozen=True, eq=False)
class _Trial:
    """A recording, and by how much each rival differs there."""

    request: Request
    position_mm: tuple[float, float, float]
    differences: tuple[float, ...]


def separations(problem: PrinterProblem, diagnosis: Diagnosis) -> list[Separation]:
    """Return, for each rival of the best explanation, the recording that separates it best."""
    everyone = rivals_of(diagnosis)
    rivals = [rival for rival in everyone if not rival.beaten][:2]
    beaten = [rival for rival in everyone if rival.beaten][:2]
    if diagnosis.best is None or not everyone:
        return []
    ours = diagnosis.best.names
    now = _differences(replace(diagnosis.estimation, coarse=True), diagnosis.best.fit, [*rivals, *beaten], None)
    settled = [
        Separation(ours, rival.names, here, here, "", (), "", separated_by(ours, rival.names))
        for rival, here in zip(beaten, now[len(rivals) :], strict=True)
    ]
    if not rivals:
        return settled
    trials = _tried(problem, diagnosis, rivals)
    best = [max(trials, key=lambda trial, i=i: trial.differences[i], default=None) for i in range(len(rivals))]  # type: ignore[misc]
    separable = [
        _separation(problem.machine, ours, rival, here, trial, trial.differences[i])
        for i, (rival, here, trial) in enumerate(zip(rivals, now[: len(rivals)], best, strict=True))
        if trial is not None
    ]
    return [*separable, *settled]


# ---- who is in question --------------------------------------------------------------------------


def rivals_of(diagnosis: Diagnosis) -> list[Rival]:
    """Return what fits as well as the best explanation, where that explains most of the discrepancy.

    Other effects that were fitted and are as likely; then the same with one more, where that is likelier but removes
    too little to be named; then effects of a like signature, whether they were never fitted or fit less well.
    """
    best = diagnosis.best
    if best is None or best.discrepancy > diagnosis.estimation.settings.left * diagnosis.base.discrepancy:
        return []
    fitted = [h for h in diagnosis.competing if h.names != best.names] + _likelier_with_one_more(diagnosis)
    rivals = [Rival(h.names, h.fit.values) for h in fitted]
    alike = [name for name, _ in confounded_with(best.names, diagnosis.screened)]
    named = {name for rival in rivals for name in rival.names}
    replacing = [h for h in diagnosis.tried if len(h.names) == len(best.names) and h.names != best.names]
    beaten = [next((h for h in replacing if name in h.names), None) for name in alike if name not in named]
    rivals += [Rival(h.names, h.fit.values, beaten=True) for h in beaten if h is not None]
    known = {name for h in diagnosis.tried for name in h.names}
    like = [s for s in diagnosis.screened if s.candidate.name in {*alike} - known and len(best.effects) == 1]
    return rivals + [Rival((s.candidate.name,), linear_estimate(diagnosis, s)) for s in like]


def _likelier_with_one_more(diagnosis: Diagnosis) -> list[Hypothesis]:
    assert diagnosis.best is not None
    ours, scale = set(diagnosis.best.names), diagnosis.best.fit.overdispersion
    larger = [h for h in diagnosis.tried if ours < set(h.names) and len(h.names) == len(ours) + 1]
    likelier = [h for h in larger if diagnosis.behind(h) / scale < -diagnosis.estimation.settings.significant]
    return sorted(likelier, key=diagnosis.behind)[:1]


# ---- where they differ ---------------------------------------------------------------------------


def _tried(problem: PrinterProblem, diagnosis: Diagnosis, rivals: Sequence[Rival]) -> list[_Trial]:
    """Try every kind at the centre, then the best kind at other places, higher, and softer."""
    machine = problem.machine
    centre, *others = default_places(machine)
    usual = Request(places_mm=[centre], seconds=2.5)
    trials = [*_played(problem, diagnosis, rivals, [replace(usual, kinds=(kind,)) for kind in KINDS])]
    if not trials:
        return []
    best = max(trials, key=lambda trial: min(trial.differences)).request
    more = [replace(best, places_mm=[place]) for place in others]
    more.append(replace(best, height_mm=round(0.5 * machine.kinematics.height_mm)))
    more.append(replace(best, acceleration_mm_per_s2=round(0.25 * machine.limits.acceleration_mm_per_s2)))
    return [*trials, *_played(problem, diagnosis, rivals, more)]


def _played(
    problem: PrinterProblem, diagnosis: Diagnosis, rivals: Sequence[Rival], requests: Sequence[Request]
) -> Iterator[_Trial]:
    """Play recordings on every explanation; those that the machine cannot make are left out."""
    assert diagnosis.best is not None
    for request in requests:
        try:
            experiment = make_plan(problem.machine, request).experiments[0]
        except FfcompError:
            continue
        virtual = _virtual(problem, diagnosis, experiment)
        apart = _differences(
            virtual, diagnosis.best.fit, rivals, diagnosis.best.fit.information / diagnosis.best.fit.overdispersion
        )
        yield _Trial(request, experiment.position_mm, tuple(apart))


def _virtual(problem: PrinterProblem, diagnosis: Diagnosis, experiment: Experiment) -> EstimationProblem:
    """Make a problem of a recording that nobody has made yet."""
    like, motion = problem.observations[0], experiment.motion
    recording = blank_recording(
        problem.machine, experiment.name, motion.nozzle, motion.duration_s, like.signals, like.rate_hz
    )
    virtual = PrinterProblem(problem.machine, [recording], ())
    whiten = whitener(virtual.observations, diagnosis.noise, virtual.band_hz)
    return replace(estimation_problem(virtual, whiten, diagnosis.estimation.settings), coarse=True)


def _differences(
    estimation: EstimationProblem, best: Fit, rivals: Sequence[Rival], information: FloatArray | None
) -> list[float]:
    """Return the rms by which each rival's prediction differs from the best one's; zero where it has none.

    Parameters
    ----------
    information : (p, p) that the given runs have of the best one's parameters; None: it is not retuned
    """
    ours, *others = estimation.residuals([best.values, *(rival.values for rival in rivals)])
    apart = [ours - other for other in others]
    squares = [float(d @ d) for d in apart]
    if information is not None:
        columns = derivatives(estimation, best.parameters, best.z, ours, range(len(best.z)))
        absorbed = np.linalg.inv(information + columns.T @ columns)
        slopes = [columns.T @ d for d in apart]
        squares = [max(s - float(g @ absorbed @ g), 0.0) for s, g in zip(squares, slopes, strict=True)]
    # an infeasible printer's residual is a million in every entry
    return [float(np.sqrt(s / len(ours))) if s < 1e11 * len(ours) else 0.0 for s in squares]


# ---- sentences and commands --------------------------------------------------------------------------------


def _separation(
    machine: Machine, ours: tuple[str, ...], rival: Rival, now: float, trial: _Trial, there: float
) -> Separation:
    return Separation(
        ours,
        rival.names,
        now,
        there,
        trial.request.kinds[0],
        trial.position_mm,
        command_of(machine, trial.request),
        separated_by(ours, rival.names),
    )


def command_of(machine: Machine, request: Request) -> str:
    """Return the command line that plans this recording."""
    x, y = request.places_mm[0]
    words = [
        "ffcomp",
        "record",
        "plan",
        "-m",
        _machine_argument(machine),
        "--kind",
        request.kinds[0],
        "--at",
        f"{x:g},{y:g}",
    ]
    words += ["--height-mm", f"{request.height_mm:g}"] if request.height_mm != Request().height_mm else []
    hard = request.acceleration_mm_per_s2
    words += [] if hard is None else ["--amplitude-mm-per-s2", f"{hard:g}"]
    return shlex.join([*words, "--seconds", f"{request.seconds:g}", "-o", OUTPUT])


def _machine_argument(machine: Machine) -> str:
    path = Path(machine.path)
    return path.stem if machine_paths().get(path.stem) == path else str(path)
