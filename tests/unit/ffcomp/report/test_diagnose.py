"""`ffcomp diagnose --report`: short runs of the virtual printer, few candidates, and the page that comes of it."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import dataclass, replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.diagnosis import problems, verb, words
from ffcomp.diagnosis.next_experiment import Separation
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import Gap
from ffcomp.diagnosis.verb import Diagnosis
from ffcomp.diagnosis.where import DrawnResidual, ResidualSize, Split
from ffcomp.identification.uncertainty import normal
from ffcomp.report import diagnose as pages
from ffcomp.report.diagnose import diagnosis_page, stands_out
from models.effects.catalogue import with_effect
from models.file import LIBRARY, load_machine
from models.printer.printer import simulate_printer
from tests.support.browser import chromium, visit
from tests.support.cli import CliRunner
from tests.support.undrawn import save_nothing

RATE_HZ, SECONDS, NOISE = 1600.0, 1.2, 0.3
PLACES = {"centre": (0.0, 0.0, 30.0), "left": (-70.0, 20.0, 30.0), "front": (40.0, -60.0, 30.0)}
PROPOSAL = Separation(
    ("coulomb_friction",), ("guide_damping",), 0.1, 40.0, "loop", (0.0, 0.0, 30.0), "ffcomp record plan", "G1 X1"
)


def write_machine(folder: Path) -> Path:
    """Two numbers may be retuned, and little: the search is quick, and retuning cannot pass for an effect."""
    file, text = folder / "my-delta.toml", (LIBRARY / "mp-delta-pro.toml").read_text(encoding="utf-8")
    before, _, after = text.partition("[uncertainty]\n")
    known = '"carriage.belt_stiffness_n_per_m" = 0.003\n"effector.nozzle_mass_kg" = 0.003\n'
    rest = after[after.index("[provenance]") :]
    file.write_text(f"{before}[uncertainty]\ndefault = 0.0\n{known}\n{rest}", encoding="utf-8")
    return file


def write_runs(folder: Path, hidden: dict[str, dict[str, Any]]) -> list[str]:
    """Two repeats at each of three places: towers shaken by tones between 5 and 120 Hz."""
    true = machine = load_machine("mp-delta-pro")
    for name, table in hidden.items():
        true = with_effect(true, name, **table)
    rng, paths = np.random.default_rng(7), []
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    for name, place in PLACES.items():
        f = rng.uniform(5, 120, (8, 3))
        tones = np.sum(0.8 / f * np.sin(2 * np.pi * f * t[:, None, None] + 6.28 * f), axis=1)
        command = machine.kinematics.inverse(np.array([place])) + tones * np.minimum(1.0, t / 0.2)[:, None]
        motion = simulate_printer(true, command, 1 / RATE_HZ, substeps=2)
        felt = np.hstack([motion.signals.carriage, motion.signals.nozzle])
        for repeat in (1, 2):
            table = np.column_stack([t, command, felt + NOISE * rng.standard_normal(felt.shape)])
            paths.append(folder / f"{name}-{repeat}.csv")
            header = ["t_s", *(f"cmd_{a}_mm" for a in "ABC"), *(f"acc_{a}_m_per_s2" for a in "ABCxyz")]
            np.savetxt(paths[-1], table, fmt="%.9g", delimiter=",", header=",".join(header), comments="")
    return [str(path) for path in paths]


def run(runs: list[str], *options: str) -> Any:
    machine = str(Path(runs[0]).parent / "my-delta.toml")
    return CliRunner().invoke(app, ["diagnose", *runs, "-m", machine, "--json", "-q", *options])


@dataclass(frozen=True, eq=False)
class Case:
    folder: Path
    runs: list[str]
    result: dict[str, Any]
    text: str
    told: Diagnosis
    where: DrawnResidual


def made(folder: Path, hidden: dict[str, dict[str, Any]], names: tuple[str, ...], *, drawn: bool = False) -> Case:
    """Through the verb, with few candidates: the search is not what is tested here.

    drawn : whether its figures are, too; two pages of three are about words
    """
    write_machine(folder)
    runs, report, told = write_runs(folder, hidden), folder / "d.html", []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problems, "PrinterProblem", lambda plant, runs, _: PrinterProblem(plant, runs, names))
        patch.setattr(pages, "diagnosis_page", lambda *given: told.extend(given) or diagnosis_page(*given))
        patch.setattr(verb, "separations", lambda *_, nearest=False: [PROPOSAL] if nearest else [])
        if not drawn:
            patch.setattr("matplotlib.figure.Figure.savefig", save_nothing)
        answer = run(runs, "-o", str(folder / "better.toml"), "--report", str(report))
    assert answer.exit_code == 0, answer.output
    result = json.loads(answer.stdout)
    assert result["report"] == str(report)
    return Case(folder, runs, result, report.read_text(encoding="utf-8"), *told[:2])


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> Case:
    hidden = {"effector_mass": {"added_kg": 0.08}}
    return made(tmp_path_factory.mktemp("heavy"), hidden, ("effector_mass", "guide_damping"), drawn=True)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return made(tmp_path_factory.mktemp("plain"), {}, ("effector_mass", "guide_damping"))


@pytest.fixture(scope="module")
def strange(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Guides that hold back more, and a heavier effector is the only candidate."""
    hidden = {"guide_damping": {"added_n_s_per_m": 20.0}}
    return made(tmp_path_factory.mktemp("strange"), hidden, ("effector_mass",))


@pytest.fixture
def found_already(plain: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """The verb without its search: the picture and the answer of a case that was searched before."""
    monkeypatch.setattr(verb, "diagnose", lambda *_: plain.told.search)
    monkeypatch.setattr(verb, "result_of", lambda *_: plain.told.result)
    monkeypatch.setattr("ffcomp.diagnosis.where.drawn_residual", lambda *_: plain.where)
    monkeypatch.setattr(verb, "separations", lambda *_, **__: [])


# ---- the page and the JSON -----------------------------------------------------------------------


def plain_text(text: str) -> str:
    """What is read, without figures and tags."""
    body = re.sub(r'src="data:[^"]*"|<style>.*?</style>', "", text, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", body))).replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.parametrize(("name", "said"), [("heavy", "effects"), ("plain", "none"), ("strange", "unknown")])
def test_the_page_says_what_the_json_says(name: str, said: str, request: pytest.FixtureRequest) -> None:
    case: Case = request.getfixturevalue(name)
    assert case.result["verdict"] == said
    read, answer = plain_text(case.text), case.result["answer"]
    assert f"verdict: {said}" in read
    for sentence in (answer["headline"], *answer["warnings"]):
        assert sentence.replace("`", "") in read
    for name, value in answer["facts"]:
        assert name in ("Report", "Better file") or value in read
    assert (case.folder / "better.toml").exists() == (said == "effects")


def test_an_effect_is_told_with_its_size_and_what_it_explains(heavy: Case) -> None:
    read = plain_text(heavy.text)
    assert "effector_mass.added_kg" in read and "better.toml" in read
    assert f"are {words.percent(heavy.result['gap']['held_out']['after'])} off" in read
    assert "Left out of the fit" in read and PROPOSAL.sentence() in read


def test_nothing_missing_is_told(plain: Case) -> None:
    read = plain_text(plain.text)
    assert "Nothing is missing: the gap of" in read and "none was needed" in read
    assert "Left out of the fit" not in read


def test_an_unknown_gap_names_what_was_refused_and_why(strange: Case) -> None:
    read = plain_text(strange.text)
    assert "nothing known explains it" in read and "Not explained" in read
    assert {each["against"] for each in strange.result["residual_curves"]} >= {"speed"}
    assert (
        "Look for something loose" in read
        and "Do not add the nearest effect" in read
        and "Missing from the machine file:" not in read
    )


def test_every_candidate_and_every_file_is_there(heavy: Case) -> None:
    read = plain_text(heavy.text)
    for name in ("effector_mass", "guide_damping"):
        assert name in read
    assert len(re.findall(r"(?:centre|left|front)-\d\.csv sha256:[0-9a-f]{64}", read)) == 6
    assert re.search(r"my-delta\.toml sha256:[0-9a-f]{64}", read)
    assert str(heavy.folder) not in heavy.text  # folders are nobody's business


def test_the_page_fetches_nothing_and_runs_nothing(heavy: Case, plain: Case, strange: Case) -> None:
    for text in (heavy.text, plain.text, strange.text):
        assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'\"" in text
        images = [base64.b64decode(each).decode() for each in re.findall(r"base64,([A-Za-z0-9+/=]+)", text)]
        assert len(images) >= 5 + 2
        for content in (text, *images):
            assert "<script" not in content
            fetched = re.findall(r"""(?:src|href)\s*=\s*["']?([^"'\s>]+)|url\(([^)]+)\)|@import""", content)
            assert all(re.match(r"data:|#", one or other) for one, other in fetched), fetched
        assert re.findall(r"https?://", text) == []


def test_every_figure_has_words(heavy: Case) -> None:
    alternatives = re.findall(r'<img [^>]*alt="([^"]*)"', heavy.text)
    assert len(alternatives) == heavy.text.count("<img ") and all(len(alt) > 15 for alt in alternatives)
    captions = re.findall(r"<figcaption><b>([^<]+)</b>([^<]+)", heavy.text)
    assert len(captions) >= 5 + 2 and all(said.strip().endswith(".") for _, said in captions)


# ---- files ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("undrawn")
def test_an_existing_report_is_refused_before_the_work_and_replaced_with_force(
    plain: Case, found_already: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    old = tmp_path / "old.html"
    old.write_text("old")
    with monkeypatch.context() as patch:
        patch.setattr(verb, "result_of", lambda *_: pytest.fail("it went to work"))
        answer = run(plain.runs, "--report", str(old))
    assert answer.exit_code == 2 and "exists already" in answer.output and old.read_text() == "old"
    answer = run(plain.runs, "--report", str(old), "--force")
    assert answer.exit_code == 0, answer.output
    assert old.read_text(encoding="utf-8").startswith("<!doctype html>")


@pytest.mark.parametrize("given", ["no/such/d.html", "."])
def test_what_cannot_be_written_is_said_at_once(given: str, plain: Case, tmp_path: Path) -> None:
    answer = run(plain.runs, "--report", str(tmp_path / given))
    assert answer.exit_code == 2 and "names a file" in re.sub(r"[\s│]+", " ", answer.output)
    assert list(tmp_path.iterdir()) == []


def test_one_file_cannot_be_both(plain: Case, tmp_path: Path) -> None:
    same = str(tmp_path / "both")
    answer = run(plain.runs, "--report", same, "-o", same)
    assert answer.exit_code == 2 and "is named twice" in answer.output


def test_nothing_is_written_when_the_page_fails(
    heavy: Case, found_already: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fails(drawing: object) -> bytes:
        raise RuntimeError("no room")

    monkeypatch.setattr(verb, "result_of", lambda *_: heavy.told.result)
    monkeypatch.setattr("ffcomp.report.page.svg", fails)
    targets = ["-o", str(tmp_path / "better.toml"), "--report", str(tmp_path / "d.html")]
    assert str(run(heavy.runs, *targets).exception) == "no room"
    assert list(tmp_path.iterdir()) == []


# ---- sentences -----------------------------------------------------------------------------------


def split(before: list[float], **about: Any) -> Split:
    count = len(before)
    given: dict[str, Any] = {"title": "signal", "labels": tuple("abcdefgh"[:count]), "weight": (1 / count,) * count}
    return Split(before=tuple(before), after=(0.0,) * count, **(given | about))


def test_what_stands_out() -> None:
    assert stands_out(split([30.0, 1.0, 1.0, 1.0])) == "91 % of the excess lies in a (25 % of the data)."
    assert stands_out(split([5.0, 6.0, 5.0, 5.0])) == "Nothing stands out: all signals have their part."
    assert stands_out(split([5.0, 6.0, 0.1, 5.0])) == "It is everywhere but in c."
    assert stands_out(split([0.02, -0.05, 0.01])) == "No excess here: the error is as large as the noise."
    assert stands_out(split([8.0])) == "There is only one: a, where the error is 3.0 times the noise."


def test_bands_in_a_row_are_named_as_one() -> None:
    bands = {"title": "frequency", "spans": ((1.0, 10.0), (10.0, 20.0), (20.0, 30.0), (30.0, 40.0)), "unit": "Hz"}
    assert stands_out(split([0.1, 9.0, 9.9, 0.1], **bands)).startswith("99.0 % of the excess lies at 10-30 Hz (50 %")
    apart = split([9.0, 0.1, 0.1, 9.1], **bands)  # two humps: the higher one, and no more than it holds
    assert stands_out(apart).startswith("50 % of the excess lies at 30-40 Hz (25 %")


def test_numbers_in_words() -> None:
    assert [words.digits(x) for x in (0.0801, 4.5, 63.21, 4010.2, 0.0)] == ["0.0801", "4.50", "63.2", "4010", "0"]
    assert [words.percent(x) for x in (0.0049, 0.034, 0.37, 1.29)] == ["0.49 %", "3.4 %", "37 %", "129 %"]
    assert [words.most_of(x) for x in (0.5, 0.99, 0.9996)] == ["50 %", "99.0 %", "more than 99.9 %"]
    assert words.interval(normal(3.288, 0.01), "N") == "3.288 N (90 %: 3.272 to 3.304)"
    assert [words.evidence(x) for x in (-0.2, 74.4, 6.6e8, -6.2e7)] == ["0", "74", "6.6·10⁸", "-6.2·10⁷"]
    assert [words.joined(list(x)) for x in ("", "a", "ab", "abc")] == ["", "a", "a and b", "a, b and c"]


def gap(before: ResidualSize, after: ResidualSize) -> Gap:
    return Gap(before=before, after=after, elsewhere=(before.nrms, after.nrms))


def test_shares_of_the_gap_are_of_what_stands_above_the_noise() -> None:
    assert gap(ResidualSize(0.5, 0.3), ResidualSize(0.3, 0.3)).explained == 1.0
    assert gap(ResidualSize(0.5, 0.3), ResidualSize(0.5, 0.3)).explained == 0.0
    assert gap(ResidualSize(0.5, 0.3), ResidualSize(0.34, 0.3)).explained == pytest.approx(1 - 0.0256 / 0.16)
    assert gap(ResidualSize(0.3, 0.3), ResidualSize(0.3, 0.3)).explained == 0.0


# ---- odd outcomes --------------------------------------------------------------------------------


def test_the_splits_say_what_the_search_found(heavy: Case) -> None:
    found = heavy.where
    titles = [each.title for each in found.splits]
    assert titles[:3] == ["frequency", "signal", "place"] and len(titles) == 5
    for each in found.splits:
        assert sum(each.weight) == pytest.approx(1.0)
        whole = np.dot(each.before, each.weight)
        assert whole == pytest.approx(np.dot(found.splits[0].before, found.splits[0].weight), rel=0.15)
        assert max(each.after) < 0.2 * max(each.before)
    assert heavy.told.result.gap.explained_elsewhere > 0.95


def test_text_from_files_is_escaped(heavy: Case) -> None:
    nasty = '"><script>alert(1)</script>$x_1$'
    where = heavy.where
    signals = replace(where.splits[1], labels=tuple(nasty for _ in where.splits[1].labels))
    splits = (where.splits[0], signals, *where.splits[2:])
    overlays = tuple(replace(each, recording=nasty) for each in where.overlays)
    proposal = replace(PROPOSAL, command=nasty, gcode=nasty)
    text = diagnosis_page(heavy.told, replace(where, splits=splits, overlays=overlays), [proposal]).decode()
    assert "alert(1)" in text and "<script" not in text


def test_narrow_screens_need_no_sideways_scrolling(heavy: Case) -> None:
    with chromium() as browser:
        for width in (390, 1280):
            with visit(browser, heavy.folder / "d.html", width) as seen:
                assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
                assert not seen.errors and not seen.requests
