"""How closely the nozzle follows: the sample prints, judged by the independent plant of the tests.

    python benchmarks/accuracy.py             the tables of docs/ACCURACY.md, about six minutes
    python benchmarks/accuracy.py --ablation  what each ingredient is worth, on parts of the prints, about a minute

Shapers get their best frequency and damping ratio on the very print they are scored on, x and y alike. With
KALICO_PYTHON set (see tests/kalico.py) the real Kalico host plans the files too.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from ffcomp import shapers
from ffcomp.invert.settings import Settings
from tests import judge

COARSE_HZ = np.arange(34.0, 56.0, 2.0)
DAMPING_RATIOS = (0.05, 0.1)
TUNING_STEP_S = 1 / 6400
HEAD = (
    "| | tracking rms µm (delay removed) | delay ms | contour rms µm | p99 | max | none / this: tracking, contour "
    "| peak m/s² | segments/s | print time |"
)
FAR_MM = 100.0


def main(arguments: list[str]) -> None:
    print(f"Python {platform.python_version()}, machine file {judge.MACHINE_FILE.name}.\n", flush=True)
    report = ablation if "--ablation" in arguments else whole_print
    for name in judge.PRINTS:
        for line in report(name):
            print(line, flush=True)
        print()


def whole_print(name: str) -> Iterator[str]:
    """The table of one print."""
    original = judge.sample_print(name)
    plan = judge.answer(original, original.motion)
    none = judge.score(original, plan)
    yield f"### {name}, {original.trajectory.end_t:.0f} s\n"
    yield HEAD
    yield "|---" * (HEAD.count("|") - 1) + "|"
    yield row("none", none, none)
    for kind in ("zv", "mzv", "ei"):
        best = tuned(name, original, kind)
        yield row(f"{kind.upper()}, best: {best.frequency_hz:g} Hz, ζ {best.damping_ratio:g}", best.score, none)
    yield from our_rows(original, plan, none)


def our_rows(original: judge.Original, plan: judge.Answer, none: judge.Score) -> Iterator[str]:
    ours = judge.compensated(original)
    own = judge.segments(original, ours)
    answer = judge.answer(original, judge.segments_motion(ours, own))
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
    ours: judge.Compensated,
    own: judge.Segments,
    before: judge.Trajectory,
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


ABLATIONS: dict[str, Settings] = {
    "as it is": Settings(),
    "no correction with what is played": Settings(corrections=0),
    "two corrections": Settings(corrections=2),
    "segments of 5 ms": Settings(segment_s=0.005),
    "bandwidth 80 Hz": Settings(bandwidth_hz=80.0),
    "bandwidth 110 Hz": Settings(bandwidth_hz=110.0),
    "bandwidth 120 Hz": Settings(bandwidth_hz=120.0),
    "every window with its own model": Settings(frozen_mm=1e-6),
    "no segments joined": Settings(merge_um=0.0),
}


def ablation(name: str) -> Iterator[str]:
    """The table of one part of a print: one thing changed at a time."""
    original = judge.sample_print(name, *judge.PARTS_S[name])
    none = judge.judge(original, original.motion)
    yield f"### {name}, {original.trajectory.end_t:.0f} s of it\n"
    yield HEAD
    yield "|---" * (HEAD.count("|") - 1) + "|"
    yield row("none", none, none)
    for label, settings in ABLATIONS.items():
        ours = judge.compensated(original, settings)
        own = judge.segments(original, ours)
        longer = own.trajectory.end_t / original.trajectory.end_t - 1
        about = f"{len(own.trajectory) / own.trajectory.end_t:.0f} | {longer:+.2%}"
        yield row(label, judge.judge(original, judge.segments_motion(ours, own)), none, about)


if __name__ == "__main__":
    main(sys.argv[1:])
