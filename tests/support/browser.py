"""A real browser without a window, to look at pages that ffcomp writes."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@contextmanager
def chromium() -> Iterator[Any]:
    """The browser; the test is skipped where there is none."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip(f"No Chromium here (looked for {', '.join(NAMES)}): pages are not opened.")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pages are not opened.")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=program, args=ARGUMENTS)
        yield browser
        browser.close()


@dataclass
class Visit:
    """One page, and what went wrong on it."""

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)  # to anything but this file

    def console(self, line: Any) -> None:
        if line.type in ("error", "warning"):
            self.errors.append(line.text)

    def dialog(self, dialog: Any) -> None:
        self.errors.append(f"dialog: {dialog.message}")
        dialog.dismiss()

    def request(self, url: str, own: str) -> None:
        if not url.startswith((own, "data:")):
            self.requests.append(url)

    def shot(self, selector: str) -> bytes:
        """PNG of one element, once everything asked for is drawn."""
        self.page.wait_for_timeout(180)  # the viewer draws finely 120 ms after the last movement
        return bytes(self.page.locator(selector).screenshot())


@contextmanager
def visit(browser: Any, path: Path, width: int = 1200, height: int = 900, ready: str = "body") -> Iterator[Visit]:
    """The page opened, as soon as `ready`, a CSS selector, finds something."""
    page = browser.new_page(viewport={"width": width, "height": height})
    seen = Visit(page)
    page.on("pageerror", lambda error: seen.errors.append(str(error)))
    page.on("console", seen.console)
    page.on("dialog", seen.dialog)
    page.on("request", lambda sent: seen.request(sent.url, path.as_uri()))
    page.goto(path.as_uri())
    page.wait_for_selector(ready)
    yield seen
    page.close()
