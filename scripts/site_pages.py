"""Make pages that are written for GitHub fit the site: a hook of mkdocs (mkdocs.yml)."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from posixpath import normpath
from typing import Any

SOURCES = "https://github.com/ffcomp/ffcomp/blob/main/"
LINK = re.compile(r"(\]\()((?:\.\./)+[^)\s#]*)([^)\s]*\))")
NESTED = re.compile(r"^(?P<indent> {2,3})(?P<text>(?:```|\||[-*] |\S).*)$")
ITEM = re.compile(r"^(\d+\.|[-*]) ")
FENCE = re.compile(r"^ *```")


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Point links that leave the folder of pages to the sources, and indent what belongs to an item of a list."""
    return indented(with_sources(markdown, PurePosixPath(page.file.src_uri)))


def with_sources(markdown: str, page: PurePosixPath) -> str:
    """Let links to files outside the pages lead to the repository."""

    def lead(link: re.Match[str]) -> str:
        target = normpath((PurePosixPath("docs") / page.parent / link[2]).as_posix())
        inside = target.startswith("docs/") and not target.startswith("docs/examples")
        return link[0] if inside else link[1] + SOURCES + target + link[3]

    return LINK.sub(lead, markdown)


def indented(markdown: str) -> str:
    """Indent the lines below an item by four, as this Markdown wants it; GitHub wants two or three."""
    lines, in_item, in_fence = [], False, False
    for line in markdown.splitlines():
        if ITEM.match(line) and not in_fence:
            if lines and lines[-1] and not in_item:
                lines.append("")
            in_item = True
        elif in_item and (nested := NESTED.match(line)):
            line = "    " + line[len(nested["indent"]) :]
        elif in_item and line and not line.startswith(" ") and not in_fence:
            in_item = False
        if FENCE.match(line):
            in_fence = not in_fence
        lines.append(line)
    return "\n".join(lines) + "\n"
