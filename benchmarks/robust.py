"""Robust against plain inversion, side by side, on printers that are not as their file says.

    python benchmarks/robust.py [--plants N] > docs/ROBUST.md

For each sample print some stretches, 20 s in all; N printers (20) whose dynamic numbers are each off by a normal draw.
The machine file says how unsure it is; robust inversion asks for what is best on average over that.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from ffcomp.compare.judge import Played, contour
from ffcomp.compare.plants import drawn
from ffcomp.compare.play import play
from ffcomp.compare.stretch import Print, Sampling, Stretch
from ffcomp.compare.tuning import LinearPrinter
from ffcomp.compare.ways import OURS, ROBUST, best_fixed, inversion
from ffcomp.pipeline import settings_for
from models.machine import Machine
from models.machine_file import load_machine

ROOT = Path(__file__).parents[1]
PRINTS = ("ringing_tower", "lobed_vase", "far_star")
SECONDS = 20.0
SHAPERS = ("mzv", "ei", "2hump_ei")
UNSURE = (0.02, 0.05, 0.1)


@dataclass(frozen=True)
class Way:
    """Contour rms, µm."""

    label: str
    nominal: float
    off: list[float]  # of each printer


def stretches_of(name: str, machine: Machine) -> list[Stretch]:
    whole = Print((ROOT / "sample_prints" / f"{name}.gcode").read_bytes(), name, machine)
    seconds = sum(each.trajectory.end_t for each in whole.stretches(Sampling())[0])
    return whole.stretches(Sampling(share=min(1.0, SECONDS / seconds)))[0]


def judged(stretches: Sequence[Stretch], way: Any, plants: Sequence[Machine], machine: Machine) -> list[float]:
    """Of each plant, over all stretches."""
    errors: list[list[np.ndarray]] = [[] for _ in plants]
    for stretch in stretches:
        motion, _ = way.motion(stretch)
        t, nozzles = play(plants, motion, machine)
        for found, nozzle in zip(errors, nozzles, strict=True):
            found.append(contour([Played(stretch, motion, t, nozzle)]))
    return [1e3 * float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for each in errors]


def compared(
    stretches: Sequence[Stretch], shapers: Sequence[Any], machine: Machine, sd: float, count: int
) -> list[Way]:
    believed = replace(machine, uncertainty={"default": sd})
    plants = [machine, *drawn(machine, sd, count)]
    ways = [*shapers, *(inversion(believed, settings_for(believed), kind) for kind in (OURS, ROBUST))]
    found = []
    for way in ways:
        nominal, *off = judged(stretches, way, plants, machine)
        found.append(Way(way.label, nominal, off))
    return found


def rows(name: str, sd: float, found: Sequence[Way]) -> Iterator[str]:
    shaper = min(found[: len(SHAPERS)], key=lambda way: float(np.median(way.off)))
    for way in (shaper, *found[len(SHAPERS) :]):
        median, mean = float(np.median(way.off)), float(np.mean(way.off))
        worse = sum(a > b for a, b in zip(way.off, shaper.off, strict=True))
        times = f"{np.median(shaper.off) / median:.1f}" if way is not shaper else ""
        above = f"{worse} of {len(way.off)}" if way is not shaper else ""
        yield (
            f"| {name} | {100 * sd:g} % | {way.label} | {way.nominal:.2f} | {median:.2f} | {mean:.2f} | "
            f"{max(way.off):.2f} | {times} | {above} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description="Robust and plain inversion on printers that are off.")
    parser.add_argument("--plants", type=int, default=20)
    count = parser.parse_args().plants
    machine = load_machine("mp-delta-pro")
    print(f"""# Robust inversion

Made by `python benchmarks/robust.py > docs/ROBUST.md`. {machine.name}; {SECONDS:g} s of each print on the nonlinear
virtual printer; {count} printers whose masses, stiffnesses, dampings and drive are each off by a normal draw of the
standard deviation given, which is also what the file says of itself. Every method keeps the tuning of the nominal
machine; the shaper is the best fixed one of {", ".join(SHAPERS)} by the median. Contour error, rms, µm.

| print | off by | method | as the file says | median | mean | worst | times below the shaper | above it |
|---|---|---|---|---|---|---|---|---|""")
    for name in PRINTS:
        stretches = stretches_of(name, machine)
        linear = LinearPrinter(machine, stretches)
        shapers = [best_fixed(linear, kind) for kind in SHAPERS]
        for sd in UNSURE:
            for row in rows(name, sd, compared(stretches, shapers, machine, sd, count)):
                print(row, flush=True)
    print("""
Robust inversion gives up accuracy on a machine that is as its file says and gains it on the others: the mean over them,
which it minimises, and most of all the worst. It is not the default (`--robust`), for the gain is small where the file
is good. The aims, 4 times at the median and never above the shaper, are met where the machine is known to 2 %, not at
10 %. What limits it: a command's content near a lightly damped mode comes out wrong by as much as the mode's FRF is
wrong there, whatever the command is. With 10 % on every number that is about as much as the content itself: it can only
be left out, as a shaper does, and then it is missing. Measuring the machine (`ffcomp identify`) helps more.""")


if __name__ == "__main__":
    main()
