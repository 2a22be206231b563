"""`ffcomp restore`: the original print, read out of a compensated one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from ffcomp.cli.command import verb
from ffcomp.numerics.serialise import keys
from ffcomp.request import OUTPUT, Argument, Option, Request
from ffcomp.result import Result


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
    from ffcomp.errors import NothingToDo
    from gcode.atomic_write import replacing, unchanged
    from gcode.container import blocks_of, ends_of, opened
    from gcode.embedded import find_stamp, original_blocks

    file, output = request.file, request.output or request.file
    still_the_same = unchanged(file)
    with opened(file) as container:
        prints = container.prints.values()
        stamped = [find_stamp(*ends_of(text)[:2]) is not None for text in prints]
        if not any(stamped):
            raise NothingToDo(f"{file}: not compensated by ffcomp; nothing to restore.")
        blocks = zip(map(blocks_of, prints), stamped, strict=True)
        texts = [original_blocks(text) if ours else text for text, ours in blocks]
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
