"""Measure where and how much recordings and simulation disagree: one call from recordings to the JSON of `gap`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ffcomp.diagnose.diagnosis import noise_floor
from ffcomp.diagnose.noise import whitener
from ffcomp.diagnose.problem import Repeated
from ffcomp.diagnose.problems import problem_of
from ffcomp.diagnose.residuals import ResidualBreakdown, ResidualSize, locate_residual
from ffcomp.diagnose.validation import Recorded, check_alike
from models.machine import Machine


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """The model discrepancy of a machine file on some recordings."""

    found: ResidualBreakdown
    from_repeats: bool  # whether repeats give the noise; else the spectrum above the model's band does
    notes: tuple[str, ...] = ()  # what is wrong with the repeats, in full sentences

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-gap/1."""
        found = self.found
        return {
            "schema": "ffcomp-gap/1",
            **_size(found.total),
            "noise_from_repeats": self.from_repeats,
            "notes": list(self.notes),
            "signals": {name: _size(size) for name, size in found.signals.items()},
            "where": {
                "frequency_hz": [{"from": low, "to": high, "share": share} for low, high, share in found.bands],
                "signal": {name: over_noise(size) for name, size in found.signals.items()},
                "region": [{"place_mm": list(position), "share": share} for position, share in found.positions.items()],
                "near_reversals": found.near_reversals,
                "runs": {name: _size(size) for name, size in found.recordings.items()},
            },
        }


def measure_gap(machine: Machine, recordings: Sequence[Recorded]) -> Discrepancy:
    """Simulate the recordings with the machine and its effects, and compare.

    Raises
    ------
    MeasurementError
        If the recordings cannot belong to this machine or to each other.
    """
    problem = problem_of(machine, recordings, ())
    check_alike(recordings)
    simulated = problem.simulate({})
    floor = noise_floor(problem, simulated)
    found = locate_residual(whitener(problem.observations, floor, problem.band_hz), floor, simulated)
    return Discrepancy(found, floor.from_repeats, tuple(_notes(problem.repeats)))


def _notes(repeats: Sequence[Repeated]) -> list[str]:
    late = [
        f"{each.late()}; they were moved onto each other before they were compared." for each in repeats if each.apart
    ]
    return [*late, *(each.trouble() for each in repeats if each.differ)]


def over_noise(size: ResidualSize) -> float:
    """Return how many times the noise a discrepancy is."""
    return size.nrms / size.noise_nrms


def _size(size: ResidualSize) -> dict[str, float]:
    return {"nrms": size.nrms, "noise_nrms": size.noise_nrms}
