"""Every method on the sample prints and on a print from outside, with machines that are not as their files say.

    OPENBLAS_NUM_THREADS=1 python -m studies.comparison > docs/COMPARISON.md     some half an hour on two cores
    … comparison.py far_star lobed_vase                     only these tables

The print from outside is read from ../shared/data/gcode (or FFCOMP_DATA); without it, its table is left out.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ffcomp.compare.engine import Request, compare
from ffcomp.compare.evaluation import SAMPLE_S
from ffcomp.compare.result import Comparison, Method
from ffcomp.compare.sampling import Print, Sampling
from ffcomp.metrics import contour_error
from models.file import load_machine
from models.machine import Machine

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

HEAD = (
    "| method | contour rms | p99 | max | extruding: rms | p99 | tracking rms (no delay) | ringing | peak m/s² "
    "| 10 % off: median | worst | m/s² for p99 < 25 µm | print time s |"
)
INTRODUCTION = f"""# Comparison

Made by `python -m studies.comparison > docs/COMPARISON.md` (Python {platform.python_version()}); every table is what
`ffcomp compare` finds. All errors in µm.

- **The judge** is the virtual printer (`models/printer/printer.py`): nonlinear, with weight, integrated 6400 times a
second or
  more. It agrees with MuJoCo ([CROSS_CHECK.md](CROSS_CHECK.md)) and with the independent plant of the tests. The
  commands come from the linear design model; our own are G-code text, read again and planned as the firmware plans it.
- **contour**: distance to the segments of the wanted path, over all moves and where plastic flows. **tracking**: at
  equal times, raw, and in brackets with the best constant delay removed. **ringing**: rms of what still swings where
  the wanted motion cruises straight, or rests. **peak**: largest acceleration of a carriage's command over 4 ms; the
  limit of both machines is 30 m/s².
- **calibrated**: the frequency that Klipper's calibration finds from a simulated resonance test at the bed's middle.
  **best fixed**: the x and y frequency and the damping ratio with the least contour rms on this very print, sought
  with the printer known. **scheduled**: the frequency follows the mode over the bed (no firmware has it), times the
  best of twelve factors. z is not shaped, as in the firmwares, so that shapers' largest errors are at z moves.
- **inversion, one model**: filtered B-splines with the model of the bed's middle. **scheduled inversion**: ffcomp.
- **10 % off**: {SEEDS} printers whose masses, stiffnesses, dampings and drive are *each* off by a normal draw with a
  standard deviation of 10 %, while every method keeps the tuning of the nominal machine. In brackets the best fixed
  shaper tuned anew on every one of these printers, which nobody can do without measuring them.
- **m/s² for p99 < 25 µm**: the highest acceleration (of every move) at which 99 % of the contour error stays below
  25 µm on 30 s of the print, within the carriages' limits, and the print time which that gives for the whole print.
  ">": the highest that was tried; "<": not even the lowest.
"""


def main(names: list[str]) -> None:
    if not names:
        print(INTRODUCTION)
    for path, name in CASES:
        if names and path.stem not in names:
            continue
        if path.exists():
            for line in case(path, load_machine(name)):
                print(line, flush=True)
        else:
            print(f"## {path.stem}\n\nNot here: {path.name} lies beside the project, not in it.\n")


def case(path: Path, machine: Machine) -> Iterator[str]:
    data = path.read_bytes()
    seconds = Print(data, path.name, machine).print_time_s
    sampling = Sampling(share=min(1.0, LONGEST_S / seconds))
    found = compare(data, path.name, machine, None, Request(sampling, MISMATCH, SEEDS), progress=_said)
    yield f"## {path.stem} on {machine.name}\n"
    yield f"{found.sampling} {found.seconds:.0f} s of computing.\n"
    yield HEAD
    yield "|---" * (HEAD.count("|") - 1) + "|"
    for method in found.methods.values():
        yield row(found, method)
    yield ""
    yield from conclusions(found, floor_um(data, path.name, machine, sampling))
    yield from other_mismatches(data, path.name, machine, sampling, found.best_fixed)


def row(found: Comparison, method: Method) -> str:
    t, e, quality, spread = method.track, method.extruding, method.equal_quality, method.spread
    assert quality is not None and spread is not None
    bold = "**" if method.name in (found.compensated, found.best_fixed) else ""
    sign = "> " if quality.capped else "" if quality.reached else "< "
    again = "" if method.retuned is None else f" ({method.retuned.median_um:.2f})"
    worst_again = "" if method.retuned is None else f" ({method.retuned.worst_um:.2f})"
    return (
        f"| {bold}{method.label}{bold} | {t.contour_rms_um:.2f} | {t.contour_p99_um:.1f} | {t.contour_max_um:.0f} "
        f"| {e.contour_rms_um:.2f} | {e.contour_p99_um:.1f} "
        f"| {t.tracking_rms_um:.1f} ({t.tracking_rms_no_delay_um:.2f}) | {method.residual_rms_um:.2f} "
        f"| {method.peaks.acceleration_mm_per_s2 / 1e3:.1f}{'' if method.peaks.within_limits else ' !'} "
        f"| {spread.median_um:.2f}{again} | {spread.worst_um:.2f}{worst_again} "
        f"| {sign}{quality.acceleration_mm_per_s2 / 1e3:.2f} | {quality.print_time_s:.0f} |"
    )


def conclusions(found: Comparison, floor: float) -> Iterator[str]:
    """The aims, and where we are."""
    ours, best, none = (found.methods[name] for name in (found.compensated, found.best_fixed, "none"))
    assert ours.spread and best.spread
    fastest = max(
        (m for m in found.methods.values() if m.family in ("calibrated", "best fixed") and m.equal_quality),
        key=lambda m: m.equal_quality.acceleration_mm_per_s2 if m.equal_quality else 0.0,
    )
    pairs = zip(ours.spread.contour_rms_um, best.spread.contour_rms_um, strict=True)
    above = sum(mine > theirs for mine, theirs in pairs)
    quick, shaper, slow = (m.equal_quality for m in (ours, fastest, none))
    assert quick and shaper and slow
    yield f"- {best.label} ({best.tuning})"
    yield (
        f"- Nominal: contour rms {best.track.contour_rms_um / ours.track.contour_rms_um:.1f} times below the best "
        f"fixed shaper (aim 8), {none.track.contour_rms_um / ours.track.contour_rms_um:.0f} times below none. "
        f"(A nozzle that followed the plan perfectly up to {SMOOTHED_HZ:.0f} Hz would still be {floor:.2f} µm off the "
        f"path's own corners.)"
    )
    yield (
        f"- 10 % off: median {best.spread.median_um / ours.spread.median_um:.1f} times below the best fixed shaper's "
        f"(aim 3); above it on {above} of {SEEDS} printers (aim 0)."
    )
    yield (
        f"- Equal quality: {quick.acceleration_mm_per_s2 / shaper.acceleration_mm_per_s2:.1f} times the acceleration "
        f"of the best shaper, {fastest.label} (aim 2), "
        f"{quick.acceleration_mm_per_s2 / slow.acceleration_mm_per_s2:.0f} times that of none"
        f"{'' if slow.reached else ' at least'} (aim 5); print time {quick.print_time_s:.0f} s against "
        f"{shaper.print_time_s:.0f} and {slow.print_time_s:.0f} s."
    )
    yield ""


def floor_um(data: bytes, name: str, machine: Machine, sampling: Sampling) -> float:
    """Contour rms of the plan itself without what is faster than SMOOTHED_HZ (a Gaussian filter, -3 dB there)."""
    width_s = np.sqrt(np.log(2)) / (2 * np.pi * SMOOTHED_HZ)
    errors = []
    for stretch in Print(data, name, machine).slices(sampling)[0]:
        t = np.arange(stretch.motion.begin_t, stretch.motion.end_t, SAMPLE_S)
        smooth = gaussian_filter1d(stretch.motion.position(t), width_s / SAMPLE_S, axis=0, mode="nearest")
        errors.append(contour_error(*stretch.corners, t, smooth))
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) * 1e3


def other_mismatches(data: bytes, name: str, machine: Machine, sampling: Sampling, best: str) -> Iterator[str]:
    """How the advantage depends on how well the machine is known."""
    yield "| machine off by (sd) | best fixed shaper: median, worst | ffcomp: median, worst | ratio of medians |"
    yield "|---|---|---|---|"
    for off in OTHER_MISMATCHES:
        request = Request(sampling, off, SEEDS, 0.0, (best,))
        found = compare(data, name, machine, None, request, progress=_said)
        ours, theirs = (found.methods[key].spread for key in (found.compensated, best))
        assert ours and theirs
        yield (
            f"| {off:.0%} | {theirs.median_um:.2f}, {theirs.worst_um:.2f} | {ours.median_um:.2f}, {ours.worst_um:.2f} "
            f"| {theirs.median_um / ours.median_um:.1f} |"
        )
    yield ""


def _said(what: str, share: float) -> None:
    print(f"  {what} {share:.0%}", end="        \r", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
