"""The loop of an owner who leaves the sensor on: print, record, update, print better; on printers that drift.

    python -m studies.loop --write          six printers, ten prints each: ten minutes of CPU

Each printer begins with a file of the library, whose numbers are assumed (20 %), and is compensated with
`--max-error-um 25`. The compensated print is recorded while it prints (`record plan --print`), joined by itself, and
`identify update` makes the file for the next print. The printers are those of `validation/plants`: other equations than
`models`, friction and towers that differ; from print to print their stiffnesses, masses and dampings walk at random.
The error is that of `validation/independent`: its own reader, its own clock.
"""

from __future__ import annotations

import argparse
import copy
import json
import re
import tempfile
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

import ffcomp
from ffcomp.diagnosis.update import update_files
from ffcomp.errors import MeasurementError, NothingToDo
from ffcomp.identification.request import UpdateRequest
from ffcomp.inverse.robust import mode_sd
from ffcomp.inverse.settings import settings_for
from ffcomp.record.gcode_writer import Recorder
from ffcomp.record.plan import Experiment
from ffcomp.record.prints import plan_of, plan_print, print_lines
from gcode.atomic_write import replace_atomically
from models.file import load_machine, updated_text
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from studies.render import REPORTS, save
from studies.scan import EACH_TOWER, SPREAD
from validation.independent.checks import printer_of
from validation.independent.play import contour
from validation.plants.accelerometer import draw_chip, klipper_capture, nozzle_felt
from validation.plants.straight_plant import Plant, simulate
from validation.plants.study import uneven

FloatArray = NDArray[np.float64]

FRICTION_N = 0.3
PRINT = Path(__file__).parents[1] / "docs" / "examples" / "print.gcode"
AXIS = re.compile(rb"\b([XY])(-?[\d.]+)")
BOUND_UM, ASSUMED, SHOWN = 25.0, 0.2, (1, 2, 3, 5, 10)
WALK = {"stiffness": 0.005, "mass": 0.003, "damping": 0.02}  # from print to print, relative
RATE_HZ, RINGING, HIGHEST_HZ = 6400.0, 0.25, 110.0
PRINTERS = {"delta": ("mp-delta-pro", (0.0, 0.0)), "CoreXY": ("voron-250", (125.0, 125.0))}
PRINTERS["bed slinger"] = ("ender-3", (110.0, 110.0))


@dataclass(frozen=True, eq=False)
class Printer:
    """A printer as it is at one print."""

    tables: dict[str, Any]  # that the independent judge plays
    numbers: dict[str, Any]  # of the best file that there can be
    felt: Callable[[Experiment, float, float], CubicSpline]  # of all three axes
    modes: Callable[[Machine], tuple[FloatArray, FloatArray]]  # frequencies Hz and damping ratios, of what is like it
    plant: Any
    chips: dict[str, FloatArray]  # name -> (3,) which part of the motion along x, y, z it feels


def delta(name: str, rng: np.random.Generator) -> Printer:
    """Sample a delta around the library's, with towers that differ and some friction."""
    document = tomllib.loads(Path(load_machine(name).path).read_text(encoding="utf-8"))
    _moved(document, SPREAD, rng)
    return _delta(uneven(document, 5, FRICTION_N))


def _delta(real: dict[str, Any]) -> Printer:
    towers = real["towers"]
    means = {key: float(np.mean(towers[key])) for key in ("belt_stiffness_n_per_m", "belt_damping_n_s_per_m")}
    means |= {"guide_damping_n_s_per_m": float(np.mean(towers["guide_damping_n_s_per_m"]))}
    means |= {"mass_kg": float(np.mean(towers["carriage_mass_kg"]))}
    numbers = {f"carriage.{key}": value for key, value in means.items()}
    keys = ("nozzle_mass_kg", "extruder_mass_kg", "extruder_stiffness_n_per_m", "extruder_damping_n_s_per_m")
    numbers |= {f"effector.{key}": real["effector"][key] for key in keys}

    def felt(each: Experiment, begin_s: float, end_s: float) -> CubicSpline:
        return nozzle_felt(real, each.motion.nozzle, begin_s, end_s)

    def modes(best: Machine) -> tuple[FloatArray, FloatArray]:
        each: dict[str, Any] = {key: np.array(towers[key]) for key in EACH_TOWER}
        carriage = replace(delta_vibration(best).carriage, **each)
        found = with_parts(best, carriage=carriage).vibration.modes_at(np.array(best.kinematics.centre_mm))
        return found.frequencies_hz, found.damping_ratios

    towers["mass_kg"] = towers["carriage_mass_kg"]
    return Printer(real, numbers, felt, modes, real, {"adxl345": np.ones(3)})


def straight(name: str, rng: np.random.Generator) -> Printer:
    """Sample a CoreXY or a bed slinger around the library's."""
    machine, kg = load_machine(name), np.array([0.4, 0.5])
    hz = np.array([machine.vibration.value(f"axes.{axis}.frequency_hz[0]") for axis in "xy"])
    hz *= np.exp(0.15 * rng.standard_normal(2))
    held = 2 * rng.uniform(0.04, 0.1, 2) * kg * 2 * np.pi * hz
    stiffness = kg * (2 * np.pi * hz) ** 2
    motors = ((1.0, 0.0), (0.0, 1.0))
    if machine.kinematics.shares_motors:  # two belts, alike, pull along both axes: the masses make the frequencies
        motors, stiffness = ((1.0, 1.0), (1.0, -1.0)), np.full(2, 3e4)
        held *= 6e4 / (2 * np.pi * hz) ** 2 / kg
        kg = 6e4 / (2 * np.pi * hz) ** 2
    plant = Plant(
        motors=motors,
        carriage_kg=(float(kg[0]), float(kg[1])),
        belt_n_per_m=(float(stiffness[0]), float(stiffness[1])),
        guide_n_s_per_m=(float(held[0]), float(held[1])),
        friction_n=(FRICTION_N, FRICTION_N),
        bristle_n_per_m=5e4,
    )
    bed = not machine.kinematics.shares_motors
    chips = (
        {"adxl345": np.array([1.0, 0.0, 1.0]), "bed": np.array([0.0, -1.0, 0.0])} if bed else {"adxl345": np.ones(3)}
    )
    return _straight(plant, tomllib.loads(Path(machine.path).read_text(encoding="utf-8")), chips)


def _straight(plant: Plant, document: dict[str, Any], chips: dict[str, FloatArray]) -> Printer:
    axes = {}
    for i, axis in enumerate("xy"):
        hz, damping, share = plant.axis_modes(i)
        axes[axis] = {"frequency_hz": hz, "damping_ratio": damping, "share": share}
    numbers = {f"axes.{axis}.{key}": value for axis, table in axes.items() for key, value in table.items()}

    def felt(each: Experiment, begin_s: float, end_s: float) -> CubicSpline:
        t = np.arange(begin_s - 0.3, end_s + 0.1, 1 / RATE_HZ)
        found = simulate(plant, each.motion.nozzle(t)[:, :2], RATE_HZ)["acceleration_m_per_s2"]
        return CubicSpline(t, np.column_stack([found, np.zeros(len(t))]))

    def modes(best: Machine) -> tuple[FloatArray, FloatArray]:
        hz, damping, _ = (np.concatenate(each) for each in zip(*map(plant.axis_modes, (0, 1)), strict=True))
        return hz, damping

    return Printer({**document, "axes": axes}, numbers, felt, modes, plant, chips)


def drifted(printer: Printer, rng: np.random.Generator) -> Printer:
    """Return the printer at its next print."""
    if isinstance(printer.plant, dict):
        real = copy.deepcopy(printer.plant)
        _moved(real, WALK, rng, ("towers", "effector"))
        return _delta(real)
    plant, kinds = printer.plant, {"belt_n_per_m": "stiffness", "carriage_kg": "mass", "guide_n_s_per_m": "damping"}
    moved = {
        key: tuple((np.array(getattr(plant, key)) * np.exp(WALK[kind] * rng.standard_normal(2))).tolist())
        for key, kind in kinds.items()
    }
    return _straight(replace(plant, **moved), printer.tables, printer.chips)


def _moved(
    document: dict[str, Any],
    sd: dict[str, float],
    rng: np.random.Generator,
    tables: tuple[str, ...] = ("carriage", "effector"),
) -> None:
    for table in tables:
        for key, value in document[table].items():
            kind = next((name for name in sd if name in key and key != "arm_mass_share_at_ends"), None)
            if kind is not None and key != "arm_pair_mass_kg" and "center" not in key:
                document[table][key] = (
                    np.array(value) * np.exp(sd[kind] * rng.standard_normal(np.shape(value)))
                ).tolist()


# ---- a print ------------------------------------------------------------------------------------------


def sliced(middle_mm: tuple[float, float], path: Path) -> Path:
    """Write the print in the middle of a bed."""

    def moved(match: re.Match[bytes]) -> bytes:
        return b"%b%.3f" % (match[1], float(match[2]) + middle_mm[match[1] == b"Y"])

    lines = PRINT.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(AXIS.sub(moved, line) if line.startswith(b"G1 ") else line for line in lines))
    return path


def printed(original: Path, printer: Printer, file: Path, output: Path) -> dict[str, float]:
    """Compensate a print under the bound with a file, and judge it on the printer; it is made only once a file."""
    if not output.exists():
        ffcomp.compensate(
            original,
            file,
            output,
            max_error_um=BOUND_UM,
            change_speed=("first layer", "Bridge infill"),
            min_layer_time_s=0.0,
        )
    judge = printer_of(printer.tables)
    found = contour(original.read_bytes(), output.read_bytes(), printer.tables, judge)
    return {
        "print_s": float(found["judged_s"] or 0.0),
        "p99_um": float(found["judged_contour_compensated_p99_um"] or 0.0),
        "rms_um": float(found["judged_contour_compensated_um"] or 0.0),
    }


def known(printer: Printer, file: Path, best: Path) -> dict[str, float]:
    """Return how well a file knows the printer: as it says, and in truth."""
    machine = load_machine(str(file))
    hz, damping = printer.modes(load_machine(str(best)))
    ringing = (damping < RINGING) & (hz < HIGHEST_HZ)
    ours = machine.vibration.modes_at(np.array(machine.kinematics.centre_mm)).frequencies_hz
    errors = [float(np.min(np.abs(ours / each - 1.0))) for each in hz[ringing]]
    return {"says": mode_sd(machine, settings_for(machine).bandwidth_hz), "off": max(errors)}


def recorded(printer: Printer, file: Path, print_file: Path, rng: np.random.Generator) -> tuple[Path, list[Path]]:
    """Print once more with captures: the print that holds their commands, and the captures."""
    machine, folder = load_machine(str(file)), print_file.parent
    plan, program = plan_print(print_file, machine, "klipper")
    with_captures = folder / f"{print_file.stem}-recorded.gcode"
    replace_atomically(with_captures, print_lines(plan, program, Recorder("klipper", tuple(printer.chips))))
    plan, captures = plan_of(with_captures, machine), []
    chips = {name: draw_chip(rng, np.eye(3)) for name in printer.chips}
    for each in plan.experiments:
        begin_s, end_s = -plan.rest_before_s, each.duration_s + plan.rest_after_s
        felt = printer.felt(each, begin_s - 0.05, end_s + 0.05)
        for name, chip in chips.items():
            part = CubicSpline(felt.x, felt(felt.x) * printer.chips[name])
            path = folder / f"{name}-{each.name}-1-{print_file.stem}.csv"
            path.write_text(klipper_capture(part, chip, begin_s, end_s, 55.0, rng), encoding="utf-8")
            captures.append(path)
    return with_captures, captures


def loop(name: str, prints: int, folder: Path, seed: int = 1) -> list[dict[str, Any]]:
    """Make prints one after the other, with a file that is updated by each."""
    rng = np.random.default_rng([seed, *name.encode()])
    library = PRINTERS[name][0]
    printer = delta(library, rng) if name == "delta" else straight(library, rng)
    first = folder / "assumed.toml"
    source = Path(load_machine(library).path)
    first.write_text(updated_text(source, {}, name="assumed", uncertainty={"default": ASSUMED}), encoding="utf-8")
    original = sliced(PRINTERS[name][1], folder / "print.gcode")
    file, since, rows = first, 1, []
    for n in range(1, prints + 1):
        best = folder / f"best-{n}.toml"
        certain = {"default": 0.0}
        best.write_text(updated_text(source, printer.numbers, name="best", uncertainty=certain), encoding="utf-8")
        row: dict[str, Any] = {"printer": f"{name} {seed}", "print": n, "known": known(printer, file, best)}
        row["update"] = printed(original, printer, file, folder / f"update-{n}.gcode")
        if n in SHOWN:
            row["never"] = printed(original, printer, first, folder / "never.gcode")
            row["perfect"] = printed(original, printer, best, folder / f"perfect-{n}.gcode")
        plan, captures = recorded(printer, file, folder / f"update-{n}.gcode", rng)
        began = time.process_time()
        next_file = folder / f"update-{n}.toml"
        request = UpdateRequest(
            data=tuple(captures),
            machine=str(file),
            output=next_file,
            plan=plan,
            prints=since,
            history=folder / "h.jsonl",
        )
        try:
            result = update_files(request)
            file, since = next_file, 1
            row["held_out"] = result.held_out
            row["innovation"] = result.innovation
        except (MeasurementError, NothingToDo) as error:
            since, row["refused"] = since + 1, str(error)
        row["cpu_s"] = time.process_time() - began
        row["after"] = known(printer, file, best)
        print(json.dumps(row), flush=True)
        rows.append(row)
        printer = drifted(printer, rng)
    return rows


def figure(rows: list[dict[str, Any]]) -> None:
    """Draw how well the file knows the printer, and how long the print takes, from print to print."""
    drawn = Figure(figsize=(10, 4), layout="constrained")
    left, right = drawn.subplots(1, 2)
    for name in dict.fromkeys(row["printer"] for row in rows):
        of = [row for row in rows if row["printer"] == name]
        kind, _, seed = name.rpartition(" ")
        colour, label = f"C{list(PRINTERS).index(kind)}", kind if seed == str(rows[0]["printer"]).split()[-1] else None
        n = [row["print"] for row in of]
        left.plot(n, [100 * row["known"]["says"] for row in of], color=colour, marker="o", label=label)
        left.plot(n, [100 * row["known"]["off"] for row in of], color=colour, linestyle=":")
        shown = [row for row in of if "perfect" in row]
        for key, style in (("update", "-"), ("never", "--")):
            share = [row[key]["print_s"] / row["perfect"]["print_s"] for row in shown]
            right.plot([row["print"] for row in shown], share, color=colour, linestyle=style, marker="o")
    left.axhline(2.0, color="grey", linewidth=1)
    left.set(xlabel="print", ylabel="uncertainty of the modes, %", yscale="log")
    left.set_title("what the file says (dotted: its error in truth)", fontsize="medium")
    right.set(xlabel="print", ylabel="times that of perfect knowledge", yscale="log")
    right.set_title("print time (dashed: never measured)", fontsize="medium")
    left.legend(frameon=False)
    for axes, ticks in ((left, (0.1, 0.2, 0.5, 1, 2, 5, 10, 20)), (right, (1, 1.5, 2, 3, 5, 8))):
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    drawn.savefig(REPORTS / "loop.png", dpi=100)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarise each printer from the third print on, and all prints together."""
    each = []
    for name in dict.fromkeys(row["printer"] for row in rows):
        of = [row for row in rows if row["printer"] == name]
        later = [row for row in of if row["print"] > 2]
        shown = [row for row in later if "perfect" in row]
        each.append(
            {
                "printer": name,
                "off_after_two": of[1]["after"]["off"],
                "worst_off": max(row["known"]["off"] for row in later),
                "longer": max(row["update"]["print_s"] / row["perfect"]["print_s"] - 1 for row in shown),
                "quicker": min(row["never"]["print_s"] / row["update"]["print_s"] for row in shown),
            }
        )
    p99 = [row["update"]["p99_um"] for row in rows]
    return {
        "summary": each,
        "prints": len(rows),
        "beyond": sum(value > BOUND_UM for value in p99),
        "worst_p99_um": max(p99),
        "refused": sum("refused" in row for row in rows),
        "cpu_s": float(np.median([row["cpu_s"] for row in rows])),
    }


def main() -> None:
    """Run the loop on every printer, and write the results and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prints", type=int, default=10)
    parser.add_argument("--only", nargs="*", choices=list(PRINTERS), default=list(PRINTERS))
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for name, seed in product(options.only, options.seeds):
        with tempfile.TemporaryDirectory() as folder:
            rows += loop(name, options.prints, Path(folder), seed)
    if options.write:
        figure(rows)
        about = {"bound_um": BOUND_UM, "assumed": ASSUMED, "seeds": options.seeds}
        save("loop", {**about, **summary(rows), "rows": rows})


if __name__ == "__main__":
    main()
