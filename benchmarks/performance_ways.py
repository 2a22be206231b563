"""Every way to a command, side by side: what it costs, and what it is worth."""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one core: said before numpy and scipy start their threads
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.performance_methods import SAMPLE_S, ZERO_PHASE, dense, knots, whole_run, zero_phase
from ffcomp.comparison import methods as ways
from ffcomp.comparison.baselines import LinearPrinter
from ffcomp.comparison.evaluation import Execution, evaluate, track
from ffcomp.comparison.methods import COMPENSATED, ONE_MODEL, TunedMethod
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.compensation.solve import solutions
from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings, settings_for
from ffcomp.inverse.solve import solve
from ffcomp.simulation.playback import simulate_nozzles
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
MACHINE = "mp-delta-pro"
PRINTS = ("ringing_tower", "lobed_vase", "far_star")
SHAPERS = ("zv", "mzv", "ei", "2hump_ei", "3hump_ei")
DENSE = "dense"
PIECE_S, TOGETHER_S = 10.0, 30.0
DENSE_S = (2.0, 3.0)  # how long the path of the dense formulation is
LABELS = {
    COMPENSATED: "**ours**",
    ONE_MODEL: "FBS, one model",
    ZERO_PHASE: "zero-phase-error tracking, scheduled",
}


@dataclass(frozen=True, eq=False)
class Method:
    """A way, and the computing of its commands alone."""

    way: TunedMethod
    command: Callable[[PrintSlice], int]  # how many knots it had

    def commands(self, stretches: Sequence[PrintSlice]) -> int:
        """How many knots the commands of all stretches had."""
        return sum(map(self.command, stretches))


@dataclass(frozen=True, slots=True)
class Row:
    """One method on one print."""

    name: str
    label: str
    tuning: str
    us_per_segment: float
    print_s_per_s: float
    tracking_um: float
    tracking_no_delay_um: float
    contour_um: float
    peak_m_per_s2: float


def sample_print(name: str, machine: Machine) -> Print:
    path = ROOT / "sample_prints" / f"{name}.gcode"
    return Print(path.read_bytes(), path.name, machine)


# ---- side by side --------------------------------------------------------------------------------


def side_by_side(rounds: int, seconds: float, names: Sequence[str] = PRINTS) -> dict[str, Any]:
    """A table for each print: rows, and what was looked at."""
    machine = load_machine(MACHINE)
    return {name: table(name, machine, rounds, seconds) for name in names}


def table(name: str, machine: Machine, rounds: int, seconds: float) -> dict[str, Any]:
    printed = sample_print(name, machine)
    stretches, told = printed.slices(Sampling(), min(PIECE_S, seconds), seconds)
    methods = every_method(machine, stretches)
    times = least({m.way.name: partial(m.commands, stretches) for m in methods}, rounds)
    lasting = sum(each.motion.end_t - each.motion.begin_t for each in stretches)
    rows = [row(m.way, stretches, machine, *times[m.way.name], lasting) for m in methods]
    return {"told": told, "rows": [asdict(each) for each in rows], DENSE: dense_row(printed.planned, machine)}


def every_method(machine: Machine, stretches: Sequence[PrintSlice]) -> list[Method]:
    usual = settings_for(machine)
    linear = LinearPrinter(machine, stretches)
    found = [
        inverting(machine, usual, COMPENSATED),
        inverting(machine, usual, ONE_MODEL),
        sampling(zero_phase(machine)),
    ]
    for kind in SHAPERS:
        found.append(sampling(ways.best_fixed(linear, kind)))
    return found


def inverting(machine: Machine, settings: Settings, name: str) -> Method:
    """Filtered B-splines: every run of a stretch, with all that an inverse keeps already worked out."""
    way = replace(ways.inversion(machine, settings, name), label=LABELS[name])
    inverter = InverseModel(machine, replace(settings, one_model=name == ONE_MODEL))
    return Method(way, lambda stretch: solved_knots(stretch.planned, inverter))


def solved(planned: PlannedProgram, inverter: InverseModel, keep: bool = False) -> Iterator[SolvedSection]:
    return solutions(planned, inverter, keep_responses=keep)


def solved_knots(planned: PlannedProgram, inverter: InverseModel) -> int:
    """How many knots the command of all runs has."""
    return sum(each.reference.knots for each in solved(planned, inverter))


def sampling(way: TunedMethod) -> Method:
    """Methods that know no runs: the nozzle command at all knots."""

    def command(stretch: PrintSlice) -> int:
        return len(way.motion(stretch)[0].position(knots(stretch)))

    return Method(way, command)


def least(works: dict[str, Callable[[], int]], rounds: int) -> dict[str, tuple[int, float]]:
    """What each returns, and its shortest CPU time, s. One after the other in every round, after one that is not kept:
    so the load of other jobs is shared alike."""
    for work in works.values():
        work()
    found = dict.fromkeys(works, (0, np.inf))
    for _ in range(rounds):
        for name, work in works.items():
            began = time.process_time()
            answer = work()
            found[name] = (answer, min(found[name][1], time.process_time() - began))
    return found


def row(
    way: TunedMethod, stretches: Sequence[PrintSlice], machine: Machine, count: int, cpu_s: float, lasting: float
) -> Row:
    played, peak = [], 0.0
    for stretch in stretches:
        motion, _ = way.motion(stretch)
        t, (nozzle,) = simulate_nozzles([machine], motion, machine)
        played.append(Execution(stretch, motion, t, nozzle))
        peak = max(peak, motion.peaks(machine)[1])
    judged = evaluate(played)
    found = track(judged, np.ones(len(judged.samples.due), dtype=np.bool_), lasting, peak)
    return Row(
        way.name,
        way.label,
        way.tuning,
        1e6 * cpu_s / count,
        lasting / cpu_s,
        found.tracking_rms_um,
        found.tracking_rms_no_delay_um,
        found.contour_rms_um,
        peak / 1e3,
    )


def dense_row(planned: PlannedProgram, machine: Machine) -> dict[str, float] | None:
    """The dense formulation and ours on one run, each corrected twice; None if no run is of that length."""
    runs = [r for r in planned.sections if r.travels and DENSE_S[0] <= r.end_t - r.begin_t <= DENSE_S[1]]
    if not runs:
        return None
    ours = InverseModel(machine, replace(settings_for(machine), corrections=2))
    start = whole_run(planned, runs[0], ours)
    reference, state = start.iterate.reference, start.state
    command = solve(ours, reference, state).vertices
    knots_n, ours_s = least({COMPENSATED: lambda: len(solve(ours, reference, state).vertices) - 1}, 5)[COMPENSATED]
    began = time.process_time()
    wanted = dense(start)
    seconds = time.process_time() - began
    return {
        "run_s": runs[0].end_t - runs[0].begin_t,
        "unknowns": 3.0 * (knots_n - 1),
        "dense_us": 1e6 * seconds / knots_n,
        "ours_us": 1e6 * ours_s / knots_n,
        "dense_to_ours_um": 1e3 * float(np.abs(wanted - command).max()),
    }


# ---- against the place on the bed ----------------------------------------------------------------


def over_the_bed(radii_mm: Sequence[float], rounds: int, seconds: float) -> dict[str, Any]:
    """The same pattern at growing radius: what a segment costs."""
    machine = load_machine(MACHINE)
    ours = InverseModel(machine, settings_for(machine))
    plans = {r: plan_program(read_program(pattern(r, seconds), "pattern"), machine) for r in radii_mm}
    found = least({f"{radius:g}": partial(solved_knots, plan, ours) for radius, plan in plans.items()}, rounds)
    return {
        "radius_mm": list(radii_mm),
        "print_s": [plan.trajectory.end_t for plan in plans.values()],
        "ours_us": [1e6 * cpu_s / count for count, cpu_s in found.values()],
    }


def pattern(radius_mm: float, seconds: float) -> bytes:
    """Rings and zigzags some 15 mm across, printed again and again about a place, with a retraction after each."""
    angle = np.radians(20.0)  # towards no tower, and between none
    centre = radius_mm * np.array([np.cos(angle), np.sin(angle)])
    turn = np.linspace(0.0, 2 * np.pi, 49)
    ring = 7.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    zigzag = np.stack([np.repeat(np.linspace(-5, 5, 11), 2), np.tile([-5.0, 5.0, 5.0, -5.0], 6)[:22]], axis=1)
    places = centre + np.concatenate([ring, zigzag])
    layer = b"".join(b"G1 X%.3f Y%.3f E.05\n" % (x, y) for x, y in places)
    once = b"G1 E-1 F3000\nG1 X%.3f Y%.3f F9000\nG1 E1 F3000\nG1 F6000\n" % tuple(places[0]) + layer
    head = b"M83\nSET_VELOCITY_LIMIT ACCEL=3000\nG28\nG1 Z5 F6000\n"
    return head + once * max(1, round(seconds / LAYER_S))


LAYER_S = 3.6  # about what one ring with its zigzag takes
assert Settings().segment_s == SAMPLE_S, "What is compared has knots equally far apart."
