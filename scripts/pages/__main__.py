"""Write the pages of the docs that are made from the code.

    python -m scripts.pages            name the pages that differ from the code; exit with 1 if any does
    python -m scripts.pages --write    write them

Pictures take longer and have their own commands: `python -m scripts.pages.effects`, `python -m scripts.pages.gallery`.
"""

from __future__ import annotations

import sys

from scripts.pages import cli, dialects, effects, json_objects, machine_file


def main(arguments: list[str]) -> None:
    stale = []
    for made in (cli, dialects, effects, json_objects, machine_file):
        text = made.page()
        if made.PAGE.read_text(encoding="utf-8") != text:
            stale.append(made.PAGE.name)
            if arguments == ["--write"]:
                made.PAGE.write_text(text, encoding="utf-8")
    print(f"Changed: {', '.join(stale)}." if stale else "Every page is up to date.")
    if stale and arguments != ["--write"]:
        sys.exit(1)


if __name__ == "__main__":
    main(sys.argv[1:])
