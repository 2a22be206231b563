"""The correction loop with the whole printer inside: effects that no linear model holds.

The commands of a chapter's runs, found with the linear model, are played on the nonlinear virtual printer with all its
effects; where the nozzle should have been instead is swept through the same gains, and the command takes the answer up:

    u ← u + K (r − P(u))                                          P the printer, K the linear inverse

Friction, play or a late motor change the answer of a machine by a part of itself, so a few rounds are enough. What a
command does is over after some ten segments, so each place of a run keeps the best command that it has had: where a
round makes it worse, half of the step is tried from the best one. A run ends with the best command played whole.

What the weight bends is left to bed levelling. A delay that all motors share is left to the clock: the nozzle comes
late along the right path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ffcomp.invert import fast
from ffcomp.invert.inverter import Inverter, RunResult
from ffcomp.invert.limits import excess
from ffcomp.invert.play import Playing, Stretch
from ffcomp.invert.preview import REST_ROWS
from ffcomp.runs import Reference
from ffcomp.virtual.sag import sag
from models.effects.catalogue import values_of
from models.machine import Machine
from models.printer import simulate_printers
from models.printer_kernels import LANES

FloatArray = NDArray[np.float64]

ROUNDS = 16  # of the whole printer at most
WORTH = 0.97  # a round that leaves more of the error than this was the last
AROUND, EASED = 16, 8  # knots on either side: to judge a place by, and over which to go from one command to another
REMEMBERED_S = 0.5  # of motion before a lane's first run

Lane = tuple[int, int, int]  # runs are played from the first on; those from the second on, to the third, count


@dataclass(frozen=True, slots=True)
class Ran:
    """A run as the linear model has solved it."""

    wanted: Reference
    result: RunResult
    rest_s: float | None  # since the run before it ended; None: others have moved the nozzle, or there was none


@dataclass
class _Round:
    """One run: the best command that was played, and the one put together of the best at every place."""

    run: Playing  # its γ: what is played next
    rest_rows: int | None
    best: FloatArray  # γ (n + 1, 3) mm of the best that was played
    rms: float = np.inf  # of its error, mm
    response: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    gamma: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # put together
    error: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # that it should have, (rows, 3) mm
    local: FloatArray = field(default_factory=lambda: np.zeros(0))  # mean square of it around each knot, mm²
    share: FloatArray = field(default_factory=lambda: np.ones(1))  # of the answer that is taken up at each knot


def corrected(inverter: Inverter, machine: Machine, runs: Sequence[Ran]) -> list[RunResult]:
    """The runs of a chapter, with the printer's effects allowed for. `machine` lists them."""
    rounds, before = [_begin(inverter, each) for each in runs], np.inf
    for left in range(ROUNDS - 1, -1, -1):
        for each, nozzle in zip(rounds, _played(inverter, machine, rounds), strict=True):
            _judge(each, nozzle)
        now = float(np.sqrt(sum(each.rms**2 * each.run.last for each in rounds)))
        if not left or now > WORTH * before:
            break
        before = now
        for each in rounds:
            each.run.gamma = each.gamma.copy()
            fast.improve(each.run, each.error, each.share)
    return [_result(inverter, each, ran) for each, ran in zip(rounds, runs, strict=True)]


def _begin(inverter: Inverter, ran: Ran) -> _Round:
    run, s = Playing(inverter, ran.wanted), inverter.settings
    knots = np.arange(run.last + 1)
    run.gamma[: run.last + 1] = inverter.delta.inverse(ran.result.vertices) - inverter.delta.inverse(
        ran.wanted.at_knots(knots)
    )
    row_s = s.segment_s / s.substeps
    rest = None if ran.rest_s is None else max(round(ran.rest_s / row_s), 0)
    return _Round(run, rest, run.gamma.copy())


def _played(inverter: Inverter, machine: Machine, rounds: Sequence[_Round]) -> list[FloatArray]:
    """The whole printer's nozzle in every run and a while after it, (rows + rest, 3) mm, from its first knot on."""
    commands = [inverter.delta.inverse(Stretch(each.run, 0, each.run.last).as_played()) for each in rounds]
    row_s = inverter.settings.segment_s / inverter.settings.substeps
    after = REST_ROWS * inverter.settings.substeps
    late = values_of(machine, "command_delay")
    shift = float(np.mean(late["delay_s"])) / row_s if late else 0.0
    lanes = _lanes(rounds, commands, round(REMEMBERED_S / row_s))
    rows = [_timeline(rounds, commands, lane) for lane in lanes]
    motions = simulate_printers([machine] * len(lanes), [command for command, _ in rows], row_s, hold="linear")
    found: list[FloatArray] = [np.empty((0, 3))] * len(rounds)
    for (_first, begin, end), (_command, at), motion in zip(lanes, rows, motions, strict=True):
        if isinstance(motion, ValueError):
            raise motion
        nozzle = motion.nozzle_mm - sag(machine, motion.nozzle_mm)
        t = np.arange(len(nozzle), dtype=np.float64)
        for i in range(begin, end):
            until = at[i + 1] if i + 1 in at else len(nozzle) - 1  # the next run begins there
            own = np.arange(at[i], at[i] + len(commands[i]) + after) + shift
            sampled = np.stack([np.interp(np.minimum(own, until), t, axis) for axis in nozzle.T], axis=1)
            found[i] = sampled
    return found


def _lanes(rounds: Sequence[_Round], commands: Sequence[FloatArray], remembered: int) -> list[Lane]:
    """Runs for each lane of the virtual printer: about as much for each, with what is before them to warm up."""
    lengths = [len(c) + (each.rest_rows or 0) for c, each in zip(commands, rounds, strict=True)]
    enough = sum(lengths) / LANES
    lanes, begin, gathered = [], 0, 0
    for i, length in enumerate(lengths):
        if i > begin and (gathered + length > enough or rounds[i].rest_rows is None):
            lanes.append(_warmed(rounds, lengths, begin, i, remembered))
            begin, gathered = i, 0
        gathered += length
    return [*lanes, _warmed(rounds, lengths, begin, len(rounds), remembered)]


def _warmed(rounds: Sequence[_Round], lengths: Sequence[int], begin: int, end: int, remembered: int) -> Lane:
    first, gathered = begin, 0
    while first > 0 and rounds[first].rest_rows is not None and gathered < remembered:
        first -= 1
        gathered += lengths[first]
    return first, begin, end


def _timeline(
    rounds: Sequence[_Round], commands: Sequence[FloatArray], lane: Lane
) -> tuple[FloatArray, dict[int, int]]:
    """The carriage commands of a lane, row by row, and the row at which each of its runs begins."""
    first, _, end = lane
    pieces, at, rows = [], {}, 0
    for i in range(first, end):
        rest = rounds[i].rest_rows if i > first else None
        if rest:
            pieces.append(np.repeat(commands[i][:1], rest, axis=0))
            rows += rest
        at[i] = rows
        pieces.append(commands[i])
        rows += len(commands[i])
    pieces.append(np.repeat(commands[end - 1][-1:], 100, axis=0))  # what is left of the last run
    return np.concatenate(pieces), at


def _judge(each: _Round, nozzle: FloatArray) -> None:
    """Take up what was played wherever it is the best so far; elsewhere go half as far next time."""
    run, s = each.run, each.run.inverter.settings
    wanted, _ = run.reference.substeps(0, run.last + REST_ROWS)
    rows = min(len(nozzle), len(wanted))
    error = np.zeros_like(wanted)
    error[:rows] = wanted[:rows] - nozzle[:rows]
    end = run.last * s.substeps
    square = np.sum(error[1 : end + 1] ** 2, axis=1)
    rms = float(np.sqrt(np.mean(square)))
    if rms < each.rms:
        each.best, each.rms, each.response = run.gamma.copy(), rms, nozzle[1 : end + 1]
    weighed = error[s.substeps // s.rows_per_segment :: s.substeps // s.rows_per_segment].copy()
    weighed[: len(run.softened)] += run.softened
    local = np.zeros(len(run.gamma))
    local[1 : run.last + 1] = square.reshape(-1, s.substeps).mean(axis=1)
    local = _around(local, AROUND)
    if not len(each.gamma):
        each.gamma, each.error, each.local = run.gamma.copy(), weighed, local
        each.share = np.ones(len(local))
        return
    better = local < each.local
    taken = _around(better.astype(np.float64), EASED)[:, None]  # eased, for the command must not jump
    each.gamma = taken * run.gamma + (1.0 - taken) * each.gamma
    of_rows = np.repeat(taken[1:], s.rows_per_segment, axis=0)
    each.error = of_rows * weighed + (1.0 - of_rows) * each.error
    each.local = np.where(better, local, each.local)
    each.share = np.where(better, each.share, 0.5 * each.share)


def _around(values: FloatArray, knots: int) -> FloatArray:
    """Means over so many knots on either side, (n,)."""
    window = np.ones(2 * knots + 1)
    inside = slice(knots, knots + len(values))
    return np.asarray(np.convolve(values, window)[inside] / np.convolve(np.ones_like(values), window)[inside])


def _result(inverter: Inverter, each: _Round, ran: Ran) -> RunResult:
    run = each.run
    knots = np.arange(run.last + 1)
    q = inverter.delta.inverse(ran.wanted.at_knots(knots)) + each.best[: run.last + 1]
    vertices = inverter.delta.forward(q)
    response = each.response if len(ran.result.response) else ran.result.response
    return replace(ran.result, vertices=vertices, response=response, excess=excess(vertices, inverter.limits))
