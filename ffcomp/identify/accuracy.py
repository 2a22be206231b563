"""Errors of a predicted frequency response against a measured one (paper, Eqs. 70-72), and the log error.

The paper's accuracy is 100 minus the mean absolute percentage error over the measured lines; it can be negative.

Phase: the prediction is unwrapped from its lowest line, and the measured phase is taken on the branch nearest to it
at every line, so that noise at an antiresonance cannot wind it up. The error of a line is relative to the measured
phase, as in Eq. 71; but where that is near zero (every position response at low frequency) a percentage of it says
nothing, so the error is never taken relative to less than SMALLEST_PHASE_DEG.
"""

from __future__ import annotations

import numpy as np

from models.arrays import ComplexArray, FloatArray

SMALLEST_PHASE_DEG = 10.0


def mean_absolute_percentage_accuracy(
    measured: ComplexArray, predicted: ComplexArray, smallest_phase_deg: float = SMALLEST_PHASE_DEG
) -> tuple[float, float]:
    """Compute μ_acc of magnitude and of phase, % (Eqs. 70, 71).

    Parameters
    ----------
    measured, predicted : (k,) at the same frequencies, rising; measured nowhere zero.
    smallest_phase_deg : 0 is Eq. 71 verbatim.
    """
    magnitude, phase = _errors(measured, predicted, smallest_phase_deg)
    return 100.0 - magnitude, 100.0 - phase


def error_reduction(
    measured: ComplexArray,
    predicted: ComplexArray,
    baseline: ComplexArray,
    smallest_phase_deg: float = SMALLEST_PHASE_DEG,
) -> tuple[float, float]:
    """Compute how much smaller the error is than that of a baseline model, of magnitude and of phase, % (Eq. 72)."""
    ours = _errors(measured, predicted, smallest_phase_deg)
    theirs = _errors(measured, baseline, smallest_phase_deg)
    return 100 * (1 - ours[0] / theirs[0]), 100 * (1 - ours[1] / theirs[1])


def log_error_db(measured: ComplexArray, predicted: ComplexArray) -> float:
    """Compute the root mean square of 20 log₁₀(|P|/|M|), dB: too large and too small count alike, resonance or not."""
    return float(np.sqrt(np.mean((20 * np.log10(np.abs(predicted) / np.abs(measured))) ** 2)))


def complex_log_error(measured: ComplexArray, predicted: ComplexArray) -> float:
    """Compute the rms of |ln(P/M)|: relative errors of magnitude and phase (rad) at once, on the nearest branch."""
    ratio = predicted / measured
    return float(np.sqrt(np.mean(np.log(np.abs(ratio)) ** 2 + np.angle(ratio) ** 2)))


def phases_deg(measured: ComplexArray, predicted: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return both phases on one branch, (k,) degrees: the prediction unwrapped, the measured one nearest to it."""
    reference = np.unwrap(np.angle(predicted))
    return np.degrees(reference + np.angle(measured / predicted)), np.degrees(reference)


def _errors(measured: ComplexArray, predicted: ComplexArray, smallest_phase_deg: float) -> tuple[float, float]:
    """Compute the mean absolute percentage error μ_err of magnitude and of phase."""
    magnitude = np.abs(measured)
    ours, theirs = phases_deg(measured, predicted)
    relative_to = np.maximum(np.abs(ours), smallest_phase_deg)
    return (
        float(100 * np.mean(np.abs(magnitude - np.abs(predicted)) / magnitude)),
        float(100 * np.mean(np.abs(ours - theirs) / relative_to)),
    )
