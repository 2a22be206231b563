"""Coverage-guided fuzzing: `python -m validation.fuzz [TARGET ...] --minutes 1 --seed 1 --keep FOLDER`.

Targets: what the readers of G-code, machine files, measured runs and containers make of any bytes, and `prints`: random
prints through the main job, each result held to the invariants of `validation/invariants.py`. Inputs are mutated by
atheris (libFuzzer), which keeps those that reach new code; `prints` counts numbers instead of bytes.

FOLDER keeps each target's corpus, so that a later run goes on from there, and every input that failed, named after the
error and its place. A row per target; ends with 1 if anything has failed. Needs `pip install atheris`.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).parents[1]
SLOW_S = 10.0  # for one input: as bad as a crash
MEMORY_MB = 2048
LONGEST = 4096  # bytes of an input
TARGETS = "reader", "machine", "run", "frf", "capture", "container", "prints"
_DONE = re.compile(r"stat::number_of_executed_units:\s+(\d+)")
_EDGES = re.compile(r"cov: (\d+)")
# numba reads their bytecode, which must stay unchanged
_COMPILED = ("gcode.fast_scan", "gcode.arcs", "gcode.emit")


@dataclass(frozen=True, slots=True)
class Row:
    """What a target's run came to."""

    target: str
    executions: int
    edges: int | None  # None: not counted
    failures: int
    seconds: float

    def __str__(self) -> str:
        edges = "" if self.edges is None else str(self.edges)
        return f"| {self.target} | {self.executions} | {edges} | {self.failures} | {self.seconds:.0f} |"


# -- the targets: each takes bytes, and lets pass no error but the documented ones --


def _reader() -> Callable[[bytes], None]:
    from gcode.errors import GcodeError
    from gcode.reader import read_program

    def one(data: bytes) -> None:
        with suppress(GcodeError):
            program = read_program(data, "print.gcode")
            assert b"".join(program.lines) == data

    return one


def _machine() -> Callable[[bytes], None]:
    from models.errors import MachineFileError
    from models.file import load_machine

    return _by_file(lambda path: load_machine(path), MachineFileError, ".toml")


def _run() -> Callable[[bytes], None]:
    from ffcomp.errors import MeasurementError
    from ffcomp.measurement.recording import read_recording

    return _by_file(read_recording, MeasurementError, ".csv")


def _frf() -> Callable[[bytes], None]:
    from ffcomp.errors import MeasurementError
    from ffcomp.measurement.frf_files import read_frfs

    return _by_file(read_frfs, MeasurementError, ".csv")


def _capture() -> Callable[[bytes], None]:
    from ffcomp.errors import MeasurementError
    from ffcomp.measurement.vibration import read_vibration

    return _by_file(read_vibration, MeasurementError, ".csv")


def _container() -> Callable[[bytes], None]:
    from gcode.container import opened
    from gcode.errors import GcodeError

    def one(data: bytes) -> None:
        with suppress(GcodeError), opened(data, "print") as container:
            for source in container.prints.values():
                assert source is not None

    return one


def _by_file(read: Callable[[Path], object], documented: type[Exception], suffix: str) -> Callable[[bytes], None]:
    folder = tempfile.mkdtemp()
    path = Path(folder, "input" + suffix)

    def one(data: bytes) -> None:
        path.write_bytes(data)
        with suppress(documented):
            read(path)

    return one


_MAKERS: dict[str, tuple[Callable[[], Callable[[bytes], None]], tuple[str, ...]]] = {  # and what is watched
    "reader": (_reader, ("gcode",)),
    "machine": (_machine, ("models.file", "models.schema.documents", "models.checks", "tomllib")),
    "run": (_run, ("ffcomp.measurement",)),
    "frf": (_frf, ("ffcomp.measurement",)),
    "capture": (_capture, ("ffcomp.measurement",)),
    "container": (_container, ("gcode", "zipfile", "gzip")),
}


def seeds(target: str) -> list[bytes]:
    """What mutation begins with."""
    from tests.fuzz.test_random_programs import random_print

    prints = [random_print(seed)[:LONGEST] for seed in range(40)]
    if target == "reader":
        return prints
    if target == "machine":
        return [path.read_bytes() for path in sorted((ROOT / "models" / "library").glob("*.toml"))]
    if target == "container":
        return _containers(prints[0])
    return _measurements()[target]


def _containers(text: bytes) -> list[bytes]:
    import gzip
    import io
    import zipfile

    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Metadata/plate_1.gcode", text)
        archive.writestr("Metadata/plate_1.gcode.md5", "0" * 32)
    return [text, gzip.compress(text), file.getvalue()]


def _measurements() -> dict[str, list[bytes]]:
    rows = [k / 1000 for k in range(60)]
    run = "# position_mm: 0, 0, 5\nt_s,cmd_A_mm,cmd_B_mm,cmd_C_mm,acc_A_m_per_s2\n" + "".join(
        f"{t:.3f},{10 + t:.4f},{10 - t:.4f},10.0,{0.1 * (k % 3):.2f}\n" for k, t in enumerate(rows)
    )
    frf = "# input: cmd_A\n# output: pos_A\n# position_mm: 0, 0, 5\nfrequency_hz,real,imag,coherence\n" + "".join(
        f"{k},{1 + k / 50:.3f},{-k / 90:.3f},0.99\n" for k in range(1, 25)
    )
    raw = "#time,accel_x,accel_y,accel_z\n" + "".join(f"{t:.6f},{100 * t:.1f},3.0,9806.0\n" for t in rows)
    psd = "freq,psd_x,psd_y,psd_z,psd_xyz\n" + "".join(f"{k}.0,1e3,2e3,{k}.5,4e3\n" for k in range(5, 40))
    return {"run": [run.encode()], "frf": [frf.encode()], "capture": [raw.encode(), psd.encode()]}


# -- one target, in a process of its own --


def fuzz(target: str, seconds: int, seed: int, keep: Path) -> None:
    """Does not return: libFuzzer ends the process."""
    import atheris

    maker, watched = _MAKERS[target]
    corpus = keep / target
    if not corpus.exists():
        corpus.mkdir(parents=True)
        for number, data in enumerate(seeds(target)):
            (corpus / f"seed{number}").write_bytes(data)
    with atheris.instrument_imports(include=list(watched), exclude=list(_COMPILED)):
        for name in [name for name in sys.modules if name.startswith(watched)]:
            del sys.modules[name]  # the seeds needed them: now once more, watched
        one = maker()
    options = [f"-max_total_time={seconds}", f"-seed={seed}", f"-max_len={LONGEST}", f"-rss_limit_mb={MEMORY_MB}"]
    atheris.Setup([target, "-print_final_stats=1", *options, str(corpus)], lambda data: watch(one, data, target, keep))
    atheris.Fuzz()


def watch(one: Callable[[bytes], None], data: bytes, target: str, keep: Path) -> None:
    """Run an input; if it fails or takes long it is kept, and the fuzzing goes on."""
    begin = time.perf_counter()
    try:
        one(data)
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        failed(keep, f"{target}-{type(error).__name__}-{Path(frame.filename).stem}-{frame.lineno}", data)
        return
    if time.perf_counter() - begin > SLOW_S:
        failed(keep, f"{target}-slow", data)


def failed(keep: Path, name: str, data: bytes) -> None:
    """One input of each kind is enough."""
    folder = keep / "failures"
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / name).exists():
        (folder / name).write_bytes(data)


def fuzzed(target: str, seconds: int, seed: int, keep: Path) -> Row:
    """Run a target, and read libFuzzer's account of it."""
    begin, before = time.monotonic(), count(keep, target)
    options = {"--within": target, "--seconds": str(seconds), "--seed": str(seed), "--keep": str(keep.resolve())}
    command = [sys.executable, "-m", "validation.fuzz", *chain.from_iterable(options.items())]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, errors="replace", check=False)
    executions, edges = _DONE.search(done.stderr), _EDGES.findall(done.stderr)
    if executions is None or not edges:
        raise SystemExit(f"{target}: the fuzzer has stopped.\n{done.stderr[-3000:]}")
    spent = time.monotonic() - begin
    return Row(target, int(executions[1]), int(edges[-1]), count(keep, target) - before, spent)


def count(keep: Path, target: str) -> int:
    return len(list((keep / "failures").glob(f"{target}-*")))


# -- random prints --


def prints(seconds: int, seed: int, keep: Path) -> Row:
    """Numbers from seed million on, each a print, nine in ten of them with unknown places."""
    from tests.fuzz.test_random_programs import IN_A_ROW, Case, compensated, inverter, random_print
    from validation.invariants import violations

    begin, number, before = time.monotonic(), 1_000_000 * seed, count(keep, "prints")
    while time.monotonic() - begin < seconds:
        case = Case.of(number) if number // (10 * IN_A_ROW) % 10 else None
        data = random_print(number) if case is None else case.data

        def one(data: bytes, case: Case | None = case) -> None:
            found = case.violations() if case else violations(data, compensated(data, inverter()), inverter().machine)
            if found:
                raise AssertionError(found)

        watch(one, data, "prints", keep)
        number += 1
    spent = time.monotonic() - begin
    return Row("prints", number - 1_000_000 * seed, None, count(keep, "prints") - before, spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; default: all")
    parser.add_argument("--minutes", type=float, default=1.0, help="for each target")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=None, help="corpus and failures; default: a new folder")
    parser.add_argument("--within", help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.within:
        fuzz(asked.within, asked.seconds, asked.seed, asked.keep)
    if unknown := set(asked.targets) - set(TARGETS):
        parser.error(f"{', '.join(sorted(unknown))}: no such target.")
    keep, seconds = asked.keep or Path(tempfile.mkdtemp(prefix="fuzz-")), max(1, round(60 * asked.minutes))
    print("| target | executions | edges | failures | s |\n|---|---|---|---|---|")
    rows = []
    for target in asked.targets or TARGETS:
        work = prints if target == "prints" else lambda *told, target=target: fuzzed(target, *told)
        rows.append(work(seconds, asked.seed, keep))
        print(rows[-1], flush=True)
    print(f"\nCorpus and failures: {keep}")
    raise SystemExit(1 if any(row.failures for row in rows) else 0)


if __name__ == "__main__":
    main()
