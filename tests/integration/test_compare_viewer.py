"""The page of `ffcomp compare` in a browser: the viewer's controls, the table at any width, and its colours."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.report import drawing as style
from models.arrays import FloatArray
from tests.support.browser import Visit, chromium, contrast, hard_to_read, linear, visit
from tests.support.comparison import READY, whole_page

METHODS = (style.BEFORE, style.AFTER, style.SHAPER, style.CALIBRATED, style.SCHEDULED, style.BEYOND)
LINES = 3.0  # least contrast with the ground of what is no word (WCAG 2.1)
CUT = """() => [...document.querySelectorAll(".sortable td, .sortable th")].filter((e) => {
  const box = e.getBoundingClientRect();
  return box.width && (box.right > innerWidth || box.left < 0 || e.scrollWidth > e.clientWidth + 1);
}).map((e) => e.textContent)"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("viewer") / "report.html"
    target.write_bytes(whole_page())
    return target


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


def text_of(seen: Visit, role: str) -> str:
    return str(seen.page.locator(f"[data-role={role}]").inner_text())


def test_the_filter_leaves_one_feature_and_tells_its_numbers(browser: Any, page: Path) -> None:
    with visit(browser, page, ready=READY) as seen:
        options = seen.page.locator("[data-role=feature] option").all_inner_texts()
        assert options == ["all features", "External perimeter", "Perimeter"]  # what is seen comes first
        every = seen.shot("canvas")
        seen.page.locator("[data-role=feature]").select_option(label="External perimeter")
        assert seen.shot("canvas") != every
        assert re.search(
            r"Whole print, External perimeter.*µm rms: no compensation [\d.]+ · MZV", text_of(seen, "label")
        )
        assert not seen.errors


def test_the_move_slider_stops_the_nozzle_and_tells_its_speed(browser: Any, page: Path) -> None:
    with visit(browser, page, ready=READY) as seen:
        assert text_of(seen, "now") == "all moves"
        every = seen.shot("canvas")
        seen.page.locator("[data-role=layer]").fill("1")
        seen.page.locator("[data-role=move]").fill("400")
        found = re.match(r"([\d.]+) s · (\d+) mm/s · (External p|P)erimeter · [\d.]+ µm", text_of(seen, "now"))
        assert found is not None and float(found[2]) == pytest.approx(80.0, abs=3.0)
        assert 2.0 < float(found[1]) < 4.0  # of the second of three layers of 2 s each
        assert seen.shot("canvas") != every and not seen.errors


def test_what_was_not_evaluated_and_travel_come_and_go(browser: Any, page: Path) -> None:
    with visit(browser, page, ready=READY) as seen:
        shots = [seen.shot("canvas")]
        for name in ("not evaluated", "travel"):
            seen.page.get_by_role("button", name=name, exact=True).click()
            shots.append(seen.shot("canvas"))
        seen.page.locator("[data-role=width]").fill("5")
        shots.append(seen.shot("canvas"))
        assert len(set(shots)) == 4 and not seen.errors


def test_an_error_is_never_drawn_larger_than_a_twentieth_of_the_part(browser: Any, page: Path) -> None:
    with visit(browser, page, ready=READY) as seen:
        slider = seen.page.locator("[data-role=exaggeration]")
        slider.focus()
        slider.press("End")
        drawn = re.search(r"up to ([\d.]+) mm", text_of(seen, "times"))
        assert drawn is not None and 1.0 < float(drawn[1]) <= 0.05 * 40.0 + 0.005


def test_two_fingers_zoom_and_one_turns(browser: Any, page: Path) -> None:
    with visit(browser, page, 390, 800, READY) as seen:
        seen.page.locator("canvas").scroll_into_view_if_needed()
        box = seen.page.locator("canvas").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        touch = seen.page.context.new_cdp_session(seen.page)
        touch.send("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})

        def gesture(*steps: list[tuple[float, float]]) -> bytes:
            for k, places in enumerate(steps):
                points = [{"x": x + dx, "y": y + dy, "id": j} for j, (dx, dy) in enumerate(places)]
                kind = "touchStart" if k == 0 else "touchMove"
                touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
            touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
            return seen.shot("canvas")

        shots = [seen.shot("canvas"), gesture([(-60, 0)], [(-20, 0)], [(40, 0)])]
        apart = [[(-20.0 - 15 * k, 0.0), (20.0 + 15 * k, 0.0)] for k in range(4)]
        shots.append(gesture(*apart))
        assert len(set(shots)) == 3 and not seen.errors


@pytest.mark.parametrize("width", [1400, 1100, 390])
def test_the_table_is_never_cut(browser: Any, page: Path, width: int) -> None:
    with visit(browser, page, width, 900, READY) as seen:
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
        assert seen.page.evaluate(CUT) == []
        assert seen.page.locator(".sortable tbody td").nth(0).get_attribute("data-short") == "25 µm up to"
        if width < 1240:
            seen.page.locator(".more input").check()
            assert seen.page.evaluate(CUT) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_are_readable(browser: Any, page: Path, scheme: str) -> None:
    with visit(browser, page, ready=READY) as seen:
        seen.page.emulate_media(color_scheme=scheme)
        assert not hard_to_read(seen)


# ---- colours -------------------------------------------------------------------------------------


def oklab(colour: Any) -> FloatArray:
    """Björn Ottosson's Oklab (2020), in which equal distances look equally far apart."""
    cones = [
        [0.41222147, 0.53633254, 0.05144599],
        [0.2119035, 0.6806995, 0.10739696],
        [0.08830246, 0.28171884, 0.6299787],
    ]
    lab = [
        [0.21045426, 0.79361779, -0.00407205],
        [1.9779985, -2.42859221, 0.45059371],
        [0.02590404, 0.78277177, -0.80867577],
    ]
    return np.asarray(np.array(lab) @ np.cbrt(np.array(cones) @ linear(colour)))


@pytest.mark.parametrize("on_dark", [False, True])
def test_no_colour_means_two_things_and_every_line_shows(on_dark: bool) -> None:
    own = [style.ON_DARK[each] if on_dark else each for each in METHODS]
    ground = style.ON_DARK[style.PAPER] if on_dark else style.PAPER
    ramp = [style.error_colours(on_dark)(k / 20) for k in range(21)]
    assert min(contrast(each, ground) for each in own + ramp) >= LINES
    assert min(float(np.linalg.norm(oklab(a) - oklab(b))) for a, b in combinations(own, 2)) > 0.1
    assert min(float(np.linalg.norm(oklab(a) - oklab(b))) for a in own for b in ramp) > 0.1
    steps = [contrast(each, ground) for each in ramp]
    assert steps == sorted(steps)  # the worse, the more it stands out, for the colour-blind too
