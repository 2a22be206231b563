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

import numpy as np

from ffcomp.diagnose.diagnosis import Diagnosis
from ffcomp.diagnose.fit import EstimationProblem, Fit, derivatives, estimation_problem
from ffcomp.diagnose.hypotheses import Hypothesis
from ffcomp.diagnose.next_experiment import blank_recording, linear_estimate
from ffcomp.diagnose.noise import whitener
from ffcomp.diagnose.printer_problem import PrinterProblem
from ffcomp.diagnose.score_test import confounded_with
from ffcomp.diagnose.separation import Separation
from ffcomp.diagnose.settings import SETTINGS
from ffcomp.errors import FfcompError
from ffcomp.record.moves import KINDS, Request, default_places, make_plan
from ffcomp.record.plan import Experiment
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE
from models.finding import machine_paths
from models.machine import Machine

MOST = 2  # rivals that are asked for
SECONDS = 2.5  # of the recording
HIGH = 0.5  # of the print height
SOFT = 0.25  # of the acceleration limit
OUTPUT = "separate.gcode"
FEASIBLE = 1e11  # mean square: an infeasible printer's residual is a million in every entry

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


def separations(problem: PrinterProblem, found: Diagnosis) -> list[Separation]:
    """Return, for each rival of the best explanation, the recording that separates it best."""
    everyone = rivals_of(found)
    rivals = [rival for rival in everyone if not rival.beaten][:MOST]
    beaten = [rival for rival in everyone if rival.beaten][:MOST]
    if found.best is None or not everyone:
        return []
    ours = found.best.names
    now = _differences(replace(found.estimation, coarse=True), found.best.fit, [*rivals, *beaten], None)
    settled = [
        Separation(ours, rival.names, here, here, "", (), "", _otherwise(ours, rival.names))
        for rival, here in zip(beaten, now[len(rivals) :], strict=True)
    ]
    if not rivals:
        return settled
    trials = _tried(problem, found, rivals)
    best = [max(trials, key=lambda trial, i=i: trial.differences[i], default=None) for i in range(len(rivals))]  # type: ignore[misc]
    asked = [
        _separation(problem.machine, ours, rival, here, trial, trial.differences[i])
        for i, (rival, here, trial) in enumerate(zip(rivals, now[: len(rivals)], best, strict=True))
        if trial is not None
    ]
    return [*asked, *settled]


# ---- who is in question --------------------------------------------------------------------------


def rivals_of(found: Diagnosis) -> list[Rival]:
    """Return what fits as well as the best explanation, where that explains most of the discrepancy.

    Other effects that were fitted and are as likely; then the same with one more, where that is likelier but removes
    too little to be named; then effects of a like signature, whether they were never fitted or fit less well.
    """
    best = found.best
    if best is None or best.discrepancy > (1 - SETTINGS.mostly) * found.base.discrepancy:
        return []
    fitted = [h for h in found.competing if h.names != best.names] + _likelier_with_one_more(found)
    rivals = [Rival(h.names, h.fit.values) for h in fitted]
    alike = [name for name, _ in confounded_with(best.names, found.screened)]
    asked = {name for rival in rivals for name in rival.names}
    replacing = [h for h in found.tried if len(h.names) == len(best.names) and h.names != best.names]
    beaten = [next((h for h in replacing if name in h.names), None) for name in alike if name not in asked]
    rivals += [Rival(h.names, h.fit.values, beaten=True) for h in beaten if h is not None]
    known = {name for h in found.tried for name in h.names}
    like = [s for s in found.screened if s.candidate.name in {*alike} - known and len(best.effects) == 1]
    return rivals + [Rival((s.candidate.name,), linear_estimate(found, s)) for s in like]


def _likelier_with_one_more(found: Diagnosis) -> list[Hypothesis]:
    assert found.best is not None
    ours, scale = set(found.best.names), found.best.fit.misfit
    larger = [h for h in found.tried if ours < set(h.names) and len(h.names) == len(ours) + 1]
    likelier = [h for h in larger if found.behind(h) / scale < -SETTINGS.significant]
    return sorted(likelier, key=found.behind)[:1]


# ---- where they differ ---------------------------------------------------------------------------


def _tried(problem: PrinterProblem, found: Diagnosis, rivals: Sequence[Rival]) -> list[_Trial]:
    """Try every kind at the centre, then the best kind at other places, higher, and softer."""
    machine = problem.machine
    centre, *others = default_places(machine)
    usual = Request(places_mm=[centre], seconds=SECONDS)
    trials = [*_asked(problem, found, rivals, [replace(usual, kinds=(kind,)) for kind in KINDS])]
    if not trials:
        return []
    best = max(trials, key=lambda trial: min(trial.differences)).request
    more = [replace(best, places_mm=[place]) for place in others]
    more.append(replace(best, height_mm=round(HIGH * machine.kinematics.height_mm)))
    more.append(replace(best, acceleration_mm_per_s2=round(SOFT * machine.limits.acceleration_mm_per_s2)))
    return [*trials, *_asked(problem, found, rivals, more)]


def _asked(
    problem: PrinterProblem, found: Diagnosis, rivals: Sequence[Rival], requests: Sequence[Request]
) -> Iterator[_Trial]:
    """Play recordings on every explanation; those that the machine cannot make are left out."""
    assert found.best is not None
    for request in requests:
        try:
            experiment = make_plan(problem.machine, request).experiments[0]
        except FfcompError:
            continue
        virtual = _virtual(problem, found, experiment)
        apart = _differences(virtual, found.best.fit, rivals, found.best.fit.information / found.best.fit.misfit)
        yield _Trial(request, experiment.position_mm, tuple(apart))


def _virtual(problem: PrinterProblem, found: Diagnosis, experiment: Experiment) -> EstimationProblem:
    """Make a problem of a recording that nobody has made yet."""
    like, motion = problem.observations[0], experiment.motion
    recording = blank_recording(
        problem.machine, experiment.name, motion.nozzle, motion.duration_s, like.signals, like.rate_hz
    )
    virtual = PrinterProblem(problem.machine, [recording], ())
    whiten = whitener(virtual.observations, found.noise, virtual.band_hz)
    return replace(estimation_problem(virtual, whiten), coarse=True)


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
    return [float(np.sqrt(s / len(ours))) if s < FEASIBLE * len(ours) else 0.0 for s in squares]


# ---- what is said --------------------------------------------------------------------------------


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
        _otherwise(ours, rival.names),
    )


def _otherwise(ours: Sequence[str], theirs: Sequence[str]) -> str:
    """Return the catalogue's advice on telling them apart."""
    found = (
        CATALOGUE[a].confounded_with.get(b) or CATALOGUE[b].confounded_with.get(a)
        for a in ours
        for b in theirs
        if a != b and a in CATALOGUE and b in CATALOGUE
    )
    return next(filter(None, found), "")


def command_of(machine: Machine, request: Request) -> str:
    """Return the command line that plans this recording."""
    x, y = request.places_mm[0]
    words = ["ffcomp", "record", "plan", "-m", _asked_for(machine), "--kind", request.kinds[0], "--at", f"{x:g},{y:g}"]
    words += ["--height-mm", f"{request.height_mm:g}"] if request.height_mm != Request().height_mm else []
    hard = request.acceleration_mm_per_s2
    words += [] if hard is None else ["--amplitude-mm-per-s2", f"{hard:g}"]
    return shlex.join([*words, "--seconds", f"{request.seconds:g}", "-o", OUTPUT])


def _asked_for(machine: Machine) -> str:
    path = Path(machine.path)
    return path.stem if machine_paths().get(path.stem) == path else str(path)
