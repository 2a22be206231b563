"""Every vibration file measured by others: what `ffcomp identify fit` says of it, beside the firmware's own spectrum.

    python -m studies.vibration_files     its section of studies/reports/identification.md, a minute

The firmware's own tool is Kalico's: captures are handed to its code in a process of its own (KALICO_PYTHON names the
Python that has it; it is GPL and never imported), spectra are what such firmware wrote. Its peak is that of the power
of all axes over the frequency, as its calibration uses it. It counts as clear where no other one reaches half of it,
and where at half its height it is narrower than a fifth of its frequency.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

import ffcomp
from ffcomp.errors import FfcompError
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.vibration import read_vibrations
from studies.render import save

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data")) / "vibration"
MACHINE = "voron-300"
BAND_HZ = (10.0, 130.0)
OTHER_PEAK = 0.5  # of the highest: from there on the peak is not clear
NARROW = 0.2  # width at half the height, of the frequency
KALICO = """
import json, sys
import numpy
from klippy.extras.shaper_calibrate import ShaperCalibrate
found = ShaperCalibrate(None).process_accelerometer_data(numpy.load(sys.argv[1]))
print(json.dumps([found.freq_bins.tolist(), found.psd_sum.tolist()]))
"""


def main() -> None:
    """Go through all files, and write the results and the page."""
    files = sorted(p for p in DATA.rglob("*") if p.suffix in (".csv", ".tsv", ".stdata"))
    save("identification", {"vibration_files": [row(path) for path in files]})


def row(path: Path) -> dict[str, Any]:
    """Return what is said of a file, and how far it is from the firmware's peak."""
    firmware = peak_of(path)
    found: dict[str, Any] = {"file": path.stem.replace("__", " "), "modes_hz": [], "sentence": "", "left": None}
    try:
        result = ffcomp.identify(path, MACHINE).to_dict()
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
    keep = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
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


if __name__ == "__main__":
    main()
