"""Play a command of any length on one simulated printer or on many, chunk by chunk: only one chunk is held.

Printers go side by side in the lanes of the processor's vectors, and groups of them in threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from models.arrays import FloatArray
from models.machine import Machine
from models.printer.kernels.record import LANES
from models.printer.printer import SPLINE_ROWS, Hold, PrinterMotion, PrinterState, simulate_printers

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
    threads: int = 1,
    substeps: int | None = None,
) -> Iterator[tuple[int, list[PrinterMotion]]]:
    """Play one command on every machine, or on each its own, from rest.

    Parameters
    ----------
    machines : sequence of Machine
    rows : callable, or a sequence of one for each machine
        Carriage positions, columns A B C. A cubic hold asks for some rows behind the last, and for one command.
    count : int
        Rows that are played, at least two.
    row_s : float
        Time from row to row, s.
    hold : {"cubic", "linear"}
        How the command runs from row to row.
    gravity : bool
    chunk_rows : int
        Intervals of a chunk.
    threads : int
    substeps : int, optional
        Integration steps from row to row. None: as many as each printer asks for.

    Yields
    ------
    int, list of PrinterMotion
        The first row of a chunk, and one motion a machine. A chunk begins with the last row of the one before.

    Raises
    ------
    UnreachableError
        If a nozzle leaves the reach of its arms.
    ValueError
        If the command or the effects of a machine are not complete, or a printer cannot rest.
    """
    ahead = SPLINE_ROWS if hold == "cubic" else 0
    each = [rows] if callable(rows) else list(rows)
    if len(each) > 1 and ahead:
        raise ValueError("Several commands are played with a linear hold only.")
    groups = max(-(-len(machines) // LANES), min(threads, len(machines)))
    parts = [part.tolist() for part in np.array_split(np.arange(len(machines)), groups)]
    states: list[PrinterState] | None = None

    def advance(part: Sequence[int]) -> list[PrinterMotion]:
        found = simulate_printers(
            [machines[i] for i in part],
            [commands[i % len(commands)] for i in part],
            row_s,
            starts=None if states is None else [states[i] for i in part],
            substeps=substeps,
            gravity=gravity,
            hold=hold,
            ahead=coming,
        )
        return [_played(each) for each in found]

    with ThreadPoolExecutor(max(threads, 1)) as pool:
        for first in range(0, count - 1, chunk_rows):
            last = min(first + chunk_rows + 1, count)
            both = [own(first, last + ahead) for own in each]
            commands, coming = [own[: last - first] for own in both], both[0][last - first :]
            run = pool.map if threads > 1 and len(parts) > 1 else map
            motions = [motion for group in run(advance, parts) for motion in group]
            states = [motion.state for motion in motions]
            yield first, motions


def _played(found: PrinterMotion | ValueError) -> PrinterMotion:
    if isinstance(found, ValueError):
        raise found
    return found
