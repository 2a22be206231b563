"""Checks of sensors: alive, within range, free of gravity, and true to the unit and the axis of their name.

Below 20 Hz any printer follows its command. Swapped and reversed columns, a sensor turned against the axes, a dead one
and a late record look like huge effects of the machine, and no model explains them. Errors that low frequencies do not
show are left to the diagnosis. Faults of whole recordings are in `faults.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import butter, fftconvolve, sosfiltfilt
from scipy.signal.windows import tukey

from models.arrays import FloatArray, IntArray

G = 9.80665  # m/s²

# of a column by itself
_UNITS = {"mm/s²": 1000.0, "mg": 1000 / G, "cm/s²": 100.0, "g": 1 / G, "km/s²": 1e-3}
_LENGTHS = {"m": 1000.0, "cm": 10.0, "inches": 25.4, "µm": 1e-3}  # mm
_HEIGHTS_MM = (30.0, 3000.0)  # of a delta's carriages above its bed
_LEAST_CLIPPED_ROWS = 8  # at the extreme, before it can be called clipping
_CLIPPED_TIMES = 10  # as many at the extreme as on the levels next to it
_LEAST_LEVELS = 24  # a signal of fewer levels touches its extremes anyway
_LARGEST_MEAN = 2.0  # m/s²: from rest to rest the mean is zero, and sensors' zeros are off by up to half of this
_PLAUSIBLE_GAIN = (0.3, 30.0)  # of acceleration against the command's, at low frequency (rows of J: 0.6 to 2)
_NEAR_UNIT = 2.0  # times: how far off another unit's factor a gain may be, by J
_SCALE_BAND_HZ = 20.0  # far below the first mode, where the machine follows its command
_SINGULAR = 0.05  # of the largest singular value: below, commands move in proportion
_SCALE_R2 = 0.5  # of the sensor explained by the command, before the gain means anything

# against the command
_BAND_HZ = (2.0, 20.0)  # no offsets and drifts, and far below the first mode
_LEAST_CORRELATION = 0.6  # with its command
_REVERSED = -0.9
_ANOTHERS = 0.95  # correlation with another's command, if it is not its own
_DISTINCT = 0.8  # correlation above which two commands cannot be separated
_EXPLAINED = 0.95  # of a sensor's square, by all commands of its kind together
_DEAD = 0.02  # of the expected motion
_LOUD = 0.3  # of the largest command, above which a sensor's own must show
_STUCK_S, _STUCK_MARGIN_S = 0.1, 0.025  # of one and the same value; its ends are not checked
_STUCK_MOTION = 0.3  # of its whole range must the command move in that time
_LATE_S, _LATE_CORRELATION = 0.025, 0.9  # from when a record is late and no sensor slow; how well it must fit then


def broken_sensor(name: str, values: FloatArray, row: IntArray) -> list[str]:
    """List the problems of one column (n,) by itself, in full sentences."""
    known = np.isfinite(values)
    if not known.any():
        return [f"Column {name} holds no number at all; leave a missing sensor's column out."]
    if 1 - known.mean() > 0.5:
        return [f"Column {name} is missing in {1 - known.mean():.0%} of the rows; at most half may be."]
    if name.startswith("cmd_"):
        return []  # a command may rest, and has plateaus at its extremes
    if known.sum() > 1 and np.ptp(values[known]) == 0:
        same = f"is {values[known][0]:.6g} in all {known.sum()} rows"
        return [f"Column {name} {same}; a sensor that works is never still."]
    return _clipped(name, values[known], row[known]) if name.startswith("acc_") else []


def _clipped(name: str, values: FloatArray, row: IntArray) -> list[str]:
    """Report a clipped sensor, which piles up at its extreme everything beyond; a quantised one does not.

    The top level of a quantised sine holds at most 2.4 times as many samples as the next one.
    """
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < _LEAST_LEVELS:
        return []
    ends = [
        f"stands at its {word} value {level:.6g} in {count} rows, first at row {row[values == level][0]}"
        for word, level, count, nearby in (
            ("lowest", float(levels[0]), int(counts[0]), counts[1:4]),
            ("highest", float(levels[-1]), int(counts[-1]), counts[-4:-1]),
        )
        if count >= max(_LEAST_CLIPPED_ROWS, _CLIPPED_TIMES * float(nearby.mean()))
    ]
    return [f"Column {name} {end}: it is clipped. Measure with a wider range or a smaller motion." for end in ends]


def with_gravity(acceleration: Mapping[str, FloatArray]) -> list[str]:
    """Report accelerations (n,) m/s² with a mean: a motion that begins and ends at rest has none."""
    sentences = []
    for name, values in acceleration.items():
        mean = float(np.nanmean(values))
        if abs(mean) > _LARGEST_MEAN:
            what = "gravity" if abs(abs(mean) / G - 1) < 0.1 else "gravity on a tilted sensor, or an offset,"
            sentences.append(
                f"Column {name}_m_per_s2 has a mean of {mean:.4g} m/s², and a motion from rest to rest has none: "
                f"{what} is still in it. Subtract {mean:.4g} from the column."
            )
    return sentences


def wrong_scale(
    command: FloatArray, inputs: Sequence[str], acceleration: Mapping[str, FloatArray], rate_hz: float
) -> list[str]:
    """Report accelerations whose size does not fit the command's own, in full sentences.

    Below 20 Hz the machine follows its command: a carriage its own, any other sensor a linear combination of all
    three with coefficients of order one, or less: in a plane a sensor of z feels nearly nothing. So too small is only
    a sensor with its own command that moves it. Where a sensor follows none (noise, a command too fast or at rest),
    nothing is reported. A wrong unit is a chip's: not that of x where its y has the right size.

    command : (n, 3) mm.
    inputs : the names of its columns.
    acceleration : name → (n,) m/s², NaN where missing.
    """
    low = butter(4, _SCALE_BAND_HZ, fs=rate_hz, output="sos")
    commanded = sosfiltfilt(low, _second_derivative(command * 1e-3, rate_hz), axis=0)
    (lowest, highest), chip_is_right, gains = _PLAUSIBLE_GAIN, False, dict[str, float]()
    for name, values in acceleration.items():
        basis, moves_itself = _moving_with(name.replace("acc", "cmd"), inputs, commanded)
        gain = _gain(sosfiltfilt(low, np.nan_to_num(values)), basis)
        if gain >= highest or (moves_itself and gain < lowest):
            gains[name] = gain
        elif moves_itself and gain < highest and name[-1] in "xyz":  # axes of one chip; each carriage has its own
            chip_is_right = True
    wrong = [_wrong_size(name, gain, chip_is_right and name[-1] in "xyz") for name, gain in gains.items()]
    return (wrong and command_unit(command, inputs)) or wrong


def _moving_with(name: str, inputs: Sequence[str], commanded: FloatArray) -> tuple[FloatArray, bool]:
    """Select the sensor's own command if it moves much, else all; return which was taken."""
    size = commanded.std(axis=0)
    j = list(inputs).index(name) if name in inputs else -1
    alone = j >= 0 and bool(size[j] > _LOUD * float(size.max()))
    return (commanded[:, [j]] if alone else commanded), alone


def _gain(measured: FloatArray, basis: FloatArray) -> float:
    """Compute how many times as large as its command a sensor is; NaN where that is unclear."""
    coefficients = np.linalg.lstsq(basis, measured, rcond=_SINGULAR)[0]
    explained = float((basis @ coefficients).var()) / max(float(measured.var()), 1e-300)
    gain = float(np.linalg.norm(coefficients))
    return np.nan if explained < _SCALE_R2 else gain


def _wrong_size(name: str, gain: float, unit_is_right: bool) -> str:
    unit, factor = min(_UNITS.items(), key=lambda each: abs(np.log(each[1] / gain)))
    found = f"below {_SCALE_BAND_HZ:g} Hz it is {gain:.3g} times the acceleration commanded, where about 1 is right"
    if unit_is_right or not 1 / _NEAR_UNIT < gain / factor < _NEAR_UNIT:
        return (
            f"Column {name}_m_per_s2 does not follow its command: {found}, and no other unit explains that. Check the "
            "sensor's range (it may clip), its axes and its mounting."
        )
    looks = f"{factor:.4g} times too large" if factor > 1 else f"{1 / factor:.3g} times too small"
    return (
        f"Column {name}_m_per_s2 looks {looks}, as if it were in {unit}, not in m/s²: {found}. Multiply it by "
        f"{1 / factor:.6g}."
    )


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


# ---- against the command -------------------------------------------------------------------------


def misplaced(measured: Mapping[str, FloatArray], expected: Mapping[str, FloatArray], rate_hz: float) -> list[str]:
    """Report the sensors that do not move along the axis of their name, in full sentences.

    measured : signal (acc_A, pos_x, …) → (n,), NaN where missing. A constant one is ignored.
    expected : the same and other signals of these kinds → (n,), if the printer followed its command exactly.
    """
    telling = {name: x for name, x in measured.items() if np.nanmax(x) > np.nanmin(x)}
    if not telling:
        return []
    signals, reference = _in_band(telling, rate_hz), _in_band(expected, rate_hz)
    odd = [name for name, x in signals.items() if _correlation(x, reference[name]) < _LEAST_CORRELATION]
    late = _late(signals, reference, rate_hz) if odd else ""
    if late:
        return [late]
    stuck = [text for name, x in telling.items() for text in _stuck(name, x, expected[name], rate_hz)]
    return stuck or [sentence for name in odd for sentence in _about(name, signals, reference)]


def _stuck(name: str, measured: FloatArray, expected: FloatArray, rate_hz: float) -> list[str]:
    """Report a sensor that is constant while it should move."""
    begin, end = _longest_rest(measured)
    low = sosfiltfilt(butter(2, _BAND_HZ[1], fs=rate_hz, output="sos"), expected)
    edge = round(_STUCK_MARGIN_S * rate_hz)
    if end - begin < _STUCK_S * rate_hz or np.ptp(low[begin + edge : end - edge]) < _STUCK_MOTION * np.ptp(low):
        return []
    return [
        f"Sensor {name} stands at {measured[begin]:.6g} for {(end - begin) / rate_hz:.3g} s, from "
        f"{begin / rate_hz:.4g} s after the beginning on, while it is commanded to move: it, or its recording, "
        "stopped. Cut the recording there."
    ]


def _longest_rest(x: FloatArray) -> tuple[int, int]:
    """Return the first index of the longest window of one value, and the index behind it."""
    changes = np.flatnonzero(np.diff(x) != 0) + 1
    edges = np.concatenate([[0], changes, [len(x)]])
    k = int(np.diff(edges).argmax())
    return int(edges[k]), int(edges[k + 1])


def _in_band(signals: Mapping[str, FloatArray], rate_hz: float) -> dict[str, FloatArray]:
    band = butter(2, _BAND_HZ, "bandpass", fs=rate_hz, output="sos")
    # NOTE: without fading, the filter takes the noise of the first and the last sample for steps
    window = tukey(len(next(iter(signals.values()))), 0.1)
    return {
        name: np.asarray(sosfiltfilt(band, window * np.nan_to_num(x - np.nanmean(x)), padtype=None))
        for name, x in signals.items()
    }


def _about(name: str, signals: Mapping[str, FloatArray], reference: Mapping[str, FloatArray]) -> list[str]:
    """Say what a sensor does that does not follow its command, as the commands of its kind show it."""
    axes = "ABC" if name[-1] in "ABC" else "xyz"  # the carriages, or the nozzle
    kin = {other: x for other, x in reference.items() if other[:4] == name[:4] and other[-1] in axes}
    measured, commanded = signals[name], kin[name]
    much = _LOUD * max(float(x.std()) for x in kin.values())
    match = _correlation(measured, commanded)
    if max(commanded.std(), measured.std()) < much:
        return []
    if commanded.std() > much and measured.std() < _DEAD * commanded.std():
        return [
            f"Sensor {name} measures {measured.std() / commanded.std():.1%} of the motion that is commanded between "
            f"{_BAND_HZ[0]:g} and {_BAND_HZ[1]:g} Hz: it is dead, not fastened, or in another unit."
        ]
    if match < _REVERSED:
        return [
            f"Sensor {name} moves against its command (correlation {match:.2f}): its axis points the other way, or its "
            "sign is reversed. Multiply its numbers by -1."
        ]
    others = {o: _correlation(measured, x) for o, x in kin.items() if o != name}
    other = max(others, key=lambda o: abs(others[o]))
    if abs(others[other]) >= _ANOTHERS and abs(_correlation(commanded, kin[other])) <= _DISTINCT:
        return [
            f"Sensor {name} moves {'with' if others[other] > 0 else 'against'} the command of {other[-1]} (correlation "
            f"{others[other]:.2f}), not with that of {name[-1]} ({match:.2f}): columns of the sensors or of the "
            "command are swapped, or the order of the towers in the machine file is another."
        ]
    moving = {o: x for o, x in kin.items() if x.std() > much}
    basis = np.column_stack(list(moving.values()))
    share, _, rank, _ = np.linalg.lstsq(basis, measured, rcond=_SINGULAR)
    left = float(np.var(measured - basis @ share)) / max(float(np.var(measured)), 1e-300)
    if rank < len(moving) or left > 1 - _EXPLAINED:
        return []
    mixed = " ".join(f"{c:+.2f} {o[-1]}" for o, c in zip(moving, share, strict=True) if abs(c) > 0.05)
    return [
        f"Sensor {name} moves as {mixed} of the command (correlation with its own {match:.2f}): its axes are "
        "turned against the machine file's, or the order of the towers is another."
    ]


def _late(signals: Mapping[str, FloatArray], reference: Mapping[str, FloatArray], rate_hz: float) -> str:
    """Report a record that fits its command clearly better at another time, in a sentence; '' if it does not."""
    names = [name for name in signals if name.startswith("acc")] or list(signals)
    measured, expected = (np.column_stack([one[name] for name in names]) for one in (signals, reference))
    size = np.linalg.norm(measured) * np.linalg.norm(expected)
    curve = fftconvolve(measured, expected[::-1], axes=0).sum(axis=1) / max(float(size), 1e-300)
    lag = (int(curve.argmax()) - len(expected) + 1) / rate_hz
    if abs(lag) < _LATE_S or curve.max() < _LATE_CORRELATION or curve[len(expected) - 1] > _LEAST_CORRELATION:
        return ""
    return (
        f"The sensors fit the command best {abs(lag):.4g} s {'late' if lag > 0 else 'early'} (correlation "
        f"{curve.max():.2f} against {curve[len(expected) - 1]:.2f} unshifted): shift their columns by so much."
    )


def _correlation(a: FloatArray, b: FloatArray) -> float:
    return float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
