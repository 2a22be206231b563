"""Write frequency responses and mode maps as the JSON objects of `ffcomp frf`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffcomp.identify.frf_study import Compared, Station, Study, verdict
from models.arrays import FloatArray
from models.machine import Machine
from models.provenance import identity
from models.vibration.mode_map import ModeMap


def frf_json(found: Study, station: Station) -> dict[str, Any]:
    """Return the JSON object ffcomp-frf/1 of one position."""
    view = found.view
    rows, columns = range(station.value.shape[1]), range(station.value.shape[2])
    phase, carriage_phase = (np.degrees(np.unwrap(np.angle(g), axis=0)) for g in (station.value, station.carriage))
    return {
        "schema": "ffcomp-frf/1",
        "machine": identity(found.machine),
        "force_map": found.machine.vibration.describe().force_map
        if found.machine.vibration.position_dependent
        else None,
        "position_mm": [*station.xy.tolist(), 0.0],
        "frequency_hz": found.frequency_hz.tolist(),
        "carriage": [[_bode(station.carriage, carriage_phase, i, k) for k in range(3)] for i in range(3)],
        "response": {
            "of": view.of,
            "per": view.per if view.depends_on_place else None,
            "unit": view.unit,
            "rows": list(view.rows),
            "columns": list(view.columns),
            "values": [[_bode(station.value, phase, i, k) for k in columns] for i in rows],
        },
        "added_mass_kg": station.added_mass_kg,
        "modes": [
            {"number": m.number, "frequency_hz": m.frequency_hz, "damping_ratio": m.damping_ratio, "kind": m.kind}
            for m in station.modes
        ],
        "measured": [_compared_answer(each) for each in station.compared],
        "verdict": verdict(found),
    }


def _bode(g: Any, phase: Any, i: int, k: int) -> dict[str, list[float]]:
    return {"magnitude": abs(g[:, i, k]).tolist(), "phase_deg": phase[:, i, k].tolist()}


def _compared_answer(each: Compared) -> dict[str, Any]:
    return {
        "source": each.response.source,
        "input": each.response.input,
        "output": each.response.output,
        "lines": len(each.frequency_hz),
        "band_hz": [float(each.frequency_hz[0]), float(each.frequency_hz[-1])],
        "magnitude_accuracy_percent": each.magnitude_percent,
        "phase_accuracy_percent": each.phase_percent,
        "log_error_db": each.log_error_db,
    }


def mode_map_json(machine: Machine, modes: ModeMap) -> dict[str, Any]:
    """Return the JSON object ffcomp-frf-map/1.

    Row i, column k belong to the position X = x_mm[i], Y = x_mm[k]; null off the bed.
    """
    return {
        "schema": "ffcomp-frf-map/1",
        "machine": identity(machine),
        "force_map": machine.vibration.describe().force_map,
        "x_mm": modes.x_mm.tolist(),
        "y_mm": modes.x_mm.tolist(),
        "modes": [
            {
                "number": mode + 1,
                "kind": kind,
                "frequency_hz": _rows(modes, modes.frequency_hz[:, :, mode]),
                "damping_ratio": _rows(modes, modes.damping_ratio[:, :, mode]),
            }
            for mode, kind in enumerate(modes.kinds)
        ],
    }


def _rows(modes: ModeMap, table: FloatArray) -> list[list[float | None]]:
    good = modes.on_bed & np.isfinite(table)
    return [
        [round(v, 6) if ok else None for v, ok in zip(*row, strict=True)]
        for row in zip(table.tolist(), good.tolist(), strict=True)
    ]
