"""docs/reference/json.md as something that objects can be held against: which keys there are, and of which type."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HEADING = re.compile(r"#+ (ffcomp-[\w-]+/\d+|[A-Z]+)$")
ROW = re.compile(r"\| `([^`]+)` \| ([^|]+?) \|")
PART = re.compile(r"\[\]|[^.\[]+")
OPTIONAL = ", may be missing"
SAME_KEYS = "…"
SCALARS: dict[str, tuple[type, ...]] = {
    "text": (str,),
    "number": (int, float),
    "whole number": (int,),
    "boolean": (bool,),
    "null": (type(None),),
    "list": (list,),
    "number and null": (int, float, type(None)),
}


@dataclass
class Node:
    """One key, or what stands in a list (`[]`) or under a name (`*`)."""

    place: str = ""
    type: str = ""  # as the page says it; empty: an object or a list whose parts have rows
    optional: bool = True
    parts: dict[str, Node] = field(default_factory=dict)


class Page:
    """Every object of the page, by name, and which of its keys have been met."""

    def __init__(self, path: Path) -> None:
        self.objects: dict[str, Node] = {}
        self.met: set[str] = set()
        current = Node()
        for line in path.read_text(encoding="utf-8").splitlines():
            if heading := HEADING.match(line):
                current = self.objects[heading[1]] = Node(heading[1])
            elif line.startswith("#"):
                current = Node()
            elif row := ROW.match(line):
                _add(current, row[1], row[2])

    def problems(self, value: Any, name: str) -> list[str]:
        """What is wrong with an object of this name, against the page."""
        met: set[str] = set()
        found = list(self._of_object(value, self.objects[name], met))
        self.met |= met
        return found

    def not_met(self, name: str) -> list[str]:
        """Keys of an object, and of those it names, that no value had yet; other schemas have tests of their own."""
        waiting, known = [name], set[str]()
        while waiting:
            known.add(now := waiting.pop())
            named = set(re.findall(r"\b[A-Z]+\b", " ".join(node.type for node in _nodes(self.objects[now]))))
            waiting += named - known
        nodes = [node for each in sorted(known) for node in _nodes(self.objects[each])]
        return [
            node.place for node in nodes if node.type and node.place not in self.met and SAME_KEYS not in node.place
        ]

    def _of_object(self, value: Any, node: Node, met: set[str]) -> Iterator[str]:
        if not isinstance(value, dict):
            yield f"{node.place} is {value!r}, not an object"
            return
        parts = self._parts(node)
        for key, part in parts.items():
            if key != "*" and key not in value and not part.optional:
                yield f"{part.place} is missing"
        for key, each in value.items():
            known = parts.get(key, parts.get("*"))
            if known is None:
                yield f"{node.place} {key} is not on the page"
            else:
                yield from self._of(each, known, met)

    def _parts(self, node: Node) -> dict[str, Node]:
        """With those of the object that stands here too."""
        parts = dict(node.parts)
        same = parts.pop(SAME_KEYS, None)
        return parts if same is None else {**self._parts(self.objects[same.type]), **parts}

    def _of(self, value: Any, node: Node, met: set[str]) -> Iterator[str]:
        if not node.type and node.optional and value is None:
            return
        if not node.type and "[]" in node.parts:
            if not isinstance(value, list):
                yield f"{node.place} is {value!r}, not a list"
                return
            for each in value:
                yield from self._of(each, node.parts["[]"], met)
        elif not node.type:
            yield from self._of_object(value, node, met)
        else:
            yield from self._of_type(value, node, met)

    def _of_type(self, value: Any, node: Node, met: set[str]) -> Iterator[str]:
        told = []
        for alternative in node.type.replace("true or false", "boolean").split(" or "):
            also: set[str] = set()
            told = list(self._of_alternative(value, alternative, node, also))
            if not told:
                met |= {node.place, *also}
                return
        yield from told

    def _of_alternative(self, value: Any, kind: str, node: Node, met: set[str]) -> Iterator[str]:
        if kind in self.objects:
            yield from self._of_object(value, self.objects[kind], met)
        elif not _fits(value, kind):
            yield f"{node.place} is {value!r:.60}, not {node.type}"


def _add(node: Node, key: str, kind: str) -> None:
    root = node.place
    for part in PART.findall(key):
        node = node.parts.setdefault(part, Node(f"{root} {key}"))
    node.type, node.optional = kind.removesuffix(OPTIONAL), kind.endswith(OPTIONAL)


def _nodes(node: Node) -> Iterator[Node]:
    yield node
    for part in node.parts.values():
        yield from _nodes(part)


def _fits(value: Any, kind: str) -> bool:
    kind = re.sub(r"(list|number|null)s\b", r"\1", kind)
    if kind.startswith("list of "):
        return isinstance(value, list) and all(_fits(each, kind.removeprefix("list of ")) for each in value)
    return isinstance(value, SCALARS[kind]) and (kind == "boolean" or not isinstance(value, bool))
