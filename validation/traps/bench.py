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
from models.file import machine_of_text
from validation.blind.captures import BEFORE_S, TURNS, around
from validation.blind.delta import draw_machine, file_of, played
from validation.blind.real import FloatArray, Real, Tables, toml_of
from validation.plants.accelerometer import Chip, draw_chip, klipper_text

PRINTER_SEED = 6
AT_MM = ((0.0, 0.0), (55.0, 20.0), (-40.0, -50.0))
MADE = ("ffcomp-zigzag-0", "ffcomp-reversals-1", "ffcomp-multisine-2")
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
    text: str = ""  # of the file, if it is not Klipper's

    def by_klipper(self, print_time_s: float = 55.0) -> str:
        """Return the capture as Klipper writes it."""
        return self.comments + klipper_text(self.time_s + print_time_s, 1e3 * self.values)


Nozzle: TypeAlias = Callable[[FloatArray], FloatArray]  # (n,) s → (n, 3) mm
Spoiled: TypeAlias = Callable[[Real, int], Real]  # the printer in a run, by the run's place in the file
Moved: TypeAlias = Callable[[Experiment], Nozzle]
Feels: TypeAlias = Callable[[FloatArray, FloatArray, Run], FloatArray]  # (n,) s, (n, 3) m/s² without gravity, run
Writes: TypeAlias = Callable[[Taken, list[Taken]], Taken]  # one capture, and all of them


@dataclass(frozen=True)
class Said:
    """Allowed, required and forbidden statements; patterns are searched in the answer's text, in any case."""

    verdicts: tuple[str, ...] = ("effects", "none", "unknown")
    refused: bool = False  # the recordings may be refused (exit code 5); then `must` is searched in the refusal
    names: tuple[str, ...] | None = None  # effects that may be named; None: any
    must: tuple[str, ...] = ()
    must_not: tuple[str, ...] = ()
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # effect.key → where its interval reaches
    file: bool | None = None  # whether a better file may be written; None: either


@dataclass(frozen=True, eq=False)
class Trap:
    """What goes wrong in a recording, and what an answer may say."""

    name: str
    about: str
    said: Said
    printer: Spoiled = lambda real, _: real
    by_run: bool = False  # whether the printer is another in every run
    moved: Moved = lambda experiment: experiment.motion.nozzle
    file: Mapping[str, float] = field(default_factory=dict)  # table.key → the file's number over the true one
    firmware: Mapping[str, float] = field(default_factory=dict)  # the same, of the file and of the firmware
    feels: Feels = lambda t, felt, run: felt
    second: Feels | None = None  # what a second chip feels, if there is one
    chip: Callable[[Chip, Run], Chip] = lambda chip, _: chip
    written: Writes = lambda capture, _: capture
    axes_map: str | None = None


def tables_of(trap: Trap | None) -> tuple[Tables, Tables]:
    """Return the true printer, and its owner's file."""
    true = draw_machine(np.random.default_rng(PRINTER_SEED))
    file = file_of(true, 0.02, np.random.default_rng(4))
    for key, factor in [*trap.file.items(), *trap.firmware.items()] if trap else ():
        table, _, name = key.partition(".")
        file[table][name] *= factor
    return true, file


@cache
def plan_for_all() -> Plan:
    """Return three motions at three places, each made twice; whatever is wrong with a trap's file."""
    usual = machine_of_text(toml_of(tables_of(None)[1], "the owner's printer"), "machine.toml")
    made = make_plan(usual, Request(places_mm=AT_MM, seconds=2.0, seed=1))
    return replace(made, experiments=tuple(each for each in made.experiments if each.name in MADE))


def recorded(trap: Trap, plan: Plan) -> list[Taken]:
    """Make every execution, and record it by every chip."""
    taken, rng = [], np.random.default_rng([1, 31])
    feels = {"adxl345": trap.feels} | ({"hotend": trap.second} if trap.second else {})
    chips = {name: draw_chip(rng, TURNS[1], rate_hz=RATE_HZ) for name in feels}
    for index, (experiment, repeat) in enumerate(plan.runs()):
        run, firmware = Run(experiment.name, repeat, index), tuple(trap.firmware.items())
        t, felt = _felt(trap.printer, trap.moved, firmware, experiment, index if trap.by_run else 0)
        for name, change in feels.items():
            chip, there = trap.chip(chips[name], run), CubicSpline(t, change(t, felt, run))
            rows = chip.sampled(there, -plan.rest_before_s, experiment.duration_s + plan.rest_after_s, rng)
            taken.append(Taken(run, name, *rows))
    return taken


@cache
def _felt(
    printer: Spoiled, moved: Moved, numbers: tuple[tuple[str, float], ...], experiment: Experiment, index: int
) -> tuple[FloatArray, FloatArray]:
    """What the nozzle holder feels, (n, 3) m/s² at (n,) s from the beginning of the motion."""
    true, _ = tables_of(None)
    firmware = dict(true["kinematics"])
    for key, factor in numbers:
        firmware[key.partition(".")[2]] *= factor
    reading = played(printer(Real(true), index), firmware, around(experiment, moved(experiment)))
    return reading.t - BEFORE_S, reading.nozzle


def write(trap: Trap, folder: Path) -> list[Path]:
    """Write machine.toml, moves.json and the captures, spoiled; return the captures."""
    (folder / "captures").mkdir(parents=True, exist_ok=True)
    for old in (folder / "captures").iterdir():
        old.unlink()
    (folder / "machine.toml").write_text(toml_of(tables_of(trap)[1], "the owner's printer"), encoding="utf-8")
    plan = plan_for_all()
    save_plan(plan, folder / "moves.json")
    taken, paths = recorded(trap, plan), []
    for each in [trap.written(each, taken) for each in taken]:
        path = folder / "captures" / f"{each.chip}-{each.run.experiment}-{each.run.repeat}.csv"
        path.write_text(each.text or each.by_klipper(55.0 + 10.0 * each.run.index), encoding="utf-8")
        paths.append(path)
    return sorted(paths)
