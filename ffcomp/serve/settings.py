"""The settings of a server."""

from __future__ import annotations

import ipaddress
import secrets
import socket
from dataclasses import dataclass
from pathlib import Path

MEGABYTE = 1 << 20
RESERVE = 300 * MEGABYTE  # free on the disk, whatever comes in: the system and the printer's host need it


@dataclass(frozen=True, slots=True)
class ServeSettings:
    """Settings of one server."""

    folder: Path  # where uploads and jobs are kept
    host: str = "127.0.0.1"  # address to listen on
    port: int = 8017
    jobs: int = 1  # that run at the same time
    largest_bytes: int = 1024 * MEGABYTE  # of a file that is taken
    room_bytes: int = 20 * 1024 * MEGABYTE  # for all files of the folder together
    keep_days: float = 14.0  # after which finished jobs are removed
    names: tuple[str, ...] = ()  # of the server, in addition to those that `guard` knows
    token: str = ""  # that a visitor needs; empty: none
    secure: bool = False  # the server speaks TLS

    @property
    def address(self) -> str:
        """The page's address, as its owner types it."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        shown = f"[{host}]" if ":" in host else host
        return f"{'https' if self.secure else 'http'}://{shown}:{self.port}/"


def is_local(host: str) -> bool:
    """Return whether an address is reachable from this computer only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def kept_token(folder: Path) -> str:
    """Return the folder's token, made once, which nobody else on this computer can read."""
    path = folder / "token"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        path.touch(mode=0o600)
        path.write_text(secrets.token_urlsafe(24), encoding="ascii")
    return path.read_text(encoding="ascii").strip()
