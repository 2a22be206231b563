"""A delta of `validation/blind` that hides an effect: its owner's file, its recordings, and how well it prints."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, NONE, inversion
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.inverse.settings import settings_for
from ffcomp.record.plan import Experiment, Plan
from ffcomp.simulation.expectation import draw_plants
from models.file import load_machine, updated_text
from models.machine import Machine, value_of
from models.printer.rest import static_deflection
from tests.support.straight_printer import TURNED, with_lost_rows
from validation import judge
from validation.blind.delta import EFFECTS, played
from validation.blind.motions import KINDS, Motion, Place
from validation.blind.real import Real
from validation.blind.sensors import columns_of, commands_of, csv_of, draw_sensors
from validation.kalico import kalico_plan, sample
from validation.plants.accelerometer import draw_chip, klipper_capture
from validation.plants.delta_plant import carriages_of

FloatArray = NDArray[np.float64]
Nozzle = Callable[[FloatArray], FloatArray]

PRINT, LAYERS = Path(__file__).parents[2] / "sample_prints" / "ringing_tower.gcode", Sampling(4, 7)
SAMPLE_HZ, KEPT_EVERY = 1600.0, 4  # of a recording; of the printer's 6400 samples a second, which are judged
FILE_ERROR = 0.02  # standard deviation of every dynamic number of the owner's file, and what it says of itself
MOTION_ONLY = (b"G0", b"G1", b"G4", b"G90", b"G21", b"SET_VELOCITY_LIMIT")
BEFORE_S, AFTER_S = 1.2, 0.7  # of the motion that is simulated around an experiment
SAME_MM = 0.01  # by which the host's motion may differ from the plan's


def hidden(name: str, seed: int) -> tuple[dict[str, Any], Real]:
    """Return the effect as a machine file states it, and the printer that has it."""
    plain = Real(tomllib.loads(judge.MACHINE_FILE.read_text(encoding="utf-8")))
    return EFFECTS[name](np.random.default_rng(seed), 1.0, plain)


def owners_file(truth: Machine) -> str:
    """Return the owner's machine file: every dynamic number is a little off."""
    off = draw_plants(truth, FILE_ERROR, 1)[0]
    values = {name: float(f"{value_of(off, name):.6g}") for name in truth.vibration.parameters().names}
    return updated_text(judge.MACHINE_FILE, values, name="owner's printer", uncertainty={"default": FILE_ERROR})


# ---- recordings ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Motions:
    """A kind of motion at a place, made several times."""

    kind: str
    place_mm: Place
    loudness: float = 1.0
    times: int = 1


def record(folder: Path, motions: Sequence[Motions], real: Real, seconds: float) -> None:
    """Write every execution as a run file."""
    folder.mkdir(parents=True)
    sensors, kinematics = draw_sensors(np.random.default_rng(11), "all", SAMPLE_HZ), real.machine["kinematics"]
    for k, each in enumerate(motions):
        rng = np.random.default_rng([1, k])
        path = KINDS[each.kind](rng, each.place_mm, seconds, each.loudness)
        reading = played(real, kinematics, Motion("measured", path, seconds))
        t = reading.t[:: round(1 / (SAMPLE_HZ * reading.t[1]))]
        command = commands_of(carriages_of(kinematics, path(t)), "ABC")
        for n in range(each.times):
            text = csv_of(t, command, columns_of(sensors.record(reading, rng)))
            (folder / f"{each.kind}-{k}-{n + 1}.csv").write_text(text, encoding="utf-8")


def firmware_plan(plan: Path, moves: Plan) -> list[Nozzle]:
    """Return each execution's motion as the real host plans the file, from its begin."""
    lines = [line for line in plan.read_bytes().splitlines(keepends=True) if line.startswith(MOTION_ONLY)]
    limits = {"max_velocity": 1000, "max_accel": 100_000, "max_z_velocity": 1000}
    found = kalico_plan(b"".join(lines), **limits, delta_radius=140.0, arm_length=300.0)["moves"]
    ends = found[:, 0] + found[:, 1:4].sum(axis=1)
    rests = (np.flatnonzero(found[1:, 0] - ends[:-1] > 0.9 * moves.rest_before_s) + 1).tolist()
    motions = list[Nozzle]()
    for each, repeat in moves.runs():
        while rests and not _is(each, found, float(found[rests[0], 0])):
            rests.pop(0)
        assert rests, f"The host does not make {each.name}, repeat {repeat}."
        motions.append(partial(_motion, found, float(found[rests.pop(0), 0])))
    return motions


def _motion(found: FloatArray, begin_s: float, t: FloatArray) -> FloatArray:
    return sample(found, begin_s + t)


def _is(experiment: Experiment, found: FloatArray, begin_s: float) -> bool:
    """Tell whether the host makes this experiment from this time on."""
    t = np.linspace(0.0, experiment.duration_s, 50)
    return bool(np.max(np.abs(sample(found, begin_s + t) - experiment.motion.nozzle(t))) < SAME_MM)


def as_captures(folder: Path, moves: Plan, motions: Sequence[Nozzle], real: Real) -> dict[str, float]:
    """Make every execution on the printer and record it; return when each capture's first row was taken, s."""
    folder.mkdir()
    rng = np.random.default_rng([7, len(motions)])
    chip, begun, clock_s = draw_chip(rng, TURNED), dict[str, float](), 30.0
    for (each, repeat), nozzle in zip(moves.runs(), motions, strict=True):
        felt = _felt_by_nozzle(real, nozzle, each.duration_s)
        name = f"adxl345-{each.name}-{repeat}.csv"
        begin_s, end_s = -moves.rest_before_s, each.duration_s + moves.rest_after_s
        text = with_lost_rows(klipper_capture(felt, chip, begin_s, end_s, clock_s, rng), rng)
        begun[name] = float(text.split("\n", 2)[1].split(",")[0]) - clock_s + begin_s
        (folder / name).write_text(text, encoding="utf-8")
        clock_s += end_s - begin_s + 2.0
    return begun


def _felt_by_nozzle(real: Real, nozzle: Nozzle, duration_s: float) -> CubicSpline:
    """Return what the nozzle holder feels, m/s², over s from the experiment's begin."""

    def path(t: FloatArray) -> FloatArray:
        return nozzle(np.clip(t - BEFORE_S, -0.9, duration_s + 0.4))

    reading = played(real, real.machine["kinematics"], Motion("recorded", path, BEFORE_S + duration_s + AFTER_S))
    return CubicSpline(reading.t - BEFORE_S, reading.nozzle)


def worst_offset(joined: Mapping[str, Any], begun: Mapping[str, float]) -> float:
    """Return the largest error of a joined capture's offset, s."""
    return max(
        abs(run["offset_s"] - begun[f"adxl345-{run['experiment']}-{run['repeat']}.csv"]) for run in joined["runs"]
    )


# ---- the print -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Printer:
    """A printer that hides an effect, and the file that knows it: by it the bed was levelled."""

    real: Real
    levelled: Machine


def printed_with(printer: Printer, file: Path, seconds: float, *, compensate: bool = True) -> float:
    """Return the contour error of a print with a machine file, µm rms."""
    machine = load_machine(file)
    part = Print(PRINT.read_bytes(), PRINT.name, machine).slices(LAYERS, at_most_s=seconds)[0]
    way = inversion(machine, settings_for(machine), COMPENSATED) if compensate else NONE
    errors = contour([on_the_real(printer, each, way.motion(each)[0]) for each in part])
    return float(np.sqrt(np.mean(errors**2))) * 1e3


def on_the_real(printer: Printer, stretch: PrintSlice, motion: Any) -> Execution:
    """Return what the independent printer makes of a command; what weight bends is taken out."""
    began = motion.begin_t
    told = Motion("printed", lambda t: motion.position(began + t), motion.end_t - began)
    reading = played(printer.real, printer.real.machine["kinematics"], told)
    t, nozzle = began + reading.t[KEPT_EVERY::KEPT_EVERY], reading.nozzle_mm[KEPT_EVERY::KEPT_EVERY]
    return Execution(stretch, motion, t, nozzle - static_deflection(printer.levelled, nozzle))
