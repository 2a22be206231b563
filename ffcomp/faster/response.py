"""The error that a command will have, at a quantile over the printers that the machine file allows."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ffcomp.inverse.extent import WrittenReference
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.robust import drawn_machines
from ffcomp.inverse.solve import Solution
from ffcomp.metrics import contour_error
from ffcomp.planner.segment_timing import sample_even_segments
from models.arrays import FloatArray
from models.machine import Machine
from models.vibration.scheduled import Schedule, plant_table

_printers: weakref.WeakKeyDictionary[InverseModel, Printers] = weakref.WeakKeyDictionary()
DRAWS = 6  # printers, in pairs on either side of the machine file's
PITCH_MM = 30.0  # of their tables over the bed: coarser than the machine's own, for they are only guesses


def printers_of(model: InverseModel, safety: float) -> Printers:
    """Return the printers of a machine, the same ones as long as its model lives."""
    known = _printers.get(model)
    if known is None or known.safety != safety:
        known = _printers[model] = Printers(weakref.proxy(model), safety)
    return known


@dataclass(frozen=True, eq=False)
class Printers:
    """The machine file's printer and some that are as far off as its `[uncertainty]` says."""

    model: InverseModel
    safety: float

    @cached_property
    def drawn(self) -> list[tuple[Machine, Schedule]]:
        """The plants of the drawn printers; none if the machine file is certain of everything."""
        machine, s = self.model.machine, self.model.settings
        if not np.any(machine.vibration.parameters().relative_sd(machine.uncertainty)):
            return []
        step_s = s.segment_s / s.substeps
        return [
            (each, Schedule(each.kinematics, plant_table(each.kinematics, each.vibration, step_s, PITCH_MM)))
            for each in drawn_machines(machine, DRAWS)
        ]

    @cached_property
    def far(self) -> float:
        """How many standard deviations the wanted quantile is away."""
        from scipy.stats import norm  # 0.3 s to import

        return float(norm.ppf(1.0 - 0.5 * self.safety))

    def error(self, written: WrittenReference, solution: Solution, path: tuple[FloatArray, FloatArray]) -> FloatArray:
        """Return the contour error (m,) mm after every substep; path: when its corners are due, and where they are."""
        s, reference = self.model.settings, written.reference
        t = reference.t0 + (1 + np.arange(len(solution.response), dtype=np.float64)) * (s.segment_s / s.substeps)
        nominal = contour_error(*path, t, solution.response)
        if not self.drawn:
            return nominal
        squares = [contour_error(*path, t, each) ** 2 for each in self._answers(written, solution)]
        return np.maximum(nominal, self.far * np.sqrt(np.mean(squares, axis=0)))

    def _answers(self, written: WrittenReference, solution: Solution) -> list[FloatArray]:
        """Return what each drawn printer makes of the command, (m, 3) mm."""
        model, s, reference = self.model, self.model.settings, written.reference
        nozzle, velocity = reference.substeps(0, reference.knots)
        place = np.ascontiguousarray(nozzle[s.substeps // 2 :: s.substeps, :2])
        centripetal = model.kinematics.rate_term(nozzle, np.ascontiguousarray(velocity))
        filament = np.diff(reference.extrusion())
        played = sample_even_segments(solution.vertices, filament, s.segment_s, s.output, s.substeps)
        command = model.kinematics.inverse(played)
        answers = (
            plant.play(place, centripetal, command, each.equilibrium(nozzle[0]), s.substeps)[0]
            for each, plant in self.drawn
        )
        return [model.kinematics.forward(q) for q in answers]
