"""Layers and features, as the slicers' comments name them."""

from __future__ import annotations

import pytest

from gcode.layers import UNNAMED, labels
from gcode.reader import read_program

PRUSA = (";LAYER_CHANGE\n;Z:0.2\n", ";TYPE:External perimeter\n", "External perimeter")
CURA = (";LAYER:0\n", ";TYPE:WALL-OUTER\n", "WALL-OUTER")
BAMBU = ("; CHANGE_LAYER\n", "; FEATURE: Outer wall\n", "Outer wall")
SIMPLIFY = ("; layer 1, Z = 0.200\n", "; feature outer perimeter\n", "outer perimeter")


@pytest.mark.parametrize("spelling", [PRUSA, CURA, BAMBU, SIMPLIFY])
def test_every_slicers_words(spelling: tuple[str, str, str]) -> None:
    layer, feature, name = spelling
    text = f"G90\nM83\nG1 X0 Y0 Z0.2 F6000\nG1 X1\n{layer}G1 X2\n{feature}G1 X3 E1\nG1 X4 E1\n{layer}G1 X5 E1\n"
    found = labels(read_program(text.encode()))
    assert found.features == (UNNAMED, name)
    assert found.feature.tolist() == [0, 0, 1, 1, 1]
    assert found.layer.tolist() == [0, 0, 0, 0, 1]
    assert found.layers == 2


def test_without_comments_layers_are_heights() -> None:
    square = "G1 X10 E1\nG1 Y10 E1\nG1 X0 E1\nG1 Y0 E1\n"
    text = "G90\nM83\nG1 X0 Y0 Z0.2 F6000\n" + square + "G1 Z0.6\nG1 Z0.4\n" + square
    assert labels(read_program(text.encode())).layer.tolist() == [0, 0, 0, 0, 0, 0, 1, 1, 1, 1]
