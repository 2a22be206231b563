"""The JSON object of `ffcomp compare`, from what was found."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from ffcomp.compare.result import Comparison, Error, Method, Party, Spread


def as_json(found: Comparison) -> dict[str, Any]:
    """ffcomp-compare/1: every method's TRACK, and beside it what else was measured."""
    return {
        "schema": "ffcomp-compare/1",
        "input": found.print_name,
        "input_sha256": found.print_sha256,
        "version": found.version,
        "machine": _party(found.machine),
        "plant": _party(found.plant),
        "sampling": found.sampling,
        "mismatch": found.mismatch,
        "settings": found.settings,
        "limits": found.limits,
        "print_time_s": found.print_time_s,
        "layers": [asdict(layer) for layer in found.layers],
        "best_fixed": found.best_fixed,
        "ours": found.ours,
        "quality_bound_um": found.quality_bound_um,
        "methods": {name: _method(method) for name, method in found.methods.items()},
        "seconds": found.seconds,
    }


def _party(party: Party) -> dict[str, Any]:
    return {"name": party.name, "sha256": party.sha256, "effects": list(party.effects)}


def _method(method: Method) -> dict[str, Any]:
    return {
        **asdict(method.track),
        "label": method.label,
        "family": method.family,
        "tuning": method.tuning,
        "extruding": asdict(method.extruding),
        "by_layer": {str(number): _error(error) for number, error in method.by_layer.items()},
        "by_feature": {name: _error(error) for name, error in method.by_feature.items()},
        "residual_rms_um": None if math.isnan(method.residual_rms_um) else method.residual_rms_um,
        "peaks": asdict(method.peaks),
        "mismatch": None if method.spread is None else _spread(method.spread),
        "mismatch_retuned": None if method.retuned is None else _spread(method.retuned),
        "equal_quality": None if method.equal_quality is None else asdict(method.equal_quality),
        "warnings": list(method.warnings),
    }


def _error(error: Error) -> dict[str, float]:
    return asdict(error)


def _spread(spread: Spread) -> dict[str, Any]:
    values = list(spread.contour_rms_um)
    return {"median_um": spread.median_um, "worst_um": spread.worst_um, "contour_rms_um": values}
