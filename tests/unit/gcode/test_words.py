from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcode.errors import GcodeError
from gcode.words import commands


@pytest.mark.parametrize(
    ("line", "name", "numbers"),
    [
        (b"G0X-5Y0Z0F200\n", "G0", {"X": -5, "Y": 0, "Z": 0, "F": 200}),
        (b"G0 X -5 Y 0 Z 0 F 200\n", "G0", {"X": -5, "Y": 0, "Z": 0, "F": 200}),
        (b"g01 x1.5 e-.25 ; go\r\n", "G1", {"X": 1.5, "E": -0.25}),
        (b"G1 X1. Y+2 (left) Z3 (open", "G1", {"X": 1, "Y": 2, "Z": 3}),
        (b"\xef\xbb\xbfG28 X0\n", "G28", {"X": 0}),
        (b"G38.20 Z-5\n", "G38.2", {"Z": -5}),
    ],
)
def test_a_line_is_a_name_and_its_numbers(line: bytes, name: str, numbers: dict[str, float]) -> None:
    (command,) = commands(line, 1)
    assert (command.name, command.numbers()) == (name, numbers)


@given(st.integers(0, 99999), st.integers(-999, 999))
def test_checksums_are_checked(number: int, x: int) -> None:
    body = b"N%d G1 X%d" % (number, x)
    right = 0
    for byte in body:
        right ^= byte
    assert commands(body + b"*%d\n" % right, 7)[0].numbers() == {"X": x}
    with pytest.raises(GcodeError, match="checksum") as caught:
        commands(body + b"*%d ; noise\n" % (right ^ 1), 7)
    assert caught.value.line == 7


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        (b"G1 X Y1", "word X without a number"),
        (b"G1 X1 X2", "word X twice"),
        (b"G1 X1e30", "exponent"),
        (b"G1 X1 #2", "letter and a number"),
        (b"^%~n,B", "cannot be read as a command"),
    ],
)
def test_mistakes_are_sentences_with_their_line(line: bytes, rule: str) -> None:
    with pytest.raises(GcodeError, match=rule) as caught:
        commands(line, 42)[0].numbers()
    assert caught.value.line == 42
    assert str(caught.value).endswith(".")
