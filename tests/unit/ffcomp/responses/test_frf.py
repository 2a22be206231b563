"""`ffcomp frf`: which responses, against which measurements, in JSON and in pictures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.identification.predict import predicted
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.frf_files import write_frf
from ffcomp.responses.result import frequency_responses
from ffcomp.responses.view import view_of
from models.machine import Machine
from tests.support.cli import CliRunner, Result

FREQUENCIES = np.arange(2.0, 125.1, 0.5)


def measured(machine: Machine, given: str, answers: str, factor: complex = 1.0, **said) -> FrequencyResponse:
    """What the machine would have answered, times a factor."""
    said.setdefault("source", f"{given}-{answers}.csv")
    nothing = np.ones(len(FREQUENCIES), dtype=complex)
    empty = FrequencyResponse(given, answers, FREQUENCIES, nothing, np.full(len(FREQUENCIES), 1e-6), **said)
    return replace(empty, value=factor * predicted(machine, [empty])[0])


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["frf", "-m", "mp-delta-pro", *map(str, arguments)])


def answers(*arguments: object) -> list[dict]:
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


def complex_of(bode: dict) -> np.ndarray:
    return np.array(bode["magnitude"]) * np.exp(1j * np.radians(bode["phase_deg"]))


# --- JSON


@pytest.mark.parametrize("of", ["carriage", "nozzle", "acceleration"])
@pytest.mark.parametrize("per", ["carriage", "nozzle"])
def test_responses_of_the_printer(machine: Machine, of, per) -> None:
    (answer,) = answers("--of", of, "--per", per, "--at", "-40,25", "--lowest-hz", 10, "--step-hz", 10)
    response, first = answer["response"], {"carriage": "A"}
    wanted = machine.vibration.frequency_response(np.array([-40.0, 25.0]), np.arange(10, 201, 10.0), of, per)
    assert (response["rows"][0], response["columns"][0]) == (first.get(of, "x"), first.get(per, "x"))
    found = np.array([[complex_of(bode) for bode in row] for row in response["values"]])
    np.testing.assert_allclose(np.moveaxis(found, 2, 0), wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())


# --- Measurements


def test_a_measurement_finds_its_view_place_and_accuracy(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_frf(path, measured(machine, "cmd_A", "pos_A", 1.25, position_mm=(-80.0, 0.0, 30.0)))
    (answer,) = answers("--measured", path)
    assert answer["position_mm"][:2] == [-80.0, 0.0]
    (each,) = answer["measured"]
    assert each["magnitude_accuracy_percent"] == pytest.approx(80.0)
    assert each["phase_accuracy_percent"] == pytest.approx(100.0)
    assert each["log_error_db"] == pytest.approx(20 * np.log10(1.25))
    assert (each["lines"], each["band_hz"]) == (247, [2.0, 125.0])
    assert "80 % accurate in magnitude, 100 % in phase" in answer["verdict"] and "fair" in answer["verdict"]


@pytest.mark.parametrize(
    ("given", "answering", "setup", "of"),
    [
        ("cmd_B", "acc_B", "assembly", "carriage"),
        ("cmd_x", "acc_y", "assembly", "nozzle"),
        ("cmd_C", "acc_C", "carriage", "carriage-alone"),
        ("cmd_A", "pos_A", "carriage+mass", "carriage-alone"),
        ("force_z", "acc_z", "effector", "effector-alone"),
    ],
)
def test_every_kind_of_measurement_is_met_by_its_own_machine(machine: Machine, given, answering, setup, of) -> None:
    """In the view's unit: accelerations per position are turned into positions, and a wrong factor stays wrong."""
    mass = 0.2 if setup == "carriage+mass" else 0.0
    place = (60.0, -20.0, 30.0) if setup == "assembly" else None
    response = measured(machine, given, answering, 1.25, setup=setup, added_mass_kg=mass, position_mm=place)
    found = frequency_responses(machine, view_of(response), FREQUENCIES, [], [response])
    assert found.view.of == of
    (station,) = found.stations
    (each,) = station.compared
    np.testing.assert_allclose(each.measured, 1.25 * station.value[:, *each.pair], rtol=1e-9)
    assert each.magnitude_percent == pytest.approx(80.0) and each.phase_percent == pytest.approx(100.0)
