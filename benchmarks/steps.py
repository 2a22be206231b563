"""How fast steps are made, how small they get, and how far off they are: exact, compressed, and sampled.

    python -m benchmarks.steps [PRINT ...] [--error-us E] [--rounds N] [--sample-us S]

Each print's plan becomes the steps of three carriages and the filament, on one core; the best of N rounds (3) counts.
`exact` and `compressed` are the whole way from the plan to an archive. `sampled` is what one would write in NumPy at
first, and it writes no file: the plan every S µs (20), inverse kinematics, whole microsteps, and straight lines between
samples. Errors are against the exact steps, which are off by half a tick; those of the sampled way are against exact
steps without the filter of rapid turns, of motors with as many steps.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ffcomp.firmware.program import firmware_plan
from ffcomp.planner.trajectory import Trajectory
from ffcomp.steps.archive import MotorSteps, read_steps
from ffcomp.steps.crossings import trajectory_pieces
from ffcomp.steps.sink import Board, MotorTotal, StepSink
from gcode.reader import read_program
from models.file import load_machine

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
PRINTS = [ROOT / "sample_prints" / f"{name}.gcode" for name in ("ringing_tower", "lobed_vase", "far_star")]
MACHINE = load_machine("mp-delta-pro")
BOARD = Board(extruder_steps_per_mm=415.0)
BLOCK_SAMPLES = 200_000


def written(plan: Trajectory, target: Path, error_s: float | None, board: Board = BOARD) -> dict[str, MotorTotal]:
    with StepSink(MACHINE, board, target, error_s) as sink:
        for pieces in trajectory_pieces(plan):
            sink.pieces(pieces)
        return sink.finish()


def sampled(plan: Trajectory, sample_s: float) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Step times (n,) s and ways (n,) ±1, of each motor."""
    step_mm = 1 / np.append(MACHINE.steps.per_motor, BOARD.extruder_steps_per_mm)
    start = _places(plan, np.array([plan.start_t[0]]))
    found: list[list[tuple[FloatArray, FloatArray]]] = [[], [], [], []]
    samples = int((plan.end_t - plan.start_t[0]) / sample_s) + 2
    for first in range(0, samples, BLOCK_SAMPLES):
        t = plan.start_t[0] + sample_s * np.arange(first, min(first + BLOCK_SAMPLES + 1, samples + 1))
        steps = (_places(plan, t) - start) / step_mm
        for motor in range(4):
            found[motor].append(_crossed(t, steps[:, motor]))
    return {
        name: (np.concatenate([t for t, _ in parts]), np.concatenate([way for _, way in parts]))
        for name, parts in zip("abce", found, strict=True)
    }


def _places(plan: Trajectory, t: FloatArray) -> FloatArray:
    place = plan.position(t)
    return np.column_stack([MACHINE.kinematics.inverse(place[:, :3]), place[:, 3]])


def _crossed(t: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where lines between samples cross the middles between whole numbers."""
    level = np.rint(steps).astype(np.int64)
    each = np.abs(np.diff(level))
    at = np.repeat(np.arange(len(each)), each)
    nth = np.arange(len(at)) - np.repeat(np.cumsum(each) - each, each)
    way = np.sign(np.diff(level))[at]
    border = level[at] + way * (nth + 0.5)
    return t[at] + (border - steps[at]) / (steps[at + 1] - steps[at]) * (t[1] - t[0]), way.astype(np.float64)


def best(work: Callable[[], object], rounds: int) -> float:
    """Seconds of this process."""
    found = []
    for _ in range(rounds):
        begin = time.process_time()
        work()
        found.append(time.process_time() - begin)
    return min(found)


def worst_us(found: dict[str, MotorSteps], exact: dict[str, MotorSteps]) -> str:
    return f"{1e6 * max(np.abs(found[m].time_s - exact[m].time_s).max() for m in exact):.2f}"


def sampled_worst_us(found: dict[str, tuple[FloatArray, FloatArray]], exact: dict[str, MotorSteps]) -> str:
    """And how many steps are too many or too few."""
    missed = sum(abs(len(t) - len(exact[m].time_s)) for m, (t, _) in found.items())
    same = [m for m, (t, _) in found.items() if len(t) == len(exact[m].time_s)]
    worst = max((np.abs(found[m][0] - exact[m].time_s).max() for m in same), default=np.nan)
    return f"{1e6 * worst:.1f}, {missed} steps wrong"


def measured(path: Path, error_s: float = 12.5e-6, sample_s: float = 20e-6, rounds: int = 3) -> list[Row]:
    """One print in all ways."""
    plan = firmware_plan(read_program(path.read_bytes(), path.name), MACHINE)
    with tempfile.TemporaryDirectory() as folder:
        exact, rows = Path(folder, "exact"), Path(folder, "rows")
        totals = written(plan, rows, error_s)
        steps, entries = (sum(getattr(total, what) for total in totals.values()) for what in ("steps", "rows"))
        spent = best(lambda: written(plan, exact, None), rounds), best(lambda: written(plan, rows, error_s), rounds)
        truth = read_steps(exact)
        sizes, off = [each.stat().st_size / 1e6 for each in (exact, rows)], worst_us(read_steps(rows), truth)
        written(plan, exact, None, replace(BOARD, shortest_turn_s=0.0))
        unfiltered = read_steps(exact)
    slow = best(lambda: sampled(plan, sample_s), 1)  # slow enough to be measured at once
    far_off = sampled_worst_us(sampled(plan, sample_s), unfiltered)
    return [
        Row("exact", spent[0], steps, plan.end_t, "-", f"{sizes[0]:.1f}", f"{0.5e6 / BOARD.clock_hz:.2f}"),
        Row(
            f"compressed, {1e6 * error_s:g} µs",
            spent[1],
            steps,
            plan.end_t,
            f"{steps / entries:.1f}",
            f"{sizes[1]:.1f}",
            off,
        ),
        Row(f"sampled, {1e6 * sample_s:g} µs", slow, steps, plan.end_t, "-", "-", far_off),
    ]


@dataclass(frozen=True, slots=True)
class Row:
    way: str
    cpu_s: float
    steps: int
    print_s: float
    steps_a_row: str
    mb: str
    worst_us: str


HEAD = """| print | way | CPU s | million steps a second | print-seconds a second | steps a row | MB | worst error, µs |
|---|---|---|---|---|---|---|---|"""


def line(name: str, row: Row) -> str:
    return (
        f"| {name} | {row.way} | {row.cpu_s:.2f} | {row.steps / row.cpu_s / 1e6:.1f} | {row.print_s / row.cpu_s:,.0f} "
        f"| {row.steps_a_row} | {row.mb} | {row.worst_us} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Steps a second: exact, compressed and sampled.")
    parser.add_argument("prints", nargs="*", type=Path, default=PRINTS)
    parser.add_argument("--error-us", type=float, default=12.5, help="of compressed steps")
    parser.add_argument("--sample-us", type=float, default=20.0, help="of the sampled way")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    print(HEAD)
    for path in options.prints:
        for row in measured(path, options.error_us * 1e-6, options.sample_us * 1e-6, options.rounds):
            print(line(path.stem, row), flush=True)


if __name__ == "__main__":
    main()
