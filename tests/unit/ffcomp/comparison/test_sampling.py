"""What part of a print is looked at, and that the sentence about it is true."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.comparison.sampling import SETTLE_S, Print, PrintSlice, Sampling, Strata, choose
from ffcomp.errors import NothingToDo
from gcode.layers import is_outer_wall
from models.arrays import FloatArray
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


def shares(printed: Print, stretches: list[PrintSlice], weighted: bool) -> tuple[FloatArray, FloatArray]:
    """The shares of time of every feature, in the whole print and in what is judged."""
    count = len(printed.labels.features)
    whole = np.bincount(printed.labels.feature, printed.planned.trajectory.duration, count)
    judged = np.zeros(count)
    for each in stretches:
        weight = each.weight if weighted and each.weight is not None else 1.0
        settled = np.minimum(
            each.trajectory.duration, np.maximum(each.trajectory.start_t + each.trajectory.duration - SETTLE_S, 0)
        )
        judged += np.bincount(each.feature, weight * settled, count)
    return whole / whole.sum(), judged / judged.sum()


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
    whole, chosen = shares(printed, stretches, weighted=False)
    assert np.abs(whole - chosen).sum() < 0.2
    outer = [is_outer_wall(feature) for feature in printed.labels.features]
    assert chosen[outer].sum() > 0.85 * whole[outer].sum()
    _, counted = shares(printed, stretches, weighted=True)
    assert np.abs(whole - counted).sum() < 0.08


def test_what_is_left_out_is_said() -> None:
    printed = vase()
    stretches, sentence = printed.slices(Sampling(share=0.1))
    assert "Not among them: Skirt/Brim (1.1% of what extrudes)." in sentence
    assert "Skirt/Brim" not in {printed.labels.features[k] for each in stretches for k in each.feature[each.extrudes]}


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


def test_the_acceleration_of_a_print_is_that_of_its_outer_walls() -> None:
    start = b"G90\nM83\nG1 X0 Y0 Z0.2 F6000\n"
    infill = b";TYPE:Internal infill\nM204 S8000\nG1 X60 E2\nG1 X0 E2\n"
    wall = b";TYPE:External perimeter\nM204 S3000\nG1 Y20 E1\n"
    for data, expected in ((start + infill + wall, 3000.0), (start + infill, 8000.0), (start + b"G1 X20 E1\n", None)):
        assert Print(data, "lines.gcode", MACHINE).acceleration_mm_per_s2 == expected


def strata(feature: list[int], outer: int = -1) -> Strata:
    """Moves of one second, all in one layer and one place."""
    kind = np.array(feature)
    ones = np.ones(len(kind), dtype=bool)
    return Strata.of(kind, np.zeros_like(kind), np.zeros((len(kind), 2)), np.ones(len(kind)), ones, kind == outer)


def test_the_shares_of_the_whole_are_found_again() -> None:
    """Six of eight slices hold one kind alone; two mixed ones are the whole on a smaller scale."""
    parts = strata([0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 1])
    begin = np.arange(0, 16, 2)
    amounts = parts.amounts(begin, begin + 2)
    whole = parts.amounts(np.array([0]), np.array([16]))[0]
    chosen = choose(amounts, whole, begin.astype(float), begin + 2.0, 4)
    kinds = parts.kind.reshape(8, 2)[chosen]
    assert np.mean(kinds == kinds.max()) == 0.25  # as in the whole


def test_slices_do_not_overlap_and_no_more_are_taken_than_fit() -> None:
    begin = np.arange(0.0, 10.0)
    chosen = choose(np.ones((10, 1)), np.ones(1), begin, begin + 3.0, 9)
    assert np.all(np.diff(begin[chosen]) >= 3.0) and 2 <= len(chosen) <= 4


def test_an_empty_slice_is_never_taken() -> None:
    amounts = np.array([[0.0, 0.0], [1.0, 1.0]])
    assert list(choose(amounts, np.ones(2), np.array([0.0, 5.0]), np.array([1.0, 6.0]), 2)) == [1]


def test_outer_walls_count_double() -> None:
    parts = strata([0, 1, 1, 1], outer=0)
    assert parts.amounts(np.array([0]), np.array([4]))[0][:4].tolist() == [0.0, 2.0, 0.0, 3.0]


def test_weights_restore_the_shares_and_are_one_on_average() -> None:
    parts = strata([0] * 6 + [1] * 4)
    taken = np.array([1.0] * 2 + [0.0] * 4 + [1.0] * 4)  # the second kind whole, of the first a third
    weight = parts.weights(taken)
    np.testing.assert_allclose([np.average(weight, weights=taken), weight[0] / weight[-1]], [1.0, 3.0])


def test_what_is_not_in_the_sample_has_no_weight() -> None:
    parts = strata([0] * 6 + [1] * 4)
    taken = np.array([1.0] * 3 + [0.0] * 7)
    assert parts.weights(taken).tolist() == [1.0] * 6 + [0.0] * 4
