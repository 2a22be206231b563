"""Figures of a fit: what stands on their axes, where their panels are, and what they say of a fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from matplotlib.figure import Figure

from ffcomp.identification.machine_fit import Origin, ParametersFit
from ffcomp.identification.output_error import Fitted
from ffcomp.identification.predict import predicted
from ffcomp.identification.uncertainty import normal
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.report.identify import page_of, panels_of, three_panels
from ffcomp.shapers import SHAPERS
from ffcomp.shapers.calibration import TARGET_SMOOTHING_MM, in_words, klipper_block, shaper_advice, smoothing
from models.file import load_machine

MACHINE = load_machine("mp-delta-pro")
LINES_HZ = np.arange(5.0, 120.0, 1.0)


def identified(errors: float, inputs: str = "ABC") -> Fitted:
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
    about = {"model_errors": model_errors, "misfit": 1.1, "common_scale_sd": 0.0}
    mass = {"carriage.mass_kg": normal(0.3, 0.01)}
    about |= {"responses": responses, "predictions": values, "estimates": mass, "beside_scale": mass}
    return cast(Fitted, SimpleNamespace(machine=MACHINE, kept=(), **about))


def words(figure: Figure) -> list[str]:
    """All that is written on a figure and its panels."""
    return [text.get_text() for text in figure.findobj(lambda each: hasattr(each, "get_text"))]


@pytest.fixture(scope="module")
def drawn() -> Figure:
    return three_panels("mine", "It fits.", panels_of(identified(0.013)), klipper_block(shaper_advice(MACHINE)))


def test_the_page_has_the_answer_three_panels_and_settings_to_paste() -> None:
    fit = ParametersFit(
        **{"origin": Origin(MACHINE, "mine"), "skipped": ["one.csv"], "advice": ["Weigh it."]},
        result=identified(0.013),
        shapers=shaper_advice(MACHINE),
        output=Path("folder/better.toml"),
    )
    text = page_of(fit).html(fit.answer).decode()
    assert text.count("<img ") == 3 and "Weigh it." in text and "The model explains" in text
    assert f"<pre>{klipper_block(fit.shapers)}</pre>" in text and "folder/" not in text


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
    (block,) = (text for text in words(drawn) if "[input_shaper]" in text)
    assert f"shaper_type_x: {x.shaper}\nshaper_freq_x: {x.frequency_hz:.1f}" in block and klipper_block(()) == ""
