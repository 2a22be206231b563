"""Error of the simulated nozzle against the reference path, collected while a command is executed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.metrics import Track, build_track, contour_error, end_to_end, tracking
from ffcomp.simulate.command import CommandSection, command_peaks
from ffcomp.simulate.playback import Chunk, levelled
from models.arrays import FloatArray
from models.machine import Machine

EVALUATED_HZ = 1600.0  # no more samples than that are kept, 0.2 GB for an hour of print
FEWEST_SAMPLES = 4


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What was executed against its reference, at m samples of all sections, and its statistics."""

    time_s: FloatArray  # (m,) on the command's clock
    reference_mm: FloatArray  # (m, 3) where the nozzle should be
    nozzle_mm: FloatArray  # (m, 3) where it is, static deflection taken out
    error_um: FloatArray  # (m,) contour error
    track: Track
    peak_actuator_velocity_mm_per_s: float


class Evaluator:
    """Collect chunks of an executed command and evaluate them all.

    Static deflection is taken out (unless there is no gravity), as bed levelling does. The ringing after a section's
    end is not evaluated.
    """

    def __init__(self, plant: Machine, rate_hz: float, gravity: bool = True) -> None:
        self._plant, self._gravity = plant, gravity
        self._every = max(1, round(rate_hz / EVALUATED_HZ))
        self._sample_s = self._every / rate_hz
        self._parts: dict[CommandSection, list[tuple[FloatArray, FloatArray]]] = {}  # times and nozzle of its chunks
        self._skip = 0  # samples until the next that is kept

    def add(self, chunk: Chunk) -> None:
        """Take the next chunk in."""
        if chunk.section not in self._parts:
            self._parts[chunk.section], self._skip = [], 0
        kept = slice(self._skip, None, self._every)
        t, nozzle = chunk.t_s[kept], chunk.nozzle_mm[kept]
        self._skip = (self._skip - len(chunk.t_s)) % self._every
        inside = t <= chunk.section.end_s
        nozzle = levelled(self._plant, nozzle[inside]) if self._gravity else nozzle[inside]
        self._parts[chunk.section].append((t[inside], nozzle))

    def enough(self, sections: int, seconds: float) -> bool:
        """Tell whether a motion of so many sections and seconds can be evaluated at all."""
        return seconds > (FEWEST_SAMPLES + sections) * self._sample_s

    def evaluation(self) -> Evaluation:
        """Evaluate everything that was added."""
        found = [self._section(section) for section in self._parts]
        reference, nozzle = end_to_end([each.reference for each in found], [each.nozzle for each in found])
        contour = np.concatenate([each.contour() for each in found])
        speeds, accelerations = zip(*(each.peaks() for each in found), strict=True)
        seconds = sum(float(each.t[-1] - each.t[0]) for each in found)
        return Evaluation(
            time_s=np.concatenate([each.t for each in found]),
            reference_mm=np.concatenate([each.reference for each in found]),
            nozzle_mm=np.concatenate([each.nozzle for each in found]),
            error_um=1e3 * contour,
            track=build_track(tracking(reference, nozzle, self._sample_s), contour, seconds, max(accelerations)),
            peak_actuator_velocity_mm_per_s=max(speeds),
        )

    def _section(self, section: CommandSection) -> _EvaluatedSection:
        t, nozzle = (np.concatenate(parts) for parts in zip(*self._parts[section], strict=True))
        return _EvaluatedSection(section, t, nozzle)


class _EvaluatedSection:
    """One section: where the nozzle was, and where it should have been."""

    def __init__(self, section: CommandSection, t: FloatArray, nozzle: FloatArray) -> None:
        self.section, self.t, self.nozzle = section, t, nozzle
        self.reference = section.reference.position(t)

    def contour(self) -> FloatArray:
        plan_t = self.section.reference.plan_time(self.t)
        corners = self.section.reference.corners(float(plan_t[0]), float(plan_t[-1]))
        return contour_error(*corners, plan_t, self.nozzle)

    def peaks(self) -> tuple[float, float]:
        return command_peaks(self.section.actuators, float(self.t[0]), float(self.t[-1]))
