"""What part of a print is looked at, and that the sentence about it is true."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.comparison.baselines import LinearPrinter
from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.simulation.expectation import Piece
from models.file import load_machine
from tests.support.prints import squares
from validation import judge

MACHINE = load_machine("mp-delta-pro")


@pytest.mark.parametrize("name", ["ringing_tower", "lobed_vase", "far_star"])
def test_a_share_stands_for_the_whole_and_is_said(name: str) -> None:
    path = judge.ROOT / "sample_prints" / f"{name}.gcode"
    printed = Print(path.read_bytes(), path.name, MACHINE, flavor="klipper")
    stretches, sentence = printed.slices(Sampling(share=0.1))
    judged = sum(each.trajectory.end_t for each in stretches)
    assert judged == pytest.approx(0.1 * printed.print_time_s, rel=0.15)
    assert f"{len(stretches)} slices" in sentence and f"{judged:.0f} of {printed.print_time_s:.0f} s" in sentence
    begins = np.array([each.begin_t for each in stretches])
    ends = begins + [each.trajectory.end_t for each in stretches]
    assert np.all(begins[1:] > ends[:-1] - 0.5)  # from rest to rest a slice takes longer than on its way
    whole, chosen = (
        LinearPrinter(MACHINE, each).contour_rms_um(Piece.planned) for each in ([printed.whole()], stretches)
    )
    assert chosen == pytest.approx(whole, rel=0.15)


def test_another_acceleration_changes_the_times_and_not_the_path() -> None:
    (stretch,), _ = Print(squares(), "squares.gcode", MACHINE).slices(Sampling())
    slower = stretch.with_acceleration(500.0)
    assert slower.trajectory.end_t > 1.3 * stretch.trajectory.end_t
    np.testing.assert_array_equal(slower.trajectory.origin, stretch.trajectory.origin)
    travels = np.any(slower.trajectory.direction[:, :3] != 0, axis=1)
    np.testing.assert_allclose(slower.trajectory.acceleration[travels], 500.0)
    assert stretch.trajectory.acceleration[travels].max() == 5000.0
