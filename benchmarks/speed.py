"""How fast a print is compensated, on one core: print-seconds per second, from the bytes read to the bytes written.

    python -m benchmarks.speed [--json] [--rounds N]

Each print is compensated N times (3), as the command line does it but without the prediction; the best round counts.
The first round of all, which also loads or compiles the kernels, is reported apart.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one core: said before numpy and scipy start their threads
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import json
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from models.file import load_machine
from models.machine import Machine

ROOT = Path(__file__).parents[1]
PRINTS = ("ringing_tower", "lobed_vase", "far_star")
WARM_UP = PRINTS[0]


@dataclass(frozen=True, slots=True)
class Round:
    """One print compensated once."""

    print_s: float  # of the original, by its plan
    wall_s: float
    process_s: float
    segments: int

    @property
    def ratio(self) -> float:
        return self.print_s / self.wall_s


def compensate_once(name: str, machine: Machine, target: Path) -> Round:
    path = ROOT / "sample_prints" / f"{name}.gcode"
    wall, process = time.perf_counter(), time.process_time()
    done = compensate_file(path, path.name, machine, Options(predict=False), target)
    found = done.result.statistics
    wall, process = time.perf_counter() - wall, time.process_time() - process
    return Round(found.original_print_time_s, wall, process, found.segments)


def measure(rounds: int) -> tuple[Round, dict[str, Round]]:
    """The first round of all, and the best round of each print."""
    machine = load_machine(ROOT / "models" / "library" / "mp-delta-pro.toml")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "out.gcode")
        first = compensate_once(WARM_UP, machine, target)
        each = {name: [compensate_once(name, machine, target) for _ in range(rounds)] for name in PRINTS}
    return first, {name: min(found, key=lambda one: one.wall_s) for name, found in each.items()}


def as_table(first: Round, best: dict[str, Round]) -> str:
    lines = [
        "| print | print s | wall s | process s | print-seconds per second | segments |",
        "|---|---|---|---|---|---|",
    ]
    rows = {f"{WARM_UP}, first of all": first, **best}
    lines += [
        f"| {name} | {one.print_s:.0f} | {one.wall_s:.2f} | {one.process_s:.2f} | {one.ratio:.1f} | {one.segments} |"
        for name, one in rows.items()
    ]
    return "\n".join(lines)


def as_json(first: Round, best: dict[str, Round]) -> str:
    def row(one: Round) -> dict[str, float]:
        return {**asdict(one), "print_s_per_wall_s": one.ratio}

    prints = {name: row(one) for name, one in best.items()}
    return json.dumps({"schema": "ffcomp-speed/1", "first": row(first), "prints": prints})


def main() -> None:
    parser = argparse.ArgumentParser(description="Print-seconds compensated per second, on one core.")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    parser.add_argument("--rounds", type=int, default=3, help="of each print; the best one counts")
    options = parser.parse_args()
    first, best = measure(options.rounds)
    print((as_json if options.json else as_table)(first, best))


if __name__ == "__main__":
    main()
