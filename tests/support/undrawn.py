"""Figures that are composed and not drawn, for tests of what stands around them."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import IO

EMPTY = {  # pictures of one point or none
    "png": base64.b64decode(
        b"iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEAsTj2FAAAAABJRU5ErkJggg=="
    ),
    "svg": b'<svg xmlns="http://www.w3.org/2000/svg"><defs></defs></svg>',
    "pdf": b"%PDF-1.4\n%%EOF\n",
}


def save_nothing(_: object, target: str | Path | IO[bytes], **options: object) -> None:
    """Write an empty picture, in place of `Figure.savefig`."""
    empty = EMPTY[str(options.get("format", "png"))]
    if isinstance(target, str | Path):
        Path(target).write_bytes(empty)
    else:
        target.write(empty)
