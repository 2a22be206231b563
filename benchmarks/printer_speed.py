"""How fast the virtual printer is on one core: one simulation alone, and eight side by side.

    python -m benchmarks.printer_speed [--seconds S] [--rounds N]

A machine plays S seconds (4) of a curve, one step from row to row, alone and then eight times at once; the best of N
rounds (7) counts. Both are nanoseconds of this thread for a step of one printer, splines and all; the last column is
how many print-seconds the eight get through in a second.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import with_effect
from models.file import load_machine
from models.machine import Machine
from models.printer.kernels.record import LANES
from models.printer.printer import SMOOTH_STEP_S, simulate_printer, simulate_printers

EFFECTS: dict[str, dict[str, Any]] = {
    "frame_mode": {"mass_kg": 8.0, "frequency_hz": 25.0, "damping_ratio": 0.03, "direction": "x"},
    "coulomb_friction": {"force_n": 2.0},
    "stribeck_friction": {"force_n": 1.0, "extra_force_n": 1.0, "velocity_mm_per_s": 10.0},
    "joint_friction": {"force_n": 2.0},
    "belt_backlash": {"width_mm": 0.05},
    "command_delay": {"delay_s": [0.001, 0.002, 0.0013]},
    "cogging": {"amplitude_mm": 0.01, "pitch_mm": 0.8},
    "torque_angle": {"amplitude_mm": 2.0},
}


def curve(machine: Machine, seconds: float) -> FloatArray:
    """(n, 3) mm: carriage heights of a shaken sweep over the bed, from rest."""
    t = np.arange(0, seconds, SMOOTH_STEP_S)
    x = 20 * np.sin(2 * np.pi * 3 * t) + np.sin(2 * np.pi * 40 * t)
    path = np.column_stack([x, 15 * np.sin(2 * np.pi * 2.2 * t), 20 + 2 * np.sin(2 * np.pi * 5 * t)])
    return machine.kinematics.inverse(path * np.minimum(1, t / 0.3)[:, None] ** 2)


def best_ns(play: Callable[[], object], rounds: int, steps: int) -> float:
    def once() -> int:
        begin = time.thread_time_ns()
        play()
        return time.thread_time_ns() - begin

    return min(once() for _ in range(rounds)) / steps


def measure(machine: Machine, command: FloatArray, rounds: int) -> tuple[float, float]:
    """ns a step of one printer: alone, and side by side."""
    lanes, steps = LANES, len(command) - 1

    def alone() -> None:
        simulate_printer(machine, command, SMOOTH_STEP_S, substeps=1)

    def together() -> None:
        simulate_printers([machine] * lanes, [command] * lanes, SMOOTH_STEP_S, substeps=1)

    alone()  # compiles, or loads what was compiled
    return best_ns(alone, rounds, steps), best_ns(together, rounds, steps * lanes)


def main() -> None:
    parser = argparse.ArgumentParser(description="Nanoseconds for a step of a virtual printer, alone and in lanes.")
    parser.add_argument("--seconds", type=float, default=4.0, help="of motion in each simulation")
    parser.add_argument("--rounds", type=int, default=7, help="of each; the best one counts")
    options = parser.parse_args()
    smooth = load_machine(Path(__file__).parents[1] / "models" / "library" / "mp-delta-pro.toml")
    command = curve(smooth, options.seconds)
    machines = {"no effects": smooth, **{name: with_effect(smooth, name, **table) for name, table in EFFECTS.items()}}
    print(f"| {LANES} lanes | alone, ns | together, ns | times | print-seconds per second |")
    print("|---|---|---|---|---|")
    for name, machine in machines.items():
        alone, together = measure(machine, command, options.rounds)
        through = SMOOTH_STEP_S * 1e9 / together
        print(f"| {name} | {alone:.0f} | {together:.0f} | {alone / together:.1f} | {through:.0f} |")


if __name__ == "__main__":
    main()
