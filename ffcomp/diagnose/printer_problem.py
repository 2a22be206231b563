"""The diagnosis of a printer: commands in, accelerations or positions of carriages and effector out.

Every effect of the catalogue becomes a candidate. Its parameters are those of the machine file, except amplitudes whose
effect does not grow in proportion: those are fitted as `value ** power`, which is zero without effect. A direction is
fitted as an angle.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby, product
from typing import Any, TypeVar

import numpy as np

from ffcomp.diagnose.noise import BAND_HZ
from ffcomp.diagnose.observations import (
    Part,
    compared,
    every_row,
    excerpt_parts,
    first_seconds,
    informative_recordings,
    led_in,
    observation_of,
)
from ffcomp.diagnose.problem import Candidate, InfeasibleParameters, Parameter, Problem, within_travel
from ffcomp.diagnose.recording_clocks import (
    aligned,
    as_recorded,
    belongs_to_recording,
    delay_parameters,
    repeats_of,
    seen_parameters,
    with_stated_clock,
)
from ffcomp.diagnose.validation import carriages_of
from ffcomp.measurement.recording import Recording
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE, effects_of, measured
from models.effects.effect import Effect
from models.effects.effect import Parameter as EffectParameter
from models.machine import Machine
from models.parameters import value_of, with_values
from models.printer.kernels.record import LANES
from models.printer.parameters import ConvertedPrinter, converted_printer
from models.printer.printer import SMOOTH_STEP_S, PrinterMotion, Splines, longest_step, simulate_printers

STEP_S = 1 / 3200  # of a printer without dry friction or backlash: some nanometres off
COARSE_STEP_S, COARSE_KINKED_STEP_S = 1 / 1600, 1 / 3200  # where effects are only ranked
LONGER_STEP = 1.03  # a step may be so much longer where that saves one a row
SAME_RATE = 5  # decimals of a rate, Hz: the others are 20 ns in three seconds
KEPT, AT_ONCE = 4, 24  # machines whose motions are held
WORKERS = min(8, os.cpu_count() or 1)
REACH = 5.0  # standard deviations by which a parameter may be retuned: beyond, it is an effect
FULL_STEPS = (1.0, 4.0)  # cogging repeats every full step, or every four
GRID = 3  # starting values of a shape of which only the range is known
MANY = {"frequency_hz": 20}  # shapes whose signature changes quickly
IDLE_MM = 0.05  # an actuator that moves less rests
BOTH = 9.0  # in place of an angle: alike in x and y
LEAST, SPREAD = 1e-3, 1.5  # of a parameter known by its order of magnitude: counts as none; ln's standard deviation
CYCLE_STEPS = 4.0  # full steps of a motor's electrical cycle
WHOLE = "whole"  # the one parameter of an effect that is there or not

STRAIGHT = ("axis X", "axis Y", "axis Z")
_Pack = TypeVar("_Pack")
_Answer = TypeVar("_Answer")
_Key = tuple[tuple[tuple[str, float], ...], tuple[int, ...], bool]
_NAME = re.compile(r"effects\.(?P<effect>\w+)\.(?P<parameter>\w+)(\[(?P<index>\d)\])?")


class PrinterProblem(Problem):
    """A machine file and its recordings."""

    band_hz = BAND_HZ

    def __init__(
        self, machine: Machine, recordings: Sequence[Recording], names: Sequence[str] = tuple(CATALOGUE)
    ) -> None:
        self.machine, self.recordings = machine, recordings
        self.name, self.path, self.per_kilogram = machine.name, machine.path, machine.vibration.per_kilogram
        if not machine.kinematics.tower_directions:
            self.carriages, self.belts = STRAIGHT, machine.kinematics.actuator_names
        self.reach_mm, self.cycle_mm = machine.kinematics.bed_radius_mm, CYCLE_STEPS / machine.steps.full_per_motor[0]
        self.commands = [compared(carriages_of(machine, one), every_row(one)) for one in recordings]
        recorded = [observation_of(machine, one, c) for one, c in zip(recordings, self.commands, strict=True)]
        self.repeats = repeats_of(recorded)
        self.observations = aligned(recorded, self.repeats)
        self.parameters = (*_parameters(machine), *delay_parameters(recordings, recorded, self.repeats))
        possible, idle = _possible(machine, self.commands), _idle(machine, self.commands)
        asked = [n for n in names if n in possible and n not in machine.effects]
        limited = [
            within_travel(_candidate(machine, CATALOGUE[n], idle), _travel(machine, self.commands)) for n in asked
        ]
        self.candidates = tuple(with_stated_clock(each, recordings) for each in limited if each is not None)
        self.same_command = [_first_equal(self.commands, i) for i in range(len(recordings))]
        self.kept: dict[_Key, dict[int, PrinterMotion]] = {}
        self.parts: Sequence[Part] = [Part(0, len(command), 0) for command in self.commands]
        self.whole, self.chosen = self, tuple(range(len(recordings)))  # what this is a part of, and which recordings
        self.splines = Splines()

    @property
    def motions(self) -> Sequence[int]:
        """Return the first recording with the same command, of each."""
        return self.same_command

    def excerpt(self) -> PrinterProblem | None:
        """Return the problem on a part of each recording that tells most; None where that would hardly be quicker."""
        chosen = informative_recordings(self.observations, self.same_command)
        same = [chosen.index(self.same_command[i]) for i in chosen]
        parts = excerpt_parts([self.observations[i] for i in chosen], same)
        return None if parts is None else self._of(chosen, parts)

    def short_horizon(self, seconds: float) -> PrinterProblem | None:
        """Return the problem on so much of each recording from where it begins to move; None if that is all of it."""
        begun = [first_seconds(self.whole.observations[i], self.whole.commands[i], seconds) for i in self.chosen]
        if all(part.last == len(self.whole.commands[i]) for i, part in zip(self.chosen, begun, strict=True)):
            return None
        return self.whole._of(self.chosen, begun)

    def _of(self, chosen: Sequence[int], parts: Sequence[Part]) -> PrinterProblem:
        """Return the problem on parts of some recordings."""
        shorter = copy(self)
        whole = [self.observations[i] for i in chosen]
        shorter.whole, shorter.chosen = self, tuple(chosen)
        shorter.same_command = [chosen.index(self.same_command[i]) for i in chosen]
        shorter.recordings = [self.recordings[i] for i in chosen]
        shorter.parameters = seen_parameters(self.parameters, whole)
        shorter.kept, shorter.parts, shorter.splines = {}, parts, Splines()
        led = {i: led_in(self.commands[chosen[i]], parts[i], whole[i].rate_hz) for i in set(shorter.same_command)}
        shorter.commands = [led[i] for i in shorter.same_command]
        shorter.observations = [part.of(o) for part, o in zip(parts, whole, strict=True)]
        return shorter

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        """Simulate the recordings: (n, m) each."""
        found = next(iter(self.simulate_many([values], only, coarse=coarse)))
        if isinstance(found, InfeasibleParameters):
            raise found
        return found

    def simulate_many(
        self, many: Sequence[Mapping[str, float]], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> Iterator[list[FloatArray] | InfeasibleParameters]:
        """Simulate in batches, all recordings of a batch together."""
        chosen = range(len(self.recordings)) if only is None else only
        needed = sorted({self.same_command[i] for i in chosen})
        for first in range(0, len(many), AT_ONCE):
            part = many[first : first + AT_ONCE]
            for values, motions in zip(part, self._motions(part, needed, coarse), strict=True):
                yield motions if isinstance(motions, InfeasibleParameters) else self._answer(values, motions, chosen)

    def _answer(
        self, values: Mapping[str, float], motions: Mapping[int, PrinterMotion], chosen: Sequence[int]
    ) -> list[FloatArray]:
        sensors, found = (
            self._sensors_with(values),
            dict[tuple[int, str, tuple[str, ...], tuple[str, ...]], FloatArray](),
        )
        seen = [self.observations[i] for i in chosen]
        kinds = [(self.same_command[i], o.repeat_of, o.signals, o.clocks) for i, o in zip(chosen, seen, strict=True)]
        for i, kind in zip(chosen, kinds, strict=True):
            if kind not in found:
                felt = _signals(sensors, motions[kind[0]], kind[2], self.parts[i])
                found[kind] = as_recorded(values, self.observations[i], felt)
        return [found[kind] for kind in kinds]  # the same array for repeats, which the whitener transforms once

    def _motions(
        self, many: Sequence[Mapping[str, float]], needed: Sequence[int], coarse: bool
    ) -> list[dict[int, PrinterMotion] | InfeasibleParameters]:
        """Simulate motions by index of the recording; the last few are kept, for sensor effects need no new motion."""
        plain = [_without_sensors(values) for values in many]
        keys = [(tuple(sorted(values.items())), tuple(needed), coarse) for values in plain]
        new = {key: values for key, values in zip(keys, plain, strict=True) if key not in self.kept}
        found: dict[_Key, dict[int, PrinterMotion] | InfeasibleParameters] = {
            k: self.kept[k] for k in keys if k in self.kept
        }
        found |= dict(zip(new, self._simulated(list(new.values()), needed, coarse), strict=True))
        answers = [found[key] for key in keys]
        fresh = {key: motions for key, motions in found.items() if not isinstance(motions, InfeasibleParameters)}
        self.kept = dict([*self.kept.items(), *fresh.items()][-KEPT:])
        return answers

    def _simulated(
        self, many: Sequence[Mapping[str, float]], needed: Sequence[int], coarse: bool
    ) -> list[dict[int, PrinterMotion] | InfeasibleParameters]:
        """Simulate on every core, in SIMD lanes what takes equal steps."""
        machines = [self.machine_with(values) for values in many]
        converted = [_converted(machine) for machine in machines]
        printers = {n: each for n, each in enumerate(converted) if not isinstance(each, ValueError)}
        longest = {n: _longest(printer, coarse) for n, printer in printers.items()}
        by_steps: dict[_Steps, list[tuple[int, int]]] = {}
        # together in the lanes: commands of one length, and among those one printer, which is then prepared once
        for _, alike in groupby(sorted(needed, key=self._rows), self._rows):
            for (n, step_s), i in product(longest.items(), list(alike)):
                by_steps.setdefault(_steps(step_s, self.observations[i].rate_hz), []).append((n, i))
        self.work.add(
            sum(steps.substeps * len(self.commands[i]) for steps, tasks in by_steps.items() for _, i in tasks)
        )
        packs = [
            (steps, tasks[k : k + LANES]) for steps, tasks in by_steps.items() for k in range(0, len(tasks), LANES)
        ]

        def simulate(pack: tuple[_Steps, Sequence[tuple[int, int]]]) -> Sequence[PrinterMotion | ValueError]:
            steps, tasks = pack
            commands = [self.commands[i] for _, i in tasks]
            return simulate_printers(
                [machines[n] for n, _ in tasks],
                commands,
                steps.row_s,
                substeps=steps.substeps,
                converted=[printers[n] for n, _ in tasks],
                splines=self.splines,
            )

        motions: list[dict[int, PrinterMotion | ValueError]] = [
            {-1: each} if isinstance(each, ValueError) else {} for each in converted
        ]
        for (_, tasks), found in zip(packs, _each(simulate, packs), strict=True):
            for (n, i), motion in zip(tasks, found, strict=True):
                motions[n][i] = motion
        return [_whole(by_run) for by_run in motions]

    def _rows(self, i: int) -> int:
        return len(self.commands[i])

    def _sensors_with(self, values: Mapping[str, float]) -> Machine | None:
        """Return the machine whose sensors have effects; None if none of them has any."""
        own = any(CATALOGUE[name].kind == "sensor" for name in self.machine.effects)
        return self.machine_with(values) if own or any(map(_is_sensor, values)) else None

    def stated(self, values: Mapping[str, float], name: str) -> float:
        """Return what a file states of one of the machine's numbers: a mount lies between the modes of its axis."""
        return value_of(self.machine_with(values), name)

    def machine_with(self, values: Mapping[str, float]) -> Machine:
        """Return the machine file's machine with these parameters and effects."""
        plain = {n: x for n, x in values.items() if not (n.startswith("effects.") or belongs_to_recording(n))}
        machine = with_values(self.machine, plain)
        return replace(machine, effects={**machine.effects, **effect_tables(values)})


def _each(function: Callable[[_Pack], _Answer], packs: Sequence[_Pack]) -> list[_Answer]:
    """Apply a function to all packs on every core; a single one needs no thread of its own."""
    if len(packs) < 2:
        return [function(pack) for pack in packs]
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(function, packs))


def _without_sensors(values: Mapping[str, float]) -> dict[str, float]:
    return {name: x for name, x in values.items() if not (_is_sensor(name) or belongs_to_recording(name))}


@lru_cache(maxsize=4096)
def _is_sensor(name: str) -> bool:
    match = _NAME.fullmatch(name)
    return match is not None and CATALOGUE[match["effect"]].kind == "sensor"


@dataclass(frozen=True)
class _Steps:
    """Integration steps of a recording."""

    row_s: float
    substeps: int


def _longest(printer: ConvertedPrinter, coarse: bool) -> float:
    longest = longest_step(printer.parameters, printer.modes)
    if longest == SMOOTH_STEP_S:
        return COARSE_STEP_S if coarse else STEP_S
    return max(longest, COARSE_KINKED_STEP_S) if coarse else longest


def _steps(longest: float, rate_hz: float) -> _Steps:
    """Return the steps of a recording; rates that only the rounding of times tells apart share the lanes."""
    rate_hz = round(rate_hz, SAME_RATE)
    return _Steps(1 / rate_hz, math.ceil(1 / rate_hz / longest / LONGER_STEP))


def _converted(machine: Machine) -> ConvertedPrinter | ValueError:
    """Return the printer's numbers, or why there is no such printer: its arms may be too short for its bed."""
    try:
        return converted_printer(machine)
    except ValueError as error:
        return error


def _whole(motions: Mapping[int, PrinterMotion | ValueError]) -> dict[int, PrinterMotion] | InfeasibleParameters:
    """Return the motions, or the first error: one infeasible recording makes the parameters infeasible."""
    failed = [m for m in motions.values() if isinstance(m, ValueError)]
    if failed:
        return InfeasibleParameters(str(failed[0]))
    return {i: m for i, m in motions.items() if isinstance(m, PrinterMotion)}


def _first_equal(commands: Sequence[FloatArray], i: int) -> int:
    """Return the first recording with the same command: repeats need one simulation."""
    return next(k for k in range(i + 1) if np.array_equal(commands[k], commands[i]))


def effect_tables(values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Turn fitted parameters into the tables of a machine file, without effects that do nothing."""
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
            each = effect.parameter(key)
            none = _machine_value(each, 0.0, True) if each.default is None else each.default
            table.setdefault(key, [none, none, none])[int(index)] = _machine_value(each, value, True)
    return {name: _without_whole(table) for name, table in tables.items() if _acts(CATALOGUE[name], table)}


def _without_whole(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key != WHOLE}


def _acts(effect: Effect, table: Mapping[str, Any]) -> bool:
    if WHOLE in table:
        return bool(table[WHOLE] > 0.5)
    return any(np.any(np.asarray(table[a.name]) != a.neutral) for a in effect.amplitudes if a.name in table)


def _machine_value(parameter: EffectParameter, value: float, of_three: bool = False) -> Any:
    if parameter.logarithmic:
        return math.exp(value)
    if parameter.size == "direction":
        return "both" if value == BOTH else [round(float(f(value)), 6) for f in (np.cos, np.sin)]
    if parameter.power == 1:
        return value
    if of_three and parameter.power < 0:  # a list has no room for infinity: the largest value does nothing either
        return min(float(max(value, 1e-300) ** (1 / parameter.power)), parameter.bounds[1])
    return float(value ** (1 / parameter.power)) if value > 0 else parameter.neutral


# ---- parameters and candidates ----------------------------------------------------------------------


def _parameters(machine: Machine) -> list[Parameter]:
    parameters = []
    for name in machine.vibration.tunable:
        value = value_of(machine, name)
        table_key = name.partition("[")[0]
        stated = machine.uncertainty.get(table_key, machine.uncertainty.get("default", 0.02))
        relative = machine.vibration.guessed.get(name, stated)
        if value and relative:
            sd = relative * abs(value)
            low = value - REACH * sd
            parameters.append(
                Parameter(name, value, sd, low if value < 0 else max(low, 0.05 * value), value + REACH * sd)
            )
    return parameters


def _possible(machine: Machine, commands: Sequence[FloatArray]) -> list[str]:
    """List the effects of this kind of machine that these recordings could tell from its own numbers.

    What depends on a place is no more than another number of the file where all is recorded at one place.
    """
    places = np.array([machine.kinematics.forward(command.mean(axis=0)[None])[0] for command in commands])
    spread = np.ptp(places, axis=0)
    return [n for n in effects_of(machine.vibration.moves) if np.all(spread >= CATALOGUE[n].spread_mm)]


def _idle(machine: Machine, commands: Sequence[FloatArray]) -> frozenset[int]:
    """Return which actuators rest in all recordings, and their motors with them: nothing can be said of them."""
    moves = np.max([np.ptp(command, axis=0) for command in commands], axis=0) > IDLE_MM
    driven = np.abs(machine.kinematics.motors) @ moves > 0
    return frozenset(np.flatnonzero(~(moves | driven)).tolist()) if moves.any() else frozenset()


def _travel(machine: Machine, commands: Sequence[FloatArray]) -> float:
    """Return the longest way of a motor in any recording, mm."""
    return float(max(np.ptp(command @ machine.kinematics.motors.T, axis=0).max() for command in commands))


def _candidate(machine: Machine, effect: Effect, idle: frozenset[int]) -> Candidate:
    if not effect.amplitudes:
        name = f"effects.{effect.name}.{WHOLE}"
        return Candidate(effect.name, (Parameter(name, 0.0, 1.0, 1.0, 1.0),), {name: 1.0}, switch=True)
    shared = _of(machine, effect, idle, each=False)
    if any(p.size == "direction" for p in effect.shapes):
        return replace(shared, other=replace(shared, shapes=tuple(_in_both(n) for n in shared.shapes)))
    if all(p.size != "per_tower" for p in effect.amplitudes):
        return shared
    return replace(shared, other=_of(machine, effect, idle, each=True))


def _in_both(shape: Parameter) -> Parameter:
    """Fix the direction to both: alike in x and y."""
    return replace(shape, start=BOTH, low=BOTH, high=BOTH) if shape.name.endswith(".direction") else shape


def _of(machine: Machine, effect: Effect, idle: frozenset[int], each: bool) -> Candidate:
    """Make the candidate of an effect.

    Parameters
    ----------
    each : a value for each tower that is not idle, or one that all share.
    """
    amplitudes = [n for p in effect.amplitudes for n in _amplitude(effect, p, idle, each)]
    probe = {n.name: _linear(p, p.probe) for p in effect.amplitudes for n in _amplitude(effect, p, idle, each)}
    shapes = [_shape(effect, p, machine) for p in effect.shapes if _searched(p)]
    finer = [_finer(effect, p, p.default) for p in effect.shapes if p.default is not None and not p.starts]
    alternative = tuple(n for p in effect.of_printers for n in _alternative(effect, p, idle, each))
    grid = tuple(_grid(effect, machine))
    return Candidate(effect.name, tuple(amplitudes), probe, tuple(shapes), grid, tuple(finer), alternative)


def _searched(p: EffectParameter) -> bool:
    return p.default is None or bool(p.starts)


def _finer(effect: Effect, p: EffectParameter, usual: float) -> Parameter:
    if p.logarithmic:
        low, high = (math.log(max(x, LEAST)) for x in p.bounds)
        return Parameter(_full(effect, p), math.log(usual), SPREAD, low, high)
    return Parameter(_full(effect, p), usual, p.typical[1] / 2, *p.bounds)


def _alternative(effect: Effect, p: EffectParameter, idle: frozenset[int], each: bool) -> list[Parameter]:
    """Make one parameter, or one an axis, of a shape whose default is to have no say."""
    usual = _finer(effect, p, math.sqrt(p.typical[0] * p.typical[1]))
    if not each:
        return [usual]
    return [replace(usual, name=f"{usual.name}[{i}]") for i in range(3) if i not in idle]


def _full(effect: Effect, p: EffectParameter) -> str:
    return f"effects.{effect.name}.{p.name}"


def _amplitude(effect: Effect, p: EffectParameter, idle: frozenset[int], each: bool) -> list[Parameter]:
    """Make one parameter, or one an axis, or one a tower."""
    low, high = sorted(_linear(p, b) for b in p.on_printers or p.bounds)
    width = max(abs(_linear(p, t)) for t in p.typical if t)
    spared = idle if p.size == "per_tower" else frozenset()
    three = p.size == "vector3" or (each and p.size == "per_tower")
    suffixes = [f"[{i}]" for i in range(3) if i not in spared] if three else [""]
    names = [_full(effect, p) + suffix for suffix in suffixes]
    return [Parameter(name, 0.0, width, 0.0 if p.power < 0 else low, high) for name in names]


def _linear(p: EffectParameter, value: float) -> float:
    return float(value**p.power) if value else 0.0


def _shape(effect: Effect, p: EffectParameter, machine: Machine) -> Parameter:
    name = _full(effect, p)
    if p.size == "direction":
        return Parameter(name, 0.0, 2.0, -2 * np.pi, 2 * np.pi)
    low, high = p.typical
    middle = _starts(effect, p, machine)[0]
    return Parameter(name, middle, max(high - low, abs(middle)) / 2, *p.bounds)


def _starts(effect: Effect, p: EffectParameter, machine: Machine) -> list[float]:
    if p.starts:
        return list(p.starts)
    if p.size == "direction":
        return [0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4]
    if p.is_pitch:
        return [steps / float(machine.steps.full_per_motor[0]) for steps in FULL_STEPS]
    low, high = p.typical
    if p.name == "x_centre_mm":
        return [float(machine.kinematics.centre_mm[0])]
    if p.name == "q_centre_mm":
        return [0.5 * (low + high)]
    if p.name == "damping_ratio":
        return [float(np.sqrt(low * high))]
    return [float(x) for x in np.geomspace(low, high, MANY.get(p.name, GRID))]


def _grid(effect: Effect, machine: Machine) -> list[dict[str, float]]:
    """List every combination of the shapes' starting values."""
    grid: list[dict[str, float]] = [{}]
    for p in effect.shapes:
        if not _searched(p):
            continue
        name = _full(effect, p)
        grid = [{**point, name: value} for point in grid for value in _starts(effect, p, machine)]
    return grid


# ---- signals ---------------------------------------------------------------------------------------


def _signals(machine: Machine | None, motion: PrinterMotion, names: Sequence[str], part: Part) -> FloatArray:
    """Return the sensor signals, (n, m), in the order of `names`, of the rows that are compared."""
    rows, sensed = part.compared(len(motion.t_s)), motion.signals
    if machine is not None:
        dt_s = float(motion.t_s[1] - motion.t_s[0])
        sensed = measured(machine, replace(sensed, t_s=sensed.t_s + dt_s * (part.last - rows.stop)))
    columns = np.empty((len(names), rows.stop - rows.start))
    for column, name in zip(columns, names, strict=True):
        kind, axis = name.split("_")
        carriage = axis in "ABC"
        i = "ABC".index(axis) if carriage else "xyz".index(axis)
        if kind == "acc":
            column[:] = (sensed.carriage if carriage else sensed.nozzle)[rows, i]
        else:
            column[:] = (motion.carriage_mm if carriage else motion.nozzle_mm)[rows, i]
    return columns.T
