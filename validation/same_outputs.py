"""Prove that two checkouts of ffcomp answer alike: every verb, on prints and measurements, before and after a change.

    python validation/same_outputs.py capture CHECKOUT -o before --data ../shared/data --quick
    python validation/same_outputs.py capture OTHER_CHECKOUT -o after --data ../shared/data --quick
    python validation/same_outputs.py compare before after

Exit codes, the names of the files that are written, G-code, CSV and step archives must be the same to the last byte.
JSON and TOML must have the same keys (new ones may come) and the same numbers within a relative tolerance. Sentences
may be reworded, as long as their numbers stay; error messages may change altogether and are only shown. What depends
on the day, the place or the clock is taken out first: versions, hashes, dates, paths, seconds of computing.

Both must be given the same `--samples` and `--examples`; by default they are those of the checkout this file lies in.
Compiled code stays in the folder for temporary files, one for each state of the sources.

Needs numpy, and a python that has ffcomp's dependencies (`--python`; by default the one that runs this).
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import json
import math
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import asdict, dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
QQS, KOSSEL, ENDER, VORON = "flsun-qqs", "kossel", "ender-3", "voron-300"
MACHINES = ("mp-delta-pro", "mp-delta-pro-as-printed", QQS, KOSSEL, ENDER, VORON)
SAMPLES = ("ringing_tower", "lobed_vase", "far_star")

PRINTS = {  # of others: the machine, the offset, and whether --quick takes it too
    "ender3_ringing_tower.gcode": (ENDER, "0,0", False),
    "flsun_v400_retract-tower.gcode": (QQS, "0,0", False),
    "gcodepreview_benchy_arcs.gcode": (QQS, "auto", False),
    "gcodepreview_vase.gcode": (VORON, "auto", False),
    "kossel_mks-pwc.gcode": (KOSSEL, "0,0", False),
    "makreeltje_cura_slicer.gcode": (VORON, "0,0", False),
    "makreeltje_orca_slicer.gcode": (VORON, "0,0", False),
    "real/anand_hook.gcode.gz": (VORON, "auto", False),
    "real/chest_benchy.gcode.gz": (QQS, "auto", False),
    "real/chest_primcube.bgcode": (VORON, "auto", True),
    "real/chest_primcube.gcode.gz": (VORON, "auto", False),
    "real/demestav_hook.gcode.gz": (VORON, "0,0", False),
    "real/fast_part.gcode.gz": (VORON, "73,64", False),
    "real/gkerr_motor.gcode.gz": (VORON, "auto", False),
    "real/helix_calicat.gcode.gz": (QQS, "auto", False),
    "real/kage_cura.gcode.gz": (ENDER, "0,0", False),
    "real/kage_kirimoto.gcode.gz": (ENDER, "0,0", True),
    "real/kage_psissue1.gcode.gz": (QQS, "auto", False),
    "real/libbg_ps281.bgcode": (VORON, "30,67", True),
    "real/mk404_vfa.gcode.gz": (VORON, "78,2", True),
    "real/t1_pa300.gcode.gz": (QQS, "0,0", True),
    "real/v400_cube.gcode.gz": (QQS, "0,0", False),
    "real/v400_overhang.gcode.gz": (QQS, "0,0", False),
}
BASSCO = "data/vibration/klipper_resonances_bassco"
LABELLED = ("nothing-hidden", "effector-mass", "coulomb-friction")

CLOCK = {"compute_time_s", "wall_s", "print_s_per_wall_s", "version", "sha256", "input_sha256"}  # keys left out
TOOK = re.compile(r"(?:\[\d+\])?\.seconds")  # what the whole answer took; deeper down it is a result
SPENT = re.compile(rb"[\d.]+ s, \d+ times faster")  # in a message
WORDS_ONLY = {"error"}  # keys whose sentence may change altogether
EXACT_TEXT = {"name", "schema"}  # keys whose text is no sentence, whatever it looks like
LOOSE = {"compare": 1e-6}  # relative tolerance of a verb's numbers
TIGHT = 1e-9  # of all others
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
GLOBS = ("*", "?")


@dataclass(frozen=True, slots=True)
class Run:
    """One command, and the files or folders that it writes."""

    name: str
    args: tuple[str, ...]
    writes: tuple[str, ...] = ()
    quick: bool = True

    @property
    def verb(self) -> str:
        """What it asks ffcomp for."""
        return self.args[0]


@dataclass(slots=True)
class Kept:
    """The outcome of one command."""

    name: str
    args: list[str]
    exit_code: int
    cpu_s: float
    files: dict[str, str] = field(default_factory=dict)  # its kind by what was written, `stdout` and `stderr` too


# NAME: COMMAND -> FILES that it writes; ~ in front: not with --quick. In an order in which each finds what it reads.
RUNS = """
machines list: machines list --json
machines diff: machines diff mp-delta-pro mp-delta-pro-as-printed --json
machines import: machines import examples/printer.cfg -o imported.toml --json -> imported.toml
machines new: machines new mine -o mine.toml --from kossel -> mine.toml
machines show, unknown: machines show no-such-machine --json
frf mp-delta-pro: frf -m mp-delta-pro --at 0,0 --at -80,0 --step-hz 2 --json
frf voron-300: frf -m voron-300 --at 100,150 --step-hz 2 --json
frf of nozzle: frf -m mp-delta-pro --of nozzle --step-hz 5 --json
frf of acceleration: frf -m mp-delta-pro --of acceleration --step-hz 5 --json
~frf of carriage-alone: frf -m mp-delta-pro --of carriage-alone --added-mass-kg 0.1 --step-hz 5 --json
~frf of effector-alone: frf -m mp-delta-pro --of effector-alone --with-arms --step-hz 5 --json
frf measured: frf -m mp-delta-pro --at 0,0 --measured examples/measured.csv --step-hz 10
{samples}
compensate again: compensate far_star.out.gcode -m mp-delta-pro -o again.gcode --json
compensate slowly: compensate samples/far_star.gcode -m mp-delta-pro -o s.gcode --json --strict -> s.gcode
~small robust: {small} -o small.robust.gcode --json --robust on -> small.robust.gcode
small offset: {small} -o small.offset.gcode --json --offset-mm 20,-15 --flavor marlin -> small.offset.gcode
small coarse: {small} -o coarse.gcode --json --max-segments-per-second 150 --no-predict --tolerance-um 5 -> coarse.gcode
small shaper-off: {small} -o small.shaper-off.gcode --json --no-keep-shaper -> small.shaper-off.gcode
small steps: {small} --kind steps {steps} -o small.steps.npz --json -> small.steps.npz
simulate small steps: simulate small.steps.npz -m mp-delta-pro --from 4 --to 5 -o steps.csv --json -> steps.csv
small klipper-steps: {small} --kind klipper-steps {steps} -o small.klipper-steps.npz --json -> small.klipper-steps.npz
~simulate small klipper-steps: simulate small.klipper-steps.npz -m mp-delta-pro --from 4 --to 5 -o k.csv --json -> k.csv
~small plain steps: {small} --kind steps --inverse none {steps} -o plain.npz -> plain.npz
~two at once: compensate examples/print.gcode samples/far_star.gcode -m kossel --output-dir two --json -j 2 -> two
no such file: compensate nothing.gcode -m mp-delta-pro -o n.gcode --json
no such option: {small} --no-such-option
no extruder steps: {small} --kind steps -o n.npz
odd files on mp-delta-pro: compensate data/gcode/odd/* -m mp-delta-pro --output-dir odd-delta --json -> odd-delta
odd files on voron-300: compensate data/gcode/odd/* -m voron-300 --output-dir odd-voron --json -> odd-voron
{prints}
~further in: compensate data/gcode/real/mk404_vfa.gcode.gz -m voron-300 --offset-mm 78,10 -o vfa.gcode --json -> vfa.gcode
simulate short: {tower} --to 81 -o short.csv -> short.csv
~simulate: {tower} --to 90 -o run.csv -> run.csv
~simulate voron: simulate examples/print.gcode -m voron-300 --offset-mm 150,150 -o voron.csv --json -> voron.csv
~simulate kossel: simulate examples/print.gcode -m kossel --plant mp-delta-pro --to 4 -o kossel.csv --json -> kossel.csv
compare short: {compare} --only mzv,fbs-lti --quality-um 0
~compare robust: {compare} --only mzv,fbs-robust --quality-um 0
~compare: compare samples/ringing_tower.gcode -m mp-delta-pro --sample 2% --only zv,ei-calibrated --report c.html --json -> c.html
~compare mismatched: {compare} --only mzv --mismatch 10% --seeds 2
record plan mp-delta-pro: {plan} mp-delta-pro -o plan-delta.gcode --json --at 0,0 -> plan-delta.gcode plan-delta.json
record plan voron-300: {plan} voron-300 -o plan-voron.gcode --json --kind sweep -> plan-voron.gcode plan-voron.json
~record plan, log-sweep: {plan} flsun-qqs -o log.gcode --kind log-sweep {log_sweep} --json -> log.gcode log.json
identify fit ender-3: identify fit {ender} -m ender-3 -o fit-ender.toml --json -q -> fit-ender.toml
~identify fit voron-300: identify fit {voron} -m voron-300 -o fit-voron.toml --json -q -> fit-voron.toml
{hidden}
~identify fit runs: identify fit {runs}/multisine-centre-?.csv -m {file} -o fit-delta.toml --json -q -> fit-delta.toml
"""  # noqa: E501
SAMPLE = """
compensate {0}: compensate samples/{0}.gcode -m mp-delta-pro -o {0}.out.gcode --json -> {0}.out.gcode
estimate {0}: estimate samples/{0}.gcode -m mp-delta-pro --json
~estimate {0} compensated: estimate {0}.out.gcode --json
restore {0}: restore {0}.out.gcode -o {0}.back.gcode -> {0}.back.gcode
~show {0}: show {0}.out.gcode -o {0}.png --json -> {0}.png
~compensate {0} as steps: {steps} --kind steps -o {0}.steps.npz --json -> {0}.steps.npz
~compensate {0} as klipper-steps: {steps} --kind klipper-steps -o {0}.klipper.npz --json -> {0}.klipper.npz
"""
MACHINE = """
machines show {0}: machines show {0} --json
machines check {0}: machines check {0} --json
"""
HIDDEN = """
gap {0}: gap data/runs/{0}/runs/*.csv -m data/runs/{0}/machine.toml --json
~diagnose {0}: diagnose {2}/runs/*.csv -m {2}/machine.toml -o {1}.toml --report {1}.html --json -q -> {1}.toml {1}.html
"""


def all_runs() -> list[Run]:
    """Return every command."""
    extruder = "--extruder-steps-per-mm 400"
    samples = [MACHINE.format(name) for name in MACHINES]
    for name in SAMPLES:
        samples.append(SAMPLE.format(name, steps=f"compensate samples/{name}.gcode -m mp-delta-pro {extruder}"))
    prints = []
    for name, (machine, offset, quick) in PRINTS.items():
        given, out = f"data/gcode/{name} -m {machine} --offset-mm {offset}", f"print-{Path(name).name}"
        prints.append(f"{'' if quick else '~'}compensate {name}: compensate {given} -o {out} --json -> {out}")
        if offset != "auto":
            prints.append(f"~estimate {name}: estimate {given} --json")
    text = RUNS.format(
        samples="\n".join(samples),
        prints="\n".join(prints),
        hidden="\n".join(HIDDEN.format(name, f"better-{name}", f"data/runs/{name}") for name in LABELLED),
        small="compensate examples/print.gcode -m mp-delta-pro",
        steps=extruder,
        tower="simulate samples/ringing_tower.gcode -m mp-delta-pro --from 80 --json",
        compare="compare examples/print.gcode -m mp-delta-pro --json --sample 15%",
        plan="record plan --for identify -m",
        log_sweep="--flavor marlin --at line-of-action --axes xyz",
        ender=f"{BASSCO}/ender3__resonances_x_20210821_152037.csv {BASSCO}/ender3__resonances_y_20210630_223910.csv",
        voron=f"{BASSCO}/v24__resonances_x_20230306_224517.csv {BASSCO}/v24__resonances_y_20230306_224919.csv",
        runs=f"data/runs/{LABELLED[0]}/runs",
        file=f"data/runs/{LABELLED[0]}/machine.toml",
    )
    return [_run(line) for line in text.splitlines() if line.strip()]


def _run(line: str) -> Run:
    name, _, rest = line.removeprefix("~").partition(": ")
    command, _, files = rest.partition(" -> ")
    return Run(name, tuple(command.split()), tuple(files.split()), quick=not line.startswith("~"))


class Place:
    """Where the commands of one capture run: a fresh folder, with links to what they read."""

    def __init__(self, checkout: Path, python: str, data: Path, samples: Path, examples: Path, work: Path) -> None:
        self.checkout, self.python, self.data, self.work = checkout, python, data, work
        for name, there in (("data", data), ("samples", samples), ("examples", examples)):
            if not there.is_dir():
                raise SystemExit(f"{there}: no such folder; see --{name}.")
            (work / name).symlink_to(there.resolve())
        self.inputs = {name: _digest(there, "*") for name, there in (("samples", samples), ("examples", examples))}
        self.code = self._entry()
        self.environment = self._environment()
        self._check()

    def _entry(self) -> str:
        """The call behind the command `ffcomp`, as the checkout's pyproject.toml names it."""
        project = tomllib.loads((self.checkout / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        module, _, function = project["scripts"]["ffcomp"].partition(":")
        return f"from {module} import {function} as run; run()"

    def _environment(self) -> dict[str, str]:
        sources = [path for path in (self.checkout / "src", self.checkout) if path.is_dir()]
        compiled = Path(tempfile.gettempdir(), f"ffcomp-compiled-{_digest(self.checkout, '*.py')}")
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("FFCOMP_", "SLIC3R_"))}
        return kept | {
            "PYTHONPATH": os.pathsep.join(map(str, sources)),
            "PYTHONDONTWRITEBYTECODE": "1",
            "PYTHONHASHSEED": "0",
            "NUMBA_CACHE_DIR": str(compiled / "numba"),  # numba does not notice a callee of another module that changed
            "MPLCONFIGDIR": str(compiled / "matplotlib"),
            "MPLBACKEND": "Agg",
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "FFCOMP_CACHE": str(self.work / ".kept"),
            "FFCOMP_LOG": "off",
            "HOME": str(self.work),
            "XDG_CONFIG_HOME": str(self.work / ".config"),
            "XDG_DATA_HOME": str(self.work / ".data"),
            "COLUMNS": "120",
            "NO_COLOR": "1",
        }

    def _check(self) -> None:
        """Whether it is this checkout that is imported, and no installed ffcomp."""
        done = self._python("import ffcomp; print(ffcomp.__file__)")
        if done.returncode or not Path(done.stdout.decode().strip()).is_relative_to(self.checkout):
            raise SystemExit(f"{self.checkout}: ffcomp is not imported from here.\n{done.stdout!r}\n{done.stderr!r}")

    def _python(self, code: str, *args: str) -> subprocess.CompletedProcess[bytes]:
        order = [self.python, "-c", code, *args]
        return subprocess.run(
            order, cwd=self.work, env=self.environment, capture_output=True, stdin=subprocess.DEVNULL, check=False
        )

    def ffcomp(self, args: tuple[str, ...]) -> subprocess.CompletedProcess[bytes]:
        """Run one command; file names with * or ? stand for all that fit, sorted."""
        given: list[str] = []
        for arg in args:
            if "/" in arg and any(sign in arg for sign in GLOBS):
                found = sorted(str(path.relative_to(self.work)) for path in self.work.glob(arg))
                given.extend(found or [arg])
            else:
                given.append(arg)
        return self._python(self.code, *given)

    def plain(self, text: str) -> str:
        """Without what depends on the day or the place."""
        checkout = re.escape(str(self.checkout))
        text = re.sub(rf"{checkout}(?:/[\w.-]+)*/", "", text)
        for path in (self.work, self.data, self.data.resolve()):
            text = text.replace(f"{path}/", "")
        text = re.sub(r"sha256:[0-9a-f]{8,64}", "sha256:…", text)
        text = re.sub(r"\b20\d\d-\d\d-\d\d\b", "DAY", text)
        return re.sub(r"ffcomp v\d+\.\d+\.\d+\S*", "ffcomp v…", text)


def _digest(folder: Path, files: str) -> str:
    """One for each state of the files: what is compiled of one state of the code is never used for another."""
    digest = hashlib.sha256(sys.version.encode())
    for path in sorted(folder.rglob(files)):
        inside = path.relative_to(folder)
        if path.is_file() and not any(part.startswith((".", "__pycache__")) for part in inside.parts):
            digest.update(str(inside).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def capture(folder: Path, place: Place, runs: list[Run]) -> None:
    """Run the commands and keep what they say and write."""
    (folder / "files").mkdir(parents=True)
    kept: list[Kept] = []
    begin = time.monotonic()
    for number, run in enumerate(runs):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = place.ffcomp(run.args)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        result = Kept(run.name, list(run.args), done.returncode, round(cpu_s, 1))
        found = {"stdout": done.stdout, "stderr": done.stderr} | _written(place.work, run.writes)
        for name, data in found.items():
            kind, plain = _normal(name, data, place)
            result.files[name] = kind
            (folder / "files" / _slug(run.name, name)).write_bytes(gzip.compress(plain, 6, mtime=0))
        kept.append(result)
        print(f"{number + 1}/{len(runs)} {run.name}: exit code {done.returncode}, {cpu_s:.1f} s of CPU", flush=True)
    cpu_s = round(sum(one.cpu_s for one in kept), 1)
    index = {"cpu_s": cpu_s, "inputs": place.inputs, "runs": [asdict(one) for one in kept]}
    (folder / "index.json").write_text(json.dumps(index, indent=1, ensure_ascii=False), encoding="utf-8")
    print(f"{len(kept)} commands, {cpu_s} s of CPU, {time.monotonic() - begin:.0f} s; {folder}")


def _written(work: Path, writes: tuple[str, ...]) -> dict[str, bytes]:
    """The files that are there of those that were to be written; a folder stands for all in it."""
    found: dict[str, bytes] = {}
    for name in writes:
        there = work / name
        files = sorted(path for path in there.rglob("*") if path.is_file()) if there.is_dir() else [there]
        found |= {str(path.relative_to(work)): path.read_bytes() for path in files if path.is_file()}
    return found


def _slug(run: str, file: str) -> str:
    return re.sub(r"[^\w.-]+", "_", f"{run}--{file}") + ".gz"


def _normal(name: str, data: bytes, place: Place) -> tuple[str, bytes]:
    """The kind of a file, and what of it is to be compared."""
    suffix = Path(name).suffix
    if suffix in (".png", ".svg", ".html"):
        return "picture", b"there" if data else b"empty"
    if suffix == ".npz":
        return "npz", data
    if suffix == ".gz":
        data, suffix = gzip.decompress(data), Path(name).with_suffix("").suffix
    if suffix == ".bgcode":
        return "bytes", data
    if suffix in (".gcode", ".nc"):
        return "gcode", _plain_gcode(data)
    text = place.plain(data.decode("utf-8", "replace"))
    if name == "stderr":
        return "message", re.sub(r"\d+ %, \d+ s left", "… left", text).encode()
    if suffix == ".toml":
        return "json", _dumped(tomllib.loads(text))
    if suffix == ".json" or (name == "stdout" and text.lstrip().startswith("{")):
        return "json", _dumped([json.loads(line) for line in _objects(text)])
    return ("message" if name == "stdout" else "text"), text.encode()


def _plain_gcode(data: bytes) -> bytes:
    """Without the stamp's particulars and our own remarks; what keeps a line of the original stays."""
    data = re.sub(rb"(?m)^; Processed by ffcomp [^\r\n]*", b"; Processed by ffcomp", data)
    return re.sub(rb"(?m)^(?:; ffcomp(?! was | offset_mm=)|;section line=)[^\n]*\n", b"", data)


def _objects(text: str) -> list[str]:
    """One object a line, or one over all lines."""
    try:
        json.loads(text)
    except ValueError:
        return [line for line in text.splitlines() if line.strip()]
    return [text]


def _dumped(value: Any) -> bytes:
    return json.dumps(_timeless(value), ensure_ascii=False, indent=1, default=str).encode()


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _timeless(inner) for key, inner in value.items() if key not in CLOCK}
    return [_timeless(inner) for inner in value] if isinstance(value, list) else value


@dataclass(slots=True)
class Verdict:
    """How two files compare."""

    differs: int = 0  # lines or values
    first: str = ""
    largest: float = 0.0  # difference of numbers, absolute in text, relative in JSON
    reworded: int = 0
    added: int = 0  # new keys

    def blame(self, sentence: str) -> None:
        """Count a difference."""
        self.differs += 1
        self.first = self.first or sentence

    def words(self) -> str:
        """In a table's cell."""
        more = [f"{self.reworded} reworded"] * bool(self.reworded) + [f"{self.added} new keys"] * bool(self.added)
        number = f"largest difference {self.largest:.3g}" if self.largest else ""
        if self.differs:
            return ", ".join(filter(None, [f"DIFFERS in {self.differs}", number, *more])) + f"; first: {self.first}"
        return ", ".join(filter(None, ["same", number, *more]))


def compare_text(before: bytes, after: bytes) -> Verdict:
    """Line by line."""
    verdict = Verdict()
    if before == after:
        return verdict
    a, b = before.decode("utf-8", "replace"), after.decode("utf-8", "replace")
    for number, (old, new) in enumerate(zip_longest(a.split("\n"), b.split("\n")), 1):
        if old == new:
            continue
        verdict.blame(f"line {number}: {_short(old)} | {_short(new)}")
        values = NUMBER.findall(old or ""), NUMBER.findall(new or "")
        if len(values[0]) == len(values[1]):
            apart = (abs(float(x) - float(y)) for x, y in zip(*values, strict=True))
            verdict.largest = max(verdict.largest, *apart, 0.0)
    return verdict


def compare_json(before: Any, after: Any, tolerance: float, verdict: Verdict, where: str = "") -> Verdict:
    """Key by key: none may be missing, and numbers must agree within the relative tolerance."""
    key = where.rpartition(".")[2]
    if isinstance(before, dict) and isinstance(after, dict):
        for name, value in before.items():
            if name not in after:
                verdict.blame(f"{where}.{name} is missing")
            elif not TOOK.fullmatch(f"{where}.{name}"):
                compare_json(value, after[name], tolerance, verdict, f"{where}.{name}")
        verdict.added += len(after.keys() - before.keys())
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            verdict.blame(f"{where} has {len(before)} | {len(after)} entries")
        for number, (old, new) in enumerate(zip(before, after, strict=False)):
            compare_json(old, new, tolerance, verdict, f"{where}[{number}]")
    elif _is_number(before) and _is_number(after):
        both_nan = math.isnan(before) and math.isnan(after)
        apart = 0.0 if before == after or both_nan else abs(before - after) / max(abs(before), abs(after))
        verdict.largest = max(verdict.largest, apart)
        if not apart <= tolerance:
            verdict.blame(f"{where}: {before!r} | {after!r}")
    elif isinstance(before, str) and isinstance(after, str) and before != after and _is_sentence(key, before):
        verdict.reworded += 1
        same = key in WORDS_ONLY or sorted(NUMBER.findall(before)) == sorted(NUMBER.findall(after))
        if not same:
            verdict.blame(f"{where}, its numbers: {_short(before)} | {_short(after)}")
    elif type(before) is not type(after) or before != after:
        verdict.blame(f"{where}: {_short(before)} | {_short(after)}")
    return verdict


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_sentence(key: str, text: str) -> bool:
    return key not in EXACT_TEXT and " " in text


def compare_arrays(before: bytes, after: bytes) -> Verdict:
    """Array for array: names, types, shapes and every value."""
    verdict = Verdict()
    with np.load(io.BytesIO(before)) as old, np.load(io.BytesIO(after)) as new:
        for name in old.files:
            if name not in new.files:
                verdict.blame(f"{name} is missing")
                continue
            a, b = old[name], new[name]
            if a.dtype != b.dtype or a.shape != b.shape:
                verdict.blame(f"{name}: {a.dtype} {a.shape} | {b.dtype} {b.shape}")
            elif not np.array_equal(a, b):
                verdict.blame(f"{name}: {int(np.sum(a != b))} of {a.size} values")
                if a.dtype.kind in "iuf":
                    apart = np.abs(a.astype(float) - b.astype(float))
                    verdict.largest = max(verdict.largest, float(np.max(apart)))
        verdict.added = len(set(new.files) - set(old.files))
    return verdict


def compare_file(kinds: tuple[str, str], verb: str, before: bytes, after: bytes) -> Verdict:
    """Compare by kind."""
    if kinds[0] != kinds[1]:
        verdict = Verdict()
        verdict.blame(f"{kinds[0]} | {kinds[1]}")
        return verdict
    if kinds[0] == "json":
        return compare_json(json.loads(before), json.loads(after), LOOSE.get(verb, TIGHT), Verdict())
    if kinds[0] == "npz":
        return compare_arrays(before, after)
    if kinds[0] == "message":
        return Verdict(reworded=int(SPENT.sub(b"", before) != SPENT.sub(b"", after)))
    if kinds[0] == "bytes":
        verdict = Verdict()
        if before != after:
            verdict.blame(f"{len(before)} | {len(after)} bytes")
        return verdict
    return compare_text(before, after)


def compare(before: Path, after: Path, quiet: bool) -> int:
    """Print the table; how many rows differ."""
    (old_inputs, old), (new_inputs, new) = _index(before), _index(after)
    for name in old_inputs:
        if old_inputs[name] != new_inputs.get(name):
            print(f"Careful: the captures were given different {name} (--{name}).", file=sys.stderr)
    wrong = rows = 0
    print("| command | file | result |\n|---|---|---|")
    for name, a in old.items():
        results: list[tuple[str, Verdict]] = []
        ends = Verdict()
        if (b := new.get(name)) is None:
            ends.blame("was not run")
            results.append(("", ends))
        else:
            if a["args"] != b["args"]:
                ends.blame("other arguments: the captures are of different versions of this script")
            if a["exit_code"] != b["exit_code"]:
                ends.blame(f"{a['exit_code']} | {b['exit_code']}")
            results.append((f"exit code {a['exit_code']}", ends))
            results += [(file, _judge(before, after, a, b, file)) for file in sorted(a["files"].keys() | b["files"])]
        for file, verdict in results:
            rows += 1
            wrong += bool(verdict.differs)
            if not quiet or verdict.differs:
                print(f"| {name} | {file} | {verdict.words()} |")
    for name in new.keys() - old.keys():
        print(f"| {name} | | only in {after} |")
    print(f"\n{rows} compared, {wrong} differ.")
    return wrong


def _index(folder: Path) -> tuple[dict[str, str], dict[str, Any]]:
    """The digests of what was read, and the commands by name."""
    index = json.loads((folder / "index.json").read_text(encoding="utf-8"))
    return index.get("inputs", {}), {run["name"]: run for run in index["runs"]}


def _judge(before: Path, after: Path, a: dict[str, Any], b: dict[str, Any], file: str) -> Verdict:
    missing = [str(folder) for folder, run in ((before, a), (after, b)) if file not in run["files"]]
    if missing:
        verdict = Verdict()
        verdict.blame(f"not written in {missing[0]}")
        return verdict
    data = [gzip.decompress((folder / "files" / _slug(a["name"], file)).read_bytes()) for folder in (before, after)]
    return compare_file((a["files"][file], b["files"][file]), a["args"][0], data[0], data[1])


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 100 else text[:97] + "..."


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("capture", help="run every command with one checkout and keep the results")
    one.add_argument("checkout", type=Path)
    one.add_argument("-o", "--output", type=Path, required=True, help="a new folder")
    one.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data", help="data of others")
    one.add_argument("--samples", type=Path, default=ROOT / "sample_prints", help="the project's own prints")
    one.add_argument("--examples", type=Path, default=ROOT / "docs" / "examples", help="small files of the docs")
    one.add_argument("--python", default=sys.executable, help="with ffcomp's dependencies")
    one.add_argument("--quick", action="store_true", help="a few minutes' worth")
    one.add_argument("--only", default="", help="only commands whose name holds this text, for a closer look")
    one.add_argument("--force", action="store_true", help="overwrite the folder")
    two = verbs.add_parser("compare", help="compare two captures; exit code 1 if anything differs")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    two.add_argument("-q", "--quiet", action="store_true", help="print only what differs")
    asked = parser.parse_args()
    if asked.verb == "compare":
        raise SystemExit(1 if compare(asked.before, asked.after, asked.quiet) else 0)
    if asked.output.exists():
        if not asked.force:
            raise SystemExit(f"{asked.output} exists already; --force overwrites it.")
        shutil.rmtree(asked.output)
    runs = [run for run in all_runs() if (run.quick or not asked.quick) and asked.only in run.name]
    with tempfile.TemporaryDirectory(prefix="same-outputs-") as work:
        data, samples, examples = (path.absolute() for path in (asked.data, asked.samples, asked.examples))
        place = Place(asked.checkout.resolve(), asked.python, data, samples, examples, Path(work))
        capture(asked.output, place, runs)


if __name__ == "__main__":
    main()
