"""The picture of a compensated print shows speeds where the print takes another time than its original."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffcomp.report.show import retimed, show_figure
from ffcomp.simulation.forecast import NO_FORECAST
from ffcomp.simulation.preview import Curve, Preview


def drawn(seconds: float) -> Curve:
    """A line of 40 mm, passed in so many seconds."""
    t = np.linspace(0.0, seconds, 400)
    path = np.column_stack([40.0 * t / seconds, np.zeros(400), np.full(400, 0.2)])
    everywhere = np.ones(400, dtype=np.bool_)
    return Curve(t, path + np.array([0.0, 0.01, 0.0]), path, np.full(400, 0.01), everywhere, everywhere)


def test_speeds_are_drawn_of_a_print_that_is_quicker() -> None:
    same = Preview(np.array([[0.0, 0.0, 0.2], [40.0, 0.0, 0.2]]), np.array([0.0, 2.0]), drawn(2.0), drawn(2.0))
    quicker = replace(same, after=drawn(1.0))
    assert not retimed(same) and retimed(quicker)
    assert [axes.get_ylabel() for axes in show_figure(same, NO_FORECAST, "same").axes].count("speed, mm/s") == 0
    figure = show_figure(quicker, NO_FORECAST, "quicker")
    (speeds,) = (axes for axes in figure.axes if axes.get_ylabel() == "speed, mm/s")
    before, after = (np.median(np.asarray(line.get_ydata())) for line in speeds.get_lines())
    np.testing.assert_allclose([before, after], [20.0, 40.0], rtol=1e-6)
