"""Story: a printer whose machine file shares the effector's load as the source paper prints it.

    python -m studies.story_force_map --keep DIR    reports/story_force_map.md and its figures, some 10 minutes

The printer is built of bodies and joints in MuJoCo (`validation/plants/multibody.py`, needs the `mujoco` package):
none of our equations is in it. Runs, verdicts and machine files stay in DIR; what is there is not made again.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.measurement.recording import read_recording
from models.effects.catalogue import effective_machine
from models.file import load_machine
from models.machine import Machine, value_of
from studies.diagnosis_proof import (
    FILE_ERROR,
    FRESH,
    MEASURED,
    SAMPLE_HZ,
    SECONDS,
    Moved,
    kept,
    motions,
    owners_file,
    record,
)
from studies.render import REPORTS, save
from validation import judge
from validation.blind.printer.motions import Path as NozzlePath
from validation.blind.printer.real import Reading
from validation.plants.multibody import Choice, build, modes, play

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
FIGURES = {name: REPORTS / f"story_force_map_{name}.png" for name in ("gap", "overlay", "modes")}
COMMAND_HZ = 3200.0
HEIGHT_MM = 30.0  # at which modes are compared
CHOICES = {
    "half": Choice("lumped", "parallelograms", gravity=True),
    "rods": Choice("uniform", "parallelograms", gravity=True),
}
OLD, NEW = "#c0392b", "#2471a3"


def main() -> None:
    """Measure and diagnose, and write the results, the page and its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", required=True, metavar="DIR", help="where runs, verdicts and machine files are kept")
    folder = Path(parser.parse_args().keep)
    told = {arms: story(folder / arms, arms) for arms in CHOICES}
    save("story_force_map", about() | results(told))
    draw_gap(told["half"], FIGURES["gap"])
    draw_overlay(told["half"], FIGURES["overlay"])
    draw_modes(told["half"], FIGURES["modes"])


# ---- the printer, its runs, its owner's file -----------------------------------------------------


@dataclass(frozen=True)
class Told:
    """Everything that was made and said of one printer."""

    folder: Path
    arms: str
    verdict: dict[str, Any]
    before: dict[str, Any]  # gap on the runs of the diagnosis
    after: dict[str, Any]
    fresh_before: dict[str, Any]  # on fresh runs
    fresh_after: dict[str, Any]

    @property
    def owner(self) -> Path:
        return self.folder / "owner.toml"

    @property
    def better(self) -> Path:
        """The owner's own file again, if nothing better was found."""
        found = self.folder / "better.toml"
        return found if found.exists() else self.owner


def story(folder: Path, arms: str) -> Told:
    """Measure, diagnose, measure anew, compare."""
    truth = load_machine(judge.MACHINE_FILE)
    moved = measured_by(truth, CHOICES[arms])
    measured, fresh = record(folder / "runs", MEASURED, moved, 1), record(folder / "fresh", FRESH, moved, 2)
    owner, better = folder / "owner.toml", folder / "better.toml"
    owner.write_text(owners_file(truth, effector__force_map="paper"), encoding="utf-8")
    options = ("--machine", owner, "--output", better, "--json", "--quiet", "--force")
    verdict = kept(folder / "verdict.json", "diagnose", *measured, *options)
    new = better if better.exists() else owner
    gaps = {
        name: kept(folder / f"gap-{name}.json", "gap", *runs, "--machine", file, "--json")
        for name, runs, file in (
            ("before", measured, owner),
            ("after", measured, new),
            ("fresh_before", fresh, owner),
            ("fresh_after", fresh, new),
        )
    }
    return Told(folder, arms, verdict, **gaps)


def measured_by(machine: Machine, choice: Choice) -> Moved:
    def moved(path: NozzlePath) -> tuple[FloatArray, FloatArray, Reading]:
        rows = np.arange(round(SECONDS * COMMAND_HZ) + 1) / COMMAND_HZ
        command = machine.kinematics.inverse(path(rows))
        answer = play(machine, path(rows[:1])[0], command, 1 / COMMAND_HZ, choice)
        carriage, nozzle = (_acceleration(x, answer.t_s[1]) for x in (answer.carriage_mm, answer.nozzle_mm))
        every = round(COMMAND_HZ / SAMPLE_HZ)
        reading = Reading(answer.t_s, carriage, nozzle, answer.carriage_mm, answer.nozzle_mm)
        return rows[::every], command[::every], reading

    return moved


def _acceleration(moved_mm: FloatArray, step_s: float) -> FloatArray:
    """(n, 3) m/s², second differences; at rest at both ends."""
    inner = np.diff(moved_mm, 2, axis=0) / (1e3 * step_s**2)
    return np.vstack([np.zeros((1, 3)), inner, np.zeros((1, 3))])


# ---- the results ---------------------------------------------------------------------------------


def results(told: dict[str, Told]) -> dict[str, Any]:
    """Return what the page says of both printers, and of the modes of the first."""
    return {arms: result(each) for arms, each in told.items()} | {"modes": compared_modes(told["half"])}


def about() -> dict[str, Any]:
    """Return how everything is measured."""
    return {
        "mujoco": mujoco.__version__,
        "file_error": FILE_ERROR,
        "seconds": SECONDS,
        "motions": motions(),
        "fresh_place_mm": [round(x) for x in FRESH[0].place_mm],
    }


def result(told: Told) -> dict[str, Any]:
    """Return what the page says of one printer."""
    verdict, truth = told.verdict, load_machine(judge.MACHINE_FILE)
    return {
        "seconds": verdict["seconds"],
        "verdict": verdict["verdict"],
        "effects": [{key: effect[key] for key in ("name", "parameters")} for effect in verdict["effects"]],
        "nearest": verdict["refused"],
        "gap": {key: verdict["gap"][key] for key in ("before", "after", "noise", "held_out")},
        "retuned": [
            {"name": name, "owner": step["from"], "to": step["to"], "really": value_of(truth, name)}
            for name, step in verdict["retuned"].items()
        ],
        "fresh": gap_rows(told.fresh_before, told.fresh_after),
        "fresh_noise_times": told.fresh_after["nrms"] / told.fresh_after["noise_nrms"],
    }


def gap_rows(before: dict[str, Any], after: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the gap of all runs together, then of each."""
    runs = {"all": (before, after)}
    runs |= {name: (size, after["where"]["runs"][name]) for name, size in before["where"]["runs"].items()}
    return [
        {"run": name, "before": old["nrms"], "after": new["nrms"], "noise": old["noise_nrms"]}
        for name, (old, new) in runs.items()
    ]


def compared_modes(told: Told) -> dict[str, Any]:
    """Return the lowest modes in the middle, and how far off both files are at worst along a line."""
    at = line_of_places()
    theirs, old, new = (np.abs(x) / (2 * np.pi) for x in lowest_modes(told, at))
    wrong, right = (np.max(np.abs(x / theirs - 1), axis=0) for x in (old, new))
    middle = len(at) // 2
    return {
        "really_hz": theirs[middle],
        "owner_hz": old[middle],
        "better_hz": new[middle],
        "owner_off": wrong,
        "better_off": right,
    }


# ---- figures -------------------------------------------------------------------------------------


def line_of_places() -> FloatArray:
    """(n, 2) mm along y = 0."""
    x = np.linspace(-110.0, 110.0, 23)
    return np.column_stack([x, np.zeros_like(x)])


def lowest_modes(told: Told, places: FloatArray) -> list[FloatArray]:
    """|poles| (places, 3) 1/s of MuJoCo's printer, by the owner's file and by the better one; slowest first."""
    truth = load_machine(judge.MACHINE_FILE)
    choice = CHOICES[told.arms]
    theirs = [modes(build(truth, np.append(xy, HEIGHT_MM), choice))[:3] for xy in places]
    ours = [effective_machine(load_machine(file)).vibration.poles(places) for file in (told.owner, told.better)]
    return [np.abs(np.array(theirs)), *(np.array([_slowest(x) for x in found]) for found in ours)]


def _slowest(found: NDArray[np.complex128]) -> FloatArray:
    """(3,) 1/s"""
    return np.sort(np.abs(found[found.imag > 1.0]))[:3]


def draw_gap(told: Told, path: Path) -> None:
    from matplotlib import pyplot

    runs = {name: (a, b) for name, a, b in _runs(told)}
    figure, axes = pyplot.subplots(figsize=(8, 3.6), layout="constrained")
    at = np.arange(len(runs))
    axes.bar(at - 0.2, [100 * a["nrms"] for a, _ in runs.values()], 0.38, color=OLD, label="owner's file")
    axes.bar(at + 0.2, [100 * b["nrms"] for _, b in runs.values()], 0.38, color=NEW, label="better file")
    for k, (a, _) in zip(at, runs.values(), strict=True):
        axes.hlines(100 * a["noise_nrms"], k - 0.42, k + 0.42, "k", linewidth=1.5, label="" if k else "noise")
    axes.set_yscale("log")
    axes.set_ylim(0.1, 600)
    axes.set_ylabel("gap, % of the signals")
    axes.set_xticks(at, list(runs), fontsize=8)
    axes.axvspan(len(runs) - len(told.fresh_after["where"]["runs"]) - 0.5, len(runs) - 0.5, color="0.92", zorder=0)
    axes.set_title("Simulation against MuJoCo's printer; grey: fresh runs at another place", fontsize=10)
    axes.legend(ncols=3, fontsize=8, loc="upper left")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _runs(told: Told) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    for before, after in ((told.before, told.after), (told.fresh_before, told.fresh_after)):
        for name, size in before["where"]["runs"].items():
            yield "\n".join(name.removesuffix(".csv").split("-")), size, after["where"]["runs"][name]


def draw_overlay(told: Told, path: Path) -> None:
    from matplotlib import pyplot

    runs = [read_recording(sorted((told.folder / "fresh").glob("infill*.csv"))[0])]
    plants = [PrinterProblem(load_machine(file), runs, ()) for file in (told.owner, told.better)]
    old, new = (plant.simulate({})[0] for plant in plants)
    observation = plants[0].observations[0]
    figure, axes = pyplot.subplots(2, 1, figsize=(8, 4.6), sharex=True, layout="constrained")
    span = slice(round(1.0 * SAMPLE_HZ), round(1.35 * SAMPLE_HZ))
    for signal, label, ax in zip(("acc_x", "acc_A"), ("nozzle holder, x", "carriage A"), axes, strict=True):
        column = observation.signals.index(signal)
        t = runs[0].time_s[span]
        ax.plot(t, observation.measured[span, column], "k", linewidth=1.6, label="measured")
        ax.plot(t, old[span, column], color=OLD, linewidth=1.0, label="simulated, owner's file")
        ax.plot(t, new[span, column], "--", color=NEW, linewidth=1.2, label="simulated, better file")
        ax.set_ylabel(f"{label}\nm/s²")
    axes[0].legend(ncols=3, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 1.25))
    axes[1].set_xlabel("time, s")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def draw_modes(told: Told, path: Path) -> None:
    from matplotlib import pyplot

    places = line_of_places()
    theirs, old, new = (x / (2 * np.pi) for x in lowest_modes(told, places))
    figure, axes = pyplot.subplots(figsize=(8, 4), layout="constrained")
    for k in range(3):
        first = k == 0
        axes.plot(places[:, 0], old[:, k], color=OLD, label='owner\'s file (force_map = "paper")' if first else None)
        axes.plot(places[:, 0], new[:, k], color=NEW, label="better file" if first else None)
        axes.plot(places[:, 0], theirs[:, k], "ko", markersize=3.5, label="MuJoCo's printer" if first else None)
    axes.set_ylim(0)
    axes.set_xlabel("x along y = 0, mm")
    axes.set_ylabel("three lowest modes, Hz")
    axes.legend(fontsize=8, ncols=3, loc="lower center")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
