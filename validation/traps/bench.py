"""An owner's bench: a printer of the blind bank, three short motions at three places, an accelerometer at the nozzle.

The readings of a motion are kept in a folder: a trap spoils what was recorded, seldom what was played.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.delta.machines import draw_machine, file_of
from validation.blind.delta.numbers import FloatArray, carriages_of
from validation.blind.delta.real import played
from validation.blind.printer.motions import KINDS, Motion, Place
from validation.blind.printer.real import Order, Reading, Real, Tables
from validation.blind.sensors import columns_of, commands_of, csv_of
from validation.blind.tables import toml_of

PRINTER_SEED, RATE_HZ, SECONDS = 6, 1600.0, 1.6
CHANNELS = ("acc_x", "acc_y", "acc_z")
BRISTLE = {"dry_kind": 2, "bristle": 2e-5, "dry_v": 1.5e-3}
FRICTION = {"dry": np.full(3, 2.52), **BRISTLE}  # N, each guide
CAMERA_KG = 0.128


@dataclass(frozen=True)
class Experiment:
    """A motion at a place, made several times."""

    kind: str
    place: Place
    times: int = 2
    loudness: float = 1.0
    seed: int = 1
    planar: bool = False
    name: str = ""

    @property
    def stem(self) -> str:
        """What its files are called by."""
        return self.name or f"{self.kind}-{self.place[0]:.0f}_{self.place[1]:.0f}"


USUAL = (
    Experiment("multisine", (0.0, 0.0, 30.0)),
    Experiment("slow", (55.0, 20.0, 40.0)),
    Experiment("infill", (-40.0, -50.0, 30.0)),
)


@dataclass(frozen=True)
class Bench:
    """What is measured, on what printer, by what file."""

    fields: Mapping[str, Any] = field(default_factory=dict)  # of numbers.PRINTER: what is hidden
    in_repeat: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)  # other fields in the n-th repeats
    added_kg: float = 0.0  # on the nozzle holder
    file_error: float = 0.02  # of every dynamic number of the file; it says 2 %
    file_factors: Mapping[str, float] = field(default_factory=dict)  # table.key -> the file's number over the true one
    noise: float = 0.01  # rms of the sensors, of each signal's
    experiments: tuple[Experiment, ...] = USUAL
    seconds: float = SECONDS
    axes: str = "ABC"  # of the command as it is written
    orders: tuple[Order, ...] = ()  # what happens to the carriages' command
    seed: int = 1  # of noise


@dataclass(eq=False)
class Recorded:
    """One run before it is written."""

    stem: str
    repeat: int
    time_s: FloatArray  # (n,)
    command: FloatArray  # (n, 3) mm, carriages or nozzle
    signals: dict[str, FloatArray]  # (n,) m/s²
    comments: dict[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.stem}-{self.repeat}.csv"


Spoil = Callable[[list[Recorded], np.random.Generator], list[Recorded]]


def machine_of(bench: Bench) -> tuple[Tables, str]:
    """Return the printer as it is, and its file's text."""
    true = draw_machine(np.random.default_rng(PRINTER_SEED))
    file = file_of(true, bench.file_error, np.random.default_rng(4))
    for key, factor in bench.file_factors.items():
        table, name = key.split(".")
        value = true[table][name]
        file[table][name] = [factor * x for x in value] if isinstance(value, list) else factor * value
    return true, toml_of(file, "the owner's printer")


def recorded(bench: Bench, kept: Path) -> list[Recorded]:
    """Play and record every experiment; readings are kept in the folder `kept`."""
    true, _ = machine_of(bench)
    rng = np.random.default_rng(bench.seed)
    return [
        _record(bench, true, experiment, repeat, kept, rng)
        for experiment in bench.experiments
        for repeat in range(1, experiment.times + 1)
    ]


def _record(
    bench: Bench, true: Tables, experiment: Experiment, repeat: int, kept: Path, rng: np.random.Generator
) -> Recorded:
    real = Real(true).having(**{**bench.fields, **bench.in_repeat.get(repeat, {})})
    real = replace(real, orders=bench.orders)
    if bench.added_kg:
        real = real.changed("effector", nozzle_mass_kg=true["effector"]["nozzle_mass_kg"] + bench.added_kg)
    motion = motion_of(experiment, bench.seconds)
    t, nozzle = _reading(real, true, motion, experiment, kept)
    path = motion.path(t)
    command = path if bench.axes == "xyz" else carriages_of(true["kinematics"], path)
    signals = {c: nozzle[:, i] + _noise(nozzle[:, i], bench.noise, rng) for i, c in enumerate(CHANNELS)}
    return Recorded(experiment.stem, repeat, t, command, signals)


def _noise(signal: FloatArray, share: float, rng: np.random.Generator) -> FloatArray:
    """White, of a share of the signal's rms; a signal that rests has a hundredth of the usual."""
    size = max(float(np.std(signal)), 0.05)
    return np.asarray(share * size * rng.standard_normal(len(signal)))


def motion_of(experiment: Experiment, seconds: float) -> Motion:
    """Draw the motion of an experiment."""
    rng = np.random.default_rng([experiment.seed, 5])
    path = KINDS[experiment.kind](rng, experiment.place, seconds, experiment.loudness)
    if experiment.planar:
        inner, height = path, experiment.place[2]

        def path(t: FloatArray) -> FloatArray:
            return np.column_stack([inner(t)[:, :2], np.full(len(t), height)])

    return Motion(experiment.stem, path, seconds)


def _reading(
    real: Real, true: Tables, motion: Motion, experiment: Experiment, kept: Path
) -> tuple[FloatArray, FloatArray]:
    key = repr(
        (PRINTER_SEED, _plain(real.fields), real.machine, experiment, motion.seconds, [repr(o) for o in real.orders])
    )
    path = kept / f"{hashlib.sha256(key.encode()).hexdigest()[:20]}.npz"
    if path.exists():
        found = np.load(path)
        return found["t"], found["nozzle"]
    reading: Reading = played(real, true["kinematics"], motion)
    every = round(1 / (RATE_HZ * (reading.t[1] - reading.t[0])))
    t, nozzle = reading.t[::every], reading.nozzle[::every]
    kept.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, t=t, nozzle=nozzle)
    return t, nozzle


def _plain(fields: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return sorted((k, np.asarray(v).tolist()) for k, v in fields.items())


def write(bench: Bench, spoils: Sequence[Spoil], folder: Path, kept: Path) -> list[Path]:
    """Write machine.toml and the runs of a bench, spoiled; return the runs."""
    runs = recorded(bench, kept)
    rng = np.random.default_rng([bench.seed, 17])
    for spoil in spoils:
        runs = spoil(runs, rng)
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    (folder / "machine.toml").write_text(machine_of(bench)[1], encoding="utf-8")
    paths = []
    for run in runs:
        path = folder / "runs" / run.name
        comments = "".join(f"# {key}: {value}\n" for key, value in run.comments.items())
        path.write_text(
            comments + csv_of(run.time_s, commands_of(run.command, bench.axes), columns_of(run.signals)),
            encoding="utf-8",
        )
        paths.append(path)
    return sorted(paths)
