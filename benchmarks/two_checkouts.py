"""Time whole commands of two checkouts side by side, in turn, and print the ratios.

    python benchmarks/two_checkouts.py --before ../old --after . [--data DIR] [--runs 5] [--only TEXT]

Each command runs once in either checkout without being counted, which compiles its kernels and fills the cache; then
the two take turns. CPU is the user and system time of the process and its children, so that other work on the machine
counts little; wall time is shown beside it. The ratio is the median of after/before over the pairs.

    python benchmarks/two_checkouts.py --before ../old --after . --whole

compensates whole prints instead, as usual and plain, and shows beside the time the memory, the file's size, the largest
acceleration of a carriage, and the contour error: as this checkout simulates either file on the machine as it is known,
and on four that are off by 5 and by 10 % (standard deviation, their median). A first row is of a first print, with
nothing compiled.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import zlib
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

ROOT = Path(__file__).parents[1]
RUN = "from ffcomp.cli.app import main; main()"


@dataclass(frozen=True)
class Command:
    """One command; FILE names are looked up in the folders of prints."""

    name: str
    arguments: str
    needs: str = ""  # a file of the outside data


COMMANDS = (
    Command("import ffcomp", ""),
    Command("--help", "--help"),
    Command("compensate tower (delta)", "compensate {prints}/ringing_tower.gcode -m mp-delta-pro -o out.gcode -q"),
    Command("compensate vase (delta)", "compensate {prints}/lobed_vase.gcode -m mp-delta-pro -o out.gcode -q"),
    Command("compensate star (delta)", "compensate {prints}/far_star.gcode -m mp-delta-pro -o out.gcode -q"),
    Command("compensate, steps", "compensate {prints}/lobed_vase.gcode -m mp-delta-pro --kind steps -o o.npz -q"),
    Command(
        "compensate tower (cartesian)",
        "compensate {data}/gcode/ender3_ringing_tower.gcode -m ender-3 -o out.gcode -q",
        "gcode/ender3_ringing_tower.gcode",
    ),
    Command(
        "compensate tower (CoreXY)",
        "compensate {data}/gcode/ender3_ringing_tower.gcode -m voron-300 -o out.gcode -q",
        "gcode/ender3_ringing_tower.gcode",
    ),
    Command(
        "compensate kossel_mks-pwc",
        "compensate {data}/gcode/kossel_mks-pwc.gcode -m kossel -o out.gcode -q",
        "gcode/kossel_mks-pwc.gcode",
    ),
    Command("estimate", "estimate {prints}/ringing_tower.gcode -m mp-delta-pro --json"),
    Command("simulate", "simulate {prints}/ringing_tower.gcode -m mp-delta-pro --from 80 --to 100 --json -q"),
    Command("compare", "compare {prints}/lobed_vase.gcode -m mp-delta-pro --sample 3% --quality-um 0 --json -q"),
    Command("frf", "frf -m mp-delta-pro --at 0,0 --at -80,0"),
    Command("machines show", "machines show mp-delta-pro"),
    Command("machines check", "machines check mp-delta-pro"),
    Command("identify plan", "record plan --for identify -m mp-delta-pro -o excite.gcode --json"),
    Command(
        "gap",
        "gap {data}/runs/nothing-hidden/runs/infill-centre-1.csv {data}/runs/nothing-hidden/runs/infill-centre-2.csv "
        "-m {data}/runs/nothing-hidden/machine.toml --json",
        "runs/nothing-hidden",
    ),
    *(
        Command(
            f"diagnose ({hidden})",
            f"diagnose {{runs}} -m {{data}}/runs/{hidden}/machine.toml --json -q",
            f"runs/{hidden}",
        )
        for hidden in ("nothing-hidden", "coulomb-friction", "effector-mass")
    ),
)


def main() -> None:
    """Print a row for each command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, required=True, help="the checkout to compare with")
    parser.add_argument("--after", type=Path, default=ROOT)
    parser.add_argument("--prints", type=Path, default=ROOT / "sample_prints")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data", help="data from outside")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--only", default="", help="commands whose name holds this text")
    parser.add_argument("--whole", action="store_true", help="whole prints: time, memory, size, errors")
    options = parser.parse_args()
    if options.whole:
        whole_prints(options)
        return
    print("| command | before, s CPU | after, s CPU | after / before | wall after, s |\n|---|---|---|---|---|")
    for command in COMMANDS:
        if options.only in command.name and (options.data / command.needs).exists():
            print(row(command, options), flush=True)


def row(command: Command, options: argparse.Namespace) -> str:
    """Time one command in both checkouts."""
    runs = sorted((options.data / command.needs / "runs").glob("*.csv"))
    places = {"prints": options.prints.resolve(), "data": options.data.resolve(), "runs": shlex.join(map(str, runs))}
    arguments = shlex.split(command.arguments.format(**places))
    code = [sys.executable, "-c", RUN if arguments else "import ffcomp", *arguments]
    both = [checkout.resolve() for checkout in (options.before, options.after)]
    for checkout in both:
        timed(code, checkout)
    pairs = [[timed(code, checkout) for checkout in both] for _ in range(options.runs)]
    before, after = (statistics.median(run.cpu_s for run in each) for each in zip(*pairs, strict=True))
    wall = statistics.median(new.wall_s for _, new in pairs)
    ratio = statistics.median(new.cpu_s / old.cpu_s for old, new in pairs)
    return f"| {command.name} | {before:.2f} | {after:.2f} | {ratio:.2f} | {wall:.2f} |"


@dataclass(frozen=True)
class Print:
    """A print for a machine; its errors are simulated up to `until_s`, 0: not at all."""

    file: str
    machine: str
    until_s: float = 0.0


PRINTS = (
    Print("{prints}/ringing_tower.gcode", "mp-delta-pro", 1e4),
    Print("{prints}/lobed_vase.gcode", "mp-delta-pro", 1e4),
    Print("{prints}/far_star.gcode", "mp-delta-pro", 1e4),
    Print("{data}/gcode/ender3_ringing_tower.gcode", "ender-3", 300.0),
    Print("{data}/gcode/ender3_ringing_tower.gcode", "voron-300", 300.0),
    Print("{data}/gcode/ender3_ringing_tower.gcode", "mp-delta-pro"),
    Print("{data}/gcode/flsun_v400_retract-tower.gcode", "mp-delta-pro"),
    Print("{data}/gcode/gcodepreview_vase.gcode", "mp-delta-pro"),
    Print("{data}/gcode/kossel_mks-pwc.gcode", "kossel"),
    Print("{data}/gcode/makreeltje_cura_slicer.gcode", "mp-delta-pro"),
    Print("{data}/gcode/makreeltje_orca_slicer.gcode", "mp-delta-pro"),
)
WAYS = {"as usual": "", "plain": "--robust off"}
OFF, PLANTS = (0.0, 0.05, 0.10), 4  # relative standard deviation, and machines of each


@dataclass(frozen=True)
class Run:
    """A command that has ended."""

    cpu_s: float
    wall_s: float
    memory_mb: float
    answer: str


def whole_prints(options: argparse.Namespace) -> None:
    """Print two rows for each print and way: before and after."""
    both = {"before": options.before.resolve(), "after": options.after.resolve()}
    places = {"prints": options.prints.resolve(), "data": options.data.resolve()}
    names = ("print", "way", "checkout", "CPU s", "wall s", "print s a CPU s", "memory MB", "file MB", "peak m/s²")
    print("| " + " | ".join((*names, *(f"contour µm, {100 * off:g} % off" for off in OFF))) + " |")
    print("|" + "---|" * (len(names) + len(OFF)), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        first = shlex.split(f"compensate {places['prints']}/ringing_tower.gcode -m mp-delta-pro -q -o {folder}/o.gcode")
        for name, checkout in () if options.only else both.items():
            shutil.rmtree(cache_of(checkout), ignore_errors=True)
            run = timed([sys.executable, "-c", RUN, *first], checkout)
            print(f"| ringing_tower | the first of all | {name} | {run.cpu_s:.1f} | {run.wall_s:.1f} | | |", flush=True)
        for each in PRINTS:
            file = each.file.format(**places)
            for way, flags in WAYS.items():
                if options.only not in f"{Path(file).stem} {each.machine} {way}" or not Path(file).exists():
                    continue
                for name, checkout in both.items():
                    out = Path(folder, f"{name}.gcode")
                    words = f"compensate {shlex.quote(file)} -m {each.machine} {flags} -q --json -o {out}"
                    code = [sys.executable, "-c", RUN, *shlex.split(words)]
                    runs = [timed(code, checkout) for _ in range(options.runs + 1)][1:]
                    print(whole_row(each, Path(file).stem, way, name, runs, out), flush=True)


def whole_row(each: Print, title: str, way: str, checkout: str, runs: list[Run], out: Path) -> str:
    """Return the row of a compensated print."""
    cpu, wall, memory = (
        statistics.median(getattr(run, name) for run in runs) for name in ("cpu_s", "wall_s", "memory_mb")
    )
    told = json.loads(runs[0].answer[runs[0].answer.index("{") :])
    peak = told["predicted"]["compensated"]["peak_command_acceleration_mm_per_s2"]
    speed, size = told["print_time_s"] / cpu, out.stat().st_size
    cells = [f"{cpu:.2f}", f"{wall:.2f}", f"{speed:.0f}", f"{memory:.0f}", f"{1e-6 * size:.2f}", f"{1e-3 * peak:.1f}"]
    with get_context("spawn").Pool(
        1
    ) as apart:  # a process that grows here would count in the memory of the next command
        cells += [f"{error:.2f}" for error in apart.apply(errors_of, (out, each))]
    return f"| {title}, {each.machine} | {way} | {checkout} | " + " | ".join(cells) + " |"


def errors_of(out: Path, each: Print) -> list[float]:
    """Simulate a print in this checkout; return the contour error for each of `OFF`, µm rms while filament flows."""
    from ffcomp.api.machines import load_machine
    from ffcomp.api.simulation import simulate
    from ffcomp.simulation.expectation import draw_plants

    if not each.until_s:
        return []
    machine, errors = load_machine(each.machine), list[float]()
    for off in OFF:
        plants = draw_plants(machine, off, PLANTS) if off else [machine]
        found = [simulate(out, machine, plant=plant, to_s=each.until_s).track.contour_rms_um for plant in plants]
        errors.append(statistics.median(found))
    return errors


def cache_of(checkout: Path) -> Path:
    """Return where a checkout's kernels and tables are kept meanwhile."""
    return Path(tempfile.gettempdir()) / f"ffcomp-two-checkouts-{zlib.crc32(str(checkout).encode()):08x}"


def timed(code: list[str], checkout: Path) -> Run:
    """Run a command in a checkout."""
    cache = cache_of(checkout)
    environment = {
        **os.environ,
        "PYTHONPATH": str(checkout),
        "PYTHONHASHSEED": "0",
        "FFCOMP_LOG": "off",
        "FFCOMP_CACHE": str(cache / "tables"),
        "NUMBA_CACHE_DIR": str(cache / "compiled"),
        "OPENBLAS_NUM_THREADS": "1",
    }
    with (
        tempfile.TemporaryDirectory() as folder,
        tempfile.TemporaryFile("w+") as answer,
        tempfile.TemporaryFile("w+") as said,
    ):
        started = time.perf_counter()
        process = subprocess.Popen(code, cwd=folder, env=environment, stdout=answer, stderr=said)
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - started
        answer.seek(0)
        said.seek(0)
        if status:
            raise SystemExit(f"{checkout}: {shlex.join(code)} ended with {status}:\n{said.read()[-2000:]}")
        return Run(used.ru_utime + used.ru_stime, wall, used.ru_maxrss / 1024, answer.read())


if __name__ == "__main__":
    main()
