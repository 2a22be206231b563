"""Values with standard uncertainties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NINETY_PERCENT = 1.6449  # standard deviations to each side


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
