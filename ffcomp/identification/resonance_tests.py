"""Captures and spectra of a firmware's resonance tests, as data that modes or belts are fitted to.

A test excites x, y, z, or a direction of x and y: a belt of a CoreXY machine, or a tower of a delta. A file
without a test is left out, with a sentence that says why.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffcomp.identification.axis_spectra import USUAL_AVERAGES, Spectrum
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.frf import AXES
from ffcomp.measurement.swept import HIGHEST_HZ, fitted_band, segment_powers, swept_band, swept_band_of_spectrum
from ffcomp.measurement.vibration import Resonances, read_vibrations
from models.arrays import FloatArray

FEWEST_LINES = 20  # of one file, in the band

TestFile = Capture | Resonances


@dataclass(frozen=True, eq=False)
class BeltTest:
    """A test along one direction of x and y: the power of all the sensor's axes, however it is mounted."""

    spectrum: Spectrum
    direction: FloatArray  # (2,) unit vector
    position_mm: tuple[float, float] | None  # None: not stated

    @property
    def axis(self) -> str:
        """The direction as people give it to the firmware."""
        return direction_name(self.direction)


def direction_name(direction: FloatArray) -> str:
    """Return a unit vector (2,) as people give it to the firmware, up to a factor: 1,-1 or 0.866,-0.5."""
    x, y = direction.tolist()
    scale = abs(x) if abs(abs(x) - abs(y)) < 1e-3 else 1.0
    return ",".join(f"{round(c / scale, 3) + 0.0:g}" for c in (x, y))


def no_test(test: TestFile) -> str:
    """Say in a sentence why a file holds no resonance test; '' if it may be one."""
    if isinstance(test, Resonances) or swept_band(test) is not None:
        return ""
    name, seconds = file_and_name(test), float(test.time_s[-1] - test.time_s[0])
    return (
        f"{name}: there is no sweep in its {seconds:.3g} s, so it is no capture of a resonance test. Run the "
        "firmware's (Klipper: TEST_RESONANCES AXIS=X OUTPUT=raw_data), or `ffcomp record plan --for identify`."
    )


def direction_of(axis: str | None) -> FloatArray | None:
    """Return the unit vector (2,) of an axis such as 'axis=1.000,-1.000' or '1,-1'; None: it is x, y, z or unknown.

    Raises ValueError if it is neither.
    """
    if axis is None or axis in AXES:
        return None
    parts = np.array([float(part) for part in axis.removeprefix("axis=").split(",")])
    size = float(np.linalg.norm(parts[:2]))
    if len(parts) not in (2, 3) or not np.isfinite(size) or size == 0 or parts[2:].any():
        raise ValueError(axis)
    return np.asarray(parts[:2] / size)


def spectrum_of(path: Path, stated_axis: str | None, band_hz: tuple[float, float]) -> Spectrum | BeltTest | str:
    """Read the one resonance test of a file; see `read_test`."""
    (test,) = read_vibrations(path)
    return no_test(test) or read_test(test, test.axis or stated_axis, band_hz)


def read_test(
    test: TestFile, axis: str | None, band_hz: tuple[float, float], column: str | None = None
) -> Spectrum | BeltTest | str:
    """Read a resonance test, or return a sentence that says why it is of no use.

    axis : the excited axis; None: not known
    column : the spectrum to be taken, of a file with several

    Raises MeasurementError if there are several spectra and no rule selects one.
    """
    name = file_and_name(test)
    if axis is None:
        return f"{name}: the excited axis is not stated. Say --axis x or y."
    try:
        direction = direction_of(axis)
    except ValueError:
        return f"{name}: {axis!r} is no axis; it is x, y, z or a direction as 1,-1."
    if direction is None:
        return _cut(test, axis, *_powers(test, axis, column), band_hz)
    if isinstance(test, Resonances):
        (frequency, power), averages = test.total, USUAL_AVERAGES
    else:
        frequency, segments = segment_powers(test, [0, 1, 2])
        power, averages = segments.mean(axis=0), len(segments)
    spectrum = _cut(test, "", frequency, {"all": power}, averages, band_hz)
    if isinstance(spectrum, str):
        return spectrum
    return BeltTest(spectrum, direction, None if test.position_mm is None else test.position_mm[:2])


def _powers(test: TestFile, axis: str, column: str | None) -> tuple[FloatArray, dict[str, FloatArray], int]:
    """Return frequencies (k,), the power (k,) along each axis or along the one that is certain, and averages."""
    if isinstance(test, Capture):
        segments = {letter: segment_powers(test, [i]) for i, letter in enumerate(AXES)}
        frequency, first = segments["x"]
        return frequency, {letter: each.mean(axis=0) for letter, (_, each) in segments.items()}, len(first)
    if test.by_axis and column is None:
        each = {name: test.power(name) for name in test.psd}
        return next(iter(each.values()))[0], {name: power for name, (_, power) in each.items()}, USUAL_AVERAGES
    frequency, power = test.power(test.chosen(column))
    return frequency, {axis: power}, USUAL_AVERAGES


def _cut(
    test: TestFile,
    axis: str,
    frequency: FloatArray,
    powers: Mapping[str, FloatArray],
    averages: int,
    band_hz: tuple[float, float],
) -> Spectrum | str:
    """Cut the excited band out; axis "": there is one power, of all axes."""
    name = file_and_name(test)
    swept = swept_band(test) if isinstance(test, Capture) else swept_band_of_spectrum(*test.total)
    lowest, highest = fitted_band(frequency, swept)
    low, high = max(lowest, band_hz[0]), min(highest, band_hz[1])
    inside = (frequency >= low) & (frequency <= high)
    if axis and axis not in powers:
        return f"{name}: there is no spectrum along {axis} in it, only {', '.join(powers)}."
    if inside.sum() < FEWEST_LINES:
        remedy = f" {swept.remedy}" if swept is not None else ""
        return (
            f"{name}: {inside.sum()} lines between {low:.3g} and {high:.3g} Hz are too few; {FEWEST_LINES} are "
            f"needed.{remedy}"
        )
    each = {letter: power[inside] for letter, power in powers.items()}
    power, remark = _along_axis(each, axis, name) if axis else (next(iter(each.values())), "")
    kept = frequency[inside][power > 0]
    even = np.linspace(kept[0], kept[-1], len(kept))  # files round
    short = swept if swept is not None and swept.high_hz < HIGHEST_HZ else None
    return Spectrum(name, axis, even, power[power > 0], averages, remark, short)


def file_and_name(test: TestFile) -> str:
    """Return the file's name, and the measurement's where a file holds several."""
    file = Path(test.source).name
    named = test.name if isinstance(test, Capture) else ""
    return f"{file} ({named})" if named and named not in file else file


def _along_axis(powers: Mapping[str, FloatArray], axis: str, name: str) -> tuple[FloatArray, str]:
    """Return the power along the excited axis; of all three where the sensor is not mounted along the axes."""
    along = {letter: float(powers[letter].sum()) for letter in AXES if letter in powers}
    strongest = max(along, key=lambda letter: along[letter])
    if strongest == axis:
        return powers[axis], ""
    remark = (
        f"{name}: {axis} was excited, but the sensor's {strongest} shows {along[strongest] / along[axis]:.1f} times as "
        "much, so the sum of its axes was taken. Are its axes the printer's (axes_map in the firmware's settings)?"
    )
    return np.sum([powers[letter] for letter in along], axis=0), remark
