"""Every method on the sample prints and on prints from outside, with machines that are not as their files say.

    OPENBLAS_NUM_THREADS=1 python -m studies.comparison     studies/reports/comparison.md, an hour on two cores
    … python -m studies.comparison far_star lobed_vase      measure only these tables; the others stay as they are

Each print is saved as soon as it is measured. The prints from outside are read from ../shared/data/gcode (or
FFCOMP_DATA); without them their tables stay as they are.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ffcomp.comparison import methods as every
from ffcomp.comparison.equal_quality import equal_qualities
from ffcomp.comparison.evaluation import SAMPLE_S, Execution, contour
from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.inverse.settings import SlowingSettings, settings_for
from ffcomp.metrics import contour_error, contour_statistics, peak_acceleration, rms
from ffcomp.simulation.expectation import draw_plants
from ffcomp.simulation.linear import STEP_S
from ffcomp.simulation.playback import simulate_nozzles
from gcode.dialect import KLIPPER
from models.file import load_machine
from models.machine import Machine
from studies.comparison_rivals import SPANS_S, Pair, inverse_within, inversions, pairs
from studies.render import DATA, ROOT, results_of, save

CASES = (
    (ROOT / "sample_prints" / "ringing_tower.gcode", "mp-delta-pro"),
    (ROOT / "sample_prints" / "lobed_vase.gcode", "mp-delta-pro"),
    (ROOT / "sample_prints" / "far_star.gcode", "mp-delta-pro"),
    (DATA / "gcode" / "kossel_mks-pwc.gcode", "kossel"),
    (DATA / "gcode" / "makreeltje_cura_slicer.gcode", "voron-300"),
    (DATA / "gcode" / "ender3_ringing_tower.gcode", "ender-3"),
)
MISMATCHES, SEEDS = (0.02, 0.05, 0.10), 20
JUDGED_S, SOUGHT_S, OFF_S = 40.0, 20.0, 20.0  # of print time: every method, the searches, printers that are off
PIECE_S = 5.0
WHOLE = ("ringing_tower", "lobed_vase", "far_star")  # the few best are judged on all of it: what pages quote
BOUND_UM = 25.0  # of the 99th percentile, where the speed for equal quality is sought
SMOOTHED_HZ = 100.0


def main(names: list[str]) -> None:
    """Measure all prints, or those named, and write the results and the page."""
    for path, name in sorted(CASES, key=lambda case: names.index(case[0].stem) if case[0].stem in names else -1):
        if not path.exists():
            print(f"Not here: {path.name} lies beside the project, not in it.", file=sys.stderr)
        elif not names or path.stem in names:
            measured = {path.stem: case(path, load_machine(name), path.stem in WHOLE)}
            found = results_of("comparison")["prints"] | measured
            ordered = {stem: found[stem] for stem in (p.stem for p, _ in CASES) if stem in found}
            save("comparison", {"printers": SEEDS, "smoothed_hz": SMOOTHED_HZ, "prints": ordered})


@dataclass(frozen=True, eq=False)
class Case:
    """One print on one machine, and the parts of it that are used."""

    printed: Print
    machine: Machine
    slices: list[PrintSlice]
    few: list[PrintSlice]
    off: list[PrintSlice]


def case(path: Path, machine: Machine, whole: bool) -> dict[str, Any]:
    """Compare the methods on one print."""
    began = time.process_time()
    printed = Print(path.read_bytes(), path.name, machine, flavor=KLIPPER)
    slices, sampling = printed.slices(Sampling(), at_most_s=JUDGED_S)
    few, off = (printed.slices(Sampling(), PIECE_S, seconds)[0] for seconds in (SOUGHT_S, OFF_S))
    own = Case(printed, machine, slices, few, off)
    tried, others = pairs(machine, few)
    _said(f"{path.stem}: {len(tried)} methods are set", began)
    rows = [_row(pair, slices, machine) for pair in tried]
    ours = [{"label": method.label} | _judged(method, slices, machine) for method in inversions(machine)]
    none = _judged(every.NONE, slices, machine)
    _said("judged", began)
    best = min(range(len(tried)), key=lambda k: rows[k]["best"]["rms_um"])
    plain = [k for k, pair in enumerate(tried) if pair.plain]
    simple = min(plain, key=lambda k: rows[k]["best"]["rms_um"])
    found = {
        "machine": machine.name,
        "sampling": sampling,
        "seconds": printed.print_time_s,
        "none": none,
        "methods": rows,
        "others": others,
        "ours": ours,
        "best": rows[best]["label"],
        "best_um": rows[best]["best"]["rms_um"],
        "best_xy": rows[simple]["label"],
        "best_xy_um": rows[simple]["best"]["rms_um"],
        "best_calibrated_um": min(row["calibrated"]["rms_um"] for row in rows),
        "floor_um": floor_um(slices),
    }
    chosen = [tried[best].best]
    if machine.kinematics.model_reach_mm == 0.0:
        highest = [1e3 * peak for peak in ours[-1]["peaks_m_per_s2"]]
        gentle = [inverse_within(machine, few, *each) for each in zip(highest, SPANS_S, strict=True)]
        found["gentle"] = [_row(each, slices, machine) for each in gentle]
        chosen.append(replace(gentle[0].best, name="gentle", label=f"{gentle[0].label}, at ffcomp's peak"))
    found["off"] = [_off(own, chosen, sd) for sd in MISMATCHES]
    _said("off", began)
    p99 = {chosen[0].name: rows[best]["best"]["p99_um"], every.COMPENSATED: ours[-1]["p99_um"]}
    found["quality"] = _quality(own, chosen[:1], p99)
    _said("quality", began)
    few_best = {"none": every.NONE, "best_xy": tried[simple].best, "best": tried[best].best}
    few_best["ours"] = every.inversion(own.machine, settings_for(own.machine), every.COMPENSATED)
    judged = [printed.whole()] if whole else slices
    quoted = {key: _judged(method, judged, machine) for key, method in few_best.items()}
    found |= {"quoted": quoted, "margin": quoted["best"]["rms_um"] / quoted["ours"]["rms_um"], "whole": whole}
    found["computing_s"] = time.process_time() - began
    _said("all", began)
    return found


# ---- one method ----------------------------------------------------------------------------------


def _row(pair: Pair, slices: Sequence[PrintSlice], plant: Machine) -> dict[str, Any]:
    """Return what the table says of a rival."""
    return {
        "label": pair.label,
        "group": pair.group,
        "calibrated": _judged(pair.calibrated, slices, plant),
        "best": _judged(pair.best, slices, plant),
        "tuning": pair.best.tuning.partition(": ")[0],
    }


def _judged(method: TunedMethod, slices: Sequence[PrintSlice], plant: Machine) -> dict[str, Any]:
    """Execute a method on the simulated printer."""
    (executions,), within = _executed(method, slices, [plant])
    statistics = contour_statistics(contour(executions))
    peaks = [max(_peak_m_per_s2(each, span_s) for each in executions) for span_s in SPANS_S]
    errors = {"rms_um": statistics.rms_um, "p99_um": statistics.p99_um, "max_um": statistics.max_um}
    return {**errors, "peaks_m_per_s2": peaks, "within": within}


def _peak_m_per_s2(execution: Execution, span_s: float) -> float:
    motion, machine = execution.motion, execution.print_slice.machine
    command = motion.actuators(machine)(np.arange(motion.begin_t, motion.end_t, STEP_S))
    return 1e-3 * peak_acceleration(command, STEP_S, span_s)


def _executed(
    method: TunedMethod, slices: Sequence[PrintSlice], plants: Sequence[Machine]
) -> tuple[list[list[Execution]], bool]:
    """Return the executions on each plant, and whether the commands are within the carriages' limits."""
    found: list[list[Execution]] = [[] for _ in plants]
    commanded = method.commands(slices)
    for part, motion in commanded.pieces:
        for own, (t, nozzle) in zip(found, simulate_nozzles(plants, [motion], part.machine), strict=True):
            own.append(Execution(part, motion, t, nozzle))
    return found, commanded.peaks.within_limits


# ---- the few best --------------------------------------------------------------------------------


def _off(own: Case, methods: Sequence[TunedMethod], sd: float) -> dict[str, Any]:
    """Return medians and worst over printers that are off by this much; a robust inverse is told how much."""
    plants = draw_plants(own.machine, sd, SEEDS)
    settings = settings_for(own.machine)
    told = replace(own.machine, uncertainty=dict.fromkeys(own.machine.uncertainty, sd) | {"default": sd})
    ours = every.inversion(own.machine, settings, every.COMPENSATED)
    robust = every.inversion(told, settings, every.ROBUST)
    rows: list[dict[str, Any]] = []
    for method in (*methods, ours, robust):
        executions, _ = _executed(method, own.off, plants)
        each = [rms(contour(on)) * 1e3 for on in executions]
        rows.append({"label": method.label, "median_um": float(np.median(each)), "worst_um": max(each)})
    best = min(row["median_um"] for row in rows[:-2])
    return {
        "sd": sd,
        "rows": rows,
        "margin": best / rows[-2]["median_um"],
        "margin_robust": best / rows[-1]["median_um"],
    }


def _quality(own: Case, methods: Sequence[TunedMethod], p99_um: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the highest acceleration of each method for the same quality."""
    keep_time = replace(settings_for(own.machine), slowing=SlowingSettings(slow=False))
    tried = [*methods, every.inversion(own.machine, keep_time, every.COMPENSATED)]
    found = equal_qualities(tried, own.printed, own.machine, own.few, BOUND_UM, p99_um, lambda what, done: None)
    return [
        {
            "label": method.label,
            "sign": ">" if found[method.name].capped else "" if found[method.name].reached else "<",
            "m_per_s2": found[method.name].acceleration_mm_per_s2 / 1e3,
            "print_time_s": found[method.name].print_time_s,
        }
        for method in tried
    ]


def floor_um(slices: Sequence[PrintSlice]) -> float:
    """Contour rms of the plan itself without what is faster than SMOOTHED_HZ (a Gaussian filter, -3 dB there)."""
    width_s = np.sqrt(np.log(2)) / (2 * np.pi * SMOOTHED_HZ)
    errors = []
    for stretch in slices:
        t = np.arange(stretch.motion.begin_t, stretch.motion.end_t, SAMPLE_S)
        smooth = gaussian_filter1d(stretch.motion.position(t), width_s / SAMPLE_S, axis=0, mode="nearest")
        errors.append(contour_error(*stretch.corners, t, smooth))
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) * 1e3


def _said(what: str, began: float) -> None:
    print(f"  {what}: {time.process_time() - began:.0f} s of CPU", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
