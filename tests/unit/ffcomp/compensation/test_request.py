"""The request of `compensate`: texts become values, and what does not go together is refused."""

from __future__ import annotations

from typing import Any

import pytest

from ffcomp.compensation.request import CompensateRequest
from ffcomp.errors import RequestError


def test_a_text_is_read_where_a_number_belongs() -> None:
    read = CompensateRequest("a.gcode", "kossel", max_error_um="60", tolerance_um="5")  # type: ignore[arg-type]
    assert (read.errors_um, read.tolerance_um) == ({"": 60.0}, 5.0)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"keep_speed": ("Bridge",)}, "--max-error-um"),
        ({"max_error_um": 0.01}, "from 0.1"),
        ({"max_error_um": {"Bridge": 10.0}}, "without a feature"),
        ({"inverse": "none"}, "--inverse none"),
        ({"inverse": "quick"}, "there is no 'quick'"),
        ({"tolerance_um": 0.0}, "at least 0.1 µm"),
        ({"safety": 0.6}, "0.001 to 0.5"),
        ({"max_error_um": "sixty"}, "it is a number of µm"),
        ({"tolerance_um": "fine"}, "it is a number"),
        ({"jobs": 0}, "at least 1"),
    ],
)
def test_what_does_not_go_together_is_refused(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(RequestError, match=sentence):
        CompensateRequest("a.gcode", "kossel", **options)
