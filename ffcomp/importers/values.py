"""Values of a configuration: entries of the machine file, each with its origin; and how configurations are read.

RepRapFirmware's `config.g` and Marlin's answer to M503 are G-code commands.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import add
from pathlib import Path
from typing import Literal

from ffcomp.errors import FfcompError
from models.machine import START

How = Literal["read", "default", "converted", "assumed"]
ORDER: tuple[How, ...] = ("default", "read", "converted", "assumed")  # of several sources the last counts
AXES = "xyz"


class PrinterConfigError(FfcompError, ValueError):
    """A configuration that cannot be read: the file, the line where there is one, and the rule."""

    exit_code = 5


def unsupported(place: str, name: str) -> PrinterConfigError:
    """Return the error of kinematics that ffcomp does not have, with the reason and the remedy."""
    return PrinterConfigError(
        f"{place}: {name}: ffcomp has delta, cartesian and corexy machines. Others couple the motors in ways that "
        "their limits and steps would need: keep the firmware's input shaper."
    )


@dataclass(frozen=True)
class Value:
    """One value of the machine file."""

    value: float | str | list[float] | list[str]  # as the key says
    how: How  # text: read, converted, default or assumed
    origin: str  # a place in the configuration, or the rule

    @property
    def numbers(self) -> list[float]:
        """The value, of one number or several."""
        return [float(each) for each in (self.value if isinstance(self.value, list) else [self.value])]

    @property
    def number(self) -> float:
        """The value, of one number."""
        assert not isinstance(self.value, list | str), "it is no number"
        return self.value


@dataclass(frozen=True)
class ConfigValues:
    """All values of a configuration that a machine file can hold."""

    firmware: str
    kinematics: str  # delta, cartesian, corexy
    kinematics_origin: str
    values: Mapping[str, Value]  # "table.key" -> value; a key that is not here is not known
    notes: tuple[str, ...] = ()  # settings that a machine file cannot hold, and parts that were not read
    shaper_hz: tuple[float, ...] = ()  # of a delta: the input shaper's frequencies, where it is on


def converted(value: float | list[float], rule: str, *sources: Value) -> Value:
    """Make a value of others by a rule."""
    exact = value if isinstance(value, list) else float(f"{value:.9g}")
    return Value(exact, "converted", f"{_origins(sources)}: {rule}")


def changed(value: Value | None, change: Callable[[float], float], rule: str) -> Value | None:
    """Convert a value, if there is one."""
    return None if value is None else converted(change(value.number), rule, value)


def whole(value: Value | None) -> Value | None:
    """Take a value as a whole number."""
    return None if value is None else replace(value, value=int(value.number))


def listed(values: Sequence[Value]) -> Value:
    """Join single values in one list."""
    return _combined([each.number for each in values], values)


def all_listed(values: Sequence[Value | None], factor: float = 1.0, rule: str = "") -> Value | None:
    """Join single values in one list, times a factor; None unless all are known.

    rule : what the factor converts
    """
    known_values = [each for each in values if each is not None]
    if len(known_values) < len(values):
        return None
    joined = listed(known_values)
    return converted([each.number * factor for each in known_values], rule, joined) if rule else joined


def together(values: Sequence[Value | None]) -> Value | None:
    """Join values: one number if all are the same, a list otherwise; None unless all are known."""
    known_values = [each for each in values if each is not None]
    if len(known_values) < len(values):
        return None
    numbers = [each.number for each in known_values]
    if len(set(numbers)) > 1:
        return _combined(numbers, known_values)
    others = " (the others alike)" if len({each.origin for each in known_values}) > 1 else ""
    return replace(known_values[0], origin=known_values[0].origin + others)


def least(values: Sequence[Value | None]) -> Value | None:
    """Return the smallest of the known values; its origin names all of them."""
    known_values = [each for each in values if each is not None]
    return _combined(min(each.number for each in known_values), known_values) if known_values else None


def full_steps(steps: Value | None, microsteps: Value | None) -> Value | None:
    """Convert microsteps per mm to full steps per mm."""
    if steps is None or microsteps is None:
        return None
    return converted(steps.number / microsteps.number, f"{microsteps.number:g} microsteps each", steps, microsteps)


def known(values: Mapping[str, Value | None]) -> dict[str, Value]:
    """Drop the keys without a value."""
    return {key: value for key, value in values.items() if value is not None}


SHAPER = "firmware.input_shaper"


def own_shaper(commands: Sequence[str], sources: Sequence[Value], unread: bool, rule: str) -> dict[str, Value]:
    """Return the commands that switch the firmware's shaper on; nothing where a part that was not read may hold them.

    rule : where there are none, why
    """
    if not commands and unread:
        return {}
    return {SHAPER: Value(list(commands), "read" if commands else "default", _origins(sources) or rule)}


def shaped_axis(axis: str, frequency: Value, damping: Value) -> dict[str, Value]:
    """Take a shaper's values for an axis: its frequency lies where it cancels best, near the resonance."""
    start = f"the shaper's frequency {START}, not a measured resonance"
    if damping.how == "default":
        damping = replace(damping, origin=f"{damping.origin}, {START}")
    return {
        f"axes.{axis}.frequency_hz": converted([frequency.number], start, frequency),
        f"axes.{axis}.damping_ratio": listed([damping]),
    }


def plain_number(text: str, place: str, *, above: float = -math.inf) -> float:
    """Parse the number in a text; `place` names its position in the file and its meaning.

    Raises PrinterConfigError for anything that is not a plain finite number, or not above the bound.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise PrinterConfigError(f"{place} = {text!r} must be a plain number, without a unit or a formula.")
    if value <= above:
        raise PrinterConfigError(f"{place} = {text!r} must be above {above:g}.")
    return value


def _combined(value: float | list[float], sources: Iterable[Value]) -> Value:
    sources = list(sources)
    return Value(value, max((each.how for each in sources), key=ORDER.index), _origins(sources))


def _origins(sources: Iterable[Value]) -> str:
    return "; ".join(dict.fromkeys(each.origin for each in sources))


LARGEST_BYTES = 16_000_000  # a configuration has some kilobytes, a day's terminal log some megabytes


def decoded(path: Path) -> str:
    r"""Read a file's text, with lines ending in \n; PrinterConfigError if it holds none, or far too much of it."""
    if path.stat().st_size > LARGEST_BYTES:
        raise PrinterConfigError(f"{path}: a printer configuration has at most {LARGEST_BYTES // 10**6} MB.")
    data = path.read_bytes()
    if b"\0" in data:
        place = data.index(b"\0")
        raise PrinterConfigError(f"{path}: byte {place} is zero; a printer configuration is a text file.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # only comments and names hold such letters
    return text.replace("\r\n", "\n").replace("\r", "\n")


TOWER_ANGLES_DEG = (210.0, 330.0, 90.0)
STEEPEST_ARM = 12.0  # carriage speed per nozzle speed beyond which Klipper allows no move


def arm_lengths(arms: Sequence[Value | None]) -> dict[str, Value | None]:
    """Return `arm_length_mm`, or `arm_lengths_mm` where the towers' arms differ."""
    value = together(arms)
    many = value is not None and isinstance(value.value, list)
    return {"kinematics.arm_lengths_mm" if many else "kinematics.arm_length_mm": value}


def tower_angles(trims: Sequence[Value | None]) -> Value:
    """Convert trims of the towers' angles to angles."""
    angles = [
        changed(trim, partial(add, angle), f"added to {angle:g} degrees")
        or Value(angle, "default", "M665 gives no angles: the firmware's towers")
        for trim, angle in zip(trims, TOWER_ANGLES_DEG, strict=True)
    ]
    return listed(angles)


def farthest_reach(arm_mm: float, radius_mm: float) -> float:
    """Return the reach of the steepest arm: 12 L / √(12² + 1) − radius, 0.3 % of its length short of lying flat."""
    return arm_mm * STEEPEST_ARM / math.hypot(STEEPEST_ARM, 1.0) - radius_mm


def print_radius(stated: Value | None, radius: Value | None, arm: Value | None) -> Value | None:
    """Limit the configured print radius to the reach of the shortest arm."""
    if stated is None or radius is None or arm is None:
        return stated
    reach = farthest_reach(arm.number, radius.number)
    if stated.number <= reach:
        return stated
    return converted(round(reach, 3), f"{stated.number:g} mm is more than such arms can do", stated)


UNCOMMENTED = re.compile(r'(?:[^";]|"[^"]*"?)*')
# A terminal may have put its own words before the command: a time, `Recv:`, `echo:`.
COMMAND = re.compile(r'(?:[^"]*?[:>\]]\s*)??(?P<code>[GM]\d+(?:\.\d+)?)(?![\d.:])(?P<words>.*)')
WORD = re.compile(r'(?P<letter>[A-Za-z])(?:"(?P<quoted>[^"]*)"|(?P<formula>\{[^}]*\})|(?P<plain>[-+.:\d]*))', re.ASCII)
CONDITION = re.compile(r"\s*(?:if|elif|else|while)\b")


@dataclass(frozen=True)
class Command:
    """One command of a configuration."""

    code: str  # "M92"
    words: Mapping[str, str]  # letter -> the text after it; a formula keeps its braces
    place: str  # file:line
    conditional: bool  # stands under RepRapFirmware's `if` or `while`

    def numbers(self, letter: str, *, above: float = -math.inf) -> list[Value]:
        """Parse the numbers after a letter, with colons between them; none if it is missing or has a formula."""
        text = self.words.get(letter, "")
        if not text or text.startswith("{"):
            return []
        place = f"{self.place}: {self.code} {letter}"
        origin = f"{self.place} {self.code} {letter}"
        return [Value(plain_number(part, place, above=above), "read", origin) for part in text.split(":")]

    def number(self, letter: str, *, above: float = -math.inf) -> Value | None:
        """Parse the first of the numbers after a letter."""
        return next(iter(self.numbers(letter, above=above)), None)


def commands(text: str, name: str) -> Iterator[Command]:
    """Yield the commands of a text; other lines are skipped."""
    block: int | None = None  # how far the condition that is open is indented
    for line_number, line in enumerate(text.split("\n"), 1):
        uncommented = UNCOMMENTED.match(line)
        code = uncommented[0].rstrip() if uncommented else ""
        if not code:
            continue
        indent = len(code) - len(code.lstrip())
        if block is None or indent <= block:
            block = indent if CONDITION.match(code) else None
        if match := COMMAND.match(code.strip()):
            words = {word["letter"].upper(): _text(word) for word in WORD.finditer(match["words"])}
            yield Command(match["code"], words, f"{name}:{line_number}", block is not None)


def _text(word: re.Match[str]) -> str:
    return next(text for text in (word["quoted"], word["formula"], word["plain"]) if text is not None)
