"""What was played, as a measured-run file: accelerations as the plant's own sensors record them, and positions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ffcomp.simulate.playback import Piece
from models.arrays import FloatArray
from models.effects.catalogue import measured
from models.effects.effect import Signals
from models.machine import Machine

KINDS = ("acc", "pos")
IN_TIME = {"sensor_time_offset", "sensor_clock_drift"}  # effects for which a sample depends on others than itself


def run_lines(
    pieces: Iterable[Piece], plant: Machine, comments: Mapping[str, str], kinds: Sequence[str] = KINDS
) -> Iterator[bytes]:
    """The file, piece by piece: comments, header, rows. The pieces are of one stretch.

    kinds : which sensors there are, of "acc" (m/s², gravity removed) and "pos" (mm).
    """
    yield "".join(f"# {key}: {' '.join(text.split())}\n" for key, text in comments.items()).encode()
    yield (",".join(_columns(kinds)) + "\n").encode()
    row = ",".join(["%.7f"] * (4 + 6 * len(kinds))) + "\n"
    for piece in _sensed(pieces, plant):
        values = _values(piece, kinds)
        yield (row * len(values) % tuple(values.ravel().tolist())).encode()


def _columns(kinds: Sequence[str]) -> list[str]:
    units = {"acc": "m_per_s2", "pos": "mm"}
    sensors = [f"{kind}_{axis}_{units[kind]}" for kind in kinds for axis in "ABCxyz"]
    return ["t_s", *(f"cmd_{axis}_mm" for axis in "ABC"), *sensors]


def _values(piece: Piece, kinds: Sequence[str]) -> FloatArray:
    """(n, columns)"""
    blocks = {
        "acc": (piece.signals.carriage, piece.signals.nozzle),
        "pos": (piece.carriage_mm, piece.nozzle_mm),
    }
    sensors = [block for kind in kinds for block in blocks[kind]]
    return np.column_stack([piece.t_s, piece.stretch.meant(piece.t_s), *sensors])


def _sensed(pieces: Iterable[Piece], plant: Machine) -> Iterator[Piece]:
    """With the accelerations that the plant's sensors would have recorded, on a clock that begins with the run."""
    if IN_TIME & plant.effects.keys():
        yield _felt(_joined(list(pieces)), plant)
    else:
        for piece in pieces:
            yield _felt(piece, plant)


def _felt(piece: Piece, plant: Machine) -> Piece:
    since_begin = replace(piece.signals, t_s=piece.t_s - piece.t_s[0])
    return replace(piece, signals=measured(plant, since_begin))


def _joined(pieces: Sequence[Piece]) -> Piece:
    t_s, carriage_mm, nozzle_mm, carriage, nozzle = (
        np.concatenate(parts)
        for parts in zip(
            *((p.t_s, p.carriage_mm, p.nozzle_mm, p.signals.carriage, p.signals.nozzle) for p in pieces), strict=True
        )
    )
    return Piece(pieces[0].stretch, t_s, carriage_mm, nozzle_mm, Signals(t_s, carriage, nozzle))
