"""The commands of a chapter's runs, played on the whole virtual printer: in pieces, side by side.

A piece begins from rest, some time before what counts of it: until then the printer has forgotten how it began. It
comes up to speed gently, for a motor that is torn along loses steps, and that is not forgotten.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import values_of
from models.machine import Machine
from models.printer.kernels.record import LANES
from models.printer.printer import PrinterMotion, simulate_printers

Seen = Callable[[PrinterMotion], FloatArray]  # (n, 3) mm of a motion of n rows

REMEMBERED_S = 1.0  # by a printer; by its frame until e to the −7 is left
FORGOTTEN, LONGEST_S = 7.0, 30.0
STARTING_S = 0.25


def rehearsed(
    machine: Machine,
    commands: Sequence[FloatArray],
    rests: Sequence[int | None],
    row_s: float,
    after: int,
    seen: Seen,
    late_s: float = 0.0,
) -> list[FloatArray]:
    """What is seen in every run and so many rows after it, (n + after, 3) mm.

    Parameters
    ----------
    commands : (n, 3) mm each, carriage heights every `row_s`
    rests : rows since the run before; None: others have moved the nozzle
    late_s : by how much later the printer is looked at
    """
    remembered = round(memory_s(machine) / row_s)
    lines, found = _lines(commands, rests, after, remembered), []
    played = _in_pieces(machine, [line.rows for line in lines], row_s, remembered, seen)
    for line, values in zip(lines, played, strict=True):
        t = np.arange(len(values), dtype=np.float64)
        for (begin, end), until in zip(line.runs, [*(begin for begin, _ in line.runs[1:]), t[-1]], strict=True):
            own = np.minimum(np.arange(begin, end + after) + late_s / row_s, until)  # there, the next run begins
            found.append(np.stack([np.interp(own, t, axis) for axis in values.T], axis=1))
    return found


def memory_s(machine: Machine) -> float:
    """After how long it no longer matters what came before."""
    frame = values_of(machine, "frame_mode")
    rate = np.inf if frame is None else 2 * np.pi * float(frame["frequency_hz"]) * float(frame["damping_ratio"])
    return max(REMEMBERED_S, FORGOTTEN / max(rate, FORGOTTEN / LONGEST_S))


@dataclass(frozen=True, slots=True)
class _Line:
    """Runs that follow each other, with the rests between them."""

    rows: FloatArray  # (n, 3) mm
    runs: list[tuple[int, int]]  # the row at which each begins, and the one after its last


def _lines(commands: Sequence[FloatArray], rests: Sequence[int | None], after: int, longest: int) -> list[_Line]:
    """longest : rows of a rest; more make no difference"""
    new = [i for i, rest in enumerate(rests) if i == 0 or rest is None]
    return [
        _line(commands[a:b], [min(rest or 0, longest) for rest in rests[a + 1 : b]], after)
        for a, b in pairwise([*new, len(rests)])
    ]


def _line(commands: Sequence[FloatArray], rests: Sequence[int], after: int) -> _Line:
    rows, runs = [commands[0]], [(0, len(commands[0]))]
    for command, rest in zip(commands[1:], rests, strict=True):
        begin = runs[-1][1] + rest
        rows += [np.repeat(command[:1], rest, axis=0), command]
        runs.append((begin, begin + len(command)))
    return _Line(np.concatenate([*rows, np.repeat(commands[-1][-1:], after + 1, axis=0)]), runs)


def _in_pieces(
    machine: Machine, lines: Sequence[FloatArray], row_s: float, remembered: int, seen: Seen
) -> list[FloatArray]:
    """What is seen at every row of commands (n, 3) mm, in about as many pieces as the printer has lanes."""
    enough = max(sum(map(len, lines)) / LANES, remembered)
    cuts = [np.linspace(0, len(line), max(int(len(line) / enough), 1) + 1).astype(int) for line in lines]
    pieces = [(line, a, b) for line, at in zip(lines, cuts, strict=True) for a, b in pairwise(at)]
    starting = round(STARTING_S / row_s)
    commands = [_started(line[a - remembered : b], starting) if a > remembered else line[:b] for line, a, b in pieces]
    motions, values = simulate_printers([machine] * len(pieces), commands, row_s, hold="linear"), []
    for (_, a, b), motion in zip(pieces, motions, strict=True):
        if isinstance(motion, ValueError):
            raise motion
        values.append(seen(motion)[a - b :])
    ends = np.cumsum([len(at) - 1 for at in cuts])
    return [np.concatenate(values[end - len(at) + 1 : end]) for at, end in zip(cuts, ends, strict=True)]


def _started(rows: FloatArray, starting: int) -> FloatArray:
    """A command that sets out from rest: what it does first, in so many rows instead of half of them."""
    slow = np.arange(starting, dtype=np.float64) ** 2 / (2 * starting)
    index, half = np.arange(len(rows), dtype=np.float64), starting // 2
    first = np.stack([np.interp(slow, index, axis) for axis in rows.T], axis=1)
    return np.concatenate([first, rows[half:]])
