"""How long a diagnosis takes: CPU seconds, peak memory, simulated time and verdict, set by set.

    python -m benchmarks.diagnose_speed [--keep DIR] [--data DIR] [--only TEXT] [--candidates NAME ...] [--json]

Three kinds of sets, each with something hidden in a printer that is not ours (`validation/blind`), except the first:

    labelled   the labelled sets of the outside data (--data, or FFCOMP_DATA): ten runs of 4 s at 1.6 kHz
    six        ten runs of 6 s at 3.2 kHz, six channels: dry friction, added mass, nothing
    joined     six captures of `record plan` as Klipper writes them, one chip at the nozzle: dry friction, added mass

Every set is diagnosed in a process of its own, after one that compiles the kernels. CPU is user and system time of that
process. A simulated second is one second of one recording on one printer; a thousand integration steps of a lane are
counted as one kilostep, whatever a step holds.

Measured on a machine with much other work, before and after effects were searched in excerpts (22 November 2026; the
labelled set before: an older checkout of the same day, user time of the whole command):

    set                         CPU s before   after   verdict and value before -> after
    labelled/coulomb-friction            178      64   force 3.2882 N (3.2726 to 3.3039) -> the same (665 MB)
    joined/mass                          188      63   unknown, nearest 0.1098 kg -> the same (peak 888 -> 596 MB)
    six/friction             > 380, not ended    123   -> forces within 1 % of what was hidden (876 MB)

The last of these was measured with coarser steps in the excerpt than now; the other sets were not measured.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.interpolate import CubicSpline

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data"))
MACHINE = ROOT / "models" / "library" / "mp-delta-pro.toml"
RATE_HZ, SECONDS, FILE_ERROR = 3200.0, 6.0, 0.02
EFFECTS = {"friction": "coulomb_friction", "mass": "effector_mass", "nothing": ""}
MEASURED = (  # kind, place, loudness, times
    ("multisine", (0.0, 0.0, 30.0), 1.0, 2),
    ("multisine", (70.0, 40.0, 30.0), 1.4, 2),
    ("slow", (-60.0, 60.0, 60.0), 1.0, 2),
    ("infill", (0.0, -80.0, 20.0), 1.0, 2),
    ("steps", (-60.0, -40.0, 40.0), 1.0, 1),
    ("turns", (50.0, -30.0, 40.0), 1.0, 1),
)
JOINED_PLACES = ((0.0, 0.0), (60.0, 20.0))
JOINED = ("zigzag-0", "reversals-1", "multisine-1")
SETS = (
    *(f"labelled/{name}" for name in ("coulomb-friction", "effector-mass", "nothing-hidden")),
    *(f"six/{name}" for name in EFFECTS),
    "joined/friction",
    "joined/mass",
)


def main() -> None:
    """Make the sets that are missing, and diagnose each."""
    options = _options()
    if options.one:
        print(json.dumps(diagnosed(Path(options.one), options.candidates)))
        return
    with tempfile.TemporaryDirectory() as folder:
        keep = Path(options.keep or folder)
        chosen = [name for name in SETS if options.only in name]
        rows = {}
        for name in chosen:
            made = set_of(name, keep, Path(options.data))
            if made is None:
                print(f"{name}: the outside data are not there; give --data", file=sys.stderr)
                continue
            rows[name] = _asked(made, options.candidates)
            print(json.dumps({name: rows[name]}) if options.json else _row(name, rows[name]), flush=True)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", metavar="DIR", help="where the sets are kept: none is made twice")
    parser.add_argument("--data", metavar="DIR", default=str(DATA), help="outside data, with runs/")
    parser.add_argument("--only", metavar="TEXT", default="", help="sets whose name contains it")
    parser.add_argument("--candidates", metavar="NAME", nargs="*", default=[], help="these effects only")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--one", metavar="DIR", help=argparse.SUPPRESS)
    return parser.parse_args()


def _row(name: str, found: dict[str, Any]) -> str:
    return (
        f"{name:28s} {found['cpu_s']:8.1f} s CPU {found['wall_s']:7.1f} s {found['peak_mb']:6.0f} MB "
        f"{found['simulated_s']:8.0f} s, {found['kilosteps']:9.0f} kilosteps simulated: {found['verdict']} "
        f"{found['effects']}"
    )


# ---- diagnose ------------------------------------------------------------------------------------


def _asked(folder: Path, candidates: Sequence[str]) -> dict[str, Any]:
    """Diagnose a set in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.diagnose_speed", "--one", str(folder)]
    found = subprocess.run(
        [*command, *(["--candidates", *candidates] if candidates else [])],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    return dict(json.loads(found.stdout.splitlines()[-1]))


def diagnosed(folder: Path, candidates: Sequence[str] = ()) -> dict[str, Any]:
    """Diagnose the set in a folder, and tell what it cost."""
    from ffcomp.diagnosis import printer_problem
    from ffcomp.diagnosis.diagnosis import diagnose
    from ffcomp.diagnosis.result import result_of
    from ffcomp.record.join import load_recordings
    from models.effects.catalogue import CATALOGUE
    from models.file import load_machine
    from models.printer.printer import simulate_printer

    machine, plan = load_machine(folder / "machine.toml"), folder / "moves.json"
    rest = machine.kinematics.inverse(np.array([[0.0, 0.0, 20.0]] * 8))
    simulate_printer(machine, rest, 1 / 1600)  # compiles
    runs = sorted((folder / "runs").glob("*.csv"))
    counted = {"simulated_s": 0.0, "kilosteps": 0.0}
    simulate = printer_problem.simulate_printers

    def counting(machines: Any, commands: Any, dt_s: float, **more: Any) -> Any:
        seconds = sum(len(c) for c in commands) * dt_s
        counted["simulated_s"] += seconds
        counted["kilosteps"] += seconds / dt_s * (more.get("substeps") or 1) / 1e3
        return simulate(machines, commands, dt_s, **more)

    printer_problem.simulate_printers = counting
    began, cpu = time.perf_counter(), _cpu_s()
    recordings = load_recordings(runs, machine, plan if plan.exists() else None)
    problem = printer_problem.PrinterProblem(machine, recordings, tuple(candidates) or tuple(CATALOGUE))
    found = diagnose(problem, lambda said: print(f"{_cpu_s() - cpu:7.1f}", said, file=sys.stderr))
    result = result_of(problem, found)
    return {
        "cpu_s": round(_cpu_s() - cpu, 2),
        "wall_s": round(time.perf_counter() - began, 2),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        **{key: round(value, 1) for key, value in counted.items()},
        "verdict": found.verdict,
        "effects": {name: result.parameters(name) for name in result.effects},
        "rejections": list(found.rejections),
    }


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


# ---- sets ----------------------------------------------------------------------------------------


def set_of(name: str, keep: Path, data: Path) -> Path | None:
    """Return the folder of a set (machine.toml, runs/, with captures moves.json), made if it is not there."""
    kind, _, hidden = name.partition("/")
    if kind == "labelled":
        folder = data / "runs" / hidden
        return folder if folder.is_dir() else None
    folder = keep / f"{kind}-{hidden}"
    if not (folder / "made").exists():
        (folder / "runs").mkdir(parents=True, exist_ok=True)
        MAKERS[kind](folder, EFFECTS[hidden])
        (folder / "made").touch()
    return folder


def _real(folder: Path, effect: str) -> Any:
    """Return the printer with its hidden effect; its owner's file, a little off, is written."""
    from models.file import load_machine
    from tests.support.hidden_delta import owners_file
    from validation.blind.delta import EFFECTS as HIDE
    from validation.blind.real import Real

    (folder / "machine.toml").write_text(owners_file(load_machine(MACHINE)), encoding="utf-8")
    plain = Real(tomllib.loads(MACHINE.read_text(encoding="utf-8")))
    if not effect:
        return plain
    table, real = HIDE[effect](np.random.default_rng(5), 1.0, plain)
    (folder / "truth.json").write_text(json.dumps({effect: table}), encoding="utf-8")
    return real


def _six(folder: Path, effect: str) -> None:
    from validation.blind.delta import played
    from validation.blind.motions import KINDS, Motion
    from validation.blind.sensors import columns_of, commands_of, csv_of, draw_sensors
    from validation.plants.delta_plant import carriages_of

    real = _real(folder, effect)
    sensors = draw_sensors(np.random.default_rng(11), "all", RATE_HZ)
    for k, (kind, place, loudness, times) in enumerate(MEASURED):
        rng = np.random.default_rng([1, k])
        motion = Motion(kind, _rising(KINDS[kind](rng, place, SECONDS, loudness), place), SECONDS)
        reading = played(real, real.machine["kinematics"], motion)
        t = reading.t[:: round(1 / (RATE_HZ * reading.t[1]))]
        command = carriages_of(real.machine["kinematics"], motion.path(t))
        for n in range(times):
            text = csv_of(t, commands_of(command, "ABC"), columns_of(sensors.record(reading, rng)))
            (folder / "runs" / f"{kind}-{k}-{n + 1}.csv").write_text(text, encoding="utf-8")


def _rising(path: Callable[[Any], Any], place: Sequence[float]) -> Callable[[Any], Any]:
    """Tilt a path: a sensor that hardly moves along its axis is refused."""
    return lambda t: path(t) + np.outer(path(t)[:, 0] - place[0], [0.0, 0.0, 0.3])


def _joined(folder: Path, effect: str) -> None:
    from ffcomp.record.moves import Request, make_plan
    from ffcomp.record.plan import save_plan
    from models.file import load_machine
    from validation.blind.delta import played
    from validation.blind.motions import Motion
    from validation.plants.accelerometer import draw_chip, klipper_capture

    real = _real(folder, effect)
    plan = make_plan(load_machine(folder / "machine.toml"), Request(seconds=4.0, places_mm=JOINED_PLACES))
    save_plan(plan, folder / "moves.json")
    rng = np.random.default_rng(3)
    chip = draw_chip(rng, np.eye(3))
    wanted = [each for each in plan.experiments if each.name.removeprefix("ffcomp-") in JOINED]
    for each in wanted:
        before, after = plan.rest_before_s + 0.3, plan.rest_after_s + 0.3
        nozzle: Callable[[Any], Any] = each.motion.nozzle
        seconds = before + each.duration_s + after
        motion = Motion(each.name, lambda t, n=nozzle, b=before: n(t - b), seconds)  # type: ignore[misc]
        reading = played(real, real.machine["kinematics"], motion)
        felt = CubicSpline(reading.t - before, reading.nozzle)
        for repeat in (1, 2):
            end = each.duration_s + plan.rest_after_s
            text = klipper_capture(felt, chip, -plan.rest_before_s, end, 55.0, rng)
            (folder / "runs" / f"adxl345-{each.name}-{repeat}.csv").write_text(text, encoding="utf-8")


MAKERS: dict[str, Callable[[Path, str], None]] = {"six": _six, "joined": _joined}

if __name__ == "__main__":
    main()
