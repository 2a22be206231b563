"""The printer's Moonraker: its G-code files, one of them to here, a compensated one back. Nothing is ever started."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import httpx

from ffcomp.serve.uploads import Refused

TIMEOUT_S = 30.0
PIECE = 1 << 16
FILES = "/server/files"
MOST_FILES = 2000
SUFFIX = "_ffcomp"
KEY = "FFCOMP_MOONRAKER_KEY"  # of the environment: Moonraker's API key, where it wants one
_KINDS = (".gcode", ".g", ".gco", ".bgcode", ".gcode.gz")


@dataclass(frozen=True, slots=True)
class PrinterFile:
    """A print on the printer."""

    path: str
    bytes: int
    modified: float  # s since 1970


@dataclass(frozen=True, slots=True)
class Printer:
    """One Moonraker, by its address."""

    url: str

    def files(self) -> list[PrinterFile]:
        """Return the prints on the printer, the newest first."""
        listed = [
            PrinterFile(str(each["path"]), int(each["size"]), float(each["modified"]))
            for each in self._listed()
            if str(each["path"]).lower().endswith(_KINDS)
        ]
        return sorted(listed, key=lambda each: -each.modified)[:MOST_FILES]

    def read(self, path: str) -> Iterator[bytes]:
        """Read a file that the printer lists, piece by piece.

        Raises
        ------
        Refused
            If the printer does not list it.
        """
        if path not in {each.path for each in self.files()}:
            raise Refused(404, "The printer has no such file.")
        with self._answers(), self._client() as client, client.stream("GET", f"{FILES}/gcodes/{quote(path)}") as answer:
            answer.raise_for_status()
            yield from answer.iter_bytes(PIECE)

    def write(self, source: Path, beside: str) -> str:
        """Upload a file to the folder of another one on the printer, under a new name, and return its path."""
        folder = PurePosixPath(beside).parent if beside else PurePosixPath(".")
        name = _free_name(source.name, folder, {each.path for each in self.files()})
        fields = {"root": "gcodes", "path": "" if str(folder) == "." else str(folder), "print": "false"}
        with self._answers(), self._client() as client, open(source, "rb") as file:
            client.post(f"{FILES}/upload", data=fields, files={"file": (name, file)}).raise_for_status()
        return str(folder / name)

    def _listed(self) -> Any:
        with self._answers(), self._client() as client:
            answer = client.get(f"{FILES}/list", params={"root": "gcodes"}).raise_for_status()
            try:
                return answer.json()["result"]
            except (ValueError, KeyError, TypeError):
                raise Refused(502, f"{self.url} does not answer as Moonraker does.") from None

    def _client(self) -> httpx.Client:
        key = {"X-Api-Key": os.environ[KEY]} if os.environ.get(KEY) else {}
        return httpx.Client(base_url=self.url, headers=key, timeout=TIMEOUT_S, follow_redirects=True)

    @contextmanager
    def _answers(self) -> Iterator[None]:
        """Turn an HTTP failure into a sentence."""
        try:
            yield
        except httpx.HTTPStatusError as error:
            code, reason = error.response.status_code, error.response.reason_phrase
            hint = f" Set its API key in {KEY}." if code in (401, 403) else ""
            raise Refused(502, f"The printer answers {code} {reason}.{hint}") from None
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise Refused(502, f"The printer at {self.url} cannot be reached: {error}.") from None


def _free_name(name: str, folder: PurePosixPath, taken: set[str]) -> str:
    """Return a name that no file of the printer has: the slicer's print is not replaced."""
    stem, dot, kind = re.sub(r'["\r\n]', "_", name).partition(".")
    names = [f"{stem}{SUFFIX}{number}{dot}{kind}" for number in ("", *range(2, 1000))]
    return next(each for each in names if str(folder / each) not in taken)
