"""Every G-code file of others, whole, through the main job: `python benchmarks/all_files.py [FOLDER]`.

FOLDER defaults to ../shared/data/gcode. A row per file: print time, how it grew, segments, speed, and whether all
that must survive has survived. Ends with 1 if anything has not.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from ffcomp.job import Job  # noqa: E402
from ffcomp.writer import original  # noqa: E402
from gcode.reader import read_program  # noqa: E402
from models.machine_file import load_machine  # noqa: E402
from tests.test_files import OFFSETS, layers  # noqa: E402
from tests.test_writer import others  # noqa: E402

COLUMNS = (
    "file",
    "print s",
    "longer by",
    "segments/s",
    "times faster than printing",
    "lines kept",
    "filament off by mm",
)


def row(path: Path) -> tuple[list[str], bool]:
    """The table's row, and whether the file came through whole."""
    data = path.read_bytes()
    offset = OFFSETS.get(path.name, (0.0, 0.0))
    begin = time.perf_counter()
    job = Job(data, str(path), load_machine("mp-delta-pro"), offset=offset, predict=False)
    out = b"".join(job.lines())
    took = time.perf_counter() - begin
    kept = others(out) == others(data) and original(out) == data
    before, after = read_program(data, offset_mm=offset), read_program(out)
    filament = float(np.abs(np.subtract(layers(after), layers(before))).max())
    s = job.summary
    numbers = (
        f"{s.print_time_s:.0f}",
        f"{100 * (s.print_time_s / s.original_print_time_s - 1):.2f} %",
        f"{s.segments / s.print_time_s:.0f}",
        f"{s.print_time_s / took:.0f}",
        "yes" if kept else "NO",
        f"{filament:.1e}",
    )
    return [path.name, *numbers], kept and filament < 1e-4


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared" / "data" / "gcode"
    files = sorted(folder.glob("*.gcode"))
    if not files:
        raise SystemExit(f"{folder}: no .gcode files here.")
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
    fine = True
    for path in files:
        cells, whole = row(path)
        fine &= whole
        print("| " + " | ".join(cells) + " |", flush=True)
    raise SystemExit(0 if fine else 1)


if __name__ == "__main__":
    main()
