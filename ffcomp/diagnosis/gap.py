"""Where and how much recordings and simulation disagree: the residual against measurement and noise, and `gap`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.fit import estimation_problem, fit
from ffcomp.diagnosis.noise import NoiseFloor, Whitener, noise_floor, whitener
from ffcomp.diagnosis.problem import Observation, Problem, Repeats
from ffcomp.diagnosis.problems import Recorded, check_alike, plant_of, problem_of, recordings_of
from ffcomp.diagnosis.request import GapRequest
from ffcomp.record.axes import turn_of
from ffcomp.result import Fact, Result
from models.arrays import FloatArray
from models.machine import Machine

EDGES_HZ = (1.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 130.0, 160.0, 200.0)
SLOW_SHARE = 0.05  # of a signal's largest speed: slower than that it is near a reversal


@dataclass(frozen=True)
class ResidualSize:
    """√(Σ(measured − simulated)²/Σ measured²) inside the band, and the same of noise alone."""

    nrms: float
    noise_nrms: float

    @property
    def over_noise(self) -> float:
        """How many times the noise it is."""
        return self.nrms / self.noise_nrms

    def to_dict(self) -> dict[str, float]:
        """Return the JSON's pair of numbers."""
        return {
            # number: √(Σ(measured − simulated)² / Σ measured²), both filtered alike to the machine's band
            "nrms": self.nrms,
            "noise_nrms": self.noise_nrms,  # number: what noise alone would leave
        }


@dataclass(frozen=True, eq=False)
class ResidualBreakdown:
    """The residual as a whole and in parts; the excess is its power above the noise."""

    total: ResidualSize
    signals: Mapping[str, ResidualSize]
    recordings: Mapping[str, ResidualSize]
    positions: Mapping[tuple[float, ...], float]  # share of the excess
    bands: Sequence[tuple[float, float, float]]  # from Hz, to Hz, share of the excess
    near_reversals: float  # share of the excess while the part a signal is measured on reverses or rests
    forwards: float  # share of it while that part moves forwards, of all while it moves


def locate_residual(whiten: Whitener, floor: NoiseFloor, simulated: Sequence[FloatArray]) -> ResidualBreakdown:
    """Compare all observations with their simulation, (n, m) each."""
    tables = [_table(whiten, floor, r, y) for r, y in zip(whiten.observations, simulated, strict=True)]
    excess = [np.maximum(t.error - t.noise, 0.0) for t in tables]
    total = max(sum(float(e.sum()) for e in excess), 1e-300)
    observations = whiten.observations
    signals = sorted({s for r in observations for s in r.signals})
    positions: dict[tuple[float, ...], float] = {}
    for r, e in zip(observations, excess, strict=True):
        positions[r.position] = positions.get(r.position, 0.0) + float(e.sum()) / total
    return ResidualBreakdown(
        _size(tables, [np.ones(len(r.signals), bool) for r in observations]),
        {s: _size(tables, [np.array([name == s for name in r.signals]) for r in observations]) for s in signals},
        {
            Path(r.name).name: _size([t], [np.ones(len(r.signals), bool)])
            for r, t in zip(observations, tables, strict=True)
        },
        positions,
        _bands(tables, excess, total),
        *_by_motion(observations, simulated),
    )


@dataclass(frozen=True, eq=False)
class _Table:
    """Powers of one observation by signal and frequency, (m, k): of error, noise and measured signals."""

    frequency_hz: FloatArray
    error: FloatArray
    noise: FloatArray
    signal: FloatArray


def _table(whiten: Whitener, floor: NoiseFloor, observation: Observation, simulated: FloatArray) -> _Table:
    error, frequency = whiten.spectrum(observation, observation.measured - simulated)
    signal, _ = whiten.spectrum(observation, observation.measured)
    scale = whiten.power(observation)
    noise = np.stack([2 * scale * floor.at(s, frequency) for s in observation.signals])
    return _Table(frequency, np.abs(error) ** 2, noise, np.abs(signal) ** 2)


def _size(tables: Sequence[_Table], chosen: Sequence[NDArray[np.bool_]]) -> ResidualSize:
    sums = [
        sum(float(getattr(t, part)[keep].sum()) for t, keep in zip(tables, chosen, strict=True))
        for part in ("error", "noise", "signal")
    ]
    return ResidualSize(float(np.sqrt(sums[0] / sums[2])), float(np.sqrt(sums[1] / sums[2])))


def _bands(tables: Sequence[_Table], excess: Sequence[FloatArray], total: float) -> list[tuple[float, float, float]]:
    bands = []
    for low, high in pairwise(EDGES_HZ):
        inside = [e[:, (t.frequency_hz >= low) & (t.frequency_hz < high)] for t, e in zip(tables, excess, strict=True)]
        bands.append((low, high, sum(float(e.sum()) for e in inside) / total))
    return bands


def _by_motion(observations: Sequence[Observation], simulated: Sequence[FloatArray]) -> tuple[float, float]:
    near = forwards = total = 0.0
    for r, y in zip(observations, simulated, strict=True):
        power = np.nan_to_num((r.measured - y) ** 2)
        slow = np.abs(r.speed) < SLOW_SHARE * np.max(np.abs(r.speed), axis=0)
        near, total = near + float(power[slow].sum()), total + float(power.sum())
        forwards += float(power[~slow & (r.speed > 0)].sum())
    return near / max(total, 1e-300), forwards / max(total - near, 1e-300)


# ---- the verb ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Discrepancy(Result):
    """The model discrepancy of a machine file on some recordings."""

    residual: ResidualBreakdown
    floor: NoiseFloor
    notes: tuple[str, ...] = ()  # faults of the repeats, in full sentences
    places: Mapping[tuple[float, ...], str] = field(default_factory=dict)  # what people call them
    forces: bool = False  # compared are the drive's force and the one that the measured motion needs

    @property
    def headline(self) -> str:
        """How large the disagreement is, and what noise alone would leave."""
        total = self.residual.total
        noise = "; that is noise" if self.is_noise else ""
        compared = "the drive's forces" if self.forces else "the signals"
        return (
            f"Simulation and measurement differ by {100 * total.nrms:.2f} % of {compared}; noise alone would leave "
            f"{100 * total.noise_nrms:.2f} % (known from {self.floor.origin}){noise}."
        )

    @property
    def is_noise(self) -> bool:
        """Whether there is nothing else."""
        return self.residual.total.over_noise < 1.1 and not self.notes

    @property
    def facts(self) -> list[Fact]:
        """The disagreement by signal and run; where most of it is: bands, places, reversals."""
        residual = self.residual
        sizes = [*residual.signals.items(), *residual.recordings.items()]
        facts = [(name, f"{100 * e.nrms:.2f} %, {e.over_noise:.1f} times the noise") for name, e in sizes]
        if self.is_noise:
            return facts
        loud = sorted(residual.bands, key=lambda band: -band[2])[:3]
        facts.append(("Bands", ", ".join(f"{low:g}-{high:g} Hz {100 * share:.0f} %" for low, high, share in loud)))
        places = sorted(residual.positions.items(), key=lambda item: -item[1])
        facts += [(self.places[place], f"{100 * share:.0f} %") for place, share in places]
        return [*facts, ("Near reversals and at rest", f"{100 * residual.near_reversals:.0f} %")]

    @property
    def warnings(self) -> Sequence[str]:
        """The faults of the repeats."""
        return self.notes

    def details(self) -> dict[str, Any]:
        """Return the keys of ffcomp-gap/1."""
        residual = self.residual
        return {
            "schema": "ffcomp-gap/1",
            **residual.total.to_dict(),  # … SIZE: its keys stand here too, of all signals of all runs
            # `signals`; `forces`: as `diagnose` compares, of an axis that is simulated worse than one that stands still
            "compared": "forces" if self.forces else "signals",
            # true or false: false: an encoder's own, or from the spectrum above the model's band, which is weaker
            "noise_from_repeats": self.floor.from_repeats,
            "notes": list(self.notes),  # list of text: repeats that lie apart in time, or do not repeat: sentences
            # .* SIZE: by sensor: acc_A, acc_x, …
            "signals": {name: size.to_dict() for name, size in residual.signals.items()},
            "where": {
                "frequency_hz": [
                    {
                        "from": low,  # number [Hz]: bands
                        "to": high,  # number [Hz]
                        "share": share,  # number: of what lies above the noise
                    }
                    for low, high, share in residual.bands
                ],
                # .* number: by sensor: times the noise
                "signal": {name: size.over_noise for name, size in residual.signals.items()},
                "region": [
                    {
                        "place_mm": list(position),  # list of numbers: of an axis by itself `from_s`, a window of time
                        "share": share,  # number
                    }
                    if len(position) > 1
                    else {"from_s": position[0], "share": share}
                    for position, share in residual.positions.items()
                ],
                "near_reversals": residual.near_reversals,  # number: share while a carriage turns back or rests
                "runs": {name: size.to_dict() for name, size in residual.recordings.items()},  # .* SIZE: by file
            },
        }


def gap_request(request: GapRequest) -> Discrepancy:
    """Measure where and how much recordings and simulation disagree.

    Parameters
    ----------
    progress : takes sentences on what is being done

    Raises
    ------
    MeasurementError, MachineFileError
    """
    plant = plant_of(request.machine)
    given = cast("tuple[Path | Recorded, ...]", request.recordings)
    recordings = [each for each in given if not isinstance(each, Path)]
    files = [each for each in given if isinstance(each, Path)]
    if files:
        recordings += recordings_of(plant, files, request.plan, turn_of(request.axes_map), request.progress)
    return measure_gap(plant, recordings)


def measure_gap(machine: Machine, recordings: Sequence[Recorded]) -> Discrepancy:
    """Simulate the recordings with the machine and its effects, and compare.

    Raises
    ------
    MeasurementError
        If the recordings cannot belong to this machine or to each other.
    """
    problem = problem_of(machine, recordings, ())
    check_alike(recordings)
    return gap_of(as_compared(problem))


def as_compared(problem: Problem) -> Problem:
    """Return the problem that `diagnose` compares on these recordings.

    Of an axis that is further off than one that stands still, also with its numbers retuned: that of the forces.
    """
    balance = problem.balance()
    if balance is None:
        return problem
    estimation = estimation_problem(problem, whitener(problem.observations, noise_floor(problem), problem.band_hz))
    residual, still = estimation.residual({}), float(estimation.measured @ estimation.measured)
    if float(residual @ residual) <= still:
        return problem
    retuned = fit(estimation, problem.parameters, np.zeros(len(problem.parameters)), iterations=12)
    return balance if retuned.cost > still else problem


def gap_of(problem: Problem) -> Discrepancy:
    """Compare a problem's observations with its simulation by the machine file."""
    simulated = problem.simulate({})
    floor = noise_floor(problem, simulated)
    residual = locate_residual(whitener(problem.observations, floor, problem.band_hz), floor, simulated)
    places = {place: problem.place_name(place) for place in residual.positions}
    return Discrepancy(residual, floor, tuple(_notes(problem.repeats)), places, problem.forces)


def _notes(repeats: Sequence[Repeats]) -> list[str]:
    late = [
        f"{each.late()}; they were moved onto each other before they were compared." for each in repeats if each.apart
    ]
    return [*late, *(each.trouble() for each in repeats if each.differ)]
