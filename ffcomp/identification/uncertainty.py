"""Values with standard uncertainties, and the numbers that fits move to find them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ffcomp.inference.problem import Unknown
from models.arrays import FloatArray

NINETY_PERCENT = 1.6449  # standard deviations to each side
FARTHEST = 30.0  # of a logarithm: e to the 30 times the start


@dataclass(frozen=True)
class Estimate:
    """A value, its standard uncertainty, and the 90 % interval."""

    value: float
    sd: float  # standard uncertainty
    low: float  # of the 90 % interval
    high: float

    def __str__(self) -> str:
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g})"

    @property
    def relative_sd(self) -> float:
        """Standard uncertainty over value."""
        return self.sd / abs(self.value) if self.value else np.inf

    def scaled(self, by: float) -> Estimate:
        """Return the estimate in another unit."""
        low, high = sorted((by * self.low, by * self.high))
        return Estimate(by * self.value, abs(by) * self.sd, low, high)


def normal(value: float, sd: float) -> Estimate:
    """Estimate with a normal distribution."""
    return Estimate(value, sd, value - NINETY_PERCENT * sd, value + NINETY_PERCENT * sd)


def lognormal(value: float, log_sd: float) -> Estimate:
    """Estimate a positive quantity; `log_sd` is the relative standard uncertainty."""
    factor = float(np.exp(min(NINETY_PERCENT * log_sd, 50.0)))
    return Estimate(value, value * log_sd, value / factor, value * factor)


@dataclass(frozen=True)
class Mode:
    """A mode as it was measured."""

    frequency_hz: Estimate
    damping_ratio: Estimate


@dataclass(frozen=True)
class Number:
    """A number x away from where it starts: a factor of e to the x; in `unit`, where it may change its sign."""

    name: str
    start: float
    sd: float = np.inf  # of the prior of x
    unit: float = 0.0  # 0: it keeps its sign

    def value(self, x: float) -> float:
        """Return the number at x."""
        return self.start + self.unit * x if self.unit else self.start * float(np.exp(np.clip(x, -FARTHEST, FARTHEST)))

    def at(self, value: float) -> float:
        """Return x of a value."""
        return (value - self.start) / self.unit if self.unit else float(np.log(value / self.start))

    def unknown(self, step: float, low: float = -np.inf, high: float = np.inf) -> Unknown:
        """Return x as a fit moves it."""
        return Unknown(self.name, 0.0, self.sd, low, high, step)

    def estimate(self, x: float, sd: float) -> Estimate:
        """Return the number with its interval, from the standard deviation of x."""
        value = self.value(x)
        return normal(value, self.unit * sd) if self.unit else lognormal(abs(value), sd).scaled(float(np.sign(value)))


def estimates(numbers: Iterable[Number], at: FloatArray, variance: FloatArray) -> dict[str, Estimate]:
    """Return numbers with their intervals, by what a fit has found: x and its variances, (p,) or more."""
    each = zip(numbers, at.tolist(), np.sqrt(variance).tolist(), strict=False)
    return {number.name: number.estimate(x, sd) for number, x, sd in each}
