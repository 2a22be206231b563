"""The least value of a function of one variable, by Brent's method.

R. P. Brent, Algorithms for Minimization without Derivatives, 1973, ch. 5. The numbers are those of
`scipy.optimize.minimize_scalar(method="bounded")`, whose import takes 0.1 s of every print.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

GOLDEN = 0.5 * (3.0 - sqrt(5.0))
RELATIVE_TOLERANCE = sqrt(2.2e-16)
MOST_CALLS = 500


def bounded_minimum(cost: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Find where a cost is least between two bounds.

    Parameters
    ----------
    tolerance : of the result, in addition to a relative one of 1.5e-8

    Raises
    ------
    RuntimeError
        If that takes more than MOST_CALLS calls.
    """
    best = second = third = low + GOLDEN * (high - low)
    of_best = of_second = of_third = cost(best)
    step = before = 0.0
    for _ in range(MOST_CALLS):
        middle, least = 0.5 * (low + high), RELATIVE_TOLERANCE * abs(best) + tolerance / 3.0
        if abs(best - middle) <= 2.0 * least - 0.5 * (high - low):
            return best
        parabolic = False
        if abs(before) > least:  # the parabola through the three best points
            r = (best - second) * (of_best - of_third)
            q = (best - third) * (of_best - of_second)
            p = (best - third) * q - (best - second) * r
            q = 2.0 * (q - r)
            p, q = -p if q > 0.0 else p, abs(q)
            parabolic = abs(p) < abs(0.5 * q * before) and q * (low - best) < p < q * (high - best)
            before = step
            if parabolic:
                step = p / q
                if best + step - low < 2.0 * least or high - (best + step) < 2.0 * least:
                    step = least if middle >= best else -least
        if not parabolic:
            before = low - best if best >= middle else high - best
            step = GOLDEN * before
        tried = best + (max(step, least) if step >= 0.0 else min(step, -least))
        of_tried = cost(tried)
        if of_tried <= of_best:
            low, high = (best, high) if tried >= best else (low, best)
            third, of_third = second, of_second
            second, of_second = best, of_best
            best, of_best = tried, of_tried
        else:
            low, high = (tried, high) if tried < best else (low, tried)
            if of_tried <= of_second or second == best:
                third, of_third = second, of_second
                second, of_second = tried, of_tried
            elif of_tried <= of_third or third in (best, second):
                third, of_third = tried, of_tried
    raise RuntimeError(f"The search for a least value near {best:g} has not ended.")
