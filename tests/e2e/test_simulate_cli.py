"""`ffcomp simulate`: G-code through the virtual printer, and what it writes, as a user and as `ffcomp gap` meet it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.measurement.recording import Recording, read_recording
from ffcomp.simulation.command import gcode_command
from ffcomp.simulation.request import SimulateRequest
from ffcomp.simulation.simulation import simulate_command
from models.file import LIBRARY, load_machine
from tests.support.cli import CliRunner, Result
from validation import judge

MACHINE = load_machine("mp-delta-pro")
SQUARE = b"G28\nG90\nM83\nG1 X0 Y0 Z0.3 F6000\nG1 X40 Y0 E1 F12000\nG1 X40 Y40 E1\nG1 X0 Y40 E1\nG1 X0 Y0 E1\nM107\n"


def call(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def good(*arguments: object) -> Any:
    answer = call(*arguments, "--json")
    assert answer.exit_code == 0, answer.output
    return json.loads(answer.stdout)


@pytest.fixture
def square(tmp_path: Path) -> Path:
    path = tmp_path / "ein Würfel 立方.gcode"
    path.write_bytes(SQUARE)
    return path


def with_table(folder: Path, name: str, table: str) -> Path:
    path = folder / f"{name}.toml"
    path.write_text((LIBRARY / "mp-delta-pro.toml").read_text(encoding="utf-8") + table, encoding="utf-8")
    return path


FRICTION = "\n[effects.coulomb_friction]\nforce_n = 2.0\n"


# ---- the numbers ---------------------------------------------------------------------------------


def test_the_track_is_that_of_an_independent_printer() -> None:
    """A plant that shares no line with ours, judged by other code."""
    original = judge.sample_print("ringing_tower", 75.0, 82.0)
    theirs = judge.judge(original, original.motion)
    counted = SimulateRequest("print.gcode", MACHINE, from_s=original.motion.begin_t + judge.SETTLE_S)
    track = simulate_command(counted, gcode_command(original.planned, MACHINE), MACHINE, MACHINE).track
    for key in ("contour_rms_um", "contour_p99_um", "tracking_rms_um", "tracking_rms_no_delay_um"):
        assert getattr(track, key) == pytest.approx(getattr(theirs, key), rel=0.005), key
    assert track.delay_s == pytest.approx(theirs.delay_s, abs=1e-6)
    assert track.peak_command_acceleration_mm_per_s2 / 1e3 == pytest.approx(theirs.peak_m_per_s2, rel=0.01)


def test_a_compensated_file_is_judged_against_its_original(square: Path, tmp_path: Path) -> None:
    """As the design model predicts it, and against the path that the slicer wanted."""
    target = tmp_path / "out.gcode"
    klipper = ("--flavor", "klipper")  # in Marlin the command's segments come late by some ms, which is no contour
    options = ("--offset-mm", "-20,10", "--max-segments-per-second", "160")
    words = ("-o", target, "--quiet", "--robust", "off", *klipper, *options)  # a robust reference is early or late
    predicted = good("compensate", square, "-m", "mp-delta-pro", *words)["predicted"]
    before, after = (good("simulate", path, "-m", "mp-delta-pro", "--quiet", *klipper) for path in (square, target))
    assert "original" in after["reference"]
    for found, name in ((before, "uncompensated"), (after, "compensated")):
        for key in ("tracking_rms_um", "contour_rms_um"):
            assert found["track"][key] == pytest.approx(predicted[name][key], rel=0.15, abs=0.25), (name, key)
    assert after["track"]["tracking_rms_um"] < before["track"]["tracking_rms_um"] / 15
    lines = target.read_bytes().splitlines(keepends=True)
    target.write_bytes(b"".join(line for line in lines if not line.startswith(b";section ")))
    refused = call("simulate", target, "-m", "mp-delta-pro", "--quiet")
    assert refused.exit_code == 4 and "Compensate the original again" in refused.output


# ---- the run file --------------------------------------------------------------------------------


def written(folder: Path, gcode: Path, *options: object) -> Recording:
    target = folder / "run.csv"
    good("simulate", gcode, "-m", "mp-delta-pro", "-o", target, "--quiet", *options)
    return read_recording(target)


def test_gap_finds_nothing_but_what_is_hidden(square: Path, tmp_path: Path) -> None:
    """The same printer: a thousandth (velocity's corners between rows). 2 N of friction: a gap, and none with them."""
    friction = with_table(tmp_path, "friction", FRICTION)
    sizes = []
    for plant, believed in (("", "mp-delta-pro"), (friction, "mp-delta-pro"), (friction, friction)):
        written(tmp_path, square, *(["--plant", plant] if plant else []))
        sizes.append(good("gap", tmp_path / "run.csv", "-m", believed)["nrms"])
    same, hidden, known = sizes
    assert same < 1e-3 and known < 2e-3
    assert hidden > 0.02


GAIN = "\n[effects.sensor_gain]\ncarriage_relative_change = 0.05\nnozzle_relative_change = [0.0, 0.1, 0.0]\n"


LATE = "\n[effects.sensor_time_offset]\noffset_s = 0.00125\n"


def test_the_plants_sensors_are_what_is_written(square: Path, tmp_path: Path) -> None:
    true = written(tmp_path, square).acceleration
    gained = written(tmp_path, square, "--plant", with_table(tmp_path, "gain", GAIN)).acceleration
    for name, factor in (("acc_A", 1.05), ("acc_x", 1.0), ("acc_y", 1.1)):
        np.testing.assert_allclose(gained[name], factor * true[name], atol=2e-6)
    late = written(tmp_path, square, "--plant", with_table(tmp_path, "late", LATE)).acceleration
    np.testing.assert_allclose(late["acc_x"][2:], true["acc_x"][:-2], atol=2e-6)  # two samples
