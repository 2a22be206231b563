"""Build the table of methods: its columns, the best value of each, and what is beyond the limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from ffcomp.compare.result import Comparison, EqualQuality, Family, Method, Spread
from ffcomp.report.compare.words import duration, extrudes, thousands, um

FAMILY_WORDS: dict[Family, str] = {
    "none": "as the firmware would print it",
    "calibrated": "input shapers as the firmware's own resonance test sets them",
    "best fixed": "input shapers at the best frequencies for this print, the printer known",
    "scheduled": "input shapers whose frequency follows the place on the bed: no firmware has them",
    "inversion": "the motion computed backwards through a model of the printer",
}

Value = Callable[[Method], float | None]


def _um(method: Method, value: float) -> str:
    return um(value)


@dataclass(frozen=True, slots=True)
class Column:
    """One quantity of every method; None where a method has none."""

    group: str
    head: str
    short: str  # head and group in one, for narrow screens
    explanation: str
    value: Value
    text: Callable[[Method, float], str] = _um
    below: Callable[[float], str] | None = None  # the same in another unit
    best: Callable[[list[float]], float] | None = min  # None: no value is better than another
    minor: bool = False  # left out on narrow screens until it is asked for
    limited: bool = False  # shown in red if the method breaks the carriages' limits


@dataclass(frozen=True, slots=True)
class Cell:
    """One value of the table."""

    text: str
    key: str  # to sort by; empty: nothing there
    best: bool = False
    beyond: bool = False
    below: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """One method of the table."""

    method: Method
    cells: list[Cell]


def columns(found: Comparison) -> list[Column]:
    """Return the columns that the comparison has values for."""
    every = [*_extruding(), *map(_minor, _all_moves())] if extrudes(found) else _all_moves()
    if any(method.spread is not None for method in found.methods.values()):
        every += map(_minor, _mismatch())
    every += map(_minor, _effort())
    if any(method.equal_quality is not None for method in found.methods.values()):
        every = _equal_quality(found.quality_bound_um) + every  # what people look for first
    return every


def _minor(column: Column) -> Column:
    return replace(column, minor=True)


def _extruding() -> list[Column]:
    group = "contour error where plastic flows, µm"
    return [
        Column(group, "rms", "rms, plastic", "root mean square", lambda m: m.extruding.contour_rms_um),
        Column(group, "99 %", "99 %, plastic", "99 % of the time it is less", lambda m: m.extruding.contour_p99_um),
        Column(group, "max", "max, plastic", "the largest", lambda m: m.extruding.contour_max_um),
    ]


def _all_moves() -> list[Column]:
    contour, tracking = "contour error, all moves, µm", "tracking error, all moves, µm rms"
    no_delay = "with the constant delay taken out that explains most of it"
    return [
        Column(contour, "rms", "rms, all", "root mean square", lambda m: m.track.contour_rms_um),
        Column(contour, "99 %", "99 %, all", "99 % of the time it is less", lambda m: m.track.contour_p99_um),
        Column(contour, "max", "max, all", "the largest", lambda m: m.track.contour_max_um),
        Column(tracking, "raw", "tracking, raw", "distance to where the nozzle should be then", _tracking),
        Column(tracking, "no delay", "tracking, no delay", no_delay, lambda m: m.track.tracking_rms_no_delay_um),
        Column(tracking, "delay, ms", "delay, ms", "that constant delay", _delay_ms, _delay, best=None),
        Column("residual ringing", "µm rms", "ringing", "in steady motion and at rest", lambda m: m.residual_rms_um),
    ]


def _tracking(method: Method) -> float:
    return method.track.tracking_rms_um


def _delay_ms(method: Method) -> float:
    return 1e3 * method.track.delay_s


def _delay(method: Method, value: float) -> str:
    return f"{value:.2f}".replace("-0.00", "0.00")


def _effort() -> list[Column]:
    speed = partial(Column, "fastest carriage", best=None, limited=True)
    return [
        speed("mm/s", "carriage, mm/s", "largest commanded speed", _velocity, lambda m, v: f"{v:.0f}"),
        speed("mm/s²", "carriage, mm/s²", "largest commanded acceleration", _peak, _thousands, _metres),
    ]


def _velocity(method: Method) -> float:
    return method.peaks.velocity_mm_per_s


def _peak(method: Method) -> float:
    return method.peaks.acceleration_mm_per_s2


def _thousands(method: Method, value: float) -> str:
    return thousands(value)


def _metres(mm_per_s2: float) -> str:
    return f"{mm_per_s2 / 1e3:.3g} m/s²"


def _mismatch() -> list[Column]:
    group = "on Monte-Carlo plants, µm rms"
    again = "median, the shaper tuned again on every Monte-Carlo plant"
    return [
        Column(group, "median", "file off, median", "over the Monte-Carlo plants", _spread(lambda s: s.median_um)),
        Column(group, "worst", "file off, worst", "of the Monte-Carlo plants", _spread(lambda s: s.worst_um)),
        Column(group, "tuned again", "tuned again", again, _retuned, best=None),
    ]


def _spread(of: Callable[[Spread], float]) -> Value:
    return lambda method: None if method.spread is None else of(method.spread)


def _retuned(method: Method) -> float | None:
    return None if method.retuned is None else method.retuned.median_um


def _equal_quality(bound_um: float) -> list[Column]:
    speed = partial(Column, f"99 % below {bound_um:g} µm up to")
    highest = _reached(lambda quality: quality.acceleration_mm_per_s2)
    time = _reached(lambda quality: quality.print_time_s)
    return [
        speed("mm/s²", f"{bound_um:g} µm up to", "highest acceleration", highest, _acceleration, _metres, max),
        speed("print time", "print time", "of the whole print then", time, lambda m, v: duration(v)),
    ]


def _reached(of: Callable[[EqualQuality], float]) -> Value:
    """Return a figure of merit, None where the bound is missed even at the lowest acceleration."""

    def value(method: Method) -> float | None:
        quality = method.equal_quality
        return of(quality) if quality is not None and quality.reached else None

    return value


def _acceleration(method: Method, value: float) -> str:
    capped = method.equal_quality is not None and method.equal_quality.capped
    return f"{'≥ ' if capped else ''}{thousands(value)}"


def rows(found: Comparison) -> list[Row]:
    """Return the rows in the order of the comparison. Best are only methods that the carriages can follow."""
    table = columns(found)
    methods = list(found.methods.values())
    best = [_best(column, [method for method in methods if method.peaks.within_limits]) for column in table]
    return [Row(m, [_cell(column, m, top) for column, top in zip(table, best, strict=True)]) for m in methods]


def _best(column: Column, methods: list[Method]) -> float | None:
    found = [column.value(method) for method in methods]
    values = [value for value in found if value is not None and math.isfinite(value)]
    if column.best is None or len(set(values)) < 2:
        return None
    return column.best(values)


def _cell(column: Column, method: Method, best: float | None) -> Cell:
    value = column.value(method)
    beyond = column.limited and not method.peaks.within_limits
    if value is None or not math.isfinite(value):
        return Cell("–", "", beyond=beyond)
    below = "" if column.below is None else column.below(value)
    best_here = value == best and method.peaks.within_limits
    return Cell(column.text(method, value), f"{value:.9g}", best_here, beyond, below)
