"""Story: a real axis, where rigid mass and viscous friction are not enough.

    python -m studies.story_emps [--keep FOLDER] [--only EFFECT ...]    reports/story_emps.md, some 2 min

Needs the EMPS data set in `../shared/data/emps`, or in `emps` of $FFCOMP_DATA; `studies/measured_axes.py` makes a
machine file and two runs of it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.optimize import least_squares
from scipy.signal import butter, filtfilt

from ffcomp.diagnosis.axis_problem import OFFSET, AxisProblem
from ffcomp.diagnosis.diagnosis import Diagnosis, diagnose
from ffcomp.identification.axis_shots import Shots, shots_of
from ffcomp.measurement.axis_run import AxisRun, read_axis_run
from models.effects.catalogue import CATALOGUE
from models.file import load_plant
from models.kinds import driven_axis, is_one_axis
from models.machine import Machine
from models.printer.one_axis import simulate_axis
from studies.measured_axes import DATA, EMPS_FILES, emps
from studies.render import REPORTS, save

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
FIGURES = {name: REPORTS / f"story_emps_{name}.png" for name in ("error", "force")}
MASS, VISCOUS = "axis.mass_kg", "axis.damping_n_s_per_m"
FRICTION = "effects.coulomb_friction.force_n"
DIRECTION = "effects.friction_by_direction.damping_difference_n_s_per_m"
PUBLISHED = {
    MASS: (95.11, "kg"),
    VISCOUS: (203.5, "N s/m"),
    FRICTION: (20.39, "N"),
    DIRECTION: (166.7 - 240.4, "N s/m"),
}
NAMES = {
    MASS: "mass",
    VISCOUS: "viscous friction",
    FRICTION: "Coulomb friction",
    DIRECTION: "viscous friction forwards less backwards",
}
HORIZON_S, SKIPPED = 0.1, 20  # of the short score; samples that the benchmark's own score leaves out
GAIN_N_PER_V = 35.15  # of the motor, as the files have it
SMOOTH_HZ = 40.0  # low-pass of the regression and of the picture of the force
STEADY_M_PER_S2, AROUND_S = 0.5, 0.03  # slower than that, and so long before and after: where forces are steady
STILL_MM_PER_S = 1.0
OLD, NEW = "#c0392b", "#2471a3"


@dataclass(frozen=True, eq=False)
class Answer:
    """One recording, and how far off each plant's position is."""

    shot: int  # samples until both simulations begin anew
    time_s: FloatArray  # (n,)
    speed: FloatArray  # (n,) mm/s
    before_um: FloatArray  # (n,) measured − simulated with mass and viscous friction alone
    after_um: FloatArray  # (n,) with what was found


def main() -> None:
    """Diagnose the axis, and write the results, the page and its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", metavar="FOLDER", type=Path, help="keep machine file and runs here")
    parser.add_argument("--only", metavar="EFFECT", nargs="+", default=tuple(CATALOGUE), help="look for these only")
    given = parser.parse_args()
    folder = given.keep or Path(mkdtemp())
    file, *paths = emps(folder)
    machine, runs = load_plant(file), [read_axis_run(path) for path in paths]
    assert is_one_axis(machine)
    problem = AxisProblem(machine, runs[:1], given.only)
    found = diagnose(problem)
    before, after = (problem.machine_with(fitted.values) for fitted in (found.base, found.final))
    numbers = [name for name in (MASS, VISCOUS, OFFSET, FRICTION, DIRECTION) if name in found.final.values]
    run_free = free_run_fit(problem, found.final.values, numbers, runs[0])
    answers = [answer(run, before, after) for run in runs]
    told = results(problem, found, answers) | {"limit": friction_that_differs(problem, run_free, runs[1])}
    told |= {"free": free_scores(runs, before, after, problem.machine_with(run_free))}
    told |= {"both": given_both(AxisProblem(machine, runs, given.only), runs)}
    save("story_emps", told | {"pulses": about_pulses(runs[1])})
    draw_error(answers, FIGURES["error"])
    draw_force(found, runs[0], FIGURES["force"])


def begun_every(run: AxisRun, machine: Machine, seconds: float) -> Shots:
    """Return the run with a simulation that begins anew so often, with the measured position and speed."""
    (one,) = shots_of(machine, [run])
    length = round(seconds * run.sample_rate_hz)
    at = np.arange(0, len(run.drive), length)
    return Shots(run, length, states(run.position["pos_q"][at], one.speed[at]), one.speed)


def states(place: FloatArray, speed: FloatArray) -> FloatArray:
    """Return (n, 4) states to begin at: there is one mass only."""
    return np.column_stack([place, speed, place, speed])


def answer(run: AxisRun, before: Machine, after: Machine) -> Answer:
    """Both plants begin anew at every shot."""
    one, measured = begun_every(run, before, HORIZON_S), run.position["pos_q"]
    errors = [1e3 * (measured - one.simulate(m).position_mm) for m in (before, after)]
    return Answer(one.length, run.time_s, one.speed, *errors)


def free_run(run: AxisRun, machine: Machine) -> FloatArray:
    """Return the error, (n,) mm, of the benchmark's own score: one simulation from the 21st sample to the end."""
    (one,) = shots_of(machine, [run])
    place, rest = run.position["pos_q"][SKIPPED:], run.drive[SKIPPED:]
    begin = states(place[:1], one.speed[SKIPPED : SKIPPED + 1])
    return place - simulate_axis(machine, rest, 1 / run.sample_rate_hz, begin=begin).position_mm


def free_run_fit(
    problem: AxisProblem, values: Mapping[str, float], names: Sequence[str], run: AxisRun
) -> dict[str, float]:
    """Return the values, those of these names fitted to the free run of a recording."""
    start = np.array([values[name] for name in names])

    def error(x: FloatArray) -> FloatArray:
        return free_run(run, problem.machine_with({**values, **dict(zip(names, x.tolist(), strict=True))}))[::5]

    fitted = least_squares(error, start, x_scale=np.abs(start) + 1, diff_step=1e-4)
    return {**values, **dict(zip(names, fitted.x.tolist(), strict=True))}


def friction_that_differs(problem: AxisProblem, values: Mapping[str, float], run: AxisRun) -> dict[str, float]:
    """Fit dry friction alone to a recording that was not fitted: how well can a free run be foretold?"""
    own = free_run_fit(problem, values, [FRICTION], run)
    left = rms(free_run(run, problem.machine_with(own)))
    return {"friction_n": values[FRICTION], "own_friction_n": own[FRICTION], "pulses_mm": left}


# ---- the results ---------------------------------------------------------------------------------


def results(problem: AxisProblem, found: Diagnosis, answers: list[Answer]) -> dict[str, Any]:
    """Return what the page says of the recording that was fitted, and of the one that was not."""
    intervals = {name: found.intervals[name] for name in PUBLISHED if name in found.intervals}
    labels = ("the recording it was fitted to", "a second recording, with pulses, never seen by the fit")
    axis = driven_axis(problem.machine)
    return {
        "guess": {"mass_kg": axis.mass_kg, "viscous_n_s_per_m": axis.damping_n_s_per_m},
        "tried": [candidate.name for candidate in problem.candidates],
        "verdict": said(found),
        "parameters": [parameter(name, e.value, e.low, e.high) for name, e in intervals.items()],
        "missed": [NAMES[n] for n, e in intervals.items() if not e.low <= PUBLISHED[n][0] <= e.high],
        "without": {"mass_kg": found.base.values[MASS], "viscous_n_s_per_m": found.base.values[VISCOUS]},
        "shot_s": problem.shots[0].length / problem.shots[0].run.sample_rate_hz,
        "horizon_s": HORIZON_S,
        "errors": [row(label, each) for label, each in zip(labels, answers, strict=True)],
        "left_out": [{"from_s": p.position[0], "before": p.before, "after": p.after} for p in found.held_out],
    }


def parameter(name: str, value: float, low: float, high: float) -> dict[str, Any]:
    published, unit = PUBLISHED[name]
    told = {"label": NAMES[name], "unit": unit, "found": value, "low": low, "high": high}
    return told | {"published": published, "ratio": value / published}


def row(label: str, found: Answer) -> dict[str, Any]:
    before, after = rms(found.before_um), rms(found.after_um)
    return {"label": label, "before_um": before, "after_um": after, "times": before / after}


def free_scores(runs: list[AxisRun], *machines: Machine) -> list[dict[str, Any]]:
    """Return the benchmark's own score of each plant on both recordings."""
    labels = ("mass and viscous friction", "with what was found", "the same, its numbers fitted to the free run")
    return [
        {"label": label, "plain_mm": rms(free_run(runs[0], m)), "pulses_mm": rms(free_run(runs[1], m))}
        for label, m in zip(labels, machines, strict=True)
    ]


def given_both(problem: AxisProblem, runs: list[AxisRun]) -> dict[str, Any]:
    """Return what a diagnosis of both recordings says of the one with pulses, and the free runs of its one file."""
    found = diagnose(problem)
    machine, pulses = problem.machine_with(found.final.values), found.others[1]
    return {
        "effects": [] if found.named is None else list(found.named.names),
        "free_mm": [rms(free_run(run, machine)) for run in runs],
        "number": pulses.number.removeprefix("effects."),
        "changed": pulses.changed,
        "after": pulses.after,
        "refitted": pulses.refitted,
    }


def rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def about_pulses(run: AxisRun) -> dict[str, Any]:
    """Return what is in the force of the recording with pulses."""
    inside_force, left_n = pulses_in_force(run)
    return {
        "gain_n_per_v": GAIN_N_PER_V,
        "force_for_each": inside_force,
        "regression_leaves_n": left_n,
    }


def pulses() -> FloatArray:
    """(n,) as the file has them."""
    from scipy.io import loadmat

    return np.asarray(loadmat(DATA / "emps" / EMPS_FILES["pulses"])["pulses_N"], dtype=float).ravel()


def said(found: Diagnosis) -> dict[str, Any]:
    """Return what a diagnosis named, or why it named nothing."""
    return {
        "names": found.named.names if found.named else (),
        "verdict": found.verdict,
        "rejections": found.rejections,
        "friction_n": found.final.values.get(FRICTION),
    }


def pulses_in_force(run: AxisRun) -> tuple[float, float]:
    """N in the measured force for each unit of `pulses_N`, and what the regression leaves, N rms."""
    speed, acceleration = derivatives(run)
    columns = (acceleration, speed, np.tanh(1e3 * speed), np.ones_like(speed), pulses())
    a = np.column_stack([smooth(c, run.sample_rate_hz) for c in columns])
    force = smooth(run.drive, run.sample_rate_hz)
    x, *_ = np.linalg.lstsq(a, force, rcond=None)
    return float(x[4]), rms(force - a @ x)


def smooth(x: FloatArray, rate_hz: float) -> FloatArray:
    """Low-passed, without delay."""
    return np.asarray(filtfilt(*butter(4, SMOOTH_HZ, fs=rate_hz), x))


def derivatives(run: AxisRun) -> tuple[FloatArray, FloatArray]:
    """(n,) m/s and (n,) m/s² of the smoothed position."""
    speed = np.gradient(smooth(run.position["pos_q"] / 1e3, run.sample_rate_hz), 1 / run.sample_rate_hz)
    return speed, np.gradient(speed, 1 / run.sample_rate_hz)


# ---- figures -------------------------------------------------------------------------------------


def draw_error(answers: Sequence[Answer], path: Path) -> None:
    """At the end of every shot over time, and all of it by the sign of the speed."""
    from matplotlib import pyplot

    figure, rows = pyplot.subplots(2, 2, figsize=(9, 5), width_ratios=(3, 1), sharey=True, layout="constrained")
    for (over_time, by_sign), found, title in zip(
        rows, answers, ("fitted to this", "with pulses, never seen"), strict=True
    ):
        ends = slice(found.shot - 1, None, found.shot)
        for error, colour, label in (
            (found.before_um, OLD, "mass and viscous friction"),
            (found.after_um, NEW, "with what was found"),
        ):
            over_time.plot(
                found.time_s[ends], error[ends], ".-", color=colour, linewidth=0.7, markersize=3, label=label
            )
        over_time.set_ylabel(f"error after {HORIZON_S:g} s, µm")
        over_time.set_title(title, fontsize=10)
        moving = [found.speed < -STILL_MM_PER_S, found.speed > STILL_MM_PER_S]
        for offset, error, colour in ((-0.18, found.before_um, OLD), (0.18, found.after_um, NEW)):
            boxes = by_sign.boxplot(
                [error[m] for m in moving], positions=np.arange(2) + offset, widths=0.3, whis=(5, 95), showfliers=False
            )
            for part in (*boxes["boxes"], *boxes["whiskers"], *boxes["medians"], *boxes["caps"]):
                part.set_color(colour)
        by_sign.set_xticks([0, 1], ["moving −", "moving +"])
    rows[0, 0].legend(fontsize=8, loc="lower left", ncols=2)
    rows[1, 0].set_xlabel("time, s")
    rows[1, 1].set_xlabel("box: half, whiskers: 90 %", fontsize=8)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def draw_force(found: Diagnosis, run: AxisRun, path: Path) -> None:
    """What is left of the force when mass times acceleration is taken off, and both models' curves."""
    from matplotlib import pyplot

    speed, acceleration = derivatives(run)
    around = maximum_filter1d(np.abs(acceleration), 2 * round(AROUND_S * run.sample_rate_hz) + 1)
    steady = around < STEADY_M_PER_S2
    figure, axes = pyplot.subplots(figsize=(8, 4), layout="constrained")
    held = smooth(run.drive, run.sample_rate_hz) - found.final.values[MASS] * acceleration
    axes.plot(1e3 * speed[steady], held[steady], ".", color="0.45", markersize=2, label="measured, less M times a")
    v = np.linspace(-0.14, 0.14, 1001)
    for values, colour, label in (
        (found.base.values, OLD, "mass and viscous friction"),
        (found.final.values, NEW, "with what was found"),
    ):
        force = values[VISCOUS] * v - values.get(OFFSET, 0.0) + values.get(FRICTION, 0.0) * np.sign(v)
        force += 0.5 * values.get(DIRECTION, 0.0) * np.abs(v)
        axes.plot(1e3 * v, force, color=colour, linewidth=1.6, label=label)
    axes.set_xlabel("speed, mm/s")
    axes.set_ylabel("force, N")
    axes.set_title("where the axis moves steadily", fontsize=10)
    axes.legend(fontsize=8, loc="upper left")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
