"""Straight axes from a firmware's resonance tests: simulated ones, whose truth is known, and real printers'.

    python -m studies.identification_axes --write     the last section of docs/IDENTIFICATION.md, a minute

The simulated tests pass the response of the modes' sum, with white noise in every sample; an ADXL345 read 3200 times a
second has 0.15 m/s², which is 0.08 m/s² here. The real spectra are read from ../shared/data or FFCOMP_DATA.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import MeasurementError
from ffcomp.identify.axis_spectra import Spectrum, spectrum_of
from ffcomp.identify.modal_fit import AxisFit, fit_axis
from ffcomp.measurement.klipper import Resonances, read_vibration
from ffcomp.shapers.calibration import calibrated, normalised, resonance_test
from models.arrays import constant
from models.kinematics.cartesian import CARTESIAN, CartesianKinematics
from models.machine import Machine, MotionLimits
from models.vibration.modal import Axis, parts

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data")) / "vibration" / "klipper_resonances_bassco"
PAGE, BEGIN = ROOT / "docs" / "IDENTIFICATION.md", "\n## Cartesian and CoreXY machines\n"
NOISES = (0.08, 0.25, 0.8)  # m/s² in each of 800 samples a second
MACHINES = 16  # of each number of modes
BAND_HZ = (2.0, 400.0)
HOW_TO = """
Made by `python -m studies.identification_axes --write`.

Each axis of such a machine is one mode or two (`models/vibration/modal.py`). `ffcomp identify fit` finds their
frequencies, damping ratios and shares from any of these, together if there are several:

- captures of a firmware's resonance test, `raw_data_x_*.csv`, or its spectra, `resonances_x_*.csv` and
  `calibration_data_x_*.csv`. The axis is in the name; `--axis x` says it where it is not;
- captures of `ffcomp identify plan`, with `--plan`;
- frequency responses (CSV, UFF 58) of `cmd_x` to `acc_x` or `pos_x`;
- measured runs, which may be whole prints: straight axes answer alike everywhere.

<!-- not run: it needs captures of a printer -->
```sh
ffcomp identify fit raw_data_x_*.csv raw_data_y_*.csv -m voron-300 -o mine.toml --figure fit.png
```

A spectrum holds no phase, but the test's power is known to go with f²: so where the axis does not vibrate yet, the
spectrum says how large the command was, and the heights of the peaks over that say damping and shares. A second mode is
written only where the Bayesian information criterion asks for it, residuals of neighbouring lines counted as fewer, and
where its frequency is known to 5 % and its share is two standard uncertainties from zero. What the modes leave
unexplained is printed as a share of the measured values. Where an axis is told to worse than 35 %, the file says little
about it.

What cannot be had from it: a second peak that swings against the first (its share would be negative), a third one, and
what one axis does to another. The first two show in the figure, the third is said.
"""


@dataclass(frozen=True)
class Row:
    """The worst errors of some machines, each with its truth."""

    frequency: float
    damping: float
    share: float
    wrong: int  # machines whose number of modes was not found


def main() -> None:
    text = BEGIN + HOW_TO + "".join(f"{line}\n" for line in [*simulated(), *real()])
    if "--write" not in sys.argv:
        print(text)
        return
    page = PAGE.read_text(encoding="utf-8").split(BEGIN)[0]
    PAGE.write_text(page + text, encoding="utf-8")


# ---- simulated tests -----------------------------------------------------------------------------


def simulated() -> Iterator[str]:
    yield f"\n### Simulated resonance tests, {2 * MACHINES} machines\n"
    yield "Modes drawn at random: 25 to 70 Hz, damping ratio 0.03 to 0.12; a second one 1.35 to 2.2 times as high with"
    yield "a share of 0.1 to 0.4. Errors are the worst of all.\n"
    yield "| noise, m/s² | modes | wrong number found | frequency, % | damping, % | share |"
    yield "|---|---|---|---|---|---|"
    for noise in NOISES:
        for count in (1, 2):
            row = _row(count, noise)
            errors = f"{100 * row.frequency:.2f} | {100 * row.damping:.1f} | {row.share:.3f}"
            yield f"| {noise:g} | {count} | {row.wrong} of {MACHINES} | {errors} |"


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
    return Row(*worst.tolist(), wrong)


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
    vibrating = parts([Axis(*modes.T.tolist()), Axis(), Axis()])
    machine = Machine("truth", box, limits=MotionLimits(200.0, 3000.0), **vibrating)
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


def real() -> Iterator[str]:
    files = sorted(DATA.glob("*.csv"))
    if not files:
        return
    yield "\n### Real printers\n"
    yield "Spectra measured by others, beside the frequencies that a firmware's own calibration of the same file gives"
    yield "its shapers (what it recommends in bold). Where several peaks stand side by side, a shaper's frequency is a"
    yield "compromise between them. *Sum*: the sensor was not mounted along the axis, so its axes were added up.\n"
    yield "| file | modes: Hz, damping ratio, share | unexplained | ZV | MZV | EI |"
    yield "|---|---|---|---|---|---|"
    for path in files:
        yield f"| {path.stem.replace('__', ' ')} | {_told(path)} | {_shapers(path)} |"


def _told(path: Path) -> str:
    spectrum = spectrum_of(path, None, BAND_HZ)
    if isinstance(spectrum, str):
        return f"{spectrum} | -"
    try:
        found = fit_axis(spectrum.axis, [spectrum])
    except MeasurementError as error:
        return f"{error.problems[0].partition(':')[0]} | -"
    modes = "; ".join(
        f"{m.frequency_hz.value:.1f} ± {m.frequency_hz.sd:.1f}, {m.damping_ratio.value:.3f}, {m.share.value:.2f}"
        for m in found.modes
    )
    return f"{modes}{' *sum*' if spectrum.remark else ''} | {100 * found.errors[0]:.0f} %"


def _shapers(path: Path) -> str:
    file = read_vibration(path)
    assert isinstance(file, Resonances)
    spectrum = (file.frequency_hz, file.psd["xyz"]) if file.normalised else normalised(*file.power("xyz"))
    found = calibrated(spectrum, spectrum)[0]
    cells = [f"{found.fits[kind].frequency_hz:.1f}" for kind in ("zv", "mzv", "ei")]
    chosen = ("zv", "mzv", "ei").index(found.recommended.kind) if found.recommended.kind in ("zv", "mzv", "ei") else -1
    return " | ".join(f"**{cell}**" if i == chosen else cell for i, cell in enumerate(cells))


if __name__ == "__main__":
    main()
