"""Write the text of a compensated file as it streams: stamp, and times retold when the end is known.

A file says at its head how long it takes, and with M73 all along how much is left. So from the first such line on,
what is written waits in a file without a name, and is read out again when the whole print has been planned. The
longest print costs one more copy of itself on the disk, for that long, and no memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import IO

from gcode.embedded import TIME_WAS
from gcode.metadata import Durations, Tells, Timed, retold, stated_time, tells, with_waiting_s

IN_MEMORY, BLOCK = 4 << 20, 1 << 20  # bytes


def with_times_retold(
    pieces: Iterable[bytes],
    planned_s: Callable[[], tuple[float, float]],
    folder: Path | None = None,
    *,
    embed: bool = True,
) -> Iterator[bytes]:
    """Rewrite the lines that tell a time; a comment before each keeps what it was.

    Parameters
    ----------
    pieces : with every line that tells a time, or begins a layer, as a `Timed` of its own
    planned_s : what the print takes, and took as it was sliced, s; asked at the end of the pieces
    folder : where they may wait; None: where the system keeps such files
    embed : whether the comments are written
    """
    layers: list[float] = []  # when each begins
    waiting: list[tuple[int, Timed]] = []  # each with how much is held before it
    with SpooledTemporaryFile(IN_MEMORY, dir=str(folder) if folder else None) as held:
        for piece in pieces:
            text, tells_time = piece, tells(piece) if isinstance(piece, Timed) else None
            if isinstance(piece, Timed) and tells_time is None:
                layers.append(piece.at_s)
            elif isinstance(piece, Timed) and tells_time is Tells.ELAPSED:
                text = _retold(piece, Durations(piece.at_s), embed)
            elif isinstance(piece, Timed):
                waiting.append((held.tell(), piece))
                continue
            if waiting:
                held.write(text)
            else:
                yield text
        first_layer_s = layers[1] - layers[0] if len(layers) > 1 else None
        total_s, sliced_s = planned_s()
        stated_s = next(filter(None, (with_waiting_s(line) for _, line in waiting)), 0.0)
        durations = Durations(total_s, first_layer_s, sliced_s if stated_s > sliced_s > 0.0 else None)
        yield from _released(held, waiting, durations, embed)


def _released(held: IO[bytes], waiting: list[tuple[int, Timed]], durations: Durations, embed: bool) -> Iterator[bytes]:
    held.seek(0)
    done = 0
    for until, line in waiting:
        yield from _read(held, until - done)
        yield _retold(line, durations, embed)
        done = until
    while piece := held.read(BLOCK):
        yield piece


def _read(held: IO[bytes], size: int) -> Iterator[bytes]:
    while size:
        piece = held.read(min(size, BLOCK))
        size -= len(piece)
        yield piece


def _retold(line: Timed, durations: Durations, embed: bool) -> bytes:
    new = retold(line, durations)
    ending = line[len(line.rstrip(b"\r\n")) :] or b"\n"
    return new if new == line or not embed else TIME_WAS + stated_time(line) + ending + new


def stamped(
    pieces: Iterator[bytes], stamp: bytes, notes: bytes, at_end: Callable[[], bytes] = lambda: b""
) -> Iterator[bytes]:
    """Put the stamp after the first line (slicers are known by it) and before a last line without newline.

    notes : lines behind the first stamp;  at_end : asked after the last piece for lines behind the second one
    """
    kept = next(pieces, b"")
    begin = kept.find(b"\n") + 1
    if b"\r" in kept[:begin].removesuffix(b"\r\n"):
        begin = 0  # lines that end in other ways: the stamp comes first of all
    ending = b"\r\n" if kept[:begin].endswith(b"\r\n") else b"\n"
    stamp = stamp.rstrip(b"\n") + ending
    yield kept[:begin] + stamp + notes.replace(b"\n", ending)
    kept = kept[begin:]
    for piece in filter(None, pieces):
        yield kept
        kept = piece
    end = kept.rfind(b"\n") + 1
    yield kept[:end] + stamp + at_end().replace(b"\n", ending)
    yield kept[end:]
