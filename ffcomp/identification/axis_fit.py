"""Fit the numbers of an axis by itself to its runs: the simulation's own error, from shot to shot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffcomp.errors import RequestError
from ffcomp.identification.axis_shots import Shots, scales_of, shots_of
from ffcomp.identification.machine_fit import MachineFit, Origin, hash_of, number_facts
from ffcomp.identification.uncertainty import Estimate, Number, estimates
from ffcomp.inference.fit import FitSettings, fit
from ffcomp.inference.problem import EstimationProblem, Observation
from ffcomp.measurement.axis_run import AxisRun, read_axis_run
from ffcomp.numerics.stages import Stage
from ffcomp.result import Fact
from models.arrays import FloatArray
from models.kinds import driven_axis
from models.machine import Machine, value_of, with_values

MASS, OFFSET, OFFSET_SHARE = "axis.mass_kg", "axis.offset_n", 0.1
FINAL = FitSettings(rounds=5)
BLOCKS = 60  # of a run: residuals are alike within a block, and independent between blocks
NOISE = 1e-6  # of a signal: less is not resolved
STEP, FARTHEST = 1e-6, (-7.0, 7.0)  # of differences; of the file's value, logarithms


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class OneAxisFit(MachineFit):
    """The numbers of an axis by itself."""

    method = "axis"
    json_keys = MachineFit.json_keys | {
        "numbers": "estimates",
        "kept": "kept",
        "nrms.before": "before",
        "nrms.after": "after",
    }

    estimates: Mapping[str, Estimate]
    before: float  # rms of the error over that of the signals' own motion
    after: float
    kept: Sequence[str]  # numbers that no run determines

    @property
    def headline(self) -> str:
        """How well the axis is simulated now, and was before."""
        after, before = 100 * self.after, 100 * self.before
        return f"The simulation's error is {after:.2g} % of the motion; with the starting file {before:.2g} %."

    @property
    def found(self) -> list[Fact]:
        """Every parameter."""
        return number_facts(self.estimates)

    @property
    def next_steps(self) -> list[str]:
        """Compare the file with the runs."""
        return [f"Look at it: ffcomp gap RUNS --machine {self.output}"] if self.output else []


def fit_axis(
    start: Machine,
    data: Sequence[Path],
    known: Mapping[str, tuple[float, float]],
    name: str,
    progress: Callable[[str], None] = lambda _: None,
) -> OneAxisFit:
    """Fit the axis' numbers to files of runs; its effects stay as the file has them."""
    runs = [read_axis_run(path, driven_axis(start).input) for path in data]
    progress(Stage(2, f"fitting {start.name} to {len(runs)} runs"))
    return fit_runs(start, runs, known, name, [hash_of(path) for path in data])


def fit_runs(
    start: Machine,
    runs: Sequence[AxisRun],
    known: Mapping[str, tuple[float, float]],
    name: str = "",
    hashes: Sequence[str] = (),
) -> OneAxisFit:
    """Fit by least squares; known numbers are measurements like any other.

    Where a position drives, all numbers may grow in proportion, so the mass is kept unless one of them is known.
    """
    shots = shots_of(start, runs)
    names = [*start.vibration.tunable, *([OFFSET] if driven_axis(start).by_force else [])]
    unknown = [key for key in known if key not in names]
    if unknown:
        raise RequestError(f"--known {unknown[0]}: this axis has {', '.join(names)}.")
    kept = [] if driven_axis(start).by_force or known else [MASS]
    problem = _Problem(start, shots, [n for n in names if n not in kept], known)
    first = np.zeros(len(problem.numbers))
    found = fit(problem, first, FINAL)
    fitted = estimates(problem.numbers, found.values, np.diag(found.covariance))
    before, after = (
        float(np.sqrt(np.mean(simulated[: -len(known) or None] ** 2)))
        for simulated in (problem.measured - each for each in problem.simulate([first, found.values]))
    )
    origin = Origin(start, name, hashes)
    return OneAxisFit(
        origin=origin,
        text=origin.text_of(fitted, "fit", nrms=after) if start.path else "",
        advice=[
            *found.doubt(start.name),
            *(f"{key} is unchanged: where a position drives, only ratios show. Weigh it (--known)." for key in kept),
        ],
        estimates=fitted,
        before=before,
        after=after,
        kept=kept,
    )


class _Problem(EstimationProblem):
    """Unknowns are the axis' numbers; measured are signals over the size of their motion."""

    def __init__(
        self, start: Machine, shots: Sequence[Shots], names: Sequence[str], known: Mapping[str, tuple[float, float]]
    ) -> None:
        self.start, self.shots, self.known = start, shots, known
        units = {OFFSET: OFFSET_SHARE * scales_of(start, shots).force_n}
        self.numbers = [Number(name, value_of(start, name), unit=units.get(name, 0.0)) for name in names]
        self.unknowns = [each.unknown(STEP, *((-np.inf, np.inf) if each.unit else FARTHEST)) for each in self.numbers]
        self.sizes = _sizes(shots)
        certain = [Observation(np.array([value]), np.array([sd**2])) for value, sd in known.values()]
        self.observations = [*(self._observed(one) for one in shots), *certain]

    def _observed(self, one: Shots) -> Observation:
        measured = np.concatenate([np.nan_to_num(x) / self.sizes[name] for name, x in one.run.signals.items()])
        n = len(one.run.drive)
        blocks = np.tile(np.arange(n) * BLOCKS // n, len(one.run.signals))
        return Observation(measured, np.full(len(measured), NOISE**2), np.ones(len(measured)), blocks)

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        """Simulate all runs, then the known numbers; gaps are zero."""
        for x in lanes:
            values = {each.name: each.value(float(at)) for each, at in zip(self.numbers, x, strict=True)}
            machine = with_values(self.start, values)
            yield np.concatenate([*(self._one(one, machine) for one in self.shots), [values[n] for n in self.known]])

    def _one(self, one: Shots, machine: Machine) -> FloatArray:
        try:
            simulated = one.simulate(machine).sensed(machine)
        except ValueError:  # it moves to infinity
            return np.full(len(one.run.drive) * len(one.run.signals), np.nan)
        signals = one.run.signals.items()
        return np.concatenate(
            [np.where(np.isfinite(x), simulated[name], 0.0) / self.sizes[name] for name, x in signals]
        )


def _sizes(shots: Sequence[Shots]) -> dict[str, float]:
    """Return the rms of each signal's own motion."""
    names = {name for one in shots for name in one.run.signals}
    squares = {n: [np.nanmean(one.forced_motion(n) ** 2) for one in shots if n in one.run.signals] for n in names}
    return {name: max(float(np.sqrt(np.mean(x))), 1e-12) for name, x in squares.items()}
