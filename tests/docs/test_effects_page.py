"""docs/EFFECTS.md tells what the catalogue declares, and shows every effect by a figure that differs with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.effects.catalogue import CATALOGUE, effects_of_printers
from scripts.pages import effects

DOCS = Path(__file__).parents[2] / "docs"
LARGEST_BYTES = 40_000


def test_the_page_is_in_step_with_the_catalogue() -> None:
    written = (DOCS / "EFFECTS.md").read_text(encoding="utf-8")
    assert written == effects.page(), "python -m scripts.pages --write"


def test_every_effect_has_its_small_figure_and_no_figure_is_left_over() -> None:
    figures = {path.stem: path for path in (DOCS / "effects").glob("*.png")}
    assert set(figures) == set(effects_of_printers()) == set(effects.SHOWN)
    assert max(path.stat().st_size for path in figures.values()) < LARGEST_BYTES


@pytest.mark.parametrize("name", ["coulomb_friction", "effector_mass", "cogging", "sensor_gain", "arm_geometry"])
def test_a_figure_shows_the_effect(name: str) -> None:
    """One of each kind of view: the curve with the effect is another one by more than a tenth of a percent."""
    shown = effects.SHOWN[name]
    without, with_it = (shown.panels[0].draw(m) for m in effects.machines(CATALOGUE[name], shown))
    np.testing.assert_array_equal(without.x, with_it.x)
    assert np.abs(with_it.y - without.y).max() > 1e-3 * max(float(np.abs(without.y).max()), 1.0)
