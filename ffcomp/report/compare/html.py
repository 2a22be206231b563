"""The report of a comparison as one HTML page."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib
from markupsafe import Markup

from ffcomp.compare.result import Comparison
from ffcomp.report.compare import table
from ffcomp.report.compare.answer import answer
from ffcomp.report.compare.captions import HOW_TO_READ
from ffcomp.report.compare.figures import close_ups, drawings, panels
from ffcomp.report.compare.glossary import GLOSSARY
from ffcomp.report.compare.packed import FEATURES, LOWEST_UM, packed, thinned_out
from ffcomp.report.compare.parts import by_feature, by_layer
from ffcomp.report.compare.style import colour_of
from ffcomp.report.compare.verdict import verdict
from ffcomp.report.compare.words import (
    contour_p99_um,
    contour_rms_um,
    duration,
    extrudes,
    file_name,
    outer_first,
    rms_um,
    shown,
    um,
    where_seen,
)
from ffcomp.report.shared.drawing import panel
from ffcomp.report.shared.page import rendered, resource, tied
from ffcomp.report.shared.style import ON_DARK, error_colours
from gcode.atomic_write import replace_atomically

COLOURS = 48


def write_report(comparison: Comparison, target: Path) -> None:
    """Write the whole comparison as one HTML file; an old one stays until the new one is complete."""
    replace_atomically(target, _page(comparison))


def _page(found: Comparison) -> Iterator[bytes]:
    script = "\n".join(resource(f"compare/{name}.js") for name in ("unpack", "viewer", "controls", "page"))
    yield rendered(
        "compare",
        {"um": um, "duration": duration, "tied": tied},
        found=found,
        name=file_name(found),
        script=Markup(script),
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii"),
        data=_json(packed(found)),
        thinned_out=thinned_out(found),
        colours=_json({"light": _colours(False), "dark": _colours(True)}),
        ramps={"light": ", ".join(_colours(False)), "dark": ", ".join(_colours(True))},
        ticks=_ticks(found),
        answer=answer(found),
        sentences=[tied(sentence) for sentence in verdict(found)],
        tiles=_tiles(found),
        extrudes=extrudes(found),
        where=where_seen(found),
        shown=shown(found),
        close_ups=[panel(each) for each in close_ups(found)],
        how_to_read=HOW_TO_READ,
        figures={each.name: each for each in drawings(found)},
        panels={name: [panel(each) for each in them] for name, them in panels(found).items()},
        columns=table.columns(found),
        groups=[(name, len(list(them))) for name, them in groupby(c.group for c in table.columns(found))],
        families=_families(found),
        layers=_layers(found),
        features=_features(found),
        feature_numbers=_feature_numbers(found),
        warnings=[(m.label, each) for m in found.methods.values() for each in dict.fromkeys(m.warnings)],
        glossary=GLOSSARY,
    )


def _json(value: Any) -> Markup:
    """Escape JSON for a <script> element, which only `</` could end."""
    return Markup(json.dumps(value, ensure_ascii=True, separators=(",", ":")).replace("<", "\\u003c"))


def _colours(on_dark: bool) -> list[str]:
    """Return colours from violet (on the path) to what stands out most (far off)."""
    colours = error_colours(on_dark)
    return [matplotlib.colors.to_hex(colours(k / (COLOURS - 1))) for k in range(COLOURS)]


def _ticks(found: Comparison) -> list[tuple[float, str]]:
    """Return where on the colour bar, in %, powers of ten stand."""
    highest = max(1e3 * float(method.samples.contour.max()) for method in shown(found))
    decades = math.log10(max(highest, 1.0) / LOWEST_UM)
    return [(100 * k / decades, f"{LOWEST_UM * 10**k:g}") for k in range(math.floor(decades) + 1)]


@dataclass(frozen=True, slots=True)
class Tile:
    """One of the three big numbers on top."""

    label: str
    rms: str
    p99: str
    colour: str
    on_dark: str
    share: float  # of the largest of them, %


def _tiles(found: Comparison) -> list[Tile]:
    values = [contour_rms_um(found, method) for method in shown(found)]
    most = max(max(values), 1e-9)
    return [
        Tile(
            m.label,
            um(v),
            um(contour_p99_um(found, m)),
            colour_of(found, m),
            ON_DARK[colour_of(found, m)],
            100 * v / most,
        )
        for m, v in zip(shown(found), values, strict=True)
    ]


def _families(found: Comparison) -> list[tuple[str, list[table.Row]]]:
    by_family = groupby(table.rows(found), lambda row: row.method.family)
    return [(table.FAMILY_WORDS[family], list(rows)) for family, rows in by_family]


def _layers(found: Comparison) -> list[tuple[int, str, list[str]]]:
    errors = [by_layer(found, method) for method in shown(found)]
    return [
        (layer.number, f"{layer.z_mm:.2f}", [rms_um(each.get(layer.number)) for each in errors])
        for layer in found.layers
    ]


def _features(found: Comparison) -> list[tuple[str, str, list[str]]]:
    errors = [by_feature(found, method) for method in shown(found)]
    share = {name: error.share for name, error in by_feature(found, found.methods["none"]).items()}
    names = outer_first(share, share)
    return [(name, f"{share[name]:.1%}", [rms_um(each.get(name)) for each in errors]) for name in names]


def _feature_numbers(found: Comparison) -> list[tuple[int, str]]:
    """Return what the viewer may show alone, with its number in the data."""
    number = {name: k for k, name in enumerate(found.features[: FEATURES + 1])}
    return [(number[name], name) for name, _, _ in _features(found) if name in number]
