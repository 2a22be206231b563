"""A file that comes in blocks of bytes, cut anywhere, as parts of whole lines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

PART_BYTES = 1 << 20


def whole_lines(blocks: Iterable[bytes], part_bytes: int = PART_BYTES) -> Iterator[bytes]:
    r"""Parts of about `part_bytes`, cut after the last \n, \r\n or \r that has come; longer where a line is longer."""
    pending, searched = bytearray(), 0
    for piece in _pieces(blocks, part_bytes):
        pending += piece
        if len(pending) < part_bytes:
            continue
        cut = _after_last_line(pending, searched)
        if cut:
            yield bytes(pending[:cut])
            del pending[:cut]
        searched = max(0, len(pending) - 1)
    if pending:
        yield bytes(pending)


def _pieces(blocks: Iterable[bytes], longest: int) -> Iterator[bytes]:
    for block in blocks:
        if len(block) <= longest:
            yield block
        else:
            yield from (block[at : at + longest] for at in range(0, len(block), longest))


def _after_last_line(text: bytearray, begin: int) -> int:
    r"""Where the last line that ends after `begin` is over; 0: none does. A last \r may be half of a \r\n."""
    return max(text.rfind(b"\n", begin), text.rfind(b"\r", begin, len(text) - 1)) + 1
