"""`ffcomp restore`: the original print, read out of a compensated one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.cli.help import OUTPUT

if TYPE_CHECKING:
    from gcode.container import Container


def restore(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Compensated print. Changed in place unless -o is given.")
    ],
    output_file: Annotated[
        Path | None,
        typer.Option("--output-file", "-o", metavar="FILE", rich_help_panel=OUTPUT, help="Write here instead."),
    ] = None,
) -> None:
    """Restore the original of a compensated print, byte for byte.

    Example: ffcomp restore out.gcode -o original.gcode
    """
    from ffcomp.cli.common import exit_codes, say

    with exit_codes():
        from gcode.atomic_write import replacing, unchanged
        from gcode.container import opened

        still_the_same = unchanged(file)
        with opened(file) as container:
            texts = _originals(container, file)
            with replacing(output_file or file) as target:
                container.write(target, texts)
                still_the_same()
        say(f"ffcomp: the original is in {output_file or file}.")


def _originals(container: Container, file: Path) -> list[Iterator[bytes]]:
    """Each print as it was."""
    from ffcomp.errors import NothingToDo
    from gcode.container import blocks_of, ends_of
    from gcode.embedded import original_blocks
    from gcode.stamp import find_stamp

    prints = container.prints.values()
    stamped = [find_stamp(*ends_of(text)[:2]) is not None for text in prints]
    if not any(stamped):
        raise NothingToDo(f"{file}: not compensated by ffcomp; nothing to restore.")
    found = zip(prints, stamped, strict=True)
    return [original_blocks(blocks_of(text)) if ours else blocks_of(text) for text, ours in found]
