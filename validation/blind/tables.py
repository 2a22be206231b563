"""The text of a machine file."""

from __future__ import annotations

from typing import Any

from validation.blind.printer.real import Tables


def toml_of(machine: Tables, name: str) -> str:
    """Write the tables of a machine file as its text."""
    lines = ['format = "ffcomp-machine/1"', f'name = "{name}"']
    for title, table in machine.items():
        lines += ["", f"[{title}]"]
        inner = {key: value for key, value in table.items() if isinstance(value, dict)}
        lines += [f"{key} = {_literal(value)}" for key, value in table.items() if key not in inner]
        for key, values in inner.items():
            lines += ["", f"[{title}.{key}]", *(f"{k} = {_literal(v)}" for k, v in values.items())]
    return "\n".join(lines) + "\n"


def _literal(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return f"[{', '.join(_literal(x) for x in value)}]"
    return f"{value:.6g}"
