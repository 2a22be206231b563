"""Story: a real axis, where rigid mass and viscous friction are not enough.

    python -m studies.story_emps      docs/STORY_EMPS.md and its figures, some 20 s

Needs the EMPS data set (see `ffcomp/diagnose/axis_problem.py`) in `../shared/data/emps`, or in `emps` of $FFCOMP_DATA.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, filtfilt

from ffcomp.diagnose.diagnosis import Diagnosis, diagnose
from studies.emps_axis import FRICTION, MASS, OFFSET, SHOT_S, VISCOUS, AxisProblem, ForceDriven, read_emps
from studies.render import save

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data")) / "emps"
ESTIMATION, PULSES = DATA / "DATA_EMPS.mat", DATA / "DATA_EMPS_PULSES.mat"
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
    """Diagnose the axis, and write the results, the page and its figures."""
    found = diagnose(AxisProblem([read_emps(ESTIMATION)], *GUESS))
    fitted, fresh = (answer(path, found) for path in (ESTIMATION, PULSES))
    save("story_emps", results(found, fitted, fresh) | {"pulses": about_pulses()})
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
    time = np.concatenate([run.time_s for run, _ in axis.windows])
    shot = round(SHOT_S * axis.observations[0].rate_hz)
    return Answer(shot, time, np.concatenate([speed for _, speed in axis.windows]), before, after)


# ---- the results ---------------------------------------------------------------------------------


def results(found: Diagnosis, fitted: Answer, fresh: Answer) -> dict[str, Any]:
    """Return what the page says of the recording that was fitted, and of the one that was not."""
    intervals = {name: found.intervals[name] for name in PUBLISHED}
    return {
        "guess": dict(zip(("mass_kg", "viscous_n_s_per_m"), GUESS, strict=True)),
        "verdict": said(found),
        "parameters": [
            {
                "label": NAMES[name],
                "unit": unit,
                "found": intervals[name].value,
                "low": intervals[name].low,
                "high": intervals[name].high,
                "published": published,
                "ratio": intervals[name].value / published,
            }
            for name, (published, unit) in PUBLISHED.items()
        ],
        "missed": [NAMES[n] for n, (p, _) in PUBLISHED.items() if not intervals[n].low <= p <= intervals[n].high],
        "without": {"mass_kg": found.base.values[MASS], "viscous_n_s_per_m": found.base.values[VISCOUS]},
        "shot_s": SHOT_S,
        "errors": [
            row("the recording it was fitted to", fitted),
            row("a second recording, with pulses, never seen by the fit", fresh),
        ],
        "left_out": [{"from_s": p.position[0], "before": p.before, "after": p.after} for p in found.held_out],
    }


def row(label: str, found: Answer) -> dict[str, Any]:
    before, after = rms(found.before_um), rms(found.after_um)
    return {"label": label, "before_um": before, "after_um": after, "times": before / after}


def rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def about_pulses() -> dict[str, Any]:
    """Diagnose the recording with pulses: with them added to the force, alone, and together with the other one."""
    alone, both = (diagnose(AxisProblem([read_emps(path) for path in paths], *GUESS)) for paths in ([PULSES], BOTH))
    wrong = diagnose(AxisProblem([twice_pushed(read_emps(PULSES))], *GUESS))
    worst = max(both.held_out, key=lambda p: p.after)
    inside_force, left_n = pulses_in_force()
    return {
        "added": said(wrong),
        "added_offset_n": wrong.final.values[OFFSET],
        "offset_n": alone.final.values[OFFSET],
        "gain_n_per_v": GAIN_N_PER_V,
        "force_for_each": inside_force,
        "regression_leaves_n": left_n,
        "alone": said(alone),
        "both": said(both),
        "worst_from_s": worst.position[0],
        "worst_after": worst.after,
    }


def twice_pushed(run: ForceDriven) -> ForceDriven:
    """As if the file's `pulses_N` were newtons beside the motor's."""
    return replace(run, force_n=run.force_n + pulses())


def pulses() -> FloatArray:
    """(n,) as the file has them."""
    from scipy.io import loadmat

    return np.asarray(loadmat(PULSES)["pulses_N"], dtype=float).ravel()


def said(found: Diagnosis) -> dict[str, Any]:
    """Return what a diagnosis named, or why it named nothing."""
    return {
        "names": found.named.names if found.named else (),
        "verdict": found.verdict,
        "rejections": found.rejections,
        "friction_n": found.final.values.get(FRICTION),
    }


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
