"""Robust against plain inversion, side by side, on printers that are not as their file says.

    python -m studies.robust [--plants N] > docs/ROBUST.md

For each sample print eight stretches, 36 s in all, and a small square far from the bed's middle; N printers (20) whose
dynamic numbers are all off. The machine file says how unsure it is; robust inversion wants what is best over that.
Where a plan that takes longer is looked at, the shapers have the same one, tuned for it.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ffcomp.compare.baselines import LinearPrinter
from ffcomp.compare.evaluation import Execution, contour
from ffcomp.compare.methods import COMPENSATED, ROBUST, TunedMethod, best_fixed, inversion
from ffcomp.compare.monte_carlo import draw_plants
from ffcomp.compare.sampling import Print, PrintSlice, Sampling
from ffcomp.inverse.settings import settings_for
from ffcomp.planner.junctions import junction_limits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.s_curve import SCurve, s_curve
from ffcomp.planner.sections import split_sections
from ffcomp.simulate.playback import simulate_nozzles
from models.file import load_machine
from models.machine import Machine
from models.parameters import dynamic_numbers, value_of, with_values

ROOT = Path(__file__).parents[1]
PRINTS = ("ringing_tower", "lobed_vase", "far_star")
SQUARE = "20 mm square"
SECONDS, PIECE_S = 36.0, 4.5
AIM = 4.0  # times below the best shaper, at 10 %
SHAPERS = ("mzv", "ei", "2hump_ei")
BUDGETS = (0.009, 0.03)  # shares by which a plan may take longer; the first is that of --s-curve

Draw = Callable[[Machine, int], list[Machine]]


@dataclass(frozen=True)
class Off:
    """How far printers are from their file."""

    label: str
    sd: float  # of each number, relative: what the file says of itself
    draw: Draw


def within(machine: Machine, share: float, count: int) -> list[Machine]:
    """Machines whose dynamic numbers are all off, each by its own even draw from ± share."""
    names = dynamic_numbers(machine)
    off = np.random.default_rng(3).uniform(-share, share, (count, len(names)))
    return [
        with_values(machine, {name: value_of(machine, name) * (1 + d) for name, d in zip(names, row, strict=True)})
        for row in off.tolist()
    ]


CASES = (
    Off("sd 5 %", 0.05, lambda machine, count: draw_plants(machine, 0.05, count)),
    Off("within ±10 %", 0.1 / np.sqrt(3), lambda machine, count: within(machine, 0.1, count)),
    Off("sd 10 %", 0.1, lambda machine, count: draw_plants(machine, 0.1, count)),
)


@dataclass(frozen=True)
class Found:
    """Contour rms, µm."""

    label: str
    longer: float  # share by which its plan takes longer
    nominal: float
    off: list[float]  # of each printer

    @property
    def median(self) -> float:
        return float(np.median(self.off))


def square() -> bytes:
    """Ten rounds of a square of 20 mm around (-90, -20), 200 mm/s and 10 m/s²."""
    corners = ((-80, -30), (-80, -10), (-100, -10), (-100, -30))
    rounds = "".join(f"G1 X{x} Y{y} E0.6\n" for _ in range(10) for x, y in corners)
    return f"G90\nM83\nM204 S10000\nG1 X-100 Y-30 Z0.2 F12000\n{rounds}".encode()


def stretches_of(name: str, machine: Machine) -> list[PrintSlice]:
    data = square() if name == SQUARE else (ROOT / "sample_prints" / f"{name}.gcode").read_bytes()
    whole = Print(data, name, machine)
    return whole.slices(Sampling(share=min(1.0, SECONDS / whole.print_time_s)), PIECE_S)[0]


def slower(stretch: PrintSlice, share: float) -> PrintSlice:
    """On the same path, with gentler ramps in a time longer by a share."""
    planned, machine = stretch.planned, stretch.machine
    moves, limits = planned.program.moves, planner_limits(machine)
    stops, waits = stops_and_waits(planned.program)
    plan = plan_moves(moves, limits, stop_before=stops, wait_before=waits)
    allowed = junction_limits(moves, limits, stops | (waits > 0.0))
    most = SCurve(slower=share, limit_mm_per_s2=machine.limits.acceleration_mm_per_s2)
    gentle = s_curve(plan, machine.kinematics.compiled().inverse, most, allowed_v=allowed)
    return replace(stretch, planned=replace(planned, trajectory=gentle, runs=split_sections(gentle, stops)))


def judged(
    stretches: Sequence[PrintSlice], way: TunedMethod, plants: Sequence[Machine], machine: Machine
) -> list[float]:
    """Of each plant, over all stretches."""
    errors: list[list[np.ndarray]] = [[] for _ in plants]
    for stretch in stretches:
        motion, _ = way.motion(stretch)
        t, nozzles = simulate_nozzles(plants, motion, machine)
        for found, nozzle in zip(errors, nozzles, strict=True):
            found.append(contour([Execution(stretch, motion, t, nozzle)]))
    return [1e3 * float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for each in errors]


class Comparison:
    """The stretches of one print on one plan, and the shapers that serve them best."""

    def __init__(self, stretches: Sequence[PrintSlice], longer: float = 0.0) -> None:
        self.stretches, self.longer, self.machine = stretches, longer, stretches[0].machine
        linear = LinearPrinter(self.machine, stretches)
        self.shapers = [best_fixed(linear, kind) for kind in SHAPERS]

    def shaper(self, plants: Sequence[Machine]) -> Found:
        """The best one, by the median over the plants after the first."""
        return min((self._found(way, plants) for way in self.shapers), key=lambda found: found.median)

    def inversion(self, kind: str, sd: float, plants: Sequence[Machine]) -> Found:
        believed = replace(self.machine, uncertainty={"default": sd})
        return self._found(inversion(believed, settings_for(believed), kind), plants)

    def _found(self, way: TunedMethod, plants: Sequence[Machine]) -> Found:
        nominal, *off = judged(self.stretches, way, plants, self.machine)
        return Found(way.label, self.longer, nominal, off)


@dataclass(frozen=True)
class Against:
    """One of our ways against the best shaper on the firmware's plan."""

    name: str  # of the print
    off: Off
    way: Found
    shaper: Found

    @property
    def times(self) -> float:
        return self.shaper.median / self.way.median

    @property
    def above(self) -> int:
        """On how many printers it is worse."""
        return sum(a > b for a, b in zip(self.way.off, self.shaper.off, strict=True))


def rows(name: str, off: Off, plans: Sequence[Comparison], count: int, seen: dict[str, list[Against]]) -> Iterator[str]:
    """The given plan first, then those that take longer. seen : what was found for each of our ways on the first"""
    machine = plans[0].machine
    plants = [machine, *off.draw(machine, count)]
    given = plans[0].shaper(plants)
    for plan in plans:
        shaper = given if plan is plans[0] else plan.shaper(plants)
        yield row(Against(name, off, shaper, given), shaper)
        for kind in (COMPENSATED, ROBUST) if plan is plans[0] else (ROBUST,):
            against = Against(name, off, plan.inversion(kind, off.sd, plants), given)
            if plan is plans[0]:
                seen[kind].append(against)
            yield row(against, shaper)


def row(against: Against, shaper: Found) -> str:
    """shaper : the best on the method's own plan"""
    found, times, same, above = against.way, "", "", ""
    if found is not shaper:
        times, same = f"{against.times:.1f}", f"{shaper.median / found.median:.1f}"
        above = f"{against.above} of {len(found.off)}"
    numbers = (found.nominal, found.median, float(np.mean(found.off)), max(found.off))
    errors = " | ".join(f"{number:.2f}" for number in numbers)
    longer = f"{100 * found.longer:g} %"
    return (
        f"| {against.name} | {against.off.label} | {longer} | {found.label} | {errors} | {times} | {same} | {above} |"
    )


def told(seen: dict[str, list[Against]]) -> Iterator[str]:
    """How many times below the shaper the medians are, on the firmware's plan, and what is above it."""
    yield "\nTimes below the best shaper, on the firmware's plan; and printers on which a way is above it, of all:\n"
    for kind, label in ((COMPENSATED, "Scheduled inversion"), (ROBUST, "Robust inversion")):
        found = seen[kind]
        cases = []
        for off in CASES:
            on_prints = [each.times for each in found if each.off is off and each.name != SQUARE]
            on_square = next(each.times for each in found if each.off is off and each.name == SQUARE)
            cases.append(f"{off.label}: {min(on_prints):.1f} to {max(on_prints):.1f}, square {on_square:.1f}")
        above, of = sum(each.above for each in found), sum(len(each.way.off) for each in found)
        yield f"- {label}: {'; '.join(cases)}; above: {above} of {of}."
    short = [each for each in seen[ROBUST] if each.off is not CASES[0] and each.times < AIM]
    missed = ", ".join(f"{each.name} ({each.off.label})" for each in short)
    yield f"\nThe aim, {AIM:g} times at 10 %, is {'missed on ' + missed if short else 'met'} by robust inversion."


def main() -> None:
    parser = argparse.ArgumentParser(description="Robust and plain inversion on printers that are off.")
    parser.add_argument("--plants", type=int, default=20)
    count = parser.parse_args().plants
    machine = load_machine("mp-delta-pro")
    print(HEAD.format(name=machine.name, seconds=SECONDS, count=count, shapers=", ".join(SHAPERS)))
    seen: dict[str, list[Against]] = {COMPENSATED: [], ROBUST: []}
    for name in (*PRINTS, SQUARE):
        stretches = stretches_of(name, machine)
        given, gentler = Comparison(stretches), list[Comparison]()
        if name != SQUARE:
            gentler = [Comparison([slower(each, share) for each in stretches], share) for share in BUDGETS]
        for off in CASES:
            for line in rows(name, off, [given, *(gentler if off is CASES[-1] else ())], count, seen):
                print(line, flush=True)
    for line in told(seen):
        print(line)
    print(TAIL, end="")


HEAD = """# Robust inversion

Made by `python -m studies.robust > docs/ROBUST.md`. {name}, {seconds:g} s of each print on the
nonlinear virtual printer, and ten rounds of a square of 20 mm around (-90, -20) at 200 mm/s and 10 m/s². {count}
printers have all their 15 masses, stiffnesses, dampings and drive numbers off, each by its own draw: normal with a
standard deviation of 5 % or 10 %, or even within ±10 %. The machine file's `[uncertainty]` says how far. Every method
keeps the tuning of the nominal machine; the shaper is the best fixed one of {shapers} by the median. Contour
error, rms, µm; of ours, the compensated G-code, read again and planned as the firmware plans it.

"Longer" is by how much the plan takes longer than the firmware's; ramps are then gentler (`ffcomp/planner/s_curve.py`;
0.9 % is what `--s-curve` does). "Times below" is the shaper's median on the firmware's plan by the method's, "same
plan" that of the shaper which is best on the method's own plan. "Above it" counts printers on which the method is worse
than the shaper on the firmware's plan.

| print | off by | longer | method | as the file says | median | mean | worst | times below | same plan | above it |
|---|---|---|---|---|---|---|---|---|---|---|"""

TAIL = """
What robust inversion does costs no print time: the nozzle is told to be elsewhere on its path, by about a tenth of a
millimetre at most, and to leave out a little at corners, so that less of the command lies where the machine is least
known. On a machine that is as its file says it is farther off the path than scheduled inversion. Gentler ramps help it
and the shaper. Working it out takes some forty times as long as scheduled inversion (19 s of CPU time for the 346 s of
`ringing_tower`, file to file): it is not the default (`--robust`). Knowing the machine to 5 % instead of 10 %
(`ffcomp identify`) helps scheduled inversion about as much as this does, and both together help most.

What limits it: on curves the nozzle misses its path by the acceleration across it times the error of the machine's
compliance, whatever is commanded when; `lobed_vase` is all curves, and gains least. At corners the direction has to
change within the corner's own time, and what is not known of the FRF near the modes comes out wrong.
"""


if __name__ == "__main__":
    main()
