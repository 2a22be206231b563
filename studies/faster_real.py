"""Real prints, a CoreXY and several bounds at equal error, on printers that are off too.

    python -m studies.faster_real FOLDER [--only KEY ...]

FOLDER holds prints of others (`real/*.gcode.gz`); they are not part of the project. Every row is one
`ffcomp compare --equal-quality`: the quickest feeds and acceleration of each shaper, and ffcomp's quicker print, on
slices that stand for the print. Rows that were measured before are kept, so `--only` adds to them.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ffcomp.comparison.quickest import QuickestRequest, quickest
from ffcomp.comparison.result import Quickest, TimedMethod
from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.faster.bound import Bound
from gcode.container import read_bytes
from models.file import load_machine
from studies.render import REPORTS, results_of, save

FLOW, KNOWN, OFF, PRINTERS = 15.0, 0.05, 0.10, 4
SHAPERS = ("mzv", "ei")
EVALUATED_S = 24.0
CERTAIN = ("kinematics.arm_length_mm", "kinematics.delta_radius_mm")


@dataclass(frozen=True, slots=True)
class Case:
    """What is compared."""

    print_name: str
    machine: str
    um: float = 25.0
    printers: int = PRINTERS
    shapers: tuple[str, ...] = SHAPERS

    @property
    def key(self) -> str:
        """Name it."""
        return f"{self.print_name}:{self.um:g}"


CASES = (
    Case("v400_cube", "flsun-v400"),
    Case("v400_overhang", "flsun-v400"),
    Case("helix_calicat", "kossel"),
    Case("chest_benchy", "voron-300"),
    Case("fast_part", "ender-3"),
    *(Case("v400_cube", "flsun-v400", um, 0, SHAPERS[:1]) for um in (10.0, 50.0, 100.0)),
)


def measured(case: Case, folder: Path) -> dict[str, Any]:
    """Compare one print at one bound."""
    data = read_bytes(folder / "real" / f"{case.print_name}.gcode.gz")
    machine = load_machine(case.machine)
    certain = {name: 0.0 for name in machine.uncertainty if name in CERTAIN}
    machine = replace(machine, uncertainty={"default": KNOWN, **certain})
    bound = Bound(case.um, max_flow_mm3_per_s=FLOW)
    printed = Print(data, case.print_name, machine)
    sampling = Sampling(share=min(EVALUATED_S / printed.print_time_s, 1.0))
    began = time.process_time()
    found = quickest(printed, request=QuickestRequest(bound, sampling, case.shapers, OFF, case.printers))
    return {"case": case, "cpu_s": time.process_time() - began, **_row(found)}


def _row(found: Quickest) -> dict[str, Any]:
    own, shaper = found.faster, found.best_shaper
    return {
        "sampling": found.sampling,
        "min_layer_time_s": found.min_layer_time_s,
        "sliced": _about(found.sliced),
        "actuator_limit_s": found.actuator_limit_s,
        "shaper": _about(shaper),
        "shapers": {name: _about(each) for name, each in found.methods.items() if each.family == "best fixed"},
        "kept": _about(found.methods["fbs-lpv"]),
        "faster": {**_about(own), "limited_by": own.limited_by, "warnings": len(own.warnings)},
    }


def _about(each: TimedMethod) -> dict[str, Any]:
    return {
        "label": each.label,
        "print_s": each.print_time_s,
        "p99_um": each.contour_p99_um,
        "max_um": each.contour_max_um,
        "reached": each.reached,
        "feed": each.feed,
        "acceleration": each.acceleration_mm_per_s2,
        "off_p99_um": each.off_p99_um,
        "by_feature_s": each.by_feature_s,
        "by_feature_p99_um": each.by_feature_p99_um,
    }


def figure(rows: list[dict[str, Any]]) -> None:
    """Draw error and time against the bound, with shapers as points."""
    own = sorted((row for row in rows if row["case"]["print_name"] == "v400_cube"), key=lambda row: row["case"]["um"])
    drawn = Figure(figsize=(7, 4.2), layout="constrained")
    axes = drawn.subplots()
    ours = [row["faster"] for row in own]
    axes.plot([e["p99_um"] for e in ours], [e["print_s"] / 60 for e in ours], marker="o", label="ffcomp, faster")
    for row, e in zip(own, ours, strict=True):
        place = (e["p99_um"], e["print_s"] / 60)
        axes.annotate(f"{row['case']['um']:g} µm", place, (4, 4), textcoords="offset points", fontsize=8)
    kept = [row["kept"] for row in own]
    axes.plot([e["p99_um"] for e in kept], [e["print_s"] / 60 for e in kept], "^", label="ffcomp, feeds kept")
    for name in SHAPERS:
        each = [row["shapers"][name] for row in own if name in row["shapers"] and row["shapers"][name]["reached"]]
        if each:
            axes.plot([e["p99_um"] for e in each], [e["print_s"] / 60 for e in each], "s", label=name.upper())
    axes.plot(own[0]["sliced"]["p99_um"], own[0]["sliced"]["print_s"] / 60, "kx", label="as sliced")
    axes.axhline(own[0]["actuator_limit_s"] / 60, color="#b00020", linestyle=":", linewidth=1)
    axes.set(xscale="log", xlabel="contour error, 99 % below, µm", ylabel="minutes")
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3)
    drawn.savefig(REPORTS / "faster_real.png", dpi=100)


def main() -> None:
    """Measure what is asked for, and write the results and the page."""
    parser = argparse.ArgumentParser(description="Real prints at equal error.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    options = parser.parse_args()
    for case in CASES:
        if options.only and case.key not in options.only:
            continue
        row = measured(case, options.folder)
        rows = {**_measured_before(), case.key: row}
        save("faster_real", {"flow": FLOW, "known": KNOWN, "off": OFF, "printers": PRINTERS, "rows": rows})
    figure(list(results_of("faster_real")["rows"].values()))


def _measured_before() -> dict[str, Any]:
    try:
        rows: dict[str, Any] = results_of("faster_real")["rows"]
    except FileNotFoundError:
        return {}
    return rows


if __name__ == "__main__":
    main()
