"""Friction and backlash feedforward: what they demand of the motors, where `correction.py` begins.

A belt pulls as far as its motor is ahead of its carriage, F = k s. Dry friction of the wanted motion asks for a force
more. Play takes half of its width w on the side to which the belt pulls, and as much on the other once it pulls there:

    e = F(q̇*)/k + (w/2) sat((s + F(q̇*)/k)/ε)            sat x: x, but within ±1

So far the motors must be beyond where the linear inverse has them; s is the stretch of the belts without these effects.
A belt stretched by less than ε as good as does not pull: there the play is crossed.

Between a command and the motors there are the drives. What the nozzle makes of e, without them, is what a command must
bring about through the whole linear plant: the inverse's sweeps find it. One sweep eases a jump as the weight on effort
wants it; each further one takes up a part of what is lost by that, for crossing play is worth its effort.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from ffcomp.inverse import lq_preview as fast
from ffcomp.inverse.iterate import Iterate
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.riccati import REST_ROWS
from models.arrays import FloatArray
from models.machine import Machine
from models.printer.kernels.friction import MOST_STRAIN
from models.printer.kernels.record import PrinterParameters
from models.printer.parameters import printer_parameters
from models.vibration.scheduled import Schedule, plant_table

PLAY = "belt_backlash"
FORESEEN = ("coulomb_friction", "stribeck_friction", PLAY)
TURNS_MM = 0.004  # ε: some tenths of a newton
SWEEPS = 3


class FrictionBacklash:
    """The feedforward of one printer."""

    def __init__(self, model: InverseModel, printer: Machine) -> None:
        s = model.settings
        self._model, self._numbers, self._row_s = model, printer_parameters(printer), s.segment_s / s.substeps
        self._undriven = replace(model.machine, vibration=model.machine.vibration.undriven())
        self._belts = Schedule(
            self._undriven.kinematics, plant_table(self._undriven.kinematics, self._undriven.vibration, self._row_s)
        )

    @property
    def crosses(self) -> bool:
        """Return whether the belts' stretch matters."""
        return bool(np.any(self._numbers.half_backlash > 0.0))

    def command(self, iterate: Iterate, stretch: FloatArray) -> FloatArray:
        """Return what the linear inverse of a section lacks, γ (n + 1, 3) mm, from rest to rest.

        stretch : (rows, 3) mm, of the belts at the section's substeps, without these effects; its last row stays
        """
        answer = _Answer(self._model, iterate)
        e = self._beyond(answer.q, stretch)
        asked = answer.of(self._belts, e - e[0], self._undriven.equilibrium(answer.nozzle[0]))
        begin, gamma = self._model.machine.equilibrium(answer.nozzle[0]), np.zeros_like(iterate.gamma)
        for _ in range(SWEEPS):
            left = asked - answer.of(self._model.plant, answer.along(gamma), begin)
            gamma += answer.sweep(left)
        return gamma

    def _beyond(self, q: FloatArray, stretch: FloatArray) -> FloatArray:
        """Return e (m, 3) mm of carriages (m, 3) mm on their reference paths."""
        n = self._numbers
        more = 1e3 * guide_friction(n, q / 1e3, self._row_s) / n.belt_k
        padded = stretch[np.minimum(np.arange(len(q)), len(stretch) - 1)]
        return np.asarray(more + 1e3 * n.half_backlash * np.clip((padded + more) / TURNS_MM, -1.0, 1.0))


class _Answer:
    """The linear plant's response to something added to a section's reference."""

    def __init__(self, model: InverseModel, iterate: Iterate) -> None:
        self._model, self._iterate = model, iterate
        self.nozzle, self._velocity = iterate.reference.substeps(0, iterate.last + REST_ROWS)
        self.q = model.kinematics.inverse(self.nozzle)

    def of(self, plant: Schedule, added: FloatArray, begin: FloatArray) -> FloatArray:
        """Return the nozzle's response, (m, 3) mm after every substep, to added carriage commands (m + 1, 3) mm."""
        forward, substeps = self._model.kinematics.forward, self._model.settings.substeps
        moved, still = (plant.respond(forward(q), self._velocity, begin, substeps)[0] for q in (self.q + added, self.q))
        return moved - still

    def along(self, gamma: FloatArray) -> FloatArray:
        """Return the coefficients at every substep, (m + 1, 3) mm."""
        knots, t = np.arange(len(gamma)), np.arange(len(self.q)) / self._model.settings.substeps
        return np.stack([np.interp(t, knots, axis) for axis in gamma.T], axis=1)

    def sweep(self, left: FloatArray) -> FloatArray:
        """Return the inverse's answer γ (n + 1, 3) mm to the error that is left, by itself."""
        s = self._model.settings
        stride = s.substeps // s.rows_per_segment
        return fast.answer(self._iterate, np.zeros_like(self._iterate.gamma), left[stride - 1 :: stride])


def guide_friction(n: PrinterParameters, q: FloatArray, row_s: float) -> FloatArray:
    """Return F (m, 3) N of `models/printer/kernels` on carriages that move as q (m, 3) m says, from rest."""
    rate = np.gradient(q, row_s, axis=0)
    level = n.dry + n.sticking * np.exp(-(np.abs(rate * n.fading) ** (2.0 * n.fading_power)))
    ratio = rate / n.creep
    smooth = np.tanh(ratio + _strain(ratio, np.asarray(n.hold), row_s))
    return np.asarray(level * np.where(n.bristles > 0.0, _bent(rate * n.bristles * row_s), smooth))


@njit(cache=True, nogil=True)
def _bent(way: FloatArray) -> FloatArray:
    """Z (m, 3): dz = dw − |dw| z, with dw (m, 3) the way in units of s₀ from row to row, from 0."""
    bent = np.zeros_like(way)
    for i in range(1, len(way)):
        for a in range(3):
            forgotten = np.exp(-abs(way[i, a]))
            bent[i, a] = bent[i - 1, a] * forgotten + np.sign(way[i, a]) * (1.0 - forgotten)
    return bent


@njit(cache=True, nogil=True)
def _strain(ratio: FloatArray, hold: FloatArray, row_s: float) -> FloatArray:
    """φ (m, 3): φ̇ = κ (r − |r| φ/φ_m − r² φ)/(1 + r²) by implicit Euler steps, from 0."""
    strain = np.zeros_like(ratio)
    for i in range(1, len(ratio)):
        for a in range(3):
            r = ratio[i, a]
            gain = hold[a] * row_s / (1.0 + r * r)
            strain[i, a] = (strain[i - 1, a] + gain * r) / (1.0 + gain * (abs(r) / MOST_STRAIN + r * r))
    return strain
