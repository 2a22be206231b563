"""`ffcomp restore`: the original print, read out of a compensated one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def restore(
    file: Annotated[Path, typer.Argument(help="A compensated print; changed in place unless -o is given.")],
    output_file: Annotated[Path | None, typer.Option("--output-file", "-o", help="Write here instead.")] = None,
) -> None:
    """Undo a compensation: every line of the original is still in the file."""
    from ffcomp.cli.common import exit_codes, fail, say

    with exit_codes():
        from ffcomp.job import already_processed
        from ffcomp.writer import original_lines
        from gcode.container import read_bytes, replace_atomically

        data = read_bytes(file)
        if already_processed(data) is None:
            fail(f"{file}: not compensated by ffcomp; nothing to restore.", 3)
        replace_atomically(output_file or file, original_lines(data.splitlines(keepends=True)))
        say(f"ffcomp: the original is in {output_file or file}.")
