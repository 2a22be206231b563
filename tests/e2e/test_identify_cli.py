"""`ffcomp identify`, as a user calls it: from a plan through captures of an independent printer to a machine file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.identification.output_error import TOTAL_MASS, fit_machine
from ffcomp.identification.predict import mean_absolute_percentage_accuracy, predicted
from ffcomp.record.plan import load_plan, run_name
from models.file import LIBRARY, load_machine
from models.machine import value_of
from tests.support.cli import CliRunner, Result
from validation.plants import delta_plant
from validation.plants.accelerometer import draw_chip, klipper_capture, nozzle_felt
from validation.plants.lab import PLACES, error_reduction, measure_bench, measure_places, uneven

TRUTH_FILE = LIBRARY / "mp-delta-pro.toml"
TRUTH = load_machine(TRUTH_FILE)


def call(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["identify", *map(str, arguments)])


def good(*arguments: object) -> Any:
    answer = call(*arguments, "--json", "--quiet")
    assert answer.exit_code == 0, answer.output
    return json.loads(answer.stdout)


def test_from_a_plan_through_captures_to_a_machine_file(tmp_path: Path) -> None:
    plan = tmp_path / "excite.gcode"
    arguments = ("--period-s", 2, "--periods", 3, "--lowest-hz", 10)
    verb = ("record", "plan", "--for", "identify", "-m", TRUTH_FILE, "-o", plan, *arguments)
    assert CliRunner().invoke(app, [*map(str, verb)]).exit_code == 0
    account = load_plan(tmp_path / "excite.json")
    rng = np.random.default_rng(4)
    chip, files = draw_chip(rng, np.eye(3)), list[Path]()
    for each in account.experiments:
        end = each.duration_s + account.rest_after_s
        felt = nozzle_felt(delta_plant.load_machine(TRUTH_FILE), each.motion.nozzle, -1.5, end + 0.5)
        files.append(tmp_path / f"adxl345-{run_name(each.name, 1)}.csv")
        text = klipper_capture(felt, chip, -account.rest_before_s, end, 777.0, rng)
        files[-1].write_text(text, encoding="utf-8")

    start = tmp_path / "start.toml"  # every vibration number wrong, as a user's first file is
    wrong = {
        "mass_kg = 0.179": "mass_kg = 0.15",
        "1.039e5": "1.3e5",
        "7.04e3": "9.0e3",
        "nozzle_mass_kg = 0.536": "nozzle_mass_kg = 0.45",
    }
    text = TRUTH_FILE.read_text(encoding="utf-8")
    for old, new in wrong.items():
        assert old in text
        text = text.replace(old, new)
    start.write_text(text, encoding="utf-8")
    out, figure = tmp_path / "mine.toml", tmp_path / "fit.png"
    known = f"{TOTAL_MASS}=0.651±0.001"
    result = good(
        "fit", *files, "--plan", tmp_path / "excite.json", "-m", start, "--known", known, "-o", out, "--figure", figure
    )

    found = load_machine(out)
    for name in ("carriage.belt_stiffness_n_per_m", "carriage.mass_kg", "effector.nozzle_mass_kg"):
        assert value_of(found, name) == pytest.approx(value_of(TRUTH, name), rel=0.02), name
    assert len(result["responses"]) == 9 and figure.exists()
    assert any("along z" in sentence for sentence in result["advice"])  # its mount resonates beyond the plan's band
    assert str(found.provenance["identified"]["data"]).count("sha256:") == 3  # type: ignore[index]


def test_tables_two_and_three_of_the_paper() -> None:
    """Identified at the centre of an uneven printer with friction, predicted at four places (Eqs. 70-72)."""
    real = uneven(delta_plant.load_machine(TRUTH_FILE), seed=0, friction_n=1.0)
    found = fit_machine(TRUTH, measure_bench(real, 40.0, seed=1), {TOTAL_MASS: (0.651, 0.001)}, starts=[{}]).machine
    responses = measure_places(real, 40.0, seed=2)
    scores = [
        mean_absolute_percentage_accuracy(r.value, h, 1.0)
        for r, h in zip(responses, predicted(found, responses), strict=True)
    ]
    magnitude, phase = np.mean(scores, axis=0)
    assert magnitude > 90 and phase > 95  # the paper: 71.5 and 82.2
    centre = {r.input: r.value for r in responses if r.position_mm == PLACES[0]}
    elsewhere = [r for r in responses if r.position_mm != PLACES[0]]
    cells = [error_reduction(r.value, predicted(found, [r])[0], centre[r.input], 1.0) for r in elsewhere]
    assert np.min(cells) > 0  # the paper's worst: -19.8
