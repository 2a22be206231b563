"""Iterative correction on the simulated printer, for effects that no linear model holds.

The commands of a chunk's sections, found with the linear model and the feedforward of friction and backlash
(`friction_backlash.py`), are simulated on the nonlinear printer with all its effects; the nozzle's error is swept
through the same gains, and the command takes the answer up:

    u ← u + K (r − P(u))                                      P the printer, K the linear inverse

Each step is mixed with the ones before it (`anderson.py`), and smoothed where it would break a limit. The effect of a
command is over after some ten segments: at the end, the best command at each position is put together and simulated
too. A section ends with the best command that was simulated whole.

What the weight bends is left to bed levelling. A delay that all motors share is left to the clock: the nozzle comes
late along the right path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.inverse import lq_preview as fast
from ffcomp.inverse.command_limits import peak_utilisation, utilisation_from_rest
from ffcomp.inverse.iterate import Iterate, KnotWindow
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.nonlinear.anderson import AROUND, EASED, Tried, around, mixed
from ffcomp.inverse.nonlinear.friction_backlash import FORESEEN, PLAY, FrictionBacklash
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.riccati import REST_ROWS
from ffcomp.inverse.solve import Solution
from models.arrays import FloatArray
from models.effects.catalogue import values_of, without_effects
from models.machine import Machine
from models.printer.batch import Observe, simulate_batch
from models.printer.printer import PrinterMotion
from models.printer.static_deflection import static_deflection

ROUNDS = 16  # of the whole printer at most
WORTH = 0.97  # a round that leaves more of the error than this was the last
TRIED = 4  # rounds whose answers are mixed
CAREFUL = 0.7  # share of an answer that is taken up where there is play: inside it, nothing answers
SMOOTHINGS, NEAR, KEPT = 60, 4, 0.9  # of a change that breaks a limit: how often, knots around, what is left each time


@dataclass(frozen=True, slots=True)
class LinearSolution:
    """A section as the linear model has solved it."""

    reference: Reference
    result: Solution
    rest_s: float | None  # since the section before it ended; None: others have moved the nozzle, or there was none


@dataclass
class _Round:
    """One section: what is simulated next, the last commands that were, the best, and the one put together."""

    iterate: Iterate  # its γ: what is executed next
    rest_rows: int | None  # since the section before it
    most: float  # times the limits that a command may ask for
    best: FloatArray  # γ (n + 1, 3) mm of the best that was executed
    foreseen: FloatArray  # γ beyond the linear inverse; no effort is counted for it
    rms: float = np.inf  # of the best one's error, mm
    response: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    error: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # (rows, 3) mm of what was executed last
    tried: list[Tried] = field(default_factory=list)  # γ without what is foreseen, and the answer to its error
    gamma: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # put together
    local: FloatArray = field(default_factory=lambda: np.zeros(0))  # mean square of its error around each knot, mm²


def correct_sections(model: InverseModel, machine: Machine, runs: Sequence[LinearSolution]) -> list[Solution]:
    """Correct the sections of a chunk for the printer's nonlinear effects, which `machine` lists."""
    if not runs:
        return []
    rounds, before = [_begin(model, each) for each in runs], np.inf
    share = 1.0 if values_of(machine, PLAY) is None else CAREFUL
    if any(values_of(machine, name) is not None for name in FORESEEN):
        _foresee(model, machine, rounds)
    for _ in range(ROUNDS - 1):
        _round(model, machine, rounds)
        if (now := _promised(rounds)) > WORTH * before:
            break
        before = now
        for each in rounds:
            _step(each, share)
    if _promised(rounds) < WORTH * _reached(rounds):
        for each in rounds:
            _change(each, each.best, each.gamma - each.best)
        _round(model, machine, rounds)
    return [_result(model, each, ran) for each, ran in zip(rounds, runs, strict=True)]


def _begin(model: InverseModel, ran: LinearSolution) -> _Round:
    iterate, s = Iterate(model, ran.reference), model.settings
    knots = np.arange(iterate.last + 1)
    iterate.gamma[: iterate.last + 1] = model.kinematics.inverse(ran.result.vertices) - model.kinematics.inverse(
        ran.reference.at_knots(knots)
    )
    row_s = s.segment_s / s.substeps
    rest = None if ran.rest_s is None else max(round(ran.rest_s / row_s), 0)
    return _Round(iterate, rest, max(1.0, ran.result.utilisation), iterate.gamma.copy(), np.zeros_like(iterate.gamma))


def _foresee(model: InverseModel, machine: Machine, rounds: Sequence[_Round]) -> None:
    """Add to each command the feedforward of friction and backlash."""
    foresight, stretches = FrictionBacklash(model, machine), [np.zeros((1, 3))] * len(rounds)
    if foresight.crosses:
        _round(model, machine, rounds)  # in case that play is too wide to be crossed in time
        without = without_effects(machine, *FORESEEN)
        stretches = _played(model, without, rounds, lambda motion: motion.motor_mm - motion.carriage_mm)
    for each, stretch in zip(rounds, stretches, strict=True):
        linear = each.iterate.gamma.copy()
        _change(each, linear, foresight.command(each.iterate, stretch))
        each.foreseen = each.iterate.gamma - linear


def _round(model: InverseModel, machine: Machine, rounds: Sequence[_Round]) -> None:
    """Simulate the commands as they stand."""

    def nozzle(motion: PrinterMotion) -> FloatArray:
        return motion.nozzle_mm - static_deflection(machine, motion.nozzle_mm)

    for each, places in zip(rounds, _played(model, machine, rounds, nozzle), strict=True):
        _judge(each, places)


def _reached(rounds: Sequence[_Round]) -> float:
    """Return the error's rms with the best commands simulated, mm."""
    return float(np.sqrt(np.average([each.rms**2 for each in rounds], weights=[each.iterate.last for each in rounds])))


def _promised(rounds: Sequence[_Round]) -> float:
    """Return the rms with those put together, mm, if every position is again what it was at its best."""
    return float(np.sqrt(np.mean(np.concatenate([each.local[1 : each.iterate.last + 1] for each in rounds]))))


def _played(model: InverseModel, machine: Machine, rounds: Sequence[_Round], seen: Observe) -> list[FloatArray]:
    """Return what is observed in every section and a while after it, (rows + rest, 3) mm, from its first knot on."""
    s, late = model.settings, values_of(machine, "command_delay")
    commands = [model.kinematics.inverse(KnotWindow(each.iterate, 0, each.iterate.last).as_played()) for each in rounds]
    rests = [each.rest_rows for each in rounds]
    late_s = float(np.mean(late["delay_s"])) if late else 0.0
    return simulate_batch(machine, commands, rests, s.segment_s / s.substeps, REST_ROWS * s.substeps, seen, late_s)


def _judge(each: _Round, nozzle: FloatArray) -> None:
    """Keep what was simulated if it is the best, and of it the positions that are."""
    iterate, s = each.iterate, each.iterate.model.settings
    reference, _ = iterate.reference.substeps(0, iterate.last + REST_ROWS)
    rows = min(len(nozzle), len(reference))
    error = np.zeros_like(reference)
    error[:rows] = reference[:rows] - nozzle[:rows]
    end, stride = iterate.last * s.substeps, s.substeps // s.rows_per_segment
    if len(iterate.robust_offset):
        error[1 : end + 1] += np.repeat(iterate.robust_offset, stride, axis=0)
    square = np.sum(error[1 : end + 1] ** 2, axis=1)
    rms = float(np.sqrt(np.mean(square)))
    if rms < each.rms:
        each.best, each.rms, each.response = iterate.gamma.copy(), rms, nozzle[1 : end + 1]
    each.error = error[stride::stride].copy()
    local = np.zeros(len(iterate.gamma))
    local[1 : iterate.last + 1] = square.reshape(-1, s.substeps).mean(axis=1)
    _put_together(each, around(local, AROUND))


def _put_together(each: _Round, local: FloatArray) -> None:
    """Take what was simulated wherever it is the best so far."""
    if not len(each.gamma):
        each.gamma, each.local = each.iterate.gamma.copy(), local
        return
    better = local < each.local
    taken = around(better.astype(np.float64), EASED)[:, None]  # eased, for the command must not jump
    each.gamma = taken * each.iterate.gamma + (1.0 - taken) * each.gamma
    each.local = np.where(better, local, each.local)


def _step(each: _Round, share: float) -> None:
    """Set the command that is simulated next."""
    executed = each.iterate.gamma.copy()
    gamma = executed - each.foreseen
    each.tried = [*each.tried[1 - TRIED :], (gamma, fast.answer(each.iterate, gamma, each.error))]
    _change(each, executed, mixed(each.tried, share) - gamma)


def _change(each: _Round, gamma: FloatArray, change: FloatArray) -> None:
    """Go from one command, which keeps the limits, to the next: smoother and less far around where that breaks one."""
    iterate = each.iterate
    for _ in range(SMOOTHINGS):
        iterate.gamma[:] = gamma + change
        asked = utilisation_from_rest(_vertices(iterate, iterate.gamma), iterate.model.limits).max(axis=(1, 2))
        beyond = np.zeros((len(gamma), 1))
        beyond[: iterate.last + 1, 0] = np.maximum(asked[:-1], asked[1:]) > each.most
        if not beyond.any():
            return
        near = around(np.ceil(around(beyond, NEAR)), NEAR)
        change = change - near * (change - KEPT * around(change, 1))
        change[0] = change[iterate.last :] = 0.0  # it begins and ends on the path
    iterate.gamma[:] = gamma


def _vertices(iterate: Iterate, gamma: FloatArray) -> FloatArray:
    """Return nozzle commands (n + 1, 3) mm at the knots."""
    delta, knots = iterate.model.kinematics, np.arange(iterate.last + 1)
    return delta.forward(delta.inverse(iterate.reference.at_knots(knots)) + gamma[: iterate.last + 1])


def _result(model: InverseModel, each: _Round, ran: LinearSolution) -> Solution:
    vertices = _vertices(each.iterate, each.best)
    response = each.response if len(ran.result.response) else ran.result.response
    return replace(
        ran.result, vertices=vertices, response=response, utilisation=peak_utilisation(vertices, model.limits)
    )
