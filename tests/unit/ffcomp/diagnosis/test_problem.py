"""What a candidate may be in the motion that was recorded."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.diagnosis.candidates import within_travel
from ffcomp.diagnosis.problem import Candidate, Parameter

AMPLITUDE = Parameter("effects.cogging.amplitude_mm", 0.0, 0.01)
PITCH = Parameter("effects.cogging.pitch_mm", 0.2, 0.4, 0.05, 50.0)
GRID = ({PITCH.name: 0.2}, {PITCH.name: 0.8})
COGGING = Candidate("cogging", (AMPLITUDE,), {AMPLITUDE.name: 0.01}, (PITCH,), GRID)


@pytest.mark.parametrize(("travel_mm", "starts", "most"), [(100.0, 2, 50.0), (20.0, 2, 10.0), (1.0, 1, 0.5)])
def test_a_pitch_fits_twice_into_the_travel(travel_mm: float, starts: int, most: float) -> None:
    found = within_travel(replace(COGGING, other=COGGING), travel_mm)
    assert found is not None and found.other is not None
    for each in (found, found.other):
        assert (len(each.grid), each.shapes[0].high) == (starts, most)


def test_without_two_periods_there_is_no_ripple_to_name() -> None:
    assert within_travel(COGGING, 0.3) is None
    friction = replace(COGGING, shapes=(), grid=({},))
    assert within_travel(friction, 0.3) == friction
