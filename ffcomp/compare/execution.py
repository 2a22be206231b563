"""Execute motions of many methods and slices on one printer, side by side in the lanes of the processor's vectors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from ffcomp.compare.evaluation import Execution
from ffcomp.compare.parallel import Progress, in_parallel
from ffcomp.compare.sampling import PrintSlice
from ffcomp.simulate.motion import Motion
from ffcomp.simulate.playback import side_by_side, simulate_side_by_side
from models.machine import Machine

Piece = tuple[PrintSlice, Motion]


def execute(
    plant: Machine, pieces: Sequence[Piece], what: str, progress: Progress, *, coarse: bool = False
) -> list[Execution]:
    """Execute every piece from rest, in the order of the pieces.

    Parameters
    ----------
    plant : Machine
    pieces : sequence of (PrintSlice, Motion)
    what : str
        For the progress.
    progress : callable
    coarse : bool
        See `simulate_side_by_side`.
    """
    groups = side_by_side([motion for _, motion in pieces])
    tasks = [partial(_together, plant, [pieces[k] for k in group], coarse) for group in groups]
    found: dict[int, Execution] = {}
    for group, executions in zip(groups, in_parallel(tasks, what, progress), strict=True):
        found |= zip(group, executions, strict=True)
    return [found[k] for k in range(len(pieces))]


def _together(plant: Machine, pieces: Sequence[Piece], coarse: bool) -> list[Execution]:
    believed = pieces[0][0].machine
    played = simulate_side_by_side(plant, [motion for _, motion in pieces], believed, coarse=coarse)
    return [Execution(*piece, t, nozzle) for piece, (t, nozzle) in zip(pieces, played, strict=True)]
