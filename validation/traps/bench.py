"""An owner's bench: ffcomp's own moves on a printer of the blind benchmark, recorded by its accelerometer.

A trap may change the printer, what its firmware makes of the moves, what the chip feels, the chip, and the files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Experiment, Plan, save_plan
from models.file import load_machine
from validation.blind.captures import BEFORE_S, TURNS, around
from validation.blind.delta import draw_machine, file_of, played
from validation.blind.real import FloatArray, Real, Tables, toml_of
from validation.plants.accelerometer import Chip, draw_chip, klipper_text

PRINTER_SEED = 6
AT_MM = ((0.0, 0.0), (55.0, 20.0), (-40.0, -50.0))
MADE = ("ffcomp-zigzag-0", "ffcomp-reversals-1", "ffcomp-multisine-2")
CHIP = "adxl345"
RATE_HZ = 1600.0


@dataclass(frozen=True)
class Run:
    """One execution of an experiment, as a trap sees it."""

    experiment: str
    repeat: int
    index: int  # in the order of the file

    @property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng([1, self.index, 23])


@dataclass(eq=False)
class Taken:
    """A capture before it is written; the row k was taken at time_s[k] after the beginning of the motion."""

    run: Run
    chip: str
    time_s: FloatArray  # (n,)
    values: FloatArray  # (n, 3) m/s², the chip's axes
    comments: str = ""
    text: str = ""  # of the file

    @property
    def name(self) -> str:
        return f"{self.chip}-{self.run.experiment}-{self.run.repeat}.csv"

    def by_klipper(self, print_time_s: float = 55.0) -> str:
        """Return the capture as Klipper writes it."""
        return self.comments + klipper_text(self.time_s + print_time_s, 1e3 * self.values)

    def by_phone(self) -> str:
        """Return the capture as an app writes it: its own time, m/s²."""
        axes = ",".join(f"Acceleration {axis} (m/s^2)" for axis in "xyz")
        _, _, rows = klipper_text(self.time_s - self.time_s[0], self.values).partition("\n")
        return f"Time (s),{axes}\n{rows}"


Nozzle: TypeAlias = Callable[[FloatArray], FloatArray]  # (n,) s → (n, 3) mm
Moved: TypeAlias = Callable[[Experiment], Nozzle]
Spoiled: TypeAlias = Callable[[Real, int], Real]  # the printer in a run, by the run's place in the file
Feels: TypeAlias = Callable[[FloatArray, FloatArray, Run], FloatArray]  # (n,) s, (n, 3) m/s² without gravity, run
Writes: TypeAlias = Callable[[Taken, list[Taken]], Taken]  # one capture, and all of them


@dataclass(frozen=True, eq=False)
class Bench:
    """A recording: the printer, its file, and the moves."""

    printer: Spoiled = lambda real, _: real
    by_run: bool = False  # whether it is another in every run
    moved: Moved = lambda experiment: experiment.motion.nozzle
    file: Mapping[str, float] = field(default_factory=dict)  # table.key → the file's number over the true one
    firmware: Mapping[str, float] = field(default_factory=dict)  # the same, of the file and of the firmware


USUAL = Bench()


@dataclass(frozen=True)
class Sensing:
    """What the chips make of it, and how it is written."""

    chips: Mapping[str, tuple[Feels, ...]] = field(default_factory=lambda: {CHIP: ()})
    chip: Callable[[Chip, Run], Chip] = lambda chip, _: chip
    files: tuple[Writes, ...] = ()
    seed_of_plan: int = 1  # of the plan that is given with the captures


def printer_of(bench: Bench) -> tuple[Tables, str]:
    """Return the true printer, and its file's text."""
    true = draw_machine(np.random.default_rng(PRINTER_SEED))
    file = file_of(true, 0.02, np.random.default_rng(4))
    for key, factor in [*bench.file.items(), *bench.firmware.items()]:
        table, _, name = key.partition(".")
        file[table][name] *= factor
    return true, toml_of(file, "the owner's printer")


def plan_for(machine_file: Path, seed: int = 1) -> Plan:
    """Return three motions at three places, each made twice."""
    made = make_plan(load_machine(str(machine_file)), Request(places_mm=AT_MM, seconds=2.0, seed=seed))
    return replace(made, experiments=tuple(each for each in made.experiments if each.name in MADE))


def recorded(bench: Bench, sensing: Sensing, plan: Plan) -> list[Taken]:
    """Make every execution, and record it by every chip."""
    taken, rng = [], np.random.default_rng([1, 31])
    chips = {name: draw_chip(rng, TURNS[1], rate_hz=RATE_HZ) for name in sensing.chips}
    for index, (experiment, repeat) in enumerate(plan.runs()):
        run = Run(experiment.name, repeat, index)
        for name, feels in sensing.chips.items():
            t, felt = _felt(bench, experiment, index if bench.by_run else 0)
            for each in feels:
                felt = each(t, felt, run)
            chip = sensing.chip(chips[name], run)
            first = -plan.rest_before_s + rng.uniform() / chip.rate_hz
            rows = np.arange(first, experiment.duration_s + plan.rest_after_s, 1 / chip.rate_hz)
            taken.append(Taken(run, name, rows, chip.counts(CubicSpline(t, felt)(rows), rng)))
    return taken


@cache
def _felt(bench: Bench, experiment: Experiment, index: int) -> tuple[FloatArray, FloatArray]:
    """What the nozzle holder feels, (n, 3) m/s² at (n,) s from the beginning of the motion."""
    true, _ = printer_of(bench)
    firmware = dict(true["kinematics"])
    for key, factor in bench.firmware.items():
        firmware[key.partition(".")[2]] *= factor
    reading = played(bench.printer(Real(true), index), firmware, around(experiment, bench.moved(experiment)))
    return reading.t - BEFORE_S, reading.nozzle


@cache
def _plan(folder: Path, seed: int) -> Plan:
    """The plan does not depend on what is wrong with a trap's file."""
    usual = folder / "planned.toml"
    usual.write_text(printer_of(USUAL)[1], encoding="utf-8")
    return plan_for(usual, seed)


def write(bench: Bench, sensing: Sensing, folder: Path) -> list[Path]:
    """Write machine.toml, moves.json and the captures, spoiled; return the captures."""
    (folder / "captures").mkdir(parents=True, exist_ok=True)
    for old in (folder / "captures").iterdir():
        old.unlink()
    (folder / "machine.toml").write_text(printer_of(bench)[1], encoding="utf-8")
    save_plan(_plan(folder.parent, sensing.seed_of_plan), folder / "moves.json")
    taken = recorded(bench, sensing, _plan(folder.parent, 1))
    for spoil in sensing.files:
        taken = [spoil(each, taken) for each in taken]
    paths = []
    for each in taken:
        path = folder / "captures" / each.name
        path.write_text(each.text or each.by_klipper(55.0 + 10.0 * each.run.index), encoding="utf-8")
        paths.append(path)
    return sorted(paths)
