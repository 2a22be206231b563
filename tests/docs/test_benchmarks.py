"""The sections of the benchmark run and measure something, on a small print."""

from __future__ import annotations

import pytest

from benchmarks import speed

SMALL = [speed.ROOT / "docs" / "examples" / "print.gcode"]


@pytest.mark.parametrize("name", ["prints", "where", "read", "steps"])
def test_every_section_has_a_row_with_its_numbers(name: str) -> None:
    head, *rows = speed.SECTIONS[name](SMALL, 1)
    assert rows and all(len(row) == len(head) for row in rows)
    assert all(float(cell) > 0.0 for row in rows for cell in row[1:] if isinstance(cell, float))


def test_a_print_is_repeated_between_its_own_beginning_and_end() -> None:
    a, b = speed.LAYER + b"\na\n", speed.LAYER + b"\nb\n"
    begin, end = b"begin\n", speed.END + b"\nend\n"
    assert b"".join(speed.repeated(begin + a + b + end, 3)) == begin + a + b + a + end
