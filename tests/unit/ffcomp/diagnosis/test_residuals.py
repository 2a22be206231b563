"""Runs of another author's printer against our simulation: nothing but the noise where nothing is hidden."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.diagnosis.noise import noise_floor, whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.measurement.recording import Recording
from models.file import load_machine
from tests.support.cli import CliRunner

RUNS = Path(os.environ.get("FFCOMP_DATA", Path(__file__).parents[5] / "shared" / "data")) / "runs"


def gap_of(case: str, *, machine: Path | None = None) -> Any:
    folder = RUNS / case
    if not folder.is_dir():
        pytest.skip(f"the runs from outside are not beside the project ({case})")
    files = [str(path) for path in sorted((folder / "runs").glob("*.csv"))]
    answer = CliRunner().invoke(app, ["gap", *files, "-m", str(machine or folder / "machine.toml"), "--json"])
    assert answer.exit_code == 0, answer.output
    return json.loads(answer.stdout)


def test_nothing_hidden_leaves_nothing_but_the_noise() -> None:
    found = gap_of("nothing-hidden")
    assert found["schema"] == "ffcomp-gap/1" and found["noise_from_repeats"]
    assert found["nrms"] == pytest.approx(found["noise_nrms"], rel=0.02)
    for size in (*found["where"]["signals"].values(), *found["where"]["runs"].values()):
        assert size["nrms"] < 1.1 * size["noise_nrms"]


def test_a_hidden_effect_is_a_gap_and_adding_it_closes_it(tmp_path: Path) -> None:
    case = "coulomb-friction"
    found = gap_of(case)
    assert found["nrms"] > 20 * found["noise_nrms"]
    assert sum(share for _, _, share in found["where"]["frequency_hz"]) == pytest.approx(1.0)
    truth = (RUNS / case / "truth.toml").read_text(encoding="utf-8")
    better = tmp_path / "better.toml"
    effect = truth[truth.index("[effects.") :]
    better.write_text((RUNS / case / "machine.toml").read_text(encoding="utf-8") + "\n" + effect, encoding="utf-8")
    closed = gap_of(case, machine=better)
    assert closed["nrms"] < 1.2 * closed["noise_nrms"]


def made_recordings(noise: float, count: int, rng: np.random.Generator) -> list[Recording]:
    """Repeats of one motion on the library's printer, by the plant itself, with white noise."""
    machine = load_machine("mp-delta-pro")
    t = np.arange(0, 1.5, 1 / 1600)
    rest = np.array([[330.0, 330.0, 330.0]])
    moved = 0.3 * np.sin(2 * np.pi * 37 * t)[:, None] * np.array([1.0, -0.4, 0.2]) * np.minimum(1, t / 0.2)[:, None]
    blank = {f"acc_{a}": np.zeros(len(t)) for a in "ABCxyz"}
    gaps = np.zeros(len(t), dtype=bool)
    first = Recording("x-1.csv", t, rest + moved, "carriage", blank, {}, gaps, {})
    true = PrinterProblem(machine, [first], ()).simulate({})[0]
    return [
        Recording(f"x-{i}.csv", t, rest + moved, "carriage", dict(zip(blank, (true + n).T, strict=True)), {}, gaps, {})
        for i, n in enumerate(noise * rng.standard_normal((count, *true.shape)), 1)
    ]


def test_whitened_noise_has_variance_one() -> None:
    recordings = made_recordings(0.2, 6, np.random.default_rng(0))
    plant = PrinterProblem(load_machine("mp-delta-pro"), recordings, ())
    simulated = plant.simulate({})
    floor = noise_floor(plant)
    assert floor.from_repeats
    white = whitener(plant.observations, floor)
    errors = white([r.measured - y for r, y in zip(plant.observations, simulated, strict=True)])
    assert np.var(errors) == pytest.approx(1.0, abs=0.03)
    density = floor.density["acc_A"]
    assert np.median(density) == pytest.approx(0.2**2 / 800, rel=0.06)  # white noise: variance over the Nyquist band


def test_diagnose_says_none_where_nothing_is_hidden(tmp_path: Path) -> None:
    folder = RUNS / "nothing-hidden"
    if not folder.is_dir():
        pytest.skip("the runs from outside are not beside the project (nothing-hidden)")
    files = [str(folder / "runs" / f"{name}.csv") for name in ("infill-centre-1", "infill-centre-2", "infill-front")]
    better = tmp_path / "better.toml"
    machine = str(folder / "machine.toml")
    answer = CliRunner().invoke(app, ["diagnose", *files, "-m", machine, "-o", str(better), "--json", "--quiet"])
    assert answer.exit_code == 0, answer.output
    told = json.loads(answer.stdout)
    assert (told["schema"], told["verdict"], told["effects"]) == ("ffcomp-diagnose/1", "none", [])
    assert told["machine"] is None and not better.exists()
