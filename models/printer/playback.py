"""Play long commands: whole prints chunk by chunk with one chunk in memory, and sections of a print in windows.

Printers, or windows, run in the lanes of the processor's vectors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE, values_of
from models.machine import Machine
from models.printer.kernels.record import LANES
from models.printer.parameters import converted_printer
from models.printer.printer import SPLINE_ROWS, Hold, PrinterMotion, PrinterState, played, simulate_printers

Rows = Callable[[int, int], FloatArray]  # first, last → (last - first, 3) mm, rows first … last - 1 of a command

CHUNK_ROWS = 64_000


def play(
    machines: Sequence[Machine],
    rows: Rows | Sequence[Rows],
    count: int,
    row_s: float,
    *,
    hold: Hold = "cubic",
    gravity: bool = True,
    chunk_rows: int = CHUNK_ROWS,
    substeps: int | None = None,
) -> Iterator[tuple[int, list[PrinterMotion]]]:
    """Play one command on every machine, or on each its own, from rest.

    rows : of all machines, or one for each: carriage positions, columns A B C. A cubic hold reads some rows past the
        last, and takes one command only.
    count : rows that are played, at least two
    row_s : s, from row to row
    hold, gravity, substeps : as for `simulate_printer`
    chunk_rows : intervals of a chunk

    Yields the first row of a chunk, and one motion a machine. A chunk begins with the last row of the one before.

    Raises UnreachableError if a nozzle leaves the reach of its arms; ValueError if the command or the effects of a
    machine are incomplete, or a printer has no rest position.
    """
    ahead = SPLINE_ROWS if hold == "cubic" else 0
    each = [rows] if callable(rows) else list(rows)
    if len(each) > 1 and ahead:
        raise ValueError("Several commands are played with a linear hold only.")
    printers = [converted_printer(machine, gravity=gravity) for machine in machines]
    states: list[PrinterState] | None = None
    for first in range(0, count - 1, chunk_rows):
        last = min(first + chunk_rows + 1, count)
        both = [one(first, last + ahead) for one in each]
        own, coming = [one[: last - first] for one in both], both[0][last - first :]
        commands = own * (len(machines) // len(own))
        how: Any = {"starts": states, "substeps": substeps, "hold": hold, "ahead": coming}
        motions = [played(motion) for motion in simulate_printers(printers, commands, row_s, **how)]
        states = [motion.state for motion in motions]
        yield first, motions


Observe = Callable[[PrinterMotion], FloatArray]  # (n, 3) mm of a motion of n rows

MEMORY_S = 1.0  # of a printer without a vibrating frame
DECAY, LONGEST_S = 7.0, 30.0  # a frame's vibration has decayed to e to the −7
START_S = 0.25


def simulate_batch(
    machine: Machine,
    commands: Sequence[FloatArray],
    rests: Sequence[int | None],
    row_s: float,
    after: int,
    observe: Observe,
    delay_s: float = 0.0,
) -> list[FloatArray]:
    """Simulate every section and observe it, together with the rows right after it.

    commands : carriage heights of each section, (n, 3) mm, columns A B C
    rests : rows of rest since the section before; None: the nozzle has been moved in between
    row_s : s, from row to row
    after : rows to observe after a section's last
    observe : the observed quantity of a motion
    delay_s : s, of the observation

    Returns (n + after, 3) mm of each section; ValueError if the printer cannot be simulated under a command.
    """
    memory = round(memory_s(machine) / row_s)
    lines, observed = _lines(commands, rests, after, memory), []
    motions = _in_windows(machine, [line.rows for line in lines], row_s, memory, observe)
    for line, values in zip(lines, motions, strict=True):
        t = np.arange(len(values), dtype=np.float64)
        next_begins = [*(begin for begin, _ in line.sections[1:]), t[-1]]
        for (begin, end), until in zip(line.sections, next_begins, strict=True):
            at = np.minimum(np.arange(begin, end + after) + delay_s / row_s, until)
            observed.append(np.stack([np.interp(at, t, axis) for axis in values.T], axis=1))
    return observed


def memory_s(machine: Machine) -> float:
    """Return the time, s, after which the printer's earlier motion no longer matters."""
    frames = [name for name in machine.effects if CATALOGUE[name].kind == "frame"]
    swaying = [values for name in frames if (values := values_of(machine, name)) is not None]
    rates = [2 * np.pi * float(each["frequency_hz"]) * float(each["damping_ratio"]) for each in swaying]
    return max(MEMORY_S, DECAY / max(min(rates, default=np.inf), DECAY / LONGEST_S))


@dataclass(frozen=True, slots=True)
class _Line:
    """Consecutive sections with the rests between them."""

    rows: FloatArray  # (n, 3) mm
    sections: list[tuple[int, int]]  # the first row of each, and the one after its last


def _lines(commands: Sequence[FloatArray], rests: Sequence[int | None], after: int, longest: int) -> list[_Line]:
    """Join sections up to the next unknown rest; a rest of more than `longest` rows is cut to that."""
    new = [i for i, rest in enumerate(rests) if i == 0 or rest is None]
    return [
        _line(commands[a:b], [min(rest or 0, longest) for rest in rests[a + 1 : b]], after)
        for a, b in pairwise([*new, len(rests)])
    ]


def _line(commands: Sequence[FloatArray], rests: Sequence[int], after: int) -> _Line:
    rows, sections = [commands[0]], [(0, len(commands[0]))]
    for command, rest in zip(commands[1:], rests, strict=True):
        begin = sections[-1][1] + rest
        rows += [np.repeat(command[:1], rest, axis=0), command]
        sections.append((begin, begin + len(command)))
    return _Line(np.concatenate([*rows, np.repeat(commands[-1][-1:], after + 1, axis=0)]), sections)


def _in_windows(
    machine: Machine, lines: Sequence[FloatArray], row_s: float, memory: int, observe: Observe
) -> list[FloatArray]:
    """Observe every row of commands (n, 3) mm, simulated in about as many windows as the printer has lanes."""
    enough = max(sum(map(len, lines)) / LANES, memory)
    cuts = [np.linspace(0, len(line), max(int(len(line) / enough), 1) + 1).astype(int) for line in lines]
    windows = [(line, a, b) for line, at in zip(lines, cuts, strict=True) for a, b in pairwise(at)]
    start = round(START_S / row_s)
    commands = [gentle_start(line[a - memory : b], start) if a > memory else line[:b] for line, a, b in windows]
    printers, values = [converted_printer(machine)] * len(windows), []
    for (_, a, b), motion in zip(windows, simulate_printers(printers, commands, row_s, hold="linear"), strict=True):
        values.append(observe(played(motion))[a - b :])
    ends = np.cumsum([len(at) - 1 for at in cuts])
    return [np.concatenate(values[end - len(at) + 1 : end]) for at, end in zip(cuts, ends, strict=True)]


def gentle_start(rows: FloatArray, start: int) -> FloatArray:
    """Accelerate a command from rest: its first `start // 2` rows take `start` rows."""
    slow = np.arange(start, dtype=np.float64) ** 2 / (2 * start)
    index, half = np.arange(len(rows), dtype=np.float64), start // 2
    first = np.stack([np.interp(slow, index, axis) for axis in rows.T], axis=1)
    return np.concatenate([first, rows[half:]])
