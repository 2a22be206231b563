"""Check that each sensor moves as its name says, at low frequency, where any printer follows its command.

Swapped and reversed columns, a sensor turned against the axes, a dead one and a late record look like huge
effects of the machine, and no model explains them. Errors that low frequencies do not show are left to the diagnosis.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import butter, fftconvolve, sosfiltfilt
from scipy.signal.windows import tukey

from models.arrays import FloatArray

_BAND_HZ = (2.0, 20.0)  # no offsets and drifts, and far below the first mode
_FADED = 0.1  # of the recording, at both ends together
_AS_NAMED = 0.6  # correlation with its own command that is accepted
_REVERSED = -0.9
_ANOTHERS = 0.95  # correlation with another's command, if it is not its own
_DISTINCT = 0.8  # correlation of two commands from which they cannot be told apart
_EXPLAINED = 0.95  # of a sensor's square, by all commands of its kind together
_DEAD, _MUCH = 0.02, 0.3  # of the expected motion is there; of the largest expected motion, to be missed
_STUCK_S, _MARGIN_S = 0.1, 0.025  # of one and the same value; its ends are not checked
_SHAKEN = 0.3  # of its whole range must the command move in that time
_LATE_S, _LATE = 0.025, 0.9  # from when a record is late and no sensor slow; and how well it must fit then


def misplaced(measured: Mapping[str, FloatArray], expected: Mapping[str, FloatArray], rate_hz: float) -> list[str]:
    """Report the sensors that do not move as they are named, in full sentences.

    Parameters
    ----------
    measured : signal (acc_A, pos_x, …) → (n,), NaN where missing. A constant one is ignored.
    expected : the same and other signals of these kinds → (n,), if the printer followed its command exactly.
    """
    telling = {name: x for name, x in measured.items() if np.nanmax(x) > np.nanmin(x)}
    if not telling:
        return []
    signals, reference = _in_band(telling, rate_hz), _in_band(expected, rate_hz)
    odd = [name for name, x in signals.items() if _correlation(x, reference[name]) < _AS_NAMED]
    late = _late(signals, reference, rate_hz) if odd else ""
    if late:
        return [late]
    stuck = [text for name, x in telling.items() for text in _stuck(name, x, expected[name], rate_hz)]
    return stuck or [sentence for name in odd for sentence in _about(name, signals, _kin(name, reference))]


def _stuck(name: str, measured: FloatArray, expected: FloatArray, rate_hz: float) -> list[str]:
    """Report a sensor that is constant while it should move."""
    begin, end = _longest_rest(measured)
    low = sosfiltfilt(butter(2, _BAND_HZ[1], fs=rate_hz, output="sos"), expected)
    edge = round(_MARGIN_S * rate_hz)
    if end - begin < _STUCK_S * rate_hz or np.ptp(low[begin + edge : end - edge]) < _SHAKEN * np.ptp(low):
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
    window = tukey(len(next(iter(signals.values()))), _FADED)
    return {
        name: np.asarray(sosfiltfilt(band, window * np.nan_to_num(x - np.nanmean(x)), padtype=None))
        for name, x in signals.items()
    }


def _kin(name: str, reference: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the expected signals of the sensors of its kind: on the carriages, or on the nozzle."""
    axes = "ABC" if name[-1] in "ABC" else "xyz"
    return {other: x for other, x in reference.items() if other[:4] == name[:4] and other[-1] in axes}


def _about(name: str, signals: Mapping[str, FloatArray], kin: Mapping[str, FloatArray]) -> list[str]:
    measured, own = signals[name], kin[name]
    expected, much = float(own.std()), _MUCH * max(float(x.std()) for x in kin.values())
    match = _correlation(measured, own)
    if max(expected, float(measured.std())) < much:
        return []
    if expected > much and measured.std() < _DEAD * expected:
        return [
            f"Sensor {name} measures {measured.std() / expected:.1%} of the motion that is commanded between "
            f"{_BAND_HZ[0]:g} and {_BAND_HZ[1]:g} Hz: it is dead, not fastened, or in another unit."
        ]
    if match < _REVERSED:
        return [
            f"Sensor {name} moves against its command (correlation {match:.2f}): its axis points the other way, or its "
            "sign is reversed. Multiply its numbers by -1."
        ]
    return _anothers(name, measured, kin, match) or _turned(name, measured, kin, match)


def _anothers(name: str, measured: FloatArray, kin: Mapping[str, FloatArray], match: float) -> list[str]:
    """Report a sensor that moves as another one should."""
    others = {o: _correlation(measured, x) for o, x in kin.items() if o != name}
    other = max(others, key=lambda o: abs(others[o]))
    if abs(others[other]) < _ANOTHERS or abs(_correlation(kin[name], kin[other])) > _DISTINCT:
        return []
    way = "with" if others[other] > 0 else "against"
    return [
        f"Sensor {name} moves {way} the command of {other[-1]} (correlation {others[other]:.2f}), not with that of "
        f"{name[-1]} ({match:.2f}): columns of the sensors or of the command are swapped, or the order of the towers "
        "in the machine file is another."
    ]


def _turned(name: str, measured: FloatArray, kin: Mapping[str, FloatArray], match: float) -> list[str]:
    """Report a sensor that moves as several together."""
    basis = np.column_stack(list(kin.values()))
    moving = basis.std(axis=0) > _MUCH * basis.std(axis=0).max()
    basis[:, ~moving] = 0.0
    share, _, rank, _ = np.linalg.lstsq(basis, measured, rcond=0.05)
    left = float(np.var(measured - basis @ share)) / max(float(np.var(measured)), 1e-300)
    if rank < moving.sum() or left > 1 - _EXPLAINED:
        return []
    mixed = " ".join(f"{c:+.2f} {o[-1]}" for o, c in zip(kin, share, strict=True) if abs(c) > 0.05)
    return [
        f"Sensor {name} moves as {mixed} of what is commanded (correlation with its own {match:.2f}): its axes are "
        "turned against the machine file's, or the order of the towers is another."
    ]


def _late(signals: Mapping[str, FloatArray], reference: Mapping[str, FloatArray], rate_hz: float) -> str:
    """Report a record that fits its command clearly better at another time, in a sentence; '' if it does not."""
    names = [name for name in signals if name.startswith("acc")] or list(signals)
    measured, expected = (np.column_stack([one[name] for name in names]) for one in (signals, reference))
    size = np.linalg.norm(measured) * np.linalg.norm(expected)
    curve = fftconvolve(measured, expected[::-1], axes=0).sum(axis=1) / max(float(size), 1e-300)
    lag = (int(curve.argmax()) - len(expected) + 1) / rate_hz
    if abs(lag) < _LATE_S or curve.max() < _LATE or curve[len(expected) - 1] > _AS_NAMED:
        return ""
    return (
        f"The sensors fit the command best {abs(lag):.4g} s {'late' if lag > 0 else 'early'} (correlation "
        f"{curve.max():.2f} against {curve[len(expected) - 1]:.2f} as they are): shift their columns by so much."
    )


def _correlation(a: FloatArray, b: FloatArray) -> float:
    return float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
