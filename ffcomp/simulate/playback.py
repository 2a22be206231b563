"""A command played on a virtual printer, piece by piece: however long it is, only two pieces are held.

Rows of the command are at most ROW_S apart. A cubic spline through a plan's rows strays by 0.02 µm in the nozzle where
its speed has corners (5 mm/s at 10 m/s²), straight lines by 0.1 µm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ffcomp.simulate.command import Command, Stretch
from models.arrays import FloatArray
from models.effects.effect import Signals
from models.errors import MachineFileError, UnreachableError
from models.machine import Machine
from models.printer.printer import SPLINE_ROWS, Hold, printer_numbers, rest_values, simulate_printer

Item = TypeVar("Item")

ROW_S = 1 / 6400
CHUNK_ROWS = 40_000
SETTLE_S = 0.5  # played before a part that begins in the midst of motion, and not shown
ROUNDING = 1e-6  # of a sample
TAIL_S = 0.25  # shown after a stretch has ended: the printer rings on


@dataclass(frozen=True, eq=False)
class Piece:
    """n evenly spaced samples of a stretch; the next piece goes on where this one ends."""

    stretch: Stretch
    t_s: FloatArray  # (n,) s, on the command's clock
    carriage_mm: FloatArray  # (n, 3)
    nozzle_mm: FloatArray  # (n, 3), seen from the bed
    signals: Signals  # true accelerations


def rows_per_sample(rate_hz: float) -> int:
    """So many rows of the command for each sample that they are no farther apart than ROW_S."""
    return math.ceil((1 - 1e-9) / (rate_hz * ROW_S))


def play(
    command: Command,
    plant: Machine,
    rate_hz: float,
    from_s: float = 0.0,
    to_s: float = math.inf,
    *,
    gravity: bool = True,
) -> Iterator[Piece]:
    """The plant under a part of the command, stretch by stretch, each from rest.

    While a piece is looked at, the next one is computed in a thread.

    Raises
    ------
    MachineFileError
        If the plant cannot even rest.
    UnreachableError
        If its nozzle leaves the reach of its arms.
    """
    rows = rows_per_sample(rate_hz)
    for stretch, begin_s, end_s in command.between(from_s, to_s):
        tail_s = TAIL_S if end_s == stretch.end_s else 0.0
        lead = min(int((begin_s - stretch.begin_s) * rate_hz), math.ceil(SETTLE_S * rate_hz))
        last = int((end_s + tail_s - begin_s) * rate_hz + ROUNDING)
        t = begin_s + np.arange(-lead, last + 1) / rate_hz
        yield from _ahead(_stretch(stretch, plant, t, lead, 1 / (rate_hz * rows), rows, command.hold, gravity))


def _stretch(
    stretch: Stretch, plant: Machine, t: FloatArray, lead: int, row_s: float, rows: int, hold: Hold, gravity: bool
) -> Iterator[Piece]:
    """Samples at the even times t (n,) s, without the first `lead` of them; so many `rows`, row_s apart, for each."""
    _check_rest(plant, stretch.meant(t[:1])[0], gravity)
    chunk = CHUNK_ROWS // rows
    state = None
    for first in range(0, len(t) - 1, chunk):
        part = t[first : first + chunk + 1]
        own = (len(part) - 1) * rows + 1
        command = stretch.rows(part[0] + row_s * np.arange(own + SPLINE_ROWS), row_s)
        motion = simulate_printer(
            plant, command[:own], row_s, start=state, gravity=gravity, hold=hold, ahead=command[own:]
        )
        state = motion.state
        begin = max(lead - first, 0 if first == 0 else 1)  # the first sample is the last of the piece before
        every = slice(begin * rows, None, rows)
        signals = Signals(part[begin:], motion.carriage_acceleration[every], motion.nozzle_acceleration[every])
        if begin < len(part):
            yield Piece(stretch, part[begin:], motion.carriage_mm[every], motion.nozzle_mm[every], signals)


def _check_rest(plant: Machine, carriages: FloatArray, gravity: bool) -> None:
    try:
        rest_values(plant, carriages, printer_numbers(plant, gravity=gravity))
    except UnreachableError:
        raise
    except ValueError as error:
        raise MachineFileError(plant.path or plant.name, [str(error)]) from error


def _ahead(items: Iterator[Item]) -> Iterator[Item]:
    """The same items, each made while the one before is used."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = pool.submit(next, items, None)
            yield item
