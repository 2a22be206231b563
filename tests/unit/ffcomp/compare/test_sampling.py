"""What part of a print is looked at, and that the sentence about it is true."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.compare.sampling import Print, Sampling
from ffcomp.errors import NothingToDo
from models.file import load_machine
from tests.support.prints import squares
from validation import judge

MACHINE = load_machine("mp-delta-pro")


def vase() -> Print:
    path = judge.ROOT / "sample_prints" / "lobed_vase.gcode"
    return Print(path.read_bytes(), path.name, MACHINE)


def test_a_short_print_is_judged_whole() -> None:
    printed = Print(squares(), "squares.gcode", MACHINE)
    (stretch,), sentence = printed.slices(Sampling())
    assert len(stretch.trajectory) == len(printed.program.moves)
    assert sentence == f"The whole print was evaluated, {printed.print_time_s:.0f} s."


def test_a_share_is_spread_evenly_and_said() -> None:
    printed = vase()
    stretches, sentence = printed.slices(Sampling(share=0.2))
    judged = sum(each.trajectory.end_t for each in stretches)
    assert judged == pytest.approx(0.2 * printed.print_time_s, rel=0.15)
    begins = [each.begin_t / printed.print_time_s for each in stretches]
    assert np.ptp(np.diff(begins)) < 0.15 and begins[0] < 0.25 and begins[-1] > 0.7
    assert f"{len(stretches)} slices" in sentence and f"{judged:.0f} of {printed.print_time_s:.0f} s" in sentence


def test_a_long_print_is_sampled_without_being_asked() -> None:
    path = judge.ROOT / "sample_prints" / "far_star.gcode"
    stretches, sentence = Print(path.read_bytes(), path.name, MACHINE).slices(Sampling())
    assert 100.0 < sum(each.trajectory.end_t for each in stretches) < 150.0
    assert "slices" in sentence


def test_layers_are_taken_whole_and_nothing_else() -> None:
    printed = Print(squares(5), "squares.gcode", MACHINE)
    (stretch,), sentence = printed.slices(Sampling(1, 3))
    assert set(stretch.layer) == {1, 2, 3}
    assert "Layers 1 to 3" in sentence
    whole = printed.planned.trajectory
    own = np.flatnonzero((printed.labels.layer >= 1) & (printed.labels.layer <= 3))
    np.testing.assert_allclose(stretch.trajectory.origin[:, :3], whole.origin[own, :3])
    assert stretch.begin_t == whole.start_t[own[0]]


def test_layers_that_are_not_there_are_an_error() -> None:
    with pytest.raises(NothingToDo, match="the print has 3 layers, 0 to 2"):
        Print(squares(3), "squares.gcode", MACHINE).slices(Sampling(7, 9))


def test_another_acceleration_changes_the_times_and_not_the_path() -> None:
    (stretch,), _ = Print(squares(), "squares.gcode", MACHINE).slices(Sampling())
    slower = stretch.with_acceleration(500.0)
    assert slower.trajectory.end_t > 1.3 * stretch.trajectory.end_t
    np.testing.assert_array_equal(slower.trajectory.origin, stretch.trajectory.origin)
    travels = np.any(slower.trajectory.direction[:, :3] != 0, axis=1)
    np.testing.assert_allclose(slower.trajectory.acceleration[travels], 500.0)
    assert stretch.trajectory.acceleration[travels].max() == 5000.0
