"""Statistics are values that add up."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import FrozenInstanceError
from functools import reduce
from operator import add

import numpy as np
import pytest

from ffcomp.compensate.prediction import Samples
from ffcomp.compensate.statistics import Statistics
from ffcomp.compensate.stream import Stream


def samples(clock: float, wanted: float) -> Samples:
    point = np.full((1, 3), wanted)
    return Samples(1e-3, clock, clock, point[0], [point], [np.array([0.0])], [point])


def test_numbers_add_and_a_warning_is_kept_once() -> None:
    parts = [
        Statistics(moves=1, print_time_s=1.5, warnings=("a",)),
        Statistics(segments=2, warnings=("b", "a", "b")),
        Statistics(moves=4, windows=3, limited_windows=1, original_print_time_s=2.0),
    ]
    expected = Statistics(5, 2, 3, 1, 2.0, 1.5, ("a", "b"))
    assert reduce(add, parts) == reduce(add, parts, Statistics()) == expected


def test_samples_follow_one_another_in_time_and_in_space() -> None:
    first, second = (Statistics(predicted=samples(clock, 1.0 + clock)) for clock in (2.0, 3.0))
    both = (first + Statistics() + second).predicted
    assert both is not None and first.predicted is not None
    assert both.clock == both.covered_s == 5.0
    np.testing.assert_array_equal(np.concatenate(both.reference)[:, 0], [3.0, 7.0])
    np.testing.assert_array_equal(np.concatenate(both.path_t), [0.0, 2.0])
    assert len(first.predicted.reference) == 1  # what is added stays as it is


def test_statistics_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        Statistics().moves = 1  # type: ignore[misc]


def test_a_stream_keeps_what_its_generator_returns() -> None:
    def lines() -> Generator[bytes, None, int]:
        yield b"a"
        yield b"b"
        return 7

    stream = Stream(lines())
    assert not hasattr(stream, "value")
    assert list(stream) == [b"a", b"b"] and stream.value == 7
