"""Identification: the paper's Tables II and III in a laboratory, resonance tests of straight axes, files of others.

    python -m studies.identification [lab] [axes] [files]     studies/reports/identification.md, some 5 min

lab      A nonlinear printer with equations of its own (`validation/plants/lab.py`), uneven towers, dry friction and
         noise is identified at one place and predicted at four.
axes     Straight axes from a firmware's resonance tests: simulated ones, whose truth is known, with white noise in
         every sample (an ADXL345 read 3200 times a second has 0.15 m/s², which is 0.08 m/s² here), and real printers'.
files    Every vibration file of others: what `ffcomp identify fit` says of it, next to the peak of the firmware's own
         spectrum. Kalico computes it from captures in a process of its own (KALICO_PYTHON names its Python; it is GPL
         and never imported). A peak is clear where no other reaches half of it, and where at half its height it is
         narrower than a fifth of its frequency.

Files of others are read from ../shared/data or FFCOMP_DATA; a section without them stays as it was.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

import ffcomp
from ffcomp.errors import FfcompError, MeasurementError
from ffcomp.identification.axis_spectra import Spectrum
from ffcomp.identification.modal_fit import AxisFit, fit_axis
from ffcomp.identification.output_error import TOTAL_MASS, UNKNOWNS, fit_machine
from ffcomp.identification.paper import identify_as_paper
from ffcomp.identification.predict import mean_absolute_percentage_accuracy, predicted
from ffcomp.identification.resonance_tests import spectrum_of
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.vibration import Resonances, read_vibrations
from ffcomp.shapers.calibration import fits, normalised, recommended, resonance_test
from models.arrays import constant
from models.file import LIBRARY, load_machine
from models.kinds import delta_vibration, with_parts
from models.kinematics.cartesian import CARTESIAN, CartesianKinematics
from models.machine import Machine, MotionLimits, value_of
from models.vibration.modal import Axis, ModalAxes
from models.vibration.substructures import Drive
from studies.render import DATA, save
from validation.plants import delta_plant
from validation.plants.lab import PLACES, error_reduction, measure_bench, measure_places, uneven

FloatArray = NDArray[np.float64]

SNR_DB = 40.0
DEGREE = 1.0  # a phase error is never taken relative to less
FILES = DATA / "vibration"
NOISES = (0.08, 0.25, 0.8)  # m/s² in each of 800 samples a second
MACHINES = 16  # of each number of modes
BAND_HZ = (2.0, 400.0)
PRINTER, PEAKS_HZ = "voron-300", (10.0, 130.0)  # for files of others
OTHER_PEAK = 0.5  # of the highest: from there on the peak is not clear
NARROW = 0.2  # width at half the height, of the frequency
KALICO = """
import json, sys
import numpy
from klippy.extras.shaper_calibrate import ShaperCalibrate
found = ShaperCalibrate(None).process_accelerometer_data(numpy.load(sys.argv[1]))
print(json.dumps([found.freq_bins.tolist(), found.psd_sum.tolist()]))
"""


def main(sections: Sequence[str]) -> None:
    """Measure the sections, or all, and write the results and the page."""
    for name in sections or SECTIONS:
        save("identification", SECTIONS[name]())


# ---- lab -----------------------------------------------------------------------------------------


def lab() -> dict[str, Any]:
    """Return the tables of the paper, and the parameters that are recovered."""
    truth = delta_plant.load_machine(LIBRARY / "mp-delta-pro.toml")
    real, smooth = uneven(truth, seed=0, friction_n=1.0), uneven(truth, seed=0, friction_n=0.0)
    studies = [
        study("Uneven towers, 1 N of dry friction in each guide, 40 dB", real),
        study("The same without friction", smooth),
    ]
    places = [place[:2] for place in PLACES]
    return {"places_mm": places, "studies": studies, "parameters": parameters(truth)}


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


def complex_log_error(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Compute the rms of |ln(P/M)|: relative errors of magnitude and phase (rad) at once, on the nearest branch."""
    ratio = predicted / measured
    return float(np.sqrt(np.mean(np.log(np.abs(ratio)) ** 2 + np.angle(ratio) ** 2)))


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


# ---- axes ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """The worst errors of some machines, each with its truth."""

    frequency: float
    damping: float
    share: float
    wrong: int  # machines whose number of modes was not found


def axes() -> dict[str, Any]:
    """Return what is found of simulated axes, and of real ones where their spectra are here."""
    found: dict[str, Any] = {"axes_machines": MACHINES, "axes_simulated": simulated_axes()}
    spectra = sorted((FILES / "klipper_resonances_bassco").glob("*.csv"))
    return found | ({"axes_real": [real_spectrum(path) for path in spectra]} if spectra else {})


def simulated_axes() -> list[dict[str, Any]]:
    """Identify machines whose modes are known from simulated resonance tests."""
    rows = []
    for noise in NOISES:
        for count in (1, 2):
            row = _row(count, noise)
            rows.append(
                {
                    "noise_m_per_s2": noise,
                    "modes": count,
                    "wrong": row.wrong,
                    "frequency_percent": 100 * row.frequency,
                    "damping_percent": 100 * row.damping,
                    "share": row.share,
                }
            )
    return rows


def _row(count: int, noise: float) -> Row:
    rng = np.random.default_rng(count)
    worst, wrong = np.zeros(3), 0
    for seed in range(MACHINES):
        true = _drawn(rng, count)
        found = _identified(true, noise, seed)
        if len(found.modes) != count:
            wrong += 1
            continue
        table = [[m.frequency_hz.value, m.damping_ratio.value, m.share.value] for m in found.modes]
        error = np.abs(np.array(table) - true) / [[f, z, 1.0] for f, z, _ in true]
        worst = np.maximum(worst, error.max(axis=0))
    frequency, damping, share = worst.tolist()
    return Row(frequency, damping, share, wrong)


def _drawn(rng: np.random.Generator, count: int) -> FloatArray:
    """(m, 3) frequency Hz, damping ratio, share; the larger share first."""
    first, share = rng.uniform(25, 70), rng.uniform(0.6, 0.9)
    dampings = rng.uniform(0.03, 0.12, 2)
    if count == 1:
        return np.array([[first, dampings[0], 1.0]])
    second = min(first * rng.uniform(1.35, 2.2), 115.0)
    return np.array([[first, dampings[0], share], [second, dampings[1], 1 - share]])


def _identified(modes: FloatArray, noise: float, seed: int) -> AxisFit:
    """From a capture as the firmware writes it."""
    box = CartesianKinematics(constant([[0, 200]] * 3), CARTESIAN)
    axes = ModalAxes.of([Axis(*modes.T.tolist()), Axis(), Axis()])
    machine = Machine("truth", box, axes, MotionLimits(200.0, 3000.0))
    felt = resonance_test(machine, np.zeros(2), "x")
    felt = felt + 1e3 * np.random.default_rng(seed).normal(0, noise, felt.shape)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "raw_data_x_made.csv")
        rows = np.column_stack([np.arange(len(felt)) / 800, felt])
        np.savetxt(path, rows, fmt="%.5f", delimiter=",", header="#time,accel_x,accel_y,accel_z", comments="")
        spectrum = spectrum_of(path, None, BAND_HZ)
    assert isinstance(spectrum, Spectrum), spectrum
    return fit_axis("x", [spectrum])


def real_spectrum(path: Path) -> dict[str, Any]:
    """Return what is found in a measured spectrum, and what the firmware's calibration makes of it."""
    return {"file": path.stem.replace("__", " ")} | modes_of(path) | shapers_of(path)


def modes_of(path: Path) -> dict[str, Any]:
    nothing: dict[str, Any] = {"problem": None, "modes": [], "summed": False, "unexplained": None}
    spectrum = spectrum_of(path, None, BAND_HZ)
    if not isinstance(spectrum, Spectrum):
        return nothing | {"problem": str(spectrum)}
    try:
        found = fit_axis(spectrum.axis, [spectrum])
    except MeasurementError as error:
        return nothing | {"problem": error.problems[0].partition(":")[0]}
    modes = [
        {
            "frequency_hz": m.frequency_hz.value,
            "frequency_sd_hz": m.frequency_hz.sd,
            "damping_ratio": m.damping_ratio.value,
            "share": m.share.value,
        }
        for m in found.modes
    ]
    return nothing | {"modes": modes, "summed": bool(spectrum.remark), "unexplained": found.errors[0]}


def shapers_of(path: Path) -> dict[str, Any]:
    (file,) = read_vibrations(path)
    assert isinstance(file, Resonances)
    spectrum = (file.frequency_hz, file.psd["xyz"]) if file.normalised else normalised(*file.power("xyz"))
    found = fits(spectrum)
    frequencies = {kind: found[kind].frequency_hz for kind in ("zv", "mzv", "ei")}
    return {"shapers_hz": frequencies, "recommended": recommended(found.values()).kind}


# ---- files ---------------------------------------------------------------------------------------


def files() -> dict[str, Any]:
    """Return what is said of every file."""
    found = sorted(p for p in FILES.rglob("*") if p.suffix in (".csv", ".stdata"))
    return {"vibration_files": [vibration_file(path) for path in found]} if found else {}


def vibration_file(path: Path) -> dict[str, Any]:
    """Return what is said of a file, and how far it is from the firmware's peak."""
    firmware = peak_of(path)
    found: dict[str, Any] = {"file": path.stem.replace("__", " "), "modes_hz": [], "sentence": "", "left": None}
    try:
        result = ffcomp.identify(path, PRINTER).to_dict()
        axis = next(iter(result["axes"].values()))
        found["modes_hz"] = [mode["frequency_hz"]["value"] for mode in axis["modes"]]
        found["left"] = axis["data"][0]["model_error"]
    except FfcompError as error:
        found["sentence"] = sentence_of(str(error), path)
    hz = firmware["peak_hz"]
    near = min(found["modes_hz"], key=lambda f: abs(f - hz), default=None) if hz else None
    return found | firmware | {"nearest_hz": near, "difference": near / hz - 1 if near and hz else None}


def sentence_of(text: str, path: Path) -> str:
    """Return the first sentence about a file, without its name."""
    line = next((each for each in text.splitlines() if each.strip()), "")
    for prefix in ("data: ", f"{path}: ", f"{path.name}: "):
        line = line.removeprefix(prefix)
    return line.partition(". ")[0].rstrip(".")


def peak_of(path: Path) -> dict[str, Any]:
    """Return the highest peak of the firmware's spectrum, Hz, and whether it is clear; None: there is no sweep."""
    nothing = {"peak_hz": None, "clear": False}
    first = read_vibrations(path)[0]
    if isinstance(first, Capture):
        if float(first.time_s[-1] - first.time_s[0]) < 10.0:  # no resonance test
            return nothing
        frequency, power = kalico_spectrum(first)
        power = power / (frequency + 0.1)
    else:
        if "xyz" not in first.psd:
            return nothing
        frequency, power = first.frequency_hz, first.psd["xyz"]
        if not first.normalised:
            power = power / (frequency + 0.1)
    keep = (frequency >= PEAKS_HZ[0]) & (frequency <= PEAKS_HZ[1])
    return clear_peak(frequency[keep], power[keep])


def clear_peak(frequency: FloatArray, power: FloatArray) -> dict[str, Any]:
    """Find the highest peak, and whether it is narrow and no other one reaches half of it."""
    top = int(np.argmax(power))
    others, _ = find_peaks(power, height=OTHER_PEAK * power[top])
    high = frequency[power >= 0.5 * power[top]]
    narrow = high[-1] - high[0] < NARROW * frequency[top]
    return {"peak_hz": float(frequency[top]), "clear": bool(narrow and set(others) <= {top})}


def kalico_spectrum(capture: Capture) -> tuple[FloatArray, FloatArray]:
    """Let Kalico compute the spectrum of a capture: (k,) Hz and (k,) mm²/s⁴/Hz."""
    python = os.environ.get("KALICO_PYTHON", sys.executable)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "samples.npy")
        rows = np.column_stack([capture.time_s, 1e3 * capture.acceleration])
        np.save(file, rows[np.isfinite(rows).all(axis=1)])
        done = subprocess.run([python, "-c", KALICO, str(file)], capture_output=True, text=True, check=True)
    frequency, power = json.loads(done.stdout)
    return np.array(frequency), np.array(power)


SECTIONS: dict[str, Callable[[], dict[str, Any]]] = {"lab": lab, "axes": axes, "files": files}

if __name__ == "__main__":
    main(sys.argv[1:])
