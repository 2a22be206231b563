"""Kalico's host in batch mode with the module of `integrations/klipper`, as a process of its own."""

from __future__ import annotations

import importlib.util
import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation import kalico

FOLDER = Path(__file__).parents[2] / "integrations" / "klipper"
Place = tuple[float, float, float]
E_STEPS_PER_MM = 415.0
EXACT_S, HOSTS_OWN_S = 1e-9, 25e-6  # how much too early the host may send a step
EXTRUDER = """\
nozzle_diameter: 0.4
filament_diameter: 1.75
heater_pin: gpio44
sensor_type: EPCOS 100K B57560G104F
sensor_pin: analog0
control: watermark
min_temp: 0
max_temp: 300
min_extrude_temp: 0
max_extrude_cross_section: 50
[mcu]
serial: /dev/null
"""
CONFIG = """\
[extruder]
step_pin: gpio41
dir_pin: gpio42
enable_pin: !gpio43
microsteps: 16
rotation_distance: {e_mm}
{extruder}max_stepper_error: {error_s:.9f}
[printer]
kinematics: delta
max_velocity: 300
max_accel: 3000
max_z_velocity: 300
delta_radius: 140
minimum_z_position: -5
[force_move]
enable_force_move: True
[pause_resume]
[exclude_object]
[fan]
pin: gpio50
[virtual_sdcard]
path: {folder}
[ffcomp_print]
"""


@dataclass(frozen=True)
class Steps:
    """What a motor was sent: times (n,) s, ways (n,) ±1."""

    time_s: NDArray[np.float64]
    way: NDArray[np.int64]


@dataclass(frozen=True)
class Played:
    """A print that the host has played."""

    result: dict[str, Any]
    steps: dict[str, Steps]  # of motors a b c e

    @property
    def lasts_s(self) -> float:
        return float(self.result["end_s"] - self.result["begin_s"])


def reader() -> ModuleType:
    """The module's reader of files, which needs no host."""
    return _module("motion_reader", FOLDER / "ffcomp_print" / "reader.py")


def _module(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def _oracle() -> ModuleType:
    return _module("kalico_oracle", kalico._oracle())


def play(
    folder: Path,
    command: str,
    begin: Place,
    at: Sequence[tuple[int, str]] = (),
    error_s: float = EXACT_S,
    more: str = "",
    before: Sequence[str] = (),
) -> Played:
    """Print with `command`, from rest at `begin`; `at` these numbers of records other G-code comes from elsewhere."""
    work = folder / "host"
    work.mkdir(exist_ok=True)
    places = {name: str(work / name) for name in ("config", "output", "log", "result")}
    Path(places["config"]).write_text(_towers() + _settings(folder, error_s) + more)
    for name in ("output", "result"):
        Path(places[name]).unlink(missing_ok=True)
    board = kalico._oracle().with_name("mcu.json")
    scenario = {**places, "board": str(board), "start": [*_start(begin), *before], "print": command, "at": list(at)}
    (work / "scenario").write_text(json.dumps(scenario))
    run = [kalico._python(), str(FOLDER / "batch.py"), str(work / "scenario")]
    done = subprocess.run(run, capture_output=True, text=True, timeout=300, check=False)
    if Path(places["result"]).exists():
        result = json.loads(Path(places["result"]).read_text())
    else:
        result = {"state": "stopped", "error": done.stderr[-2000:] + Path(places["log"]).read_text()[-20000:]}
    return Played(result, _steps(Path(places["output"]), board))


def _settings(folder: Path, error_s: float) -> str:
    return CONFIG.format(extruder=EXTRUDER, e_mm=3200 / E_STEPS_PER_MM, error_s=error_s, folder=folder)


def _towers() -> str:
    """Three towers as those of mp-delta-pro."""
    text = ""
    for k, (name, angle) in enumerate((("a", 0), ("b", 120), ("c", 240))):
        pins = f"step_pin: gpio{10 * k + 1}\ndir_pin: gpio{10 * k + 2}\nenable_pin: !gpio{10 * k + 3}\n"
        text += f"[stepper_{name}]\n{pins}endstop_pin: gpio{10 * k + 4}\nmicrosteps: 16\nrotation_distance: 40\n"
        text += f"angle: {angle}\n" + ("position_endstop: 320\narm_length: 300\n" if name == "a" else "")
    return text


def _start(begin: Place) -> list[str]:
    """A minute in hand, as in validation/kalico.py: the host watches the wall clock while little is queued."""
    x, y, z = begin
    there = "SET_KINEMATIC_POSITION " + " ".join(f"{axis}={mm!r}" for axis, mm in zip("XYZ", (x, y, z), strict=True))
    slow = [f"G1 Z{z + (1 - k % 2)!r} F4" for k in range(4)]
    return [there, "G90", "M82", *slow, "G4 P0", "G1 F1500"]


def _steps(output: Path, board: Path) -> dict[str, Steps]:
    source = output if output.exists() else output.with_name(f"{output.name}-mcu")
    dictionary = json.loads(board.read_text())
    rows, _ = _oracle().parse_serial(source.read_bytes(), dictionary)
    clock_hz = float(dictionary["config"]["CLOCK_FREQ"])
    found = {}
    for motor, number in zip("abce", sorted(rows), strict=False):
        clock, level = _oracle().expand(rows[number], clock_hz)
        found[motor] = Steps(clock / clock_hz, np.diff(level, prepend=0))
    return found
