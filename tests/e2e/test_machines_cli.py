"""`ffcomp machines`: what goes where, and with which exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ffcomp.cli.app import app
from ffcomp.cli.machines import machines
from models.file import LIBRARY, load_machine
from models.kinds import delta_vibration
from tests.support.cli import CliRunner, Result
from tests.support.configs import Delta, written
from tests.support.prints import squares
from tests.support.reference import call


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("models.finding.user_folder", lambda: tmp_path / "own")
    return tmp_path / "own"


@pytest.fixture
def run(own_folder: Path):
    def run(*arguments: str) -> Result:
        return CliRunner().invoke(machines, arguments)

    return run


def test_check_of_a_model_that_does_not_hold_still(run, tmp_path: Path) -> None:
    text = (LIBRARY / "mp-delta-pro-as-printed.toml").read_text()
    path = tmp_path / "unstable.toml"
    path.write_text(text.replace("[10.21, -16.52, 19.31]", "[35.0, -60.0, 120.0]"))
    result = run("check", str(path))
    assert result.exit_code == 5
    assert "does not decay" in result.stderr


def test_new_starts_a_file_that_loads(run, own_folder: Path) -> None:
    result = run("new", "mine", "--from", "kossel")
    assert (result.exit_code, result.stdout.strip()) == (0, str(own_folder / "mine.toml"))
    machine = load_machine("mine")
    assert machine.name == "mine"
    assert delta_vibration(machine).carriage == delta_vibration(load_machine("kossel")).carriage


def test_new_stays_in_its_folder(run, own_folder: Path) -> None:
    result = run("new", "../mine")
    assert result.exit_code == 2
    assert "cannot be a machine's name" in result.stderr


# ---- library machines ----


SQUARE = "G28\nG90\nM83\nG1 Z0.3 F600\nG1 X{0} Y{0} F9000\nG1 X{1} E1 F6000\nG1 Y{1} E1\nG1 X{0} E1\nG1 Y{0} E1\n"
MACHINES = {"flsun-v400": (-10, 10), "prusa-mk4": (100, 120)}


@pytest.mark.parametrize("name", MACHINES)
def test_a_small_print_is_compensated_and_says_what_is_assumed(name: str, tmp_path: Path) -> None:
    (tmp_path / "square.gcode").write_text(SQUARE.format(*MACHINES[name]), encoding="utf-8")
    done = call("compensate", tmp_path / "square.gcode", "-m", name, "--dry-run", "--json", "--robust", "off")
    result = json.loads(done.stdout)
    predicted, sentence = result["predicted"], f"The modes of {name} are assumed, not measured"
    # 0.12 on the MK4, 1.06 µm: Marlin's jerk leaves steps of speed that no command undoes, and its ends are whole steps
    assert predicted["compensated"]["contour_rms_um"] < 0.13 * predicted["uncompensated"]["contour_rms_um"]
    assert result["machine"]["assumed"].startswith(sentence)
    first, *others = result["answer"]["warnings"]
    assert first.startswith(sentence) and not any("input shaper" in each for each in others)


def test_a_measured_machine_says_nothing(tmp_path: Path) -> None:
    (tmp_path / "square.gcode").write_text(SQUARE.format(-10, 10), encoding="utf-8")
    done = call("compensate", tmp_path / "square.gcode", "-m", "mp-delta-pro", "--dry-run", "--no-predict", "--json")
    assert json.loads(done.stdout)["machine"]["assumed"] is None
    assert "are assumed" not in done.output


# ---- machine of a print ----


@pytest.fixture
def print_of_my_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A print that was compensated with `-m ./my.toml`, and that file, in different folders; the cache is empty."""
    monkeypatch.setenv("FFCOMP_CACHE", str(tmp_path / "cache"))
    (tmp_path / "machines").mkdir()
    machine, printed = tmp_path / "machines" / "my.toml", tmp_path / "squares.gcode"
    machine.write_bytes(Path(load_machine("mp-delta-pro").path).read_bytes() + b"\n# mine\n")
    printed.write_bytes(squares(1))
    monkeypatch.chdir(tmp_path / "machines")
    done = CliRunner().invoke(app, ["compensate", str(printed), "-m", "./my.toml", "-q", "--no-predict"])
    assert done.exit_code == 0, done.output
    monkeypatch.chdir(tmp_path)
    return printed, machine


def test_show_and_estimate_find_a_machine_next_to_the_print(print_of_my_machine: tuple[Path, Path]) -> None:
    printed, machine = print_of_my_machine
    machine.rename(printed.with_name("moved.toml"))  # next to the print
    for verb in ("show", "estimate"):
        done = CliRunner().invoke(app, [verb, str(printed), "--json"])
        assert done.exit_code == 0, done.output


def test_a_machine_that_has_changed_is_another(print_of_my_machine: tuple[Path, Path]) -> None:
    printed, machine = print_of_my_machine
    machine.write_bytes(machine.read_bytes() + b"# changed\n")
    refused = CliRunner().invoke(app, ["show", str(printed)])
    assert refused.exit_code == 5 and "name the file with --machine" in refused.output


# ---- import cli ----


@pytest.fixture
def run_of_import_cli(own_folder: Path):
    def run_of_import_cli(*arguments: str | Path) -> Result:
        return CliRunner().invoke(machines, ["import", *map(str, arguments)])

    return run_of_import_cli


def test_a_delta_becomes_a_machine_that_checks_well(run_of_import_cli, own_folder: Path, tmp_path: Path) -> None:
    result = run_of_import_cli(written(tmp_path, Delta().klipper(), "printer.cfg"))
    assert result.exit_code == 0, result.output
    for source in ("read: ", "converted: ", "assumed: "):
        assert source in result.stdout
    row = next(line for line in result.stdout.splitlines() if "kinematics.arm_lengths_mm" in line)
    assert "280.5, 280.75, 280.25" in row and "printer.cfg:4 [stepper_a] arm_length" in row
    assert load_machine(own_folder / "printer.toml").name == "printer"
    checked = CliRunner().invoke(machines, ["check", str(own_folder / "printer.toml")])
    assert checked.exit_code == 0
    assert "Not measured: carriage.mass_kg" in checked.stdout


def test_marlin_is_told_its_kinematics(run_of_import_cli, tmp_path: Path) -> None:
    log = "echo:  M92 X80 Y80 Z400\necho:  M203 X300 Y300 Z10\necho:  M201 Z100\necho:  M593 F40 D0.1\n"
    result = run_of_import_cli(written(tmp_path, log), "-o", tmp_path / "a.toml")
    assert result.exit_code == 5
    assert "--kinematics cartesian" in result.stderr
    assert run_of_import_cli(written(tmp_path, log), "-o", tmp_path / "a.toml", "--kinematics", "polar").exit_code == 2
    result = run_of_import_cli(written(tmp_path, log), "-o", tmp_path / "a.toml", "--kinematics", "corexy", "--json")
    assert json.loads(result.stdout)["missing"].keys() == {
        *(f"kinematics.{axis}_range_mm" for axis in "xyz"),
        "limits.acceleration_mm_per_s2",
    }


M503 = "M92 X80 Y80 Z400 E93\nM201 X500 Y500 Z100 E5000\nM203 X500 Y500 Z5 E25\nM204 P500 R500 T500\nM205 J0.08\n"


def test_an_incomplete_import_is_completed_by_the_same_command_with_a_like_machine(
    run_of_import_cli, tmp_path: Path
) -> None:
    source, path = written(tmp_path, M503, "m503.txt"), tmp_path / "mine.toml"
    words = (source, "-o", path, "--kinematics", "cartesian")
    first = run_of_import_cli(*words)
    assert first.exit_code == 5 and "--like ender-3" in first.output and "voron" not in first.output
    assert run_of_import_cli(*words, "--like", "ender-3").exit_code == 0
    machine = load_machine(str(path))
    assert machine.kinematics.range_mm.tolist() == load_machine("ender-3").kinematics.range_mm.tolist()
    assert machine.limits.carriage_acceleration_mm_per_s2 == 5000.0, "no motor was asked for 30 m/s² where M201 is 0.5"
    again = run_of_import_cli(*words, "--like", "ender-3")
    assert again.exit_code == 2 and "exists already" in again.output, "a complete file is never overwritten"
