"""Measure the structure of a checkout and check it against the import contract.

Reads source text only (`ast`): nothing of the checkout is imported or run. Imports count wherever they stand: at the
top of a file, inside functions, under `if TYPE_CHECKING:`, and as `import_module("...")` with the name written out.
Importing a module also runs the `__init__` of the packages around it; these imports are not written anywhere and are
not counted.

Terms used here:

unit
    A direct child of a package, either a file or a folder with all that is in it. "The units" are those of `ffcomp/`.
cycle
    A strongly connected component of more than one member: among files, or among the units of one package.
floors
    The number of units on the longest chain of imports, each cycle counted as one.
arrows
    The number of ordered pairs of units of which the first imports the second.
"""

from __future__ import annotations

import argparse
import ast
import io
import math
import statistics
import subprocess
import sys
import tarfile
import tempfile
import tokenize
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

Graph = Mapping[str, set[str]]
"""Nodes and, for each, the nodes that it imports."""

PRODUCT = ("gcode", "models", "ffcomp")
"""Top-level packages that are shipped. All measures are of these."""

OUTSIDE = ("validation", "studies", "benchmarks", "tests")
"""Top-level folders that use the product and are never imported by it."""

LAYERS: tuple[tuple[str, ...], ...] = (
    ("gcode", "models", "ffcomp.errors", "ffcomp.numerics", "ffcomp.metrics", "ffcomp.version"),
    ("ffcomp.measurement", "ffcomp.shapers", "ffcomp.planner", "ffcomp.importers", "ffcomp.integrations"),
    ("ffcomp.steps", "ffcomp.inverse"),
    ("ffcomp.faster",),
    ("ffcomp.compensate", "ffcomp.simulate", "ffcomp.identify", "ffcomp.record"),
    ("ffcomp.estimate", "ffcomp.compare", "ffcomp.diagnose", "ffcomp.check"),
    ("ffcomp.report",),
    ("ffcomp.api", "ffcomp.serve"),
    ("ffcomp.__init__",),
    ("ffcomp.cli", "ffcomp.__main__"),
    ("validation",),
    ("studies", "benchmarks"),
)
"""Who may import whom, lowest layer first: a module imports from its own layer and from lower ones.

`ffcomp.__init__` is the public face: it offers the verbs, so that only the command line may import it; the version
therefore has a file of its own.
"""

INDEPENDENT = {"gcode": ("models", "ffcomp"), "models": ("gcode", "ffcomp")}
"""Packages that stand on their own, and the packages they must not import."""

MOST_FILES_IN_FFCOMP = 6
"""Files allowed directly in `ffcomp/`, of whatever type."""

KIND_ATTRIBUTES = ("has_straight_axes", "first_share")
"""Names that tell one kind of machine from another, wherever they are used."""

KIND_CLASSES = (
    "DeltaGeometry",
    "StraightGeometry",
    "DeltaKinematics",
    "CartesianKinematics",
    "DeltaVibration",
    "ModalAxes",
)
"""Classes of one kind of machine, in `isinstance`, `issubclass`, `type(...) is` and `case`."""

MACHINE_NAMES = ("machine", "plant", "loaded")
"""Variables and attributes that hold a machine: their `.delta` asks for one kind."""

FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
DOCUMENTED = (*FUNCTIONS, ast.ClassDef, ast.Module)
BODIES = (*FUNCTIONS, ast.Lambda)  # what is imported inside is imported when they are called
ASSIGNMENTS = (ast.Assign, ast.AnnAssign)
ASKING = (ast.expr, ast.pattern, ast.keyword)
UNNEEDED = (ast.expr_context, ast.operator)


@dataclass(frozen=True)
class Import:
    """One import statement's name, as written in a file."""

    importer: str  # module
    imported: str  # module, or the dotted name as written where there is no such module
    path: str
    line: int
    lazy: bool  # inside a function
    typing: bool  # under `if TYPE_CHECKING:`
    exists: bool  # the imported module is part of the checkout

    def __str__(self) -> str:
        note = "".join([" (in a function)" if self.lazy else "", " (for types)" if self.typing else ""])
        return f"{self.path}:{self.line} imports {self.imported}{note}"


class Node(NamedTuple):
    """One node of a syntax tree and where it stands."""

    node: ast.AST
    lazy: bool  # inside a function
    typing: bool  # under `if TYPE_CHECKING:`


@dataclass(frozen=True)
class Module:
    """One parsed source file."""

    name: str  # dotted; "ffcomp.cli" for ffcomp/cli/__init__.py
    path: str  # relative to the checkout, with "/"
    lines: int
    text: str
    tree: ast.Module

    @cached_property
    def nodes(self) -> list[Node]:
        """List the nodes of the tree."""
        return _nodes(self.tree)

    @cached_property
    def code_lines(self) -> frozenset[int]:
        """Return the numbers of the lines that hold code: no comment, no docstring, not blank."""
        told = {
            line
            for here in self.nodes
            if isinstance(here.node, DOCUMENTED) and (text := _docstring(here.node)) is not None
            for line in range(text.lineno, (text.end_lineno or text.lineno) + 1)
        }
        skipped = (
            tokenize.COMMENT,
            tokenize.NL,
            tokenize.NEWLINE,
            tokenize.INDENT,
            tokenize.DEDENT,
            tokenize.ENDMARKER,
        )
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        held = {n for each in tokens if each.type not in skipped for n in range(each.start[0], each.end[0] + 1)}
        return frozenset(held - told)

    @property
    def is_init(self) -> bool:
        """Tell whether this is the `__init__` of a package."""
        return self.path.endswith("/__init__.py")

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """Return the path from the top-level package down, with `__init__` written out."""
        return (*self.name.split("."), *(["__init__"] if self.is_init else []))


@dataclass(frozen=True)
class Function:
    """One function or method and its lines of code, from `def` to the last line, without its docstring."""

    name: str
    path: str
    lines: int


def _docstring(node: ast.AST) -> ast.expr | None:
    """Return the expression that is the docstring of a module, class or function."""
    body = getattr(node, "body", [])
    first = body[0].value if body and isinstance(body[0], ast.Expr) else None
    return first if isinstance(first, ast.Constant) and isinstance(first.value, str) else None


def _code_in(module: Module, node: ast.stmt) -> int:
    """Count the lines of code of a definition."""
    return sum(n in module.code_lines for n in range(node.lineno, (node.end_lineno or node.lineno) + 1))


class Checkout:
    """The source of one checkout: modules, imports and what is measured of them."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.modules = {m.name: m for m in _modules(root)}
        self.product = [m for m in self.modules.values() if m.name.split(".")[0] in PRODUCT]
        if not self.product:
            raise SystemExit(f"structure: no Python files of {', '.join(PRODUCT)} in {root}")

    @cached_property
    def imports(self) -> list[Import]:
        """List all imports of one module of the checkout by another, in order of files and lines."""
        return [i for m in self.modules.values() for i in _imports(m, self.modules) if i.imported != i.importer]

    def file_graph(self, typing: bool = True) -> dict[str, set[str]]:
        """Return which module imports which; `typing=False` leaves out imports under `if TYPE_CHECKING:`."""
        graph: dict[str, set[str]] = {name: set() for name in self.modules}
        for i in self.imports:
            if i.exists and (typing or not i.typing):
                graph[i.importer].add(i.imported)
        return graph

    def units_of(self, package: str, typing: bool = True) -> dict[str, set[str]]:
        """Return which unit of a package imports which other; `""` stands for the checkout itself."""
        graph: dict[str, set[str]] = {}
        for module in self.modules.values():
            if unit := _unit_below(module, package):
                graph.setdefault(unit, set())
        for i in self.imports:
            if i.exists and (typing or not i.typing):
                one, other = (_unit_below(self.modules[name], package) for name in (i.importer, i.imported))
                if one and other and one != other:
                    graph[one].add(other)
        return graph

    @cached_property
    def packages(self) -> list[str]:
        """List the checkout (`""`) and all packages in it."""
        return sorted({".".join(m.parts[:n]) for m in self.modules.values() for n in range(len(m.parts))})

    def file_cycles(self, typing: bool = True) -> list[list[str]]:
        """List the cycles among files."""
        return cycles(self.file_graph(typing))

    def folder_cycles(self, typing: bool = True) -> dict[str, list[list[str]]]:
        """Return the cycles among the units of each package that has any."""
        found = {package: cycles(self.units_of(package, typing)) for package in self.packages}
        return {package: groups for package, groups in found.items() if groups}

    @cached_property
    def units(self) -> dict[str, set[str]]:
        """Return the graph of the units of `ffcomp/`, without its `__init__`."""
        face = "ffcomp.__init__"
        return {one: others - {face} for one, others in self.units_of("ffcomp").items() if one != face}

    @cached_property
    def files_in_ffcomp(self) -> list[str]:
        """List the files directly in `ffcomp/`, of whatever type."""
        return sorted(
            p.name for p in (self.root / "ffcomp").iterdir() if p.is_file() and p.suffix != ".pyc" and p.name[0] != "."
        )

    @cached_property
    def without_layer(self) -> list[str]:
        """List the units for which the contract has no layer."""
        return sorted({unit for m in self.modules.values() if layer_of(unit := contract_unit(m)) is None})

    @cached_property
    def forbidden(self) -> list[str]:
        """List the imports that the contract forbids, each as a sentence with file and line."""
        found = []
        for i in self.imports:
            one = contract_unit(self.modules[i.importer])
            other = contract_unit(self.modules[i.imported]) if i.exists else i.imported.split(".")[0]
            if reason := forbids(one, other):
                found.append(f"{i}: {reason}")
        return found

    @cached_property
    def missing(self) -> list[str]:
        """List the imports of product modules that do not exist."""
        return [
            f"{i}, which does not exist" for i in self.imports if not i.exists and i.imported.split(".")[0] in PRODUCT
        ]

    @cached_property
    def functions(self) -> list[Function]:
        """List all functions and methods of the product."""
        return [
            Function(here.node.name, m.path, _code_in(m, here.node))
            for m in self.product
            for here in m.nodes
            if isinstance(here.node, FUNCTIONS)
        ]

    @cached_property
    def named_twice(self) -> dict[str, list[str]]:
        """Return the public top-level names that more than one product file defines, with these files."""
        places: dict[str, list[str]] = defaultdict(list)
        for module in self.product:
            for name in sorted(set(_defined(module.tree.body))):
                if not name.startswith("_"):
                    places[name].append(module.path)
        return {name: paths for name, paths in sorted(places.items()) if len(paths) > 1}

    @cached_property
    def kind_switches(self) -> list[str]:
        """List the places outside `models/` that ask which kind of machine this is."""
        return [
            f"{m.path}:{line} asks for the kind of machine: {text}"
            for m in self.product
            if m.name.split(".")[0] != "models"
            for line, text in sorted(_kind_switches(m))
        ]

    @cached_property
    def float_arrays(self) -> int:
        """Count the definitions `FloatArray = NDArray[...]`."""
        return sum(
            any(isinstance(target, ast.Name) and target.id == "FloatArray" for target in _targets(here.node))
            for m in self.product
            for here in m.nodes
            if isinstance(here.node, ASSIGNMENTS)
            and here.node.value is not None
            and _last_name(getattr(here.node.value, "value", here.node.value)) == "NDArray"
        )

    def problems(self) -> list[str]:
        """List everything that breaks the contract, each as a sentence; empty if all is well."""
        found = [f"no layer for {unit}: add it to LAYERS in scripts/structure.py" for unit in self.without_layer]
        found += self.missing
        if len(files := self.files_in_ffcomp) > MOST_FILES_IN_FFCOMP:
            found.append(f"{len(files)} files directly in ffcomp/, allowed {MOST_FILES_IN_FFCOMP}: {', '.join(files)}")
        for package, groups in self.folder_cycles().items():
            for group in groups:
                way = self._way_round(self.units_of(package), group, partial(self._unit_of, package))
                found.append(f"cycle of {len(group)} units in {package or 'the checkout'}: {way}")
        for group in self.file_cycles():
            found.append(f"cycle of {len(group)} files: {self._way_round(self.file_graph(), group, str)}")
        return found + self.forbidden + self.kind_switches

    def _unit_of(self, package: str, name: str) -> str | None:
        """Return the unit of a package to which a module belongs."""
        return _unit_below(self.modules[name], package)

    def _way_round(self, graph: Graph, group: list[str], node_of: Callable[[str], str | None]) -> str:
        """Describe a shortest way round a cycle, and name the other members of the cycle.

        Parameters
        ----------
        graph
            The graph in which the cycle is.
        group
            Members of the cycle.
        node_of
            Node of the graph to which a module belongs.
        """
        way = min((shortest_cycle(graph, start) for start in group), key=len)
        first = {(node_of(i.importer), node_of(i.imported)): i for i in reversed(self.imports) if i.exists}
        steps = [str(first[pair]) for pair in zip(way, way[1:] + way[:1], strict=True)]
        rest = sorted(set(group) - set(way))
        return "; ".join(steps) + (f"; also {', '.join(rest)}" if rest else "")

    def table(self) -> list[tuple[str, str]]:
        """Return the measures as rows of name and value."""
        lengths = sorted(f.lines for f in self.functions)
        longest = max(self.functions, key=lambda f: f.lines)
        largest = max(self.product, key=lambda m: m.lines)
        unit_cycles, file_cycles = cycles(self.units), self.file_cycles()
        untyped = self.file_cycles(typing=False)
        folders = self.folder_cycles()
        return [
            ("Files directly in `ffcomp/`", f"{len(self.files_in_ffcomp)}"),
            ("Units (direct children of `ffcomp/`)", f"{len(self.units)}"),
            ("Units in cycles", _members(unit_cycles)),
            ("Floors (longest chain of units)", f"{floors(self.units)}"),
            ("Arrows (unit to unit)", f"{sum(map(len, self.units.values()))}"),
            ("Cycles among the units of any package", f"{sum(map(len, folders.values()))}"),
            ("Files in cycles", _members(file_cycles)),
            ("Files in cycles, imports for types left out", _members(untyped)),
            ("Units without a layer", f"{len(self.without_layer)}"),
            ("Forbidden imports", f"{len(self.forbidden)}"),
            ("Python files of product", f"{len(self.product)}"),
            ("Lines of product", f"{sum(m.lines for m in self.product):,}"),
            ("Lines of code: no comment, no docstring, not blank", f"{sum(len(m.code_lines) for m in self.product):,}"),
            ("Functions", f"{len(lengths):,}"),
            ("Lines of code of a function, median", f"{statistics.median(lengths):g}"),
            ("Lines of code of a function, nine of ten within", f"{lengths[math.ceil(0.9 * len(lengths)) - 1]}"),
            ("Longest function", f"{longest.lines} ({longest.path}: {longest.name})"),
            ("Largest file", f"{largest.lines} ({largest.path})"),
            ("Public names defined twice or more", f"{len(self.named_twice)}"),
            ("Switches on the kind of machine outside `models/`", f"{len(self.kind_switches)}"),
            ("Definitions of `FloatArray`", f"{self.float_arrays}"),
        ]


# Graphs


def cycles(graph: Graph) -> list[list[str]]:
    """List the strongly connected components of more than one member, each sorted (Kosaraju's algorithm)."""
    return [sorted(group) for group in _components(graph) if len(group) > 1]


def _components(graph: Graph) -> list[set[str]]:
    """List the strongly connected components, importers before what they import."""
    finished: list[str] = []
    seen: set[str] = set()
    for start in graph:
        finished += _visit(start, graph, seen)
    backwards: dict[str, set[str]] = {node: set() for node in graph}
    for node, others in graph.items():
        for other in others:
            backwards[other].add(node)
    seen = set()
    groups = (set(_visit(start, backwards, seen)) for start in reversed(finished))
    return [group for group in groups if group]


def _visit(start: str, graph: Graph, seen: set[str]) -> list[str]:
    """Return the unseen nodes reachable from one, in the order in which a depth-first search leaves them."""
    if start in seen:
        return []
    seen.add(start)
    left, stack = [], [(start, iter(sorted(graph[start])))]
    while stack:
        node, others = stack[-1]
        following = next((other for other in others if other not in seen), None)
        if following is None:
            left.append(node)
            stack.pop()
        else:
            seen.add(following)
            stack.append((following, iter(sorted(graph[following]))))
    return left


def floors(graph: Graph) -> int:
    """Count the components on the longest chain of imports."""
    groups = _components(graph)
    of = {node: k for k, group in enumerate(groups) for node in group}
    height: dict[int, int] = {}
    for k in reversed(range(len(groups))):  # what is imported comes before its importers
        below = {of[other] for node in groups[k] for other in graph[node]} - {k}
        height[k] = 1 + max((height[j] for j in below), default=0)
    return max(height.values(), default=0)


def shortest_cycle(graph: Graph, start: str) -> list[str]:
    """Return the members of a shortest cycle through a node that is in one, from this node on."""
    ways = {start: [start]}
    queue = [start]
    for node in queue:
        for other in sorted(graph[node]):
            if other == start:
                return ways[node]
            if other not in ways:
                ways[other] = [*ways[node], other]
                queue.append(other)
    raise ValueError(f"{start} is in no cycle")


# The contract


def contract_unit(module: Module) -> str:
    """Return the name by which the contract knows a module: `gcode`, `ffcomp.planner`, `ffcomp.__init__`, `studies`."""
    return ".".join(module.parts[:2]) if module.parts[0] == "ffcomp" else module.parts[0]


def layer_of(unit: str) -> int | None:
    """Return the number of a unit's layer, 0 the lowest; None if the contract does not know the unit."""
    return next((k for k, layer in enumerate(LAYERS) if unit in layer), None)


def forbids(importer: str, imported: str) -> str | None:
    """Return why one unit must not import another, None if it may.

    Units without a layer are let pass; they are a problem of their own.
    """
    one, other = importer.split(".")[0], imported.split(".")[0]
    if one in PRODUCT and other in OUTSIDE:
        return f"{other}/ is never imported by the product"
    if other in INDEPENDENT.get(one, ()):
        return f"{one} must not import {other}"
    low, high = layer_of(importer), layer_of(imported)
    if low is not None and high is not None and high > low:
        return f"{importer} (layer {low + 1}) is below {imported} (layer {high + 1})"
    return None


# Reading


def _modules(root: Path) -> Iterator[Module]:
    """Parse all files of the product and of the folders outside it that have a layer."""
    for top in (*PRODUCT, *(name for name in OUTSIDE if layer_of(name) is not None)):
        for file in sorted((root / top).rglob("*.py")):
            path = file.relative_to(root)
            parts = path.with_suffix("").parts
            text = file.read_text(encoding="utf-8")
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            yield Module(name, path.as_posix(), text.count("\n"), text, ast.parse(text, filename=path.as_posix()))


def _unit_below(module: Module, package: str) -> str | None:
    """Return the unit of a package to which a module belongs, None if it is not in this package."""
    above = package.split(".") if package else []
    if len(module.parts) <= len(above) or list(module.parts[: len(above)]) != above:
        return None
    return ".".join(module.parts[: len(above) + 1])


def _imports(module: Module, modules: Mapping[str, Module]) -> Iterator[Import]:
    """Yield the imports of one module that go to the product or to the folders around it."""
    for here in module.nodes:
        for name, line in _imported_names(here.node, module):
            if name.split(".")[0] not in (*PRODUCT, *OUTSIDE):
                continue
            imported = name
            if isinstance(here.node, ast.ImportFrom) and name not in modules:  # `from module import name`
                imported = name.rpartition(".")[0]
                if here.node.level and imported not in modules:  # of a program into which the file is copied
                    continue
            yield Import(module.name, imported, module.path, line, here.lazy, here.typing, imported in modules)


def _nodes(tree: ast.Module) -> list[Node]:
    """List all nodes of a tree, each before its children."""
    found = [Node(tree, False, False)]
    for here in found:  # grows while it is read
        lazy = here.lazy or isinstance(here.node, BODIES)
        guard = here.node if isinstance(here.node, ast.If) and _last_name(here.node.test) == "TYPE_CHECKING" else None
        for child in ast.iter_child_nodes(here.node):
            if not isinstance(child, UNNEEDED):
                found.append(Node(child, lazy, here.typing or (guard is not None and child in guard.body)))
    return found


def _imported_names(node: ast.AST, module: Module) -> Iterator[tuple[str, int]]:
    """Yield the dotted names that a node imports, each with its line; `from a import b` gives `a.b`."""
    if isinstance(node, ast.Import):
        yield from ((alias.name, node.lineno) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        above = module.parts[: len(module.parts) - node.level] if node.level else ()
        base = ".".join([*above, *([node.module] if node.module else [])])
        yield from ((f"{base}.{alias.name}", alias.lineno) for alias in node.names)
    elif isinstance(node, ast.Call) and _last_name(node.func) in ("import_module", "__import__") and node.args:
        name = node.args[0]
        if isinstance(name, ast.Constant) and isinstance(name.value, str):
            yield name.value, node.lineno


def _last_name(node: ast.AST) -> str | None:
    """Return `c` of `c`, `b.c` and `a.b.c`."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else None


def _targets(node: ast.Assign | ast.AnnAssign) -> list[ast.expr]:
    """List what an assignment assigns to."""
    return node.targets if isinstance(node, ast.Assign) else [node.target]


def _defined(body: Iterable[ast.stmt]) -> Iterator[str]:
    """Yield the names of the functions, classes and constants that statements define, also under `if` and `try`."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            for target in _targets(node):
                yield from (n.id for n in ast.walk(target) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
        elif isinstance(node, ast.If | ast.Try | ast.With):
            parts: Iterable[list[ast.stmt]] = [node.body, getattr(node, "orelse", []), getattr(node, "finalbody", [])]
            for part in (*parts, *(handler.body for handler in getattr(node, "handlers", []))):
                yield from _defined(part)


def _kind_switches(module: Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of each place that asks which kind of machine it deals with."""
    if any(word in module.text for word in (*KIND_ATTRIBUTES, *KIND_CLASSES, ".delta")):
        for here in module.nodes:
            if isinstance(here.node, ASKING) and _asks_for_kind(here.node):
                yield here.node.lineno, ast.unparse(here.node)


def _asks_for_kind(node: ast.AST) -> bool:
    """Tell whether a node asks for the kind of a machine."""
    if isinstance(node, ast.Name | ast.Attribute) and _last_name(node) in KIND_ATTRIBUTES:
        return True
    if isinstance(node, ast.keyword):
        return node.arg in KIND_ATTRIBUTES
    if isinstance(node, ast.Attribute):
        return node.attr == "delta" and _last_name(node.value) in MACHINE_NAMES
    if isinstance(node, ast.Call) and _last_name(node.func) in ("isinstance", "issubclass"):
        return any(_names_kind(argument) for argument in node.args[1:])
    if isinstance(node, ast.Compare):
        sides = (node.left, *node.comparators)
        return any(isinstance(s, ast.Call) and _last_name(s.func) == "type" for s in sides) and any(
            map(_names_kind, sides)
        )
    return isinstance(node, ast.MatchClass) and _last_name(node.cls) in KIND_CLASSES


def _names_kind(node: ast.AST) -> bool:
    """Tell whether a class of one kind of machine is named in an expression."""
    return any(_last_name(n) in KIND_CLASSES for n in ast.walk(node))


# Checkouts


@contextmanager
def checkout_at(root: Path, ref: str | None) -> Iterator[Checkout]:
    """Provide the checkout as it is, or one of its commits in a temporary folder."""
    if ref is None:
        yield Checkout(root)
        return
    with tempfile.TemporaryDirectory() as folder:
        there = _git(root, "ls-tree", "--name-only", ref).decode().split("\n")
        wanted = [top for top in (*PRODUCT, *OUTSIDE) if top in there and top != "tests"]
        with tarfile.open(fileobj=io.BytesIO(_git(root, "archive", ref, *wanted))) as archive:
            for member in archive:
                if member.isfile() and (member.name.endswith(".py") or member.name.startswith("ffcomp/")):
                    archive.extract(member, folder, filter="data")
        yield Checkout(Path(folder))


def _git(root: Path, *arguments: str) -> bytes:
    """Return the output of a git command; stop with git's message if it fails."""
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, check=False)
    if done.returncode:
        raise SystemExit(f"structure: git {arguments[0]}: {done.stderr.decode(errors='replace').strip()}")
    return done.stdout


# Output


def _members(groups: list[list[str]]) -> str:
    """Write how many members all cycles have, and in how many cycles."""
    return f"{sum(map(len, groups))} (in {len(groups)})" if groups else "0"


def graph_text(graph: Graph) -> str:
    """Write a graph with one importer a line."""
    return "\n".join(f"{node} -> {', '.join(sorted(others)) or '(none)'}" for node, others in sorted(graph.items()))


def dot_text(graph: Graph) -> str:
    """Write a graph for Graphviz; members of cycles are red."""
    circular = {node for group in cycles(graph) for node in group}
    lines = [f'  "{node}"{" [color=red]" if node in circular else ""};' for node in sorted(graph)]
    lines += [f'  "{node}" -> "{other}";' for node in sorted(graph) for other in sorted(graph[node])]
    return "\n".join(["digraph structure {", "  rankdir=BT; node [shape=box];", *lines, "}"])


def markdown(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Write a table in Markdown with aligned columns."""
    table = [header, *rows]
    widths = [max(len(row[k]) for row in table) for k in range(len(header))]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in table]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


def report(checkout: Checkout, files: bool) -> str:
    """Write the import graph, what breaks the contract, and the measures."""
    graph = {u: others for u, others in checkout.units_of("").items() if u in PRODUCT} | checkout.units_of("ffcomp")
    parts = ["# Imports between packages and units", "", graph_text(graph), ""]
    if files:
        parts += ["# Imports between files", "", graph_text(checkout.file_graph()), ""]
    parts += ["# Cycles", "", *_cycle_lines(checkout), ""]
    problems = checkout.problems()
    parts += [f"# Problems ({len(problems)})", "", *(problems or ["none"]), ""]
    return "\n".join([*parts, "# Measures", "", markdown(("Measure", "Value"), checkout.table())])


def _cycle_lines(checkout: Checkout) -> list[str]:
    """Name the cycles of units and files, with and without the imports for types."""
    lines = []
    for title, typing in (("all imports", True), ("imports for types left out", False)):
        for package, groups in checkout.folder_cycles(typing).items():
            lines += [f"{title}: units of {package or 'the checkout'}: {', '.join(group)}" for group in groups]
        lines += [f"{title}: files: {', '.join(group)}" for group in checkout.file_cycles(typing)]
    return lines or ["none"]


def _twice_text(checkout: Checkout) -> str:
    """List the public names that are defined more than once."""
    return "\n".join(f"{name}: {', '.join(paths)}" for name, paths in checkout.named_twice.items())


def _parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="scripts/structure",
        description="Measure the structure of a checkout: import graph, cycles, forbidden imports, sizes.",
        epilog="The contract (LAYERS) is data at the top of scripts/structure.py.",
    )
    parser.add_argument(
        "root", nargs="?", type=Path, default=Path(__file__).resolve().parents[1], help="checkout to read"
    )
    parser.add_argument("--ref", help="read this commit of the checkout instead of its files")
    modes = parser.add_mutually_exclusive_group()
    modes.add_argument("--check", action="store_true", help="print what breaks the contract; exit 1 if anything does")
    modes.add_argument("--table", action="store_true", help="print the table of measures only")
    modes.add_argument("--compare", metavar="REF", help="print the measures before (REF) and after as Markdown")
    modes.add_argument("--twice", action="store_true", help="list the public names that are defined twice or more")
    modes.add_argument("--dot", action="store_true", help="print the graph of the units for Graphviz")
    modes.add_argument("--files", action="store_true", help="print the imports between files too")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    asked = _parser().parse_args(arguments)
    with checkout_at(asked.root, asked.ref) as checkout:
        if asked.check:
            problems = checkout.problems()
            print(
                "\n".join(
                    [*problems, f"structure: {len(problems)} problems"] if problems else ["structure: no problems"]
                )
            )
            return 1 if problems else 0
        if asked.compare:
            with checkout_at(asked.root, asked.compare) as before:
                pairs = zip(before.table(), checkout.table(), strict=True)
                print(markdown(("Measure", "Before", "After"), ((name, old, new) for (name, old), (_, new) in pairs)))
            return 0
        texts: dict[str, Callable[[], str]] = {
            "table": lambda: markdown(("Measure", "Value"), checkout.table()),
            "twice": lambda: _twice_text(checkout),
            "dot": lambda: dot_text(checkout.units),
        }
        print(
            next((text() for name, text in texts.items() if getattr(asked, name)), None)
            or report(checkout, asked.files)
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
