"""What the summary of `ffcomp compensate` says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.compensation.result import NO_GAIN, QuickerPrint, faster_line, late_line, uncertainty_line
from models.file import load_machine


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


def test_what_comes_late_is_told_apart_from_what_is_off() -> None:
    assert late_line(0.0) == ""
    assert "up to 44 ms" in late_line(0.044) and "up to 1.3 s" in late_line(1.3)


def test_a_bound_says_which_uncertainty_was_assumed() -> None:
    stated = load_machine("mp-delta-pro")
    assert "uncertain by 2 % (standard deviation)" in uncertainty_line(replace(stated, uncertainty={"default": 0.02}))
    for uncertainty in ({"default": 0.05}, {"default": 0.02, "carriage.mass_kg": 0.1}):
        assert uncertainty_line(replace(stated, uncertainty=uncertainty)) == ""
