"""Iterative correction on the simulated printer, for effects that no linear model holds.

The commands of a chunk's sections, found with the linear model and a feedforward of friction and backlash, are
simulated on the nonlinear printer with all its effects; the nozzle's error is swept through the same gains, and the
command takes the answer up:

    u ← u + K (r − P(u))                                      P the printer, K the linear inverse

Each step is mixed with the ones before it (Anderson's acceleration), and smoothed where it would break a limit. The
effect of a command is over after some ten segments: at the end, the best command at each position is put together and
simulated too. The result is the best fully simulated command.

What the weight bends is left to bed levelling. A delay that all motors share is left to the clock: the nozzle comes
late along the right path.

Anderson's acceleration of a fixed point, at each place of a path by itself (D. G. Anderson, J. ACM 12 (1965) 547): of
points x_i and their answers f_i, which ought to vanish, the next point is

    x + β f − Σ w_i (Δx_i + β Δf_i),   Δx_i = x − x_i, Δf_i = f − f_i,   w: the least squares of f − Σ w_i Δf_i

With one point before it, this is the secant method. Around each knot the answers have their own weights.

Friction and backlash feedforward: a belt pulls as far as its motor is ahead of its carriage, F = k s. Dry friction of
the wanted motion adds a force. Backlash takes half of its width w on the side to which the belt pulls, and as much
on the other once it pulls there:

    e = F(q̇*)/k + (w/2) sat((s + F(q̇*)/k)/ε)            sat x: x, but within ±1

So far the motors must be beyond where the linear inverse has them; s is the stretch of the belts without these effects.
A belt stretched by less than ε as good as does not pull: there the play is crossed. Between a command and the motors
there are the drives. What the nozzle makes of e, without them, is what a command must bring about through the whole
linear plant: the inverse's sweeps find it. One sweep eases a jump as the control weight wants it; each further one
takes up a part of what is lost by that, for crossing play is worth its acceleration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.inverse.command_limits import utilisation_from_rest
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.inverse.gains import REST_ROWS
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.solve import Solution, Sweep
from models.arrays import FloatArray
from models.compiled import kernel
from models.effects.catalogue import values_of, without_effects
from models.machine import Machine
from models.printer.kernels.friction import MOST_STRAIN
from models.printer.kernels.record import PrinterParameters
from models.printer.parameters import converted_printer
from models.printer.playback import Observe, simulate_batch
from models.printer.printer import PrinterMotion
from models.printer.rest import static_deflection
from models.vibration.scheduled import Schedule, plant_table

Tried = tuple[FloatArray, FloatArray]  # a point and its answer, (n, 3) mm

JUDGED_KNOTS, BLENDED_KNOTS = 16, 8  # on either side: window of the error, and of blending two commands
RIDGE, LEAST_MM2 = 1e-2, 1e-12  # what keeps the weights small: of the squares, and where nothing moves


def mixed(tried: Sequence[Tried], share: float) -> FloatArray:
    """Return the next point (n, 3) mm, from those tried, oldest first, and the share β of an answer to take up."""
    (x, f), before = tried[-1], tried[:-1]
    if not before:
        return np.asarray(x + share * f)
    moved, turned = (np.stack([now - old[part] for old in before], axis=1) for part, now in enumerate((x, f)))
    squares = around(np.einsum("nic,njc->nij", turned, turned), JUDGED_KNOTS)
    room = RIDGE * np.trace(squares, axis1=1, axis2=2) + LEAST_MM2
    right = around(np.einsum("nic,nc->ni", turned, f), JUDGED_KNOTS)
    weights = np.linalg.solve(squares + room[:, None, None] * np.eye(len(before)), right[..., None])[..., 0]
    return np.asarray(x + share * f - np.einsum("ni,nic->nc", around(weights, BLENDED_KNOTS), moved + share * turned))


def around(values: FloatArray, knots: int) -> FloatArray:
    """Average over so many knots on either side, (n, …); fewer at the ends."""
    at, n = np.arange(len(values)), len(values)
    low, high = np.maximum(at - knots, 0), np.minimum(at + knots + 1, n)
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    return np.asarray(((sums[high] - sums[low]).T / (high - low)).T)


PLAY = "belt_backlash"
FEEDFORWARD_EFFECTS = ("coulomb_friction", "stribeck_friction", PLAY)
BACKLASH_SMOOTHING_MM = 0.004  # ε: some tenths of a newton
SWEEPS = 3


class FrictionBacklash:
    """The feedforward of one printer."""

    def __init__(self, model: InverseModel, printer: Machine) -> None:
        s = model.settings
        self._model, self._row_s = model, s.segment_s / s.substeps
        self._numbers = converted_printer(printer).parameters
        table = plant_table(model.machine.kinematics, model.machine.vibration.undriven(), self._row_s)
        self._belts = Schedule(model.machine.kinematics, table)

    @property
    def crosses(self) -> bool:
        """Return whether the belts' stretch matters."""
        return bool(np.any(self._numbers.half_backlash > 0.0))

    def command(self, sweep: Sweep, stretch: FloatArray) -> FloatArray:
        """Return what the linear inverse of a section lacks, γ (n + 1, 3) mm, from rest to rest.

        stretch : (rows, 3) mm, of the belts at the section's substeps, without these effects; its last row stays
        """
        s, kinematics = self._model.settings, self._model.kinematics
        (nozzle, _), place = sweep.reference.substeps(sweep.n), sweep.place
        e = self._beyond(kinematics.inverse(nozzle), stretch)
        rows = slice(s.substeps // s.rows_per_segment - 1, None, s.substeps // s.rows_per_segment)
        jacobian = self._model.machine.kinematics.jacobian(nozzle[1:, :2][rows])
        knots, t = np.arange(len(sweep.gamma)), np.arange(len(nozzle)) / s.substeps

        def carriages(plant: Schedule, added: FloatArray) -> FloatArray:
            """Return what a linear plant makes of an addition to the command, (m + 1, 3) mm."""
            rest = np.zeros(plant.table.plant.a.shape[1])
            return plant.play(place, np.zeros_like(added), added, rest, s.substeps)[0][rows]

        demand, gamma = carriages(self._belts, e - e[0]), np.zeros_like(sweep.gamma)
        for _ in range(SWEEPS):
            done = carriages(self._model.plant, np.stack([np.interp(t, knots, axis) for axis in gamma.T], axis=1))
            left = np.einsum("nij,nj->ni", jacobian, demand - done)
            gamma += sweep.answer(left, np.zeros_like(gamma))[0]
        return gamma

    def _beyond(self, q: FloatArray, stretch: FloatArray) -> FloatArray:
        """Return e (m, 3) mm of carriages (m, 3) mm on their reference paths."""
        n = self._numbers
        more = 1e3 * guide_friction(n, q / 1e3, self._row_s) / n.belt_k
        padded = stretch[np.minimum(np.arange(len(q)), len(stretch) - 1)]
        return np.asarray(more + 1e3 * n.half_backlash * np.clip((padded + more) / BACKLASH_SMOOTHING_MM, -1.0, 1.0))


def guide_friction(n: PrinterParameters, q: FloatArray, row_s: float) -> FloatArray:
    """Return F (m, 3) N of `models/printer/kernels` on carriages that move as q (m, 3) m says, from rest."""
    rate = np.gradient(q, row_s, axis=0)
    level = n.dry + n.sticking * np.exp(-(np.abs(rate * n.fading) ** (2.0 * n.fading_power)))
    ratio = rate / n.creep
    smooth = np.tanh(ratio + _strain(ratio, np.asarray(n.hold), row_s))
    return np.asarray(level * np.where(n.bristles > 0.0, _bent(rate * n.bristles * row_s), smooth))


@kernel
def _bent(way: FloatArray) -> FloatArray:
    """Z (m, 3): dz = dw − |dw| z, with dw (m, 3) the way in units of s₀ from row to row, from 0."""
    bent = np.zeros_like(way)
    for i in range(1, len(way)):
        for a in range(3):
            forgotten = np.exp(-abs(way[i, a]))
            bent[i, a] = bent[i - 1, a] * forgotten + np.sign(way[i, a]) * (1.0 - forgotten)
    return bent


@kernel
def _strain(ratio: FloatArray, hold: FloatArray, row_s: float) -> FloatArray:
    """φ (m, 3): φ̇ = κ (r − |r| φ/φ_m − r² φ)/(1 + r²) by implicit Euler steps, from 0."""
    strain = np.zeros_like(ratio)
    for i in range(1, len(ratio)):
        for a in range(3):
            r = ratio[i, a]
            gain = hold[a] * row_s / (1.0 + r * r)
            strain[i, a] = (strain[i - 1, a] + gain * r) / (1.0 + gain * (abs(r) / MOST_STRAIN + r * r))
    return strain


ROUNDS = 16  # of the whole printer at most
STALL_RATIO = 0.97  # a round that leaves more of the error than this was the last
TRIED = 4  # rounds whose answers are mixed
PLAY_RELAXATION = 0.7  # share of an answer that is taken up where there is play: inside it, nothing answers
SMOOTHINGS, SMOOTHED_KNOTS, KEPT_SHARE = 60, 4, 0.9  # of a change that breaks a limit: tries, knots around, factor


@dataclass
class _Round:
    """The state of one section: next, last, best and blended command."""

    sweep: Sweep  # its γ is executed next
    rest_rows: int | None  # since the section before it
    most: float  # times the limits allowed for a command
    best: FloatArray  # γ (n + 1, 3) mm of the best that was executed
    feedforward: FloatArray  # γ beyond the linear inverse; no control weight is counted for it
    rms: float = np.inf  # of the best one's error, mm
    response: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    error: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # (rows, 3) mm of what was executed last
    tried: list[Tried] = field(default_factory=list)  # γ without what is foreseen, and the answer to its error
    gamma: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # put together
    local: FloatArray = field(default_factory=lambda: np.zeros(0))  # mean square of its error around each knot, mm²


def correct_sections(model: InverseModel, machine: Machine, sections: Sequence[SolvedSection]) -> list[SolvedSection]:
    """Correct the sections of a chunk, solved linearly, for the printer's nonlinear effects, which `machine` lists."""
    if not sections:
        return []
    rounds, before = [_begin(model, each) for each in sections], np.inf
    share = 1.0 if values_of(machine, PLAY) is None else PLAY_RELAXATION
    if any(values_of(machine, name) is not None for name in FEEDFORWARD_EFFECTS):
        _add_feedforward(model, machine, rounds)
    for _ in range(ROUNDS - 1):
        _round(model, machine, rounds)
        if (now := _promised(rounds)) > STALL_RATIO * before:
            break
        before = now
        for each in rounds:  # the command that is simulated next
            executed = each.sweep.gamma.copy()
            gamma = executed - each.feedforward
            each.tried = [*each.tried[1 - TRIED :], (gamma, each.sweep.answer(each.error, gamma)[0])]
            _change(each, executed, mixed(each.tried, share) - gamma)
    reached = np.sqrt(np.average([each.rms**2 for each in rounds], weights=[each.sweep.last for each in rounds]))
    if _promised(rounds) < STALL_RATIO * float(reached):
        for each in rounds:
            _change(each, each.best, each.gamma - each.best)
        _round(model, machine, rounds)
    return [
        replace(section, solution=_result(model, each, section.solution))
        for each, section in zip(rounds, sections, strict=True)
    ]


def _begin(model: InverseModel, section: SolvedSection) -> _Round:
    sweep, s = Sweep(model, section.reference), model.settings
    sweep.take(section.solution.vertices)
    row_s = s.segment_s / s.substeps
    rest = None if section.rest_s is None else max(round(section.rest_s / row_s), 0)
    most = max(1.0, section.solution.utilisation)
    return _Round(sweep, rest, most, sweep.gamma.copy(), np.zeros_like(sweep.gamma))


def _add_feedforward(model: InverseModel, machine: Machine, rounds: Sequence[_Round]) -> None:
    """Add to each command the feedforward of friction and backlash."""
    printer_feedforward, stretches = FrictionBacklash(model, machine), [np.zeros((1, 3))] * len(rounds)
    if printer_feedforward.crosses:
        _round(model, machine, rounds)  # in case that play is too wide to be crossed in time
        without = without_effects(machine, *FEEDFORWARD_EFFECTS)
        stretches = _played(model, without, rounds, lambda motion: motion.motor_mm - motion.carriage_mm)
    for each, stretch in zip(rounds, stretches, strict=True):
        linear = each.sweep.gamma.copy()
        _change(each, linear, printer_feedforward.command(each.sweep, stretch))
        each.feedforward = each.sweep.gamma - linear


def _round(model: InverseModel, machine: Machine, rounds: Sequence[_Round]) -> None:
    """Simulate the commands as they stand."""

    def nozzle(motion: PrinterMotion) -> FloatArray:
        return motion.nozzle_mm - static_deflection(machine, motion.nozzle_mm)

    for each, places in zip(rounds, _played(model, machine, rounds, nozzle), strict=True):
        _judge(each, places)


def _promised(rounds: Sequence[_Round]) -> float:
    """Return the rms with those put together, mm, if every position is again what it was at its best."""
    return float(np.sqrt(np.mean(np.concatenate([each.local[1 : each.sweep.last + 1] for each in rounds]))))


def _played(model: InverseModel, machine: Machine, rounds: Sequence[_Round], seen: Observe) -> list[FloatArray]:
    """Return what is observed in every section and a while after it, (rows + rest, 3) mm, from its first knot on."""
    s, late = model.settings, values_of(machine, "command_delay")
    sweeps = (each.sweep for each in rounds)
    executed = (model.executed(each.reference, each.command(each.gamma)) for each in sweeps)
    commands = [model.kinematics.inverse(each) for each in executed]
    rests = [each.rest_rows for each in rounds]
    late_s = float(np.mean(late["delay_s"])) if late else 0.0
    return simulate_batch(machine, commands, rests, s.segment_s / s.substeps, REST_ROWS * s.substeps, seen, late_s)


def _judge(each: _Round, nozzle: FloatArray) -> None:
    """Keep the simulated command if it is the best, and of it the positions that are."""
    sweep, s = each.sweep, each.sweep.model.settings
    reference, _ = sweep.reference.substeps(sweep.n)
    rows = min(len(nozzle), len(reference))
    error = np.zeros_like(reference)
    error[:rows] = reference[:rows] - nozzle[:rows]
    end, stride = sweep.last * s.substeps, s.substeps // s.rows_per_segment
    if len(sweep.robust_offset):
        error[1 : end + 1] += np.repeat(sweep.robust_offset, stride, axis=0)
    square = np.sum(error[1 : end + 1] ** 2, axis=1)
    rms = float(np.sqrt(np.mean(square)))
    if rms < each.rms:
        each.best, each.rms, each.response = sweep.gamma.copy(), rms, nozzle[1 : end + 1]
    each.error = error[stride::stride].copy()
    local = np.zeros(len(sweep.gamma))
    local[1 : sweep.last + 1] = square.reshape(-1, s.substeps).mean(axis=1)
    _put_together(each, around(local, JUDGED_KNOTS))


def _put_together(each: _Round, local: FloatArray) -> None:
    """Take the simulated command wherever it is the best so far."""
    if not len(each.gamma):
        each.gamma, each.local = each.sweep.gamma.copy(), local
        return
    better = local < each.local
    taken = around(better.astype(np.float64), BLENDED_KNOTS)[:, None]  # smoothed, so that the command does not jump
    each.gamma = taken * each.sweep.gamma + (1.0 - taken) * each.gamma
    each.local = np.where(better, local, each.local)


def _change(each: _Round, gamma: FloatArray, change: FloatArray) -> None:
    """Go from one command, which keeps the limits, to the next: smoother and less far around where that breaks one."""
    sweep = each.sweep
    for _ in range(SMOOTHINGS):
        sweep.gamma[:] = gamma + change
        demand = utilisation_from_rest(sweep.command(sweep.gamma), sweep.model.limits).max(axis=(1, 2))
        beyond = np.zeros((len(gamma), 1))
        beyond[: sweep.last + 1, 0] = np.maximum(demand[:-1], demand[1:]) > each.most
        if not beyond.any():
            return
        near = around(np.ceil(around(beyond, SMOOTHED_KNOTS)), SMOOTHED_KNOTS)
        change = change - near * (change - KEPT_SHARE * around(change, 1))
        change[0] = change[sweep.last :] = 0.0  # it begins and ends on the path
    sweep.gamma[:] = gamma


def _result(model: InverseModel, each: _Round, linear: Solution) -> Solution:
    vertices = each.sweep.command(each.best)
    demand = utilisation_from_rest(vertices, model.limits)
    return replace(linear, vertices=vertices, response=each.response, demand=demand)
