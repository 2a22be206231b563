"""Predict a print's errors without and with compensation by the design model, while it is compensated.

This is a prediction by the model that the command was designed with, not a proof: an independent plant evaluates in the
tests and in `compare`. It is of the segments as their lines state them, and of the sliced lines as the firmware runs
them: Marlin rounds the ends of both to whole steps, before its own shaper too. Long prints are sampled section by
section, evenly, and the result states how much it covers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ffcomp.firmware.table import FIRMWARES
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.metrics import build_track, contour_error, end_to_end, peaks, tracking
from ffcomp.planner.segment_timing import TimedSegments
from ffcomp.simulation.command import path_corners
from ffcomp.simulation.expectation import EXCERPT_S, Piece, expectation, pieces_of_segments
from ffcomp.simulation.forecast import WAYS, Forecast, failure
from models.arrays import FloatArray
from models.machine import Machine

LONGEST_S = 100.0  # of print time that is simulated for the prediction
SAMPLE_S = 1e-3  # about
Position = Callable[[FloatArray], FloatArray]  # (m,) s → (m, 3) mm
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # its multiples fall evenly between whole numbers, whatever a print repeats


class SampledSection(NamedTuple):
    """A section that was simulated, without compensation and with it: one of WAYS each."""

    lasts_s: float
    reference: FloatArray  # (m, 3) mm
    nozzles: tuple[FloatArray, ...]  # (m, 3) mm each
    contours: tuple[FloatArray, ...]  # (m,) mm each


@dataclass
class Samples:
    """The simulated sections of a print or of a part of it."""

    sample_s: float
    sections: list[SampledSection] = field(default_factory=list)
    peaks: tuple[float, float] = (0.0, 0.0)  # mm/s², of the carriages' commands before and after
    pieces: list[Piece] = field(default_factory=list)  # to estimate the error on printers with other parameters
    failed: str = ""  # why nothing is predicted, in a sentence

    def __add__(self, later: Samples) -> Samples:
        peaks = max(self.peaks[0], later.peaks[0]), max(self.peaks[1], later.peaks[1])
        sections, pieces = self.sections + later.sections, self.pieces + later.pieces
        return Samples(self.sample_s, sections, peaks, pieces, self.failed or later.failed)

    def forecast(self, machine: Machine, flavor: str) -> Forecast:
        """Evaluate the sampled sections of a print for a machine and a firmware."""
        if self.failed or not self.sections:
            return Forecast(failed=self.failed)
        covered_s = sum(each.lasts_s for each in self.sections)
        references = [each.reference for each in self.sections]
        tracks = {}
        for way, (name, peak) in enumerate(zip(WAYS, self.peaks, strict=True)):
            motions = end_to_end(references, [each.nozzles[way] for each in self.sections])
            contour = np.concatenate([each.contours[way] for each in self.sections])
            tracks[name] = build_track(tracking(*motions, self.sample_s), contour, covered_s, peak)
        return Forecast(tracks, covered_s, expected=expectation(machine, self.pieces, flavor))


class Prediction:
    """Collects samples of runs while they are compensated."""

    def __init__(self, model: InverseModel, share: float, flavor: str) -> None:
        """Simulate this share of a print for a firmware; above 1, all of it.

        On the printers that the file allows, less is simulated: EXCERPT_S in LONGEST_S.
        """
        self.model, self.share, self.firmware = model, share, FIRMWARES[flavor].segments(model)
        s = model.settings
        self.every = max(1, round(SAMPLE_S * s.substeps / s.segment_s))  # substeps from sample to sample
        self.samples = Samples(self.every * s.segment_s / s.substeps)
        self.seen_s = self.covered_s = 0.0
        self.ringing: list[FloatArray] = []  # both plants as the last section has ended, without compensation and with

    def add(self, solved: SolvedSection, written: Sequence[TimedSegments] = ()) -> None:
        """Sample the next section, if its turn has come; `written`: its segments, where others than the solved ones."""
        length = solved.reference.knots * self.model.settings.segment_s
        due = self.covered_s <= self.share * self.seen_s and not self.samples.failed
        self.seen_s += length
        try:
            self.ringing = self._add(solved, written, length) if due else []
        except Exception as error:
            self.samples.failed = failure(error)

    def _add(self, solved: SolvedSection, written: Sequence[TimedSegments], length: float) -> list[FloatArray]:
        model, s, samples, every = self.model, self.model.settings, self.samples, self.every
        reference = solved.reference
        self.covered_s += length
        nozzle, velocity = reference.substeps(reference.knots)
        if not self.ringing or solved.rest_s is None:
            states = [model.machine.equilibrium(nozzle[0])] * 2
        else:
            states = [model.state_after_rest(each, nozzle[0], solved.rest_s) for each in self.ringing]
        sliced = self._sliced(reference) if written else reference.nozzle
        t = reference.t0 + self._step_s * np.arange(len(nozzle), dtype=np.float64)
        by_slicer = sliced(t)
        plain, states[0] = model.plant.respond(by_slicer, velocity, states[0], s.substeps)
        executed = self._executed(solved, written)
        response, states[1] = self._response(solved, executed, states[1])
        due, corners = reference.path()
        # by rounding a path may end after its last knot, where the next run begins
        path_t = np.clip(due - reference.t0, 0.0, length)
        nozzles = tuple(each[every - 1 :: every] for each in (plain, response))
        sampled_t = (t - reference.t0)[every::every]
        contours = tuple(contour_error(path_t, corners, sampled_t, each) for each in nozzles)
        samples.sections.append(SampledSection(length, nozzle[every::every], nozzles, contours))
        speeds_up = [peaks(model.kinematics.inverse(each), self._step_s)[1] for each in (by_slicer, executed)]
        samples.peaks = max(samples.peaks[0], speeds_up[0]), max(samples.peaks[1], speeds_up[1])
        samples.pieces += self._pieces(solved, sliced, executed)
        return states

    def _sliced(self, reference: Reference) -> Position:
        """Return the nozzle by the sliced lines, whose ends the firmware rounds."""
        due, corners = reference.path()
        off = self.firmware.rounded(corners) - corners
        return lambda t: reference.nozzle(t) + np.stack([np.interp(t, due, column) for column in off.T], axis=1)

    def _pieces(self, solved: SolvedSection, sliced: Position, executed: FloatArray) -> list[Piece]:
        """Return its share of a section, or all of it if the print is short."""
        reference = solved.reference
        times = reference.t0 + self._step_s * np.arange(len(executed), dtype=np.float64)
        share = EXCERPT_S / LONGEST_S * max(self.share, 1.0)
        lot = GOLDEN * len(self.samples.sections) % 1.0
        path = path_corners(solved.trajectory)
        return pieces_of_segments(sliced, times, executed, path, share, lot)

    @property
    def _step_s(self) -> float:
        return self.model.settings.segment_s / self.model.settings.substeps

    def _executed(self, solved: SolvedSection, written: Sequence[TimedSegments]) -> FloatArray:
        """Return the command by the written segments, (n, 3) mm."""
        command = self.model.executed(solved.reference, solved.solution.vertices)
        times = np.arange(len(command), dtype=np.float64) * self._step_s
        for piece in written:
            rows = slice(*times.searchsorted([piece.due[0], piece.due[-1]]).tolist())
            command[rows] = piece.positions(times[rows])
        return command

    def _response(self, solved: SolvedSection, command: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the nozzle (n, 3) mm after every substep of a command (n + 1, 3) mm, and the plant's state at its end.

        state : (18,) at its beginning
        """
        model, reference, known = self.model, solved.reference, solved.solution.response
        if known is None:
            return model.respond(reference, command, state)
        # of a nonlinear printer, whose change by the written segments is taken as linear
        kinematics, substeps = model.kinematics, model.settings.substeps
        solved_for = model.executed(reference, solved.solution.vertices)
        added = kinematics.inverse(command) - kinematics.inverse(solved_for)
        place = model.places(reference.substeps(reference.knots)[0])
        q, _ = model.plant.play(place, np.zeros_like(added), added, np.zeros_like(state), substeps)
        return kinematics.forward(kinematics.inverse(known) + q), state
