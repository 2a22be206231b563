"""Print what a checkout holds: sizes, words, names, and how much code a verb reaches.

    scripts/structure                    the table
    scripts/structure --compare REF      the same beside another commit
    scripts/structure --list MEASURE     what a measure counts: twice, one-importer, words

Source text is read, nothing of it is imported or run. What may import what is import-linter's to say (`lint-imports`).
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import statistics
import subprocess
import tarfile
import tempfile
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

PRODUCT = ("gcode", "models", "ffcomp")
VERBS = ("compensate", "diagnose")
GENERATED = ("EFFECTS", "DIALECTS", "cli", "json", "machine_file", "library")  # pages of docs/ made from the code
FRAGMENT = 60  # lines of a file, at most
MANY = 9  # arguments by position in one call, from which nobody knows which is which
PRIVATE_WORDS = frozenset({"found", "own", "told", "given", "asked", "said"})
KIND_OF_MACHINE = re.compile(  # code that asks for it has no place outside of models/
    r"\b(?:has_straight_axes|first_share)\b"
    r"|\bis(?:instance|subclass)\([^()]*\b(?:Delta|Straight|Cartesian)(?:Geometry|Kinematics|Vibration)\b"
)
LAYOUT = {getattr(tokenize, n) for n in ("COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENDMARKER")}

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
Assignment = ast.Assign | ast.AnnAssign


@dataclass(frozen=True)
class Source:
    """One Python file of the product."""

    name: str  # dotted; of a package, without `__init__`
    path: str
    text: str
    lines: int
    tree: ast.Module

    @cached_property
    def nodes(self) -> list[ast.AST]:
        return list(ast.walk(self.tree))

    @cached_property
    def tokens(self) -> list[tokenize.TokenInfo]:
        """List those of code: no comment, no docstring, no layout."""
        alone = (n.value for n in self.nodes if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant))
        texts = {line for n in alone if isinstance(n.value, str) for line in _lines_of(n)}
        every = tokenize.generate_tokens(io.StringIO(self.text).readline)
        return [each for each in every if each.type not in LAYOUT and each.start[0] not in texts]

    @cached_property
    def code_lines(self) -> set[int]:
        return {line for each in self.tokens for line in range(each.start[0], each.end[0] + 1)}

    @cached_property
    def functions(self) -> list[tuple[int, str]]:
        nodes = (n for n in self.nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))
        return [(len(self.code_lines.intersection(_lines_of(n))), f"{self.path}: {n.name}") for n in nodes]

    @cached_property
    def words(self) -> Counter[str]:
        parts = (set(each.string.lower().split("_")) for each in self.tokens if each.type == tokenize.NAME)
        return Counter(word for words in parts for word in words & PRIVATE_WORDS)

    @cached_property
    def bound(self) -> dict[str, list[ast.stmt]]:
        """Map names at the top to what stands behind them: definitions, tables, functions that are dispatched to."""
        bound: dict[str, list[ast.stmt]] = defaultdict(list)
        for node in self.tree.body:
            if isinstance(node, Definition):
                dispatched = re.search(r"(\w+)\.register\b", " ".join(map(ast.unparse, node.decorator_list)))
                bound[dispatched[1] if dispatched else node.name].append(node)
            elif isinstance(node, Assignment):
                for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                    for name in (n.id for n in ast.walk(target) if isinstance(n, ast.Name)):
                        bound[name].append(node)
        return bound

    @cached_property
    def constants(self) -> list[str]:
        """List names in capitals that hold numbers."""
        return [name for name, nodes in self.bound.items() if name.isupper() and any(map(_holds_number, nodes))]

    @cached_property
    def imports(self) -> dict[str, tuple[str, str]]:
        """Map local names to module and name in it, "" for the module itself, wherever the import stands."""
        names = {}
        for node in self.nodes:
            if isinstance(node, ast.Import):
                names |= {each.asname or each.name: (each.name, "") for each in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names |= {each.asname or each.name: (node.module, each.name) for each in node.names}
        return names


class Checkout:
    """The product, the docs and the tests of one checkout."""

    def __init__(self, root: Path) -> None:
        self.root, self.sources = root, dict[str, Source]()
        for file in (file for package in PRODUCT for file in sorted((root / package).rglob("*.py"))):
            path, text = file.relative_to(root), file.read_text(encoding="utf-8")
            name = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
            self.sources[name] = Source(name, path.as_posix(), text, text.count("\n"), ast.parse(text))

    @cached_property
    def with_one_importer(self) -> dict[str, str]:
        importers: dict[str, set[str]] = {name: set() for name in self.sources}
        for source in self.sources.values():
            for module, name in source.imports.values():
                if (imported := f"{module}.{name}" if f"{module}.{name}" in importers else module) in importers:
                    importers[imported].add(source.name)
        files = (source for source in self.sources.values() if not source.path.endswith("__init__.py"))
        return {file.path: next(iter(by)) for file in files if len(by := importers[file.name]) == 1}

    @cached_property
    def named_twice(self) -> dict[str, list[str]]:
        places: dict[str, list[str]] = defaultdict(list)
        for source in self.sources.values():
            for name in source.bound:
                places[name].append(source.path)
        return {name: files for name, files in sorted(places.items()) if len(files) > 1 and not name.startswith("_")}

    def reached(self, verb: str) -> dict[tuple[str, str], list[ast.stmt]]:
        """Map module and name to what the Python function of a verb may come by; a class brings its methods.

        Names are followed through imports and tables, whether they are called or not; attributes of objects are not.
        """
        ahead = [(name, verb) for name in self.sources if not name.startswith(("ffcomp.cli", "ffcomp.serve"))]
        reached: dict[tuple[str, str], list[ast.stmt]] = {}
        while ahead:
            module, name = here = ahead.pop()
            if here in reached or (source := self.sources.get(module)) is None:
                continue
            if name in source.bound:
                reached[here] = source.bound[name]
                ahead += [(module, each) for node in reached[here] for each in _named(source, node)]
            elif name in source.imports:
                ahead.append(source.imports[name])
            elif "." in name:  # of an imported module
                alias, _, inside = name.partition(".")
                ahead.append((".".join(filter(None, source.imports[alias])), inside))
        return reached

    def table(self) -> list[tuple[str, str]]:
        files = list(self.sources.values())
        code = sum(len(f.code_lines) for f in files)
        words = sum(f.words.total() for f in files)
        functions = sorted(each for f in files for each in f.functions)
        sizes = [size for size, _ in functions]
        largest = max(files, key=lambda f: f.lines)
        calls = [n for f in files for n in f.nodes if isinstance(n, ast.Call) and len(n.args) >= MANY]
        diagnosing = sum(len(f.constants) for f in files if f.name.startswith("ffcomp.diagnosis"))
        kinds = [KIND_OF_MACHINE.findall(f.text) for f in files if not f.name.startswith("models")]
        pages = [self.root / "README.md", *(self.root / "docs").rglob("*.md")]
        prose = {page: len(page.read_text(encoding="utf-8").split()) for page in pages}
        written = {page: count for page, count in prose.items() if page.stem not in GENERATED}
        return [
            ("Python files of the product", f"{len(files)}"),
            ("Lines", f"{sum(f.lines for f in files):,}"),
            ("Lines of code: no comment, no docstring, not blank", f"{code:,}"),
            (f"Files of {FRAGMENT} lines or fewer", f"{sum(f.lines <= FRAGMENT for f in files)}"),
            ("Files with one importer", f"{len(self.with_one_importer)}"),
            ("Largest file", f"{largest.lines} ({largest.path})"),
            ("Functions", f"{len(sizes):,}"),
            (
                "Their lines of code, median; nine of ten within",
                f"{statistics.median(sizes):g}; {sizes[len(sizes) * 9 // 10]}",
            ),
            ("Longest function", f"{sizes[-1]} ({functions[-1][1]})"),
            (f"Names with {'/'.join(sorted(PRIVATE_WORDS))} in 1,000 lines of code", f"{1e3 * words / code:.1f}"),
            ("Public names that several files define", f"{len(self.named_twice)}"),
            (
                "Module constants that are numbers; of diagnose",
                f"{sum(len(f.constants) for f in files):,}; {diagnosing}",
            ),
            (f"Calls with {MANY} arguments by position, or more", f"{len(calls)}"),
            *((f"Definitions on the way of `{verb}`", _reach_text(self.reached(verb))) for verb in VERBS),
            ("Places outside models/ that ask for the kind of machine", f"{sum(map(len, kinds))}"),
            ("Pages and words of README and docs", f"{len(prose)}, {sum(prose.values()):,}"),
            ("Without the pages made from the code", f"{len(written)}, {sum(written.values()):,}"),
            ("Lines of tests", f"{sum(p.read_bytes().count(10) for p in (self.root / 'tests').rglob('*.py')):,}"),
        ]


def _lines_of(node: ast.stmt | ast.expr) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _holds_number(node: ast.stmt) -> bool:
    return isinstance(node, Assignment) and any(type(getattr(n, "value", "")) in (int, float) for n in ast.walk(node))


def _named(source: Source, node: ast.stmt) -> Iterator[str]:
    """Yield the names in a statement; of an imported module with what is taken of it, `module.name`."""
    for each in ast.walk(node):
        if isinstance(each, ast.Name):
            yield each.id
        elif isinstance(each, ast.Attribute) and isinstance(each.value, ast.Name) and each.value.id in source.imports:
            yield f"{each.value.id}.{each.attr}"


def _reach_text(reached: dict[tuple[str, str], list[ast.stmt]]) -> str:
    count = sum(isinstance(node, Definition) for nodes in reached.values() for node in nodes)
    return f"{count:,} in {len({module for module, _ in reached})} files"


def table_at(root: Path, ref: str) -> list[tuple[str, str]]:
    command = ["git", "-C", str(root), "archive", ref, *PRODUCT, "docs", "tests", "README.md"]
    with tempfile.TemporaryDirectory() as folder:
        packed = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(folder, filter="data")
        return Checkout(Path(folder)).table()


def markdown(heading: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (heading, ("---",) * len(heading), *rows))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/structure", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).resolve().parents[1], help="a checkout")
    parser.add_argument("--compare", metavar="REF", help="another commit, whose measures stand before")
    parser.add_argument("--list", choices=("twice", "one-importer", "words"), help="what a measure counts")
    options = parser.parse_args(arguments)
    here = Checkout(options.root)
    counted = {
        "twice": [f"{name}: {', '.join(files)}" for name, files in here.named_twice.items()],
        "one-importer": [f"{file}: {importer}" for file, importer in here.with_one_importer.items()],
        "words": [f"{f.path}: {f.words.total()}" for f in here.sources.values() if f.words],
    }
    if options.list:
        print(*counted[options.list], sep="\n")
    elif options.compare:
        pairs = zip(table_at(options.root, options.compare), here.table(), strict=True)
        print(markdown(("Measure", "Before", "After"), ((name, old, new) for (name, old), (_, new) in pairs)))
    else:
        print(markdown(("Measure", "Value"), here.table()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
