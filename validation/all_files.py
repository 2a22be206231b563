"""Every G-code file of others, whole, through the main job: `python -m validation.all_files [FOLDER]`.

FOLDER defaults to ../shared/data/gcode. A row per file: print time, how it grew, segments, speed, and whether every
safety invariant (`validation/invariants.py`) holds; below it what does not. Ends with 1 if anything does not.
`--machine voron-300` takes another machine than mp-delta-pro, and the files where they lie.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).parents[1]
from ffcomp.compensation.job import Job, Options  # noqa: E402
from gcode.errors import GcodeError  # noqa: E402
from models.file import load_machine  # noqa: E402
from models.machine import Machine  # noqa: E402
from tests.e2e.test_files import OFFSETS  # noqa: E402
from validation.invariants import violations  # noqa: E402

COLUMNS = (
    "file",
    "print s",
    "longer by",
    "segments/s",
    "times faster than printing",
    "invariants",
)
DELTA = "mp-delta-pro"


def row(path: Path, machine: Machine, offset: tuple[float, float]) -> tuple[list[str], list[str]]:
    """The table's row, and what is wrong with the result."""
    data = path.read_bytes()
    begin = time.perf_counter()
    lines = Job(data, str(path), machine, Options(offset=offset, predict=False)).lines()
    out = b"".join(lines)
    took = time.perf_counter() - begin
    found = violations(data, out, machine, offset)
    s = lines.value.statistics
    numbers = (
        f"{s.print_time_s:.0f}",
        f"{100 * (s.print_time_s / s.original_print_time_s - 1):.2f} %",
        f"{s.segments / s.print_time_s:.0f}",
        f"{s.print_time_s / took:.0f}",
        f"{len(found)} broken" if found else "hold",
    )
    return [path.name, *numbers], found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT.parent / "shared" / "data" / "gcode")
    parser.add_argument("--machine", default=DELTA)
    asked = parser.parse_args()
    machine, broken = load_machine(asked.machine), False
    files = sorted(asked.folder.glob("*.gcode"))
    if not files:
        raise SystemExit(f"{asked.folder}: no .gcode files here.")
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
    for path in files:
        offset = OFFSETS.get(path.name, (0.0, 0.0)) if asked.machine == DELTA else (0.0, 0.0)
        try:
            cells, found = row(path, machine, offset)
        except GcodeError as error:
            print(f"| {path.name} | refused: {error} |", flush=True)
            continue
        print("| " + " | ".join(cells) + " |", *found, sep="\n", flush=True)
        broken |= bool(found)
    raise SystemExit(1 if broken else 0)


if __name__ == "__main__":
    main()
