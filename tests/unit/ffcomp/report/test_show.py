"""The picture of `ffcomp show`: outer walls first, travel thin, one scope for each number, and opening it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ffcomp.cli.show import open_picture
from ffcomp.report.drawing import ERROR, NEIGHBOUR
from ffcomp.report.show import show_figure
from ffcomp.simulation.forecast import Forecast
from ffcomp.simulation.preview import Curve, Preview

COUNT = 400  # samples of each kind: an outer wall, infill, travel


def curve(scale: float) -> Curve:
    """Three lines 10 mm apart: 0.1 mm off on the wall, 0.3 mm in the infill, 0.9 mm in travel, times `scale`."""
    kind = np.repeat([0, 1, 2], COUNT)
    reference = np.column_stack([np.tile(np.linspace(0, 40, COUNT), 3), 10.0 * kind, np.full(3 * COUNT, 0.2)])
    contour = scale * np.choose(kind, [0.1, 0.3, 0.9]) * np.tile(np.linspace(0.5, 1.0, COUNT), 3)
    nozzle = reference + np.outer(contour, [0.0, 1.0, 0.0])
    return Curve(1e-2 * np.arange(3 * COUNT), nozzle, reference, contour, kind < 2, kind == 0)


def drawn(z_mm: float | None = None) -> Any:
    before = curve(1.0)
    after = curve(0.01)
    predicted = Forecast({"uncompensated": before.track, "compensated": after.track})
    return show_figure(Preview(before.reference, before.t, before, after), predicted, "a print", z_mm=z_mm)


def test_it_shows_the_worst_of_the_outer_walls() -> None:
    assert drawn().axes[0].get_title() == "Largest error on an outer wall: X 40.0, Y 0.0, Z 0.20 mm"


def test_every_axis_has_a_label_with_its_unit_and_every_panel_says_its_layer() -> None:
    figure = drawn()
    close, before, after, time, bar = figure.axes
    assert all(axes.get_xlabel() == "X, mm" and axes.get_ylabel() == "Y, mm" for axes in (close, before, after))
    assert (time.get_xlabel(), time.get_ylabel()) == ("time in this layer, s", "contour error, µm")
    assert bar.get_ylabel() == "contour error where plastic flows, µm"
    assert before.get_title() == "Layer at Z 0.20 mm, without compensation"
    assert "If the machine file is exact: contour error" in figure.get_suptitle()  # and nowhere else
    assert [text.get_text() for text in time.get_legend().get_texts()] == ["without compensation", "with compensation"]


def test_travel_is_thin_and_grey_and_plastic_has_the_colours_of_an_error() -> None:
    before = drawn().axes[1]
    (travel,), (plastic,) = before.get_lines(), before.collections
    assert travel.get_color() == NEIGHBOUR and travel.get_linewidth() < 0.6 * plastic.get_linewidths()[0]
    assert np.nanmin(travel.get_ydata()) > 20.0  # the third line only
    assert len(plastic.get_segments()) == 2 * COUNT - 1
    assert plastic.get_cmap()(0.0)[:3] == pytest.approx([int(ERROR[0][k : k + 2], 16) / 255 for k in (1, 3, 5)])


def test_the_picture_is_opened_or_it_is_said_where_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("ffcomp.cli.show.opened", lambda url: not opened.append(url))
    open_picture("out.png")
    assert opened == ["out.png"] and capsys.readouterr().err == ""
    monkeypatch.setattr("ffcomp.cli.show.opened", lambda url: False)
    open_picture("out.png")
    assert "look at out.png yourself" in capsys.readouterr().err
