"""Text of files that people edit on any system: any line ends, UTF-8 or Latin-1."""

from __future__ import annotations

from pathlib import Path

from ffcomp.importers.values import PrinterConfigError

LARGEST_BYTES = 16_000_000  # a configuration has some kilobytes, a day's terminal log some megabytes


def decoded(path: Path) -> str:
    r"""Read a file's text, with lines ending in \n.

    Raises
    ------
    PrinterConfigError
        For a file that holds no text, or far too much of it.
    """
    if path.stat().st_size > LARGEST_BYTES:
        raise PrinterConfigError(f"{path}: a printer configuration has at most {LARGEST_BYTES // 10**6} MB.")
    data = path.read_bytes()
    if b"\0" in data:
        place = data.index(b"\0")
        raise PrinterConfigError(f"{path}: byte {place} is zero; a printer configuration is a text file.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # only comments and names hold such letters
    return text.replace("\r\n", "\n").replace("\r", "\n")
