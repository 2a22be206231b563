"""Every method, as it was tuned, on the Monte-Carlo plants, which processes or a cluster may share.

A task is one method on LANES plants, in one thread: its numbers do not depend on who computes it. Methods hold what
cannot be sent cheaply, so each commands its slices here, once; what is sent is the commanded motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

from ffcomp.compare import methods as every
from ffcomp.compare import rivals
from ffcomp.compare.baselines import LinearPrinter
from ffcomp.compare.evaluation import Execution, contour, weights
from ffcomp.compare.execution import Piece
from ffcomp.compare.methods import TunedMethod
from ffcomp.compare.parallel import Progress, in_parallel, in_processes
from ffcomp.compare.result import Method, Spread
from ffcomp.compare.sampling import PrintSlice
from ffcomp.metrics import rms
from ffcomp.simulate.playback import simulate_nozzles
from models.machine import Machine
from models.printer.kernels.record import LANES

ON_PLANTS, TUNING_ON_PLANTS = "printing on Monte-Carlo plants", "tuning shapers on Monte-Carlo plants"
COMMANDED = 0.2  # of the time on the plants, until the commands are known


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
    """Execute every method, as it was tuned, on the Monte-Carlo plants; tune the best fixed shaper anew on each too."""
    found = dict(methods)
    for name, spread in _spreads(tuned, slices, plants, jobs, progress).items():
        found[name] = replace(methods[name], spread=spread)
    tasks = [partial(_retuned, best, few[0].machine, each, few, slices) for each in plants]
    retuned = tuple(in_processes(tasks, jobs, TUNING_ON_PLANTS, progress))
    found[best] = replace(found[best], retuned=Spread(retuned))
    return found


def _spreads(
    tuned: Sequence[TunedMethod], slices: Sequence[PrintSlice], plants: Sequence[Machine], jobs: int, progress: Progress
) -> dict[str, Spread]:
    commanded = in_parallel(
        [partial(_commanded, method, slices) for method in tuned],
        ON_PLANTS,
        lambda what, share: progress(what, COMMANDED * share),
    )
    groups = [plants[k : k + LANES] for k in range(0, len(plants), LANES)]
    tasks = [partial(_rms_on, group, pieces) for pieces in commanded for group in groups]
    rest = 1 - COMMANDED
    each = in_processes(tasks, jobs, ON_PLANTS, lambda what, share: progress(what, COMMANDED + rest * share))
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
        t, found = simulate_nozzles(plants, motion, print_slice.machine, threads=1)
        for each, nozzle in zip(executed, found, strict=True):
            each.append(Execution(print_slice, motion, t, nozzle))
    return [rms(contour(each), weights(each)) * 1e3 for each in executed]


def _retuned(
    name: str, machine: Machine, plant: Machine, few: Sequence[PrintSlice], slices: Sequence[PrintSlice]
) -> float:
    linear = LinearPrinter(plant, few)
    if every.is_rival(name):
        method = every.rival(rivals.Tuner(machine, plant, linear), machine, name)
    else:
        method = every.best_fixed(linear, name)
    return _rms_on([plant], _commanded(method, slices))[0]
