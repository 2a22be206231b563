"""Pass a generator's lines on and keep what it returns."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Stream(Generic[T]):
    """The pieces of a text, and once they have all been read, `value`: what was found on the way."""

    value: T

    def __init__(self, pieces: Generator[bytes, None, T]) -> None:
        self._pieces = pieces

    def __iter__(self) -> Iterator[bytes]:
        self.value = yield from self._pieces
