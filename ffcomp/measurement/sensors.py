"""Checks of sensors: alive, within range, free of gravity, and in the unit of their name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import butter, sosfiltfilt

from models.arrays import FloatArray, IntArray

_LARGEST_GAP_SHARE = 0.5
_CLIPPED_ROWS = 8  # so many at the extreme before it can be called clipping
_CLIPPED_PILE = 10  # times as many at the extreme as on the levels next to it
_LEVELS_TO_JUDGE = 24  # a signal of fewer levels touches its extremes anyway
_PLAUSIBLE_GAIN = (0.3, 30.0)  # of acceleration against the command's, at low frequency (rows of J: 0.6 to 2)
_SCALE_BAND_HZ = 20.0  # far below the first mode, where the machine follows its command
_MUCH = 0.3  # of the command that moves most
_SINGULAR = 0.05  # of the largest singular value: below, commands move in proportion
_SCALE_R2 = 0.5  # of the sensor explained by the command, before the gain means anything
G = 9.80665  # m/s²
_UNITS = {"mm/s²": 1000.0, "mg": 1000 / G, "cm/s²": 100.0, "g": 1 / G, "km/s²": 1e-3}
_HEIGHTS_MM = (30.0, 3000.0)  # of a delta's carriages above its bed
_LENGTHS = {"m": 1000.0, "cm": 10.0, "inches": 25.4, "µm": 1e-3}  # mm
_LARGEST_MEAN = 2.0  # m/s²: from rest to rest the mean is zero, and sensors' zeros are off by up to half of this
_NEARLY_G = 0.1  # of g


def broken_sensor(name: str, values: FloatArray, row: IntArray) -> list[str]:
    """List the problems of one column (n,) by itself, in full sentences."""
    known = np.isfinite(values)
    if not known.any():
        return [f"Column {name} holds no number at all; leave a missing sensor's column out."]
    if 1 - known.mean() > _LARGEST_GAP_SHARE:
        return [f"Column {name} is missing in {1 - known.mean():.0%} of the rows; at most half may be."]
    if name.startswith("cmd_"):
        return []  # a command may rest, and has plateaus at its extremes
    if np.ptp(values[known]) == 0:
        same = f"is {values[known][0]:.6g} in all {known.sum()} rows"
        return [f"Column {name} {same}; a sensor that works is never still."]
    return _clipped(name, values[known], row[known]) if name.startswith("acc_") else []


def _clipped(name: str, values: FloatArray, row: IntArray) -> list[str]:
    """Report a clipped sensor, which piles up at its extreme everything beyond; a quantised one does not.

    The top level of a quantised sine holds at most 2.4 times as many samples as the next one.
    """
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < _LEVELS_TO_JUDGE:
        return []
    ends = [
        f"stands at its {word} value {level:.6g} in {count} rows, first at row {row[values == level][0]}"
        for word, level, count, nearby in (
            ("lowest", float(levels[0]), int(counts[0]), counts[1:4]),
            ("highest", float(levels[-1]), int(counts[-1]), counts[-4:-1]),
        )
        if count >= max(_CLIPPED_ROWS, _CLIPPED_PILE * float(nearby.mean()))
    ]
    return [f"Column {name} {end}: it is clipped. Measure with a wider range or a smaller motion." for end in ends]


def with_gravity(acceleration: Mapping[str, FloatArray]) -> list[str]:
    """Report accelerations (n,) m/s² with a mean: a motion that begins and ends at rest has none."""
    means = {name: float(np.nanmean(values)) for name, values in acceleration.items()}
    return [_gravity(name, mean) for name, mean in means.items() if abs(mean) > _LARGEST_MEAN]


def _gravity(name: str, mean: float) -> str:
    what = "gravity" if abs(abs(mean) / G - 1) < _NEARLY_G else "gravity on a tilted sensor, or an offset,"
    return (
        f"Column {name}_m_per_s2 has a mean of {mean:.4g} m/s², and a motion from rest to rest has none: {what} is "
        f"still in it. Subtract {mean:.4g} from the column."
    )


def wrong_scale(
    command: FloatArray, inputs: Sequence[str], acceleration: Mapping[str, FloatArray], rate_hz: float
) -> list[str]:
    """Report accelerations whose size does not fit the command's own, in full sentences.

    Below 20 Hz the machine follows its command: a carriage its own, any other sensor a linear combination of all
    three with coefficients of order one, or less: in a plane a sensor of z feels nearly nothing. So too small is only
    what has a command of its own that moves it. Where a sensor follows none (noise, a command too fast or at rest),
    nothing is reported.

    Parameters
    ----------
    command : (n, 3) mm.
    inputs : the names of its columns.
    acceleration : name → (n,) m/s², NaN where missing.
    """
    low = butter(4, _SCALE_BAND_HZ, fs=rate_hz, output="sos")
    commanded = sosfiltfilt(low, _second_derivative(command * 1e-3, rate_hz), axis=0)
    gains = {}
    for name, values in acceleration.items():
        basis, own = _moving_with(name.replace("acc", "cmd"), inputs, commanded)
        gains[name] = _gain(sosfiltfilt(low, np.nan_to_num(values)), basis, _PLAUSIBLE_GAIN[0] if own else 0.0)
    wrong = [_too_large(name, gain) for name, gain in gains.items() if gain is not None]
    if not wrong or inputs[0] == "cmd_A":
        return (wrong and command_unit(command, inputs)) or wrong
    return wrong + _all_alike(list(gains.values()))


def _moving_with(own: str, inputs: Sequence[str], commanded: FloatArray) -> tuple[FloatArray, bool]:
    """Select the sensor's own command, if it moves much; else all of them, and tell which."""
    size = commanded.std(axis=0)
    j = list(inputs).index(own) if own in inputs else -1
    alone = j >= 0 and bool(size[j] > _MUCH * float(size.max()))
    return (commanded[:, [j]] if alone else commanded), alone


def _gain(measured: FloatArray, basis: FloatArray, lowest: float) -> float | None:
    """Compute how many times as large as its command a sensor is; None where that is plausible, or unclear.

    lowest : from which it is plausible; 0 where commands may leave a sensor still that works.
    """
    coefficients = np.linalg.lstsq(basis, measured, rcond=_SINGULAR)[0]
    explained = float((basis @ coefficients).var()) / max(float(measured.var()), 1e-300)
    gain = float(np.linalg.norm(coefficients))
    return None if explained < _SCALE_R2 or lowest <= gain < _PLAUSIBLE_GAIN[1] else gain


def _too_large(name: str, gain: float) -> str:
    unit = _unit_of(gain)
    factor = _UNITS[unit]
    looks = f"{factor:.4g} times too large" if factor > 1 else f"{1 / factor:.3g} times too small"
    return (
        f"Column {name}_m_per_s2 looks {looks}, as if it were in {unit}, not in m/s²: below {_SCALE_BAND_HZ:g} Hz it "
        f"is {gain:.3g} times the acceleration commanded, where about 1 is right. Multiply it by {1 / factor:.6g}."
    )


def _unit_of(gain: float) -> str:
    return min(_UNITS, key=lambda unit: abs(np.log(_UNITS[unit] / gain)))


def _all_alike(gains: Sequence[float | None]) -> list[str]:
    """Report a factor that all sensors share: it may be the nozzle's command that is wrong."""
    units = {None if gain is None else _unit_of(gain) for gain in gains}
    unit = {"mm/s²": "m", "km/s²": "µm"}.get(units.pop() or "") if len(units) == 1 < len(gains) else None
    return [f"All sensors are off by this factor: or is it the command, in {unit} and not in mm?"] if unit else []


def command_unit(command: FloatArray, inputs: Sequence[str]) -> list[str]:
    """Report carriages (n, 3) at heights that no delta has, but would have in another unit."""
    if inputs[0] != "cmd_A":
        return []
    sentences = []
    for name, height in zip(inputs, command.mean(axis=0), strict=True):
        units = [unit for unit, mm in _LENGTHS.items() if _HEIGHTS_MM[0] < height * mm < _HEIGHTS_MM[1]]
        if units and not _HEIGHTS_MM[0] < height < _HEIGHTS_MM[1]:
            sentences.append(
                f"Column {name}_mm has a mean of {height:.4g}, which no carriage's height in mm is: it looks as if it "
                f"were in {' or '.join(units)}. Multiply it by {' or '.join(f'{_LENGTHS[u]:g}' for u in units)}."
            )
    return sentences


def _second_derivative(position: FloatArray, rate_hz: float) -> FloatArray:
    """Differentiate a position (n, 3) twice, at rest before and after."""
    inner = np.diff(position, 2, axis=0) * rate_hz**2
    return np.pad(inner, ((1, 1), (0, 0)))
