import json

import numpy as np
import pytest

from ffcomp.numerics.serialise import json_line, to_json


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, np.float64("nan"), np.float32("inf"), float("nan")])
def test_numbers_that_json_cannot_hold_become_null(value: float) -> None:
    assert to_json(value) is None
    assert to_json(np.array([value, 1.0])) == [None, 1.0]


def test_what_json_cannot_hold_is_refused() -> None:
    with pytest.raises(TypeError, match="type bytes cannot be written as JSON"):
        to_json({"a": b"x"})


def test_a_line_of_json_keeps_letters_and_reads_back() -> None:
    line = json_line({"unit": "µm", "value": np.nan})
    assert "µm" in line and "\n" not in line
    assert json.loads(line) == {"unit": "µm", "value": None}
