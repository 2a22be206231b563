"""The printer as a plant: commands in, accelerations or positions of carriages and effector out.

Every effect of the catalogue becomes a candidate. Its numbers are those of the machine file, but for amplitudes whose
answer does not grow in proportion: those are fitted as `value ** power`, which is zero without effect. A direction is
fitted as an angle.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffcomp.diagnose.noise import BAND_HZ
from ffcomp.diagnose.plant import Candidate, Impossible, Number, Recording
from ffcomp.identify.direct import UNKNOWNS
from ffcomp.measured.frf import FloatArray
from ffcomp.measured.run import Run
from models.effects.catalogue import CATALOGUE, measured
from models.effects.effect import Effect, Parameter
from models.errors import UnreachableError
from models.kinematics.delta import forward, inverse
from models.machine import Machine
from models.parameters import value_of, with_values
from models.printer import SMOOTH_STEP_S, PrinterMotion, longest_step, printer_numbers, simulate_printer

STEP_S = 1 / 3200  # of a printer without dry friction or play: some nanometres off
FULL_STEPS = (1.0, 4.0)  # cogging repeats every full step, or every four
GRID = 3  # starting values of a shape that is known by its range only
MANY = {"frequency_hz": 6}  # shapes whose signature changes quickly
BOTH = 9.0  # in place of an angle: alike in x and y
WHOLE = "whole"  # the one number of an effect that is there or not

_NAME = re.compile(r"effects\.(?P<effect>\w+)\.(?P<parameter>\w+)(\[(?P<index>\d)\])?")


class Delta:
    """A machine file and its runs."""

    band_hz = BAND_HZ

    def __init__(self, machine: Machine, runs: Sequence[Run], names: Sequence[str] = tuple(CATALOGUE)) -> None:
        self.machine, self.runs = machine, runs
        self.commands = [self._carriages(run) for run in runs]
        self.recordings = [_recording(machine, run, c) for run, c in zip(runs, self.commands, strict=True)]
        self.same_command = [_first_equal(self.commands, i) for i in range(len(runs))]
        self.numbers = tuple(_numbers(machine))
        self.candidates = tuple(_candidate(machine, CATALOGUE[n]) for n in names if n not in machine.effects)

    def _carriages(self, run: Run) -> FloatArray:
        """(n, 3) mm: what the motors were told. A nozzle command goes through the file's kinematics, as in firmware."""
        if run.command_space == "carriage":
            return run.command
        return inverse(self.machine.kinematics, run.command)

    def simulate(self, values: Mapping[str, float], only: Sequence[int] | None = None) -> list[FloatArray]:
        machine = self.machine_with(values)
        chosen = range(len(self.runs)) if only is None else only
        played: dict[int, PrinterMotion] = {}
        answers = []
        for i in chosen:
            first = self.same_command[i]
            if first not in played:
                played[first] = self._played(machine, first)
            answers.append(_signals(machine, played[first], self.recordings[i].signals))
        return answers

    def _played(self, machine: Machine, i: int) -> PrinterMotion:
        dt = 1 / self.recordings[i].rate_hz
        smooth = longest_step(printer_numbers(machine)) == SMOOTH_STEP_S
        substeps = math.ceil(dt / STEP_S * (1 - 1e-9)) if smooth else None
        try:
            return simulate_printer(machine, self.commands[i], dt, substeps=substeps)
        except UnreachableError as error:
            raise Impossible(str(error)) from error

    def machine_with(self, values: Mapping[str, float]) -> Machine:
        """The machine file's machine with these numbers and effects."""
        plain = {name: value for name, value in values.items() if not name.startswith("effects.")}
        machine = with_values(self.machine, plain)
        return replace(machine, effects={**machine.effects, **effect_tables(values)})


def _first_equal(commands: Sequence[FloatArray], i: int) -> int:
    """Repeats need one simulation."""
    return next(k for k in range(i + 1) if np.array_equal(commands[k], commands[i]))


def effect_tables(values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Fitted numbers as the tables of a machine file; what has no effect is left out."""
    tables: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        match = _NAME.fullmatch(name)
        if match is None:
            continue
        effect, key, index = CATALOGUE[match["effect"]], match["parameter"], match["index"]
        table = tables.setdefault(effect.name, {})
        if key == WHOLE:
            table[WHOLE] = value
        elif index is None:
            table[key] = _machine_value(effect.parameter(key), value)
        else:
            table.setdefault(key, [0.0, 0.0, 0.0])[int(index)] = value
    return {name: _without_whole(table) for name, table in tables.items() if _acts(CATALOGUE[name], table)}


def _without_whole(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key != WHOLE}


def _acts(effect: Effect, table: Mapping[str, Any]) -> bool:
    if WHOLE in table:
        return bool(table[WHOLE] > 0.5)
    return any(np.any(np.asarray(table[a.name]) != a.neutral) for a in effect.amplitudes if a.name in table)


def _machine_value(parameter: Parameter, value: float) -> Any:
    if parameter.size == "direction":
        return "both" if value > BOTH / 2 else [round(float(f(value)), 6) for f in (np.cos, np.sin)]
    if parameter.power == 1:
        return value
    return float(value ** (1 / parameter.power)) if value > 0 else parameter.neutral


# ---- numbers and candidates ----------------------------------------------------------------------


def _numbers(machine: Machine) -> list[Number]:
    names = [n for n in UNKNOWNS if machine.carriage.drive is not None or "drive" not in n]
    numbers = []
    for name in names:
        value = value_of(machine, name)
        table_key = name.partition("[")[0]
        relative = machine.uncertainty.get(table_key, machine.uncertainty.get("default", 0.02))
        if value and relative:
            low = float("-inf") if value < 0 else 0.05 * value
            numbers.append(Number(name, value, relative * abs(value), low))
    return numbers


def _candidate(machine: Machine, effect: Effect) -> Candidate:
    amplitudes = [n for p in effect.amplitudes for n in _amplitude(effect, p)]
    probe = {n.name: v for p in effect.amplitudes for n, v in zip(_amplitude(effect, p), _probes(p), strict=True)}
    if not amplitudes:
        name = f"effects.{effect.name}.{WHOLE}"
        amplitudes, probe = [Number(name, 0.0, 1.0, 0.0, 1.0)], {name: 1.0}
    shapes = [_shape(effect, p, machine) for p in effect.shapes]
    return Candidate(effect.name, tuple(amplitudes), probe, tuple(shapes), tuple(_grid(effect, machine)))


def _amplitude(effect: Effect, p: Parameter) -> list[Number]:
    """One number, or one an axis; a value per tower begins alike in all."""
    low, high = sorted(_linear(p, b) for b in p.bounds)
    width = max(abs(_linear(p, t)) for t in p.typical if t)
    names = [f"effects.{effect.name}.{p.name}{suffix}" for suffix in _suffixes(p)]
    return [Number(name, 0.0, width, 0.0 if p.power < 0 else low, high) for name in names]


def _suffixes(p: Parameter) -> tuple[str, ...]:
    return ("[0]", "[1]", "[2]") if p.size == "vector3" else ("",)


def _probes(p: Parameter) -> list[float]:
    return [_linear(p, p.probe)] * len(_suffixes(p))


def _linear(p: Parameter, value: float) -> float:
    return float(value**p.power) if value else 0.0


def _shape(effect: Effect, p: Parameter, machine: Machine) -> Number:
    name = f"effects.{effect.name}.{p.name}"
    if p.size == "direction":
        return Number(name, 0.0, 1.0, -np.pi, BOTH)
    low, high = p.typical
    middle = _starts(effect, p, machine)[0]
    return Number(name, middle, max(high - low, abs(middle)) / 2, *p.bounds)


def _starts(effect: Effect, p: Parameter, machine: Machine) -> list[float]:
    if p.size == "direction":
        return [0.0, np.pi / 2, BOTH]
    if (effect.name, p.name) == ("cogging", "pitch_mm"):
        return [steps / machine.steps.full_steps_per_mm for steps in FULL_STEPS]
    low, high = p.typical
    if p.name == "q_centre_mm":
        return [0.5 * (low + high)]
    if p.name == "damping_ratio":
        return [float(np.sqrt(low * high))]
    return [float(x) for x in np.geomspace(low, high, MANY.get(p.name, GRID))]


def _grid(effect: Effect, machine: Machine) -> list[dict[str, float]]:
    """Every combination of the shapes' starting values."""
    grid: list[dict[str, float]] = [{}]
    for p in effect.shapes:
        name = f"effects.{effect.name}.{p.name}"
        grid = [{**point, name: value} for point in grid for value in _starts(effect, p, machine)]
    return grid


# ---- recordings ----------------------------------------------------------------------------------


def _recording(machine: Machine, run: Run, command: FloatArray) -> Recording:
    signals = (*run.acceleration, *run.position)
    values = [*run.acceleration.values(), *run.position.values()]
    nozzle = forward(machine.kinematics, command)
    place = tuple(float(5 * round(x / 5)) for x in (np.min(nozzle, axis=0) + np.max(nozzle, axis=0))[:2] / 2)
    rate = run.sample_rate_hz
    moving = {**dict(zip("ABC", command.T, strict=True)), **dict(zip("xyz", nozzle.T, strict=True))}
    speed = np.stack([np.gradient(moving[s[4:]], 1 / rate) for s in signals], axis=1)
    return Recording(run.source, run.repeat_of, place, rate, signals, np.stack(values, axis=1), speed)


def _signals(machine: Machine, motion: PrinterMotion, names: Sequence[str]) -> FloatArray:
    """(n, m) in the order of the recording's signals."""
    felt = measured(machine, motion.signals)
    columns = []
    for name in names:
        kind, axis = name.split("_")
        carriage = axis in "ABC"
        i = "ABC".index(axis) if carriage else "xyz".index(axis)
        if kind == "acc":
            columns.append((felt.carriage if carriage else felt.nozzle)[:, i])
        else:
            columns.append((motion.carriage_mm if carriage else motion.nozzle_mm)[:, i])
    return np.stack(columns, axis=1)
