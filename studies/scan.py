"""Printers that were never measured, known from a picture of a page: how far off, and do the intervals hold?

python -m studies.scan --write          all machines that are not in its results yet: half an hour of CPU
python -m studies.scan --deltas 2 --corexy 1 --slingers 1
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ffcomp.comparison.baselines import LinearPrinter
from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, best_fixed, inversion
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.errors import MeasurementError
from ffcomp.identification.request import ScanRequest
from ffcomp.identification.scanning import fit_pictures
from ffcomp.identification.uncertainty import Estimate
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import rms
from ffcomp.record.page import PageRequest, make_page
from ffcomp.record.plan import Experiment, save_plan
from ffcomp.simulation.command import Motion
from models.file import load_machine, machine_of_text
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.vibration.modal import Axis, ModalAxes
from studies.render import RESULTS, results_of, save
from validation.drawn_page import (
    FINE_SCANNER,
    LEAD_S,
    PHONE,
    SCANNER,
    Bead,
    Camera,
    delta_player,
    draw,
    photograph,
    straight_player,
)
from validation.plants.straight_plant import Plant
from validation.plants.study import uneven

CAMERAS = {"600 dpi": SCANNER, "1200 dpi": FINE_SCANNER, "phone": PHONE}
HIGHEST_HZ, RINGING = 110.0, 0.25
SPREAD = {"stiffness": 0.15, "damping": 0.2, "mass": 0.1}  # standard deviations of the logarithms
RIPPLE_M = 2e-6
EACH_TOWER = ("mass_kg", "belt_stiffness_n_per_m", "belt_damping_n_s_per_m", "guide_damping_n_s_per_m")

PRINT = Path(__file__).parents[1] / "docs" / "examples" / "print.gcode"
SHAPERS = ("zv", "mzv", "ei", "2hump_ei")
PLAYED_S = 1 / 3200

Play = Callable[[Experiment, float], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Printer:
    """A printer that is not quite as its file says."""

    machine: Machine  # the file
    true: Machine  # the best file that there can be; a delta's has three towers
    play: Play

    def modes(self, place: tuple[float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return frequencies, Hz, and damping ratios at a place."""
        modes = self.true.vibration.modes_at(np.array(place))
        return modes.frequencies_hz, modes.damping_ratios


def sampled_delta(seed: int) -> Printer:
    """Sample a delta around the library's, with towers that differ and some friction."""
    machine = load_machine("mp-delta-pro")
    document, rng = tomllib.loads(Path(machine.path).read_text(encoding="utf-8")), np.random.default_rng(seed)
    for table in ("carriage", "effector"):
        for key, value in document[table].items():
            kind = next((name for name in SPREAD if name in key and key != "arm_mass_share_at_ends"), None)
            if kind is not None and key != "arm_pair_mass_kg" and "center" not in key:
                size = np.exp(SPREAD[kind] * rng.standard_normal(np.shape(value)))
                document[table][key] = (np.array(value) * size).tolist()
    real = uneven(document, seed, float(rng.uniform(0.1, 0.4)))
    towers, effector = real["towers"], document["effector"]
    vibration = delta_vibration(machine)
    towers["mass_kg"] = towers["carriage_mass_kg"]
    each: dict[str, Any] = {key: np.array(towers[key]) for key in EACH_TOWER}
    carriage = replace(vibration.carriage, **each)
    own = replace(
        vibration.effector,
        nozzle_mass_kg=effector["nozzle_mass_kg"],
        extruder_mass_kg=effector["extruder_mass_kg"],
        extruder_stiffness_n_per_m=np.array(effector["extruder_stiffness_n_per_m"]),
        extruder_damping_n_s_per_m=np.array(effector["extruder_damping_n_s_per_m"]),
    )
    return Printer(machine, with_parts(machine, carriage=carriage, effector=own), delta_player(real))


def sampled_straight(seed: int, corexy: bool) -> Printer:
    """Sample a CoreXY around a Voron's numbers, or a bed slinger around an Ender's, with a second mode or without."""
    machine, rng = load_machine("voron-250" if corexy else "ender-3"), np.random.default_rng(1000 + seed)
    pull = 2.0 if corexy else 1.0  # belts along each axis
    stiffness, rows = rng.uniform(2e4, 4e4), []
    for name in "xy":
        hz = machine.vibration.value(f"axes.{name}.frequency_hz[0]") * np.exp(0.15 * rng.standard_normal())
        kg = pull * stiffness / (2 * np.pi * hz) ** 2
        low, high = ((0.0, 0.0), (0.08, 0.2), (0.3, 0.5))[rng.choice(3, p=(0.4, 0.35, 0.25))]
        tool = kg * rng.uniform(low, high)  # none, weak or strong
        mount = tool * (2 * np.pi * hz * rng.uniform(1.4, 2.4)) ** 2
        held, in_belts = 2 * rng.uniform(0.04, 0.1) * kg * 2 * np.pi * hz, rng.uniform(0.0, 0.6)
        belt, guide = held * in_belts / pull, held * (1 - in_belts)
        rows.append((kg - tool, tool, mount, 2 * rng.uniform(0.03, 0.08) * np.sqrt(mount * tool), guide, belt))
    friction = rng.uniform(0.05, 0.5, 2)
    columns = [(float(a), float(b)) for a, b in zip(*rows, strict=True)]
    plant = Plant(
        motors=((1.0, 1.0), (1.0, -1.0)) if corexy else ((1.0, 0.0), (0.0, 1.0)),
        carriage_kg=columns[0],
        tool_kg=columns[1],
        belt_n_per_m=(stiffness, stiffness),
        mount_n_per_m=columns[2],
        mount_n_s_per_m=columns[3],
        guide_n_s_per_m=columns[4],
        belt_n_s_per_m=(float(np.mean(columns[5])),) * 2,
        friction_n=(float(friction[0]), float(friction[1])),
        bristle_n_per_m=float(friction.min() / rng.uniform(3e-6, 8e-6)),  # stiffer ones are too quick for the plant
        ripple_m=(RIPPLE_M, RIPPLE_M),
    )
    modal = [Axis(*plant.axis_modes(axis)) for axis in range(2)]
    true = replace(machine, vibration=ModalAxes.of([*modal, Axis()]))
    return Printer(machine, true, straight_player(plant))


def printed(printer: Printer, file: Machine | None) -> float:
    """Return the contour rms, µm, of a print on the printer: compensated with a file, or by the best shaper of all.

    Shapers are sought with the true printer known, and each kind's best one is played.
    """
    x, y = np.array(printer.machine.kinematics.centre_mm).tolist()
    slices = Print(PRINT.read_bytes(), PRINT.name, printer.machine, (x, y), "klipper").slices(Sampling(share=1.0))[0]
    if file is not None:
        ways = [inversion(file, settings_for(file), COMPENSATED)]
    else:
        linear = LinearPrinter(printer.true, slices)
        ways = [best_fixed(linear, kind) for kind in SHAPERS]
    played = ([_executed(printer, each, way.motion(each)[0]) for each in slices] for way in ways)
    return min(1e3 * rms(contour(each)) for each in played)


def _executed(printer: Printer, print_slice: PrintSlice, motion: Motion) -> Execution:
    lasts_s = motion.end_t - motion.begin_t
    drawn = SimpleNamespace(
        duration_s=lasts_s,
        motion=SimpleNamespace(nozzle=lambda t: motion.position(motion.begin_t + np.maximum(t, 0.0))),
    )
    xy = printer.play(cast(Experiment, drawn), PLAYED_S)
    t = motion.begin_t + PLAYED_S * np.arange(len(xy), dtype=np.float64) - LEAD_S
    kept = (t > motion.begin_t) & (t < motion.end_t)
    height = motion.position(t[kept])[:, 2]  # what moves up and down only is not judged
    return Execution(print_slice, motion, t[kept], np.column_stack([xy[kept], height]))


def case(name: str, printer: Printer, cameras: list[str], seed: int) -> list[dict[str, Any]]:
    """Draw a page, see it by each camera, fit, and compare with the truth; print with the fitted file."""
    plan, rng = make_page(printer.machine, PageRequest()), np.random.default_rng(seed)
    bead = Bead(drag_mm=rng.uniform(0.1, 0.3), bore_mm=rng.uniform(0.2, 0.4), rough_mm=rng.uniform(0.005, 0.01))
    drawings = draw(plan, printer.play, bead, seed)
    shaper_um, perfect_um = printed(printer, None), printed(printer, printer.true)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        save_plan(plan, Path(folder) / "page.json")
        for camera in cameras:
            path = Path(folder) / "picture.jpg"
            chosen: Camera = replace(CAMERAS[camera], turn_deg=float(rng.uniform(-4, 4)))
            Image.fromarray(photograph(drawings, chosen, seed)).save(path, quality=chosen.quality)
            before = time.process_time()
            row: dict[str, Any] = {"machine": name, "camera": camera}
            try:
                request = ScanRequest(pictures=(path,), plan=Path(folder) / "page.json", machine=printer.machine.path)
                fit = fit_pictures(printer.machine, request)
                row |= {"explained": fit.result.explained, "modes": _compared(fit.result.modes, printer)}
                row["cpu_s"] = time.process_time() - before
                row["scanned_um"] = printed(printer, machine_of_text(fit.text, fit.name))
            except MeasurementError as error:
                row |= {"refused": error.problems[0], "cpu_s": time.process_time() - before}
            row["shaper_um"], row["perfect_um"] = shaper_um, perfect_um
            print(json.dumps({key: value for key, value in row.items() if key != "modes"}), _worst(row), flush=True)
            rows.append(row)
    return rows


def _compared(modes: Any, printer: Printer) -> list[dict[str, float]]:
    """Compare every ringing mode at every place with the one of the truth that is nearest."""
    rows = []
    alike = len({tuple(f.value for f, _ in each) for each in modes.values()}) == 1
    for place, estimates in list(modes.items())[: 1 if alike else None]:
        hz, damping = printer.modes(place)
        ringing = (damping < RINGING) & (hz < HIGHEST_HZ)
        hz, damping = hz[ringing], damping[ringing]
        for f, d in estimates:
            if f.value < HIGHEST_HZ:
                k = int(np.argmin(np.abs(np.log(hz / f.value))))
                rows.append(
                    {
                        "hz": float(hz[k]),
                        "hz_error": f.value / float(hz[k]) - 1,
                        "damping_error": d.value / float(damping[k]) - 1,
                        "hz_held": _holds(f, float(hz[k])),
                        "damping_held": _holds(d, float(damping[k])),
                    }
                )
    return rows


def _holds(estimate: Estimate, true: float) -> float:
    return float(estimate.low <= true <= estimate.high)


def _worst(row: dict[str, Any]) -> str:
    modes = row.get("modes", [])
    return " ".join(f"{m['hz']:.1f}:{100 * m['hz_error']:+.2f}%/{100 * m['damping_error']:+.0f}%" for m in modes)


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Summarise by kind of machine and camera: medians, worst, and how often intervals hold."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["machine"].partition("-")[0], row["camera"]), []).append(row)
    lines = []
    for (kind, camera), members in groups.items():
        modes = [mode for row in members for mode in row.get("modes", [])]
        f, d = (np.abs([mode[key] for mode in modes]) for key in ("hz_error", "damping_error"))
        lines.append(
            {
                "kind": kind,
                "camera": camera,
                "machines": len(members),
                "refused": sum("refused" in row for row in members),
                "hz_median": float(np.median(f)) if modes else None,
                "hz_within": float(np.mean(f < (0.02 if camera == "phone" else 0.01))) if modes else None,
                "hz_worst": float(f.max()) if modes else None,
                "damping_median": float(np.median(d)) if modes else None,
                "damping_within": float(np.mean(d < 0.15)) if modes else None,
                "held": {key: _wilson([m[f"{key}_held"] for m in modes]) for key in ("hz", "damping")}
                if modes
                else None,
                "cpu_s": float(np.median([row["cpu_s"] for row in members])),
                "times": _times(members),
            }
        )
    return lines


def _times(members: list[dict[str, Any]]) -> list[float] | None:
    """Return how many times the prints are below the best shaper's: median, least, most."""
    times = [row["shaper_um"] / row["scanned_um"] for row in members if "scanned_um" in row]
    return [float(np.median(times)), min(times), max(times)] if times else None


def _wilson(held: list[float]) -> list[float]:
    """Return a share and its 95 % interval (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    n, share, z = len(held), float(np.mean(held)), 1.96
    middle, half = share + z**2 / (2 * n), z * float(np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2)))
    return [share, (middle - half) / (1 + z**2 / n), (middle + half) / (1 + z**2 / n)]


def _done() -> set[tuple[str, str]]:
    """Return which machines and pictures were measured before."""
    if not (RESULTS / "scan.json").exists():
        return set()
    return {(row["machine"], row["camera"]) for row in results_of("scan")["rows"]}


def _keep(rows: list[dict[str, Any]]) -> None:
    """Add rows to what was measured before, in place of those of the same machine and picture."""
    before = results_of("scan")["rows"] if (RESULTS / "scan.json").exists() else []
    new = {(row["machine"], row["camera"]): row for row in [*before, *rows]}
    merged = [
        new[key] for key in sorted(new, key=lambda key: (key[0].partition("-")[0], list(CAMERAS).index(key[1]), key))
    ]
    machines = len({machine for machine, _ in new})
    save("scan", {"highest_hz": HIGHEST_HZ, "machines": machines, "rows": merged, "lines": summary(merged)})


def main() -> None:
    """Run the study; --write keeps its numbers and its page."""
    parser = argparse.ArgumentParser(description=__doc__)
    for kind, count in (("deltas", 10), ("corexy", 5), ("slingers", 5)):
        parser.add_argument(f"--{kind}", type=int, default=count)
    parser.add_argument("--cameras", nargs="*", default=["600 dpi", "phone"], choices=list(CAMERAS))
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    done = _done() if asked.write else set()
    kinds: list[tuple[str, int, int, Callable[[int], Printer]]] = [
        ("CoreXY", asked.corexy, 2300, lambda seed: sampled_straight(seed, True)),
        ("bed slinger", asked.slingers, 2350, lambda seed: sampled_straight(seed, False)),
        ("delta", asked.deltas, 2700, sampled_delta),
    ]
    rows: list[dict[str, Any]] = []
    for kind, count, first, sampled in kinds:
        for i in range(count):
            cameras = [camera for camera in asked.cameras if (f"{kind}-{i}", camera) not in done]
            if cameras:
                more = case(f"{kind}-{i}", sampled(first + i), cameras, first + i)
                rows += more
                if asked.write:
                    _keep(more)
    for line in summary(rows):
        print(json.dumps(line))


if __name__ == "__main__":
    main()
