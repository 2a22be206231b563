"""The iterate of one section: its coefficients, and the plant's response to them as the firmware executes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ffcomp.inverse.reference import Reference
from ffcomp.planner.segment_timing import sample_even_segments
from models.arrays import FloatArray

if TYPE_CHECKING:
    from ffcomp.inverse.model import InverseModel


CONTEXT = 4  # segments before a window that decide how fast it is entered


class Iterate:
    """The coefficients γ of one section (n + 1, 3) mm over its knots and those in sight after its end.

    `robust_offset` (m, 3) mm is the robust reference less the path at the rows of its segments; empty: none.
    """

    def __init__(self, model: InverseModel, reference: Reference) -> None:
        self.model, self.reference = model, reference
        self.last = reference.knots  # the knot at which the command comes to rest
        self.n = self.last + model.settings.preview
        self.gamma = np.zeros((self.n + 1, 3))
        self.vertices = np.empty((self.last + 1, 3))
        self.robust_offset = model.robust_offset(reference)
        self.extrusion = np.concatenate([np.diff(reference.extrusion()), np.zeros(self.n - self.last)])


class KnotWindow:
    """The knots `at` … `end` of a section: the reference there, and the response to the coefficients as they stand."""

    def __init__(self, iterate: Iterate, at: int, end: int) -> None:
        s = iterate.model.settings
        self.iterate, self.at, self.end = iterate, at, end
        self.nozzle, self.velocity = iterate.reference.substeps(at, end)
        self.reference_q = iterate.model.kinematics.inverse(self.nozzle[:: s.substeps])
        self.place = np.ascontiguousarray(self.nozzle[s.substeps // 2 :: s.substeps, :2])
        self._centripetal = iterate.model.kinematics.rate_term(self.nozzle, np.ascontiguousarray(self.velocity))
        self._stride = s.substeps // s.rows_per_segment
        self._due = self.nozzle[self._stride :: self._stride].copy()  # at the rows that are weighed
        first = at * s.rows_per_segment
        own = iterate.robust_offset[first : first + len(self._due)]
        self._due[: len(own)] += own

    def vertices(self) -> FloatArray:
        """Return the nozzle commands at the knots, (n + 1, 3) mm."""
        return self.iterate.model.kinematics.forward(self.reference_q + self.iterate.gamma[self.at : self.end + 1])

    def respond(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the nozzle (m, 3) mm after every substep and the states at the knots, from the first one's (18,)."""
        q, states = self._carriages(state)
        return self.iterate.model.kinematics.forward(q), states

    def error(self, response: FloatArray) -> FloatArray:
        """Return the error of a response at the rows that are weighed, (rows, 3) mm."""
        return self._due - response[self._stride - 1 :: self._stride]

    def error_from(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the error by the plant, and the states at the knots, from a state (18,) at the first knot."""
        q, states = self._carriages(state)
        rows = np.ascontiguousarray(q[self._stride - 1 :: self._stride])
        return self._due - self.iterate.model.kinematics.forward(rows), states

    def _carriages(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        model = self.iterate.model
        command = model.kinematics.inverse(self.as_played())
        return model.plant.play(self.place, self._centripetal, command, state, model.settings.substeps)

    def as_played(self) -> FloatArray:
        """Return the command as the firmware executes the segments: straight, with its ramps, (m, 3) mm."""
        iterate, s = self.iterate, self.iterate.model.settings
        before = min(self.at, CONTEXT)
        first = self.at - before
        vertices = self.vertices()
        if before:
            vertices = np.concatenate([iterate.vertices[first : self.at], vertices])
        extrusion = iterate.extrusion[first : self.end]
        return sample_even_segments(vertices, extrusion, s.segment_s, s.output, s.substeps)[before * s.substeps :]
