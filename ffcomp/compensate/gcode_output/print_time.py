"""The lines of a print that tell times, retold when its end is known.

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
from gcode.metadata import Durations, Tells, Timed, retold, tells, time_told

IN_MEMORY, BLOCK = 4 << 20, 1 << 20  # bytes


def with_times_retold(
    pieces: Iterable[bytes], total_s: Callable[[], float], folder: Path | None = None, *, embed: bool = True
) -> Iterator[bytes]:
    """Rewrite the lines that tell a time; a comment before each keeps what it was.

    Parameters
    ----------
    pieces : with every line that tells a time, or begins a layer, as a `Timed` of its own
    total_s : asked at the end of the pieces
    folder : where they may wait; None: where the system keeps such files
    embed : whether the comments are written
    """
    layers: list[float] = []  # when each begins
    waiting: list[tuple[int, Timed]] = []  # each with how much is held before it
    with SpooledTemporaryFile(IN_MEMORY, dir=str(folder) if folder else None) as held:
        for piece in pieces:
            text, told = piece, tells(piece) if isinstance(piece, Timed) else None
            if isinstance(piece, Timed) and told is None:
                layers.append(piece.at_s)
            elif isinstance(piece, Timed) and told is Tells.ELAPSED:
                text = _retold(piece, Durations(piece.at_s), embed)
            elif isinstance(piece, Timed):
                waiting.append((held.tell(), piece))
                continue
            if waiting:
                held.write(text)
            else:
                yield text
        first_layer_s = layers[1] - layers[0] if len(layers) > 1 else None
        yield from _released(held, waiting, Durations(total_s(), first_layer_s), embed)


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
    """Return the line to be written, after a comment with its old time if that was another."""
    new = retold(line, durations)
    ending = line[len(line.rstrip(b"\r\n")) :] or b"\n"
    return new if new == line or not embed else TIME_WAS + time_told(line) + ending + new
