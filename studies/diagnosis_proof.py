"""The last proof of a diagnosis: does the print get better on the printer that hides the effect?

    python -m studies.diagnosis_proof --keep DIR      studies/reports/diagnosis_proof.md and its figure, some 15 minutes

Effects are hidden in the independent printer of `validation/blind`, which is measured, diagnosed through the command
line, and then prints: with the owner's file, with the better one, with one that is right in everything, and with one
into which a wrong effect was forced. Runs, verdicts and machine files stay in DIR; what is there is not made again.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, inversion, none
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import better_file, result_of
from ffcomp.inverse.settings import settings_for
from ffcomp.measurement.recording import read_recording
from ffcomp.simulation.expectation import draw_plants
from models.file import load_machine, updated_text
from models.machine import Machine, value_of
from models.printer.rest import static_deflection
from studies.diagnosis import ffcomp
from studies.render import REPORTS, save
from validation import judge
from validation.blind.delta.hidden import EFFECTS
from validation.blind.delta.numbers import carriages_of
from validation.blind.delta.real import played
from validation.blind.printer.motions import KINDS, Motion, Place
from validation.blind.printer.motions import Path as NozzlePath
from validation.blind.printer.real import Reading, Real
from validation.blind.sensors import columns_of, commands_of, csv_of, draw_sensors

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
FIGURE = REPORTS / "diagnosis_proof.png"
PRINT, LAYERS, PRINTED_S = ROOT / "sample_prints" / "ringing_tower.gcode", Sampling(4, 7), 20.0
SAMPLE_HZ, SECONDS = 1600.0, 3.0
FILE_ERROR = 0.02  # standard deviation of every dynamic number of the owner's file, and what it says of itself
OF_A_PLACE = re.compile(r"left out of the fit, (\d+) % are left")
KEPT_EVERY = 4  # of the 6400 samples a second that the printer gives: what is judged

# What is hidden, the seed of its size and shape, and the wrong effects that are then forced upon its runs.
HIDDEN = {
    "effector_mass": (5, ("belt_stiffness", "coulomb_friction")),
    "belt_stiffness": (1, ("guide_damping",)),
    "extruder_mount": (2, ("effector_mass",)),
    "guide_damping": (4, ("command_delay",)),
    "command_delay": (2, ("sensor_gain",)),
    "coulomb_friction": (4, ("guide_damping",)),
}


@dataclass(frozen=True)
class Experiment:
    """One motion at one place, made once or several times."""

    kind: str
    where: str
    place_mm: Place
    loudness: float = 1.0
    times: int = 1

    @property
    def name(self) -> str:
        return f"{self.kind}-{self.where}"


MEASURED = (
    Experiment("multisine", "centre", (0.0, 0.0, 30.0), 1.0, 2),
    Experiment("multisine", "right", (70.0, 40.0, 30.0), 1.4),
    Experiment("steps", "left", (-60.0, 60.0, 60.0)),
    Experiment("slow", "left", (-60.0, 60.0, 60.0)),
    Experiment("infill", "front", (0.0, -80.0, 20.0), 1.0, 2),
)
FRESH = (
    Experiment("multisine", "fresh", (-70.0, -45.0, 40.0), 1.2, 2),
    Experiment("infill", "fresh", (-70.0, -45.0, 40.0)),
)


def main() -> None:
    """Hide, measure, diagnose and print, and write the results and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", required=True, metavar="DIR", help="where runs, verdicts and machine files are kept")
    keep = Path(parser.parse_args().keep)
    found = [proof(keep / name, name) for name in HIDDEN]
    save("diagnosis_proof", about() | results(found))
    draw(found, FIGURE)


# ---- runs and files, also of other stories -------------------------------------------------------


Moved = Callable[[NozzlePath], tuple[FloatArray, FloatArray, Reading]]


def record(
    folder: Path, experiments: Sequence[Experiment], moved: Moved, seed: int, seconds: float = SECONDS
) -> list[Path]:
    """Every experiment as run files; repeats are numbered.

    moved : of a nozzle path the sample times (n,) s, the carriages' command there (n, 3) mm, and perfect readings
    """
    folder.mkdir(parents=True, exist_ok=True)
    sensors = draw_sensors(np.random.default_rng(11), "all", SAMPLE_HZ)
    found = []
    for k, experiment in enumerate(experiments):
        rng = np.random.default_rng([seed, k])
        paths = [folder / f"{experiment.name}-{n + 1}.csv" for n in range(experiment.times)]
        found += paths
        if all(path.exists() for path in paths):
            continue
        nozzle = KINDS[experiment.kind](rng, experiment.place_mm, seconds, experiment.loudness)
        t, command, reading = moved(nozzle)
        for path in paths:
            path.write_text(
                csv_of(t, commands_of(command, "ABC"), columns_of(sensors.record(reading, rng))), encoding="utf-8"
            )
    return found


def kept(path: Path, *arguments: str | Path) -> dict[str, Any]:
    """The command line's answer, asked for once."""
    if not path.exists():
        answer = ffcomp(*arguments)
        path.write_text(json.dumps(answer, indent=1), encoding="utf-8")
        print(path, file=sys.stderr, flush=True)
    return dict(json.loads(path.read_text(encoding="utf-8")))


def owners_file(truth: Machine, **changed: Any) -> str:
    """Every dynamic number a little off, and what is changed on purpose."""
    off = draw_plants(truth, FILE_ERROR, 1)[0]
    values: dict[str, Any] = {name: float(f"{value_of(off, name):.6g}") for name in truth.vibration.parameters().names}
    values |= {name.replace("__", "."): value for name, value in changed.items()}
    return updated_text(judge.MACHINE_FILE, values, name="owner's printer", uncertainty={"default": FILE_ERROR})


# ---- one hidden effect ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Wrong:
    """What came of a diagnosis that knew one effect only, the wrong one."""

    name: str
    verdict: str
    refused: tuple[str, ...]
    table: dict[str, Any]  # what the fit made of it
    gap_before: float  # of the runs it was fitted to
    gap_after: float


@dataclass(frozen=True)
class Proof:
    """Everything that was said of one printer, and how it prints with each file: contour rms, µm."""

    hidden: str
    table: dict[str, Any]  # as a machine file would have to say it
    verdict: dict[str, Any]
    fresh: tuple[float, float, float]  # gap on fresh runs before and after, and noise
    wrong: tuple[Wrong, ...]
    contour_um: dict[str, float]  # by file: none, owner, better, perfect, wrong-NAME


def proof(folder: Path, name: str) -> Proof:
    """Hide, measure, diagnose, print."""
    seed, wrong_names = HIDDEN[name]
    table, real = hidden(name, seed)
    moved = measured_by(real, real.machine["kinematics"])
    runs = record(folder / "runs", MEASURED, moved, 1)
    fresh = record(folder / "fresh", FRESH, moved, 2)
    files = {kind: folder / f"{kind}.toml" for kind in ("owner", "better", "perfect")}
    files["owner"].write_text(owners_file(load_machine(judge.MACHINE_FILE)), encoding="utf-8")
    true = {f"effects.{name}.{key}": value for key, value in table.items()}
    files["perfect"].write_text(updated_text(judge.MACHINE_FILE, true, name="perfect"), encoding="utf-8")
    options = ("--machine", files["owner"], "--output", files["better"], "--json", "--quiet", "--force")
    verdict = kept(folder / "verdict.json", "diagnose", *runs, *options)
    if not files["better"].exists():
        files.pop("better")
    wrong = tuple(forced(folder, files["owner"], runs, wrong_name) for wrong_name in wrong_names)
    files |= {f"wrong-{w.name}": folder / f"wrong-{w.name}.toml" for w in wrong}
    return Proof(
        name,
        table,
        verdict,
        fresh_gap(folder, fresh, files),
        wrong,
        printed(folder, Printer(real, load_machine(files["perfect"])), files),
    )


def hidden(name: str, seed: int) -> tuple[dict[str, Any], Real]:
    """The effect as a machine file has to say it, and the printer that has it."""
    plain = Real(tomllib.loads(judge.MACHINE_FILE.read_text(encoding="utf-8")))
    return EFFECTS[name](np.random.default_rng(seed), 1.0, plain)


def measured_by(real: Real, firmware: dict[str, Any], seconds: float = SECONDS) -> Moved:
    def moved(path: NozzlePath) -> tuple[FloatArray, FloatArray, Reading]:
        reading = played(real, firmware, Motion("measured", path, seconds))
        t = reading.t[:: round(1 / (SAMPLE_HZ * reading.t[1]))]
        return t, carriages_of(firmware, path(t)), reading

    return moved


def fresh_gap(folder: Path, runs: Sequence[Path], files: dict[str, Path]) -> tuple[float, float, float]:
    """nrms with the owner's file, with the better one (if there is one), and of the noise."""
    before = kept(folder / "gap-owner.json", "gap", *runs, "--machine", files["owner"], "--json")
    if "better" not in files:
        return before["nrms"], before["nrms"], before["noise_nrms"]
    after = kept(folder / "gap-better.json", "gap", *runs, "--machine", files["better"], "--json")
    return before["nrms"], after["nrms"], before["noise_nrms"]


def forced(folder: Path, owner: Path, runs: Sequence[Path], name: str) -> Wrong:
    """The same runs with one candidate only; its machine file is written although it was refused."""
    path = folder / f"wrong-{name}.json"
    if not path.exists():
        plant = PrinterProblem(load_machine(owner), [read_recording(run) for run in runs], (name,))
        found = diagnose(plant)
        told = result_of(plant, found)
        gaps = {"gap_before": told.gap.before.nrms, "gap_after": told.gap.after.nrms}
        said = {
            "name": name,
            "verdict": told.verdict,
            "refused": told.rejections,
            "table": dict(told.effects.get(name, {})),
        }
        path.with_suffix(".toml").write_text(better_file(owner, "wrong", told, [], "never"), encoding="utf-8")
        path.write_text(json.dumps({**said, **gaps}, indent=1), encoding="utf-8")
        print(path, file=sys.stderr, flush=True)
    answer = json.loads(path.read_text(encoding="utf-8"))
    return Wrong(**{**answer, "refused": tuple(answer["refused"])})


@dataclass(frozen=True, eq=False)
class Printer:
    """That hides the effect, and the file that knows it: by it the bed was levelled."""

    real: Real
    levelled: Machine


def printed(folder: Path, printer: Printer, files: dict[str, Path]) -> dict[str, float]:
    """Contour rms, µm, on the printer that hides the effect, by file; kept."""
    path = folder / "printed.json"
    found = dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else {}
    if "none" not in found:
        found["none"] = printed_with(printer, files["owner"], compensate=False)
    found |= {kind: printed_with(printer, file) for kind, file in files.items() if kind not in found}
    path.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return found


def printed_with(printer: Printer, file: Path, compensate: bool = True, seconds: float = PRINTED_S) -> float:
    """Contour rms, µm."""
    machine = load_machine(file)
    part = Print(PRINT.read_bytes(), PRINT.name, machine).slices(LAYERS, at_most_s=seconds)[0]
    way = inversion(machine, settings_for(machine), COMPENSATED) if compensate else none()
    return (
        float(np.sqrt(np.mean(contour([on_the_real(printer, each, way.motion(each)[0]) for each in part]) ** 2))) * 1e3
    )


def on_the_real(printer: Printer, stretch: PrintSlice, motion: Any) -> Execution:
    """What the independent printer makes of a command; what weight bends is taken out."""
    began = motion.begin_t
    told = Motion("printed", lambda t: motion.position(began + t), motion.end_t - began)
    reading = played(printer.real, printer.real.machine["kinematics"], told)
    t, nozzle = began + reading.t[KEPT_EVERY::KEPT_EVERY], reading.nozzle_mm[KEPT_EVERY::KEPT_EVERY]
    return Execution(stretch, motion, t, nozzle - static_deflection(printer.levelled, nozzle))


# ---- the results ---------------------------------------------------------------------------------


def about() -> dict[str, Any]:
    """Return how everything is measured."""
    return {
        "machine_file": judge.MACHINE_FILE.name,
        "file_error": FILE_ERROR,
        "seconds": SECONDS,
        "motions": motions(),
        "printed_s": PRINTED_S,
        "print": PRINT.name,
        "layers": [LAYERS.first_layer, LAYERS.last_layer],
    }


def results(found: Sequence[Proof]) -> dict[str, Any]:
    """Return what the page says of all printers."""
    accepted = [
        {"hidden": p.hidden, "name": w.name, "verdict": w.verdict}
        for p in found
        for w in p.wrong
        if w.verdict != "unknown"
    ]
    return {"printers": [result(p) for p in found], "accepted": accepted}


def result(p: Proof) -> dict[str, Any]:
    """Return what the page says of one printer."""
    before, after, noise = p.fresh
    refused = p.verdict["refused"]
    return {
        "hidden": p.hidden,
        "table": p.table,
        "verdict": p.verdict["verdict"],
        "effects": [{key: e[key] for key in ("name", "parameters")} for e in p.verdict["effects"]],
        "gap_before": before,
        "gap_after": after,
        "noise": noise,
        "seconds": p.verdict["seconds"],
        "nearest": {"effects": refused["effects"], "because": in_short(refused["because"])} if refused else None,
        "contour_um": {kind: um for kind, um in p.contour_um.items() if not kind.startswith("wrong-")},
        "bandwidths_hz": bandwidths(p) if p.contour_um["perfect"] > p.contour_um["owner"] else None,
        "wrong": [
            {
                "name": w.name,
                "gap_before": w.gap_before,
                "gap_after": w.gap_after,
                "verdict": w.verdict,
                "because": in_short(w.refused),
                "contour_um": p.contour_um[f"wrong-{w.name}"],
            }
            for w in p.wrong
        ],
    }


def motions() -> list[dict[str, Any]]:
    """Return the motions that are measured."""
    return [{"kind": e.kind, "place_mm": [round(x) for x in e.place_mm], "times": e.times} for e in MEASURED]


def in_short(reasons: Sequence[str]) -> str:
    """Join reasons, all places left out of the fit as one."""
    at_places = [int(m[1]) for m in map(OF_A_PLACE.search, reasons) if m]
    others = [reason for reason in reasons if not OF_A_PLACE.search(reason)]
    if at_places:
        others.insert(0, f"at places left out of the fit {min(at_places)} to {max(at_places)} % are left")
    return "; ".join(others)


def bandwidths(p: Proof) -> dict[str, float]:
    """Return the bandwidths, Hz, of the compensation with the effect and without it."""
    true = {f"effects.{p.hidden}.{key}": value for key, value in p.table.items()}
    text = updated_text(judge.MACHINE_FILE, true, name="perfect")
    wide, narrow = (settings_for(m).bandwidth_hz for m in (load_machine(judge.MACHINE_FILE), machine_of(text)))
    return {"knowing": narrow, "without": wide}


def machine_of(text: str) -> Machine:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "machine.toml"
        path.write_text(text, encoding="utf-8")
        return load_machine(path)


# ---- the figure ----------------------------------------------------------------------------------


def draw(found: Sequence[Proof], path: Path) -> None:
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(9, 3.8), layout="constrained")
    at = np.arange(len(found))
    bars = {"owner": "#c0392b", "better": "#2471a3", "perfect": "0.6"}
    for k, (kind, colour) in enumerate(bars.items()):
        heights = [p.contour_um.get(kind, np.nan) for p in found]
        axes.bar(at + 0.27 * (k - 1), heights, 0.25, color=colour, label=f"{kind} file")
    axes.set_xticks(at, [p.hidden for p in found], fontsize=8)
    axes.set_ylabel("contour error, rms, µm")
    uncompensated = [p.contour_um["none"] for p in found]
    axes.set_title(
        f"{PRINT.stem} on the printer that hides the effect; without compensation "
        f"{min(uncompensated):.0f} to {max(uncompensated):.0f} µm",
        fontsize=10,
    )
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
