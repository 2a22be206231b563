"""Names in the docstrings of the product lead somewhere: files exist, and words stand in the code or name a module."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = [path for top in ("gcode", "models", "ffcomp") for path in sorted((ROOT / top).rglob("*.py"))]
QUOTED = re.compile(r"`+([^`\n]+)`+")
FILE = re.compile(r"(?:gcode|models|ffcomp|tests|scripts|validation|studies|docs)/[\w./-]+")
NAME = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+|[a-z]+(?:_[a-z0-9]+)+|(?:[A-Z][a-z]+){2,}")
OF_OTHERS = {"pos_x", "pos_q_rad", "timestamp_ms", "cmd_j", "force_n_per_kg", "axis.inertia_kg_m2"}  # columns and keys
OF_OTHERS |= {"file_processors", "plan_arc", "queue_step", "control.FrequencyResponseData", "gcode_arcs.py"}  # programs
ENDINGS = {"md", "cpp", "toml", "json", "csv", "html", "cfg", "g", "gcode"}


@cache
def code() -> tuple[set[str], set[str]]:
    """Return the words of the code but for docstrings, and the names of the modules."""
    words, modules = set[str](), {part for path in SOURCES for part in path.relative_to(ROOT).with_suffix("").parts}
    for path in SOURCES:
        lines = path.read_text(encoding="utf-8").splitlines()
        for _, first, last in docstrings(path):
            lines[first - 1 : last] = [""] * (last - first + 1)
        words |= set(re.findall(r"\w+", "\n".join(lines)))
    return words, modules


@cache
def docstrings(path: Path) -> list[tuple[str, int, int]]:
    """Return the docstrings of a file as they are written, and their first and last lines."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    found = [node.body[0] for node in nodes if isinstance(node, kinds) and ast.get_docstring(node)]
    return [(ast.literal_eval(x.value), x.lineno, x.end_lineno or 0) for x in found if isinstance(x, ast.Expr)]


def stale(path: Path) -> Iterator[str]:
    """Yield the names in the docstrings of a file that lead nowhere, with their lines."""
    words, modules = code()
    for doc, line, _ in docstrings(path):
        for quoted in QUOTED.findall(doc):
            first, *rest = quoted.split(".")
            if FILE.fullmatch(quoted):
                wrong = not (ROOT / quoted.rstrip("/")).exists()
            elif rest == ["py"]:
                wrong = first not in modules and quoted not in OF_OTHERS
            elif not NAME.fullmatch(quoted) or {first, quoted} & OF_OTHERS or {*rest[-1:]} & ENDINGS:
                continue
            else:  # of `package.module.Name` the first parts are modules
                wrong = not {first, *rest} <= words | modules or (
                    len(rest) > 1 and {first, *rest[:-1]} - modules - words
                )
            if wrong:
                yield f"{path.relative_to(ROOT)}:{line}: {quoted}"


def test_names_in_docstrings_resolve() -> None:
    wrong = [each for path in SOURCES for each in stale(path)]
    assert not wrong, "\n".join(wrong)
