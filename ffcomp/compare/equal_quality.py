"""The highest acceleration at which a method's contour error stays below a bound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffcomp.compare.evaluation import Execution, contour, weights
from ffcomp.compare.methods import TunedMethod
from ffcomp.compare.result import EqualQuality
from ffcomp.compare.sampling import Print, PrintSlice, accelerated
from ffcomp.metrics import contour_statistics
from ffcomp.simulate.playback import simulate_nozzles
from models.machine import Machine

LOWEST, HIGHEST = 250.0, 40_000.0  # mm/s²
HALVINGS = 8  # of the ratio between them: 2 % at the end


def equal_quality(
    method: TunedMethod, printed: Print, plant: Machine, slices: Sequence[PrintSlice], bound_um: float
) -> EqualQuality:
    """Find the highest acceleration by bisection in its logarithm. A command beyond the carriages' limits is too fast.

    Parameters
    ----------
    method : TunedMethod
    printed : Print
        Gives the print time at that acceleration.
    plant : Machine
    slices : sequence of PrintSlice
        Evaluated at every acceleration; half a minute of print is enough.
    bound_um : float
        Of the contour error's 99th percentile.
    """

    def p99_at(acceleration: float) -> float:
        return p99_um(method, [each.with_acceleration(acceleration) for each in slices], plant)

    def result(acceleration: float, p99: float, **about: bool) -> EqualQuality:
        plan = accelerated(printed.planned, printed.machine, acceleration)
        return EqualQuality(acceleration, plan.trajectory.end_t, p99, **about)

    if (p99 := p99_at(HIGHEST)) <= bound_um:
        return result(HIGHEST, p99, capped=True)
    if (p99 := p99_at(LOWEST)) > bound_um:
        return result(LOWEST, p99, capped=False, reached=False)
    low, high, best = np.log(LOWEST), np.log(HIGHEST), p99
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        p99 = p99_at(float(np.exp(middle)))
        low, high, best = (middle, high, p99) if p99 <= bound_um else (low, middle, best)
    return result(float(np.exp(low)), best, capped=False)


def p99_um(method: TunedMethod, slices: Sequence[PrintSlice], plant: Machine) -> float:
    """Return the 99th percentile; infinite if the command breaks a carriage's limit."""
    found = []
    for print_slice in slices:
        motion, _ = method.motion(print_slice)
        if not within_limits(*motion.peaks(print_slice.machine), print_slice.machine):
            return float("inf")
        t, (nozzle,) = simulate_nozzles([plant], motion, print_slice.machine)
        found.append(Execution(print_slice, motion, t, nozzle))
    return contour_statistics(contour(found), weights(found)).p99_um


def within_limits(velocity: float, acceleration: float, machine: Machine) -> bool:
    """Tell whether the machine file allows its carriages such a command; a thousandth over is rounding."""
    own = machine.limits
    return (
        velocity <= 1.001 * own.carriage_velocity_mm_per_s
        and acceleration <= 1.001 * own.carriage_acceleration_mm_per_s2
    )
