"""What the summary of `ffcomp compensate` says."""

from __future__ import annotations

import pytest

from ffcomp.cli.compensate import NO_GAIN, faster_line
from ffcomp.compensation.result import QuickerPrint


@pytest.mark.parametrize(
    ("seconds", "limit", "slower"),
    [(80.0, "error_bound", False), (104.0, "error_bound", True), (104.0, "as_sliced", False)],
)
def test_a_print_that_takes_longer_than_it_was_sliced_says_why(seconds: float, limit: str, slower: bool) -> None:
    limits = {"error_bound": 10.0, "as_sliced": 10.0, limit: seconds - 10.0}
    line = faster_line(
        QuickerPrint(
            print_time_s=seconds,
            original_print_time_s=100.0,
            actuator_limit_s=60.0,
            limited_by=limits,
            contour_p99_um=9.0,
            contour_max_um=20.0,
            by_feature={},
        )
    )
    assert f"100.0 → {seconds:.1f} s" in line
    assert (NO_GAIN in line) == slower
