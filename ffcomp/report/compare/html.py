"""The report of a comparison as one HTML page, with its table of methods."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path

from markupsafe import Markup

from ffcomp.comparison.result import Comparison, EqualQuality, Family, Method, Spread
from ffcomp.numerics.digits import um
from ffcomp.report.compare.charts import colour_of
from ffcomp.report.compare.figures import HOW_TO_READ, close_ups, drawings, panels
from ffcomp.report.compare.sentences import GLOSSARY, answer, verdict
from ffcomp.report.compare.words import (
    contour_p99_um,
    contour_rms_um,
    duration,
    extrudes,
    feature_errors,
    file_name,
    layer_errors,
    outer_first,
    rms_um,
    shown,
    thousands,
    where_seen,
)
from ffcomp.report.drawing import ON_DARK, panel
from ffcomp.report.page import rendered, resource, tied
from gcode.atomic_write import replace_atomically

FAMILY_WORDS: dict[Family, str] = {
    "none": "as the firmware would print it",
    "calibrated": "input shapers as the firmware's own resonance test sets them",
    "best fixed": "input shapers at the best frequencies for this print, the printer known",
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


def columns(comparison: Comparison) -> list[Column]:
    """Return the columns that the comparison has values for."""
    every = [*_extruding(), *map(_minor, _all_moves())] if extrudes(comparison) else _all_moves()
    if any(method.spread is not None for method in comparison.methods.values()):
        every += map(_minor, _mismatch())
    every += map(_minor, _effort())
    if any(method.equal_quality is not None for method in comparison.methods.values()):
        every = _equal_quality(comparison.quality_bound_um) + every  # what people look for first
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


def rows(comparison: Comparison) -> list[Row]:
    """Return the rows in the order of the comparison. Best are only methods that the carriages can follow."""
    table = columns(comparison)
    methods = list(comparison.methods.values())
    best = [_best(column, [method for method in methods if method.peaks.within_limits]) for column in table]
    return [Row(m, [_cell(column, m, top) for column, top in zip(table, best, strict=True)]) for m in methods]


def _best(column: Column, methods: list[Method]) -> float | None:
    all_values = [column.value(method) for method in methods]
    values = [value for value in all_values if value is not None and math.isfinite(value)]
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


def write_report(comparison: Comparison, target: Path) -> None:
    """Write the whole comparison as one HTML file; an old one stays until the new one is complete."""
    replace_atomically(target, _page(comparison))


def _page(comparison: Comparison) -> Iterator[bytes]:
    script = resource("compare/page.js")
    yield rendered(
        "compare",
        {"um": um, "duration": duration, "tied": tied},
        comparison=comparison,
        name=file_name(comparison),
        script=Markup(script),
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii"),
        answer=answer(comparison),
        sentences=[tied(sentence) for sentence in verdict(comparison)],
        tiles=_tiles(comparison),
        extrudes=extrudes(comparison),
        where=where_seen(comparison),
        shown=shown(comparison),
        close_ups=[panel(each) for each in close_ups(comparison)],
        how_to_read=HOW_TO_READ,
        figures={each.name: each for each in drawings(comparison)},
        panels={name: [panel(each) for each in them] for name, them in panels(comparison).items()},
        columns=columns(comparison),
        groups=[(name, len(list(them))) for name, them in groupby(c.group for c in columns(comparison))],
        families=_families(comparison),
        layers=_layers(comparison),
        features=_features(comparison),
        warnings=[(m.label, each) for m in comparison.methods.values() for each in dict.fromkeys(m.warnings)],
        glossary=GLOSSARY,
    )


@dataclass(frozen=True, slots=True)
class Tile:
    """One of the three big numbers on top."""

    label: str
    rms: str
    p99: str
    colour: str
    on_dark: str
    share: float  # of the largest of them, %


def _tiles(comparison: Comparison) -> list[Tile]:
    values = [contour_rms_um(comparison, method) for method in shown(comparison)]
    most = max(max(values), 1e-9)
    return [
        Tile(
            m.label,
            um(v),
            um(contour_p99_um(comparison, m)),
            colour_of(comparison, m),
            ON_DARK[colour_of(comparison, m)],
            100 * v / most,
        )
        for m, v in zip(shown(comparison), values, strict=True)
    ]


def _families(comparison: Comparison) -> list[tuple[str, list[Row]]]:
    by_family = groupby(rows(comparison), lambda row: row.method.family)
    return [(FAMILY_WORDS[family], list(rows)) for family, rows in by_family]


def _layers(comparison: Comparison) -> list[tuple[int, str, list[str]]]:
    errors = [layer_errors(comparison, method) for method in shown(comparison)]
    return [
        (layer.number, f"{layer.z_mm:.2f}", [rms_um(each.get(layer.number)) for each in errors])
        for layer in comparison.layers
    ]


def _features(comparison: Comparison) -> list[tuple[str, str, list[str]]]:
    errors = [feature_errors(comparison, method) for method in shown(comparison)]
    share = {name: error.share for name, error in feature_errors(comparison, comparison.methods["none"]).items()}
    names = outer_first(share, share)
    return [(name, f"{share[name]:.1%}", [rms_um(each.get(name)) for each in errors]) for name in names]
