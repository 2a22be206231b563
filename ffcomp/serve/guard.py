"""Who may ask: the names of the server, the origin of a request, the token; and what a browser may do with the answers.

A page of another site can make a visitor's browser send requests to this computer. It cannot choose their `Origin`, nor
send the header MARK without asking first, which is never granted. A name of its own that it lets point here (DNS
rebinding) stands in `Host`: there only addresses and known names pass.
"""

from __future__ import annotations

import hmac
import ipaddress
import socket
from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import suppress
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from ffcomp.serve.settings import ServeSettings

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

MARK = "x-ffcomp"
COOKIE = "ffcomp_token"
SAFE = ("GET", "HEAD")
REPORT = "/api/jobs/"  # below it stand pages with scripts of their own


def known_host(host: str, settings: ServeSettings) -> bool:
    """Return whether `Host` is an address or one of the server's names; see the module."""
    name = ""
    with suppress(ValueError):  # no host, or no address
        name = (urlsplit(f"//{host}").hostname or "").lower()
        ipaddress.ip_address(name)
        return True
    this = socket.gethostname().lower()
    return name in {"localhost", this, f"{this}.local", settings.host.lower(), *map(str.lower, settings.names)}


def refusal(method: str, headers: dict[str, str], settings: ServeSettings) -> tuple[int, str] | None:
    """Return the status and the sentence of a request that is refused for where it comes from; None if it may pass."""
    host, origin = headers.get("host", ""), headers.get("origin")
    if not known_host(host, settings):
        remedy = f"Use its address, or start it with --name {host.split(':')[0]}."
        return 421, f"This server is not called {host!r}. {remedy}"
    if method in SAFE:
        return None
    if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
        return 403, "The request comes from another page than this server's own."
    if MARK not in headers:
        return 403, f"The request lacks the header {MARK}."
    return None


def token_of(headers: dict[str, str]) -> str:
    """Return the token that a request carries, as a cookie or as `Authorization: Bearer`; empty without one."""
    kind, _, token = headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return token.strip()
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return cookie.value if cookie else ""


def matches(token: str, settings: ServeSettings) -> bool:
    """Compare a token in constant time."""
    return not settings.token or hmac.compare_digest(token.encode(), settings.token.encode())


def policy(path: str) -> str:
    """Return the Content-Security-Policy of a page: nothing is fetched from elsewhere, and no other page frames it."""
    if path.startswith(REPORT):  # it has a policy itself, and is kept from this server's own interface
        return "sandbox allow-scripts allow-popups; frame-ancestors 'self'"
    return (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
    )


class Guard:
    """The outermost layer: refuses forbidden requests, and adds the headers of every answer."""

    def __init__(self, app: App, settings: ServeSettings) -> None:
        self.app, self.settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        headers = {key.decode("latin-1").lower(): value.decode("latin-1") for key, value in scope["headers"]}
        refused = refusal(scope["method"], headers, self.settings)
        if refused is None and not matches(token_of(headers), self.settings):
            if await self._let_in(scope, send):
                return
            refused = 401, "This server needs its token: open the address that it printed when it started."
        if refused is not None:
            await _say(send, *refused)
            return
        await self.app(scope, receive, self._with_headers(scope["path"], send))

    async def _let_in(self, scope: Scope, send: Send) -> bool:
        """Turn the token of the printed address into a cookie, so that it stays in no history."""
        token = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if scope["path"] != "/" or not token or not matches(token, self.settings):
            return False
        secure = "; Secure" if self.settings.secure else ""
        cookie = f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict; Max-Age=31536000{secure}"
        headers = [(b"location", b"/"), (b"set-cookie", cookie.encode("latin-1")), (b"cache-control", b"no-store")]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})
        return True

    def _with_headers(self, path: str, send: Send) -> Send:
        added = {
            b"content-security-policy": policy(path).encode(),
            b"x-content-type-options": b"nosniff",
            b"referrer-policy": b"no-referrer",
            b"cross-origin-resource-policy": b"same-origin",
            b"cache-control": b"no-store",
        }

        async def forward(message: Message) -> None:
            if message["type"] == "http.response.start":
                kept = [each for each in message["headers"] if each[0].lower() not in added]
                message["headers"] = [*kept, *added.items()]
            await send(message)

        return forward


async def _say(send: Send, status: int, sentence: str) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"x-content-type-options", b"nosniff")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": sentence.encode()})
