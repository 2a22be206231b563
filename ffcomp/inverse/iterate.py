"""One run while it is inverted: its coefficients, and what the plant makes of them as the firmware plays them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ffcomp.inverse.reference import Reference
from ffcomp.planner.segment_timing import played, sample_segments
from models.arrays import FloatArray

if TYPE_CHECKING:
    from ffcomp.inverse.model import Inverter


CONTEXT = 4  # segments before a stretch that decide how fast it is entered


class Playing:
    """The coefficients γ of one run (n + 1, 3) mm over its knots and those in sight after its end.

    `softened` (m, 3) mm is what is wanted beyond the path at the rows of its segments; empty: nothing is.
    """

    def __init__(self, inverter: Inverter, reference: Reference) -> None:
        self.inverter, self.reference = inverter, reference
        self.last = reference.knots  # the knot at which the command comes to rest
        self.n = self.last + inverter.settings.preview
        self.gamma = np.zeros((self.n + 1, 3))
        self.vertices = np.empty((self.last + 1, 3))
        self.softened = inverter.softened(reference)
        self.extrusion = np.concatenate([np.diff(reference.extrusion()), np.zeros(self.n - self.last)])


class Stretch:
    """The knots `at` … `end` of a run: what is wanted there, and what comes of the coefficients as they stand."""

    def __init__(self, run: Playing, at: int, end: int) -> None:
        s = run.inverter.settings
        self.run, self.at, self.end = run, at, end
        self.nozzle, self.velocity = run.reference.substeps(at, end)
        self.wanted = run.inverter.delta.inverse(self.nozzle[:: s.substeps])
        self.place = np.ascontiguousarray(self.nozzle[s.substeps // 2 :: s.substeps, :2])
        self._centripetal = run.inverter.delta.rate_term(self.nozzle, np.ascontiguousarray(self.velocity))
        self._stride = s.substeps // s.rows_per_segment
        self._due = self.nozzle[self._stride :: self._stride].copy()  # at the rows that are weighed
        first = at * s.rows_per_segment
        own = run.softened[first : first + len(self._due)]
        self._due[: len(own)] += own

    def vertices(self) -> FloatArray:
        """Nozzle commands at the knots, (n + 1, 3) mm."""
        return self.run.inverter.delta.forward(self.wanted + self.run.gamma[self.at : self.end + 1])

    def respond(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nozzle (m, 3) mm after every substep and states at the knots, from a state (18,) at the first knot."""
        q, states = self._carriages(state)
        return self.run.inverter.delta.forward(q), states

    def error(self, response: FloatArray) -> FloatArray:
        """Where the nozzle should have been instead, at the rows that are weighed: (rows, 3) mm."""
        return self._due - response[self._stride - 1 :: self._stride]

    def error_from(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same, and the states at the knots, from a state (18,) at the first knot."""
        q, states = self._carriages(state)
        rows = np.ascontiguousarray(q[self._stride - 1 :: self._stride])
        return self._due - self.run.inverter.delta.forward(rows), states

    def _carriages(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        inverter = self.run.inverter
        command = inverter.delta.inverse(self.as_played())
        return inverter.fine.play(self.place, self._centripetal, command, state, inverter.settings.substeps)

    def as_played(self) -> FloatArray:
        """The command as the firmware plays the segments: straight for the nozzle, with its ramps. (m, 3) mm."""
        run, s = self.run, self.run.inverter.settings
        before = min(self.at, CONTEXT)
        first = self.at - before
        vertices = np.concatenate([run.vertices[first : self.at], self.vertices()])
        lasting = np.full(len(vertices) - 1, s.segment_s)
        speeds = played(vertices, run.extrusion[first : self.end], lasting, s.output)
        nozzle = sample_segments(
            vertices, speeds.cruise, speeds.junction, speeds.acceleration, speeds.duration, s.substeps
        )
        return nozzle[before * s.substeps :]
