"""From a hidden effect to a better print, and what keeps a wrong effect out; short runs of the independent printer."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import Diagnosis, diagnose
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import better_file, result_of
from ffcomp.measurement.recording import read_recording
from models.effects.catalogue import with_effect
from models.file import load_machine
from tests.support.hidden_delta import Motions, Printer, hidden, owners_file, printed_with, record
from validation import judge

SECONDS, PRINTED_S = 1.2, 3.0
EXPERIMENTS = (
    Motions("multisine", (0.0, 0.0, 30.0), 1.0, 2),
    Motions("multisine", (70.0, 40.0, 60.0), 1.4),
)
TABLE, REAL = hidden("extruder_mount", 2)  # softer and more damped, in x and y


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The owner's machine file, and runs of the printer that hides another mount of the extruder."""
    made = tmp_path_factory.mktemp("proof")
    (made / "owner.toml").write_text(owners_file(load_machine(judge.MACHINE_FILE)), encoding="utf-8")
    record(made / "runs", EXPERIMENTS, REAL, SECONDS)
    return made


@cache
def asked(folder: Path, *names: str) -> tuple[PrinterProblem, Diagnosis]:
    runs = [read_recording(path) for path in sorted((folder / "runs").iterdir())]
    plant = PrinterProblem(load_machine(folder / "owner.toml"), runs, names)
    return plant, diagnose(plant)


def written(folder: Path, *names: str) -> Path:
    plant, found = asked(folder, *names)
    path = folder / ("+".join(names) + ".toml")
    path.write_text(
        better_file(folder / "owner.toml", "better", result_of(plant, found), [], "today"), encoding="utf-8"
    )
    return path


def test_the_hidden_effect_is_named_and_the_print_gets_better(folder: Path) -> None:
    names = ("extruder_mount", "command_delay")
    _, found = asked(folder, *names)
    assert found.named is not None and found.named.names == ("extruder_mount",)
    for key, wanted in TABLE.items():  # of what the file says, which is 2 % off itself
        values = [found.final.values[f"effects.extruder_mount.{key}[{i}]"] for i in range(2)]
        np.testing.assert_allclose(values, wanted[:2], atol=0.1)
    truth = with_effect(load_machine(judge.MACHINE_FILE), "extruder_mount", **TABLE)
    printer = Printer(REAL, truth)
    none = printed_with(printer, folder / "owner.toml", PRINTED_S, compensate=False)
    old, better = (printed_with(printer, file, PRINTED_S) for file in (folder / "owner.toml", written(folder, *names)))
    assert old < 0.3 * none
    assert better < 0.6 * old


def test_a_wrong_effect_is_refused_for_what_it_leaves_at_places_left_out(folder: Path) -> None:
    _, found = asked(folder, "effector_mass")
    assert (found.verdict, found.named) == ("unknown", None)
    assert found.best is not None and found.best.names == ("effector_mass",)
    assert any("left out of the fit" in reason for reason in found.rejections)
    assert any("% of the discrepancy is left" in reason for reason in found.rejections)
    assert np.mean([place.after for place in found.held_out]) > 1.0  # of the noise
