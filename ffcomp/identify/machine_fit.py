"""Fit a machine file to whatever was measured: from files to a new machine file and the JSON of `identify fit`."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ffcomp.errors import MeasurementError, RequestError
from ffcomp.identify.all_axes import IdentifiedAxes, identify_axes
from ffcomp.identify.belts import BeltComparison, compare_belts
from ffcomp.identify.from_resonances import Resonance, starting_machine
from ffcomp.identify.identify import (
    Identified,
    axes_file_text,
    identify,
    machine_file_text,
    modes_file_text,
    paper_file_text,
    scale_is_weak,
)
from ffcomp.identify.load import Gathered, resonances_of
from ffcomp.identify.modal_fit import AxisFit
from ffcomp.identify.output_error import TOTAL_MASS, Fitted
from ffcomp.identify.paper import identify_as_paper
from ffcomp.identify.shaper_advice import AXES, ShaperAdvice, shaper_advice
from ffcomp.measurement.modes import Mode, ModeFit
from gcode.atomic_write import replace_atomically
from models.file import check_text, machine_of_text
from models.machine import Machine

Method = Literal["direct", "stepwise"]
Progress = Callable[[str], None]
USUAL_S = (2.0, 1.0, 6.0, 1.0, 2.0)  # of CPU: reading, where to begin, other mounts, the fit, and without a filter

ROUGH = 0.2  # of the measurement: modes that leave more of it unexplained are written if the user says so
DAMPING_SD = 0.2  # of the towers' damping ratio, which two modes share
OF_A_MODE = ("frequency_hz", "damping_ratio", "share")


@dataclass(frozen=True, eq=False)
class MachineFit:
    """A machine file's parameters as measurements give them."""

    answer: Mapping[str, Any]  # ffcomp-identify-fit/1, but for the output
    text: str  # of the new machine file; empty: the data do not make one
    name: str  # of the new machine
    found: Identified | IdentifiedAxes | None  # to be drawn; None: there are no responses to draw
    belts: BeltComparison | None = None  # to be drawn
    refusal: tuple[str, ...] = ()  # sentences: why there is no machine file
    shapers: tuple[ShaperAdvice, ...] = ()  # for those who stay with one

    def to_dict(self, output: str | None = None) -> dict[str, Any]:
        """Return the JSON object ffcomp-identify-fit/1; output : path of the machine file that was written."""
        shapers = {"shapers": [asdict(each) for each in self.shapers]} if self.shapers else {}
        return {**self.answer, **shapers, "output": output}

    def write(self, path: Path) -> None:
        """Write the machine file, whole or not at all.

        Raises
        ------
        MachineFileError
            If the text is no valid machine file.
        MeasurementError
            If the data do not make a machine file.
        """
        if not self.text:
            reasons = self.refusal or ("These data hold no resonance, so there is no machine file to write.",)
            raise MeasurementError(str(path), list(reasons))
        check_text(self.text, str(path))
        replace_atomically(path, [line.encode() for line in self.text.splitlines(keepends=True)])


def fit_measurements(
    start: Machine,
    gathered: Gathered,
    data: Sequence[Path],
    known: Mapping[str, tuple[float, float]],
    name: str = "",
    *,
    method: Method = "direct",
    write_start: bool = True,
    rough: bool = False,
    progress: Progress = lambda _: None,
) -> MachineFit:
    """Fit whatever the data can tell: all parameters, the axes' modes, or resonances alone.

    Parameters
    ----------
    start : the machine to start from
    gathered, data : what the files held (see `load.gather`), and the files
    known : value and standard deviation of parameters that are known
    name : of the new machine; "": the name of `start`
    method : "stepwise" is the paper's
    write_start : make a starting file of resonances where there is nothing else
    rough : write modes too that leave more than a fifth of the measurement unexplained

    Raises
    ------
    RequestError
        If the method cannot use what is known or measured.
    MeasurementError
        If the files hold nothing that can be fitted.
    """
    if gathered.nothing:
        rule = "None of the files holds the response of an axis to its command."
        raise MeasurementError("data", [*gathered.skipped, rule])
    belts = compare_belts(start, gathered.belts) if gathered.belts else None
    hashes = [hash_of(path) for path in data]
    task = _Task(start, gathered, hashes, dict(known), name or start.name, belts, rough)
    if not start.vibration.position_dependent:
        return _with_shapers(task.axes(method, progress))
    if not gathered.responses:
        return task.resonances(write_start)
    return _with_shapers(task.stepwise() if method == "stepwise" else task.direct(progress))


def _with_shapers(fit: MachineFit) -> MachineFit:
    """Add what suits those who stay with an input shaper, for the axes that were measured."""
    if not fit.text:
        return fit
    measured = {axis.name for axis in fit.found.axes} if isinstance(fit.found, IdentifiedAxes) else set(AXES)
    advice = shaper_advice(machine_of_text(fit.text, fit.name))
    return replace(fit, shapers=tuple(each for each in advice if each.axis in measured))


@dataclass(frozen=True, eq=False)
class _Task:
    start: Machine
    gathered: Gathered
    hashes: list[str]
    known: dict[str, tuple[float, float]]
    name: str
    belts: BeltComparison | None
    rough: bool

    def axes(self, method: Method, progress: Progress) -> MachineFit:
        """Fit the modes of cartesian and CoreXY axes."""
        if method == "stepwise" or self.known:
            raise RequestError("--method stepwise and --known are for deltas; this machine's axes are straight.")
        if not (self.gathered.shaken or self.gathered.responses):
            return self._belts_alone()
        found = identify_axes(
            self.gathered.shaken, self.gathered.responses, progress, self.start.kinematics.shares_motors
        )
        rough = [] if self.rough else [_too_rough(axis) for axis in found.axes if max(axis.errors) > ROUGH]
        kept = tuple(axis for axis in found.axes if self.rough or max(axis.errors) <= ROUGH)
        written = replace(found, axes=kept, exchange=found.exchange if len(kept) == len(found.axes) else None)
        text = axes_file_text(Path(self.start.path), written, self.name, self.hashes, _today()) if kept else ""
        answer = {
            **self._head(),
            "method": "axes",
            "axes": {axis.name: _axis_answer(axis) for axis in found.axes},
            "exchange": None if found.exchange is None else _estimate(found.exchange.delta),
            "advice": [*rough, *found.advice],
        }
        return MachineFit(answer, text, self.name, found, self.belts, tuple(rough))

    def _belts_alone(self) -> MachineFit:
        """Compare belts; they make no machine file."""
        rule = "Tests along the belts compare these; for the modes of x and y test AXIS=X and AXIS=Y."
        answer = {**self._head(), "method": "belts", "advice": [rule]}
        return MachineFit(answer, "", self.name, None, self.belts, (rule,))

    def direct(self, progress: Progress) -> MachineFit:
        """Fit all parameters to all frequency responses."""
        found = identify(self.start, self.gathered.responses, self.known, progress)
        text = machine_file_text(Path(self.start.path), found, self.name, self.hashes, _today())
        answer = {
            **self._head(),
            "method": "direct",
            "numbers": {key: _estimate(e) for key, e in found.fitted.estimates.items()},
            "delays_s": {key: _estimate(e) for key, e in found.fitted.delays_s.items()},
            "rotation_deg": {key: _estimate(e) for key, e in found.fitted.rotation_deg.items()},
            "common_scale": _common_scale(found.fitted),
            "kept": list(found.kept),
            "weak": {key: dict(others) for key, others in found.fitted.weak.items()},
            "advice": list(found.advice),
            "misfit": found.fitted.misfit,
            "model_error": found.fitted.model_error,
            "responses": _fit_quality(found),
        }
        return MachineFit(answer, text, self.name, found)

    def stepwise(self) -> MachineFit:
        """Fit by the paper's method."""
        if TOTAL_MASS not in self.known:
            raise RequestError(f"--method stepwise needs the effector's weight: --known {TOTAL_MASS}=KG±SD.")
        found = identify_as_paper(self.start, self.gathered.responses, *self.known[TOTAL_MASS])
        named = replace(found, machine=replace(found.machine, name=self.name))
        text = paper_file_text(Path(self.start.path), named, self.hashes, _today())
        steps = [
            {
                "step": step.title,
                "chi_squared_per_degree_of_freedom": step.consistency,
                "numbers": {key: _estimate(e) for key, e in step.found.estimates().items()},
            }
            for step in found.steps
        ]
        return MachineFit({**self._head(), "method": "stepwise", "steps": steps, "advice": []}, text, self.name, None)

    def resonances(self, write_start: bool) -> MachineFit:
        """Tabulate resonances where nothing else is known, and make a starting file of them."""
        spectra = [
            {
                "file": fit.source,
                "signal": fit.signal,
                "verdict": fit.verdict,
                "misfit": fit.misfit,
                "modes": [_mode(m) for m in fit.modes],
            }
            for fit in self.gathered.spectra
        ]
        answer: dict[str, Any] = {**self._head(), "method": "modes", "spectra": spectra}
        answer["advice"] = [
            "Spectra hold no phase and no command: they say where it resonates, not why. For a model that can be "
            "compensated with, run `ffcomp record plan --for identify` and bring its captures."
        ]
        usable = [fit for fit in self.gathered.spectra if self.rough or fit.misfit <= ROUGH]
        left_out = [_left_out(fit) for fit in self.gathered.spectra if fit not in usable]
        answer["advice"] = [*left_out, *answer["advice"]]
        resonances, unclear = resonances_of(usable)
        resonances += _of_towers(self.belts)
        answer["advice"] = [*unclear, *answer["advice"]]
        if not write_start:
            return MachineFit(answer, "", self.name, None, self.belts)
        if not resonances:
            reasons = [*left_out, *unclear, *self.gathered.skipped]
            return MachineFit(answer, "", self.name, None, self.belts, tuple(reasons))
        started = starting_machine(self.start, resonances)
        text = modes_file_text(Path(self.start.path), started, self.name, self.hashes, _today())
        answer["numbers"] = {key: _estimate(e) for key, e in started.estimates.items()}
        return MachineFit(answer, text, self.name, None, self.belts)

    def _head(self) -> dict[str, Any]:
        head = {
            "schema": "ffcomp-identify-fit/1",
            "started_from": {"name": self.start.name, "sha256": self.start.sha256},
            "data": self.hashes,
            "skipped": self.gathered.skipped,
        }
        return head if self.belts is None else {**head, "belts": _belts_answer(self.belts)}


def _too_rough(axis: AxisFit) -> str:
    return (
        f"[axes.{axis.name}] is not written: its modes leave {100 * max(axis.errors):.0f} % of the measurement "
        f"unexplained, and {100 * ROUGH:.0f} % is the limit. Fasten the sensor and what rattles, and test it again; or "
        "write it all the same with --rough."
    )


def _left_out(fit: ModeFit) -> str:
    return (
        f"{Path(fit.source).name} is not used for the machine file: its modes leave {100 * fit.misfit:.0f} % of the "
        f"spectrum unexplained, and {100 * ROUGH:.0f} % is the limit. Test it again, or say --rough."
    )


def _of_towers(belts: BeltComparison | None) -> list[Resonance]:
    """Return the mean resonance of the head on all towers; at the centre of a delta all directions are alike."""
    if belts is None:
        return []
    frequency, damping = (float(np.mean([e.value for e in belts.modes_hz])), float(np.mean(belts.damping_ratio)))
    mode = Mode(frequency, belts.modes_hz[0].sd, damping, DAMPING_SD * damping, 1.0)
    return [Resonance("x", (0.0, 0.0), mode)]


def _belts_answer(belts: BeltComparison) -> dict[str, Any]:
    tests = zip(belts.tests, belts.errors, strict=True)
    return {
        "kind": belts.kind,
        "sentence": belts.sentence,
        "relative_stiffness": {name: _estimate(e) for name, e in zip(belts.names, belts.stiffness, strict=True)},
        "modes_hz": [_estimate(e) for e in belts.modes_hz],
        "damping_ratio": list(belts.damping_ratio),
        "tests": [{"file": t.spectrum.source, "axis": t.axis, "model_error": e} for t, e in tests],
    }


def _common_scale(fitted: Fitted) -> dict[str, Any]:
    """Return how weak the common scale of masses, stiffnesses and dampings is, and the numbers beside it."""
    beside = fitted.beside_scale if scale_is_weak(fitted) else {}
    return {"sd": fitted.common_scale_sd, "numbers": {key: _estimate(e) for key, e in beside.items()}}


def hash_of(path: Path) -> str:
    """Return a file's name with the hash of its content, for provenance."""
    return f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"


def _today() -> str:
    return date.today().isoformat()


def _estimate(e: Any) -> dict[str, float]:
    return {"value": float(e.value), "sd": float(e.sd), "low": float(e.low), "high": float(e.high)}


def _axis_answer(axis: AxisFit) -> dict[str, Any]:
    return {
        "modes": [{key: _estimate(getattr(mode, key)) for key in OF_A_MODE} for mode in axis.modes],
        "verdict": axis.verdict,
        "data": [
            {"source": Path(datum.source).name, "lines": len(datum.frequency_hz), "model_error": error}
            for datum, error in zip(axis.data, axis.errors, strict=True)
        ],
    }


def _mode(m: Any) -> dict[str, Any]:
    return {
        "frequency_hz": m.frequency_hz,
        "frequency_sd_hz": m.frequency_sd_hz,
        "damping_ratio": m.damping_ratio,
        "damping_ratio_sd": m.damping_ratio_sd,
        "power": m.power,
        "clear": m.clear,
    }


def _fit_quality(found: Identified) -> list[dict[str, Any]]:
    rows = []
    fitted = found.fitted
    for r, h, share in zip(fitted.responses, fitted.predictions, fitted.model_errors, strict=True):
        error = float(np.sqrt(np.sum(np.abs(r.value - h) ** 2) / np.sum(np.abs(r.value) ** 2)))
        noise = float(np.sqrt(np.sum(r.variance) / np.sum(np.abs(r.value) ** 2)))
        rows.append(
            {
                "source": r.source,
                "setup": r.setup,
                "input": r.input,
                "output": r.output,
                "position_mm": r.position_mm,
                "points": len(r.frequency_hz),
                "relative_error": error,
                "relative_noise": noise,
                "model_error": float(share),
            }
        )
    return rows
