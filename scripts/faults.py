"""Make deliberate faults in a copy of the checkout, one at a time, and print which test catches each.

    scripts/faults               all faults of scripts/faults.toml, as a table
    scripts/faults 3 10-14       some of them
    scripts/faults --list        the faults, without a run
    scripts/faults --all 7       against all tests, not only those that the table names

Exit code 1: a test catches nothing. A fault whose old text is not in its file, or is there twice, is an error.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_suffix(".toml")
PYTHON = ROOT / os.environ.get("FFCOMP_VENV", ".venv") / "bin" / "python"
NOT_COPIED = (".git", ".venv", ".hypothesis", ".*_cache", "site", "*.egg-info")
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


class Fault(NamedTuple):
    """A fault, and the tests that should catch it: files, folders, and words of pytest as `-k`."""

    what: str
    file: str
    old: str
    new: str
    tests: str

    def make(self, root: Path) -> None:
        """Put the new text in place of the old one."""
        path = root / self.file
        text = path.read_text(encoding="utf-8")
        if text.count(self.old) != 1:
            raise SystemExit(
                f"{TABLE.name}: {self.old!r} stands {text.count(self.old)} times in {self.file}, not once."
            )
        path.write_text(text.replace(self.old, self.new), encoding="utf-8")
        forget_compiled(root, self.file)


def forget_compiled(root: Path, changed: str) -> None:
    """Delete the compiled loops of a file and of all that import it: numba looks only at the loop's own file."""
    sources = {
        path: path.read_text(encoding="utf-8")
        for top in ("models", "gcode", "ffcomp")
        for path in (root / top).rglob("*.py")
    }
    stale, new = set[Path](), {root / changed}
    while new:
        stale |= new
        names = [".".join(path.relative_to(root).with_suffix("").parts) for path in new]
        new = {path for path, text in sources.items() if any(f"from {name} import" in text for name in names)} - stale
    for path in stale:
        for index in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb?"):
            index.unlink()


def caught_by(fault: Fault, tests: list[str]) -> str:
    """Return the first test that fails with the fault in a copy of the checkout; empty: none does."""
    with tempfile.TemporaryDirectory(prefix="ffcomp-fault-") as folder:
        copy = Path(folder, "checkout")
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*NOT_COPIED))
        fault.make(copy)
        words = ["-x", "-q", "-rfE", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", *tests]
        run = subprocess.run(
            [str(PYTHON), "-m", "pytest", *words],
            cwd=copy,
            env={**os.environ, "PYTHONPATH": str(copy)},
            capture_output=True,
            text=True,
            check=False,
        )
    if run.returncode not in (0, 1, 2):
        raise SystemExit(f"pytest {' '.join(words)} ended with {run.returncode}:\n{run.stdout[-2000:]}{run.stderr}")
    failed = FAILED.search(run.stdout)
    return failed[1] if failed else ""


def chosen(numbers: list[str], count: int) -> list[int]:
    """Return the numbers, from 1, of words like 3 and 10-14; all without a word."""
    ranges = [word.partition("-") for word in numbers] or [("1", "-", str(count))]
    return [n for first, _, last in ranges for n in range(int(first), int(last or first) + 1) if n <= count]


def main() -> int:
    """Try the faults; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("numbers", nargs="*", metavar="N", help="faults to try, as 3 or 10-14")
    parser.add_argument("--list", action="store_true", help="print the faults only")
    parser.add_argument("--all", action="store_true", help="run all tests against each")
    arguments = parser.parse_args()
    faults = [Fault(**each) for each in tomllib.loads(TABLE.read_text(encoding="utf-8"))["fault"]]
    missed = 0
    print("| | fault | file | caught by | s |\n|---|---|---|---|---|")
    for n in chosen(arguments.numbers, len(faults)):
        fault, began = faults[n - 1], time.monotonic()
        test = fault.tests if arguments.list else caught_by(fault, [] if arguments.all else fault.tests.split())
        missed += not test
        print(
            f"| {n} | {fault.what} | {fault.file} | {test or '**nothing**'} | {time.monotonic() - began:.0f} |",
            flush=True,
        )
    return bool(missed)


if __name__ == "__main__":
    raise SystemExit(main())
