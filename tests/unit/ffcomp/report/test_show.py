"""The picture of `ffcomp show`: outer walls first, travel thin, one scope for each number."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

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
    t = 1e-2 * np.arange(3 * COUNT)
    return Curve(t, t, nozzle, reference, contour, kind < 2, kind == 0)


def drawn(z_mm: float | None = None) -> Any:
    before = curve(1.0)
    after = curve(0.01)
    predicted = Forecast({"uncompensated": before.track, "compensated": after.track})
    seen = Preview(before, after, None)  # type: ignore[arg-type]  # the original's moves are for another picture
    return show_figure(seen, predicted, "a print", z_mm=z_mm)


def test_it_shows_the_worst_of_the_outer_walls_from_near() -> None:
    close = drawn().axes[0]
    assert close.get_title("left") == "Largest error on an outer wall:\nX 40.0, Y 0.0, Z 0.20 mm"
    low, high = close.get_xlim()
    assert high - low == pytest.approx(2 * 8 * 0.1, rel=0.01)  # 0.1 mm off: 1.6 mm are shown, not the whole line
