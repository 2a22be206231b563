import numpy as np
import pytest

from ffcomp.numerics.serialise import to_json


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, np.float64("nan"), np.float32("inf"), float("nan")])
def test_numbers_that_json_cannot_hold_become_null(value: float) -> None:
    assert to_json(value) is None
    assert to_json(np.array([value, 1.0])) == [None, 1.0]
