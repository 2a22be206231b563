"""Say all warnings of a compensation in a few lines for people: one for each cause, with what would avoid it.

Every single warning is in the log and in `--json`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from ffcomp.inverse.time_scaling import TimeScaling
from models.machine import Machine

MOST_LINES = 5

_NUMBER = re.compile(r"\d[\d.]*")
_MORE = "see --json, or the log (ffcomp --log-path)"


def warning_lines(
    warnings: Sequence[str], slowed: Sequence[TimeScaling], machine: Machine, original_s: float
) -> list[str]:
    """Return at most five lines.

    Parameters
    ----------
    warnings : sequence of str
        Sentences about anything but places that became slower.
    slowed : sequence of TimeScaling
        Places that became slower.
    machine : Machine
        Whose limits they are.
    original_s : float
        Time of the original print, s.
    """
    return shortened([*grouped(warnings), *_slowed(slowed, machine, original_s)])


def shortened(lines: Sequence[str], most: int = MOST_LINES) -> list[str]:
    """Return no more lines than a person reads."""
    if len(lines) <= most:
        return list(lines)
    kept = most - 1
    return [*lines[:kept], f"{len(lines) - kept} more kinds of warnings: {_MORE}."]


def grouped(warnings: Iterable[str]) -> list[str]:
    """Return the first of all warnings that differ in numbers only, and how many more there are."""
    first: dict[str, str] = {}
    count: Counter[str] = Counter()
    for warning in warnings:
        cause = cause_of(warning)
        first.setdefault(cause, warning)
        count[cause] += 1
    return [
        warning if count[cause] == 1 else f"{warning} {count[cause] - 1} more like this: {_MORE}."
        for cause, warning in first.items()
    ]


def cause_of(warning: str) -> str:
    """Return the warning without its numbers."""
    return _NUMBER.sub("#", warning)


def _slowed(slowed: Sequence[TimeScaling], machine: Machine, original_s: float) -> Iterator[str]:
    """Yield a line for each limit, the one that costs most first."""
    limits = {each.limit for each in slowed}
    found = [[each for each in slowed if each.limit == limit] for limit in limits]
    for own in sorted(found, key=lambda own: -sum(each.seconds for each in own)):
        lost_s = sum(each.seconds for each in own)
        places = "1 place" if len(own) == 1 else f"{len(own)} places"
        share = f" ({100 * lost_s / original_s:+.2g} %)" if original_s > 0 else ""
        yield f"Slowed at {places}, {_seconds(lost_s)} longer in all{share}: {_reason(own, machine)}"


def _seconds(value: float) -> str:
    return f"{value:.0f} s" if value >= 10 else f"{value:.2g} s"


def _reason(own: Sequence[TimeScaling], machine: Machine) -> str:
    limit = own[0].limit
    if not limit:
        return (
            "the firmware's own acceleration, where the nozzle lifts or filament is pulled back above all, leaves too "
            "little for the segments. Fewer z-hops and wipes avoid it, or more acceleration in firmware and machine "
            "file."
        )
    names = machine.kinematics.actuator_names
    count = Counter(names["ABC".index(each.carriage)] for each in own)
    who = ", ".join(f"{name} ({number}×)" if len(count) > 1 else name for name, number in count.most_common())
    asked = max(each.asked for each in own)
    return f"the {limit} limit of {who} was exceeded up to {asked:.2f} times. {_remedy(limit, machine)}"


def _remedy(limit: str, machine: Machine) -> str:
    own = machine.limits
    if limit == "travel":
        travel = own.carriage_travel_mm
        return f"carriage_travel_mm = {list(travel or ())} in [limits] of the machine file is what the carriages have."
    key, value = {
        "velocity": ("carriage_velocity_mm_per_s", own.carriage_velocity_mm_per_s),
        "acceleration": ("carriage_acceleration_mm_per_s2", own.carriage_acceleration_mm_per_s2),
    }[limit]
    rate = f", or step_rate_hz = {own.step_rate_hz:g}," if limit == "velocity" and own.step_rate_hz else ""
    slower = "speed" if limit == "velocity" else "acceleration"
    return (
        f"A lower {slower} in the slicer avoids it; or more than {key} = {value:g}{rate} in [limits] of the machine "
        "file, if the motors can do it."
    )
