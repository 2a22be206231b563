"""A real browser without a window, to look at pages that ffcomp writes."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib.colors
import numpy as np
import pytest

from models.arrays import FloatArray

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
    "--disable-extensions",
    "--renderer-process-limit=1",  # all pages are our own: a process for each takes a sixth of the time
    "--disable-site-isolation-trials",
    "--disable-features=IsolateOrigins,site-per-process",
]


TEXT = """() => [...document.querySelectorAll("main *, header *")].filter((e) =>
  e.checkVisibility() && [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())).map((e) => {
  let ground = e;
  while (ground && /, 0\\)$|transparent/.test(getComputedStyle(ground).backgroundColor)) ground = ground.parentElement;
  const under = getComputedStyle(ground || document.documentElement).backgroundColor;
  return [getComputedStyle(e).color, under, e.textContent.trim().slice(0, 40)];
})"""
WORDS = 4.5  # least contrast of words with the ground (WCAG 2.1)


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


@contextmanager
def visit(browser: Any, path: Path | str, width: int = 1200, height: int = 900, ready: str = "body") -> Iterator[Visit]:
    """The page opened, a file or an address, as soon as `ready`, a CSS selector, finds something."""
    own = path if isinstance(path, str) else path.as_uri()
    page = browser.new_page(viewport={"width": width, "height": height})
    seen = Visit(page)
    page.on("pageerror", lambda error: seen.errors.append(str(error)))
    page.on("console", seen.console)
    page.on("dialog", seen.dialog)
    page.on("request", lambda sent: seen.request(sent.url, own))
    page.goto(own)
    page.wait_for_selector(ready)
    yield seen
    page.close()


# ---- colours -------------------------------------------------------------------------------------


def hard_to_read(seen: Visit) -> dict[str, float]:
    """Words whose contrast with the ground is too low, by what they say."""
    found = {(rgb(ink), rgb(ground)): text for ink, ground, text in seen.page.evaluate(TEXT)}
    assert len(found) > 3
    return {text: round(contrast(*pair), 2) for pair, text in found.items() if contrast(*pair) < WORDS}


def rgb(text: str) -> tuple[float, ...]:
    """`rgb(1, 2, 3)` of a browser."""
    return tuple(float(part) / 255 for part in re.findall(r"[\d.]+", text)[:3])


def linear(colour: Any) -> FloatArray:
    c = np.array(matplotlib.colors.to_rgb(colour))
    return np.asarray(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4))


def contrast(one: Any, other: Any) -> float:
    low, high = sorted(float(linear(each) @ [0.2126, 0.7152, 0.0722]) for each in (one, other))
    return (high + 0.05) / (low + 0.05)
