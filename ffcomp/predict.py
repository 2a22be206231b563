"""What the design model says about a print: how it would have come out, and how it comes out now.

A prediction by the model the command was designed with, not a proof: an independent plant judges in the tests and in
`compare`. Long prints are sampled run by run, evenly, and the result says how much of the print it covers.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ffcomp.invert.inverter import Inverter, RunResult
from ffcomp.metrics import Track, peak_acceleration, track
from ffcomp.plan.trajectory import Trajectory
from ffcomp.runs import Reference, Run
from ffcomp.schedule import rest_state

FloatArray = NDArray[np.float64]

LONGEST_S = 300.0  # of print time that is simulated for the prediction
SAMPLE_S = 1e-3  # about


@dataclass
class _Motion:
    """Samples of one kind of motion, run after run."""

    actual: list[FloatArray] = field(default_factory=list)  # (m, 3) mm
    peak: float = 0.0  # mm/s², of the carriages' commands over one segment


class Prediction:
    """Collects runs while they are compensated; `tracks` judges them at the end."""

    def __init__(self, inverter: Inverter, print_time_s: float) -> None:
        self.inverter = inverter
        self.share = min(1.0, LONGEST_S / max(print_time_s, 1e-9))
        s = inverter.settings
        self.every = max(1, round(SAMPLE_S * s.substeps / s.segment_s))  # substeps from sample to sample
        self.sample_s = self.every * s.segment_s / s.substeps
        self.clock = self.seen_s = self.covered_s = 0.0
        self.place = np.zeros(3)
        self.wanted: list[FloatArray] = []
        self.path_t: list[FloatArray] = []
        self.path: list[FloatArray] = []
        self.before, self.after = _Motion(), _Motion()

    def wants(self, wanted: Reference) -> bool:
        """Is it this run's turn? (Ask once for each run.)"""
        length = wanted.knots * self.inverter.settings.segment_s
        due = self.covered_s <= self.share * self.seen_s
        self.seen_s += length
        return due

    def add(self, trajectory: Trajectory, run: Run, wanted: Reference, result: RunResult) -> None:
        """Take one compensated run in."""
        inverter, s = self.inverter, self.inverter.settings
        length = wanted.knots * s.segment_s
        self.covered_s += length
        every = self.every
        nozzle, velocity = wanted.substeps(0, wanted.knots)
        # one after the other in space too: only differences count, and a jump between runs would look like an error
        shift = self.place - nozzle[0]
        self.wanted.append(nozzle[every::every] + shift)
        self.place = self.wanted[-1][-1]
        self._add_path(trajectory, run, wanted, shift)
        state = rest_state(inverter.machine, nozzle[0])
        plain, _ = inverter.fine.respond(nozzle, velocity, state, s.substeps)
        knots = nozzle[:: s.substeps]
        for motion, actual, command in ((self.before, plain, knots), (self.after, result.response, result.vertices)):
            motion.actual.append(actual[every - 1 :: every] + shift)
            bend = peak_acceleration(inverter.delta.inverse(command), s.segment_s, s.segment_s)
            motion.peak = max(motion.peak, bend)
        self.clock += length

    def _add_path(self, trajectory: Trajectory, run: Run, wanted: Reference, shift: FloatArray) -> None:
        part = slice(run.first, run.last)
        corners = np.vstack([trajectory.origin[part, :3], wanted.nozzle(np.array([run.end_t]))])
        due = np.append(trajectory.start_t[part], run.end_t)
        self.path.append(corners + shift)
        self.path_t.append(self.clock + due - wanted.t0)

    def tracks(self) -> dict[str, Track]:
        """ "uncompensated" and "compensated", each judged over the runs that were taken in."""
        if not self.wanted:
            return {}
        wanted = np.concatenate(self.wanted)
        t = self.sample_s * np.arange(1, len(wanted) + 1, dtype=np.float64)
        path_t, path = np.concatenate(self.path_t), np.concatenate(self.path)
        return {
            name: track(t, wanted, np.concatenate(motion.actual), path_t, path, motion.peak)
            for name, motion in (("uncompensated", self.before), ("compensated", self.after))
        }
