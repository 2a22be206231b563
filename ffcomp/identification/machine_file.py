"""Machine files with identified numbers: the starting file's text with values, uncertainties and provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.identification.axes import IdentifiedAxes
from ffcomp.identification.direct import Identified
from ffcomp.identification.from_resonances import ResonanceStart
from ffcomp.identification.modal_fit import AxisFit
from ffcomp.identification.output_error import DRIVE, TOTAL_MASS, UNKNOWNS
from ffcomp.identification.page_fit import PageFit
from ffcomp.identification.paper import PaperIdentification
from ffcomp.identification.uncertainty import Estimate
from models.file import updated_text
from models.kinds import delta_vibration
from models.machine import value_of

SMALLEST_SD = 0.002  # relative: no frequency of a printer is more constant from day to day


def machine_file_text(source: Path, result: Identified, name: str, data: Sequence[str], when: str) -> str:
    """Write the starting file's text with the identified parameters, their uncertainties and provenance.

    Parameters
    ----------
    data : file names with hashes, for the provenance.
    when : date.
    """
    parameters = {key: e for key, e in result.determined.items() if key != TOTAL_MASS}
    origin = f"identified {when} by ffcomp identify fit"
    return _numbers_text(source, parameters, name, origin, _summary(source, result, data, when))


def scan_file_text(source: Path, result: PageFit, name: str, data: Sequence[str], when: str) -> str:
    """Write the starting file's text with the numbers that a picture of a page gives."""
    identified = {
        "date": when,
        "started_from": source.stem,
        "data": list(data),
        "lines": len(result.lines),
        "explained_share": float(f"{result.explained:.3g}"),
        "kept_from_the_starting_file": list(result.kept),
    }
    return _numbers_text(source, result.estimates, name, f"identified {when} by ffcomp identify scan", identified)


def _numbers_text(
    source: Path, parameters: Mapping[str, Estimate], name: str, origin: str, identified: Mapping[str, Any]
) -> str:
    values = {key: _rounded(e) for key, e in parameters.items()}
    provenance: dict[str, Any] = {}
    uncertainty: dict[str, float] = {}
    for key, estimate in parameters.items():
        table_key = key.partition("[")[0]
        spread = min(estimate.relative_sd, 10.0)
        uncertainty[table_key] = float(f"{max(uncertainty.get(table_key, 0.0), spread):.2g}")
        provenance[table_key] = f"{origin}; 90 % interval {_intervals(parameters, table_key)}"
    provenance["identified"] = identified
    return updated_text(source, values, name=name, uncertainty=uncertainty, provenance=provenance)


def _rounded(estimate: Estimate) -> float:
    """Round to a tenth of the standard uncertainty."""
    if not estimate.sd > 0 or not np.isfinite(estimate.sd):
        return float(f"{estimate.value:.6g}")
    digits = int(np.clip(np.ceil(np.log10(abs(estimate.value) / estimate.sd)) + 2, 3, 8))
    return float(f"{estimate.value:.{digits}g}")


def _intervals(parameters: Mapping[str, Estimate], table_key: str) -> str:
    parts = [e for key, e in parameters.items() if key.partition("[")[0] == table_key]
    return ", ".join(f"{e.low:.4g} to {e.high:.4g}" for e in parts)


def _summary(source: Path, result: Identified, data: Sequence[str], when: str) -> dict[str, Any]:
    fitted = result.fitted
    return {
        "date": when,
        "started_from": source.stem,
        "data": list(data),
        "responses": len(fitted.responses),
        "misfit_chi_squared_per_degree_of_freedom": float(f"{fitted.misfit:.4g}"),
        "model_error_share": float(f"{fitted.model_error:.3g}"),
        "kept_from_the_starting_file": list(result.kept),
    }


def paper_file_text(source: Path, result: PaperIdentification, data: Sequence[str], when: str) -> str:
    """Write the file of the paper's method; `result.machine.name` is the new file's."""
    machine = result.machine
    names = [n for n in UNKNOWNS if delta_vibration(machine).carriage.drive is not None or n not in DRIVE]
    origin = f"identified {when} by ffcomp identify fit --method stepwise"
    provenance: dict[str, Any] = {name.partition("[")[0]: origin for name in names}
    steps = {step.title: float(f"{step.consistency:.4g}") for step in result.steps}
    provenance["identified"] = {
        "date": when,
        "started_from": source.stem,
        "data": list(data),
        "chi_squared_per_degree_of_freedom": steps,
    }
    values = {name: float(f"{value_of(machine, name):.6g}") for name in names}
    return updated_text(source, values, name=machine.name, provenance=provenance)


def modes_file_text(source: Path, started: ResonanceStart, name: str, data: Sequence[str], when: str) -> str:
    """Write the file of a resonance start."""
    origin = f"scaled {when} by ffcomp identify fit until the resonances are the measured ones"
    predicted = [float(f"{f:.4g}") for f in started.predicted_hz]
    identified = {"date": when, "started_from": source.stem, "data": list(data), "resonances_hz": predicted}
    values = {key: _rounded(e) for key, e in started.estimates.items()}
    uncertainty = {key: float(f"{e.relative_sd:.2g}") for key, e in started.estimates.items()}
    provenance = {**dict.fromkeys(started.estimates, origin), "identified": identified}
    return updated_text(source, values, name=name, uncertainty=uncertainty, provenance=provenance)


def axes_file_text(source: Path, result: IdentifiedAxes, name: str, data: Sequence[str], when: str) -> str:
    """Write the file of a machine of modal axes: `[axes.x]` and its like, of the axes that were measured."""
    origin = f"identified {when} by ffcomp identify fit"
    values: dict[str, Any] = {}
    uncertainty: dict[str, float] = {}
    provenance: dict[str, Any] = {}
    for axis in result.axes:
        for key in ("frequency_hz", "damping_ratio", "share"):
            estimates = [getattr(mode, key) for mode in axis.modes]
            intervals = ", ".join(f"{e.low:.4g} to {e.high:.4g}" for e in estimates)
            values[f"axes.{axis.name}.{key}"] = [_rounded(e) for e in estimates]
            provenance[f"axes.{axis.name}.{key}"] = f"{origin}; 90 % interval {intervals}"
            spread = max(SMALLEST_SD, *(min(e.relative_sd, 10.0) for e in estimates))
            uncertainty[f"axes.{axis.name}.{key}"] = float(f"{spread:.2g}")
        del uncertainty[f"axes.{axis.name}.share"]  # a machine file has none for it
        values[f"axes.{axis.name}.share"] = _shares(axis)
        provenance[f"axes.{axis.name}"] = axis.verdict
    if result.exchange is not None:
        delta = result.exchange.delta
        values["axes.exchange"] = round(delta.value, 4)
        provenance["axes.exchange"] = f"{origin}; 90 % interval {delta.low:.4g} to {delta.high:.4g}"
    model_errors = {axis.name: float(f"{max(axis.errors):.3g}") for axis in result.axes}
    identified = {"date": when, "started_from": source.stem, "data": list(data), "model_error_share": model_errors}
    return updated_text(
        source, values, name=name, uncertainty=uncertainty, provenance={**provenance, "identified": identified}
    )


def _shares(axis: AxisFit) -> list[float]:
    """Round to three decimals, and to a sum of one."""
    if len(axis.modes) == 1:
        return [1.0]
    first = round(axis.modes[0].share.value, 3)
    return [first, round(1.0 - first, 3)]
