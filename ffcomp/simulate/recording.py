"""Write an executed command as a recording: what the plant's own sensors would have recorded, and positions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ffcomp.simulate.playback import Chunk
from models.arrays import FloatArray
from models.effects.catalogue import measured
from models.effects.effect import Signals
from models.machine import Machine

KINDS = ("acc", "pos")
IN_TIME = {"sensor_time_offset", "sensor_clock_drift"}  # effects for which a sample depends on others than itself


def recording_lines(
    chunks: Iterable[Chunk], plant: Machine, comments: Mapping[str, str], kinds: Sequence[str] = KINDS
) -> Iterator[bytes]:
    """Yield the file chunk by chunk: comments, header, rows.

    Parameters
    ----------
    chunks : iterable of Chunk
        Of one section.
    plant : Machine
        The printer whose sensors record.
    comments : mapping
        Key and text of each comment.
    kinds : sequence of {"acc", "pos"}
        Accelerations (m/s², gravity removed) and positions (mm).
    """
    yield "".join(f"# {key}: {' '.join(text.split())}\n" for key, text in comments.items()).encode()
    columns, actuators = _columns(kinds, plant.vibration.channels), _actuators(plant.vibration.channels)
    yield (",".join(columns) + "\n").encode()
    row = ",".join(["%.7f"] * len(columns)) + "\n"
    for chunk in _recorded(chunks, plant):
        values = _values(chunk, kinds, bool(actuators))
        yield (row * len(values) % tuple(values.ravel().tolist())).encode()


def _actuators(channels: Sequence[str]) -> list[str]:
    """Name the actuators that are something else than the nozzle's axes."""
    return [name for name in channels if name not in "xyz"]


def _columns(kinds: Sequence[str], channels: Sequence[str]) -> list[str]:
    units = {"acc": "m_per_s2", "pos": "mm"}
    sensors = [f"{kind}_{axis}_{units[kind]}" for kind in kinds for axis in (*_actuators(channels), *"xyz")]
    return ["t_s", *(f"cmd_{axis}_mm" for axis in channels), *sensors]


def _values(chunk: Chunk, kinds: Sequence[str], carriages: bool) -> FloatArray:
    """Return the rows : (n, columns); of straight axes, which are their own carriages, without those."""
    blocks = {
        "acc": (chunk.signals.carriage, chunk.signals.nozzle),
        "pos": (chunk.carriage_mm, chunk.nozzle_mm),
    }
    sensors = [block for kind in kinds for block in blocks[kind][0 if carriages else 1 :]]
    return np.column_stack([chunk.t_s, chunk.section.actuators(chunk.t_s), *sensors])


def _recorded(chunks: Iterable[Chunk], plant: Machine) -> Iterator[Chunk]:
    """Replace true accelerations by the sensors' signals, on a clock that begins with the recording."""
    if IN_TIME & plant.effects.keys():
        yield _with_sensor_signals(_joined(list(chunks)), plant)
    else:
        for chunk in chunks:
            yield _with_sensor_signals(chunk, plant)


def _with_sensor_signals(chunk: Chunk, plant: Machine) -> Chunk:
    since_begin = replace(chunk.signals, t_s=chunk.t_s - chunk.t_s[0])
    return replace(chunk, signals=measured(plant, since_begin))


def _joined(chunks: Sequence[Chunk]) -> Chunk:
    t_s, carriage_mm, nozzle_mm, carriage, nozzle = (
        np.concatenate(parts)
        for parts in zip(
            *((c.t_s, c.carriage_mm, c.nozzle_mm, c.signals.carriage, c.signals.nozzle) for c in chunks), strict=True
        )
    )
    return Chunk(chunks[0].section, t_s, carriage_mm, nozzle_mm, Signals(t_s, carriage, nozzle))
