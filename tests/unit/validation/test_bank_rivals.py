"""The other methods that the blind bank compares with, on made-up signatures."""

from __future__ import annotations

import numpy as np
import pytest

from studies.diagnosis_rivals import Library, sindy, spike_and_slab

ROWS = 2000


def library(truth: dict[str, float], noise: float = 1.0) -> Library:
    """Eight candidates of two columns each, two of them alike, and what some of them leave in the data."""
    rng = np.random.default_rng(4)
    columns = {name: rng.standard_normal((ROWS, 2)) for name in "abcdefgh"}
    columns["b"] = 0.9 * columns["a"] + 0.4 * columns["b"]
    residual = noise * rng.standard_normal(ROWS)
    for name, size in truth.items():
        residual = residual + size * columns[name] @ [1.0, -0.5]
    return Library(residual, columns, max(float(residual @ residual) - ROWS, 0.0))


@pytest.mark.parametrize("method", [sindy, spike_and_slab])
@pytest.mark.parametrize("truth", [{}, {"a": 1.0}, {"b": 1.0}, {"c": 0.5, "h": 2.0}])
def test_what_is_in_the_data_is_named(method: object, truth: dict[str, float]) -> None:
    assert callable(method)
    assert sorted(method(library(truth))) == sorted(truth)


def test_explained_is_least_squares() -> None:
    found = library({"c": 1.0})
    gain, count = found.explained(["c", "d"])
    assert count == 4
    assert gain == pytest.approx(found.whole, rel=0.5)
    assert found.explained([]) == (0.0, 0)
    assert gain >= found.explained(["c"])[0] >= found.explained(["d"])[0]
