"""Figures of a fit: what stands on their axes, where their panels are, and what they say of a fit."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from matplotlib.figure import Figure

from ffcomp.identification.direct import Identified
from ffcomp.identification.predict import predicted
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.report.identify import fit_figure
from ffcomp.shapers import SHAPERS
from ffcomp.shapers.calibration import TARGET_SMOOTHING_MM, in_words, shaper_advice, smoothing
from models.file import load_machine

MACHINE = load_machine("mp-delta-pro")
LINES_HZ = np.arange(5.0, 120.0, 1.0)


def identified(errors: float, inputs: str = "ABC") -> Identified:
    """A fit of all responses, out of order, with these model errors."""
    empty, ones = np.zeros(len(LINES_HZ), dtype=np.complex128), np.ones(len(LINES_HZ))
    blank = [
        FrequencyResponse(f"cmd_{a}", f"pos_{b}", LINES_HZ, empty, 1e-6 * ones, position_mm=(0.0, 0.0, 20.0))
        for b in "CBA"
        for a in inputs
    ]
    values = predicted(MACHINE, blank)
    responses = [replace(each, value=1.01 * value) for each, value in zip(blank, values, strict=True)]
    model_errors = np.full(len(blank), errors)
    model_errors[0] = 0.0
    fitted = SimpleNamespace(responses=responses, predictions=values, model_errors=model_errors, misfit=1.1)
    return cast(Identified, SimpleNamespace(fitted=fitted, machine=MACHINE))


def words(figure: Figure) -> list[str]:
    """All that is written on a figure and its panels."""
    return [text.get_text() for text in figure.findobj(lambda each: hasattr(each, "get_text"))]


@pytest.fixture(scope="module")
def drawn() -> Figure:
    return fit_figure(identified(0.013), "and more")


def test_nine_responses_are_three_by_three_inputs_across(drawn: Figure) -> None:
    titles = [axes.get_title(loc="left") or axes.get_title() for axes in drawn.axes[::2]]
    pairs = [title.partition(" at ")[0] for title in titles]
    assert pairs == [f"cmd_{a} → pos_{b}" for b in "ABC" for a in "ABC"]
    columns = {round(axes.get_position().x0, 2) for axes in drawn.axes[::2]}
    assert len(drawn.subfigs) == 9 and len(columns) <= 3


def test_every_axis_has_its_unit_and_peaks_their_frequency(drawn: Figure) -> None:
    for upper, lower in zip(drawn.axes[::2], drawn.axes[1::2], strict=True):
        assert upper.get_ylabel() == "magnitude, m/m"
        assert (lower.get_xlabel(), lower.get_ylabel()) == ("frequency, Hz", "phase, °")
    peaks = [float(text.removesuffix(" Hz")) for text in words(drawn) if text[:1].isdigit() and text.endswith(" Hz")]
    assert len(peaks) >= 9 and any(59.0 <= peak <= 62.0 for peak in peaks)  # the drive, of every response


@pytest.mark.parametrize(
    ("error", "verdict"), [(0.0, "A good fit"), (0.013, "A good fit"), (0.12, "A fair"), (0.4, "A poor")]
)
def test_a_right_fit_does_not_read_like_failure(error: float, verdict: str) -> None:
    said = words(fit_figure(identified(error, "A")))
    assert any(text.startswith(verdict) for text in said)
    assert not any("explains" in text for text in said)


def test_those_who_stay_with_a_shaper_get_all_three_settings(drawn: Figure) -> None:
    x, y = advice = shaper_advice(MACHINE)
    corner = MACHINE.limits.square_corner_velocity_mm_per_s
    for each, axis in zip(advice, "xy", strict=True):
        assert each.axis == axis and 20.0 < each.frequency_hz < 120.0
        shaper = SHAPERS[each.shaper](each.frequency_hz, 0.1)
        rounded = [smoothing(shaper, corner, each.max_accel_mm_per_s2 + more) for more in (0.0, 100.0)]
        assert rounded[0] <= TARGET_SMOOTHING_MM < rounded[1]
    most = min(x.max_accel_mm_per_s2, y.max_accel_mm_per_s2)
    assert in_words(advice).endswith(f"max_accel up to {most:.0f} mm/s².") and in_words(()) == ""
    assert "and more" in words(drawn)
