"""Every tuned method on Monte-Carlo plants: printers whose parameters are all a little off.

A task is one method on LANES plants, in one thread: its numbers do not depend on who computes it. Methods hold what
cannot be sent cheaply, so each commands its slices here, once, and only the commanded motions are sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

from ffcomp.comparison import methods as every
from ffcomp.comparison.baselines import LinearPrinter
from ffcomp.comparison.evaluation import Execution, Piece, Progress, contour, in_parallel, in_processes, weights
from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.result import Method, Spread
from ffcomp.comparison.sampling import PrintSlice
from ffcomp.metrics import rms
from ffcomp.simulation.playback import simulate_nozzles
from models.machine import Machine
from models.printer.kernels.record import LANES

ON_PLANTS, TUNING_ON_PLANTS = "printing on Monte-Carlo plants", "tuning shapers on Monte-Carlo plants"
COMMANDED_SHARE = 0.2  # of the time on the plants, until the commands are known


def with_spread(
    methods: dict[str, Method],
    tuned: Sequence[TunedMethod],
    best: str,
    slices: Sequence[PrintSlice],
    few: Sequence[PrintSlice],
    plants: Sequence[Machine],
    jobs: int,
    progress: Progress,
) -> dict[str, Method]:
    """Execute every tuned method on the Monte-Carlo plants; also retune the best fixed shaper on each."""
    with_plants = dict(methods)
    for name, spread in _spreads(tuned, slices, plants, jobs, progress).items():
        with_plants[name] = replace(methods[name], spread=spread)
    tasks = [partial(_retuned, best, each, few, slices) for each in plants]
    retuned = tuple(in_processes(tasks, jobs, TUNING_ON_PLANTS, progress))
    with_plants[best] = replace(with_plants[best], retuned=Spread(retuned))
    return with_plants


def _spreads(
    tuned: Sequence[TunedMethod], slices: Sequence[PrintSlice], plants: Sequence[Machine], jobs: int, progress: Progress
) -> dict[str, Spread]:
    commanded = in_parallel(
        [partial(_commanded, method, slices) for method in tuned],
        ON_PLANTS,
        lambda what, share: progress(what, COMMANDED_SHARE * share),
    )
    groups = [plants[k : k + LANES] for k in range(0, len(plants), LANES)]
    tasks = [partial(_rms_on, group, pieces) for pieces in commanded for group in groups]
    rest = 1 - COMMANDED_SHARE
    each = in_processes(tasks, jobs, ON_PLANTS, lambda what, share: progress(what, COMMANDED_SHARE + rest * share))
    count = len(groups)
    return {
        method.name: Spread(tuple(chain.from_iterable(each[k * count : (k + 1) * count])))
        for k, method in enumerate(tuned)
    }


def _commanded(method: TunedMethod, slices: Sequence[PrintSlice]) -> list[Piece]:
    return [(each, method.motion(each)[0]) for each in slices]


def _rms_on(plants: Sequence[Machine], pieces: Sequence[Piece]) -> list[float]:
    """Return the contour rms of one method's commands on every plant, at most LANES of them, µm."""
    executed: list[list[Execution]] = [[] for _ in plants]
    for print_slice, motion in pieces:
        t, nozzles = simulate_nozzles(plants, motion, print_slice.machine, threads=1)
        for each, nozzle in zip(executed, nozzles, strict=True):
            each.append(Execution(print_slice, motion, t, nozzle))
    return [rms(contour(each), weights(each)) * 1e3 for each in executed]


def _retuned(name: str, plant: Machine, few: Sequence[PrintSlice], slices: Sequence[PrintSlice]) -> float:
    method = every.best_fixed(LinearPrinter(plant, few), name)
    return _rms_on([plant], _commanded(method, slices))[0]
