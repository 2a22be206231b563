"""How fast G-code is read, in parts: µs a line, lines/s, MB/s, and how much faster than the way for unusual lines.

    python -m benchmarks.reader_speed [FILE ...] [--megabytes N] [--rounds N]

Each file is repeated to N megabytes (30) and read part by part; the best round (of 3) counts, in CPU time. The general
way is the same file, 1 MB of it, with a round comment in every G0 and G1: its lines are split into words one by one.
Then: the kernel alone on plain lines, a first run that has to compile it, and how memory grows.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one core: said before numpy starts its threads
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import islice, repeat
from pathlib import Path

import numpy as np

from gcode.arcs import ARC_TOLERANCE_MM
from gcode.dialects import detect_flavor
from gcode.fast_scan import Cursor, Modes, follow
from gcode.reader import read_parts
from gcode.text import PART_BYTES

ROOT = Path(__file__).parents[1]
OUTSIDE = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data")) / "gcode"
GENERAL_BYTES = 1_000_000
KERNEL_LINES = 300_000
FIRST_RUN = """
import time; began = time.process_time()
from gcode.reader import read_program
loaded = time.process_time(); read_program(b"G1 X1 F60\\n", start=(0.0, 0.0, 0.0))
print(loaded - began, time.process_time() - loaded)
"""
GROWTH = """
import resource, sys; from gcode.reader import read_parts
data = open(sys.argv[1], "rb").read()
def read(bytes):
    blocks = (data for _ in range(bytes // len(data)))
    for part in read_parts(blocks, flavor="klipper", start=(0.0, 0.0, 0.0)): pass
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
read(len(data)); before = read(len(data))
print((read(int(sys.argv[2])) - before) * (1 if sys.platform == "darwin" else 1024) / 1e6)
"""


def best(rounds: int, work: Callable[[], int]) -> tuple[int, float]:
    """What the work returns, and its shortest CPU time in s."""
    times = []
    for _ in range(rounds):
        began = time.process_time()
        answer = work()
        times.append(time.process_time() - began)
    return answer, min(times)


def repeated(data: bytes, size: int) -> Iterator[bytes]:
    return islice(repeat(data), max(1, round(size / len(data))))


def read(data: bytes, size: int) -> int:
    """Read the data again and again, up to that size; returns how many lines that were."""
    parts = read_parts(repeated(data, size), flavor=detect_flavor([data]), start=(0.0, 0.0, 0.0))
    return sum(len(part.lines) for part in parts)


def row(path: Path, size: int, rounds: int) -> str:
    data = path.read_bytes()
    slow = re.sub(rb"(?m)^(G[01]\b[^;\r\n]*)", rb"\1(slowly)", data)
    lines, seconds = best(rounds, lambda: read(data, size))
    general_lines, general_seconds = best(1, lambda: read(slow, GENERAL_BYTES))
    plain = len(re.findall(rb"(?m)^(?:G[01] |\s*;|$)", data)) / data.count(b"\n")
    rate, general = lines / seconds, general_lines / general_seconds
    megabytes = lines / (data.count(b"\n") or 1) * len(data) / 1e6
    return (
        f"| {path.name} | {megabytes:.0f} | {plain:.1%} | {1e6 / rate:.2f} | {rate / 1e6:.2f} | "
        f"{megabytes / seconds:.0f} | {1e6 / general:.2f} | {rate / general:.0f} |"
    )


def kernel_row(rounds: int) -> str:
    numbers = np.random.default_rng(1).uniform(-90, 90, (KERNEL_LINES, 3))
    data = b"".join(b"G1 X%.3f Y%.3f E%.5f\n" % tuple(each) for each in numbers)
    text = np.frombuffer(data + b"\n", dtype=np.uint8)
    ends, moves = np.empty((KERNEL_LINES, 4)), np.empty((KERNEL_LINES, 3), dtype=np.int64)
    here = Cursor(0, 0, 0, 0, 1, 0, 0.0, 0.0, 0.0, 0.0, 10.0, 0.0, -1, False)
    modes = Modes(0.0, 0.0, 0.0, False, False, 1.0, 1.0, 1.0, ARC_TOLERANCE_MM)
    work = lambda: follow(text, np.zeros(1, dtype=np.bool_), here, modes, 0, ends, moves, moves, np.empty((1, 2))).line  # noqa: E731
    lines, seconds = best(rounds + 1, work)
    speed = f"{lines / seconds / 1e6:.1f} million lines/s, {len(data) / seconds / 1e6:.0f} MB/s"
    return f"The kernel alone, `G1 X Y E`: {speed}."


def own_process(script: str, *arguments: str, **environment: str) -> list[float]:
    answer = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        env={**os.environ, **environment}, cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [float(number) for number in answer.stdout.split()]


def first_runs() -> str:
    with tempfile.TemporaryDirectory() as cache:
        (_, compiling), (loading, cached) = (own_process(FIRST_RUN, NUMBA_CACHE_DIR=cache) for _ in range(2))
    return f"The first read takes {compiling:.1f} s on a fresh machine, {cached:.1f} s later; imports {loading:.1f} s."


def main() -> None:
    parser = argparse.ArgumentParser(description="How fast G-code is read, in parts.")
    parser.add_argument("files", type=Path, nargs="*", help="default: the sample prints and the prints from outside")
    parser.add_argument("--megabytes", type=float, default=30.0, help="each file is repeated to that size")
    parser.add_argument("--rounds", type=int, default=3, help="of each file; the best one counts")
    options = parser.parse_args()
    files = options.files or sorted((ROOT / "sample_prints").glob("*.gcode")) + sorted(OUTSIDE.glob("*.gcode"))
    print("| print | MB | plain lines | µs a line | million lines/s | MB/s | general way: µs a line | times faster |")
    print("|---|---|---|---|---|---|---|---|")
    read(files[0].read_bytes(), PART_BYTES)
    for path in files:
        print(row(path, int(1e6 * options.megabytes), options.rounds), flush=True)
    print(f"\n{kernel_row(options.rounds)}\n{first_runs()}")
    growth = own_process(GROWTH, str(files[0]), str(int(2e6 * options.megabytes)))[0]
    print(f"Memory grows by {growth:.0f} MB from one to {2 * options.megabytes:.0f} MB read in parts.")


if __name__ == "__main__":
    main()
