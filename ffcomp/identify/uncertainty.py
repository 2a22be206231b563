"""Numbers with standard uncertainties, and how uncertainty travels through a formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.numerics.least_squares import central_differences
from models.arrays import FloatArray

NINETY_PERCENT = 1.6449  # standard deviations to each side


@dataclass(frozen=True)
class Estimate:
    """A value, its standard uncertainty, and the 90 % interval."""

    value: float
    sd: float
    low: float
    high: float

    @property
    def relative_sd(self) -> float:
        return self.sd / abs(self.value) if self.value else np.inf


def normal(value: float, sd: float) -> Estimate:
    return Estimate(value, sd, value - NINETY_PERCENT * sd, value + NINETY_PERCENT * sd)


def lognormal(value: float, log_sd: float) -> Estimate:
    """For what cannot be negative; `log_sd` is the relative standard uncertainty."""
    factor = float(np.exp(min(NINETY_PERCENT * log_sd, 50.0)))
    return Estimate(value, value * log_sd, value / factor, value * factor)


@dataclass(frozen=True, eq=False)
class Joint:
    """Several numbers and their covariance, by name."""

    names: tuple[str, ...]
    values: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    def estimates(self) -> dict[str, Estimate]:
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {name: normal(float(v), float(s)) for name, v, s in zip(self.names, self.values, sd, strict=True)}


def joined(*parts: Joint) -> Joint:
    """Independent results side by side."""
    names = tuple(name for part in parts for name in part.names)
    covariance = np.zeros((len(names), len(names)))
    at = 0
    for part in parts:
        end = at + len(part.names)
        covariance[at:end, at:end] = part.covariance
        at = end
    return Joint(names, np.concatenate([part.values for part in parts]), covariance)


def measured(numbers: Mapping[str, tuple[float, float]]) -> Joint:
    """Numbers measured each by itself: name -> (value, standard uncertainty)."""
    values = np.array([value for value, _ in numbers.values()], dtype=float)
    return Joint(tuple(numbers), values, np.diag([float(sd) ** 2 for _, sd in numbers.values()]))


def through(function: Callable[[FloatArray], FloatArray], names: Sequence[str], inputs: Joint) -> Joint:
    """A formula's results with covariance, to first order (GUM, JCGM 100:2008, 5.2), by central differences."""
    centre = np.asarray(function(inputs.values), dtype=float)
    steps = 1e-2 * np.sqrt(np.maximum(np.diag(inputs.covariance), 0.0))
    slope = central_differences(function, inputs.values, steps)
    return Joint(tuple(names), centre, slope @ inputs.covariance @ slope.T)
