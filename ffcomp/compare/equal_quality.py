"""The money question: how fast may it go? The highest acceleration at which a method's contour error stays small."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffcomp.compare.evaluation import Played, contour
from ffcomp.compare.methods import Way
from ffcomp.compare.result import EqualQuality
from ffcomp.compare.sampling import Print, Stretch, accelerated
from ffcomp.metrics import contour_statistics
from ffcomp.simulate.playback import simulate_nozzles
from models.machine import Machine

LOWEST, HIGHEST = 250.0, 40_000.0  # mm/s²
HALVINGS = 8  # of the ratio between them: 2 % at the end


def equal_quality(
    way: Way, printed: Print, plant: Machine, stretches: Sequence[Stretch], bound_um: float
) -> EqualQuality:
    """Bisection in the acceleration's logarithm. A command that breaks the carriages' limits is too fast.

    Parameters
    ----------
    stretches : judged at every acceleration; half a minute of print is enough
    bound_um : of the contour error's 99th percentile
    """

    def p99_um(acceleration: float) -> float:
        return _p99_um(way, [each.with_acceleration(acceleration) for each in stretches], plant)

    def answer(acceleration: float, p99: float, **about: bool) -> EqualQuality:
        plan = accelerated(printed.planned, printed.machine, acceleration, printed.offset)
        return EqualQuality(acceleration, plan.trajectory.end_t, p99, **about)

    if (p99 := p99_um(HIGHEST)) <= bound_um:
        return answer(HIGHEST, p99, capped=True)
    if (p99 := p99_um(LOWEST)) > bound_um:
        return answer(LOWEST, p99, capped=False, reached=False)
    low, high, best = np.log(LOWEST), np.log(HIGHEST), p99
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        p99 = p99_um(float(np.exp(middle)))
        low, high, best = (middle, high, p99) if p99 <= bound_um else (low, middle, best)
    return answer(float(np.exp(low)), best, capped=False)


def _p99_um(way: Way, stretches: Sequence[Stretch], plant: Machine) -> float:
    """Infinite if a carriage is asked for more than its limit."""
    found = []
    for stretch in stretches:
        motion, _ = way.motion(stretch)
        if not within_limits(*motion.peaks(stretch.machine), stretch.machine):
            return float("inf")
        t, (nozzle,) = simulate_nozzles([plant], motion, stretch.machine)
        found.append(Played(stretch, motion, t, nozzle))
    return contour_statistics(contour(found)).p99_um


def within_limits(velocity: float, acceleration: float, machine: Machine) -> bool:
    """Whether the machine file allows its carriages such a command; a thousandth over is rounding."""
    own = machine.limits
    return (
        velocity <= 1.001 * own.carriage_velocity_mm_per_s
        and acceleration <= 1.001 * own.carriage_acceleration_mm_per_s2
    )
