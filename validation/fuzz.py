"""Random prints through the main job: `python -m validation.fuzz --minutes 1 --seed 1 --keep FOLDER`.

Each result is held to the invariants of `validation/invariants.py`. Nine in ten prints have unknown places. FOLDER
keeps every print that failed, named after the error and its place; the command then ends with 1. The readers of G-code,
machine files, measurements and containers are fuzzed in `tests`: HYPOTHESIS_PROFILE=default draws new inputs each time.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from tests.fuzz.test_random_programs import IN_A_ROW, Case, compensated, inverter, random_print
from validation.invariants import violations

SLOW_S = 10.0  # for one print: as bad as a crash


def violations_of(number: int) -> tuple[bytes, Callable[[], list[str]]]:
    """Return a print, and what compensates it and says what is wrong."""
    if number // (10 * IN_A_ROW) % 10:
        case = Case.of(number)
        return case.data, case.violations
    data = random_print(number)
    return data, lambda: violations(data, compensated(data, inverter()), inverter().machine)


def failed(number: int, keep: Path) -> bool:
    """Run a print; if it fails or takes long it is kept, one of each kind, and the fuzzing goes on."""
    (data, one), begin = violations_of(number), time.perf_counter()
    try:
        found = one()
        slow = time.perf_counter() - begin > SLOW_S
        name = "violation" if found else "slow" if slow else ""
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        name = f"{type(error).__name__}-{Path(frame.filename).stem}-{frame.lineno}"
    if name:
        keep.mkdir(parents=True, exist_ok=True)
        (keep / f"{name}.gcode").write_bytes(data)
    return bool(name)


def main() -> int:
    """Fuzz for a time; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=None, help="failures; default: a new folder")
    asked = parser.parse_args()
    keep = asked.keep or Path(tempfile.mkdtemp(prefix="fuzz-"))
    begin, first, failures, prints = time.monotonic(), 1_000_000 * asked.seed, 0, 0
    while time.monotonic() - begin < 60 * asked.minutes:
        failures += failed(first + prints, keep)
        prints += 1
    print(f"{prints} prints, {failures} failures{f', kept in {keep}' if failures else ''}")
    return bool(failures)


if __name__ == "__main__":
    raise SystemExit(main())
