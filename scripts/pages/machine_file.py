"""docs/reference/machine_file.md: keys, units, ranges and defaults of its tables come from the schema.

What a key means is written by hand, in the last column; a new key gets a row that waits for it.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from models.quantities import PLAIN
from models.schema.documents import AxisDocument, DeltaDocument, StraightDocument

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "machine_file.md"

SECTIONS = {  # of the page -> path into the JSON schema of a document
    "Top level": (DeltaDocument, ""),
    "kinematics: a delta": (DeltaDocument, "kinematics"),
    "kinematics: cartesian and CoreXY axes": (StraightDocument, "kinematics"),
    "carriage": (DeltaDocument, "carriage"),
    "carriage.drive": (DeltaDocument, "carriage.drive"),
    "effector": (DeltaDocument, "effector"),
    "axes": (StraightDocument, "axes.x"),
    "kinematics: one axis": (AxisDocument, "kinematics"),
    "axis": (AxisDocument, "axis"),
    "axis.drive": (AxisDocument, "axis.drive"),
    "limits": (DeltaDocument, "limits"),
    "steps": (DeltaDocument, "steps"),
    "firmware": (DeltaDocument, "firmware"),
    "firmware.marlin": (DeltaDocument, "firmware.marlin"),
    "firmware.reprapfirmware": (DeltaDocument, "firmware.reprapfirmware"),
    "macros": (DeltaDocument, "macros"),
}
TABLES = {
    "kinematics",
    "carriage",
    "effector",
    "axes",
    "axis",
    "limits",
    "steps",
    "firmware",
    "macros",
    "effects",
    "uncertainty",
    "provenance",
}


def page() -> str:
    """The page, with the tables as the schema has them."""
    text = PAGE.read_text(encoding="utf-8")
    for section, (document, path) in SECTIONS.items():
        table = re.compile(rf"(^##+ {re.escape(section)}\n(?:(?!^##|^\|).*\n)*\|.*\n\|.*\n)((?:\|.*\n)+)", re.MULTILINE)
        match = table.search(text)
        if match is None:
            raise ValueError(f"{PAGE.name} has no table under {section!r}.")
        meanings = {cells[1].strip(): cells[5].strip() for cells in map(_cells, match[2].splitlines())}
        rows = [f"| {' | '.join([*row, meanings.get(row[0], '')])} |\n" for row in of_schema(document, path)]
        text = f"{text[: match.start(2)]}{''.join(rows)}{text[match.end(2) :]}"
    return text


def _cells(line: str) -> list[str]:
    return re.split(r"(?<!\\)\|", line)


def of_schema(document: Any, path: str) -> list[list[str]]:
    """The cells that follow from the schema: key, unit, range, default."""
    schema = document.model_json_schema()
    table = schema
    for part in filter(None, path.split(".")):
        table = _object(schema, table["properties"][part])
    rows = []
    for key, field in table["properties"].items():
        if (path or key not in TABLES) and "$ref" not in str(field):
            default = "**required**" if key in table.get("required", []) else _default(field)
            unit = PLAIN.unit_of(key) or ("s" if key.endswith("_s") else "")
            rows.append([f"`{key}`", unit, _range(field), default])
    return rows


def _object(schema: dict[str, Any], field: dict[str, Any]) -> dict[str, Any]:
    """What stands behind `X` or `X | None`."""
    reference = next(each["$ref"] for each in (field, *field.get("anyOf", ())) if "$ref" in each)
    return schema["$defs"][reference.rpartition("/")[2]]


def _default(field: dict[str, Any]) -> str:
    value = field.get("default")
    return "" if value is None else f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def _range(field: dict[str, Any]) -> str:
    kinds = [each for each in field.get("anyOf", [field]) if each.get("type") != "null"]
    if len(kinds) == 2:
        return f"{_range(kinds[0])}; or three"
    (kind,) = kinds
    if "const" in kind or "enum" in kind:
        return ", ".join(f"`{each}`" for each in kind.get("enum", [kind.get("const")]))
    if kind["type"] == "array" and "minItems" not in kind:
        return "a list of names in quotes"
    if kind["type"] == "array":
        counts = {(4, 4): "four", (3, 3): "three", (2, 2): "two", (1, 8): "one to eight"}
        count = counts[kind["minItems"], kind["maxItems"]]
        return f"{count}, {_range(kind['items'])} each"
    return {"string": "text", "boolean": "true, false"}.get(kind["type"]) or _interval(kind)


def _interval(kind: dict[str, Any]) -> str:
    low = _number(kind["minimum"]) if "minimum" in kind else f"above {_number(kind['exclusiveMinimum'])}"
    high = _number(kind["maximum"]) if "maximum" in kind else f"below {_number(kind['exclusiveMaximum'])}"
    return f"{low} to {high}"


def _number(value: float) -> str:
    if abs(value) < 1e4:
        return f"{value:g}"
    digits, _, exponent = f"{value:.9e}".partition("e")
    return f"{float(digits):g}e{int(exponent)}"
