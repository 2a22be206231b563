"""Text waits only behind lines that are not known yet, and keeps its order."""

from __future__ import annotations

from collections.abc import Iterator

from ffcomp.compensation.text_stream import Later, in_order


def test_text_is_released_once_the_lines_before_it_are_known() -> None:
    moving, total = Later(), Later()
    out: list[bytes] = []

    def pieces() -> Iterator[bytes | Later]:
        yield from (b"a", moving, b"b")
        moving.text, later = b"", Later()
        assert out == [b"a"]
        yield from (later, b"c")
        assert b"".join(out) == b"ab"
        yield from (total, b"d")
        later.text, last = b"1", Later()
        yield from (last, b"e")
        assert b"".join(out) == b"ab", "the total is not known yet"
        total.text, last.text = b"2", b"3"

    for piece in in_order(pieces()):
        out += [piece] if piece else []
    assert b"".join(out) == b"ab1c2d3e"
