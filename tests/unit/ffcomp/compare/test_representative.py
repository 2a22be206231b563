"""Slices that stand for a whole: chosen without overlap, nearest to its shares, and weighted."""

from __future__ import annotations

import numpy as np

from ffcomp.compare.representative import Strata, choose


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
