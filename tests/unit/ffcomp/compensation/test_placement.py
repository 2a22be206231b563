"""Where a print is put: not moved where it lies inside, else over the slicer's bed or in the middle, and why."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.compensation.placement import Footprint, advice, choose_offset, footprint_of
from ffcomp.integrations.slicer import Bed
from gcode.reader import read_program
from models.file import load_machine
from models.kinematics.base import Kinematics

CORNER, MIDDLE = Bed((0.0, 0.0), (220.0, 220.0)), Bed((-110.0, -110.0), (110.0, 110.0))


@pytest.fixture(scope="module")
def delta() -> Kinematics:
    return load_machine("kossel").kinematics


def box(x0: float, y0: float, x1: float, y1: float, *beside: tuple[float, float]) -> Footprint:
    part = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return Footprint(part, np.concatenate([part, np.array(beside).reshape(-1, 2)]))


@pytest.mark.parametrize("bed", [None, CORNER])
def test_a_print_inside_stays_where_it_is(delta: Kinematics, bed: Bed | None) -> None:
    chosen = choose_offset(delta, bed, lambda: box(10.0, 10.0, 40.0, 60.0))
    assert chosen.offset == (0.0, 0.0) and "lies inside without one" in chosen.reason
    assert ("--offset-mm -110,-110 would move it there" in chosen.reason) == (bed is not None)


def test_the_slicers_bed_is_laid_over_the_machines(delta: Kinematics) -> None:
    chosen = choose_offset(delta, CORNER, lambda: box(100.0, 95.0, 130.0, 140.0))
    assert chosen.offset == (-110.0, -110.0)
    assert chosen.reason.startswith(
        "Offset -110,-110: the slicer's bed lies about X110 Y110, the machine's about X0 Y0"
    )


def test_an_offset_that_is_offered_brings_every_move_inside(delta: Kinematics) -> None:
    found = box(0.0, 0.0, 90.0, 90.0, (120.0, 40.0), (-30.0, 40.0))
    said = advice(delta, None, found, (0.0, 0.0))
    x, y = map(float, said.split("--offset-mm ")[1].split(" ")[0].split(","))
    assert delta.contains(found.everything + np.array([x, y])).all()
    assert "no offset helps" in advice(delta, None, box(0.0, 0.0, 90.0, 400.0), (0.0, 0.0)).lower()
    assert "--offset-mm -110,-110 brings" in advice(delta, CORNER, box(100.0, 95.0, 130.0, 140.0), (0.0, 0.0))
    assert "too high" in advice(delta, None, box(-5.0, -5.0, 5.0, 5.0), (0.0, 0.0))


def test_the_footprint_tells_the_part_from_what_is_beside_it() -> None:
    text = b"G1 X-2 Y9 Z1 F900\nG1 Y90 E9\nG1 X30 Y30\n;LAYER:0\n"
    text += b"G1 X60 Y30 E12\nG1 X60 Y50 E15\nG1 X30 Y50 E18\nG1 X0 Y240\n"
    found = footprint_of([read_program(text, start=(0.0, 0.0, 1.0))])
    assert found is not None
    assert (found.part.min(axis=0).tolist(), found.part.max(axis=0).tolist()) == ([30.0, 30.0], [60.0, 50.0])
    assert (found.everything.min(axis=0).tolist(), found.everything.max(axis=0).tolist()) == (
        [-2.0, 0.0],
        [60.0, 240.0],
    )
    assert footprint_of([read_program(b"; nothing\n")]) is None
