"""Every method on the sample prints and on a print from outside, with machines that are not as their files say.

    OPENBLAS_NUM_THREADS=1 python -m studies.comparison     docs/COMPARISON.md, half an hour on two cores
    … python -m studies.comparison far_star lobed_vase      measure only these tables

The print from outside is read from ../shared/data/gcode (or FFCOMP_DATA); without it, its table is left out.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ffcomp.compare.engine import Request, compare
from ffcomp.compare.evaluation import SAMPLE_S
from ffcomp.compare.result import Comparison, Method
from ffcomp.compare.sampling import Print, Sampling
from ffcomp.metrics import contour_error
from models.file import load_machine
from models.machine import Machine
from studies.render import results_of, save

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data"))
CASES = (
    (ROOT / "sample_prints" / "ringing_tower.gcode", "mp-delta-pro"),
    (ROOT / "sample_prints" / "lobed_vase.gcode", "mp-delta-pro"),
    (ROOT / "sample_prints" / "far_star.gcode", "mp-delta-pro"),
    (DATA / "gcode" / "kossel_mks-pwc.gcode", "kossel"),
)
MISMATCH, SEEDS = 0.10, 20
OTHER_MISMATCHES = (0.02, 0.05)
LONGEST_S = 420.0  # of print time that is judged: the sample prints whole, a quarter of the other one
SMOOTHED_HZ = 100.0


def main(names: list[str]) -> None:
    """Measure all tables, or those of the named prints, and write the results and the page."""
    found = results_of("comparison")["prints"] if names else {}
    for path, name in CASES:
        if path.exists() and (not names or path.stem in names):
            found[path.stem] = case(path, load_machine(name))
        elif not path.exists():
            print(f"Not here: {path.name} lies beside the project, not in it.", file=sys.stderr)
    about = {"mismatch": MISMATCH, "printers": SEEDS, "smoothed_hz": SMOOTHED_HZ}
    save("comparison", about | {"prints": found})


def case(path: Path, machine: Machine) -> dict[str, Any]:
    """Compare the methods on one print."""
    data = path.read_bytes()
    seconds = Print(data, path.name, machine).print_time_s
    sampling = Sampling(share=min(1.0, LONGEST_S / seconds))
    found = compare(data, path.name, machine, None, Request(sampling, MISMATCH, SEEDS), progress=_said)
    return {
        "machine": machine.name,
        "sampling": found.sampling,
        "computing_s": found.seconds,
        "methods": [row(found, method) for method in found.methods.values()],
        "conclusions": conclusions(found, floor_um(data, path.name, machine, sampling)),
        "other_mismatches": other_mismatches(data, path.name, machine, sampling, found.best_fixed),
    }


def row(found: Comparison, method: Method) -> dict[str, Any]:
    """Return what the table says of a method."""
    t, e, quality, spread = method.track, method.extruding, method.equal_quality, method.spread
    assert quality is not None and spread is not None
    return {
        "label": method.label,
        "marked": method.name in (found.compensated, found.best_fixed),
        "contour_rms_um": t.contour_rms_um,
        "contour_p99_um": t.contour_p99_um,
        "contour_max_um": t.contour_max_um,
        "extruding_rms_um": e.contour_rms_um,
        "extruding_p99_um": e.contour_p99_um,
        "tracking_rms_um": t.tracking_rms_um,
        "tracking_rms_no_delay_um": t.tracking_rms_no_delay_um,
        "residual_rms_um": method.residual_rms_um,
        "peak_m_per_s2": method.peaks.acceleration_mm_per_s2 / 1e3,
        "within_limits": method.peaks.within_limits,
        "off_median_um": spread.median_um,
        "off_retuned_median_um": method.retuned and method.retuned.median_um,
        "off_worst_um": spread.worst_um,
        "off_retuned_worst_um": method.retuned and method.retuned.worst_um,
        "equal_quality_sign": ">" if quality.capped else "" if quality.reached else "<",
        "equal_quality_m_per_s2": quality.acceleration_mm_per_s2 / 1e3,
        "equal_quality_print_time_s": quality.print_time_s,
    }


def conclusions(found: Comparison, floor: float) -> dict[str, Any]:
    """Return how far the aims are met."""
    ours, best, none = (found.methods[name] for name in (found.compensated, found.best_fixed, "none"))
    assert ours.spread and best.spread
    fastest = max(
        (m for m in found.methods.values() if m.family in ("calibrated", "best fixed") and m.equal_quality),
        key=lambda m: m.equal_quality.acceleration_mm_per_s2 if m.equal_quality else 0.0,
    )
    pairs = zip(ours.spread.contour_rms_um, best.spread.contour_rms_um, strict=True)
    quick, shaper, slow = (m.equal_quality for m in (ours, fastest, none))
    assert quick and shaper and slow
    return {
        "best_fixed": best.label,
        "tuning": best.tuning,
        "below_best_fixed": best.track.contour_rms_um / ours.track.contour_rms_um,
        "below_none": none.track.contour_rms_um / ours.track.contour_rms_um,
        "floor_um": floor,
        "off_below_best_fixed": best.spread.median_um / ours.spread.median_um,
        "off_above": sum(mine > theirs for mine, theirs in pairs),
        "equal_quality": {
            "of_best_shaper": quick.acceleration_mm_per_s2 / shaper.acceleration_mm_per_s2,
            "best_shaper": fastest.label,
            "of_none": quick.acceleration_mm_per_s2 / slow.acceleration_mm_per_s2,
            "none_reached": slow.reached,
            "print_times_s": [quick.print_time_s, shaper.print_time_s, slow.print_time_s],
        },
    }


def floor_um(data: bytes, name: str, machine: Machine, sampling: Sampling) -> float:
    """Contour rms of the plan itself without what is faster than SMOOTHED_HZ (a Gaussian filter, -3 dB there)."""
    width_s = np.sqrt(np.log(2)) / (2 * np.pi * SMOOTHED_HZ)
    errors = []
    for stretch in Print(data, name, machine).slices(sampling)[0]:
        t = np.arange(stretch.motion.begin_t, stretch.motion.end_t, SAMPLE_S)
        smooth = gaussian_filter1d(stretch.motion.position(t), width_s / SAMPLE_S, axis=0, mode="nearest")
        errors.append(contour_error(*stretch.corners, t, smooth))
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) * 1e3


def other_mismatches(data: bytes, name: str, machine: Machine, sampling: Sampling, best: str) -> list[dict[str, float]]:
    """Return how the advantage depends on how well the machine is known."""
    rows = []
    for off in OTHER_MISMATCHES:
        request = Request(sampling, off, SEEDS, 0.0, (best,))
        found = compare(data, name, machine, None, request, progress=_said)
        ours, theirs = (found.methods[key].spread for key in (found.compensated, best))
        assert ours and theirs
        rows.append(
            {
                "off": off,
                "best_fixed_median_um": theirs.median_um,
                "best_fixed_worst_um": theirs.worst_um,
                "compensated_median_um": ours.median_um,
                "compensated_worst_um": ours.worst_um,
                "ratio": theirs.median_um / ours.median_um,
            }
        )
    return rows


def _said(what: str, share: float) -> None:
    print(f"  {what} {share:.0%}", end="        \r", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
