"""What x and y exchange, from the response of each axis to the other's command.

With f the response of an axis to its own command, d that of its driven point (`models/vibration/modal.py`), and R what
the sensor showed of f, delay and gain of both included:

    Y/u_x = (δ f_y (1 − d_x)/f_x + κ) R_x,   X/u_y = (δ f_x (1 − d_y)/f_y + κ') R_y

δ is `axes.exchange`, to first order; κ is what a sensor shows that is turned about z by κ radians. The two differ in
their course over frequency: at rest nothing is exchanged, and a turned sensor shows most there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.identify.axis_spectra import Response, closed_form
from ffcomp.identify.modal_fit import AxisFit
from ffcomp.identify.uncertainty import Estimate, normal
from ffcomp.measurement.modal import independent_share
from models.arrays import ComplexArray, FloatArray

OTHER = {"x": "y", "y": "x"}
MODEL_ERROR = 0.1  # of a crossed response, in the weights
WEAKEST = 0.03  # of its largest value: where an axis answers less to its command, its response divides by noise


@dataclass(frozen=True, eq=False)
class Exchange:
    """How x and y exchange motion, and how much of what was measured that does not explain."""

    delta: Estimate
    turned_rad: dict[str, float]  # of each crossed response, by its name
    left: float  # amplitude of what is left of the crossed responses beyond noise, over the direct ones'


@dataclass(frozen=True, eq=False)
class _Crossed:
    """One crossed response, and what δ = 1 and κ = 1 would show in it."""

    answer: Response
    lines: FloatArray  # of the response, those that count
    exchanged: ComplexArray
    turned: ComplexArray

    @property
    def value(self) -> ComplexArray:
        return np.asarray(self.answer.value[self.lines])

    @property
    def deviation(self) -> FloatArray:
        """(2 k,) of real, then imaginary parts."""
        return np.sqrt(self.answer.variance(MODEL_ERROR).reshape(2, -1)[:, self.lines].ravel())


def find_exchange(axes: Sequence[AxisFit], answers: Sequence[Response]) -> Exchange | None:
    """Fit δ and a turn of the sensor for each crossed response to all of them together.

    Parameters
    ----------
    axes : the fitted axes; both x and y must be among them, with responses that tell the sensors' signs.
    answers : responses of axes to commands, their own and each other's.

    Returns
    -------
    None where there is no crossed response with the direct one of the same file.
    """
    fitted = {axis.name: axis for axis in axes}
    if not set("xy") <= fitted.keys():
        return None
    pairs = [_crossed(fitted, answers, each) for each in answers if each.axis in "xy" and not each.direct]
    found = [pair for pair in pairs if pair is not None]
    return _fitted(found) if found else None


def _crossed(fitted: dict[str, AxisFit], answers: Sequence[Response], crossed: Response) -> _Crossed | None:
    to, of = crossed.axis, crossed.measured.input[-1]
    own = next((a for a in answers if a.direct and a.axis == of and a.source == crossed.source), None)
    if of != OTHER[to] or own is None or not np.array_equal(own.frequency_hz, crossed.frequency_hz):
        return None
    moved, shown = _modes(fitted[of]), _modes(fitted[to])
    f_moved, f_shown = closed_form(moved, own.frequency_hz), closed_form(shown, own.frequency_hz)
    lines = np.abs(f_moved) > WEAKEST * np.abs(f_moved).max()
    exchanged = f_shown * (1 - closed_form(_driven(moved), own.frequency_hz)) / f_moved
    sign = _sign(fitted[to], shown) * _sign(fitted[of], moved)
    return _Crossed(crossed, lines, (sign * exchanged * own.value)[lines], own.value[lines])


def _modes(axis: AxisFit) -> FloatArray:
    """Return (m, 3) frequency, damping ratio, share."""
    return np.array([[m.frequency_hz.value, m.damping_ratio.value, m.share.value] for m in axis.modes])


def _driven(modes: FloatArray) -> FloatArray:
    """Return the same of the point that the belt drives: every mode of it follows the belt."""
    sizes = np.abs(modes[:, 2])
    return np.column_stack([modes[:, :2], sizes / sizes.sum()])


def _sign(axis: AxisFit, modes: FloatArray) -> float:
    """Return −1 where the sensor feels the axis the other way round, as on a moving bed."""
    seen = (float(datum.begin(modes)[0]) for datum in axis.data if isinstance(datum, Response))
    return float(np.sign(next(seen, 1.0)))


def _fitted(pairs: Sequence[_Crossed]) -> Exchange:
    """Solve for δ and every κ by weighted least squares."""
    columns, rows = [], []
    for i, pair in enumerate(pairs):
        block = np.zeros((2 * len(pair.value), 1 + len(pairs)))
        block[:, 0], block[:, 1 + i] = _parts(pair.exchanged), _parts(pair.turned)
        columns.append(block / pair.deviation[:, None])
        rows.append(_parts(pair.value) / pair.deviation)
    a, b = np.concatenate(columns), np.concatenate(rows)
    solved = np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], dtype=np.float64)
    residual = b - a @ solved
    independent = _independent(residual, pairs)
    scatter = max(float(residual @ residual) / max(len(b) - a.shape[1], 1), 1.0)
    covariance = np.linalg.pinv(a.T @ a) * scatter / independent
    names = [f"{pair.answer.measured.input} to {pair.answer.measured.output}" for pair in pairs]
    turns = dict(zip(names, solved[1:].tolist(), strict=True))
    return Exchange(normal(float(solved[0]), float(np.sqrt(covariance[0, 0]))), turns, _left(solved, pairs))


def _parts(value: ComplexArray) -> FloatArray:
    return np.concatenate([value.real, value.imag])


def _independent(residual: FloatArray, pairs: Sequence[_Crossed]) -> float:
    """Return the least share of independent residuals among the responses."""
    ends = np.cumsum([2 * len(pair.value) for pair in pairs])[:-1]
    return min(independent_share(part, len(part) // 2) for part in np.split(residual, ends))


def _left(solved: FloatArray, pairs: Sequence[_Crossed]) -> float:
    """Return the amplitude that is left beyond noise, over that of the direct responses."""
    left = direct = 0.0
    for pair, turn in zip(pairs, solved[1:], strict=True):
        error = pair.value - solved[0] * pair.exchanged - turn * pair.turned
        left += float(np.sum(np.maximum(np.abs(error) ** 2 - pair.answer.measured.variance[pair.lines], 0)))
        direct += float(np.sum(np.abs(pair.turned) ** 2))
    return float(np.sqrt(left / direct))
