"""The comment that says when a section begins: a plain decimal, read back to a tenth of a µs."""

from __future__ import annotations

import pytest

from gcode.embedded import section_time_line, section_times


@pytest.mark.parametrize("t", [0.0, -0.008, -4.61e-5, -3e-9, 12.3456789, 86400.000004])
def test_a_time_is_a_plain_decimal(t: float) -> None:
    line = section_time_line(6, t)
    assert b"e-" not in line and b"=-0 " not in line
    (found,) = section_times([line + b"\n"])
    assert found.line == 6 and found.t == pytest.approx(t, abs=5.1e-8)
