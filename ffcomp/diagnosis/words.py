"""Numbers and lists as people read them."""

from __future__ import annotations

import math
from collections.abc import Sequence


def digits(value: float, places: int = 3) -> str:
    """Significant ones: 0.0801, 4.5, 63, 4010."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    return f"{value:.{max(places - 1 - math.floor(math.log10(abs(value))), 0)}f}"


def percent(share: float) -> str:
    """`3.4 %`, `87 %`."""
    return f"{100 * share:.0f} %" if abs(share) >= 0.0995 else f"{digits(100 * share, 2)} %"


def most_of(share: float) -> str:
    """Format a share of a gap, so that rounding does not make 99.96 % everything."""
    if share >= 0.9995:
        return "more than 99.9 %"
    return f"{100 * share:.1f} %" if share > 0.985 else percent(share)


def joined(parts: Sequence[str], last: str = "and") -> str:
    """Join names: `a`, `a and b`, `a, b and c`."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {last} {parts[-1]}"
