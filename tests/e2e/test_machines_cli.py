"""`ffcomp machines`: what goes where, and with which exit code."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ffcomp.cli.machines import machines as app
from models.file import LIBRARY, load_machine
from models.kinds import delta_vibration
from tests.support.cli import CliRunner, Result


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("models.finding.user_folder", lambda: tmp_path / "own")
    return tmp_path / "own"


@pytest.fixture
def run(own_folder: Path):
    def run(*arguments: str) -> Result:
        return CliRunner().invoke(app, arguments)

    return run


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    path = tmp_path / "broken.toml"
    text = (LIBRARY / "kossel.toml").read_text()
    path.write_text(text.replace("\nmass_kg = 0.12\n", "\nmass_kg = 120\n"))
    return path


def test_list(run) -> None:
    run("new", "mine")
    result = run("list", "--json")
    machines = {machine["name"]: machine["origin"] for machine in json.loads(result.stdout)["machines"]}
    assert machines["mine"] == "user"
    assert machines["mp-delta-pro"] == machines["kossel"] == "library"


def test_list_stands_in_groups(run) -> None:
    lines = run("list").stdout.splitlines()[1:]
    kinds = [line.split()[1].strip(",") for line in lines]
    assert list(dict.fromkeys(kinds)) == ["delta", "corexy", "cartesian"]
    assert kinds == sorted(kinds, key=["delta", "corexy", "cartesian"].index)
    assert next(line for line in lines if line.startswith("  bambu-p1")).endswith(
        "Bambu Lab P1P, P1S, X1, X1C (assumed dynamics)"
    )


def test_list_survives_a_broken_file(run, own_folder: Path) -> None:
    own_folder.mkdir()
    (own_folder / "broken.toml").write_text("name = 'x\n")
    (own_folder / "odd.toml").write_bytes(b"name = 3\nkinematics = '\xc3\xa9'\n")
    result = run("list", "--json")
    rows = {row["name"]: row for row in json.loads(result.stdout)["machines"]}
    assert rows["broken"]["printer"] is rows["broken"]["kinematics"] is rows["odd"]["printer"] is None
    assert run("list").stdout.splitlines()[-1].split() == ["odd", "?,", "user,", "?"]


def test_show_tells_values_provenance_and_modes(run) -> None:
    shown = json.loads(run("show", "mp-delta-pro", "--json").stdout)
    assert shown["schema"] == "ffcomp-machine-show/1"
    assert shown["machine"]["sha256"] == load_machine("mp-delta-pro").sha256
    mass = {"value": 0.179, "unit": "kg", "provenance": "paper, Table I"}
    assert shown["values"]["carriage.mass_kg"] == mass
    assert [len(mode["frequency_hz"]) for mode in shown["modes"]] == [6, 6, 6]
    assert shown["modes"][1]["position_mm"] == pytest.approx([108.0, 0.0])


def test_show_as_text(run) -> None:
    text = run("show", "mp-delta-pro").stdout
    row = next(line for line in text.splitlines() if line.startswith("  carriage.mass_kg"))
    assert row.split(maxsplit=1)[1] == "0.179 kg, paper, Table I"
    assert "80 % away from A" in text


def test_show_and_check_say_what_is_assumed_and_from_where(run) -> None:
    text = run("show", "bambu-a1").stdout
    assert "The modes of bambu-a1 are assumed, not measured" in text.splitlines()[0]
    assert any(line.startswith("  A1  ") and "https://github.com/" in line for line in text.splitlines())
    shown = json.loads(run("show", "bambu-a1", "--json").stdout)
    assert set(shown["sources"]) == {"common", "A1"} and "assumed" in shown["machine"]["assumed"]
    for name in ("bambu-a1", "flsun-v400"):
        assert f"The modes of {name} are assumed" in run("check", name).stdout
    assert "are assumed" not in run("show", "mp-delta-pro").stdout + run("check", "mp-delta-pro").stdout


def test_check_of_a_sound_machine(run) -> None:
    result = run("check", "kossel")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "no numbers disagree" in result.stdout


def test_check_notes_what_disagrees(run) -> None:
    result = run("check", "mp-delta-pro-as-printed", "--json")
    assert result.exit_code == 0
    checked = json.loads(result.stdout)
    assert checked["problems"] == []
    assert len(checked["notes"]) == 7  # five numbers, and the map that is neither reciprocal nor passive
    assert checked["answer"]["warnings"] == checked["notes"]
    assert "it can generate energy, 5 numbers disagree" in checked["answer"]["headline"]


def test_check_shows_every_value(run) -> None:
    checked = json.loads(run("check", "mp-delta-pro-as-printed", "--json").stdout)
    mass = checked["consistency"][0]
    assert mass["file_uses"].startswith("Eq. 30") and mass["of_file"] == pytest.approx(0.195)
    assert [way["equation"][:6] for way in mass["values"]] == ["Eq. 41", "Eq. 36", "Eq. 40"]
    assert mass["values"][0]["difference_percent"] == pytest.approx(-15.9, abs=0.05)
    assert checked["soundness"]["dissipation"]["value"] < -0.2
    assert "0.164 (-15.9 %) by Eq. 41" in dict(checked["answer"]["facts"])["carriage.mass_kg + arm_pair_mass_kg/2, kg"]


def test_check_of_a_broken_file(run, broken: Path) -> None:
    result = run("check", str(broken))
    assert (result.exit_code, result.stdout) == (5, "")
    assert result.stderr == f"ffcomp: {broken}: carriage.mass_kg = 120 must be at most 20 (kg).\n"
    told = json.loads(run("check", str(broken), "--json").stdout)
    assert told["problems"] == ["carriage.mass_kg = 120 must be at most 20 (kg)."]


def test_check_of_a_model_that_does_not_hold_still(run, tmp_path: Path) -> None:
    text = (LIBRARY / "mp-delta-pro-as-printed.toml").read_text()
    path = tmp_path / "unstable.toml"
    path.write_text(text.replace("[10.21, -16.52, 19.31]", "[35.0, -60.0, 120.0]"))
    result = run("check", str(path))
    assert result.exit_code == 5
    assert "does not decay" in result.stderr


@pytest.mark.parametrize("verb", ["show", "check"])
def test_unknown_machines(run, verb: str) -> None:
    result = run(verb, "flsun-qq")
    assert result.exit_code == 5
    assert "Did you mean 'flsun-qqs'?" in result.stderr


def test_new_starts_a_file_that_loads(run, own_folder: Path) -> None:
    result = run("new", "mine", "--from", "kossel")
    assert (result.exit_code, result.stdout.strip()) == (0, str(own_folder / "mine.toml"))
    machine = load_machine("mine")
    assert machine.name == "mine"
    assert delta_vibration(machine).carriage == delta_vibration(load_machine("kossel")).carriage


def test_new_overwrites_nothing(run, tmp_path: Path) -> None:
    path = tmp_path / "there.toml"
    path.write_text("precious")
    result = run("new", "mine", "-o", str(path))
    assert result.exit_code == 2
    assert "exists already" in result.stderr
    assert path.read_text() == "precious"


def test_new_starts_from_nothing_broken(run, broken: Path, own_folder: Path) -> None:
    assert run("new", "mine", "--from", str(broken)).exit_code == 5
    assert not own_folder.exists()


def test_new_stays_in_its_folder(run, own_folder: Path) -> None:
    result = run("new", "../mine")
    assert result.exit_code == 2
    assert "cannot be a machine's name" in result.stderr


def test_the_verb_is_light_to_import() -> None:
    heavy = {"numpy", "scipy", "numba", "matplotlib", "pydantic", "tomlkit"}
    code = f"import sys, ffcomp.cli.machines; print(*{heavy!r}.intersection(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_the_list_needs_no_numbers() -> None:
    """It stays quick however many machines there are: neither numpy nor the schema is imported."""
    told = "print(*{'numpy', 'models.schema'}.intersection(sys.modules))"
    code = f"import sys; from ffcomp.cli.app import main\ntry: main()\nfinally: {told}"
    done = subprocess.run([sys.executable, "-c", code, "machines", "list"], capture_output=True, text=True, check=True)
    assert "kossel" in done.stdout
    assert done.stdout.splitlines()[-1] == ""
