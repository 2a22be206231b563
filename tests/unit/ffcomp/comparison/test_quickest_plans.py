"""What knowing a machine better is worth: less time, measured."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.comparison.quickest_plans import worth_knowing
from ffcomp.comparison.sampling import Print
from ffcomp.faster.bound import Bound
from ffcomp.inverse.settings import settings_for
from models.file import load_machine
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")
BOUND = Bound(10.0, max_flow_mm3_per_s=20.0, min_layer_time_s=0.0, change_speed=("first layer",))


def test_a_better_known_machine_prints_quicker() -> None:
    vague = replace(MACHINE, uncertainty={"default": 0.2})
    (known,) = worth_knowing(Print(squares(1), "squares", vague), settings_for(vague), BOUND, (0.02,), 100.0)
    assert (known.relative_sd, known.print_time_s) == (0.02, pytest.approx(100.0 * known.share))
    assert known.share < 0.97
