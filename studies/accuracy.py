"""How closely the nozzle follows: the sample prints, judged by the independent plant of the tests.

    python studies/accuracy.py > docs/ACCURACY.md     some ten minutes
    python studies/accuracy.py --ablation             only what each ingredient is worth, half a minute

Shapers get their best frequency and damping ratio on the very print they are scored on, x and y alike
(z is not shaped, as in the firmwares). With KALICO_PYTHON set (see validation/kalico.py) the real Kalico host plans
the files too.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from ffcomp import shapers
from ffcomp.compare.compensated import Compensated, Segments, segments_motion
from ffcomp.inverse.settings import settings_for
from ffcomp.planner.trajectory import Trajectory
from validation import judge

COARSE_HZ = np.arange(34.0, 72.0, 2.0)
DAMPING_RATIOS = (0.05, 0.1)
TUNING_STEP_S = 1 / 6400
HEAD = (
    "| | tracking rms µm (delay removed) | delay ms | contour rms µm | p99 | max | none / this: tracking, contour "
    "| peak m/s² | segments/s | print time |"
)
FAR_MM = 100.0


INTRODUCTION = f"""# Accuracy

Made by `python studies/accuracy.py > docs/ACCURACY.md` (Python {platform.python_version()}, machine file
`{judge.MACHINE_FILE.name}`). The whole sample prints, without the first {judge.SETTLE_S:g} s: what the file does
before its first known move still rings in them.

The judge is `validation/plants/delta_plant.py`: a nonlinear delta with equations of its own (Lagrange, in the nozzle's
position, with every velocity term), integrated by Runge-Kutta at {1 / judge.STEP_S:.0f} steps a second,
without weight (the static sag belongs to calibration). It shares no line with the model that the command is
designed with, but it has the same parameters: what follows is the error of the method, not of a badly known machine.

- **tracking**: nozzle against plan at equal times; in brackets with the best constant delay removed.
- **contour**: distance to the segments of the wanted path; p99 and max of the same.
- **none / this**: how many times smaller than uncompensated, tracking with the delay removed.
- **peak**: largest acceleration any carriage is asked for, by second difference over one segment
  ({judge.EFFORT_S * 1e3:g} ms). The row "none" is what the plan itself asks; the machine's limit is 30 m/s².
- **ZV, MZV, EI, 2HUMP_EI**: with the best frequency (to 1 Hz) and damping ratio
  ({" or ".join(f"{z:g}" for z in DAMPING_RATIOS)}) on this very print, x and y alike; z is not shaped, as
  in the firmwares, and so their largest errors are at z moves. (Shaping z too, MZV on the first 92 s of the tower
  goes from 8.7 to 6.7 µm contour rms and from 224 to 45 µm at the worst.)
- **through Kalico**: the file as the real Kalico host plans it, and its plan played on the same plant. The star is
  written for Marlin; Kalico does not know its `M205`, so that corner velocity stands in the printer's configuration.
"""
ABOUT_ABLATION = """## What each ingredient is worth

Some 20 s of each print, one thing changed at a time.
"""


def main(arguments: list[str]) -> None:
    if "--ablation" not in arguments:
        tell([INTRODUCTION, "## The sample prints\n"])
        for name in judge.PRINTS:
            tell(whole_print(name))
    tell([ABOUT_ABLATION])
    for name in judge.PRINTS:
        tell(ablation(name))


def tell(lines: Iterable[str]) -> None:
    for line in lines:
        print(line, flush=True)


def whole_print(name: str) -> Iterator[str]:
    """The table of one print."""
    original = judge.sample_print(name)
    plan = judge.answer(original, original.motion)
    none = judge.score(original, plan)
    yield f"### {name}, {original.trajectory.end_t:.0f} s\n"
    yield HEAD
    yield "|---" * (HEAD.count("|") - 1) + "|"
    yield row("none", none, none)
    for kind in ("zv", "mzv", "ei", "2hump_ei"):
        best = tuned(name, original, kind)
        yield row(f"{kind.upper()}, best: {best.frequency_hz:g} Hz, ζ {best.damping_ratio:g}", best.score, none)
    yield from our_rows(original, plan, none)
    yield ""


def our_rows(original: judge.Original, plan: judge.Answer, none: judge.Score) -> Iterator[str]:
    ours = judge.compensated(original)
    own = judge.segments(original, ours)
    answer = judge.answer(original, segments_motion(ours, own))
    longer = own.trajectory.end_t / original.trajectory.end_t - 1
    about = f"{len(own.trajectory) / own.trajectory.end_t:.0f} | {longer:+.2%}"
    yield row("**ours**", judge.score(original, answer), none, about)
    far = np.hypot(*plan.wanted[:, :2].T).max() >= FAR_MM
    if os.environ.get("KALICO_PYTHON"):
        before = judge.original_through_kalico(original)
        yield row("none, through Kalico", judge.judge(original, before.motion), none)
        yield kalico_row(original, ours, own, before.trajectory, none)
    if far:
        there = judge.score(original, plan, FAR_MM)
        yield row(f"none, beyond {FAR_MM:g} mm", there, there)
        yield row(f"**ours**, beyond {FAR_MM:g} mm", judge.score(original, answer, FAR_MM), there)


def kalico_row(
    original: judge.Original,
    ours: Compensated,
    own: Segments,
    before: Trajectory,
    none: judge.Score,
) -> str:
    after = judge.ours_through_kalico(original, ours, own)
    seconds, was = (each.end_t - float(each.start_t[0]) for each in (after.trajectory, before))
    about = f"{len(after.trajectory) / seconds:.0f} | {seconds / was - 1:+.2%}"
    return row("**ours**, through Kalico", judge.judge(original, after.motion), none, about)


def row(label: str, score: judge.Score, none: judge.Score, about: str = "| ") -> str:
    tracking = none.tracking_rms_no_delay_um / score.tracking_rms_no_delay_um
    contour = none.contour_rms_um / score.contour_rms_um
    return (
        f"| {label} | {score.tracking_rms_um:.2f} ({score.tracking_rms_no_delay_um:.2f}) "
        f"| {score.delay_s * 1e3:.2f} | {score.contour_rms_um:.2f} | {score.contour_p99_um:.1f} "
        f"| {score.contour_max_um:.1f} | {tracking:.1f}, {contour:.1f} | {score.peak_m_per_s2:.1f} | {about} |"
    )


def tuned(name: str, original: judge.Original, kind: str) -> judge.Tuned:
    """The best shaper: sought on a part of the print, then to 1 Hz on all of it."""
    part = judge.sample_print(name, *judge.PARTS_S[name])
    coarse = judge.best_shaper(part, part.motion, kind, COARSE_HZ, DAMPING_RATIOS, TUNING_STEP_S)
    near = coarse.frequency_hz + np.array([-1.0, 0.0, 1.0])
    fine = judge.best_shaper(original, original.motion, kind, near, (coarse.damping_ratio,), TUNING_STEP_S)
    shaper = shapers.SHAPERS[kind](fine.frequency_hz, fine.damping_ratio)
    return replace(fine, score=judge.judge(original, judge.shaped(original.motion, shaper)))


ABLATIONS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "model of the centre everywhere": {"one_model": True},
    "the exact inverse": {"inverse": "exact"},
    "robust inversion": {"robust": True},
    "segments of 5 ms": {"segment_s": 0.005},
    "bandwidth 80 Hz": {"bandwidth_hz": 80.0},
    "bandwidth 110 Hz": {"bandwidth_hz": 110.0},
    "bandwidth 120 Hz": {"bandwidth_hz": 120.0},
    "no segments joined": {"merge_um": 0.0},
}


def ablation(name: str) -> Iterator[str]:
    """The table of one part of a print: one thing changed at a time."""
    original = judge.sample_print(name, *judge.PARTS_S[name])
    none = judge.judge(original, original.motion)
    yield f"### {name}, {original.trajectory.end_t:.0f} s of it\n"
    yield HEAD
    yield "|---" * (HEAD.count("|") - 1) + "|"
    yield row("none", none, none)
    usual = settings_for(original.machine)
    for label, changed in ABLATIONS.items():
        ours = judge.compensated(original, replace(usual, **changed))
        own = judge.segments(original, ours)
        longer = own.trajectory.end_t / original.trajectory.end_t - 1
        about = f"{len(own.trajectory) / own.trajectory.end_t:.0f} | {longer:+.2%}"
        yield row(label, judge.judge(original, segments_motion(ours, own)), none, about)
    yield ""


if __name__ == "__main__":
    main(sys.argv[1:])
