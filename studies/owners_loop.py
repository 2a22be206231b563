"""The owner's loop: plan, record, join, diagnose, print better; with a real firmware's plan and an independent printer.

    python -m studies.owners_loop --keep DIR --write      studies/reports/owners_loop.md, some minutes a printer

`ffcomp record plan` writes the file, the real Kalico host plans it (KALICO_PYTHON names its interpreter), the printer
of `validation/blind` with a hidden effect makes that motion, and an accelerometer like an ADXL345 records it: 3.2 kHz
± 1 %, 3.9 mg a count, noise 0.15 m/s², gravity, a tilt of 2°, turned axes, and rows that are lost. Everything after
that is the command line: join, diagnose, compensate. What is there in DIR is not made again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ffcomp.record.plan import Experiment, Plan, load_plan
from models.file import load_machine, updated_text
from studies.diagnosis import ffcomp
from studies.diagnosis_proof import Printer, hidden, kept, owners_file, printed
from studies.render import save
from validation import judge
from validation.blind.delta.real import played
from validation.blind.printer.motions import Motion
from validation.blind.printer.real import Real
from validation.kalico import kalico_plan, sample
from validation.plants.accelerometer import draw_chip, klipper_capture, reprapfirmware_capture

FloatArray = NDArray[np.float64]
Nozzle = Callable[[FloatArray], FloatArray]

AXES = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # from the printer's to the chip's
MOTION_ONLY = (b"G0", b"G1", b"G4", b"G90", b"G21", b"SET_VELOCITY_LIMIT")
BEFORE_S, AFTER_S = 1.2, 0.7  # of the motion that is simulated around an experiment
SAME_MM = 0.01  # by which the host's motion may differ from the plan's
LOST = 1 / 2000  # of a Klipper capture's rows

# What is hidden, and the seed of its size and shape; by whom the captures are made.
HIDDEN = {
    "effector_mass": (5, "klipper"),
    "coulomb_friction": (4, "klipper"),
    "guide_damping": (4, "reprapfirmware"),
    "belt_stiffness": (1, "reprapfirmware"),
    "nothing": (0, "klipper"),
}


def main() -> None:
    """Go through the loop for every hidden effect, and write the results and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", required=True, metavar="DIR", help="where captures, verdicts and files are kept")
    parser.add_argument("--only", nargs="*", choices=list(HIDDEN), default=list(HIDDEN), help="these effects")
    parser.add_argument("--write", action="store_true", help="write the results and the page")
    options = parser.parse_args()
    found = [loop(Path(options.keep) / name, name) for name in options.only]
    if options.write:
        save("owners_loop", {"machine_file": judge.MACHINE_FILE.name, "lost_rows": LOST, "printers": found})
    else:
        print(json.dumps(found, indent=1))


def loop(folder: Path, name: str) -> dict[str, Any]:
    """Record, diagnose and print on one printer."""
    seed, kind = HIDDEN[name]
    folder.mkdir(parents=True, exist_ok=True)
    plain = Real(tomllib.loads(judge.MACHINE_FILE.read_text(encoding="utf-8"))) if name == "nothing" else None
    table, real = ({}, plain) if plain is not None else hidden(name, seed)
    files = {each: folder / f"{each}.toml" for each in ("owner", "better", "perfect")}
    files["owner"].write_text(owners_file(load_machine(judge.MACHINE_FILE)), encoding="utf-8")
    true = {f"effects.{name}.{key}": value for key, value in table.items()}
    files["perfect"].write_text(updated_text(judge.MACHINE_FILE, true, name="perfect"), encoding="utf-8")
    captures, begun = recorded(folder, files["owner"], real, kind)
    told = ("--plan", folder / "moves.json", "--machine", files["owner"], "--json")
    joined = kept(folder / "joined.json", "record", "join", *captures, "-o", folder / "runs", *told)
    verdict = kept(folder / "verdict.json", "diagnose", *captures, "-o", files["better"], *told, "--quiet", "--force")
    if not files["better"].exists():
        files.pop("better")
    return {
        "hidden": name,
        "table": table,
        "by": kind,
        "captures": len(captures),
        "worst_offset_ms": 1e3 * worst_offset(joined, begun),
        "refused": joined["refused"],
        "verdict": verdict["verdict"],
        "effects": [{key: e[key] for key in ("name", "parameters")} for e in verdict.get("effects", [])],
        "gap": verdict.get("gap"),
        "seconds": verdict.get("seconds"),
        "contour_um": printed(folder, Printer(real, load_machine(files["perfect"])), files),
    }


# ---- the recording -----------------------------------------------------------------------------


def recorded(folder: Path, owner: Path, real: Real, kind: str) -> tuple[list[Path], dict[str, float]]:
    """Return the captures, and when each one's first row was taken, s after its experiment's begin."""
    plan, notes = folder / "moves.gcode", folder / "captures.json"
    if not notes.exists():
        planned(plan, owner, kind)
        planned(folder / "host.gcode", owner, "klipper")  # what the host reads; the moves are the same
        moves = load_plan(plan.with_suffix(".json"))
        found = as_captures(folder / "captures", moves, firmware_plan(folder / "host.gcode", moves), real, kind)
        notes.write_text(json.dumps(found, indent=1), encoding="utf-8")
        print(notes, file=sys.stderr, flush=True)
    begun = dict(json.loads(notes.read_text(encoding="utf-8")))
    return [folder / "captures" / name for name in begun], begun


def planned(path: Path, owner: Path, flavor: str) -> None:
    """Write the recording's G-code for a firmware, if it is not there."""
    if not path.exists():
        answer = ffcomp("record", "plan", "-m", owner, "-o", path, "--flavor", flavor, "--json")
        if "why" in answer:
            raise SystemExit(answer["why"])


def firmware_plan(plan: Path, moves: Plan) -> list[Nozzle]:
    """Return each execution's motion as the real host plans the file, from its begin."""
    lines = [line for line in plan.read_bytes().splitlines(keepends=True) if line.startswith(MOTION_ONLY)]
    found = kalico_plan(
        b"".join(lines),
        max_velocity=1000,
        max_accel=100_000,
        max_z_velocity=1000,
        delta_radius=140.0,
        arm_length=300.0,
    )["moves"]
    ends = found[:, 0] + found[:, 1:4].sum(axis=1)
    rests = (np.flatnonzero(found[1:, 0] - ends[:-1] > 0.9 * moves.rest_before_s) + 1).tolist()
    motions = []
    for each, repeat in moves.runs():
        while rests and not _is(each, found, float(found[rests[0], 0])):
            rests.pop(0)
        if not rests:
            raise SystemExit(f"The host does not make {each.name}, repeat {repeat}.")
        motions.append(_from(found, float(found[rests.pop(0), 0])))
    return motions


def _is(experiment: Experiment, found: FloatArray, begin_s: float) -> bool:
    """Tell whether the host makes this experiment from this time on."""
    t = np.linspace(0.0, experiment.duration_s, 50)
    return bool(np.max(np.abs(sample(found, begin_s + t) - experiment.motion.nozzle(t))) < SAME_MM)


def _from(found: FloatArray, begin_s: float) -> Nozzle:
    return lambda t: sample(found, begin_s + t)


def as_captures(folder: Path, moves: Plan, motions: Sequence[Nozzle], real: Real, kind: str) -> dict[str, float]:
    """Make every execution on the printer and record it; say when each capture's first row was taken."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng([7, len(motions)])
    chip, begun, clock_s = draw_chip(rng, AXES), dict[str, float](), 30.0
    for (each, repeat), nozzle in zip(moves.runs(), motions, strict=True):
        felt = felt_by_nozzle(real, nozzle, each.duration_s)
        name = f"adxl345-{each.name}-{repeat}.csv"
        begin_s, end_s = -moves.rest_before_s, each.duration_s + moves.rest_after_s
        if kind == "klipper":
            text = with_lost_rows(klipper_capture(felt, chip, begin_s, end_s, clock_s, rng), rng)
            first_s = float(text.split("\n", 2)[1].split(",")[0]) - clock_s + begin_s
        else:
            text, first_s = reprapfirmware_capture(felt, chip, begin_s, end_s, rng)
        (folder / name).write_text(text, encoding="utf-8")
        begun[name] = first_s
        clock_s += end_s - begin_s + 2.0
    return begun


def felt_by_nozzle(real: Real, nozzle: Nozzle, duration_s: float) -> CubicSpline:
    """Return what the nozzle holder feels, m/s², over s from the experiment's begin."""

    def path(t: FloatArray) -> FloatArray:
        return nozzle(np.clip(t - BEFORE_S, -0.9, duration_s + 0.4))

    reading = played(real, real.machine["kinematics"], Motion("recorded", path, BEFORE_S + duration_s + AFTER_S))
    return CubicSpline(reading.t - BEFORE_S, reading.nozzle)


def with_lost_rows(text: str, rng: np.random.Generator) -> str:
    """Leave out some rows, as a busy host does."""
    head, *rows = text.splitlines(keepends=True)
    stay = rng.uniform(size=len(rows)) > LOST
    stay[0] = True
    return head + "".join(row for row, kept_row in zip(rows, stay, strict=True) if kept_row)


def worst_offset(joined: Mapping[str, Any], begun: Mapping[str, float]) -> float:
    """Return the largest error of a joined capture's offset, s."""
    return max(
        abs(run["offset_s"] - begun[f"adxl345-{run['experiment']}-{run['repeat']}.csv"]) for run in joined["runs"]
    )


if __name__ == "__main__":
    main()
