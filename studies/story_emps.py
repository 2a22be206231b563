"""Story: a real axis, where rigid mass and viscous friction are not enough.

    python -m studies.story_emps --write      some 20 s; docs/STORY_EMPS.md and its figures

Needs the EMPS data set (see `ffcomp/diagnose/axis_problem.py`) in `../shared/data/emps`, or in `emps` of
$FFCOMP_DATA. Without
`--write` the page goes to standard output.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, filtfilt

from ffcomp.diagnose.axis_problem import FRICTION, MASS, OFFSET, SHOT_S, VISCOUS, AxisProblem, ForceDriven, read_emps
from ffcomp.diagnose.diagnosis import Diagnosis, diagnose
from studies.prose import filled

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data")) / "emps"
ESTIMATION, PULSES = DATA / "DATA_EMPS.mat", DATA / "DATA_EMPS_PULSES.mat"
PAGE = ROOT / "docs" / "STORY_EMPS.md"
FIGURES = {name: ROOT / "docs" / f"story_emps_{name}.png" for name in ("error", "force")}
GUESS = (50.0, 100.0)  # kg and N s/m: anything of the right order
PUBLISHED = {MASS: (95.11, "kg"), VISCOUS: (203.5, "N s/m"), FRICTION: (20.39, "N"), OFFSET: (-3.16, "N")}
NAMES = {MASS: "mass", VISCOUS: "viscous friction", FRICTION: "Coulomb friction", OFFSET: "offset of the force"}
BOTH = (ESTIMATION, PULSES)
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.relative_to(ROOT)} and its figures")
    found = diagnose(AxisProblem([read_emps(ESTIMATION)], *GUESS))
    fitted, fresh = (answer(path, found) for path in (ESTIMATION, PULSES))
    text = filled([*page(found, fitted, fresh), *about_pulses()])
    if not parser.parse_args().write:
        print(text)
        return
    PAGE.write_text(text, encoding="utf-8")
    draw_error(fitted, fresh, FIGURES["error"])
    draw_force(found, FIGURES["force"])


def answer(path: Path, found: Diagnosis) -> Answer:
    """Both plants begin anew at every shot, with the measured position and speed."""
    axis = AxisProblem([read_emps(path)], *GUESS)
    measured = np.concatenate([r.measured[:, 0] for r in axis.observations])
    before, after = (
        1e3 * (measured - np.concatenate([y[:, 0] for y in axis.simulate(values)]))
        for values in (found.base.values, found.final.values)
    )
    time = np.concatenate([run.time_s for run, _ in axis.stretches])
    shot = round(SHOT_S * axis.observations[0].rate_hz)
    return Answer(shot, time, np.concatenate([speed for _, speed in axis.stretches]), before, after)


# ---- the page ------------------------------------------------------------------------------------


def page(found: Diagnosis, fitted: Answer, fresh: Answer) -> Iterator[str]:
    names = " and ".join(f"`{name}`" for name in (found.named.names if found.named else ()))
    yield f"""# Story: a real axis and its friction

Made by `python -m studies.story_emps --write` (Python {platform.python_version()}).

EMPS is a linear axis on a ball screw: a motor's force goes in, a position comes out, 1000 times a second for 25 s
(A. Janot, M. Gautier and M. Brunot, Nonlinear System Identification Benchmarks, 2019). It is a real machine, not a
simulated one, and no printer: the same engine that diagnoses a printer gets another plant
(`ffcomp/diagnose/axis_problem.py`).
What it is told: a rigid mass with viscous friction, mass {GUESS[0]:g} kg and {GUESS[1]:g} N s/m to begin with, both of
which it may move as it likes.

## What it said

Verdict: **{names or found.verdict}**. Six effects were tried: dry friction, dry friction that is larger at rest,
viscous friction that is larger in one direction, a spring, a drag that grows with the speed's square, and a force that
repeats along the screw.

| | found | 90 % interval | published | found/published |
|---|---|---|---|---|"""
    for name, (published, unit) in PUBLISHED.items():
        e = found.intervals[name]
        yield (
            f"| {NAMES[name]}, {unit} | {e.value:.4g} | {e.low:.4g} to {e.high:.4g} | {published:g} "
            f"| {e.value / published:.3f} |"
        )
    base = found.base.values
    yield f"""
The published values come of another method (least squares on the force, with the position differentiated twice) on the
same recording; ours of simulating the position. The axis is not quite what either says: its publishers found later that
its viscous friction is not the same in both directions (166.7 one way, 240.4 N s/m the other). Our intervals know of
noise and of what the fit leaves, not of that: they {inside(found)}.

Without dry friction the fit does its best with what it has, and arrives at {base[MASS]:.3g} kg and
{base[VISCOUS]:.3g} N s/m.

## Does it hold where it was not fitted?

The simulation begins anew with the measured position and speed every {SHOT_S:g} s, and runs so long by the force alone.
Rms error of the position, µm:

| | mass and viscous friction | with dry friction | less by |
|---|---|---|---|"""
    yield row("the recording it was fitted to", rms(fitted.before_um), rms(fitted.after_um))
    yield row("a second recording, with pulses, never seen by the fit", rms(fresh.before_um), rms(fresh.after_um))
    yield """
In the first recording each stretch of 4 s was also left out of the fit in turn. What is left there, in units of the
noise (mean square, less one; nothing was repeated, so the noise is a guess from above 50 Hz, and here too large):

| left out from | before | after |
|---|---|---|"""
    yield from (f"| {place.position[0]:.0f} s | {place.before:.1f} | {place.after:.1f} |" for place in found.held_out)
    yield f"""
![error over time, and by the sign of the speed]({FIGURES["error"].name})

![force against speed]({FIGURES["force"].name})

The second picture is the friction itself: the measured force less mass times acceleration, against the speed. Viscous
friction alone is a straight line through the offset; what was measured lies on two, 40 N apart.
"""


def inside(found: Diagnosis) -> str:
    """Which published values the intervals hold, in words."""
    out = [NAMES[n] for n, (p, _) in PUBLISHED.items() if not found.intervals[n].low <= p <= found.intervals[n].high]
    return f"miss the published value of {', '.join(out)}" if out else "hold all published values"


def row(label: str, before: float, after: float) -> str:
    return f"| {label} | {before:.3g} | {after:.3g} | {before / after:.1f} times |"


def rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def about_pulses() -> Iterator[str]:
    alone, both = (diagnose(AxisProblem([read_emps(path) for path in paths], *GUESS)) for paths in ([PULSES], BOTH))
    wrong = diagnose(AxisProblem([twice_pushed(read_emps(PULSES))], *GUESS))
    worst = max(both.held_out, key=lambda p: p.after)
    inside_force, left_n = pulses_in_force()
    yield f"""## The recording with pulses

The second file is the same motion with a disturbance every half second, which it names `pulses_N`. The name invites to
add it to the force, and at first we did. Then a force of 5 N acts half of the time that nothing had felt. An earlier
version of the search explained it, from both files, with a force that repeats every 38 mm of the screw, beside dry
friction; today's says {said(wrong)} of this recording alone, with an offset of {wrong.final.values[OFFSET]:.2f} N
instead of {alone.final.values[OFFSET]:.2f} N. The mistake was in the reading, not in the axis: the pulses are volts
(5 V are {5 * GAIN_N_PER_V:.0f} N), and the motor's voltage, from which we take the force, has them in it already. It
jumps when they do, and a regression of that force on acceleration, speed, its sign, an offset and the pulses finds
{inside_force:+.2f} N for each unit of `pulses_N` (newtons missing in the force would come out as -1, volts as
{-GAIN_N_PER_V:.0f}); it leaves {left_n:.1f} N rms.

Read rightly, this recording alone gives {said(alone)}, and both together {said(both)}. With both, the stretch from
{worst.position[0]:.0f} s does worst: {left(worst.after)}. The publishers say that the pulses shake a flexibility of the
axis, which neither their model has nor ours.
"""


def twice_pushed(run: ForceDriven) -> ForceDriven:
    """As if the file's `pulses_N` were newtons beside the motor's."""
    return replace(run, force_n=run.force_n + pulses())


def pulses() -> FloatArray:
    """(n,) as the file has them."""
    from scipy.io import loadmat

    return np.asarray(loadmat(PULSES)["pulses_N"], dtype=float).ravel()


def left(excess: float) -> str:
    return "nothing above the noise is left there" if excess <= 0 else f"{excess:.1f} times the noise are left there"


def said(found: Diagnosis) -> str:
    if found.named is None:
        return f"`{found.verdict}` ({'; '.join(found.rejections)})"
    return f"{' and '.join(f'`{n}`' for n in found.named.names)}, {found.final.values[FRICTION]:.1f} N"


def pulses_in_force() -> tuple[float, float]:
    """N in the measured force for each unit of `pulses_N`, and what the regression leaves, N rms."""
    run = read_emps(PULSES)
    speed, acceleration = derivatives(run)
    columns = (acceleration, speed, np.tanh(1e3 * speed), np.ones_like(speed), pulses())
    a = np.column_stack([smooth(c, run.rate_hz) for c in columns])
    force = smooth(run.force_n, run.rate_hz)
    x, *_ = np.linalg.lstsq(a, force, rcond=None)
    return float(x[4]), rms(force - a @ x)


def smooth(x: FloatArray, rate_hz: float) -> FloatArray:
    """Low-passed, without delay."""
    return np.asarray(filtfilt(*butter(4, SMOOTH_HZ, fs=rate_hz), x))


def derivatives(run: ForceDriven) -> tuple[FloatArray, FloatArray]:
    """(n,) m/s and (n,) m/s² of the smoothed position."""
    speed = np.gradient(smooth(run.position_mm / 1e3, run.rate_hz), 1 / run.rate_hz)
    return speed, np.gradient(speed, 1 / run.rate_hz)


# ---- figures -------------------------------------------------------------------------------------


def draw_error(fitted: Answer, fresh: Answer, path: Path) -> None:
    """At the end of every shot over time, and all of it by the sign of the speed."""
    from matplotlib import pyplot

    figure, rows = pyplot.subplots(2, 2, figsize=(9, 5), width_ratios=(3, 1), sharey=True, layout="constrained")
    for (over_time, by_sign), found, title in zip(
        rows, (fitted, fresh), ("fitted to this", "with pulses, never seen"), strict=True
    ):
        ends = slice(found.shot - 1, None, found.shot)
        for error, colour, label in (
            (found.before_um, OLD, "mass and viscous friction"),
            (found.after_um, NEW, "with dry friction"),
        ):
            over_time.plot(
                found.time_s[ends], error[ends], ".-", color=colour, linewidth=0.7, markersize=3, label=label
            )
        over_time.set_ylabel(f"error after {SHOT_S:g} s, µm")
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


def draw_force(found: Diagnosis, path: Path) -> None:
    """What is left of the force when mass times acceleration is taken off, and both models' curves."""
    from matplotlib import pyplot

    run = read_emps(ESTIMATION)
    speed, acceleration = derivatives(run)
    around = maximum_filter1d(np.abs(acceleration), 2 * round(AROUND_S * run.rate_hz) + 1)
    steady = around < STEADY_M_PER_S2
    figure, axes = pyplot.subplots(figsize=(8, 4), layout="constrained")
    held = smooth(run.force_n, run.rate_hz) - found.final.values[MASS] * acceleration
    axes.plot(1e3 * speed[steady], held[steady], ".", color="0.45", markersize=2, label="measured, less M times a")
    v = np.linspace(-0.14, 0.14, 1001)
    for values, colour, label in (
        (found.base.values, OLD, "mass and viscous friction"),
        (found.final.values, NEW, "with dry friction"),
    ):
        force = values[VISCOUS] * v + values[OFFSET] + values.get(FRICTION, 0.0) * np.sign(v)
        axes.plot(1e3 * v, force, color=colour, linewidth=1.6, label=label)
    axes.set_xlabel("speed, mm/s")
    axes.set_ylabel("force, N")
    axes.set_title("where the axis moves steadily", fontsize=10)
    axes.legend(fontsize=8, loc="upper left")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
