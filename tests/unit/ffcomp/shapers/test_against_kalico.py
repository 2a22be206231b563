"""Shaped Cartesian first, then inverse kinematics: step by step what the real Kalico host plays on its delta.

And its own calibration, on our resonance test. Runs where KALICO_PYTHON names the python of an environment with Kalico
in it; see validation/kalico.py.
"""

from __future__ import annotations

import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp import shapers
from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.shapers import calibration as calibrate
from ffcomp.shapers.apply import Position
from ffcomp.shapers.pulses import USUAL
from gcode.reader import read_program
from models.arrays import FloatArray, constant
from models.file import load_machine
from models.kinematics.delta import DeltaKinematics
from validation import kalico

pytestmark = pytest.mark.kalico

GEOMETRY = DeltaKinematics(
    constant([kalico.ARM_LENGTH_MM] * 3),
    constant([kalico.RADIUS_MM] * 3),
    constant([210.0, 330.0, 90.0]),
    effector_height_mm=0.0,
    print_radius_mm=125.0,
    print_height_mm=400.0,
)
LIMITS = PlannerLimits(
    velocity_mm_per_s=300.0,
    acceleration_mm_per_s2=3000.0,
    delta=DeltaSlowZones(kalico.RADIUS_MM, kalico.ARM_LENGTH_MM, kalico.HALF_STEP_MM),
)
EXACT_STEPS = 1e-9  # s: the host may compress its steps, but not move them


def program() -> bytes:
    """Travel, a circle as a polyline, a corner, a rest, a short reversal, a climb."""
    turns = np.linspace(0.0, 2 * np.pi, 61)
    circle = [f"G1 X{40 + 20 * np.cos(u):.4f} Y{-10 + 20 * np.sin(u):.4f}" for u in turns]
    rest = "G1 X-50 Y30 Z10.4 F15000|G1 X-50 Y-20|G1 X-20 Y-20|G4 P50|G1 X-20.5 F3000|G1 X-20|G1 X20 Y50 F9000|G1 X0 Y0"
    return "\n".join(["G1 X60 Y-10 F12000", *circle, *rest.split("|"), ""]).encode()


def planned() -> Position:
    moves = read_program(program(), start=kalico.START_MM)
    stops, waits = stops_and_waits(moves)
    plan = plan_moves(moves.moves, LIMITS, stop_before=stops, wait_before=waits)
    return lambda t: plan.position(t + plan.start_t[0])[:, :3]


def steps_and_ours(configuration: Path, x: shapers.Shaper, y: shapers.Shaper) -> tuple[FloatArray, FloatArray]:
    """Of all towers: heights (n,) mm half way between two steps of the host, ours at that time."""
    theirs = kalico.kalico_plan(program(), extra_cfg=str(configuration), max_stepper_error=EXACT_STEPS)
    position, host, ours = planned(), [], []
    for j, tower in enumerate("abc"):
        t, height = theirs[f"step_t_{tower}"], theirs[f"step_pos_{tower}"]
        host.append((height[1:] + height[:-1]) / 2)
        ours.append(GEOMETRY.inverse(shapers.shape(position, t[1:], x, y))[:, j])
    return np.concatenate(host), np.concatenate(ours)


@pytest.mark.parametrize(
    ("kind", "x_hz", "y_hz", "damping"),
    [(kind, *((35.0, 52.0, 0.1), (61.0, 44.0, 0.05))[k % 2]) for k, kind in enumerate(USUAL[::2])],
)
def test_every_step_is_on_our_shaped_path(kind: str, x_hz: float, y_hz: float, damping: float, tmp_path: Path) -> None:
    """To 10 nm (measured: 2.2), where shaping moves the carriages by 34 to 355 µm; every kind along x or along y."""
    other = USUAL[(USUAL.index(kind) + 1) % len(USUAL)]
    configuration = tmp_path / "shaper.cfg"
    configuration.write_text(
        f"[input_shaper]\nshaper_type_x: {kind}\nshaper_type_y: {other}\nshaper_freq_x: {x_hz}\nshaper_freq_y: {y_hz}\n"
        f"damping_ratio_x: {damping}\ndamping_ratio_y: {damping}\n"
    )
    x, y = shapers.SHAPERS[kind](x_hz, damping), shapers.SHAPERS[other](y_hz, damping)
    host, ours = steps_and_ours(configuration, x, y)
    assert len(host) > 10_000
    assert np.abs(host - ours).max() < 1e-5


# ---- the calibration -----------------------------------------------------------------------------

CALIBRATE = """
import json, sys
import numpy as np
from klippy.extras.resonance_tester import VibrationPulseTestGenerator
from klippy.extras.shaper_calibrate import ShaperCalibrate

class Defaults:
    def getfloat(self, name, default, **limits):
        return default
    get_float = getfloat

test = VibrationPulseTestGenerator(Defaults())
test.prepare_test(Defaults())
calibrate = ShaperCalibrate(None)
data = calibrate.calc_freq_response(np.load(sys.argv[1]))
data.set_numpy(np)
data.normalize_to_frequencies()
best, fits = calibrate.find_best_shaper(data, scv=5.0)
print(json.dumps({
    "pulses": test.gen_test(),
    "psd": data.psd_sum.tolist(),
    "best": best.name,
    "fits": {f.name: [f.freq, f.vibrs, f.smoothing] for f in fits},
}))
"""


@dataclass(frozen=True)
class Calibrated:
    """What the host made of our resonance test along y, 75 mm/s² per Hz, and what we make of it."""

    host: dict[str, Any]
    ours: dict[str, calibrate.Fit]
    spectrum: calibrate.Spectrum


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    python = os.environ.get("KALICO_PYTHON", "")
    if not python:
        pytest.skip("KALICO_PYTHON names no Kalico; see validation/kalico.py.")
    test = load_machine("mp-delta-pro"), np.array([60.0, -50.0]), "y", 75.0
    acceleration = calibrate.resonance_test(*test)
    record = tmp_path_factory.mktemp("calibration") / "record.npy"
    np.save(record, np.column_stack([np.arange(len(acceleration)) / calibrate.RATE_HZ, acceleration]))
    done = subprocess.run([python, "-c", CALIBRATE, str(record)], capture_output=True, text=True, check=True)
    spectrum = calibrate.resonance_test_psd(*test)
    return Calibrated(json.loads(done.stdout), calibrate.fits(spectrum), spectrum)


def test_the_hosts_spectrum_is_ours(calibrated: Calibrated) -> None:
    frequency, psd = calibrated.spectrum
    assert psd == pytest.approx(np.array(calibrated.host["psd"])[: len(frequency)], rel=1e-3)


def test_the_host_chooses_as_we_do(calibrated: Calibrated) -> None:
    assert calibrate.recommended(calibrated.ours.values()).kind == calibrated.host["best"]
    for kind, (hz, vibration, smoothing) in calibrated.host["fits"].items():
        assert calibrated.ours[kind].frequency_hz == pytest.approx(hz, abs=0.21)  # one step of the scan
        assert calibrated.ours[kind].vibration == pytest.approx(vibration, abs=1e-3)
        assert calibrated.ours[kind].smoothing_mm == pytest.approx(smoothing, rel=0.01)


def test_the_pulses_are_those_of_the_host(calibrated: Calibrated) -> None:
    """Ends of the quarter periods, and the acceleration in each."""
    pulses = np.array(calibrated.host["pulses"])
    time, velocity = calibrate.pulse_train(75.0)
    assert time[1:] == pytest.approx(pulses[:, 0])
    assert np.diff(velocity) / np.diff(time) == pytest.approx(pulses[:, 1])
