"""Write the text of a compensated file: stamp, and lines that are known at the end of the print only.

The print time is stated at the head of a file and in every M73, and is known when the whole print has been planned. So
the text waits in a temporary file: the longest print needs one more copy of itself on the disk, and no memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import SpooledTemporaryFile

from gcode.embedded import TIME_WAS
from gcode.metadata import Durations, Tells, Timed, retold, stated_time, tells, with_waiting_s

IN_MEMORY, BLOCK = 4 << 20, 1 << 20  # bytes


@dataclass(slots=True)
class Later:
    """Lines that are known later."""

    text: bytes | None = None  # None: not known yet


Text = Iterable[bytes | Later]


def in_order(pieces: Text, folder: Path | None = None) -> Iterator[bytes]:
    """Yield pieces in their order, once all are made and every `Later` among them is known.

    folder : holds the temporary file; None: the system's folder
    """
    waiting: list[tuple[int, Later]] = []  # each with the number of bytes before it
    with SpooledTemporaryFile(IN_MEMORY, dir=str(folder) if folder else None) as held:
        for piece in pieces:
            if isinstance(piece, Later):
                while waiting and waiting[-1][1].text == b"":
                    waiting.pop()
                waiting.append((held.tell(), piece))
            else:
                held.write(piece)
        held.seek(0)
        for until, later in waiting:
            while size := until - held.tell():
                yield held.read(min(size, BLOCK))
            yield later.text or b""
        while piece := held.read(BLOCK) + held.readline():  # the last one holds the whole last line
            yield piece


def with_times_retold(
    pieces: Iterable[bytes], planned_s: Callable[[], tuple[float, float]], *, embed: bool = True
) -> Iterator[bytes | Later]:
    """Rewrite the lines that state a time; a comment before each keeps the original time.

    pieces : with every line that states a time, or begins a layer, as a `Timed` of its own
    planned_s : returns the planned duration of the print and of the original, s; called after the last piece
    embed : whether the comments are written
    """
    layers: list[float] = []  # when each begins
    waiting: list[tuple[Timed, Later]] = []
    for piece in pieces:
        if not isinstance(piece, Timed):
            yield piece
        elif (stated := tells(piece)) is None:
            layers.append(piece.at_s)
            yield piece
        elif stated is Tells.ELAPSED:
            yield _retold(piece, Durations(piece.at_s), embed)
        else:
            waiting.append((piece, Later()))
            yield waiting[-1][1]
    first_layer_s = layers[1] - layers[0] if len(layers) > 1 else None
    total_s, sliced_s = planned_s()
    stated_s = next(filter(None, (with_waiting_s(line) for line, _ in waiting)), 0.0)
    durations = Durations(total_s, first_layer_s, sliced_s if stated_s > sliced_s > 0.0 else None)
    for line, later in waiting:
        later.text = _retold(line, durations, embed)


def _retold(line: Timed, durations: Durations, embed: bool) -> bytes:
    new = retold(line, durations)
    ending = line[len(line.rstrip(b"\r\n")) :] or b"\n"
    return new if new == line or not embed else TIME_WAS + stated_time(line) + ending + new


def stamped(pieces: Iterator[bytes], stamp: bytes, notes: bytes, at_end: bytes) -> Iterator[bytes]:
    """Put the stamp after the first line (slicers are known by it) and before a last line without newline.

    notes : lines behind the first stamp;  at_end : lines behind the second one
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
    yield kept[:end] + stamp + at_end.replace(b"\n", ending)
    yield kept[end:]
