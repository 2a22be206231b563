"""Robust against plain inversion, side by side, on printers that are not as their file says.

    python -m studies.robust [--plants N]     studies/reports/robust.md, some ten minutes

For each sample print eight stretches, 36 s in all, and a small square far from the bed's middle; N printers (20) whose
dynamic numbers are all off. The machine file says how unsure it is; robust inversion wants what is best over that.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.comparison.baselines import LinearPrinter
from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, ROBUST, TunedMethod, best_fixed, inversion
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.inverse.settings import settings_for
from ffcomp.simulation.expectation import draw_plants
from ffcomp.simulation.playback import simulate_nozzles
from models.file import load_machine
from models.machine import Machine, value_of, with_values
from studies.render import save

ROOT = Path(__file__).parents[1]
PRINTS = ("ringing_tower", "lobed_vase", "far_star")
SQUARE = "20 mm square"
SECONDS, PIECE_S = 36.0, 4.5
AIM = 4.0  # times below the best shaper, at 10 %
SHAPERS = ("mzv", "ei", "2hump_ei")

Draw = Callable[[Machine, int], list[Machine]]


@dataclass(frozen=True)
class Off:
    """How far printers are from their file."""

    label: str
    sd: float  # of each number, relative: what the file says of itself
    draw: Draw


def within(machine: Machine, share: float, count: int) -> list[Machine]:
    """Machines whose dynamic numbers are all off, each by its own even draw from ± share."""
    names = machine.vibration.parameters().names
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
    whole = Print(data, name, machine, flavor="klipper")  # no motor steps in the commands of one side only
    return whole.slices(Sampling(share=min(1.0, SECONDS / whole.print_time_s)), PIECE_S)[0]


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
    """The stretches of one print, and the shapers that serve them best."""

    def __init__(self, stretches: Sequence[PrintSlice]) -> None:
        self.stretches, self.machine = stretches, stretches[0].machine
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
        return Found(way.label, nominal, off)


@dataclass(frozen=True)
class Against:
    """One of our ways against the best shaper."""

    name: str  # of the print
    off: Off
    way: Found
    shaper: Found
    kind: str = ""  # of the inversion

    @property
    def times(self) -> float:
        return self.shaper.median / self.way.median

    @property
    def above(self) -> int:
        """On how many printers it is worse."""
        return sum(a > b for a, b in zip(self.way.off, self.shaper.off, strict=True))


def against_shapers(name: str, off: Off, comparison: Comparison, count: int) -> Iterator[Against]:
    """Yield the best shaper, then each inversion."""
    machine = comparison.machine
    plants = [machine, *off.draw(machine, count)]
    shaper = comparison.shaper(plants)
    yield Against(name, off, shaper, shaper)
    for kind in (COMPENSATED, ROBUST):
        yield Against(name, off, comparison.inversion(kind, off.sd, plants), shaper, kind)


def row(against: Against) -> dict[str, Any]:
    """Return a method's row of the page."""
    found, compared = against.way, against.way is not against.shaper
    return {
        "print": against.name,
        "off_by": against.off.label,
        "method": found.label,
        "nominal_um": found.nominal,
        "median_um": found.median,
        "mean_um": np.mean(found.off),
        "worst_um": max(found.off),
        "times_below": against.times if compared else None,
        "above": against.above if compared else None,
    }


def summary(found: Sequence[Against], label: str) -> dict[str, Any]:
    """Return how many times below the shaper the medians of a method are, and where it is above."""
    cases = []
    for off in CASES:
        on_prints = [each.times for each in found if each.off is off and each.name != SQUARE]
        on_square = next(each.times for each in found if each.off is off and each.name == SQUARE)
        cases.append({"off_by": off.label, "least": min(on_prints), "most": max(on_prints), "square": on_square})
    above, of = sum(each.above for each in found), sum(len(each.way.off) for each in found)
    return {"method": label, "cases": cases, "above": above, "of": of}


def main() -> None:
    """Measure, and write the results and the page."""
    parser = argparse.ArgumentParser(description="Robust and plain inversion on printers that are off.")
    parser.add_argument("--plants", type=int, default=20)
    count = parser.parse_args().plants
    machine = load_machine("mp-delta-pro")
    found: list[Against] = []
    for name in (*PRINTS, SQUARE):
        comparison = Comparison(stretches_of(name, machine))
        for off in CASES:
            found += against_shapers(name, off, comparison, count)
    of_kind = {kind: [each for each in found if each.kind == kind] for kind in (COMPENSATED, ROBUST)}
    missed = [each for each in of_kind[ROBUST] if each.off is not CASES[0] and each.times < AIM]
    save(
        "robust",
        {
            "machine": machine.name,
            "seconds": SECONDS,
            "plants": count,
            "shapers": SHAPERS,
            "aim_times": AIM,
            "rows": [row(each) for each in found],
            "summary": [
                summary(of_kind[COMPENSATED], "Scheduled inversion"),
                summary(of_kind[ROBUST], "Robust inversion"),
            ],
            "missed": [{"print": each.name, "off_by": each.off.label} for each in missed],
        },
    )


if __name__ == "__main__":
    main()
