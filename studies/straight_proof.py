"""A hidden effect on a CoreXY and on a bed slinger: from captures to a better print.

    python -m studies.straight_proof --keep DIR --write    reports/straight_proof.md, a minute or two a printer

`ffcomp record plan` writes the moves, the independent printer of `validation/plants/straight_plant.py` makes them with
something hidden, and ADXL345s record it: one on the CoreXY's toolhead; on the bed slinger one on the toolhead, which
does not move along y, and one on the bed, which feels y the other way round. Everything after that is the command
line: join, diagnose, compensate. What is there in DIR is not made again.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, inversion, none
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.inverse.settings import settings_for
from ffcomp.record.plan import Experiment, Plan, load_plan
from models.file import load_machine
from studies.diagnosis import ffcomp
from studies.owners_loop import with_lost_rows
from studies.render import save
from validation.plants.accelerometer import Chip, draw_chip, klipper_capture
from validation.plants.straight_plant import Plant, simulate

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
PRINT, LAYERS, PRINTED_S = ROOT / "sample_prints" / "ringing_tower.gcode", Sampling(4, 7), 10.0
ASIDE_MM, HIGH_MM = 50.0, 100.0  # by which the print is moved along x and up
FILE_ERROR = 0.02  # standard deviation of every number of the owner's file, and what it says of itself
PLANT_HZ, BEFORE_S, AFTER_S = 6400.0, 1.2, 0.7
PLACES = ("0,0", "-70,-60", "60,50")
FIVE = (*PLACES, "70,-50", "-35,40")  # for what depends on x: with one of three left out, two x tell no curve
LOW_MM, FULL_MM = 5.0, 120.0  # heights of recordings of a growing bed
TURNED = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # from the printer's axes to the chip's


@dataclass(frozen=True)
class Hidden:
    """An effect as the plant has it, and as a machine file has to say it."""

    plant: Mapping[str, Any]
    table: Mapping[str, Any]
    effect: str = ""  # if it is not the row's own name
    heights_mm: tuple[float, ...] = (30.0,)
    places: tuple[str, ...] = PLACES


@dataclass(frozen=True)
class Kind:
    """A printer, and what is hidden in it."""

    name: str
    plant: Plant
    weighed: bool  # whether its file states masses
    hidden: Mapping[str, Hidden]

    @property
    def bed_moves(self) -> bool:
        return self.name == "cartesian"


CROSSED = replace(
    Plant(middle_m=0.0), motors=((1.0, 1.0), (1.0, -1.0)), belt_n_per_m=(2.2e4, 2.2e4), carriage_kg=(0.35, 0.55)
)
SLINGER = replace(Plant(middle_m=0.0), carriage_kg=(0.35, 0.9))
RACKING = {"yaw_kg_m2": 0.0085, "yaw_hz": 43.0, "yaw_damping_ratio": 0.05, "head_kg": 0.35, "yaw_arm_m": 0.012}
KINDS = {
    "corexy": Kind(
        "corexy",
        CROSSED,
        False,
        {
            "belt_stiffness": Hidden({"belt_n_per_m": (2.64e4, 2.2e4)}, {"relative_change": [0.2, 0.0, 0.0]}),
            "gantry_racking": Hidden(
                RACKING,
                {
                    "radius_mm": float(1e3 * np.sqrt(0.0085 / 0.35)),
                    "frequency_hz": 43.0,
                    "damping_ratio": 0.05,
                    "x_centre_mm": 0.0,
                    "tool_share": 0.35 / 0.55,
                    "arm_mm": 12.0,
                },
            ),
            "toolhead_mode": Hidden(
                {"beam_slack": 0.3},
                {"slope_per_m": 0.0, "curve_per_m2": [0.0, 33.0, 0.0], "x_centre_mm": 0.0},
                places=FIVE,
            ),
            "coulomb_friction": Hidden(
                {"friction_n": (0.7, 1.1), "bristle_n_per_m": 8e4},
                {"force_n_per_kg": [2.0, 2.0, 0.0], "presliding_mm": [0.7 / 80, 1.1 / 80, 0.0]},
            ),
            "belt_backlash": Hidden({"play_m": (6e-5, 0.0)}, {"width_mm": [0.06, 0.0, 0.0]}),
            "command_delay": Hidden({"delay_s": 1.7e-3}, {"delay_s": [1.7e-3, 1.7e-3, 0.0]}),
            "guide_damping": Hidden(
                {"guide_n_s_per_m": (32.0, 40.0)}, {"added_n_s_per_m_per_kg": [14 / 0.35, 22 / 0.55, 0.0]}
            ),
            "cogging": Hidden({"ripple_m": (8e-6, 8e-6)}, {"amplitude_mm": 8e-3, "pitch_mm": 0.8}),
            "nothing": Hidden({}, {}),
        },
    ),
    "cartesian": Kind(
        "cartesian",
        SLINGER,
        True,
        {
            "growing_bed": Hidden({"growth_per_m": 2.5}, {"growth_per_m": [0, 2.5, 0]}, heights_mm=(LOW_MM, FULL_MM)),
            "coulomb_friction": Hidden(
                {"friction_n": (0.7, 3.0), "bristle_n_per_m": 8e4},
                {"force_n": [0.7, 3.0, 0.0], "presliding_mm": [0.7 / 80, 3.0 / 80, 0.0]},
            ),
            "belt_stiffness": Hidden({"belt_n_per_m": (4e4, 2.5e4)}, {"relative_change": [0.0, -0.21875, 0.0]}),
            "belt_backlash": Hidden({"play_m": (0.0, 8e-5)}, {"width_mm": [0.0, 0.08, 0.0]}),
            "guide_damping": Hidden({"guide_n_s_per_m": (18.0, 45.0)}, {"added_n_s_per_m": [0.0, 27.0, 0.0]}),
            "command_delay": Hidden({"delay_s": 1.7e-3}, {"delay_s": [1.7e-3, 1.7e-3, 0.0]}),
            "nothing": Hidden({}, {}),
        },
    ),
}


def main() -> None:
    """Go through the loop for every hidden effect, and write the results and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", required=True, metavar="DIR", help="where captures, verdicts and files are kept")
    parser.add_argument("--only", nargs="*", metavar="KIND/EFFECT", help="these printers")
    parser.add_argument("--write", action="store_true", help="write the results and the page")
    options = parser.parse_args()
    chosen = options.only or [f"{kind}/{name}" for kind in KINDS for name in KINDS[kind].hidden]
    found = [proof(Path(options.keep) / each, *each.split("/")) for each in chosen]
    if options.write:
        rows = earlier_rows() | {f"{each['kind']}/{each['hidden']}": each for each in found}
        every = [f"{kind}/{name}" for kind in KINDS for name in KINDS[kind].hidden]
        left = [each for each in every if each not in rows]
        about = {"lost_rows": 1 / 2000, "printed_s": PRINTED_S, "not_measured": left}
        save("straight_proof", about | {"printers": [rows[each] for each in every if each in rows]})
    else:
        print(json.dumps(found, indent=1))


def earlier_rows() -> dict[str, dict[str, Any]]:
    """Return the rows of the page as it is: what is measured now takes their places."""
    before = json.loads((ROOT / "studies" / "results" / "straight_proof.json").read_text(encoding="utf-8"))
    return {f"{each['kind']}/{each['hidden']}": each for each in before["printers"]}


def proof(folder: Path, kind_name: str, name: str) -> dict[str, Any]:
    """Record, diagnose and print on one printer."""
    kind = KINDS[kind_name]
    hidden = kind.hidden[name]
    plant = replace(kind.plant, **hidden.plant)
    folder.mkdir(parents=True, exist_ok=True)
    files = {each: folder / f"{each}.toml" for each in ("owner", "better", "perfect")}
    known = replace(kind, plant=replace(kind.plant, beam_slack=plant.beam_slack))
    files["owner"].write_text(machine_text(known, off=np.random.default_rng(len(name))), encoding="utf-8")
    files["perfect"].write_text(machine_text(known, name, hidden.table), encoding="utf-8")
    given = [recorded(folder, files["owner"], plant, kind, hidden, height) for height in hidden.heights_mm]
    runs = [run for each in given for run in each]
    verdict = diagnosed(folder, runs, files)
    if not files["better"].exists():
        files.pop("better")
    return {
        "kind": kind_name,
        "hidden": name,
        "table": dict(hidden.table),
        "runs": len(runs),
        "not_joined": sum(len(json.loads(each.read_text())) for each in folder.glob("not-joined-*.json")),
        "verdict": verdict["verdict"],
        "why": verdict.get("why", ""),
        "effects": [{key: e[key] for key in ("name", "parameters")} for e in verdict.get("effects", [])],
        "said": (verdict.get("said") or [""])[0],
        "refused": verdict.get("refused"),
        "gap": verdict.get("gap"),
        "cpu_s": verdict.get("cpu_s"),
        "contour_um": printed(folder, plant, files),
    }


def diagnosed(folder: Path, runs: list[Path], files: Mapping[str, Path]) -> dict[str, Any]:
    """Return the verdict, kept, with the CPU time that it took."""
    path = folder / "verdict.json"
    if not path.exists():
        before = children_cpu_s()
        told: list[str | Path] = ["--machine", files["owner"], "-o", files["better"], "--json", "--quiet", "--force"]
        answer = ffcomp("diagnose", *runs, *told)
        path.write_text(json.dumps(answer | {"cpu_s": children_cpu_s() - before}, indent=1), encoding="utf-8")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def children_cpu_s() -> float:
    """Return the CPU time of the programs that were run and ended."""
    times = os.times()
    return times.children_user + times.children_system


def machine_text(
    kind: Kind, name: str = "", table: Mapping[str, Any] | None = None, off: np.random.Generator | None = None
) -> str:
    """Return the printer's machine file, with an effect, or with every number off by a draw."""
    lines = ['format = "ffcomp-machine/1"', f'name = "{kind.name}"', "[kinematics]", f'type = "{kind.name}"']
    lines += ["x_range_mm = [-100.0, 100.0]", "y_range_mm = [-100.0, 100.0]", "z_range_mm = [0.0, 250.0]"]
    for axis in range(2):
        frequency, damping = _in_the_middle(kind.plant, axis)
        errors = np.zeros(2) if off is None else FILE_ERROR * off.standard_normal(2)
        lines += [f"[axes.{'xy'[axis]}]", f"frequency_hz = [{frequency * (1 + errors[0]):.6g}]"]
        lines += [f"damping_ratio = [{damping * (1 + errors[1]):.6g}]"]
        lines += [f"mass_kg = {kind.plant.carriage_kg[axis]}"] if kind.weighed else []
    lines += ["[limits]", "velocity_mm_per_s = 300.0", "acceleration_mm_per_s2 = 5000.0"]
    lines += ["[steps]", "steps_per_mm = 80.0", "full_steps_per_mm = 5.0"]
    lines += ["[uncertainty]", f"default = {FILE_ERROR}"]
    if table:
        lines += [f"[effects.{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _in_the_middle(plant: Plant, axis: int) -> tuple[float, float]:
    """Return frequency and damping ratio of an axis where they are measured: the beam in series with y gives way."""
    (frequency,), (damping,), _ = plant.axis_modes(axis)
    softer = float(np.sqrt(1 + plant.beam_slack)) if axis == 1 else 1.0
    return frequency / softer, damping * softer


# ---- the recording -----------------------------------------------------------------------------


def recorded(folder: Path, owner: Path, plant: Plant, kind: Kind, hidden: Hidden, height_mm: float) -> list[Path]:
    """Return the runs that join makes of the captures at one height of the print."""
    plan, runs = folder / f"moves-{height_mm:.0f}.gcode", folder / f"runs-{height_mm:.0f}"
    if not runs.exists():
        places = [word for place in hidden.places for word in ("--at", place)]
        chips = ["--chip", "adxl345", "--chip", "bed"] if kind.bed_moves else []
        told = ("--height-mm", str(height_mm), "--flavor", "klipper", "--seconds", "2", "--json")
        answer = ffcomp("record", "plan", "-m", owner, "-o", plan, *places, *chips, *told)
        moves = load_plan(plan.with_suffix(".json"))
        captures = as_captures(folder / f"captures-{height_mm:.0f}", moves, plant, kind, height_mm)
        given = ("--plan", plan.with_suffix(".json"), "-m", owner)
        answer = ffcomp("record", "join", *captures, "-o", runs, *given, "--json")
        if "why" in answer:
            raise SystemExit(str(answer))
        if refused := answer.get("refused"):  # an owner goes on with what was joined
            (folder / f"not-joined-{height_mm:.0f}.json").write_text(json.dumps(refused, indent=1), encoding="utf-8")
        for run in sorted(runs.glob("*.csv")):  # what is recorded at another height is no repeat
            run.rename(run.with_name(f"z{height_mm:.0f}-{run.name}"))
    return sorted(runs.glob("*.csv"))


def as_captures(folder: Path, moves: Plan, plant: Plant, kind: Kind, height_mm: float) -> list[Path]:
    """Make every execution on the printer and record it with each of its chips."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng([7, len(kind.hidden)])
    chips = {"adxl345": draw_chip(rng, TURNED)} | ({"adxl345-bed": draw_chip(rng, np.eye(3))} if kind.bed_moves else {})
    felt = {each.name: made(plant, each, height_mm) for each in moves.experiments}
    found, clock_s = [], 30.0
    for each, repeat in moves.runs():
        begin_s, end_s = -moves.rest_before_s, each.duration_s + moves.rest_after_s
        for chip, own in chips.items():
            path = folder / f"{chip}-{each.name}-{repeat}.csv"
            t, moved = felt[each.name]
            spline = CubicSpline(t, _felt_by(chip, kind, moved))
            path.write_text(_capture(spline, own, begin_s, end_s, clock_s, rng), encoding="utf-8")
            found.append(path)
        clock_s += end_s - begin_s + 2.0
    return found


def made(plant: Plant, each: Experiment, height_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return an experiment's times (n,) s and accelerations (n, 2) m/s² along x and y."""
    t = np.arange(-BEFORE_S, each.duration_s + AFTER_S, 1 / PLANT_HZ)
    command = each.motion.nozzle(np.clip(t, -0.9, each.duration_s + 0.4))[:, :2]
    return t, simulate(plant, command, PLANT_HZ, height_mm)["acceleration_m_per_s2"]


def _felt_by(chip: str, kind: Kind, felt: FloatArray) -> FloatArray:
    """Return what a chip feels, (n, 3) m/s²: the bed runs the other way round."""
    rows = np.column_stack([felt, np.zeros(len(felt))])
    if not kind.bed_moves:
        return rows
    return rows * np.array([0.0, -1.0, 0.0] if chip.endswith("bed") else [1.0, 0.0, 0.0])


def _capture(
    felt: CubicSpline, chip: Chip, begin_s: float, end_s: float, clock_s: float, rng: np.random.Generator
) -> str:
    return with_lost_rows(klipper_capture(felt, chip, begin_s, end_s, clock_s, rng), rng)


# ---- the print ---------------------------------------------------------------------------------


def printed(folder: Path, plant: Plant, files: Mapping[str, Path]) -> dict[str, float]:
    """Contour rms, µm, on the printer that hides the effect, by file; kept."""
    path = folder / "printed.json"
    found = dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else {}
    if "none" not in found:
        found["none"] = printed_with(plant, files["owner"], compensate=False)
    for name, file in files.items():
        if name not in found:
            found[name] = printed_with(plant, file)
    path.write_text(json.dumps(found, indent=1), encoding="utf-8")
    print(path, found, file=sys.stderr, flush=True)
    return found


def printed_with(plant: Plant, file: Path, compensate: bool = True, seconds: float = PRINTED_S) -> float:
    """Contour rms, µm."""
    machine = load_machine(file)
    part = Print(moved_print(), PRINT.name, machine).slices(LAYERS, at_most_s=seconds)[0]
    way = inversion(machine, settings_for(machine), COMPENSATED) if compensate else none()
    errors = contour([_executed(plant, each, way.motion(each)[0]) for each in part])
    return float(1e3 * np.sqrt(np.mean(errors**2)))


def moved_print() -> bytes:
    """Return the print, aside and on top of what has been printed already."""
    text = PRINT.read_bytes()
    for axis, by in ((b"X", ASIDE_MM), (b"Z", HIGH_MM)):
        moved = re.compile(rb"^(G[0-3] [^;\n]*?\b" + axis + rb")(-?[\d.]+)", re.MULTILINE)
        text = moved.sub(partial(_further, by=by), text)
    return text


def _further(match: re.Match[bytes], by: float) -> bytes:
    """Return a coordinate's word with another number."""
    return match[1] + b"%.4f" % (float(match[2]) + by)


def _executed(plant: Plant, stretch: PrintSlice, motion: Any) -> Execution:
    """Return what the independent printer makes of a command."""
    t = np.arange(motion.begin_t, motion.end_t, 1 / PLANT_HZ)
    nozzle = motion.position(t)
    nozzle[:, :2] = simulate(plant, nozzle[:, :2], PLANT_HZ, float(nozzle[:, 2].mean()))["position_mm"]
    return Execution(stretch, motion, t[4::4], nozzle[4::4])


if __name__ == "__main__":
    main()
