"""How closely the nozzle follows: the sample prints, judged by the independent plant of the tests.

    python -m studies.accuracy                docs/ACCURACY.md, some ten minutes
    python -m studies.accuracy --ablation     measure only its second part, half a minute

Shapers get their best frequency and damping ratio on the very print they are scored on, x and y alike
(z is not shaped, as in the firmwares). With KALICO_PYTHON set (see validation/kalico.py) the real Kalico host plans
the files too.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ffcomp import shapers
from ffcomp.comparison.methods import segments, shaped
from ffcomp.inverse.settings import WriterSettings, settings_for
from ffcomp.planner.trajectory import Trajectory
from studies.render import save
from validation import judge

COARSE_HZ = np.arange(34.0, 72.0, 2.0)
DAMPING_RATIOS = (0.05, 0.1)
TUNING_STEP_S = 1 / 6400
FAR_MM = 100.0

Row = dict[str, Any]


def main(arguments: list[str]) -> None:
    """Measure, and write the results and the page."""
    found: dict[str, Any] = {}
    if "--ablation" not in arguments:
        found = about() | {"prints": [whole_print(name) for name in judge.PRINTS]}
    save("accuracy", found | {"ablation": [ablation(name) for name in judge.PRINTS]})


def about() -> dict[str, Any]:
    """Return how everything is measured."""
    return {
        "machine_file": judge.MACHINE_FILE.name,
        "settle_s": judge.SETTLE_S,
        "plant_steps_per_s": 1 / judge.STEP_S,
        "effort_ms": judge.EFFORT_S * 1e3,
        "damping_ratios": DAMPING_RATIOS,
    }


def table(name: str, original: judge.Original, rows: Iterable[Row]) -> dict[str, Any]:
    """Measure the rows of one print."""
    return {"print": name, "seconds": original.trajectory.end_t, "rows": list(rows)}


def whole_print(name: str) -> dict[str, Any]:
    """Measure one print: shapers, this program, and both through Kalico."""
    original = judge.sample_print(name)
    return table(name, original, whole_rows(name, original))


def whole_rows(name: str, original: judge.Original) -> Iterator[Row]:
    plan = judge.answer(original, original.motion)
    none = judge.score(original, plan)
    yield row("none", none, none)
    for kind in ("zv", "mzv", "ei", "2hump_ei"):
        best = tuned(name, original, kind)
        yield row(f"{kind.upper()}, best: {best.frequency_hz:g} Hz, ζ {best.damping_ratio:g}", best.score, none)
    yield from our_rows(original, plan, none)


def our_rows(original: judge.Original, plan: judge.Answer, none: judge.Score) -> Iterator[Row]:
    ours = judge.compensated(original)
    own = segments(ours, original.machine)
    answer = judge.answer(original, own.motion)
    yield row("**ffcomp**", judge.score(original, answer), none, own.trajectory, original.trajectory)
    far = np.hypot(*plan.wanted[:, :2].T).max() >= FAR_MM
    if os.environ.get("KALICO_PYTHON"):
        before = judge.original_through_kalico(original)
        after = judge.ours_through_kalico(original, ours, own)
        yield row("none, through Kalico", judge.judge(original, before.motion), none)
        score = judge.judge(original, after.motion)
        yield row("**ffcomp**, through Kalico", score, none, after.trajectory, before.trajectory, from_first=True)
    if far:
        there = judge.score(original, plan, FAR_MM)
        yield row(f"none, beyond {FAR_MM:g} mm", there, there)
        yield row(f"**ffcomp**, beyond {FAR_MM:g} mm", judge.score(original, answer, FAR_MM), there)


def row(
    label: str,
    score: judge.Score,
    none: judge.Score,
    after: Trajectory | None = None,
    before: Trajectory | None = None,
    from_first: bool = False,
) -> Row:
    """Describe one command: its score, beside that of none, and its segments and time after and before.

    Times are on the plan's clock; the host's clock counts from its first move (`from_first`).
    """
    return {
        "label": label,
        "tracking_rms_um": score.tracking_rms_um,
        "tracking_rms_no_delay_um": score.tracking_rms_no_delay_um,
        "delay_ms": score.delay_s * 1e3,
        "contour_rms_um": score.contour_rms_um,
        "contour_p99_um": score.contour_p99_um,
        "contour_max_um": score.contour_max_um,
        "tracking_times_better": none.tracking_rms_no_delay_um / score.tracking_rms_no_delay_um,
        "contour_times_better": none.contour_rms_um / score.contour_rms_um,
        "peak_m_per_s2": score.peak_m_per_s2,
        "segments_per_s": len(after) / seconds(after, from_first) if after else None,
        "longer": seconds(after, from_first) / seconds(before, from_first) - 1 if after and before else None,
    }


def seconds(trajectory: Trajectory, from_first: bool) -> float:
    return float(trajectory.end_t - (trajectory.start_t[0] if from_first else 0.0))


def tuned(name: str, original: judge.Original, kind: str) -> judge.Tuned:
    """The best shaper: sought on a part of the print, then to 1 Hz on all of it."""
    part = judge.sample_print(name, *judge.PARTS_S[name])
    coarse = judge.best_shaper(part, part.motion, kind, COARSE_HZ, DAMPING_RATIOS, TUNING_STEP_S)
    near = coarse.frequency_hz + np.array([-1.0, 0.0, 1.0])
    fine = judge.best_shaper(original, original.motion, kind, near, (coarse.damping_ratio,), TUNING_STEP_S)
    shaper = shapers.SHAPERS[kind](fine.frequency_hz, fine.damping_ratio)
    return replace(fine, score=judge.judge(original, shaped(original.motion, shaper, shaper)))


ABLATIONS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "model of the centre everywhere": {"one_model": True},
    "robust inversion": {"robust": True},
    "segments of 5 ms": {"segment_s": 0.005},
    "bandwidth 80 Hz": {"bandwidth_hz": 80.0},
    "bandwidth 110 Hz": {"bandwidth_hz": 110.0},
    "bandwidth 120 Hz": {"bandwidth_hz": 120.0},
    "no segments joined": {"writer": WriterSettings(merge_um=0.0)},
}


def ablation(name: str) -> dict[str, Any]:
    """Measure one part of a print, one thing changed at a time."""
    original = judge.sample_print(name, *judge.PARTS_S[name])
    return table(name, original, ablation_rows(original))


def ablation_rows(original: judge.Original) -> Iterator[Row]:
    none = judge.judge(original, original.motion)
    yield row("none", none, none)
    usual = settings_for(original.machine)
    for label, changed in ABLATIONS.items():
        ours = judge.compensated(original, replace(usual, **changed))
        own = segments(ours, original.machine)
        score = judge.judge(original, own.motion)
        yield row(label, score, none, own.trajectory, original.trajectory)


if __name__ == "__main__":
    main(sys.argv[1:])
