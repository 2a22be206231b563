"""Make pages that are written for GitHub fit the site: a hook of mkdocs (mkdocs.yml)."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from posixpath import normpath
from typing import Any

SOURCES = "https://github.com/ffcomp/ffcomp/blob/main/"
LINK = re.compile(r"(\]\()((?:\.\./)+[^)\s#]*)([^)\s]*\))")
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
    """Indent the lines below an item by four, as this Markdown wants it; GitHub wants as much as its marker takes."""
    lines: list[str] = []
    width, in_fence, loose = 0, False, False  # of the marker, 0 outside a list; the item has paragraphs of its own
    for line in markdown.splitlines():
        if not in_fence and (item := ITEM.match(line)):
            if lines and lines[-1] and (loose or not width):
                lines.append("")
            width, loose = len(item[0]), False
        elif width and line.startswith(" " * width):
            loose = loose or not lines[-1]
            line = "    " + line[width:]
        elif width and line and not in_fence:
            width = 0
        if FENCE.match(line):
            in_fence = not in_fence
        lines.append(line)
    return "\n".join(lines) + "\n"
