"""What `identify fit` returns: one result for each kind of measurement, its machine file and its JSON object."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identification.axes import IdentifiedAxes
from ffcomp.identification.belts import BeltComparison
from ffcomp.identification.direct import Identified, scale_is_weak
from ffcomp.identification.from_resonances import ResonanceStart
from ffcomp.identification.modal_fit import AxisFit
from ffcomp.identification.page_fit import PageFit
from ffcomp.identification.paper import PaperIdentification
from ffcomp.identification.uncertainty import Estimate
from ffcomp.measurement.modes import ModeFit
from ffcomp.shapers.calibration import ShaperAdvice
from gcode.atomic_write import replace_atomically
from models.file import check_text
from models.machine import Machine


@dataclass(frozen=True, eq=False, kw_only=True)
class MachineFit:
    """A machine file's parameters as measurements give them."""

    method: ClassVar[str] = ""
    schema: ClassVar[str] = "ffcomp-identify-fit/1"

    start: Machine
    data: Sequence[str]  # files with hashes
    name: str  # of the new machine
    text: str = ""  # of the new machine file; empty: the data do not make one
    skipped: Sequence[str] = ()  # sentences: what was not used
    advice: Sequence[str] = ()  # sentences
    refusal: Sequence[str] = ()  # sentences: why there is no machine file
    belts: BeltComparison | None = None
    shapers: tuple[ShaperAdvice, ...] = ()  # for those who stay with one

    @property
    def details(self) -> dict[str, Any]:
        """What the method tells, for the JSON object."""
        return {}

    def to_dict(self, output: str | None = None) -> dict[str, Any]:
        """Return the JSON object `schema`; output : path of the machine file that was written."""
        return {
            "schema": self.schema,
            "started_from": {"name": self.start.name, "sha256": self.start.sha256},
            "data": list(self.data),
            "skipped": list(self.skipped),
            **({} if self.belts is None else {"belts": _belts(self.belts)}),
            "method": self.method,
            **self.details,
            "advice": list(self.advice),
            **({"shapers": [asdict(each) for each in self.shapers]} if self.shapers else {}),
            "output": output,
        }

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


@dataclass(frozen=True, eq=False, kw_only=True)
class ParametersFit(MachineFit):
    """All parameters of a delta, fitted to all frequency responses."""

    method = "direct"

    result: Identified

    @property
    def beside_scale(self) -> Mapping[str, Estimate]:
        """The parameters where the common scale of masses, stiffnesses and dampings is weak, that scale being known."""
        return self.result.fitted.beside_scale if scale_is_weak(self.result.fitted) else {}

    @property
    def details(self) -> dict[str, Any]:
        """What the method tells, for the JSON object."""
        fitted = self.result.fitted
        return {
            "numbers": estimates(fitted.estimates),
            "delays_s": estimates(fitted.delays_s),
            "rotation_deg": estimates(fitted.rotation_deg),
            "common_scale": {"sd": fitted.common_scale_sd, "numbers": estimates(self.beside_scale)},
            "kept": list(self.result.kept),
            "weak": {key: dict(others) for key, others in fitted.weak.items()},
            "misfit": fitted.misfit,
            "model_error": fitted.model_error,
            "responses": _quality(self.result),
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class StepwiseFit(MachineFit):
    """The same by the paper's method."""

    method = "stepwise"

    result: PaperIdentification

    @property
    def details(self) -> dict[str, Any]:
        """What the method tells, for the JSON object."""
        steps = [
            {
                "step": step.title,
                "chi_squared_per_degree_of_freedom": step.consistency,
                "numbers": estimates(step.joint.estimates()),
            }
            for step in self.result.steps
        ]
        return {"steps": steps}


@dataclass(frozen=True, eq=False, kw_only=True)
class AxesFit(MachineFit):
    """The modes of cartesian and CoreXY axes."""

    method = "axes"

    result: IdentifiedAxes

    @property
    def details(self) -> dict[str, Any]:
        """What the method tells, for the JSON object."""
        exchange = self.result.exchange
        return {
            "axes": {axis.name: _axis(axis) for axis in self.result.axes},
            "exchange": None if exchange is None else asdict(exchange.delta),
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class BeltsFit(MachineFit):
    """Belts compared; they make no machine file."""

    method = "belts"


@dataclass(frozen=True, eq=False, kw_only=True)
class ResonancesFit(MachineFit):
    """Resonances of a delta where nothing else is known, and a starting file of them."""

    method = "modes"

    spectra: Sequence[ModeFit]
    started: ResonanceStart | None = None

    @property
    def details(self) -> dict[str, Any]:
        """What the method tells, for the JSON object."""
        spectra = [
            {
                "file": fit.source,
                "signal": fit.signal,
                "verdict": fit.verdict,
                "misfit": fit.misfit,
                "modes": [
                    {
                        "frequency_hz": mode.frequency_hz,
                        "frequency_sd_hz": mode.frequency_sd_hz,
                        "damping_ratio": mode.damping_ratio,
                        "damping_ratio_sd": mode.damping_ratio_sd,
                        "power": mode.power,
                        "clear": mode.clear,
                    }
                    for mode in fit.modes
                ],
            }
            for fit in self.spectra
        ]
        return {"spectra": spectra, **({} if self.started is None else {"numbers": estimates(self.started.estimates)})}


@dataclass(frozen=True, eq=False, kw_only=True)
class ScanFit(MachineFit):
    """A machine's numbers from pictures of a page that it drew."""

    method = "scan"
    schema = "ffcomp-identify-scan/1"

    result: PageFit

    @property
    def details(self) -> dict[str, Any]:
        """What the method tells, for the JSON object."""
        fit = self.result
        places = [
            {
                "position_mm": place,
                "modes": [{"frequency_hz": asdict(f), "damping_ratio": asdict(d)} for f, d in modes],
            }
            for place, modes in fit.modes.items()
        ]
        return {
            "numbers": estimates(fit.estimates),
            "kept": list(fit.kept),
            "places": places,
            "bead": estimates(fit.bead),
            "explained": fit.explained,
            "lines": len(fit.lines),
            "noise_um": float(1e3 * np.median([line.noise_mm for line in fit.lines])),
        }


def estimates(by_name: Mapping[str, Estimate]) -> dict[str, dict[str, float]]:
    """Return value, sd, low and high of each."""
    return {name: {key: float(x) for key, x in asdict(each).items()} for name, each in by_name.items()}


def hash_of(path: Path) -> str:
    """Return a file's name with the hash of its content, for provenance."""
    return f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"


def _belts(belts: BeltComparison) -> dict[str, Any]:
    tests = zip(belts.tests, belts.errors, strict=True)
    return {
        "kind": belts.kind,
        "sentence": belts.sentence,
        "relative_stiffness": estimates(dict(zip(belts.names, belts.stiffness, strict=True))),
        "modes_hz": [asdict(e) for e in belts.modes_hz],
        "damping_ratio": list(belts.damping_ratio),
        "tests": [{"file": t.spectrum.source, "axis": t.axis, "model_error": e} for t, e in tests],
    }


def _axis(axis: AxisFit) -> dict[str, Any]:
    return {
        "modes": [asdict(mode) for mode in axis.modes],
        "verdict": axis.verdict,
        "data": [
            {"source": Path(datum.source).name, "lines": len(datum.frequency_hz), "model_error": error}
            for datum, error in zip(axis.data, axis.errors, strict=True)
        ],
    }


def _quality(result: Identified) -> list[dict[str, Any]]:
    """Say of each response how near the fitted machine comes, and what noise it has."""
    rows = []
    fitted = result.fitted
    for r, h, share in zip(fitted.responses, fitted.predictions, fitted.model_errors, strict=True):
        size = np.sum(np.abs(r.value) ** 2)
        rows.append(
            {
                "source": r.source,
                "setup": r.setup,
                "input": r.input,
                "output": r.output,
                "position_mm": r.position_mm,
                "points": len(r.frequency_hz),
                "relative_error": float(np.sqrt(np.sum(np.abs(r.value - h) ** 2) / size)),
                "relative_noise": float(np.sqrt(np.sum(r.variance) / size)),
                "model_error": float(share),
            }
        )
    return rows
