"""The sample prints: their models are closed bodies, and the G-code is what the README says."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sample_prints import make_models

FOLDER = Path(__file__).parents[2] / "sample_prints"
PRINTS = sorted(make_models.MODELS)


@pytest.mark.parametrize("name", PRINTS)
def test_a_model_is_a_closed_body_facing_outward(name: str) -> None:
    """Every edge runs once each way, and the divergence theorem gives a positive volume."""
    triangles = np.round(make_models.MODELS[name](), 9) + 0.0
    _, corner = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    edges = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    forth, back = {tuple(e) for e in edges}, {tuple(e[::-1]) for e in edges}
    assert len(forth) == len(edges) and forth == back
    assert np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) > 0


def extruding_moves(text: str) -> NDArray[np.float64]:
    """x, y mm and feed mm/s : (n, 3) of the moves that print, read without any of our parsers."""
    place, relative, rows = {"X": 0.0, "Y": 0.0, "E": 0.0, "F": 0.0}, "\nM83" in text, []
    for line in re.findall(r"^(?:G1|G92) [^;\n]*", text, re.MULTILINE):
        before, words = place["E"], {w: float(v) for w, v in re.findall(r"([XYEF])(-?[\d.]+)", line)}
        place.update(words)
        pushed = words.get("E", 0.0) if relative else place["E"] - before
        if line.startswith("G1") and pushed > 0 and ("X" in words or "Y" in words):
            rows.append((place["X"], place["Y"], place["F"] / 60))
    return np.array(rows)


@pytest.mark.parametrize(("name", "reach_mm"), [("ringing_tower", 33), ("lobed_vase", 38), ("far_star", 110)])
def test_a_print_is_what_the_readme_says(name: str, reach_mm: float) -> None:
    path = FOLDER / f"{name}.gcode"
    text = path.read_text(encoding="utf-8")
    moves = extruding_moves(text)
    accelerations = [float(a) for a in re.findall(r"^M204 .*?[SP](\d+)", text, re.MULTILINE)]
    assert path.stat().st_size < 2_000_000
    assert np.max(np.hypot(moves[:, 0], moves[:, 1])) == pytest.approx(reach_mm, abs=1)
    assert math.isclose(np.median(moves[:, 2]), 150, abs_tol=50) and np.max(moves[:, 2]) <= 200
    assert min(accelerations) >= 3000 and max(accelerations) <= 10000
    assert not re.search(r"^G[23]\b", text, re.MULTILINE)
