"""Build the table of methods: its columns, the best value of each, and what is beyond the limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ffcomp.compare.result import Comparison, EqualQuality, Family, Method
from ffcomp.report.compare.words import duration, extrudes, um

FAMILY_WORDS: dict[Family, str] = {
    "none": "as the firmware would print it",
    "calibrated": "input shapers as the firmware's own resonance test sets them",
    "best fixed": "input shapers at the best frequencies for this print, the printer known",
    "scheduled": "input shapers whose frequency follows the position: no firmware has them",
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
    explanation: str
    value: Value
    text: Callable[[Method, float], str] = _um
    best: Callable[[list[float]], float] | None = min  # None: no value is better than another
    limited: bool = False  # shown in red if the method breaks the carriages' limits


@dataclass(frozen=True, slots=True)
class Cell:
    """One value of the table."""

    text: str
    key: str  # to sort by; empty: nothing there
    best: bool = False
    beyond: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One method of the table."""

    method: Method
    cells: list[Cell]


def columns(found: Comparison) -> list[Column]:
    """Return the columns that the comparison has values for."""
    every = [*(_extruding() if extrudes(found) else []), *_all_moves(), *_effort()]
    if any(method.spread is not None for method in found.methods.values()):
        every += _mismatch()
    if any(method.equal_quality is not None for method in found.methods.values()):
        every += _equal_quality(found.quality_bound_um)
    return every


def _extruding() -> list[Column]:
    group = "contour error where plastic flows, µm"
    return [
        Column(group, "rms", "root mean square", lambda m: m.extruding.contour_rms_um),
        Column(group, "99 %", "99 % of the time it is less", lambda m: m.extruding.contour_p99_um),
        Column(group, "max", "the largest", lambda m: m.extruding.contour_max_um),
    ]


def _all_moves() -> list[Column]:
    contour, tracking = "contour error, all moves, µm", "tracking error, all moves, µm rms"
    no_delay = "with the constant delay taken out that explains most of it"
    return [
        Column(contour, "rms", "root mean square", lambda m: m.track.contour_rms_um),
        Column(contour, "99 %", "99 % of the time it is less", lambda m: m.track.contour_p99_um),
        Column(contour, "max", "the largest", lambda m: m.track.contour_max_um),
        Column(tracking, "raw", "distance to where the nozzle should be then", lambda m: m.track.tracking_rms_um),
        Column(tracking, "no delay", no_delay, lambda m: m.track.tracking_rms_no_delay_um),
        Column(tracking, "delay, ms", "that constant delay", lambda m: 1e3 * m.track.delay_s, _delay, None),
        Column(
            "residual ringing", "µm rms", "residual ringing in steady motion and at rest", lambda m: m.residual_rms_um
        ),
    ]


def _delay(method: Method, value: float) -> str:
    return f"{value:.2f}".replace("-0.00", "0.00")


def _effort() -> list[Column]:
    speed = partial(Column, "fastest carriage", best=None, limited=True)
    return [
        speed("mm/s", "largest commanded speed", _velocity, lambda m, v: f"{v:.0f}"),
        speed("m/s²", "largest commanded acceleration", _peak, lambda m, v: f"{v:.1f}"),
    ]


def _velocity(method: Method) -> float:
    return method.peaks.velocity_mm_per_s


def _peak(method: Method) -> float:
    return method.peaks.acceleration_mm_per_s2 / 1e3


def _mismatch() -> list[Column]:
    group = "on Monte-Carlo plants, µm rms"
    again = "median, the shaper tuned again on every Monte-Carlo plant"
    return [
        Column(
            group, "median", "over the Monte-Carlo plants", lambda m: None if m.spread is None else m.spread.median_um
        ),
        Column(group, "worst", "of the Monte-Carlo plants", lambda m: None if m.spread is None else m.spread.worst_um),
        Column(group, "tuned again", again, lambda m: None if m.retuned is None else m.retuned.median_um, best=None),
    ]


def _equal_quality(bound_um: float) -> list[Column]:
    speed = partial(Column, f"for 99 % below {bound_um:g} µm")
    highest = _reached(lambda quality: quality.acceleration_mm_per_s2 / 1e3)
    time = _reached(lambda quality: quality.print_time_s)
    return [
        speed("m/s²", "highest acceleration of the print", highest, _acceleration, max),
        speed("print time", "of the whole print at that acceleration", time, lambda m, v: duration(v)),
    ]


def _reached(of: Callable[[EqualQuality], float]) -> Value:
    """Return a figure of merit, None where the bound is missed even at the lowest acceleration."""

    def value(method: Method) -> float | None:
        quality = method.equal_quality
        return of(quality) if quality is not None and quality.reached else None

    return value


def _acceleration(method: Method, value: float) -> str:
    capped = method.equal_quality is not None and method.equal_quality.capped
    return f"{'≥ ' if capped else ''}{value:.2f}"


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
    return Cell(column.text(method, value), f"{value:.9g}", value == best and method.peaks.within_limits, beyond)
