"""Whole prints from bytes to bytes: speed, memory and how both grow with length; two processes; a first run."""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one core: said before numpy and scipy start their threads
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import hashlib
import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import cache
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.performance_ways import MACHINE, PRINTS, ROOT, sample_print
from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.compensation.statistics import Statistics
from models.file import load_machine
from tests.e2e.test_files import OFFSETS

OUTSIDE = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data")) / "gcode"
OTHER_MACHINES = {"kossel_mks-pwc.gcode": "kossel"}
LENGTHS_S = (60.0, 600.0, 3600.0, 36000.0)
REPEATED = "ringing_tower"
LARGEST = "lobed_vase"  # 3 kB of text a print-second: ten hours of it are 100 MB
SIDE_BY_SIDE_S = 10800.0
SMALL_S = 60.0
LONG_S = 60.0  # of CPU: what takes longer is not measured again
LAYER, END = b";LAYER_CHANGE", b";TYPE:Custom"
UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss, bytes
REPORT = "import sys; from benchmarks.performance_prints import load, report; "
OWN_PROCESS: dict[str, Any] = {"cwd": ROOT, "capture_output": True, "text": True}

Answer = dict[str, Any]


# ---- one print in a process of its own -----------------------------------------------------------


def in_own_process(source: Path, target: Path, machine: str, rounds: int = 1, jobs: int = 1) -> Answer:
    """The best of some rounds after a small print that loads the compiled code, and the peak memory of it all."""
    _compile()
    offset = OFFSETS.get(source.name, (0.0, 0.0))
    told = json.dumps([str(source), str(target), machine, offset, rounds, jobs])
    done = subprocess.run([sys.executable, "-c", f"{REPORT}report(sys.argv[1])", told], **OWN_PROCESS)
    if done.returncode:
        raise RuntimeError(f"{source.name} was not compensated: {done.stderr.strip().splitlines()[-1]}")
    return dict(json.loads(done.stdout))


@cache
def _compile() -> None:
    """On a machine where nothing is compiled yet, the compiler's memory must not be taken for ours."""
    subprocess.run([sys.executable, "-c", f"{REPORT}load()"], check=True, **OWN_PROCESS)


def load() -> None:
    """Compensate a small print, for the sake of the compiled code."""
    small = (ROOT / "sample_prints" / f"{REPEATED}.gcode").read_bytes()
    part = b"".join(repeated(small, [1.0], 0.0))
    compensate_file(part, "small", load_machine(MACHINE), Options(predict=False), None)


def report(told: str) -> None:
    """What `in_own_process` runs: one JSON object on standard output."""
    source, target, name, offset, rounds, jobs = json.loads(told)
    machine = load_machine(name)
    load()
    loaded_mb = _peak_mb()
    done: Statistics

    def once() -> tuple[float, float]:
        nonlocal done
        cpu, wall = time.process_time(), time.perf_counter()
        options = Options(offset=(offset[0], offset[1]), predict=False)
        found = compensate_file(Path(source), source, machine, options, Path(target), jobs=jobs)
        done = found.result.statistics
        return time.process_time() - cpu, time.perf_counter() - wall

    found = [once() for _ in range(rounds)]
    with TemporaryDirectory() as cache:
        os.environ["FFCOMP_CACHE"] = cache
        again = [once() for _ in range(1 + rounds)][1:] if found[0][0] < LONG_S else found
    s = done
    answer = {
        "print_s": s.original_print_time_s,
        "moves": s.moves,
        "segments": s.segments,
        "cpu_s": min(cpu for cpu, _ in found),
        "wall_s": min(wall for _, wall in found),
        "again_cpu_s": min(cpu for cpu, _ in again),
        "loaded_mb": loaded_mb,
        "peak_mb": _peak_mb(),
        "in_mb": Path(source).stat().st_size / 1e6,
        "out_mb": Path(target).stat().st_size / 1e6,
    }
    print(json.dumps(answer))


def _peak_mb() -> float:
    """Of this process. NOTE: on Linux `ru_maxrss` begins with that of the process that started it; VmHWM is its own."""
    status = Path("/proc/self/status")
    if status.exists():
        return float(status.read_text().split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * UNIT / 1e6


def as_they_are(rounds: int, limit: int | None = None) -> dict[str, Answer]:
    """The sample prints, and those of others that are there, these once."""
    files = [ROOT / "sample_prints" / f"{name}.gcode" for name in PRINTS] + sorted(OUTSIDE.glob("*.gcode"))
    with TemporaryDirectory() as folder:
        target = Path(folder, "out.gcode")
        found = {}
        for path in files[:limit]:
            machine = OTHER_MACHINES.get(path.name, MACHINE)
            times = rounds if path.parent.name == "sample_prints" else 1
            try:
                answer = in_own_process(path, target, machine, times)
            except RuntimeError as error:  # others' files are told of as they are, and so is what fails
                answer = {"failed": str(error)}
            found[path.name] = {"machine": machine, **answer}
    return found


# ---- prints of any length ------------------------------------------------------------------------


def repeated(data: bytes, layers_s: list[float], seconds: float) -> Iterator[bytes]:
    """A print's layers again and again until they take so long, between its own beginning and end.

    layers_s : how long each layer takes, the file's own order; what is left out at the end is not needed
    """
    begin, end = data.index(LAYER), data.rindex(END)
    layers = [LAYER + text for text in data[begin:end].split(LAYER)[1:]]
    yield data[:begin]
    taken = 0.0
    for layer, layer_s in cycle(zip(layers, layers_s, strict=False)):
        yield layer
        taken += layer_s
        if taken >= seconds:
            break
    yield data[end:]


def layer_times(name: str) -> list[float]:
    """Of a sample print, by the firmware's plan, s."""
    printed = sample_print(name, load_machine(MACHINE))
    layer, begins = printed.labels.layer, np.append(printed.planned.trajectory.start_t, printed.print_time_s)
    firsts = np.searchsorted(layer, np.arange(printed.labels.layers))
    return np.diff(np.append(begins[firsts], begins[-1])).tolist()


def written(name: str, seconds: float, folder: Path) -> Path:
    """A print of about that length as a file."""
    path = folder / f"{name}-{seconds:.0f}.gcode"
    data = (ROOT / "sample_prints" / f"{name}.gcode").read_bytes()
    with path.open("wb") as file:
        file.writelines(repeated(data, layer_times(name), seconds))
    return path


def by_length(lengths_s: tuple[float, ...], rounds_s: float) -> dict[str, Any]:
    """What prints of growing length take; short ones as often as fits into `rounds_s` print-seconds."""
    found: dict[str, Any] = {}
    with TemporaryDirectory() as folder:
        target = Path(folder, "out.gcode")
        for name, seconds in [(REPEATED, s) for s in lengths_s] + [(LARGEST, lengths_s[-1])]:
            source = written(name, seconds, Path(folder))
            rounds = int(np.clip(rounds_s / seconds, 1, 5))
            found[f"{name}, {seconds:.0f} s"] = in_own_process(source, target, MACHINE, rounds)
            source.unlink()
    tower = [each for name, each in found.items() if name.startswith(REPEATED)]
    print_s, cpu_s = np.array([[each["print_s"], each["cpu_s"]] for each in tower]).T
    each_s, once_s = np.polyfit(print_s, cpu_s, 1, w=1 / cpu_s)
    exponent = float(np.log(cpu_s[-1] / cpu_s[-2]) / np.log(print_s[-1] / print_s[-2]))
    return {"prints": found, "once_s": float(once_s), "print_s_per_s": float(1 / each_s), "exponent": exponent}


def two_processes(seconds: float) -> dict[str, Any]:
    """The same file by one process and by two: wall time, and whether the bytes are the same."""
    found: dict[str, Any] = {}
    with TemporaryDirectory() as folder:
        source, hashes = written(REPEATED, seconds, Path(folder)), set()
        for jobs in (1, 2, 1, 2):
            target = Path(folder, "out.gcode")
            answer = in_own_process(source, target, MACHINE, jobs=jobs)
            hashes.add(hashlib.sha256(target.read_bytes()).hexdigest())
            best = found.get(str(jobs))
            if best is None or answer["wall_s"] < best["wall_s"]:
                found[str(jobs)] = answer
    return {**found, "identical": len(hashes) == 1, "load": os.getloadavg()[0]}


# ---- a fresh machine -----------------------------------------------------------------------------


def first_runs(seconds: float) -> dict[str, Any]:
    """`ffcomp compensate` on a small print, as a user calls it: nothing compiled yet, and again."""
    with TemporaryDirectory() as folder:
        source = written(REPEATED, seconds, Path(folder))
        options = [str(source), "--machine", MACHINE, "-o", str(Path(folder, "out.gcode")), "--quiet", "--force"]
        script = "from ffcomp.cli.app import main; main()"
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(folder, "cache"))}
        times = []
        for _ in range(3):
            before, wall = _children_s(), time.perf_counter()
            subprocess.run(
                [sys.executable, "-c", script, "compensate", *options], env=environment, cwd=ROOT, check=True
            )
            times.append({"cpu_s": _children_s() - before, "wall_s": time.perf_counter() - wall})
        cache_mb = sum(each.stat().st_size for each in Path(folder, "cache").rglob("*") if each.is_file()) / 1e6
    return {"first": times[0], "again": min(times[1:], key=lambda each: each["cpu_s"]), "cache_mb": cache_mb}


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
