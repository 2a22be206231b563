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
from ffcomp.metrics import build_track, contour_error, peaks, tracking
from ffcomp.planner.segment_timing import TimedSegments, sample_even_segments
from ffcomp.simulation.command import path_corners_with_rests
from ffcomp.simulation.expectation import EXCERPT_S, Piece, expectation, pieces_of_segments
from ffcomp.simulation.forecast import WAYS, Forecast, failure
from models.arrays import FloatArray
from models.machine import Machine

LONGEST_S = 100.0  # of print time that is simulated for the prediction
SAMPLE_S = 1e-3  # about
Position = Callable[[FloatArray], FloatArray]  # (m,) s → (m, 3) mm
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # its multiples fall evenly between whole numbers, whatever a print repeats


class SampledSection(NamedTuple):
    """A section that was simulated."""

    lasts_s: float
    begin: FloatArray  # (3,) mm, the reference at its first knot
    reference: FloatArray  # (m, 3) mm
    before: FloatArray  # (m, 3) mm, the nozzle without compensation
    after: FloatArray  # (m, 3) mm
    path_t: FloatArray  # (k,) s since its first knot
    path: FloatArray  # (k, 3) mm


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
        # one after the other in space too: only differences count, and a jump between runs would look like an error
        place, covered_s, shifts, begins = np.zeros(3), 0.0, list[FloatArray](), list[float]()
        for each in self.sections:
            shifts.append(place - each.begin)
            begins.append(covered_s)
            place, covered_s = each.reference[-1] + shifts[-1], covered_s + each.lasts_s
        pairs = list(zip(self.sections, shifts, strict=True))
        reference = np.concatenate([each.reference + shift for each, shift in pairs])
        before = np.concatenate([each.before + shift for each, shift in pairs])
        after = np.concatenate([each.after + shift for each, shift in pairs])
        path = np.concatenate([each.path + shift for each, shift in pairs])
        path_t = np.concatenate([each.path_t + begin for each, begin in zip(self.sections, begins, strict=True)])
        t = self.sample_s * np.arange(1, len(reference) + 1, dtype=np.float64)
        tracks = {
            name: build_track(
                tracking(reference, actual, self.sample_s),
                contour_error(path_t, path, t, actual),
                float(path_t[-1] - path_t[0]),
                peak,
            )
            for name, actual, peak in zip(WAYS, (before, after), self.peaks, strict=True)
        }
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
        self.ringing: FloatArray | None = None  # the plant without compensation, as the last section has ended

    def wants(self, reference: Reference) -> bool:
        """Return whether to sample this section; to be called once for each."""
        length = reference.knots * self.model.settings.segment_s
        due = self.covered_s <= self.share * self.seen_s
        self.seen_s += length
        return due and not self.samples.failed

    def add(self, solved: SolvedSection, written: Sequence[TimedSegments] = ()) -> None:
        """Take the next section in if it is sampled; `written`: its segments, where others than the solved ones."""
        try:
            self.ringing = self._add(solved, written) if solved.sampled else None
        except Exception as error:
            self.samples.failed = failure(error)

    def _add(self, solved: SolvedSection, written: Sequence[TimedSegments]) -> FloatArray:
        model, s, samples, every = self.model, self.model.settings, self.samples, self.every
        reference, result = solved.reference, solved.solution
        length = reference.knots * s.segment_s
        self.covered_s += length
        nozzle, velocity = reference.substeps(0, reference.knots)
        if self.ringing is None or solved.rest_s is None:
            state = model.machine.equilibrium(nozzle[0])
        else:
            state = model.state_after_rest(self.ringing, nozzle[0], solved.rest_s)
        sliced = self._sliced(reference) if written else reference.nozzle
        t = reference.t0 + self._step_s * np.arange(len(nozzle), dtype=np.float64)
        by_slicer = sliced(t)
        plain, ringing = model.plant.respond(by_slicer, velocity, state, s.substeps)
        solved_for, executed = self._commands(solved, written)
        response = result.response + self._joining(solved, nozzle, solved_for, executed)
        due, corners = reference.path()
        # by rounding a path may end after its last knot, where the next run begins
        path_t = np.clip(due - reference.t0, 0.0, length)
        at = slice(every - 1, None, every)
        sampled = SampledSection(length, nozzle[0], nozzle[every::every], plain[at], response[at], path_t, corners)
        samples.sections.append(sampled)
        speeds_up = [peaks(model.kinematics.inverse(each), self._step_s)[1] for each in (by_slicer, executed)]
        samples.peaks = max(samples.peaks[0], speeds_up[0]), max(samples.peaks[1], speeds_up[1])
        samples.pieces += self._pieces(solved, sliced, executed)
        return ringing

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
        path = path_corners_with_rests(solved.trajectory)
        return pieces_of_segments(sliced, times, executed, path, share, lot)

    @property
    def _step_s(self) -> float:
        return self.model.settings.segment_s / self.model.settings.substeps

    def _commands(self, solved: SolvedSection, written: Sequence[TimedSegments]) -> tuple[FloatArray, FloatArray]:
        """Return the solved command, and that of the written segments: (n, 3) mm each."""
        s = self.model.settings
        filament = np.diff(solved.reference.extrusion())
        command = sample_even_segments(solved.solution.vertices, filament, s.segment_s, s.output, s.substeps)
        executed = command.copy()
        times = np.arange(len(command), dtype=np.float64) * self._step_s
        for piece in written:
            rows = slice(*times.searchsorted([piece.due[0], piece.due[-1]]).tolist())
            executed[rows] = piece.positions(times[rows])
        return command, executed

    def _joining(
        self, solved: SolvedSection, nozzle: FloatArray, command: FloatArray, executed: FloatArray
    ) -> FloatArray:
        """Return the change of the response by the written segments, (n, 3) mm: the model is linear in the command."""
        model, s = self.model, self.model.settings
        kinematics, still = model.kinematics, np.zeros_like(command)
        added = kinematics.inverse(executed) - kinematics.inverse(command)
        place = np.ascontiguousarray(nozzle[s.substeps // 2 :: s.substeps, :2][: len(command) // s.substeps])
        at_rest = np.zeros_like(model.machine.equilibrium(nozzle[0]))
        q, _ = model.plant.play(place, still, added, at_rest, s.substeps)
        response = solved.solution.response
        return kinematics.forward(kinematics.inverse(response) + q) - response
