"""Predict a print's errors without and with compensation by the design model.

This is a prediction by the model that the command was designed with, not a proof: an independent plant evaluates in the
tests and in `compare`. A short print is predicted from the file that was written, read again (`read_again`): it is the
number that `show` finds. Others are predicted while they are compensated (`Prediction`), from the segments as their
lines state them; long prints are sampled section by section, evenly, and the result states their share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ffcomp.compensation.solve import SolvedSection
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.metrics import Track, peak_acceleration, track
from ffcomp.planner.segment_timing import TimedSegments, sample_even_segments
from ffcomp.simulation.command import path_corners_with_rests
from ffcomp.simulation.expectation import EXCERPT_S, Expectation, Piece, expectation, piece_of_segments
from ffcomp.simulation.preview import preview
from models.arrays import FloatArray
from models.machine import Machine

LONGEST_S = 100.0  # of print time that is simulated for the prediction
READ_AGAIN_S = 120.0  # of print time, at most, of a file that is read again
SAMPLE_S = 1e-3  # about


@dataclass(frozen=True, slots=True)
class Forecast:
    """The errors that are predicted for a print."""

    tracks: Mapping[str, Track] = field(default_factory=dict)  # "uncompensated" and "compensated"; empty: none
    over_s: float = 0.0  # print time that it covers
    failed: str = ""  # why there is none, in a sentence
    expected: Expectation | None = None  # the same on printers that the machine file's `[uncertainty]` allows


NO_FORECAST = Forecast()


def forecast(predict: Callable[[], Forecast]) -> Forecast:
    """Predict; whatever goes wrong in a prediction is said, and never fails the print that it is of."""
    try:
        return predict()
    except Exception as error:
        return Forecast(failed=_failure(error))


def _failure(error: Exception) -> str:
    why = f"{type(error).__name__}: {error}".rstrip(".")
    return f"The errors of this print could not be predicted ({why}). The print itself is complete; please report this."


@dataclass
class _Motion:
    """Samples of one kind of motion, run after run."""

    actual: list[FloatArray] = field(default_factory=list)  # (m, 3) mm
    peak: float = 0.0  # mm/s², of the carriages' commands over one segment


@dataclass
class Samples:
    """What was simulated, run after run."""

    sample_s: float
    clock: float = 0.0  # s
    covered_s: float = 0.0
    place: FloatArray = field(default_factory=lambda: np.zeros(3))  # mm, where the last run has ended
    reference: list[FloatArray] = field(default_factory=list)  # (m, 3) mm
    path_t: list[FloatArray] = field(default_factory=list)  # s
    path: list[FloatArray] = field(default_factory=list)  # (k, 3) mm
    before: _Motion = field(default_factory=_Motion)
    after: _Motion = field(default_factory=_Motion)
    pieces: list[Piece] = field(default_factory=list)  # for what is to be expected of printers that are off
    failed: str = ""  # why nothing is predicted, in a sentence

    def __add__(self, later: Samples) -> Samples:

        def moved(points: list[FloatArray]) -> list[FloatArray]:
            return [each + self.place for each in points]

        before, after = (
            _Motion(mine.actual + moved(theirs.actual), max(mine.peak, theirs.peak))
            for mine, theirs in ((self.before, later.before), (self.after, later.after))
        )
        return Samples(
            self.sample_s,
            clock=self.clock + later.clock,
            covered_s=self.covered_s + later.covered_s,
            place=self.place + later.place,
            reference=self.reference + moved(later.reference),
            path_t=self.path_t + [each + self.clock for each in later.path_t],
            path=self.path + moved(later.path),
            before=before,
            after=after,
            pieces=self.pieces + later.pieces,
            failed=self.failed or later.failed,
        )

    def forecast(self, machine: Machine) -> Forecast:
        """Evaluate the sampled sections of a print for a machine."""
        if self.failed or not self.reference:
            return Forecast(failed=self.failed)
        reference = np.concatenate(self.reference)
        t = self.sample_s * np.arange(1, len(reference) + 1, dtype=np.float64)
        path_t, path = np.concatenate(self.path_t), np.concatenate(self.path)
        tracks = {
            name: track(t, reference, np.concatenate(motion.actual), path_t, path, motion.peak)
            for name, motion in (("uncompensated", self.before), ("compensated", self.after))
        }
        return Forecast(tracks, self.covered_s, expected=expectation(machine, self.pieces))


def read_again(written: bytes, path: str, machine: Machine, offset: tuple[float, float], flavor: str) -> Forecast:
    """Predict the errors of a compensated file itself."""
    seen = preview(written, path, machine, offset, flavor)
    tracks = {"uncompensated": seen.before.track, "compensated": seen.after.track}
    return Forecast(tracks, tracks["uncompensated"].print_time_s, expected=seen.expected)


class Prediction:
    """Collects samples of runs while they are compensated."""

    def __init__(self, model: InverseModel, share: float) -> None:
        """Simulate this share of the print, 0 to 1."""
        self.model, self.share = model, share
        s = model.settings
        self.every = max(1, round(SAMPLE_S * s.substeps / s.segment_s))  # substeps from sample to sample
        self.samples = Samples(self.every * s.segment_s / s.substeps)
        self.seen_s = 0.0

    def wants(self, reference: Reference) -> bool:
        """Tell whether it is this section's turn; to be asked once for each."""
        length = reference.knots * self.model.settings.segment_s
        due = self.samples.covered_s <= self.share * self.seen_s
        self.seen_s += length
        return due and not self.samples.failed

    def add(self, solved: SolvedSection, written: Sequence[TimedSegments] = ()) -> None:
        """Take one compensated section in; `written`: its segments, where they are other than the solved ones."""
        try:
            self._add(solved, written)
        except Exception as error:
            self.samples.failed = _failure(error)

    def _add(self, solved: SolvedSection, written: Sequence[TimedSegments]) -> None:
        model, s, samples, every = self.model, self.model.settings, self.samples, self.every
        reference, result = solved.reference, solved.solution
        length = reference.knots * s.segment_s
        samples.covered_s += length
        nozzle, velocity = reference.substeps(0, reference.knots)
        # one after the other in space too: only differences count, and a jump between runs would look like an error
        shift = samples.place - nozzle[0]
        samples.reference.append(nozzle[every::every] + shift)
        samples.place = samples.reference[-1][-1]
        self._add_path(reference, shift)
        state = model.machine.equilibrium(nozzle[0])
        plain, _ = model.plant.respond(nozzle, velocity, state, s.substeps)
        response = result.response + self._joining(solved, nozzle, written)
        knots = nozzle[:: s.substeps]
        for motion, actual, command in ((samples.before, plain, knots), (samples.after, response, result.vertices)):
            motion.actual.append(actual[every - 1 :: every] + shift)
            bend = peak_acceleration(model.kinematics.inverse(command), s.segment_s, s.segment_s)
            motion.peak = max(motion.peak, bend)
        if sum(piece.seconds for piece in samples.pieces) <= EXCERPT_S / LONGEST_S * (samples.covered_s - length):
            samples.pieces.append(self._piece(solved))
        samples.clock += length

    def _piece(self, solved: SolvedSection) -> Piece:
        """Return the middle of a section."""
        reference, segment_s = solved.reference, self.model.settings.segment_s
        knots_t = reference.t0 + segment_s * np.arange(len(solved.solution.vertices), dtype=np.float64)
        path = path_corners_with_rests(solved.trajectory)
        return piece_of_segments(reference.nozzle, knots_t, solved.solution.vertices, path)

    def _joining(self, solved: SolvedSection, nozzle: FloatArray, written: Sequence[TimedSegments]) -> FloatArray:
        """Return what the joined segments add to the response, (n, 3) mm: the model is linear in the command."""
        model, s, vertices = self.model, self.model.settings, solved.solution.vertices
        filament = np.diff(solved.reference.extrusion())
        command = sample_even_segments(vertices, filament, s.segment_s, s.output, s.substeps)
        joined = command.copy()
        times = np.arange(len(command), dtype=np.float64) * (s.segment_s / s.substeps)
        for piece in written:
            rows = slice(*times.searchsorted([piece.due[0], piece.due[-1]]).tolist())
            joined[rows] = piece.positions(times[rows])
        kinematics, still = model.kinematics, np.zeros_like(command)
        added = kinematics.inverse(joined) - kinematics.inverse(command)
        place = np.ascontiguousarray(nozzle[s.substeps // 2 :: s.substeps, :2][: len(vertices) - 1])
        at_rest = np.zeros_like(model.machine.equilibrium(nozzle[0]))
        q, _ = model.plant.play(place, still, added, at_rest, s.substeps)
        response = solved.solution.response
        return kinematics.forward(kinematics.inverse(response) + q) - response

    def _add_path(self, reference: Reference, shift: FloatArray) -> None:
        due, corners = reference.path()
        self.samples.path.append(corners + shift)
        # by rounding a path may end after its last knot, where the next run begins
        length = reference.knots * self.model.settings.segment_s
        self.samples.path_t.append(self.samples.clock + np.clip(due - reference.t0, 0.0, length))
