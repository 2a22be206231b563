"""A NumPy archive that grows: arrays are appended to on disk, and become one `.npz` at the end."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.lib import format as npy
from numpy.typing import DTypeLike, NDArray

from gcode.atomic_write import replace_atomically

_BLOCK_BYTES = 1 << 20


class Column:
    """One array under way, in a nameless file that vanishes with the process."""

    def __init__(self, dtype: DTypeLike, folder: Path) -> None:
        self.dtype, self.length = np.dtype(dtype), 0
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - `close` closes it

    def append(self, values: NDArray[Any]) -> None:
        """Append values (n,) of the column's type, or one that fits into it."""
        self._file.write(np.ascontiguousarray(values, dtype=self.dtype).data)
        self.length += len(values)

    def npy(self) -> Iterator[bytes]:
        """Yield the bytes of its `.npy` file."""
        yield _header(self.dtype, (self.length,))
        self._file.seek(0)
        while block := self._file.read(_BLOCK_BYTES):
            yield block

    def close(self) -> None:
        """Give up the gathered values."""
        self._file.close()


class TextColumn:
    """An array of byte strings under way, as wide as the longest one."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - `close` closes it
        self._length, self._width = 0, 1

    def append(self, line: bytes) -> None:
        """Append a line without its line ending."""
        self._file.write(line + b"\n")
        self._length += 1
        self._width = max(self._width, len(line))

    def npy(self) -> Iterator[bytes]:
        """Yield the bytes of its `.npy` file."""
        yield _header(np.dtype(f"S{self._width}"), (self._length,))
        self._file.seek(0)
        for line in self._file:
            yield line[:-1].ljust(self._width, b"\0")

    def close(self) -> None:
        """Give up the gathered lines."""
        self._file.close()


def _header(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    head = io.BytesIO()
    description = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    npy.write_array_header_1_0(head, description)
    return head.getvalue()


def number_npy(value: float) -> Iterator[bytes]:
    """Return the bytes of a `.npy` file that holds one number."""
    yield _header(np.dtype(np.float64), ())
    yield np.float64(value).tobytes()


def write_archive(target: Path, members: Mapping[str, Iterator[bytes]]) -> None:
    """Arrays, each as the bytes of a `.npy` file, into one archive, which is replaced whole or not at all."""
    replace_atomically(target, _zipped(members))


def _zipped(members: Mapping[str, Iterator[bytes]]) -> Iterator[bytes]:
    out = _Drain()
    with zipfile.ZipFile(cast(IO[bytes], out), "w", zipfile.ZIP_STORED) as archive:
        for name, blocks in members.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                for block in blocks:
                    member.write(block)
                    yield from out.taken()
    yield from out.taken()


class _Drain:
    """A file that can only be written: what was written is taken away."""

    def __init__(self) -> None:
        self._blocks: list[bytes] = []

    def write(self, block: bytes) -> int:
        self._blocks.append(bytes(block))
        return len(block)

    def flush(self) -> None:
        """Nothing is kept back."""

    def taken(self) -> list[bytes]:
        blocks, self._blocks = self._blocks, []
        return blocks
