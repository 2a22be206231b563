"""How far the virtual printer's nozzle is off the wanted path, collected while it is played."""

from __future__ import annotations

import numpy as np

from ffcomp.metrics import Track, build_track, contour_error, end_to_end, tracking
from ffcomp.simulate.command import Stretch, peaks
from ffcomp.simulate.playback import Piece
from models.arrays import FloatArray
from models.machine import Machine
from models.printer.static_deflection import sag

JUDGED_HZ = 1600.0  # no more samples than that are kept, 0.2 GB for an hour of print
FEWEST_SAMPLES = 4


class Judge:
    """Takes pieces in; `track` judges them all. What weight alone bends is taken out, as bed levelling does."""

    def __init__(self, plant: Machine, rate_hz: float, gravity: bool = True) -> None:
        self.plant, self.gravity = plant, gravity
        self.every = max(1, round(rate_hz / JUDGED_HZ))
        self.sample_s = self.every / rate_hz
        self.parts: dict[Stretch, list[tuple[FloatArray, FloatArray]]] = {}  # times and nozzle of each one's pieces
        self.skip = 0  # samples until the next that is kept

    def add(self, piece: Piece) -> None:
        """Take the next piece in; the ringing after a stretch's end is not judged."""
        if piece.stretch not in self.parts:
            self.parts[piece.stretch], self.skip = [], 0
        kept = slice(self.skip, None, self.every)
        t, nozzle = piece.t_s[kept], piece.nozzle_mm[kept]
        self.skip = (self.skip - len(piece.t_s)) % self.every
        inside = t <= piece.stretch.end_s
        self.parts[piece.stretch].append((t[inside], self._levelled(nozzle[inside])))

    def _levelled(self, nozzle: FloatArray) -> FloatArray:
        return nozzle - sag(self.plant, nozzle) if self.gravity else nozzle

    def enough(self, stretches: int, seconds: float) -> bool:
        """Whether so much can be judged at all."""
        return seconds > (FEWEST_SAMPLES + stretches) * self.sample_s

    def track(self) -> tuple[Track, float]:
        """The TRACK of all that was added, and the largest speed, mm/s, a carriage was asked for."""
        found = [self._judged(stretch) for stretch in self.parts]
        reference, nozzle = end_to_end([each.wanted for each in found], [each.nozzle for each in found])
        speeds, accelerations = zip(*(each.peaks() for each in found), strict=True)
        numbers = build_track(
            tracking(reference, nozzle, self.sample_s),
            np.concatenate([each.contour() for each in found]),
            sum(float(each.t[-1] - each.t[0]) for each in found),
            max(accelerations),
        )
        return numbers, max(speeds)

    def _judged(self, stretch: Stretch) -> _Judged:
        t, nozzle = (np.concatenate(parts) for parts in zip(*self.parts[stretch], strict=True))
        return _Judged(stretch, t, nozzle)


class _Judged:
    """One stretch: where the nozzle was, and where it should have been."""

    def __init__(self, stretch: Stretch, t: FloatArray, nozzle: FloatArray) -> None:
        self.stretch, self.t, self.nozzle = stretch, t, nozzle
        self.wanted = stretch.goal.position(t)

    def contour(self) -> FloatArray:
        due = self.stretch.goal.due(self.t)
        corners = self.stretch.goal.path(float(due[0]), float(due[-1]))
        return contour_error(*corners, due, self.nozzle)

    def peaks(self) -> tuple[float, float]:
        return peaks(self.stretch.meant, float(self.t[0]), float(self.t[-1]))
