"""`identify fit` on one page: from files to a fitted machine file.

    files ─ gather ─┬─ runs of one axis ──────────── fit_axis ─────────── OneAxisFit
                    ├─ tests and responses of axes ─ identify_axes ────── AxesFit
                    ├─ responses of a delta ──────── identify ─────────── ParametersFit
                    │                             or identify_as_paper ── StepwiseFit
                    └─ spectra alone ─────────────── starting_machine ─── ResonancesFit
    tests along belts or towers are compared too (compare_belts)

Each fit brings its machine file's text and its JSON object (`machine_fit.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from ffcomp.errors import MeasurementError, RequestError
from ffcomp.identification.axes import fit_axes, identify_axes
from ffcomp.identification.axis_fit import fit_axis
from ffcomp.identification.belts import BeltComparison, compare_belts
from ffcomp.identification.direct import identify
from ffcomp.identification.from_resonances import ResonanceStart, belts_alone, starting_machine
from ffcomp.identification.load import Gathered, gather
from ffcomp.identification.machine_fit import (
    AxesFit,
    BeltsFit,
    MachineFit,
    Origin,
    ParametersFit,
    ResonancesFit,
    StepwiseFit,
    axes_file_text,
    hash_of,
)
from ffcomp.identification.modal_fit import AxisFit
from ffcomp.identification.output_error import EFFECTOR_MASSES, TOTAL_MASS
from ffcomp.identification.paper import identify_as_paper
from ffcomp.identification.request import IdentifyRequest, RingingRequest
from ffcomp.identification.uncertainty import Estimate, Mode, lognormal, normal
from ffcomp.shapers.calibration import shaper_advice
from models.errors import MachineFileError
from models.file import check_text, machine_of_text, updated_text
from models.kinds import is_one_axis
from models.machine import Machine, value_of

USUAL_S = (2.0, 1.0, 6.0, 1.0, 2.0)  # of CPU: reading, where to begin, other mounts, the fit, and without a filter
ROUGH = 0.2  # of the measurement: modes that leave more unexplained are only written on request
DAMPING_SD = 0.2  # of the towers' damping ratio, which two modes share

Progress = Callable[[str], None]
F = TypeVar("F", bound=MachineFit)


def fit_files(start: Machine, request: IdentifyRequest, progress: Progress = lambda _: None) -> MachineFit:
    """Fit a machine file's numbers to files.

    Raises RequestError if the method cannot use what is known or measured; MeasurementError if the files hold nothing
    that can be fitted; MachineFileError.
    """
    data = cast("tuple[Path, ...]", request.data)
    _check_known(start, request.known or {})
    if is_one_axis(start):
        if request.plan is not None or request.method != "direct":
            raise RequestError("--plan and --method are for printers; an axis by itself is fitted to its runs.")
        return fit_axis(start, data, request.known or {}, _name(start, request), progress)
    gathered = gather(start, request, progress)
    if not (gathered.responses or gathered.shaken or gathered.belts):
        rule = "None of the files holds the response of an axis to its command."
        raise MeasurementError("data", [*gathered.skipped, rule])
    for sentence in gathered.skipped:
        progress(sentence)
    task = _Task(start, gathered, [hash_of(path) for path in data], request)
    if not start.vibration.position_dependent:
        return _with_shapers(task.axes(progress)) if gathered.shaken or gathered.responses else task.belts_alone()
    if not gathered.responses:
        return task.resonances(progress)
    return _with_shapers(task.stepwise() if request.method == "stepwise" else task.parameters(progress))


def _check_known(start: Machine, known: Mapping[str, tuple[float, float]]) -> None:
    """Refuse a number that no machine file may hold, before anything is fitted to it; the fit names unknown keys."""
    tunable = start.vibration.tunable if start.path else ()
    masses = {key: value_of(start, key) for key in EFFECTOR_MASSES if key in tunable}
    for key, (value, _) in known.items():
        values = {key: value} if key in tunable else {}
        if key == TOTAL_MASS:
            values = {name: mass * value / sum(masses.values()) for name, mass in masses.items()}
        try:
            if values:
                check_text(updated_text(Path(start.path), values), key)
        except MachineFileError as error:
            raise RequestError(f"--known {key}={value:g}: {' '.join(error.problems)}") from None


READ_SD = 0.05  # of a frequency that is read off the waves of a print


def fit_ringing(start: Machine, request: RingingRequest) -> ResonancesFit:
    """Move a machine's modes to frequencies that are read off the waves of a print.

    They scale the belts' stiffness of a delta, and all modes of a straight axis in proportion.
    """
    read = {axis: hz for axis, hz in (("x", request.x_hz), ("y", request.y_hz)) if hz is not None}
    origin = Origin(start, request.name or request.output.stem)
    if start.vibration.position_dependent:
        started = belts_alone(start, [(axis, lognormal(hz, READ_SD)) for axis, hz in read.items()])
    else:
        estimates = dict[str, Estimate]()
        for axis, hz in read.items():
            keys = [key for key in start.vibration.tunable if key.startswith(f"axes.{axis}.frequency_hz")]
            if not keys:
                raise RequestError(f"{start.name} has no modes along {axis}: it is stiff there.")
            shares = [value_of(start, key.replace("frequency_hz", "share")) for key in keys]
            main = value_of(start, keys[int(np.argmax(shares))])
            estimates |= {key: lognormal(value_of(start, key) * hz / main, READ_SD) for key in keys}
        started = ResonanceStart(estimates, list(read.values()))
    text = origin.text_of(started.estimates, "ringing", read_hz=read)
    advice = ["Damping is unchanged: waves on a wall show how fast it rings, and hardly how long."]
    off = {axis: made / hz - 1 for (axis, hz), made in zip(read.items(), started.predicted_hz, strict=True)}
    if max(map(abs, off.values()), default=0.0) > 2 * READ_SD:
        words = " and ".join(f"{axis} rings at {read[axis] * (1 + share):.1f} Hz" for axis, share in off.items())
        advice.append(
            f"One stiffness of the belts does not make both: with the nearest, {words}. Read the waves again, or print "
            "a page, which shows masses and mounts too: ffcomp record plan --for scan."
        )
    return ResonancesFit(origin=origin, text=text, advice=advice, axes={}, started=started)


def _with_shapers(fit: F) -> F:
    """Add advice on input shapers for the axes that were measured."""
    if not fit.text:
        return fit
    measured = {axis.name for axis in fit.result.axes} if isinstance(fit, AxesFit) else {"x", "y"}
    advice = shaper_advice(machine_of_text(fit.text, fit.origin.name))
    return replace(fit, shapers=tuple(each for each in advice if each.axis in measured))


class _Task:
    """What all fits of some files have in common."""

    def __init__(self, start: Machine, gathered: Gathered, hashes: Sequence[str], request: IdentifyRequest) -> None:
        self.start, self.gathered, self.request = start, gathered, request
        self.known = dict(request.known or {})
        self.origin = Origin(start, _name(start, request), hashes)
        self.belts = compare_belts(start, gathered.belts) if gathered.belts else None
        self.common: dict[str, Any] = {
            "origin": self.origin,
            "skipped": gathered.skipped,
            "belts": self.belts,
        }
        if not start.vibration.position_dependent and (request.method == "stepwise" or request.known):
            raise RequestError("--method stepwise and --known are for deltas; this machine's axes are straight.")

    def parameters(self, progress: Progress) -> ParametersFit:
        """Fit all parameters to all frequency responses."""
        result = identify(self.start, self.gathered.responses, self.known, progress)
        text = self.origin.text_of(
            {key: e for key, e in result.estimates.items() if key not in (*result.kept, TOTAL_MASS)},
            "fit",
            responses=len(result.responses),
            misfit_chi_squared_per_degree_of_freedom=float(f"{result.misfit:.4g}"),
            model_error_share=float(f"{result.model_error:.3g}"),
            kept_from_the_starting_file=list(result.kept),
        )
        return ParametersFit(**self.common, text=text, advice=result.advice, result=result)

    def stepwise(self) -> StepwiseFit:
        """Fit by the paper's method."""
        if TOTAL_MASS not in self.known:
            raise RequestError(f"--method stepwise needs the effector's weight: --known {TOTAL_MASS}=KG±SD.")
        result = identify_as_paper(self.start, self.gathered.responses, *self.known[TOTAL_MASS])
        agreed = {step.title: float(f"{step.consistency:.4g}") for step in result.steps}
        text = self.origin.text_of(result.estimates, "fit --method stepwise", chi_squared_per_degree_of_freedom=agreed)
        return StepwiseFit(**self.common, text=text, result=result)

    def axes(self, progress: Progress) -> AxesFit:
        """Fit the modes of cartesian and CoreXY axes."""
        shared = self.start.kinematics.shares_motors
        result = identify_axes(self.gathered.shaken, self.gathered.responses, progress, shared)
        kept, rough = self.smooth(result.axes)
        written = replace(result, axes=kept, exchange=None if rough else result.exchange)
        return AxesFit(
            **self.common,
            text=axes_file_text(self.origin, written) if kept else "",
            advice=[*rough, *result.advice],
            refusal=rough,
            result=result,
        )

    def smooth(self, axes: Sequence[AxisFit]) -> tuple[tuple[AxisFit, ...], list[str]]:
        """Return the axes whose modes explain enough to be written, and sentences on the others."""
        kept = tuple(axis for axis in axes if self.request.rough or max(axis.errors) <= ROUGH)
        return kept, [
            f"The modes of {axis.name} are not written: they leave {100 * max(axis.errors):.0f} % of the measurement "
            f"unexplained, and {100 * ROUGH:.0f} % is the limit. Fasten the sensor and what rattles, and test it "
            "again; or write it all the same with --rough."
            for axis in axes
            if axis not in kept
        ]

    def belts_alone(self) -> BeltsFit:
        """Compare belts; they make no machine file."""
        rule = "Tests along the belts only compare belts. To measure the modes of x and y, test AXIS=X and AXIS=Y."
        return BeltsFit(**self.common, advice=[rule], refusal=[rule])

    def resonances(self, progress: Progress) -> ResonancesFit:
        """Fit modes where nothing else is known, and make a starting file of the main ones."""
        axes, silent = fit_axes(self.gathered.shaken, progress)
        usable, rough = self.smooth(axes)
        left_out = [*silent, *rough]
        resonances = [*((axis.name, axis.modes[0]) for axis in usable), *_of_towers(self.belts)]
        started = starting_machine(self.start, resonances) if resonances and self.request.output is not None else None
        moved = [] if started is None else [float(f"{f:.4g}") for f in started.predicted_hz]
        return ResonancesFit(
            **self.common,
            text="" if started is None else self.origin.text_of(started.estimates, "fit", resonances_hz=moved),
            advice=[
                *left_out,
                "Spectra hold no phase and no command: they say where it resonates, not why. For a model that can be "
                "compensated with, run `ffcomp record plan --for identify` and bring its captures.",
            ],
            refusal=() if resonances else [*left_out, *self.gathered.skipped],
            axes={axis.name: axis for axis in axes},
            started=started,
        )


def _name(start: Machine, request: IdentifyRequest) -> str:
    """Return the new machine's name."""
    return request.name or (start.name if request.output is None else request.output.stem)


def _of_towers(belts: BeltComparison | None) -> list[tuple[str, Mode]]:
    """Return the mean resonance of the head on all towers; at the centre of a delta all directions are alike."""
    if belts is None:
        return []
    frequency, damping = (float(np.mean([e.value for e in belts.modes_hz])), float(np.mean(belts.damping_ratio)))
    return [("x", Mode(normal(frequency, belts.modes_hz[0].sd), lognormal(damping, DAMPING_SD)))]
