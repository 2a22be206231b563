"""Straight axes from a firmware's resonance tests: simulated ones, whose truth is known, and real printers'.

    python -m studies.identification_axes     the last section of studies/reports/identification.md, a minute

The simulated tests pass the response of the modes' sum, with white noise in every sample; an ADXL345 read 3200 times a
second has 0.15 m/s², which is 0.08 m/s² here. The real spectra are read from ../shared/data or FFCOMP_DATA.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_spectra import Spectrum
from ffcomp.identification.modal_fit import AxisFit, fit_axis
from ffcomp.identification.resonance_tests import spectrum_of
from ffcomp.measurement.klipper import Resonances
from ffcomp.measurement.vibration import read_vibration
from ffcomp.shapers.calibration import calibrated, normalised, resonance_test
from models.arrays import constant
from models.kinematics.cartesian import CARTESIAN, CartesianKinematics
from models.machine import Machine, MotionLimits
from models.vibration.modal import Axis, ModalAxes
from studies.render import save

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data")) / "vibration" / "klipper_resonances_bassco"
NOISES = (0.08, 0.25, 0.8)  # m/s² in each of 800 samples a second
MACHINES = 16  # of each number of modes
BAND_HZ = (2.0, 400.0)


@dataclass(frozen=True)
class Row:
    """The worst errors of some machines, each with its truth."""

    frequency: float
    damping: float
    share: float
    wrong: int  # machines whose number of modes was not found


def main() -> None:
    """Measure, and write the results and the page."""
    found = {"axes_machines": MACHINES, "axes_simulated": simulated()}
    files = sorted(DATA.glob("*.csv"))
    save("identification", found | ({"axes_real": [real(path) for path in files]} if files else {}))


# ---- simulated tests -----------------------------------------------------------------------------


def simulated() -> list[dict[str, Any]]:
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


# ---- real printers -------------------------------------------------------------------------------


def real(path: Path) -> dict[str, Any]:
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
    file = read_vibration(path)
    assert isinstance(file, Resonances)
    spectrum = (file.frequency_hz, file.psd["xyz"]) if file.normalised else normalised(*file.power("xyz"))
    found = calibrated(spectrum, spectrum)[0]
    frequencies = {kind: found.fits[kind].frequency_hz for kind in ("zv", "mzv", "ei")}
    return {"shapers_hz": frequencies, "recommended": found.recommended.kind}


if __name__ == "__main__":
    main()
