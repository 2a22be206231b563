"""The search for the highest acceleration, on errors that are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ffcomp.comparison.equal_quality import HIGHEST, LOWEST, ROUNDS, Search

ERRORS: dict[str, tuple[Callable[[float], float], float]] = {  # of an acceleration, and the highest with 25 µm
    "in proportion": (lambda a: a / 200, 5000.0),
    "a floor": (lambda a: 20 + a / 1000, 5000.0),
    "steep": (lambda a: 25 * (a / 8000) ** 3, 8000.0),
    "a limit of the carriages": (lambda a: 3.0 if a <= 7000 else np.inf, 7000.0),
    "always good": (lambda a: 1.0, HIGHEST),
}


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("first", [LOWEST, 1000.0, 20_000.0])
def test_it_finds_the_highest(name: str, first: float) -> None:
    error, highest = ERRORS[name]
    search, rounds = Search(25.0, first), 0
    while not search.done and rounds < ROUNDS:
        acceleration = search.next()
        search.take(acceleration, error(acceleration))
        rounds += 1
    assert search.good is not None
    assert 0.95 * highest <= search.good[0] <= highest
    assert search.good[1] == error(search.good[0]) <= 25.0
    assert search.capped == (name == "always good")
