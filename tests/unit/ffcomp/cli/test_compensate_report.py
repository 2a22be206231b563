"""What the summary of `ffcomp compensate` says."""

from __future__ import annotations

import pytest

from ffcomp.cli.compensate_report import SLOWER, faster_line


@pytest.mark.parametrize(("seconds", "slower"), [(80.0, False), (104.0, True)])
def test_a_print_that_takes_longer_than_it_was_sliced_says_why(seconds: float, slower: bool) -> None:
    times = {"original_print_time_s": 100.0, "print_time_s": seconds, "actuator_limit_s": 60.0}
    line = faster_line({**times, "contour_p99_um": 9.0, "contour_max_um": 20.0})
    assert f"100.0 → {seconds:.1f} s" in line
    assert (SLOWER in line) == slower
