"""A print names its machine by a hash: the file is found wherever it was, and a printer's configuration is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.cli.app import app
from models.file import load_machine
from tests.support.cli import CliRunner
from tests.support.configs import COREXY
from tests.support.prints import squares


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


def test_show_and_estimate_find_a_machine_that_has_no_name(print_of_my_machine: tuple[Path, Path]) -> None:
    printed, machine = print_of_my_machine
    for verb in ("show", "estimate"):
        done = CliRunner().invoke(app, [verb, str(printed), "--json"])
        assert done.exit_code == 0, done.output
    machine.rename(printed.with_name("moved.toml"))  # beside the print
    assert CliRunner().invoke(app, ["estimate", str(printed)]).exit_code == 0


def test_a_machine_that_has_changed_is_another(print_of_my_machine: tuple[Path, Path]) -> None:
    printed, machine = print_of_my_machine
    machine.write_bytes(machine.read_bytes() + b"# changed\n")
    refused = CliRunner().invoke(app, ["show", str(printed)])
    assert refused.exit_code == 5 and "name the file with --machine" in refused.output


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("printer.cfg", COREXY),
        ("config.g", '; RepRapFirmware\nM550 P"delta"\nM665 L300 R140\nM92 X80 Y80 Z80\n'),
        ("m503.txt", "echo:; Steps per unit:\necho: M92 X80.00 Y80.00 Z400.00 E93.00\n"),
    ],
)
def test_a_printers_configuration_is_to_be_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text, encoding="utf-8")
    Path("a.gcode").write_bytes(squares(1))
    for given in (name, f"./{name}"):
        refused = CliRunner().invoke(app, ["compensate", "a.gcode", "-m", given])
        assert refused.exit_code == 5
        assert f"ffcomp machines import {Path(given)} -o my-printer.toml" in refused.output
