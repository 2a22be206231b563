"""Fit the numbers of an axis by itself to its runs: the simulation's own error, from shot to shot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.errors import RequestError
from ffcomp.identification.axis_shots import Shots, scales_of, shots_of
from ffcomp.identification.machine_fit import MachineFit, estimates, hash_of
from ffcomp.identification.uncertainty import Estimate, Joint
from ffcomp.measurement.axis_run import AxisRun, read_axis_run
from ffcomp.numerics.least_squares import minimise
from ffcomp.numerics.stages import Stage
from models.arrays import FloatArray, IntArray
from models.file import updated_text
from models.kinds import driven_axis
from models.machine import Machine, value_of, with_values

MASS, OFFSET, OFFSET_SHARE = "axis.mass_kg", "axis.offset_n", 0.1
EVALUATIONS = 60
BLOCKS = 60  # of a run: what is left is alike within one, and independent of the others
FAR = 1e3  # times its signal is the error of an axis that moves to infinity
LOWEST, HIGHEST = 1e-3, 1e3  # times the file's value
WEAK = 0.1  # relative, from which a number is said to be weak


@dataclass(frozen=True, eq=False)
class AxisFitted:
    """The numbers of an axis with their uncertainties, and what is left of the signals."""

    estimates: Mapping[str, Estimate]
    before: float  # rms of the error over that of the signals' own motion
    after: float


@dataclass(frozen=True, eq=False, kw_only=True)
class OneAxisFit(MachineFit):
    """The numbers of an axis by itself."""

    method = "axis"

    result: AxisFitted
    kept: Sequence[str]  # numbers that no run can tell

    @property
    def details(self) -> dict[str, Any]:
        """What the method tells, for the JSON object."""
        return {
            "numbers": estimates(self.result.estimates),
            "nrms": {
                # number: axis: rms of the error over that of the signals' own motion, with the file as it is
                "before": self.result.before,
                "after": self.result.after,  # number: axis: the same as fitted
            },
            "kept": list(self.kept),
        }


def fit_axis(
    start: Machine,
    data: Sequence[Path],
    known: Mapping[str, tuple[float, float]],
    name: str,
    progress: Callable[[str], None] = lambda _: None,
) -> OneAxisFit:
    """Fit the axis' numbers to runs; its effects stay as the file has them.

    Raises
    ------
    MeasurementError, RequestError
    """
    runs = [read_axis_run(path, driven_axis(start).input) for path in data]
    progress(Stage(2, f"fitting {start.name} to {len(runs)} runs"))
    result = fitted_axis(start, runs, known)
    hashes = [hash_of(path) for path in data]
    weak = [key for key, e in result.estimates.items() if e.relative_sd > WEAK and key != OFFSET]
    kept = kept_of(start, known)
    return OneAxisFit(
        start=start,
        data=hashes,
        name=name,
        text=_text(start, result, name, hashes),
        advice=[
            *(f"{key} is known to ±{100 * result.estimates[key].relative_sd:.0f} % only." for key in weak),
            *(f"{key} stays as it was: where a position drives, only ratios show. Weigh it (--known)." for key in kept),
        ],
        result=result,
        kept=kept,
    )


def kept_of(start: Machine, known: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return what no run can tell: where a position drives, all numbers may grow alike."""
    return [] if driven_axis(start).by_force or known else [MASS]


def fitted_axis(start: Machine, runs: Sequence[AxisRun], known: Mapping[str, tuple[float, float]]) -> AxisFitted:
    """Fit by least squares; known numbers are measurements like any other."""
    shots = shots_of(start, runs)
    names = [*start.vibration.tunable, *([OFFSET] if driven_axis(start).by_force else [])]
    unknown = [key for key in known if key not in names]
    if unknown:
        raise RequestError(f"--known {unknown[0]}: this axis has {', '.join(names)}.")
    names = [n for n in names if n not in kept_of(start, known)]
    first = np.array([value_of(start, n) for n in names])
    scale = np.array(
        [OFFSET_SHARE * scales_of(start, shots).force_n if n == OFFSET else value_of(start, n) for n in names]
    )
    sizes = _sizes(shots)
    blocks = _blocks(shots)

    def error(x: FloatArray) -> FloatArray:
        values = dict(zip(names, (x * scale).tolist(), strict=True))
        simulated = np.concatenate([_error(one, with_values(start, values), sizes) for one in shots])
        beside = [(values[key] - value) / sd for key, (value, sd) in known.items()]
        return np.concatenate([simulated / noise, beside])

    noise = 1.0
    positive = np.array([n != OFFSET for n in names])
    bounds = np.where(positive, LOWEST, -np.inf), np.where(positive, HIGHEST, np.inf)
    solved = minimise(error, first / scale, evaluations=EVALUATIONS, bounds=bounds)
    noise = float(np.sqrt(np.mean(solved.residual[: len(blocks)] ** 2)))
    if known:  # weighed against what is left
        solved = minimise(error, solved.x, evaluations=EVALUATIONS, bounds=bounds)
    covariance = _covariance(solved.jacobian, solved.residual, blocks)
    joint = Joint(tuple(names), solved.x * scale, covariance * np.outer(scale, scale))
    before, after = (
        float(np.sqrt(np.nanmean((noise * error(x)[: len(blocks)]) ** 2))) for x in (first / scale, solved.x)
    )
    return AxisFitted(joint.estimates(), before, after)


def _sizes(shots: Sequence[Shots]) -> dict[str, float]:
    """Return the rms of each signal's own motion."""
    names = {name for one in shots for name in one.run.signals}
    squares = {n: [np.nanmean(one.forced_motion(n) ** 2) for one in shots if n in one.run.signals] for n in names}
    return {name: max(float(np.sqrt(np.mean(x))), 1e-12) for name, x in squares.items()}


def _error(one: Shots, machine: Machine, sizes: Mapping[str, float]) -> FloatArray:
    """Return measured − simulated of a run's signals, over their size: (rows,); gaps are zero."""
    try:
        simulated = one.simulate(machine).sensed(machine)
    except ValueError:
        return np.full(len(one.run.drive) * len(one.run.signals), FAR)
    return np.concatenate([np.nan_to_num(x - simulated[name]) / sizes[name] for name, x in one.run.signals.items()])


def _blocks(shots: Sequence[Shots]) -> IntArray:
    """Return the block of each row of the error, (rows,)."""
    blocks: list[IntArray] = []
    for k, one in enumerate(shots):
        n = len(one.run.drive)
        blocks += [BLOCKS * k + np.arange(n) * BLOCKS // n for _ in one.run.signals]
    return np.concatenate(blocks)


def _covariance(jacobian: FloatArray, residual: FloatArray, blocks: IntArray) -> FloatArray:
    """Return the sandwich covariance (Liang and Zeger, 1986): what is left is alike within a block."""
    count = int(blocks.max()) + 1
    scores = np.zeros((count, jacobian.shape[1]))
    np.add.at(scores, blocks, jacobian[: len(blocks)] * residual[: len(blocks), None])
    beside = jacobian[len(blocks) :]
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    middle = scores.T @ scores * count / max(count - jacobian.shape[1], 1) + beside.T @ beside
    return np.asarray(inverse @ middle @ inverse)


def _text(start: Machine, result: AxisFitted, name: str, hashes: Sequence[str]) -> str:
    """Return the new machine file's text."""
    if not start.path:
        return ""
    values = {key: float(f"{e.value:.6g}") for key, e in result.estimates.items()}
    sds = {key: float(f"{e.relative_sd:.3g}") for key, e in result.estimates.items() if key != OFFSET}
    entry = {"date": date.today().isoformat(), "started_from": Path(start.path).stem, "data": list(hashes)}
    return updated_text(
        Path(start.path), values, name=name, uncertainty=sds, provenance={"identified": entry | {"nrms": result.after}}
    )
