"""Measure how much quicker a print becomes under a bound, and how far printers as uncertain as the file says are off.

    python -m studies.faster [--printers N] [--whole | --planned]

Every row is made by the quicker plan, the compensated G-code, our planner's plan of it (with `--kalico` the real host's
too) and the plant of `validation/plants`, which shares no code with ffcomp, on printers whose parameters are all off by
their own draw. Error is the distance to the path, whatever the clock. Without `--whole`, parts of the sample prints are
measured. With `--planned`, whole prints are planned, and their error is the plan's own prediction.
"""

from __future__ import annotations

import argparse
import copy
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ffcomp.comparison import methods as ours
from ffcomp.faster.bound import FIRST_LAYER, Bound
from ffcomp.faster.program import FasterProgram, faster_program
from ffcomp.firmware.program import plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import settings_for
from ffcomp.simulation.command import Motion
from studies.render import REPORTS, results_of, save
from validation import judge

FARTHEST = 2.5  # standard deviations
SEED = 7
OPEN = ("Bridge infill", "Overhang perimeter", FIRST_LAYER)
BOUNDS_UM, KNOWN = (25.0, 50.0, 100.0, 10.0), (0.05, 0.02, 0.0)
FLOWS = (20.0, 15.0)
CARRIAGE = ("mass_kg", "belt_stiffness_n_per_m", "belt_damping_n_s_per_m", "guide_damping_n_s_per_m")
EFFECTOR = ("nozzle_mass_kg", "extruder_mass_kg", "extruder_stiffness_n_per_m", "extruder_damping_n_s_per_m")


@dataclass(frozen=True, slots=True)
class Case:
    """What is asked for."""

    name: str
    um: float = 25.0
    known: float = 0.05  # relative standard deviation of what the machine file says
    flow: float = 20.0
    whole: bool = False
    opened: bool = True  # bridges and the first layer too
    kalico: bool = False


def measured(case: Case, printers: int) -> dict[str, Any]:
    """Make a print quicker, and judge it on printers that are off."""
    original = _original(case)
    found, model, took_s = _planned(case, original)
    file = ours.compensated(plan_program(found.program, model.machine), model.machine, model, "klipper")
    file = replace(file, planned=original.planned)
    segments = judge.segments(original, file)
    motion = ours.segments_motion(segments)
    if case.kalico:
        motion = judge.ours_through_kalico(original, file, segments).motion
    return {
        **_about(case, found, took_s),
        "print_s": file.statistics.print_time_s,
        **_errors(case, original, motion, printers),
    }


def planned(case: Case) -> dict[str, Any]:
    """Make a print quicker, and believe the prediction."""
    found, _, took_s = _planned(case, _original(case))
    seconds = sum(found.limited_by.values())
    return {**_about(case, found, took_s), "print_s": seconds, "p99_um": found.p99 * case.um}


def _original(case: Case) -> judge.Original:
    return judge.sample_print(case.name, *(judge.WHOLE_S if case.whole else judge.PARTS_S[case.name]))


def _planned(case: Case, original: judge.Original) -> tuple[FasterProgram, InverseModel, float]:
    """Return the quicker program, the inverse, and the seconds of CPU that planning took."""
    certain = {"kinematics.arm_length_mm": 0.0, "kinematics.delta_radius_mm": 0.0}
    machine = replace(original.machine, uncertainty={"default": case.known, **certain})
    model = InverseModel(machine, replace(settings_for(machine), robust=True))
    bound = Bound(case.um, max_flow_mm3_per_s=case.flow, min_layer_time_s=0.0, change_speed=OPEN if case.opened else ())
    began = time.process_time()
    found = faster_program(original.planned.program, model, bound, layers_before=0 if case.whole else 1)
    return found, model, time.process_time() - began


def _about(case: Case, found: FasterProgram, took_s: float) -> dict[str, Any]:
    return {
        "case": case,
        "sliced_s": found.plan.end_t,
        "least_s": found.actuator_limit_s,
        "limited_by": found.limited_by,
        "speed": found.plan.end_t / took_s,
        "given_up": int(found.reverted.sum()),
    }


def _errors(case: Case, original: judge.Original, motion: Motion, printers: int) -> dict[str, Any]:
    nominal = judge.judge(original, motion)
    known, rng, scores = original.plant, np.random.default_rng(SEED), []
    for _ in range(printers if case.known else 0):
        original.plant = _off(known, case.known, rng)
        scores.append(judge.judge(original, motion))
    original.plant = known
    p99 = [each.contour_p99_um for each in scores]
    return {
        "nominal_p99_um": nominal.contour_p99_um,
        "peak_m_per_s2": nominal.peak_m_per_s2,
        "printers": len(scores),
        "within": sum(each <= case.um for each in p99),
        "median_p99_um": float(np.median(p99)) if p99 else None,
        "worst_p99_um": max(p99, default=None),
        "worst_spot_um": max(each.contour_max_um for each in [nominal, *scores]),
    }


def _off(plant: dict[str, Any], sd: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return a plant whose parameters are all off, each by its own draw."""

    def drawn(value: Any) -> Any:
        moved = np.asarray(value) * (1.0 + sd * np.clip(rng.standard_normal(np.shape(value)), -FARTHEST, FARTHEST))
        return moved.tolist()

    other = copy.deepcopy(plant)
    for part, names in ((other["carriage"], CARRIAGE), (other["effector"], EFFECTOR)):
        part.update({name: drawn(part[name]) for name in names})
    drive = other["carriage"]["drive"]
    drive.update({name: drawn(value) for name, value in drive.items()})
    return other


def cases(whole: bool, kalico: bool) -> Iterator[Case]:
    """Return what is measured."""
    if whole:
        for name in judge.PRINTS:
            yield Case(name, whole=True, kalico=kalico)
        return
    yield from (Case(name, um=um) for um in BOUNDS_UM for name in judge.PRINTS)
    yield from (Case(name, known=known) for known in KNOWN[1:] for name in judge.PRINTS)
    yield from (Case(name, flow=FLOWS[1]) for name in judge.PRINTS)
    if kalico:
        yield from (Case(name, kalico=True) for name in judge.PRINTS)


def cases_planned() -> Iterator[Case]:
    """Return what is planned only, after a first one that compiles."""
    yield from (Case(name, known=known, whole=True) for known in KNOWN[:2] for name in judge.PRINTS)
    yield from (Case(name, whole=True, opened=False) for name in judge.PRINTS)


def figure(rows: list[dict[str, Any]]) -> None:
    """Draw time against the bound."""
    drawn = Figure(figsize=(7, 4), layout="constrained")
    axes = drawn.subplots()
    for name in judge.PRINTS:
        own = [row for row in rows if row["case"]["name"] == name and not row["case"]["kalico"]]
        own = [row for row in own if (row["case"]["known"], row["case"]["flow"]) == (KNOWN[0], FLOWS[0])]
        if not own:
            continue
        own.sort(key=lambda row: float(row["case"]["um"]))
        share = [row["print_s"] / row["sliced_s"] for row in own]
        (line,) = axes.plot([row["case"]["um"] for row in own], share, marker="o", label=name.replace("_", " "))
        axes.axhline(own[0]["least_s"] / own[0]["sliced_s"], color=line.get_color(), linestyle=":", linewidth=1)
    axes.set(xscale="log", xlabel="--max-error-um", ylabel="time, as a share of the sliced one")
    axes.set_xticks(sorted(BOUNDS_UM), [f"{um:g}" for um in sorted(BOUNDS_UM)])
    axes.legend(frameon=False)
    axes.grid(alpha=0.3)
    drawn.savefig(REPORTS / "faster.png", dpi=100)


def main() -> None:
    """Measure, and write the results and the page."""
    parser = argparse.ArgumentParser(description="Quicker prints under a bound.")
    parser.add_argument("--printers", type=int, default=20)
    parser.add_argument("--whole", action="store_true", help="the whole sample prints, at 25 µm")
    parser.add_argument("--kalico", action="store_true", help="planned by the real Kalico host too")
    parser.add_argument("--planned", action="store_true", help="the whole sample prints, planned only")
    options = parser.parse_args()
    if options.planned:
        planned(Case(judge.PRINTS[0]))  # compiles
        save("faster", {"planned": [planned(case) for case in cases_planned()]})
        return
    key = "whole" if options.whole else "parts"
    rows: list[dict[str, Any]] = []
    for case in cases(options.whole, options.kalico):
        rows.append(measured(case, options.printers))
        save("faster", {"seed": SEED, key: rows})
    if not options.whole:
        figure(results_of("faster")["parts"])


if __name__ == "__main__":
    main()
