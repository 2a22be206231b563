"""The effects of the catalogue as candidates for a printer, and fitted parameters as tables of its machine file.

Parameters are those of the machine file, except amplitudes whose effect does not grow in proportion: those are fitted
as `value ** power`, which is zero without effect. A direction is fitted as an angle.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffcomp.diagnosis.problem import Candidate, Parameter
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE, effects_of
from models.effects.effect import Effect
from models.effects.effect import Parameter as EffectParameter
from models.machine import Machine, value_of

REACH_SD = 5.0  # by which a parameter may be retuned: beyond, it is an effect
BOTH = 9.0  # in place of an angle: alike in x and y
WHOLE = "whole"  # the one parameter of an effect that is there or not
EFFECT_KEY = re.compile(r"effects\.(?P<effect>\w+)\.(?P<parameter>\w+)(\[(?P<index>\d)\])?")


def machine_parameters(machine: Machine) -> list[Parameter]:
    """Return the parameters that may be retuned within their stated uncertainty."""
    parameters = []
    for name in machine.vibration.tunable:
        value = value_of(machine, name)
        table_key = name.partition("[")[0]
        stated = machine.uncertainty.get(table_key, machine.uncertainty.get("default", 0.02))
        relative = machine.vibration.guessed.get(name, stated)
        if value and relative:
            sd = relative * abs(value)
            low = value - REACH_SD * sd
            parameters.append(
                Parameter(name, value, sd, low if value < 0 else max(low, 0.05 * value), value + REACH_SD * sd)
            )
    return parameters


def possible_effects(machine: Machine, commands: Sequence[FloatArray]) -> list[str]:
    """List the effects of this kind of machine that these recordings could tell from its own numbers.

    What depends on a place is no more than another number of the file where all is recorded at one place.
    """
    places = np.array([machine.kinematics.forward(command.mean(axis=0)[None])[0] for command in commands])
    spread = np.ptp(places, axis=0)
    return [n for n in effects_of(machine.vibration.moves) if np.all(spread >= CATALOGUE[n].spread_mm)]


def idle_actuators(machine: Machine, commands: Sequence[FloatArray]) -> frozenset[int]:
    """Return which actuators rest in all recordings, and their motors with them: nothing can be said of them."""
    travel = np.max([np.ptp(command, axis=0) for command in commands], axis=0)
    moves = travel > 0.05  # mm: an actuator that moves less rests
    driven = np.abs(machine.kinematics.motors) @ moves > 0
    return frozenset(np.flatnonzero(~(moves | driven)).tolist()) if moves.any() else frozenset()


def longest_travel(machine: Machine, commands: Sequence[FloatArray]) -> float:
    """Return the longest way of a motor in any recording, mm."""
    return float(max(np.ptp(command @ machine.kinematics.motors.T, axis=0).max() for command in commands))


def candidate_of(machine: Machine, effect: Effect, idle: frozenset[int]) -> Candidate:
    """Make a candidate of an effect; `idle` : actuators of which nothing can be said."""
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
        low, high = (math.log(max(x, 1e-3)) for x in p.bounds)
        return Parameter(_full(effect, p), math.log(usual), 1.5, low, high)
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
        # it repeats every full step, or every four
        return [steps / float(machine.steps.full_per_motor[0]) for steps in (1.0, 4.0)]
    low, high = p.typical
    if p.name == "x_centre_mm":
        return [float(machine.kinematics.centre_mm[0])]
    if p.name == "q_centre_mm":
        return [0.5 * (low + high)]
    if p.name == "damping_ratio":
        return [float(np.sqrt(low * high))]
    return [float(x) for x in np.geomspace(low, high, 20 if p.name == "frequency_hz" else 3)]


def _grid(effect: Effect, machine: Machine) -> list[dict[str, float]]:
    """List every combination of the shapes' starting values."""
    grid: list[dict[str, float]] = [{}]
    for p in effect.shapes:
        if not _searched(p):
            continue
        name = _full(effect, p)
        grid = [{**point, name: value} for point in grid for value in _starts(effect, p, machine)]
    return grid


# ---- fitted parameters as tables of a machine file ---------------------------------------------------


def effect_tables(values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Turn fitted parameters into the tables of a machine file, without effects that do nothing."""
    tables: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        match = EFFECT_KEY.fullmatch(name)
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
            row = table.setdefault(key, [] if each.size == "lines" else [none, none, none])
            row += [none] * (int(index) + 1 - len(row))
            row[int(index)] = _machine_value(each, value, True)
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
