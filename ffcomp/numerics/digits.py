"""Numbers for people: the same digits wherever a number is stated."""

from __future__ import annotations

import math


def um(value: float) -> str:
    """Format an error with three digits at most: 0.31, 4.82, 62.3, 416."""
    if math.isnan(value):
        return "–"
    digits = 2 if value < 9.995 else 1 if value < 99.95 else 0
    return f"{value:.{digits}f}"
