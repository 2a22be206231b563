"""An owner's bench: ffcomp's own moves on a printer of the blind benchmark, recorded by its accelerometer.

A trap may change what the firmware makes of the moves, the printer, what the chip feels, the chip, and the files. The
printer's motion is kept in a folder: most traps spoil only what was recorded.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Experiment, Plan, save_plan
from models.file import load_machine
from validation.blind.captures import BEFORE_S, around
from validation.blind.delta import draw_machine, file_of, played
from validation.blind.real import FloatArray, Order, Real, Tables, toml_of
from validation.plants import accelerometer
from validation.plants.accelerometer import Chip, draw_chip

PRINTER_SEED = 6
AT_MM = ((0.0, 0.0), (55.0, 20.0), (-40.0, -50.0))
MADE = ("ffcomp-zigzag-0", "ffcomp-reversals-1", "ffcomp-multisine-2")
CHIP = "adxl345"
RATE_HZ = 1600.0
AXES = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # from the printer's to the chip's

Nozzle: TypeAlias = Callable[[FloatArray], FloatArray]  # (n,) s → (n, 3) mm
Moved: TypeAlias = Callable[[Experiment], Nozzle]


@dataclass(frozen=True)
class Run:
    """One execution of an experiment, as a trap sees it."""

    experiment: str
    repeat: int
    index: int  # in the order of the file
    seed: int

    @property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, self.index, 23])


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


Feels: TypeAlias = Callable[[FloatArray, FloatArray, Run], FloatArray]  # (n,) s, (n, 3) m/s² without gravity, run
ChipOf: TypeAlias = Callable[[Chip, Run], Chip]
Writes: TypeAlias = Callable[[list[Taken]], list[Taken]]


def as_planned(experiment: Experiment) -> Nozzle:
    """The firmware moves as the plan says."""
    return experiment.motion.nozzle


@dataclass(frozen=True)
class Bench:
    """A recording: the printer, its file, and the moves."""

    fields: Mapping[str, Any] = field(default_factory=dict)  # of delta_plant.PLANT: what is hidden
    in_run: Callable[[int], Mapping[str, Any]] | None = None  # other fields in each run, by its place in the file
    outside: Callable[..., tuple[dict[str, Any], Real]] | None = None  # of validation.blind.delta
    added_kg: float = 0.0
    file_factors: Mapping[str, float] = field(default_factory=dict)  # table.key → the file's number over the true one
    firmware: Mapping[str, float] = field(default_factory=dict)  # the configuration's geometry over the true one
    orders: tuple[Order, ...] = ()  # what happens to the carriages' command
    orders_in: tuple[int, ...] = ()  # in these runs only; none: in all
    moved: Moved = as_planned
    seed: int = 1


@dataclass(frozen=True)
class Sensing:
    """What the chips make of it, and how it is written."""

    feels: tuple[Feels, ...] = ()
    chip: ChipOf = lambda chip, run: chip
    chips: Mapping[str, tuple[Feels, ...]] = field(default_factory=lambda: {CHIP: ()})  # name → what it feels besides
    files: tuple[Writes, ...] = ()


def printer_of(bench: Bench) -> tuple[Tables, str]:
    """The true printer, and its file's text; the file has the firmware's geometry."""
    true = draw_machine(np.random.default_rng(PRINTER_SEED))
    file = file_of(true, 0.02, np.random.default_rng(4))
    _scale(file, bench.file_factors)
    _scale(file, bench.firmware)
    return true, toml_of(file, "the owner's printer")


def _scale(tables: Tables, factors: Mapping[str, float]) -> None:
    for key, factor in factors.items():
        table, name = key.split(".")
        value = tables[table][name]
        tables[table][name] = [factor * x for x in value] if isinstance(value, list) else factor * value


def plan_for(machine_file: Path, seed: int = 1) -> Plan:
    """Three motions at three places, each made twice."""
    made = make_plan(load_machine(str(machine_file)), Request(places_mm=AT_MM, seconds=2.0, seed=seed))
    return replace(made, experiments=tuple(each for each in made.experiments if each.name in MADE))


def recorded(bench: Bench, sensing: Sensing, plan: Plan, kept: Path) -> list[Taken]:
    """Make every execution, and record it by every chip."""
    taken = []
    rng = np.random.default_rng([bench.seed, 31])
    chips = {name: draw_chip(rng, AXES, rate_hz=RATE_HZ) for name in sensing.chips}
    for index, (experiment, repeat) in enumerate(plan.runs()):
        run = Run(experiment.name, repeat, index, bench.seed)
        t, nozzle = _felt(bench, experiment, index, kept)
        for feels in sensing.feels:
            nozzle = feels(t, nozzle, run)
        for name, others in sensing.chips.items():
            own = nozzle
            for feels in others:
                own = feels(t, own, run)
            chip, felt = sensing.chip(chips[name], run), CubicSpline(t, own)
            first = -plan.rest_before_s + rng.uniform() / chip.rate_hz
            rows = np.arange(first, experiment.duration_s + plan.rest_after_s, 1 / chip.rate_hz)
            taken.append(Taken(run, name, rows, chip.counts(felt(rows), rng)))
    return taken


def _felt(bench: Bench, experiment: Experiment, index: int, kept: Path) -> tuple[FloatArray, FloatArray]:
    """What the nozzle holder feels, (n, 3) m/s² at (n,) s from the beginning of the motion."""
    true, _ = printer_of(bench)
    if bench.added_kg:
        true["effector"]["nozzle_mass_kg"] += bench.added_kg
    fields = {**bench.fields, **(bench.in_run(index) if bench.in_run else {})}
    orders = bench.orders if index in (bench.orders_in or (index,)) else ()
    real = replace(Real(true).having(**fields), orders=orders)
    if bench.outside is not None:
        _, real = bench.outside(np.random.default_rng(bench.seed), 1.0, real)
    firmware = dict(true["kinematics"])
    for key, factor in bench.firmware.items():
        firmware[key.split(".")[1]] *= factor
    moved = bench.moved(experiment)
    along = moved(np.linspace(0.0, experiment.duration_s, 200))
    sample = [np.asarray(value).tolist() for value in fields.values()]
    outside = getattr(bench.outside, "__name__", "")
    key = repr((true, sorted(fields), sample, firmware, experiment.name, along.tolist(), bench.orders, outside))
    path = kept / f"{hashlib.sha256(key.encode()).hexdigest()[:20]}.npz"
    if path.exists():
        found = np.load(path)
        return found["t"], found["nozzle"]

    reading = played(real, firmware, around(experiment, moved))
    kept.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, t=reading.t - BEFORE_S, nozzle=reading.nozzle)
    return reading.t - BEFORE_S, reading.nozzle


def klipper_text(taken: Taken, print_time_s: float = 55.0) -> str:
    """The capture as Klipper writes it."""
    return taken.comments + accelerometer.klipper_text(taken.time_s + print_time_s, 1e3 * taken.values)


def phone_text(taken: Taken) -> str:
    """The capture as an app writes it: its own time, m/s²."""
    axes = ",".join(f"Acceleration {axis} (m/s^2)" for axis in "xyz")
    _, _, rows = accelerometer.klipper_text(taken.time_s - taken.time_s[0], taken.values).partition("\n")
    return f"Time (s),{axes}\n{rows}"


def write(bench: Bench, sensing: Sensing, folder: Path, kept: Path, seed_of_plan: int = 1) -> list[Path]:
    """Write machine.toml, moves.json and the captures, spoiled; return the captures."""
    (folder / "captures").mkdir(parents=True, exist_ok=True)
    for old in (folder / "captures").iterdir():
        old.unlink()
    file = folder / "machine.toml"
    file.write_text(printer_of(bench)[1], encoding="utf-8")
    usual = folder / "planned.toml"  # the plan does not depend on what is wrong with the file
    usual.write_text(printer_of(Bench())[1], encoding="utf-8")
    plan = plan_for(usual)
    save_plan(plan if seed_of_plan == 1 else plan_for(usual, seed_of_plan), folder / "moves.json")
    taken = recorded(bench, sensing, plan, kept)
    for spoil in sensing.files:
        taken = spoil(taken)
    paths = []
    for each in taken:
        path = folder / "captures" / each.name
        path.write_text(each.text or klipper_text(each, 55.0 + 10.0 * each.run.index), encoding="utf-8")
        paths.append(path)
    return sorted(paths)
