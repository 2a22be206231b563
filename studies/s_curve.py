"""What an S-curve plan takes and gives: print time, peaks of the carriages' command, contour error.

    python -m studies.s_curve [--seconds N] [FILE:MACHINE ...]

Peaks are of the carriages' acceleration over 4 ms: the largest, and the 99.9th percentile. "Plan" is the command before
compensation, over the whole print; "command" is what compensation makes of it, over N seconds (60) of runs drawn at
random, the same for both plans. The contour error is the design model's prediction for these.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one core: said before numpy and scipy start their threads

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ffcomp.compensation.prediction import Prediction
from ffcomp.compensation.solve import SolvedSection
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import settings_for
from ffcomp.inverse.solve import solve
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.trajectory import Section
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT / "../shared/data"))
SAMPLES = ROOT / "sample_prints"
DEFAULT = (
    f"{SAMPLES / 'ringing_tower.gcode'}:mp-delta-pro",
    f"{SAMPLES / 'lobed_vase.gcode'}:mp-delta-pro",
    f"{SAMPLES / 'far_star.gcode'}:mp-delta-pro",
    f"{DATA / 'gcode/kossel_mks-pwc.gcode'}:kossel",
    f"{DATA / 'gcode/flsun_v400_retract-tower.gcode'}:flsun-qqs",
)


@dataclass(frozen=True, slots=True)
class Row:
    """One plan of one print."""

    time_s: float
    plan: FloatArray  # (2,) mm/s², largest and 99.9th percentile
    command: FloatArray  # (2,) mm/s²
    contour_rms_um: float
    contour_p99_um: float


def bends(heights: FloatArray, dt: float) -> FloatArray:
    """Acceleration of the carriage that needs most at each knot, mm/s², rests on both sides included."""
    around = np.vstack([heights[:1], heights, heights[-1:]])
    return np.asarray(np.abs(np.diff(around, 2, axis=0)).max(axis=1) / dt**2)


def peaks(parts: list[FloatArray]) -> FloatArray:
    return np.percentile(np.concatenate(parts), [100.0, 99.9])


def drawn(runs: list[Section], seconds: float) -> list[int]:
    """Indices of runs that travel, in random but repeatable order, as many as make up the time."""
    travels = np.flatnonzero([run.travels for run in runs])
    mixed = np.random.default_rng(1).permutation(travels)
    lasting = np.cumsum([runs[i].end_t - runs[i].begin_t for i in mixed])
    return [int(i) for i in mixed[: int(np.searchsorted(lasting, seconds)) + 1]]


def measure(planned: PlannedProgram, chosen: list[int], machine: Machine) -> Row:
    motion, runs, inverter = planned.trajectory, planned.sections, InverseModel(machine, settings_for(machine))
    knot_s, prediction = inverter.settings.segment_s, Prediction(inverter, 1.0)
    delta = machine.kinematics.compiled()
    before, after = [], []
    for run in runs:
        if run.travels:
            wanted = Reference(motion, run, inverter.settings)
            before.append(bends(delta.inverse(wanted.at_knots(np.arange(wanted.knots + 1))), knot_s))
    for i in chosen:
        wanted = Reference(motion, runs[i], inverter.settings)
        start = motion.origin[runs[i].first, :3]
        result = solve(inverter, wanted, machine.equilibrium(start), keep_response=True)
        after.append(bends(delta.inverse(result.vertices), knot_s))
        prediction.add(SolvedSection(motion, runs[i], wanted, result, slowed=(), knots=(0, wanted.knots)))
    track = prediction.samples.tracks()["compensated"]
    return Row(motion.end_t, peaks(before), peaks(after), track.contour_rms_um, track.contour_p99_um)


def compare(path: Path, machine: Machine, seconds: float) -> tuple[Row, Row]:
    program = read_program(path.read_bytes(), path.name)
    given, gentle = (plan_program(program, machine, smooth) for smooth in (False, True))
    chosen = drawn(given.sections, seconds)
    return measure(given, chosen, machine), measure(gentle, chosen, machine)


def as_line(name: str, was: Row, now: Row | None = None) -> str:
    row = now or was
    cells = [f"{row.time_s:.1f}" + (f" ({row.time_s / was.time_s - 1.0:+.2%})" if now else "")]
    for new, old in zip((*row.plan, *row.command), (*was.plan, *was.command), strict=True):
        cells.append(f"{new / 1e3:.2f}" + (f" ({new / old - 1.0:+.0%})" if now else ""))
    cells.append(f"{row.contour_rms_um:.2f} / {row.contour_p99_um:.2f}")
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="An S-curve plan beside the firmware's own.")
    parser.add_argument("prints", nargs="*", default=DEFAULT, metavar="FILE:MACHINE", help="default: the sample prints")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each print that are compensated")
    options = parser.parse_args()
    print("| print | time s | plan max m/s² | plan 99.9 % | command max m/s² | command 99.9 % | contour rms / p99 µm |")
    print("|---|---|---|---|---|---|---|")
    for chosen in options.prints:
        path, _, name = chosen.rpartition(":")
        machine = load_machine(ROOT / "models" / "library" / f"{name}.toml")
        was, now = compare(Path(path), machine, options.seconds)
        print(as_line(Path(path).stem, was))
        print(as_line("… S-curve", was, now), flush=True)


if __name__ == "__main__":
    main()
