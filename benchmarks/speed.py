"""How fast ffcomp is on one core, part by part; every section prints one table.

    python -m benchmarks.speed [SECTION ...] [--rounds N] [--prints FILE ...]

    prints     whole files, from bytes to bytes: print-seconds a CPU second, without the prediction
    length     one print repeated to 1 minute, 10 minutes and 1 hour: how time and memory grow
    where      which packages the CPU time of a job goes to
    read       G-code read in parts: µs a line, and against lines that need the general way
    steps      step timings, exact and compressed: speed, size and error
    printer    the virtual printer: ns a step alone and next to others, by effect

Times are CPU times, and the best of N rounds (3) counts. The machine is `mp-delta-pro`.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one core: said before numpy and scipy start their threads
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import cProfile
import json
import pstats
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import cycle, islice, repeat
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.request import CompensateOptions
from ffcomp.compensation.statistics import Statistics
from ffcomp.firmware.program import firmware_plan
from ffcomp.steps.archive import read_steps
from ffcomp.steps.crossings import Knots, on_grid
from ffcomp.steps.sink import Board, StepSink
from gcode.dialects import flavor_sign
from gcode.reader import read_parts, read_program
from models.effects.catalogue import with_effect
from models.file import load_machine
from models.printer.kernels.record import LANES
from models.printer.parameters import converted_printer
from models.printer.printer import SMOOTH_STEP_S, simulate_printers

ROOT = Path(__file__).parents[1]
PRINTS = [ROOT / "sample_prints" / f"{name}.gcode" for name in ("ringing_tower", "lobed_vase", "far_star")]
MACHINE = load_machine("mp-delta-pro")
LENGTHS_S = (60.0, 600.0, 3600.0)
LAYER, END = b";LAYER_CHANGE", b";TYPE:Custom"
READ_BYTES, GENERAL_BYTES = 10_000_000, 1_000_000
PLAYED_S = 4.0
ERROR_S = 12.5e-6  # of compressed steps
BOARD = Board(extruder_steps_per_mm=415.0)
EFFECTS: dict[str, dict[str, Any]] = {
    "frame_mode": {"mass_kg": 8.0, "frequency_hz": 25.0, "damping_ratio": 0.03, "direction": "x"},
    "coulomb_friction": {"force_n": 2.0},
    "joint_friction": {"force_n": 2.0},
    "belt_backlash": {"width_mm": 0.05},
    "command_delay": {"delay_s": [0.001, 0.002, 0.0013]},
    "cogging": {"amplitude_mm": 0.01, "pitch_mm": 0.8},
    "torque_angle": {"amplitude_mm": 2.0},
}

Rows = Iterator[tuple[object, ...]]


def best_s(work: Callable[[], object], rounds: int) -> float:
    """Return the shortest CPU time, s."""
    times = []
    for _ in range(rounds):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return min(times)


def compensated(path: Path, target: Path) -> Statistics:
    """Compensate a print as the command line does, but without the prediction."""
    done = compensate_file(path, path.name, MACHINE, CompensateOptions(predict=False, robust="off"), target)
    return done.result.statistics


# ---- sections: the first row is the head of the table ------------------------------------------------


def prints(paths: Sequence[Path], rounds: int) -> Rows:
    """Whole prints; the first one is also told as it runs first, when kernels and tables are loaded."""
    yield "print", "print s", "CPU s", "print-seconds a second", "µs a segment", "MB in, out"
    with TemporaryDirectory() as folder:
        target = Path(folder, "out.gcode")
        for name, path in [(f"{paths[0].stem}, first", paths[0]), *((path.stem, path) for path in paths)]:
            times = 1 if name.endswith(", first") else rounds
            cpu_s, done = best_s(lambda p=path: compensated(p, target), times), compensated(path, target)  # type: ignore[misc]
            print_s = done.original_print_time_s
            sizes = ", ".join(f"{each.stat().st_size / 1e6:.2f}" for each in (path, target))
            yield name, f"{print_s:.0f}", cpu_s, f"{print_s / cpu_s:.0f}", 1e6 * cpu_s / done.segments, sizes


def length(paths: Sequence[Path], rounds: int, lengths_s: Sequence[float] = LENGTHS_S) -> Rows:
    """The layers of the first print again and again, each length in a process of its own."""
    yield "length", "print s", "CPU s", "print-seconds a second", "peak MB"
    data = paths[0].read_bytes()
    plan = firmware_plan(read_program(data, paths[0].name), MACHINE)
    layer_s = plan.end_t / data.count(LAYER)
    with TemporaryDirectory() as folder:
        for seconds in lengths_s:
            source = Path(folder, "long.gcode")
            with source.open("wb") as file:
                file.writelines(repeated(data, round(seconds / layer_s)))
            command = [sys.executable, "-m", "benchmarks.speed", "--one", str(source)]
            told = [
                json.loads(subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout)
                for _ in range(rounds if seconds < 300.0 else 1)
            ]
            found = min(told, key=lambda each: each["cpu_s"])
            cpu_s, print_s = found["cpu_s"], found["print_s"]
            yield f"{seconds:.0f} s", f"{print_s:.0f}", cpu_s, f"{print_s / cpu_s:.0f}", f"{found['peak_mb']:.0f}"


def repeated(data: bytes, layers: int) -> Iterator[bytes]:
    """Return a print's layers again and again between its own beginning and end. It is not to be printed."""
    begin, end = data.index(LAYER), data.rindex(END)
    texts = [LAYER + text for text in data[begin:end].split(LAYER)[1:]]
    yield data[:begin]
    yield from islice(cycle(texts), max(layers, 1))
    yield data[end:]


def one(source: Path) -> None:
    """Compensate a small print, then this one; print its CPU time and the peak memory of the process as JSON."""
    import resource

    with TemporaryDirectory() as folder:
        compensated(ROOT / "docs" / "examples" / "print.gcode", Path(folder, "small.gcode"))
        began = time.process_time()
        done = compensated(source, Path(folder, "out.gcode"))
        cpu_s = time.process_time() - began
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
    print(json.dumps({"cpu_s": cpu_s, "print_s": done.original_print_time_s, "peak_mb": peak_mb}))


def where(paths: Sequence[Path], rounds: int) -> Rows:
    """CPU time by package, by the profiler of Python, which makes the calls of Python dearer than they are."""
    yield "package", *(path.stem for path in paths)
    shares = []
    with TemporaryDirectory() as folder:
        for path in paths:
            profiler, target = cProfile.Profile(time.process_time), Path(folder, "out.gcode")
            compensated(path, target)
            profiler.runcall(compensated, path, target)
            spent = Counter[str]()
            for (file, _, _), (_, _, own_s, _, _) in pstats.Stats(profiler).stats.items():  # type: ignore[attr-defined]
                spent[package_of(file)] += own_s
            shares.append({name: own_s / spent.total() for name, own_s in spent.items()})
    for name in sorted(shares[0], key=lambda name: -shares[0][name]):
        if shares[0][name] > 0.01:
            yield name, *(f"{100 * share.get(name, 0.0):.0f} %" for share in shares)


def package_of(file: str) -> str:
    """Return the package that a file of the project belongs to."""
    path = Path(file)
    if not path.is_relative_to(ROOT) or ".venv" in path.parts:
        return "libraries"
    return ".".join(path.relative_to(ROOT).parts[: 2 if path.is_relative_to(ROOT / "ffcomp") else 1])


def read(paths: Sequence[Path], rounds: int, size: int = READ_BYTES) -> Rows:
    """Each file repeated to a size; the general way is the same with a round comment in every G0 and G1."""
    yield "print", "µs a line", "million lines a second", "MB a second", "general way: µs a line"
    for path in paths:
        data = path.read_bytes()
        slow = re.sub(rb"(?m)^(G[01]\b[^;\r\n]*)", rb"\1(slowly)", data)
        per_line = []
        for text, most in ((data, size), (slow, min(size, GENERAL_BYTES))):
            times = max(1, round(most / len(text)))
            flavor = flavor_sign([text]).flavor

            def work(text: bytes = text, times: int = times, flavor: Any = flavor) -> int:
                blocks = repeat(text, times)
                return sum(len(each.lines) for each in read_parts(blocks, flavor=flavor, start=(0.0, 0.0, 0.0)))

            lines = work()
            per_line.append(1e6 * best_s(work, rounds) / lines)
        bytes_a_line = len(data) / max(data.count(b"\n"), 1)
        yield path.stem, per_line[0], 1 / per_line[0], f"{bytes_a_line / per_line[0]:.0f}", per_line[1]


def steps(paths: Sequence[Path], rounds: int) -> Rows:
    """From a plan to an archive of three carriages and the filament; the error is that against exact steps."""
    yield "print", "way", "CPU s", "million steps a second", "print-seconds a second", "MB", "worst error, µs"
    with TemporaryDirectory() as folder:
        exact, target = Path(folder, "exact"), Path(folder, "steps")
        for path in paths:
            plan = firmware_plan(read_program(path.read_bytes(), path.name), MACHINE)

            def written(to: Path, error_s: float | None, plan: Any = plan) -> int:
                sink = StepSink(MACHINE, BOARD, to, error_s)
                places = on_grid(plan.position(np.arange(plan.start_t[0], plan.end_t, 0.004)))
                sink.knots(Knots(0.1, 0.004, places))
                return sum(total.steps for total in sink.finish().values())

            count = written(exact, None)
            truth = read_steps(exact)
            for way, error_s in (("exact", None), (f"compressed, {1e6 * ERROR_S:g} µs", ERROR_S)):
                cpu_s = best_s(lambda error_s=error_s: written(target, error_s), rounds)  # type: ignore[misc]
                found = read_steps(target)
                off = max(float(np.abs(found[m].time_s - truth[m].time_s).max()) for m in truth)
                worst_us = 1e6 * (off if error_s else 0.5 / BOARD.clock_hz)
                rates = (1e-6 * count / cpu_s, f"{plan.end_t / cpu_s:.0f}")
                yield path.stem, way, cpu_s, *rates, target.stat().st_size / 1e6, worst_us


def printer(paths: Sequence[Path], rounds: int, seconds: float = PLAYED_S) -> Rows:
    """A shaken sweep over the bed, one step from row to row."""
    yield "effect", "alone, ns a step", f"one of {LANES}, ns a step", "print-seconds a second"
    t = np.arange(0, seconds, SMOOTH_STEP_S)
    x = 20 * np.sin(2 * np.pi * 3 * t) + np.sin(2 * np.pi * 40 * t)
    path = np.column_stack([x, 15 * np.sin(2 * np.pi * 2.2 * t), 20 + 2 * np.sin(2 * np.pi * 5 * t)])
    command = MACHINE.kinematics.inverse(path * np.minimum(1, t / 0.3)[:, None] ** 2)
    for name in ("none", *EFFECTS):
        machine = with_effect(MACHINE, name, **EFFECTS[name]) if name in EFFECTS else MACHINE
        one = converted_printer(machine)
        each = [partial(simulate_printers, [one] * n, [command] * n, SMOOTH_STEP_S, substeps=1) for n in (1, LANES)]
        each[0]()  # compiles, or loads what was compiled
        alone, together = (1e9 * best_s(work, rounds) / (len(command) - 1) for work in each)
        yield name, f"{alone:.0f}", f"{together / LANES:.0f}", f"{SMOOTH_STEP_S * 1e9 * LANES / together:.0f}"


SECTIONS: dict[str, Callable[[Sequence[Path], int], Rows]] = {
    each.__name__: each for each in (prints, length, where, read, steps, printer)
}


def table(rows: Rows) -> Iterator[str]:
    """Write rows as a table of Markdown."""
    for number, row in enumerate(rows):
        yield "| " + " | ".join(f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row) + " |"
        if number == 0:
            yield "|" + "---|" * len(row)


def main() -> None:
    """Measure the sections that are asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--rounds", type=int, default=3, help="the best one counts")
    parser.add_argument("--prints", type=Path, nargs="+", default=PRINTS, metavar="FILE")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_intermixed_args()
    if asked.one:
        one(asked.one)
        return
    if unknown := set(asked.sections) - set(SECTIONS):
        parser.error(f"{min(unknown)} is none of {', '.join(SECTIONS)}")
    for name in asked.sections or SECTIONS:
        print(f"\n## {name}\n", flush=True)
        for line in table(SECTIONS[name](asked.prints, asked.rounds)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
