"""Print times in comments and M73: total, first layer, elapsed, left."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from math import floor
from typing import NamedTuple


class Tells(Enum):
    """Which time a line states."""

    TOTAL = "of the whole print"
    FIRST_LAYER = "of the first layer"
    ELAPSED = "from the beginning to this line"
    LEFT = "from this line to the end (M73)"


class Timed(bytes):
    """A line, and the print time when it is reached."""

    at_s: float

    @classmethod
    def at(cls, line: bytes, at_s: float) -> Timed:
        """Attach a time to a line."""
        timed = cls(line)
        timed.at_s = at_s
        return timed


@dataclass(frozen=True, slots=True)
class Durations:
    """Durations of a print, known once it is planned to the end."""

    total_s: float
    first_layer_s: float | None = None  # None: no comment marks its end
    sliced_s: float | None = None  # the slicer's own, if it includes times that no plan has; else None


_SHORT_UNITS = {"d": 86400, "h": 3600, "m": 60, "s": 1}
_PART = re.compile(rb"([\d.]+)\s*([dhms])")


def _seconds(text: bytes, bare_s: float) -> float:
    """`1h 2m 3s`, `1 hour 2 minutes` or a bare number, s. The last one if there are several."""
    last = text.rpartition(b":")[2]
    parts = _PART.findall(last)
    return sum(float(n) * _SHORT_UNITS[unit.decode()] for n, unit in parts) if parts else bare_s * float(last)


def _counts(seconds: float, units: tuple[int, ...]) -> list[int]:
    """How many of each unit, largest first."""
    left, counts = max(floor(seconds / units[-1] + 0.5), 0) * units[-1], []
    for unit_s in units:
        counts.append(left // unit_s)
        left %= unit_s
    return counts


def short(seconds: float) -> str:
    """`1d 0h 2m 3s`, from the largest unit that is not zero."""
    named = [f"{n}{unit}" for n, unit in zip(_counts(seconds, (86400, 3600, 60, 1)), "dhms", strict=True)]
    first = next((k for k, text in enumerate(named[:-1]) if not text.startswith("0")), len(named) - 1)
    return " ".join(named[first:])


def _words(seconds: float) -> str:
    """Write hours, minutes and their plural: readers expect exactly this."""
    hours, minutes = _counts(seconds, (3600, 60))
    return f"{hours} hour{'s' * (hours != 1)} {minutes} minutes"


def _whole(seconds: float) -> str:
    return str(floor(seconds + 0.5))


_TOTAL = "; total estimated time: "


class _Form(NamedTuple):
    """One slicer's way to write a time: group 1 of the pattern, the time, group 3."""

    pattern: re.Pattern[bytes]
    tells: Tells
    spell: Callable[[float], str]
    bare_s: float  # unit of a bare number


def _form(
    begins: bytes, time: bytes, spell: Callable[[float], str],
    tells: Tells = Tells.TOTAL, rest: bytes = rb"\s*", bare_s: float = 1.0,
) -> _Form:  # fmt: skip
    return _Form(re.compile(b"(" + begins + b")(" + time + b")(" + rest + b")", re.DOTALL), tells, spell, bare_s)


_DURATION = rb"(?=\d)(?:\d+d ?)?(?:\d+h ?)?(?:\d+m ?)?(?:[\d.]+s)?"
_MODE, _DECIMAL = rb"(?: \([^)]*\))? = ", rb"\d+(?:\.\d+)?"
_KISS = rb"; (?:Estimated|Calculated-during-export) Build Time: +"
_FORMS = (
    _form(rb"; estimated printing time" + _MODE, _DURATION, short),  # PrusaSlicer, OrcaSlicer, Slic3r
    _form(rb"; estimated first layer printing time" + _MODE, _DURATION, short, Tells.FIRST_LAYER),
    # BambuStudio, OrcaSlicer
    _form(rb"; model printing time: ", _DURATION + _TOTAL.encode() + _DURATION, lambda s: short(s) + _TOTAL + short(s)),
    _form(_TOTAL.encode(), _DURATION, short),
    _form(rb";TIME:", _DECIMAL, _whole),  # Cura
    _form(rb";TIME_ELAPSED:", _DECIMAL, "{:.6f}".format, Tells.ELAPSED),
    _form(rb";PRINT\.TIME:", rb"\d+", _whole),  # Cura for UltiMaker
    _form(rb";Print Time: ", rb"\d+", _whole),  # ideaMaker
    _form(rb";   Build [Tt]ime: ", rb"\d[\w ]*?", _words),  # Simplify3D 4 and 5
    _form(_KISS, _DECIMAL, lambda s: f"{s / 60:.2f}", rest=rb" minutes\s*", bare_s=60.0),  # KISSlicer
    _form(rb"; Simulated print time: ", rb"\d+", _whole),  # RepRapFirmware itself
    _form(rb"M73 ", rb"[^;*]*?\d[^;*]*?", str, Tells.LEFT, rb"\s*(?:;.*)?"),
)
_LIKELY = re.compile(rb"; (?:est|model p|total e|Est|Calc|Sim)|;TIME|;PRINT|;Print|;   Build|M73 ")


def _matched(line: bytes) -> tuple[_Form, re.Match[bytes]] | None:
    if _LIKELY.match(line):
        for form in _FORMS:
            if match := form.pattern.fullmatch(line):
                return form, match
    return None


def tells(line: bytes) -> Tells | None:
    """Return which time a line states; None for nearly all lines."""
    hit = _matched(line)
    return hit[0].tells if hit else None


def slicer_time_s(lines: Iterable[bytes]) -> float | None:
    """Return the slicer's print time, s; None if it states none."""
    for line in lines:
        if (hit := _matched(line)) and hit[0].tells is Tells.TOTAL:
            return _seconds(hit[1][2], hit[0].bare_s)
    return None


_FILAMENT_TIME = re.compile(
    rb"^; (?:machine_load_filament_time|machine_unload_filament_time|machine_tool_change_time|filament_load_time"
    rb"|filament_unload_time) = ([\d.]+)",
    re.MULTILINE,
)


def filament_change_s(head: bytes, tail: bytes) -> float:
    """Return the duration of a filament change from the slicer's settings in a file's ends, s; 0 if absent."""
    settings = tail if _FILAMENT_TIME.search(tail) else head
    return sum(float(seconds) for seconds in _FILAMENT_TIME.findall(settings))


def stated_time(line: bytes) -> bytes:
    """Return the text of the time in a line that has one."""
    hit = _matched(line)
    return hit[1][2] if hit else b""


def with_time(line: bytes, time: bytes) -> bytes:
    """Return the line with another time; a line without one is returned unchanged."""
    hit = _matched(line)
    return hit[1][1] + time + hit[1][3] if hit else line


def with_waiting_s(line: bytes) -> float | None:
    """Return the slicer's print time, s, if it includes homing, heating and probing; else None."""
    return slicer_time_s([line]) if _TOTAL.encode() in stated_time(line) else None


def retold(line: Timed, durations: Durations) -> bytes:
    """Return the line with the planned time; unknown times stay.

    Where the slicer's time includes more than any plan (heating, probing), only the difference of the plans is added.
    """
    hit = _matched(line)
    if hit is None:
        return line
    form, match = hit
    if durations.sliced_s is not None and form.tells in (Tells.TOTAL, Tells.LEFT):
        return with_time(line, _longer(form, match[2], line.at_s, durations.total_s, durations.sliced_s))
    if form.tells is Tells.LEFT:
        return with_time(line, _progress(match[2], line.at_s, durations.total_s))
    total_s, first_layer_s = durations.total_s, durations.first_layer_s
    seconds = {Tells.TOTAL: total_s, Tells.FIRST_LAYER: first_layer_s, Tells.ELAPSED: line.at_s}[form.tells]
    return line if seconds is None else with_time(line, form.spell(seconds).encode())


def _longer(form: _Form, words: bytes, at_s: float, total_s: float, sliced_s: float) -> bytes:
    """Return a slicer's time plus the extra time of the compensated print, in total or from M73 on.

    The time left is at least that of the plan.
    """
    if form.tells is Tells.TOTAL:
        return _TOTAL.encode().join(
            form.spell(_seconds(each, form.bare_s) + total_s - sliced_s).partition(_TOTAL)[0].encode()
            for each in words.split(_TOTAL.encode())
        )
    left_s = max(total_s - at_s, 0.0)
    longer_s = left_s * (1.0 - sliced_s / total_s)

    def retell(word: re.Match[bytes]) -> bytes:
        return word[1] + b"%d" % floor(max(60.0 * float(word[2]) + longer_s, left_s) / 60.0 + 0.5)

    return re.sub(rb"([RS])(\d+(?:\.\d*)?)", retell, words)


def _progress(words: bytes, at_s: float, total_s: float) -> bytes:
    """M73's P and R, percent done and minutes left, and Q and S, the same for a silent mode. All are integers.

    A slicer's own 100 % stays: only its end script may follow.
    """
    done = 100 * at_s / total_s if total_s > 0 else 100.0
    percent = min(floor(done + 1e-6), 100)
    minutes = floor(max(total_s - at_s, 0.0) / 60 + 0.5)
    values = {b"P": percent, b"Q": percent, b"R": minutes, b"S": minutes}

    def retell(word: re.Match[bytes]) -> bytes:
        full = word[1] in b"PQ" and float(word[2]) >= 100
        return word[1] + b"%d" % (100 if full else values[word[1]])

    return re.sub(rb"([PQRS])(\d+(?:\.\d*)?)", retell, words)
