"""Write the pages of the docs that are made from the code.

    python -m scripts.pages            name the pages that differ from the code; exit with 1 if any does
    python -m scripts.pages --write    write them

Pictures take longer and have their own commands: `python -m scripts.pages.effects`, `python -m scripts.pages.gallery`.
"""

from __future__ import annotations

import sys
from pathlib import Path

from scripts.pages import cli, dialects, effects, json_objects, machine_file, tables


def made() -> dict[Path, str]:
    """Return the text of every page that is made from the code, or has tables that are."""
    of_modules = {each.PAGE: each.page() for each in (cli, dialects, effects, json_objects, machine_file)}
    return of_modules | tables.pages()


def main(arguments: list[str]) -> None:
    stale = []
    for path, text in made().items():
        if path.read_text(encoding="utf-8") != text:
            stale.append(path.name)
            if arguments == ["--write"]:
                path.write_text(text, encoding="utf-8")
    print(f"Changed: {', '.join(stale)}." if stale else "Every page is up to date.")
    if stale and arguments != ["--write"]:
        sys.exit(1)


if __name__ == "__main__":
    main(sys.argv[1:])
