"""The report of `ffcomp compare`: verdict, figures, page, and the page in a real browser.

The print is invented: squares in three layers, whose corners start decaying waves across the next side. Then every
number in the report has a closed form.
"""

from __future__ import annotations

import base64
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.comparison import words as parts
from ffcomp.comparison.engine import _settings
from ffcomp.comparison.result import Comparison, EqualQuality, Party, Peaks, Samples, Spread
from ffcomp.comparison.sentences import answer_of, cautions, findings
from ffcomp.comparison.sentences import worth as answer
from ffcomp.comparison.words import duration, times
from ffcomp.inverse.robust import RobustChoice
from ffcomp.inverse.settings import settings_for
from ffcomp.numerics.digits import um
from ffcomp.report.compare import drawings, write_figures, write_report
from ffcomp.report.drawing import svg
from ffcomp.report.page import said as as_html
from ffcomp.simulation.expectation import Expectation
from gcode.dialect import KLIPPER, MARLIN
from models.file import load_machine
from tests.support.browser import Visit, chromium, visit
from tests.support.comparison import (
    LAYERS,
    NASTY,
    SIDE_N,
    changed,
    comparison,
    everything,
    method,
    samples,
    whole_page,
)


def verdict(found: Comparison) -> list[str]:
    """What was found and what to mind, in the order of importance."""
    said = [sentence for _, sentence in findings(found)]
    return [*said[:2], *cautions(found), *said[2:]]


# ---- words and verdict ---------------------------------------------------------------------------


def test_numbers_are_short_and_times_have_names() -> None:
    assert [um(x) for x in (0.314, 9.994, 9.996, 62.34, 99.96, 415.9)] == ["0.31", "9.99", "10.0", "62.3", "100", "416"]
    assert um(math.nan) == "–"
    assert [times(x) for x in (6.04, 9.96, 107.7)] == ["6.0 times", "10 times", "108 times"]
    assert [duration(x) for x in (48.4, 842, 3599.7, 11100)] == ["48 s", "14 min 02 s", "1 h 00 min", "3 h 05 min"]


def test_good_news_and_what_they_rest_on() -> None:
    said = verdict(comparison())
    assert "100 times less" in said[0] and "Where plastic flows" in said[0]
    assert "10 times as much as ffcomp" in said[1] and "x 40.0 Hz, y 41.0 Hz" in said[1]
    assert "own resonance test" in said[1]
    assert "The whole print was evaluated, 6 s." in said
    assert "exactly the parameters of the machine file" in said[-1] and "expect larger errors" in said[-1]


def test_bad_news_are_told_as_plainly() -> None:
    said = verdict(comparison(none_um=10.0, best_um=5.0, ours_um=30.0))
    assert "makes this print worse, do not use it here" in said[0]
    assert "Use the shaper." in said[1]
    hard = changed(comparison(none_um=10.0, best_um=5.0, ours_um=30.0), "mzv", peaks=Peaks(250.0, 1.5e4, True))
    assert "if the carriages can do 15,000 mm/s² (15 m/s²), where ffcomp needs 6,000 mm/s²" in verdict(hard)[1]
    assert "no difference worth the trouble" in verdict(comparison(none_um=10.0, ours_um=9.8))[0]
    assert "the same as ffcomp" in verdict(comparison(best_um=2.0))[1]


def test_the_answer_on_top() -> None:
    yes = str(answer(comparison()))
    assert yes.startswith(
        "Worth it? Yes: at your 5,000 mm/s² (5 m/s²) ffcomp leaves 0.39 µm, the best input shaper (MZV)"
    )
    assert "and none 39.0, where plastic flows." in yes
    assert (
        answer(comparison(best_um=3.0)).word == "Hardly" and "a shaper is enough" in answer(comparison(best_um=3.0)).why
    )
    assert answer(comparison(best_um=2.0)).why.endswith(
        "is as good on this print, where plastic flows: 0.39 µm against 0.39."
    )
    assert answer(comparison(best_um=1.0)).word == "No"
    assert answer(changed(comparison(), "fbs-lpv", peaks=Peaks(250.0, 4.5e4, False))).word == "No"
    assert "your" not in answer(comparison(acceleration_mm_per_s2=None)).why
    fast = changed(comparison(), "fbs-lpv", equal_quality=EqualQuality(4e4, 300.0, 20.0, capped=True))
    fast = changed(fast, "mzv", equal_quality=EqualQuality(2e3, 500.0, 24.9, capped=False))
    said = "within 25 µm up to 40,000 mm/s² (40 m/s²) and more, the fastest shaper (MZV) up to 2,000 mm/s² (2 m/s²)."
    assert answer(fast).why.endswith(said)


def test_the_answer_on_top_is_for_printers_that_are_off() -> None:
    """By the file's uncertainty; with Monte-Carlo plants, by these."""
    errors = 41.0, 12.0, 8.0
    expected = Expectation(0.2, True, 20, 16.0, *errors, "EI, x 40.0 Hz, y 41.0 Hz", "A shaper.", "Measure first: so.")
    off = replace(comparison(), expected=expected)
    assert answer(off).word == "No" and "8.00 µm against 12.0." in answer(off).why
    assert "±20 % (assumed)" in answer(off).why and "EI, x 40.0 Hz" in answer(off).why
    for name, mean in (("none", 40.0), ("mzv", 20.0), ("fbs-lpv", 5.0)):
        off = changed(off, name, spread=Spread((mean - 1.0, mean + 1.0)))
    assert answer(off).word == "Yes" and "ffcomp leaves 5.00 µm, the best input shaper (MZV) 20.0" in answer(off).why


def test_a_variant_of_a_shaper_is_named_as_such() -> None:
    found = changed(comparison(), "mzv", label="MZV, z too, best fixed")
    assert "the best input shaper (MZV, z too)" in str(answer(found))
    assert "The best fixed input shaper (MZV, z too, x 40.0 Hz, y 41.0 Hz)" in verdict(found)[1]


def test_a_third_method_that_is_better_than_ours_is_named() -> None:
    found = comparison(ours_um=4.0)
    found = replace(found, methods={**found.methods, "fbs-lti": method("fbs-lti", "ffcomp, one", "inversion", 2.0)})
    assert any("ffcomp, one has the lowest error" in sentence for sentence in verdict(found))
    assert not any("has the lowest error" in sentence for sentence in verdict(comparison()))


def test_a_file_that_is_inverted_robustly_by_default_is_judged_by_that_row() -> None:
    assert not any("robust" in sentence for sentence in verdict(comparison()))
    plain = comparison()
    rows = {
        "fbs-lpv": replace(plain.methods["fbs-lpv"], label="ffcomp, plain"),
        "fbs-robust": method("fbs-robust", "ffcomp", "inversion", 4.0),
    }
    choice = RobustChoice(True, "Robust inversion: why.")
    found = replace(plain, methods={**plain.methods, **rows}, compensated="fbs-robust", robust=choice)
    said = " ".join(verdict(found))
    assert "has the lowest error" not in said
    assert (
        "50 times less" in said
        and "Robust inversion: why. The plain inverse (“ffcomp, plain”) leaves 0.39 µm here" in said
    )
    assert "ffcomp leaves 0.78 µm" in str(answer(found))


def test_errors_by_layer_and_feature_are_those_of_the_tiles() -> None:
    found = comparison()
    for of, own in ((parts.layer_errors, found.methods["mzv"]), (parts.feature_errors, found.methods["none"])):
        each = list(of(found, own).values())  # type: ignore[operator]
        whole = sum(error.share * error.rms_um**2 for error in each) ** 0.5
        assert whole == pytest.approx(own.extruding.contour_rms_um) and sum(e.share for e in each) == pytest.approx(1)
    travel = replace(found.methods["mzv"].samples, extruding=np.zeros(len(samples(1.0).due), dtype=bool))
    still = changed(changed(found, "mzv", samples=travel), "fbs-lpv", samples=travel)
    assert set(parts.layer_errors(still, still.methods["mzv"])) == set(range(LAYERS))


def test_of_a_print_for_marlin_it_is_said_whose_ends_are_on_whole_steps() -> None:
    machine = load_machine("mp-delta-pro")
    marlin, klipper = (replace(comparison(), settings=_settings(settings_for(machine), f)) for f in (MARLIN, KLIPPER))
    assert any("No other row has that rounding" in sentence for sentence in verdict(marlin))
    assert not any("motor steps" in sentence for sentence in verdict(klipper))


def test_limits_and_warnings_are_in_the_verdict() -> None:
    beyond = Peaks(250.0, 4.5e4, False)
    said = " ".join(verdict(changed(comparison(), "fbs-lpv", peaks=beyond, warnings=("Too fast here.",))))
    assert "45,000 mm/s² (45 m/s²), more than the machine file allows (300 mm/s, 20,000 mm/s² (20 m/s²))" in said
    assert "Too fast here." in said
    assert "Beyond the limits of the carriages" in " ".join(verdict(changed(comparison(), "mzv", peaks=beyond)))
    assert "allows" not in " ".join(verdict(comparison()))


def test_assumed_modes_are_said_once_for_the_machine_and_its_plant() -> None:
    guess = "The modes of a delta are assumed."
    assumed = Party("a delta", "12" * 32, assumed=guess)
    assert verdict(comparison(machine=assumed, plant=assumed)).count(guess) == 1
    assert verdict(comparison(plant=Party("another", "34" * 32, assumed=guess))).count(guess) == 1
    assert guess not in verdict(comparison())


def test_another_plant_is_named_with_its_effects() -> None:
    said = verdict(comparison(plant=Party("a worn delta", "34" * 32, ("friction", "backlash"))))[-1]
    assert "a worn delta, with friction, backlash" in said and "exactly the parameters" not in said


@pytest.mark.parametrize(
    ("ours", "tail"),
    [
        ((2.0, 3.0), None),
        ((2.0, 14.0), "On average ffcomp is ahead or level, at worst the shaper is better."),
        ((25.0, 30.0), "With such an uncertainty the shaper is better: measure the machine first."),
    ],
)
def test_mismatch_says_who_wins(ours: tuple[float, ...], tail: str | None) -> None:
    found = changed(comparison(mismatch="two plants"), "fbs-lpv", spread=Spread(ours))
    found = changed(found, "mzv", spread=Spread((8.0, 12.0)), retuned=Spread((6.0, 11.0)))
    (said,) = (sentence for sentence in verdict(found) if sentence.startswith("On 2 printers"))
    assert "10.0 and 12.0 µm with MZV, best fixed, as tuned; 8.50 and 11.0 µm with MZV tuned again on each" in said
    assert said.endswith(tail or "on each.")


def test_equal_quality_capped_reached_and_missed() -> None:
    found = changed(comparison(), "fbs-lpv", equal_quality=EqualQuality(4e4, 300.0, 20.0, capped=True))
    found = changed(found, "mzv", equal_quality=EqualQuality(2e3, 500.0, 24.9, capped=False))
    found = changed(found, "mzv-calibrated", equal_quality=EqualQuality(5e3, 400.0, 24.9, capped=False))
    found = changed(found, "none", equal_quality=EqualQuality(250.0, 4000.0, 60.0, capped=False, reached=False))
    (said,) = (sentence for sentence in verdict(found) if "must stay below 25 µm" in sentence)
    assert "ffcomp keeps it even at 40,000 mm/s² (40 m/s²)" in said
    assert "the fastest shaper (MZV, calibrated) keeps it up to 5,000 mm/s² (5 m/s²) (whole print 6 min 40 s)" in said
    assert "no compensation misses it even at 250 mm/s² (0.25 m/s²)" in said
    assert said.endswith("With ffcomp that is 25 % less print time than with the shaper.")


def _cut(s: Samples, count: int) -> Samples:
    return Samples(**{name: getattr(s, name)[:count] for name in Samples.__dataclass_fields__})


# ---- figures and page ----------------------------------------------------------------------------


def test_figures_come_as_png_and_svg_and_say_what_they_are_of(tmp_path: Path) -> None:
    written = write_figures(everything(), tmp_path)
    names = ("close-up", "errors-by-layer", "errors-by-feature", "methods", "mismatch", "equal-quality", "print-times")
    assert {path.name for path in written} == {f"{name}.{form}" for name in names for form in ("png", "svg")}
    assert sorted(written) == sorted(tmp_path.iterdir())
    for path in written:
        if path.suffix == ".png":
            assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000
        else:
            assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_figures_of_what_was_not_asked_for_are_missing() -> None:
    names = [each.name for each in drawings(comparison())]
    assert names == ["close-up", "errors-by-layer", "errors-by-feature", "methods"]


def test_the_same_numbers_give_the_same_figure() -> None:
    first = drawings(comparison())[1]
    assert svg(first) == svg(first)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("report") / "report.html"
    target.write_bytes(whole_page())
    return target


@pytest.fixture(scope="module")
def nasty_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every text that a file can give is an attack."""
    found = replace(
        everything("folder/<img src=x onerror=alert(1)>.gcode"),
        machine=Party(f"$x_1$ {NASTY}", "12" * 32, (NASTY,)),
        plant=Party(NASTY, "34" * 32, (NASTY,)),
        features=("other", f"</script>{NASTY}", "$\\frac{"),
        settings={NASTY: NASTY},
    )
    found = changed(found, "mzv", label=f"MZV {NASTY}", tuning=NASTY, warnings=(NASTY,))
    for key, judged in found.methods.items():
        found = changed(found, key, by_feature=dict(zip(found.features[1:], judged.by_feature.values(), strict=True)))
    target = tmp_path_factory.mktemp("nasty") / "report.html"
    write_report(found, target)
    return target


def test_the_page_names_what_it_is_of_and_nothing_of_the_folders(page: Path) -> None:
    text = page.read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
    for expected in ("square.gcode", "a delta", "121212121212", "9.8.7", "ab" * 32, "8 plants, each off by 10 %."):
        assert expected in text
    assert "prints/" not in text and str(page.parent) not in text


def test_what_is_to_be_typed_is_code_and_stays_on_one_line() -> None:
    said = as_html("Say `ffcomp show <b>` or --mismatch 10% (--only fbs-robust), no-one; well--known.")
    assert str(said) == (
        "Say <code>ffcomp show &lt;b&gt;</code> or <code>--mismatch</code> 10% (<code>--only</code> fbs-robust), "
        "no-one; well--known."
    )


def test_the_page_has_the_words_of_the_terminal_and_of_json(page: Path) -> None:
    text = unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8"))).replace("\N{NO-BREAK SPACE}", " ")
    told = answer_of(everything())
    for sentence in (told.headline, *told.warnings, *told.next_steps, *(value for _, value in told.facts)):
        assert sentence.replace("`", "") in text


def test_the_page_fetches_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    images = [base64.b64decode(each).decode() for each in re.findall(r"base64,([A-Za-z0-9+/=]+)", text)]
    assert len(images) == 7
    for content in (text, *images):
        fetched = re.findall(r"""(?:src|href)\s*=\s*["']?([^"'\s>]+)|url\(([^)]+)\)|@import""", content)
        assert all(re.match(r"data:|#|$", one or other) for one, other in fetched), fetched
        assert "<script" not in content or content is text


def test_text_from_files_is_escaped(nasty_page: Path) -> None:
    text = nasty_page.read_text(encoding="utf-8")
    assert "alert(1)" in text and "<script>alert" not in text and "<img src=x" not in text


def test_a_failed_report_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "report.html"
    target.write_text("old")
    for failure in (KeyboardInterrupt, RuntimeError):

        def stop(drawing: Any, failure: type[BaseException] = failure) -> bytes:
            raise failure

        monkeypatch.setattr("ffcomp.report.page.svg", stop)
        with pytest.raises(failure):
            write_report(comparison(), target)
        assert [path.name for path in tmp_path.iterdir()] == ["report.html"] and target.read_text() == "old"


def _shortened(found: Comparison, count: int) -> Comparison:
    for name, each in found.methods.items():
        s = _cut(each.samples, count)
        short = method(name, each.label, each.family, 0.0, samples=s)
        found = changed(found, name, samples=s, by_layer=short.by_layer, by_feature=short.by_feature)
    return replace(found, layers=found.layers[:1])


def test_odd_comparisons_have_a_page_too(tmp_path: Path) -> None:
    """A few samples; a print without plastic or error; our method alone as the best; no limits known."""
    found = _shortened(comparison(limits={}), 12)
    still = replace(samples(0.0), extruding=np.zeros(4 * LAYERS * SIDE_N, dtype=bool))
    for name in found.methods if (dry := comparison(best_fixed="fbs-lpv")) else ():
        dry = changed(dry, name, samples=still, **_numbers(still))
    for k, odd in enumerate((found, dry)):
        write_report(odd, tmp_path / f"{k}.html")
    text = (tmp_path / "1.html").read_text(encoding="utf-8")
    assert "No plastic flows in the evaluated part" in text and "Errors, all moves" in text


def _numbers(s: Samples) -> dict[str, Any]:
    again = method("", "", "none", 0.0, samples=s)
    return {name: getattr(again, name) for name in ("track", "extruding", "by_layer", "by_feature")}


# ---- in a browser --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


def clean(seen: Visit) -> bool:
    return not seen.errors and not seen.requests


def test_narrow_screens_need_no_sideways_scrolling(browser: Any, page: Path) -> None:
    with visit(browser, page, 390, 800) as seen:
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= 390
        assert clean(seen), (seen.errors, seen.requests)


def test_nothing_from_a_file_is_executed(browser: Any, nasty_page: Path) -> None:
    with visit(browser, nasty_page) as seen:
        assert "alert(1)" in seen.page.locator("h1").inner_text()
        assert clean(seen), (seen.errors, seen.requests)
