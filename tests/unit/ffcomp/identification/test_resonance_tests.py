"""What `identify fit` takes of resonance tests, what it asks for, and what it does not write."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.identification.load import gather
from ffcomp.identification.predict import predicted
from ffcomp.identification.request import IdentifyRequest
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import load_plan, save_plan
from models.file import load_machine
from tests.support.cli import CliRunner
from tests.support.recordings import write_captures

F = np.arange(1, 110) * 1.5
RATIO = F / 44.0
PEAK = F**2 / ((1 - RATIO**2) ** 2 + (0.14 * RATIO) ** 2) + 1.0


def call(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["identify", "fit", *map(str, arguments)])
    return result.exit_code, " ".join(result.output.split())


def spectra(path: Path, header: str, *columns: np.ndarray) -> Path:
    rows = np.column_stack([F, *columns])
    np.savetxt(path, rows, fmt="%.6g", delimiter=",", header=f"freq,{header}", comments="")
    return path


@pytest.mark.parametrize("machine", ["ender-3", "kossel"])
def test_several_spectra_are_never_guessed(tmp_path: Path, machine: str) -> None:
    path = spectra(tmp_path / "vib_y_test.csv", "x,y,z", 0.02 * F + 1, PEAK, 0.1 * PEAK)
    code, said = call(path, "-m", machine)
    assert code == 5 and ("several spectra, x, y, z" in said or "Say --axis x or y" in said)
    code, said = call(path, "-m", machine, "--axis", "y", "--json", "--quiet")
    assert code == 0
    found: Any = json.loads(said)
    assert found["axes"]["y"]["modes"][0]["frequency_hz"]["value"] == pytest.approx(44.0, rel=0.02)
    code, said = call(path, "-m", machine, "--axis", "x", "--column", "w")
    assert code == 5 and "no spectrum 'w'; there are x, y, z" in said


def test_a_rough_mode_is_written_only_if_it_is_asked_for(tmp_path: Path) -> None:
    rough = PEAK * np.exp(1.0 * np.random.default_rng(0).normal(size=len(F)))
    path = spectra(tmp_path / "resonances_x_1.csv", "psd_x,psd_y,psd_z,psd_xyz", rough, F * 0, F * 0 + 1, rough)
    path.write_text(path.read_text().replace(",0,", ",1,"))
    output = tmp_path / "mine.toml"
    code, said = call(path, "-m", "ender-3", "-o", output)
    assert code == 5 and "modes of x are not written" in said and "--rough" in said and not output.exists()
    code, _ = call(path, "-m", "ender-3", "-o", output, "--rough")
    assert code == 0 and load_machine(output).vibration.parameters().names


def test_a_deltas_file_is_not_made_from_an_unclear_mode(tmp_path: Path) -> None:
    """A drive's own peak beside the belts' one was taken for it: the belts came out five times too stiff."""
    rough = PEAK * np.exp(1.0 * np.random.default_rng(0).normal(size=len(F)))
    path = spectra(tmp_path / "resonances_x_1.csv", "psd_x,psd_y,psd_z,psd_xyz", rough, F + 1, F + 1, rough)
    output = tmp_path / "mine.toml"
    code, said = call(path, "-m", "kossel", "-o", output)
    assert code == 5 and "modes of x are not written" in said and not output.exists()


def test_the_highest_peak_of_many_is_where_it_is(tmp_path: Path) -> None:
    """With other modes beside it, one mode of the whole band lay a tenth off real printers' peaks."""
    response = np.zeros(len(F), dtype=complex)
    for hz, zeta, share in ((47.0, 0.05, 0.7), (75.0, 0.04, -0.2), (96.0, 0.05, 0.15), (113.0, 0.05, -0.1)):
        response += share / (1 - (F / hz) ** 2 + 2j * zeta * F / hz)
    power = F**2 * np.abs(response) ** 2
    path = spectra(tmp_path / "resonances_x_1.csv", "psd_x,psd_y,psd_z,psd_xyz", power, F + 1, F + 1, power)
    code, said = call(path, "-m", "ender-3", "--json", "--quiet")
    axis = json.loads(said)["axes"]["x"]
    assert code == 0 and "has more modes than two" in axis["verdict"]
    assert axis["modes"][0]["frequency_hz"]["value"] == pytest.approx(47.0, rel=0.03)


# ---- captures ----


@pytest.mark.slow
def test_captures_of_a_recording_give_responses(tmp_path: Path) -> None:
    machine = load_machine("mp-delta-pro")
    file = tmp_path / "moves.json"
    save_plan(make_plan(machine, Request(seconds=3.0)), file)
    plan = load_plan(file)
    place = next(each.place for each in plan.experiments if each.kind == "multisine")
    names = [each.name for each in plan.experiments if each.place == place]
    written = write_captures(file, machine, tmp_path, kinds=[e.kind for e in plan.experiments if e.place == place])
    captures = [path for path in written if any(f"{name}-1" in path.name for name in names)]
    request = IdentifyRequest(tuple(captures), machine, plan=file, lowest_hz=8.0, highest_hz=100.0)
    found = gather(machine, request).responses
    assert {(r.input, r.output) for r in found} >= {("cmd_x", "acc_x"), ("cmd_y", "acc_y")}
    for r, model in zip(found, predicted(machine, found), strict=True):
        assert r.clock == f"place-{place}" and r.position_mm is not None
        error = np.sqrt(np.sum(np.abs(r.value - model) ** 2) / np.sum(np.abs(model) ** 2))
        assert error < 0.15, (r.input, r.output)


@pytest.mark.parametrize("lost", [0, 4])
def test_samples_that_reprapfirmware_lost_are_reported(tmp_path: Path, lost: int) -> None:
    rows = np.random.default_rng(1).normal((0.0, 0.0, 1.0), 0.2, (4000, 3))
    text = "".join(f"{n},{x:.4f},{y:.4f},{z:.4f}\n" for n, (x, y, z) in enumerate(rows.tolist()))
    path = tmp_path / "0_2026-11-22.csv"
    path.write_text(f"Sample,X,Y,Z\n{text}Rate 1344, overflows {lost}\n")
    machine = load_machine("voron-300")
    found = gather(machine, IdentifyRequest((path,), machine, lowest_hz=10.0, highest_hz=120.0, axis=("x",)))
    assert any("lost samples (4 overflows" in each for each in found.skipped) == bool(lost)
