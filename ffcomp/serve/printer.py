"""The printer's Moonraker: its G-code files, one of them to here, a compensated one back. Nothing is ever started."""

from __future__ import annotations

import json
import os
import re
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

from ffcomp.serve.uploads import Refused

TIMEOUT_S = 30.0
PIECE = 1 << 16
MOST_FILES = 2000
SUFFIX = "_ffcomp"
KEY = "FFCOMP_MOONRAKER_KEY"  # of the environment: Moonraker's API key, where it wants one
_KINDS = (".gcode", ".g", ".gco", ".bgcode", ".gcode.gz")


@dataclass(frozen=True, slots=True)
class Printer:
    """One Moonraker, by its address."""

    url: str

    def files(self) -> list[dict[str, Any]]:
        """Return the prints on the printer, the newest first: `path`, `bytes`, `modified` (s since 1970)."""
        found = self._json("/server/files/list?root=gcodes")
        listed = [
            {"path": str(each["path"]), "bytes": int(each["size"]), "modified": float(each["modified"])}
            for each in found
            if str(each["path"]).lower().endswith(_KINDS)
        ]
        return sorted(listed, key=lambda each: -float(str(each["modified"])))[:MOST_FILES]

    def read(self, path: str) -> Iterator[bytes]:
        """Read a file that the printer lists, piece by piece.

        Raises
        ------
        Refused
            If the printer does not list it.
        """
        if path not in {each["path"] for each in self.files()}:
            raise Refused(404, "The printer has no such file.")
        with self._open(Request(f"{self.url}/server/files/gcodes/{quote(path)}", headers=_key())) as answer:
            while piece := answer.read(PIECE):
                yield piece

    def write(self, source: Path, beside: str) -> str:
        """Put a file beside another one on the printer, under a name of its own, and return its path."""
        folder = PurePosixPath(beside).parent if beside else PurePosixPath(".")
        name = _free_name(source.name, folder, {each["path"] for each in self.files()})
        edge = secrets.token_hex(16)
        fields = {"root": "gcodes", "path": "" if str(folder) == "." else str(folder), "print": "false"}
        head = "".join(
            f'--{edge}\r\nContent-Disposition: form-data; name="{k}"\r\n\r\n{v}\r\n' for k, v in fields.items()
        )
        head += f'--{edge}\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n'
        head += "Content-Type: application/octet-stream\r\n\r\n"
        ends = head.encode(), f"\r\n--{edge}--\r\n".encode()
        size = sum(map(len, ends)) + source.stat().st_size
        headers = {"Content-Type": f"multipart/form-data; boundary={edge}", "Content-Length": str(size)} | _key()
        with self._open(Request(f"{self.url}/server/files/upload", _body(source, *ends), headers)) as answer:
            answer.read(PIECE)
        return str(folder / name)

    def _json(self, path: str) -> Any:
        with self._open(Request(self.url + path, headers=_key())) as answer:
            try:
                return json.loads(answer.read(1 << 24))["result"]
            except (ValueError, KeyError, TypeError):
                raise Refused(502, f"{self.url} does not answer as Moonraker does.") from None

    def _open(self, request: Request) -> Any:
        try:
            return urlopen(request, timeout=TIMEOUT_S)
        except HTTPError as error:
            hint = f" Set its API key in {KEY}." if error.code in (401, 403) else ""
            raise Refused(502, f"The printer answers {error.code} {error.reason}.{hint}") from None
        except (URLError, OSError, ValueError) as error:
            raise Refused(502, f"The printer at {self.url} cannot be reached: {error}.") from None


def _key() -> dict[str, str]:
    return {"X-Api-Key": os.environ[KEY]} if os.environ.get(KEY) else {}


def _body(source: Path, head: bytes, end: bytes) -> Iterator[bytes]:
    yield head
    with open(source, "rb") as file:
        while piece := file.read(PIECE):
            yield piece
    yield end


def _free_name(name: str, folder: PurePosixPath, taken: set[str]) -> str:
    """Return a name that no file of the printer has: the slicer's print stays there as it is."""
    stem, dot, kind = re.sub(r'["\r\n]', "_", name).partition(".")
    names = [f"{stem}{SUFFIX}{number}{dot}{kind}" for number in ("", *range(2, 1000))]
    return next(each for each in names if str(folder / each) not in taken)
