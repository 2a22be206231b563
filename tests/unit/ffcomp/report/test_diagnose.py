"""`ffcomp diagnose --report`: short runs of the virtual printer, few candidates, and the page that comes of it."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import dataclass, replace
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.diagnosis import problems, verb
from ffcomp.diagnosis.dominance import Dominant, Rival
from ffcomp.diagnosis.held_out import HeldOut
from ffcomp.diagnosis.next_experiment import Separation
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import Gap
from ffcomp.diagnosis.verb import Diagnosis
from ffcomp.report import diagnose as pages
from ffcomp.report.diagnose import page_of
from models.effects.catalogue import with_effect
from models.file import LIBRARY, load_machine
from models.printer.printer import simulate_printer
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


def made(folder: Path, hidden: dict[str, dict[str, Any]], names: tuple[str, ...], *, drawn: bool = False) -> Case:
    """Through the verb, with few candidates: the search is not what is tested here.

    drawn : whether its figures are, too; the other page is about words
    """
    write_machine(folder)
    runs, report, told = write_runs(folder, hidden), folder / "d.html", []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problems, "PrinterProblem", lambda plant, runs, _: PrinterProblem(plant, runs, names))
        patch.setattr(pages, "page_of", lambda given: told.append(given) or page_of(given))
        patch.setattr(verb, "separations", lambda *_: [PROPOSAL])
        if not drawn:
            patch.setattr("matplotlib.figure.Figure.savefig", save_nothing)
        answer = run(runs, "-o", str(folder / "better.toml"), "--report", str(report))
    assert answer.exit_code == 0, answer.output
    result = json.loads(answer.stdout)
    return Case(folder, runs, result, report.read_text(encoding="utf-8"), told[0])


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> Case:
    hidden = {"effector_mass": {"added_kg": 0.08}}
    return made(tmp_path_factory.mktemp("heavy"), hidden, ("effector_mass", "guide_damping"), drawn=True)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return made(tmp_path_factory.mktemp("plain"), {}, ("effector_mass", "guide_damping"))


@pytest.fixture
def found_already(plain: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """The verb without its search: the picture and the answer of a case that was searched before."""
    monkeypatch.setattr(verb, "diagnose", lambda *_: plain.told.search)
    monkeypatch.setattr(verb, "separations", lambda *_, **__: [])


# ---- the page and the JSON -----------------------------------------------------------------------


def plain_text(text: str) -> str:
    """What is read, without figures and tags."""
    body = re.sub(r'src="data:[^"]*"|<style>.*?</style>', "", text, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", body))).replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.parametrize(("name", "said"), [("heavy", "effects"), ("plain", "none")])
def test_the_page_says_what_the_json_says(name: str, said: str, request: pytest.FixtureRequest) -> None:
    case: Case = request.getfixturevalue(name)
    assert case.result["verdict"] == said
    read, answer = plain_text(case.text), case.result["answer"]
    assert f"verdict: {said}" in read
    for sentence in (answer["headline"], *answer["warnings"]):
        assert sentence.replace("`", "") in read
    for name, value in answer["facts"]:
        assert name == "Better file" or value in read
    assert (case.folder / "better.toml").exists() == (said == "effects")


def test_the_page_fetches_nothing_and_runs_nothing(heavy: Case, plain: Case) -> None:
    for text in (heavy.text, plain.text):
        assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'\"" in text
        images = [base64.b64decode(each).decode() for each in re.findall(r"base64,([A-Za-z0-9+/=]+)", text)]
        assert len(images) >= 5 + 2
        for content in (text, *images):
            assert "<script" not in content
            fetched = re.findall(r"""(?:src|href)\s*=\s*["']?([^"'\s>]+)|url\(([^)]+)\)|@import""", content)
            assert all(re.match(r"data:|#", one or other) for one, other in fetched), fetched
        assert re.findall(r"https?://", text) == []


# ---- files ---------------------------------------------------------------------------------------


def test_the_machine_file_is_whole_when_the_page_fails(
    heavy: Case, found_already: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fails(drawing: object) -> bytes:
        raise RuntimeError("no room")

    monkeypatch.setattr(verb, "diagnose", lambda *_: heavy.told.search)
    monkeypatch.setattr("ffcomp.report.page.svg", fails)
    targets = ["-o", str(tmp_path / "better.toml"), "--report", str(tmp_path / "d.html")]
    assert str(run(heavy.runs, *targets).exception) == "no room"
    assert [path.name for path in tmp_path.iterdir()] == ["better.toml"]
    assert load_machine(tmp_path / "better.toml").effects.keys() == {"effector_mass"}


# ---- sentences -----------------------------------------------------------------------------------


def gap(before: float, after: float) -> Gap:
    return Gap(before=before, after=after, noise=0.3, elsewhere=(before, after))


def test_shares_of_the_gap_are_of_what_stands_above_the_noise() -> None:
    assert gap(0.5, 0.3).explained == 1.0
    assert gap(0.5, 0.5).explained == 0.0
    assert gap(0.5, 0.34).explained == pytest.approx(1 - 0.0256 / 0.16)
    assert gap(0.3, 0.3).explained == 0.0


def left_out(position: tuple[float, ...], experiment: str, after: float = 10.0) -> dict[str, Any]:
    return {"held_out": [HeldOut(position, experiment, 100, 1e3, after, 1e3, power=(1.0, after / 1e3, 1.2, 0.0))]}


BECAUSE = {"rejections": ("it is late",)}
AT_FAULT = SimpleNamespace(sentence=lambda: "x moved as EI.")
OUTCOMES: list[tuple[dict[str, Any], str, str]] = [
    (
        {"finding": "dominant"},
        "Of other effects guide_damping would explain 30 %",
        "residual is then searched by itself",
    ),
    ({"finding": "dominant", "signal": "acc_x"}, "of the gap in acc_x is ", "the better machine file"),
    ({"finding": "nothing", "named": None}, "of the file's numbers retuned, ", "Compare the better machine file"),
    ({"finding": "cannot_tell"}, "they differ by more than noise", "Record again as said above"),
    ({"finding": "recording", "fault": AT_FAULT}, "at fault: x moved as EI.", "Record again as said above"),
    ({"finding": "unproven"} | BECAUSE, "It is not named because it is late.", "Do not add the nearest effect"),
    ({"finding": "unexplained"} | BECAUSE, "Nearest: effector_mass, which", "Look for something loose"),
    ({"finding": "unexplained", "best": None}, "nothing known explains it", "Record other motions, each twice"),
    (left_out((3.0,), ""), "In windows of time", "Compare the better machine file"),
    (left_out((0.0, 0.0), "slow"), "One place only: not tested elsewhere", "at two more places"),
    (left_out((55.0, 20.0), "", after=400.0), "It is unproven at (55, 20)", "Record louder motions at (55, 20)"),
    ({"cut_short": True}, "ended at its budget of work", "better.toml"),
]


@pytest.mark.parametrize(("outcome", "said", "step"), OUTCOMES, ids=[said for _, said, _ in OUTCOMES])
def test_each_outcome_has_its_sentences(heavy: Case, outcome: dict[str, Any], said: str, step: str) -> None:
    search, changed = heavy.told.search, dict(outcome)
    assert search.best is not None
    if changed.get("finding") == "dominant":
        rival = Rival(("guide_damping",), 0.3)
        changed["dominant"] = Dominant(search.best, 0.8, (rival,), changed.pop("signal", ""))
    verdict = {"effects": "effects", "nothing": "none"}.get(changed.get("finding", "effects"), "unknown")
    told = replace(heavy.told, search=replace(search, verdict=verdict, **changed))
    assert said in " ".join(told.said) and any(step in each for each in told.next_steps)
    assert json.loads(json.dumps(told.to_dict()))["verdict"] == verdict and told.answer.facts


# ---- odd outcomes --------------------------------------------------------------------------------
