"""The error that a command will have, at a quantile over the printers that the machine file allows.

The response of a printer that is a little off is that of the machine file's printer and, nearly, a sum of changes, one
for each independent direction in which its parameters may be off. A few of them are simulated: those of the directions
in which the printer's answer changes most, by one standard deviation each. `spread.py` adds them up.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ffcomp.faster.spread import ShortArray
from ffcomp.inverse.extent import WrittenReference
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.solve import Solution
from ffcomp.metrics import contour_error
from ffcomp.planner.segment_timing import sample_even_segments
from models.arrays import ComplexArray, FloatArray
from models.machine import Machine
from models.parameters import with_values
from models.vibration.scheduled import Schedule, plant_table

DIRECTIONS = 4  # of the parameters, in which a printer's answer changes most: 98 % of the variance on a delta
LEAST = 0.2  # of a parameter's value
PITCH_MM = 30.0  # of their tables over the bed: coarser than the machine's own, for only their difference counts
PLACES_MM = ((0.0, 0.0), (40.0, 0.0), (0.0, 40.0))  # where the directions are found
SLOWEST_HZ, LINES = 2.0, 60  # of the frequencies there
EVERY = 2  # substeps: often enough for what rings
STANDING_MM_PER_S = 1.0  # below, a motion has no direction, and all of an error counts

_printers: weakref.WeakKeyDictionary[InverseModel, Printers] = weakref.WeakKeyDictionary()


def printers_of(model: InverseModel, safety: float) -> Printers:
    """Return the printers of a machine, the same ones as long as its model lives."""
    known = _printers.get(model)
    if known is None or known.safety != safety:
        known = _printers[model] = Printers(weakref.proxy(model), safety)
    return known


@dataclass(frozen=True, eq=False)
class Printers:
    """The machine file's printer, and some that are off by what its `[uncertainty]` says."""

    model: InverseModel
    safety: float

    @cached_property
    def nominal(self) -> Schedule:
        """The plant of the machine file's printer on the same coarse table, so that only differences count."""
        return self._plant(self.model.machine)

    @cached_property
    def off(self) -> list[tuple[Machine, Schedule]]:
        """The printers that are off, with their plants; none if the machine file is certain of everything."""
        machine = self.model.machine
        parameters = machine.vibration.parameters()
        spread = parameters.relative_sd(machine.uncertainty)
        if not np.any(spread):
            return []

        def moved(deviates: FloatArray) -> Machine:
            return with_values(machine, parameters.scaled(deviates, spread, least=LEAST))

        each = [moved(deviates) for deviates in np.eye(parameters.columns)]
        directions = _principal(machine, each, self.model.settings.bandwidth_hz)
        return [(printer, self._plant(printer)) for printer in map(moved, directions)]

    def _plant(self, machine: Machine) -> Schedule:
        s = self.model.settings
        return Schedule(
            machine.kinematics, plant_table(machine.kinematics, machine.vibration, s.segment_s / s.substeps, PITCH_MM)
        )

    @cached_property
    def far(self) -> float:
        """How many standard deviations the wanted quantile is away."""
        from scipy.stats import norm  # 0.3 s to import

        return float(norm.ppf(1.0 - 0.5 * self.safety))

    def errors(
        self, written: WrittenReference, solution: Solution, path: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, ShortArray]:
        """Return contour errors every `EVERY` substeps: the file's printer's (m,) mm, and changes (k, m, 3) mm.

        path : when its corners are due, and where they are
        """
        at = slice(EVERY - 1, None, EVERY)
        nominal = contour_error(*path, self.moments(written, solution), solution.response[at])
        changes = [change[at] for change in self._changes(written, solution)]
        if not changes:
            return nominal, np.empty((0, len(nominal), 3), np.float32)
        return nominal, np.array(changes, dtype=np.float32)

    def moments(self, written: WrittenReference, solution: Solution) -> FloatArray:
        """Return when the errors of `errors` are, (m,) s on the plan's clock."""
        s = self.model.settings
        count = len(solution.response) // EVERY
        return np.asarray(written.reference.t0 + EVERY * (1.0 + np.arange(count)) * (s.segment_s / s.substeps))

    def _changes(self, written: WrittenReference, solution: Solution) -> Iterator[FloatArray]:
        """Yield what changes across the path, (m, 3) mm after every substep, in each direction."""
        if not self.off:
            return
        model, s, reference = self.model, self.model.settings, written.reference
        nozzle, velocity = reference.substeps(0, reference.knots)
        place = np.ascontiguousarray(nozzle[s.substeps // 2 :: s.substeps, :2])
        centripetal = model.kinematics.rate_term(nozzle, np.ascontiguousarray(velocity))
        filament = np.diff(reference.extrusion())
        played = sample_even_segments(solution.vertices, filament, s.segment_s, s.output, s.substeps)
        command = model.kinematics.inverse(played)

        def answer(machine: Machine, plant: Schedule) -> FloatArray:
            q = plant.play(place, centripetal, command, machine.equilibrium(nozzle[0]), s.substeps)[0]
            return model.kinematics.forward(q)

        usual, along = answer(model.machine, self.nominal), _directions(velocity[1:])
        for machine, plant in self.off:
            change = answer(machine, plant) - usual
            yield change - (change * along).sum(axis=1, keepdims=True) * along


def _directions(velocity: FloatArray) -> FloatArray:
    """Return the directions of velocities (m, 3), zero where the nozzle stands."""
    speed = np.sqrt((velocity**2).sum(axis=1, keepdims=True))
    return np.asarray(np.where(speed > STANDING_MM_PER_S, velocity / np.maximum(speed, STANDING_MM_PER_S), 0.0))


def _principal(machine: Machine, each: list[Machine], bandwidth_hz: float) -> FloatArray:
    """Return the directions of deviates (k, columns), of length one, that change the answer most.

    each : the machine with one deviate at one standard deviation
    """
    f = np.linspace(SLOWEST_HZ, bandwidth_hz, LINES)
    changes = []
    for place in np.array(PLACES_MM):
        known = machine.vibration.frequency_response(place, f, "nozzle", "nozzle")
        answers = (other.vibration.frequency_response(place, f, "nozzle", "nozzle") for other in each)
        changes.append([(answer @ np.linalg.inv(known)).ravel() for answer in answers])
    change: ComplexArray = np.concatenate(changes, axis=1) - np.tile(np.eye(3).ravel(), LINES * len(PLACES_MM))
    _, vectors = np.linalg.eigh((change @ np.conj(change.T)).real)
    return np.asarray(vectors[:, ::-1].T[:DIRECTIONS])
