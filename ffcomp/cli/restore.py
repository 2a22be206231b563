"""`ffcomp restore`: the original print, read out of a compensated one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from ffcomp.cli.command import verb
from ffcomp.numerics.serialise import keys
from ffcomp.request import OUTPUT, Argument, Option, Request
from ffcomp.result import Result

if TYPE_CHECKING:
    from gcode.container import Container


@dataclass(frozen=True)
class RestoreRequest(Request):
    """What `ffcomp restore` is to restore."""

    file: Annotated[Path, Argument("Compensated print. Changed in place unless -o is given.", metavar="FILE")]
    output: Annotated[Path | None, Option("Write here instead.", OUTPUT, "--output -o", metavar="FILE")] = None


@verb
def restore(request: RestoreRequest) -> Result:
    """Restore the original of a compensated print, byte for byte.

    Example: ffcomp restore out.gcode -o original.gcode
    """
    from gcode.atomic_write import replacing, unchanged
    from gcode.container import opened

    file, output = request.file, request.output or request.file
    still_the_same = unchanged(file)
    with opened(file) as container:
        texts = _originals(container, file)
        with replacing(output) as target:
            container.write(target, texts)
            still_the_same()
    return Restored(file, output)


@dataclass(frozen=True, eq=False, repr=False)
class Restored(Result):
    """An original that was restored."""

    schema = "ffcomp-restore/1"
    json_keys: ClassVar = keys("input", "output")

    input: Path
    output: Path

    @property
    def headline(self) -> str:
        """Where it is."""
        return f"The original is in {self.output}."


def _originals(container: Container, file: Path) -> list[Iterator[bytes]]:
    from ffcomp.errors import NothingToDo
    from gcode.container import blocks_of, ends_of
    from gcode.embedded import find_stamp, original_blocks

    prints = container.prints.values()
    stamped = [find_stamp(*ends_of(text)[:2]) is not None for text in prints]
    if not any(stamped):
        raise NothingToDo(f"{file}: not compensated by ffcomp; nothing to restore.")
    return [
        original_blocks(blocks_of(text)) if ours else blocks_of(text)
        for text, ours in zip(prints, stamped, strict=True)
    ]
