"""docs/reference/cli.md, as cyclopts writes it from `ffcomp --help`, with a head of its own."""

from __future__ import annotations

import re
from pathlib import Path

from ffcomp.cli.app import app

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "cli.md"

HEAD = """\
# Command line

Written by `python -m scripts.pages --write` from `ffcomp --help`; a test compares them.

All verbs:

- A **machine** is a name (`ffcomp machines list`) or the path of a TOML file ([its format](machine_file.md)). A name
  that ends in `.toml` or contains a folder separator is a path. Your own machine folder goes before the library.
- A **print** may be `.gcode`, `.gcode.gz`, `.gcode.3mf` or `.bgcode`. The content decides, not the name.
- **Results** go to stdout, messages and progress to stderr. `--json` prints one object ([every key](json.md));
  `--quiet` hides progress, not the result.
- A file to write must be in a folder that exists, and must not be a file that the verb reads. A verb that has `--force`
  overwrites files with this option only. Otherwise it exits with 2 before any work, as for a missing file.
- Every run returns one of a few [exit codes](files.md#exit-codes) and adds to the log described there.
- Options may come before or after the files. Repeat an option to give several values: `--at 0,0 --at 40,0`.
"""


def page() -> str:
    """Return the page."""
    text = app.generate_docs(output_format="markdown", flatten_commands=True, heading_level=2)
    text = re.sub("^(ffcomp --[a-z-]+) .*$", r"\1", text, flags=re.MULTILINE)  # without the words of this call
    text = re.sub("#ffcomp-(version|log-path)", r"#ffcomp---\1", text)
    text = text.replace("```console", "```text")  # usage, not an example to run
    verbs = re.sub("^Example: (.*)$", r"Example: `\1`", text[text.index("## Table of Contents") :], flags=re.MULTILINE)
    return f"{HEAD}\n{verbs.rstrip()}\n"
