"""Numbers, units, names and lists as people read them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ffcomp.identification.uncertainty import Estimate
from models.effects.effect import Effect


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


def joined(parts: Sequence[str]) -> str:
    """Join names: `a`, `a and b`, `a, b and c`."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def times_noise(excess: float) -> float:
    """Return the error as a multiple of the noise, in rms."""
    return math.sqrt(max(1 + excess, 0.0))


def times(value: float) -> str:
    """Format a ratio: `6.4 times`, `57 times`."""
    return f"{digits(value, 2)} times" if value < 99.5 else f"{value:.0f} times"


def interval(e: Estimate) -> str:
    """`0.0801 (90 %: 0.0795 to 0.0807)`, with the digits that the width deserves."""
    width = max(e.high - e.low, 1e-4 * abs(e.value), 1e-12)
    places = max(1 - math.floor(math.log10(width)), 0)
    value, low, high = (f"{x:.{places}f}" for x in (e.value, e.low, e.high))
    return f"{value} (90 %: {low} to {high})"


def evidence(value: float) -> str:
    """−2 ln Z: whole numbers, in powers of ten where they are huge."""
    if abs(value) < 1e5:
        return f"{round(value)}"
    mantissa, _, power = f"{value:.1e}".partition("e")
    return f"{mantissa}·10{str(int(power)).translate(str.maketrans('0123456789', '⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


def title(effect: str, catalogue: Mapping[str, Effect]) -> str:
    """`more on the nozzle holder`: to stand inside a sentence."""
    words = catalogue[effect].title
    return words[0].lower() + words[1:]
