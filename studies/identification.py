"""The paper's Tables II and III as a study: identified at one place, predicted at four.

    python -m studies.identification     studies/reports/identification.md but for its last section, some two minutes

The laboratory is `validation/plants/lab.py`: a nonlinear printer with equations of its own, uneven towers, dry
friction in its guides, noise on its sensors. What it hands out are time records; everything else is `ffcomp identify`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffcomp.identification.output_error import TOTAL_MASS, UNKNOWNS, fit_machine
from ffcomp.identification.paper import identify_as_paper
from ffcomp.identification.predict import (
    complex_log_error,
    error_reduction,
    mean_absolute_percentage_accuracy,
    predicted,
)
from ffcomp.measurement.frf import FrequencyResponse
from models.file import LIBRARY, load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine, value_of
from models.vibration.substructures import Drive
from studies.render import save
from validation.plants import delta_plant
from validation.plants.study import PLACES, measure_bench, measure_places, uneven

SNR_DB = 40.0
DEGREE = 1.0  # a phase error is never taken relative to less


def main() -> None:
    """Measure, and write the results and the page."""
    truth = delta_plant.load_machine(LIBRARY / "mp-delta-pro.toml")
    real, smooth = uneven(truth, seed=0, friction_n=1.0), uneven(truth, seed=0, friction_n=0.0)
    studies = [
        study("Uneven towers, 1 N of dry friction in each guide, 40 dB", real),
        study("The same without friction", smooth),
    ]
    places = [place[:2] for place in PLACES]
    save("identification", {"places_mm": places, "studies": studies, "parameters": parameters(truth)})


def far_off(machine: Machine) -> Machine:
    """Another printer's numbers on this one's kinematics."""
    other = load_machine("kossel")
    arms = delta_vibration(machine).carriage.arm_pair_mass_kg
    carriage = replace(delta_vibration(other).carriage, arm_pair_mass_kg=arms, drive=Drive(2.5e5, -50.0, 100.0))
    return with_parts(replace(other, kinematics=machine.kinematics), carriage=carriage)


def study(title: str, real: dict[str, Any]) -> dict[str, Any]:
    """Identify one printer at the centre, and predict what its towers do at four places."""
    start = far_off(load_machine("mp-delta-pro"))
    bench = measure_bench(real, SNR_DB, seed=1)
    weighed = real["effector"]["nozzle_mass_kg"] + real["effector"]["extruder_mass_kg"]
    began = time.perf_counter()
    direct = fit_machine(start, bench, {TOTAL_MASS: (weighed, 0.001 * weighed)})
    seconds = time.perf_counter() - began
    stepwise = identify_as_paper(start, bench, weighed, 0.001 * weighed)
    measured = measure_places(real, SNR_DB, seed=2)
    found = (("Output-error fit", direct.machine), ("The paper's method", stepwise.machine))
    return {
        "title": title,
        "direct_s": seconds,
        "model_error": direct.model_error,
        "methods": [tables(name, machine, measured) for name, machine in found],
    }


def tables(method: str, machine: Machine, measured: Sequence[FrequencyResponse]) -> dict[str, Any]:
    """Return the cells of Tables II and III, of what a method has identified."""
    cells = {key: accuracy(r, predicted(machine, [r])[0]) for r in measured for key in [key_of(r)]}
    by_key = {key_of(r): r for r in measured}
    rows, reductions = list[dict[str, Any]](), list[dict[str, Any]]()
    for tower in "ABC":
        row = [cells[tower, place] for place in PLACES]
        rows.append({"tower": tower, "cells": list(map(told, row)), "mean": told(np.mean(row, axis=0))})
        centre = by_key[tower, PLACES[0]].value
        less = [
            error_reduction(here.value, predicted(machine, [here])[0], centre, DEGREE)
            for here in (by_key[tower, place] for place in PLACES[1:])
        ]
        reductions.append({"tower": tower, "cells": [{"magnitude": m, "phase": p} for m, p in less]})
    return {
        "method": method,
        "accuracy": rows,
        "over_all": told(np.mean(list(cells.values()), axis=0)),
        "reduction": reductions,
        "worst_reduction": min(value for row in reductions for cell in row["cells"] for value in cell.values()),
    }


def told(cell: Sequence[float]) -> dict[str, float]:
    magnitude, phase, log_error = cell
    return {"magnitude": magnitude, "phase": phase, "log_error": log_error}


def key_of(r: FrequencyResponse) -> tuple[str, tuple[float, float, float]]:
    assert r.position_mm is not None
    return r.input[-1], r.position_mm


def accuracy(r: FrequencyResponse, model: np.ndarray) -> tuple[float, float, float]:
    return (*mean_absolute_percentage_accuracy(r.value, model, DEGREE), complex_log_error(r.value, model))


def parameters(truth: dict[str, Any]) -> list[dict[str, Any]]:
    """Recover the parameters of an even printer without friction, 40 dB, both ways."""
    machine = load_machine("mp-delta-pro")
    start = far_off(machine)
    bench = measure_bench(truth, SNR_DB, seed=3)
    weighed = delta_vibration(machine).effector.nozzle_mass_kg + delta_vibration(machine).effector.extruder_mass_kg
    direct = fit_machine(start, bench, {TOTAL_MASS: (weighed, 0.001 * weighed)})
    stepwise = identify_as_paper(start, bench, weighed, 0.001 * weighed).machine
    rows = []
    for name in UNKNOWNS:
        true, e = value_of(machine, name), direct.estimates[name]
        rows.append(
            {
                "name": name,
                "true": true,
                "direct_error_percent": 100 * (e.value / true - 1),
                "stated_sd_percent": 100 * e.relative_sd,
                "stepwise_error_percent": 100 * (value_of(stepwise, name) / true - 1),
            }
        )
    return rows


if __name__ == "__main__":
    main()
