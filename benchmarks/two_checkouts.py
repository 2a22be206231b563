"""Time whole commands of two checkouts side by side, in turn, and print the ratios.

    python benchmarks/two_checkouts.py --before ../old --after . [--data DIR] [--runs 5] [--only TEXT]

Each command runs once in either checkout without being counted, which compiles its kernels and fills the cache; then
the two take turns. CPU is the user and system time of the process and its children, so that other work on the machine
counts little; wall time is shown beside it. The ratio is the median of after/before over the pairs.
"""

from __future__ import annotations

import argparse
import os
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
import zlib
from dataclasses import dataclass
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
    Command("compensate, steps", "compensate {prints}/lobed_vase.gcode -m mp-delta-pro --output steps -o o.npz -q"),
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
    Command(
        "diagnose (nothing hidden)",
        "diagnose {runs} -m {data}/runs/nothing-hidden/machine.toml --json -q",
        "runs/nothing-hidden",
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
    options = parser.parse_args()
    print("| command | before, s CPU | after, s CPU | after / before | wall after, s |\n|---|---|---|---|---|")
    for command in COMMANDS:
        if options.only in command.name and (options.data / command.needs).exists():
            print(row(command, options), flush=True)


def row(command: Command, options: argparse.Namespace) -> str:
    """Time one command in both checkouts."""
    runs = sorted((options.data / "runs" / "nothing-hidden" / "runs").glob("*.csv"))
    places = {"prints": options.prints.resolve(), "data": options.data.resolve(), "runs": shlex.join(map(str, runs))}
    arguments = shlex.split(command.arguments.format(**places))
    code = [sys.executable, "-c", RUN if arguments else "import ffcomp", *arguments]
    both = [checkout.resolve() for checkout in (options.before, options.after)]
    for checkout in both:
        timed(code, checkout)
    pairs = [[timed(code, checkout) for checkout in both] for _ in range(options.runs)]
    (before, _), (after, wall) = (
        [statistics.median(x) for x in zip(*each, strict=True)] for each in zip(*pairs, strict=True)
    )
    ratio = statistics.median(pair[1][0] / pair[0][0] for pair in pairs)
    return f"| {command.name} | {before:.2f} | {after:.2f} | {ratio:.2f} | {wall:.2f} |"


def timed(code: list[str], checkout: Path) -> tuple[float, float]:
    """Run a command in a checkout; return CPU and wall seconds."""
    cache = Path(tempfile.gettempdir()) / f"ffcomp-two-checkouts-{zlib.crc32(str(checkout).encode()):08x}"
    environment = {
        **os.environ,
        "PYTHONPATH": str(checkout),
        "PYTHONHASHSEED": "0",
        "FFCOMP_LOG": "off",
        "FFCOMP_CACHE": str(cache / "tables"),
        "NUMBA_CACHE_DIR": str(cache / "compiled"),
        "OPENBLAS_NUM_THREADS": "1",
    }
    with tempfile.TemporaryDirectory() as folder:
        begin, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        answer = subprocess.run(code, cwd=folder, env=environment, capture_output=True, text=True)
        wall, end = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if answer.returncode:
        raise SystemExit(f"{checkout}: {shlex.join(code)} ended with {answer.returncode}:\n{answer.stderr[-2000:]}")
    return end.ru_utime + end.ru_stime - begin.ru_utime - begin.ru_stime, wall


if __name__ == "__main__":
    main()
