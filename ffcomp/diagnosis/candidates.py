"""The effects of the catalogue as candidates for a machine, and fitted parameters as tables of its file.

Parameters are those of the machine file, except amplitudes whose effect does not grow in proportion: those are fitted
as `value ** power`, which is zero without effect. A direction is fitted as an angle. How large an effect of a printer
usually is stands in the catalogue; that of an axis by itself, whatever its size, follows from the sizes of its motion.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffcomp.diagnosis.observations import PLACES_APART_MM
from ffcomp.diagnosis.problem import Candidate, Parameter
from models.arrays import ComplexArray, FloatArray
from models.effects.catalogue import CATALOGUE, effective_machine, effects_of, with_effects
from models.effects.effect import AT_DRIVE, Effect, EffectParameter, MotionScales
from models.kinds import driven_axis
from models.machine import Machine, value_of, with_values
from models.printer.one_axis import axis_effects

BOTH = 9.0  # in place of an angle: alike in x and y
USUAL_SHARE = 0.3  # of the forces on an axis: a usual effect
RESTS_MM = 0.05  # an actuator that moves less rests
SPAN_MM = 100.0  # of a printer's travel at least, of which recordings may use less
PROBE = 0.1  # of a usual size: the signature of an axis' effect is taken there
IN_FILE = "file."  # prefix of the sizes of effects that the file states: retuned like its other numbers
WHOLE = "whole"  # the one parameter of an effect that is there or not
EFFECT_KEY = re.compile(r"effects\.(?P<effect>\w+)\.(?P<parameter>\w+)(\[(?P<index>\d)\])?")


# ---- of any machine ------------------------------------------------------------------------------


def machine_parameters(machine: Machine) -> list[Parameter]:
    """Return the numbers of the file, of its effects too, that may be retuned within their stated uncertainty."""
    parameters, default = [], machine.uncertainty.get("default", 0.02)
    numbers = {name: value_of(machine, name) for name in machine.vibration.tunable}
    for name, value in (numbers | _sizes_in_file(machine)).items():
        stated = machine.uncertainty.get(name.removeprefix(IN_FILE).partition("[")[0], default)
        relative = machine.vibration.guessed.get(name, stated)
        if value and relative:
            parameters.append(Parameter.near(name, value, relative * abs(value)))
    return parameters


def _sizes_in_file(machine: Machine) -> dict[str, float]:
    """Return the sizes of the effects that the file states, by name."""
    sizes: dict[str, float] = {}
    for effect, table in machine.effects.items():
        for key in (a.name for a in CATALOGUE[effect].amplitudes if a.name in table):
            name, several = f"{IN_FILE}effects.{effect}.{key}", isinstance(table[key], (list, tuple))
            each = {f"{name}[{i}]": x for i, x in enumerate(table[key])} if several else {name: table[key]}
            sizes |= {name: float(x) for name, x in each.items() if np.isfinite(x)}
    return sizes


def machine_with(machine: Machine, values: Mapping[str, float]) -> Machine:
    """Return the machine with fitted parameters, by name: numbers of its file, and effects that are added."""
    own = {name: x for name, x in values.items() if not name.startswith((IN_FILE, "effects."))}
    effects = {name: dict(table) for name, table in machine.effects.items()}
    for name, x in values.items():
        if name.startswith(IN_FILE):
            _, effect, key = name.removeprefix(IN_FILE).split(".")
            key, _, index = key.removesuffix("]").partition("[")
            table = effects[effect]
            table[key] = [x if i == int(index) else y for i, y in enumerate(table[key])] if index else x
    return with_effects(replace(with_values(machine, own), effects=effects), effect_tables(values))


def with_replaced(machine: Machine, candidate: Candidate) -> Candidate:
    """Note which of the file's numbers each form of an effect replaces: those that its amplitudes can set one by one.

    A belt that is softer than in the file is one number, and a fit that moves both of them ends anywhere between.
    """
    other = None if candidate.other is None else with_replaced(machine, candidate.other)
    return replace(candidate, other=other, replaces=_replaced(machine, candidate))


def _replaced(machine: Machine, candidate: Candidate) -> dict[str, FloatArray]:
    tunable = list(machine.vibration.tunable)
    if CATALOGUE[candidate.name].kind != "parameter" or candidate.switch or not tunable:
        return {}
    unchanged = {n.name: n.start for n in candidate.parameters}
    filed = {n: value_of(machine, n) for n in tunable}
    columns = []
    for a in candidate.amplitudes:
        tables = effect_tables({**unchanged, a.name: candidate.probe[a.name]})
        changed = effective_machine(with_effects(machine, tables))
        if not np.allclose(_response(with_values(changed, filed)), _response(machine), rtol=1e-9):
            return {}  # it does something else besides
        z = (candidate.probe[a.name] - a.start) / a.sd
        columns.append([(value_of(changed, n) - x) / z for n, x in filed.items()])
    by_z = np.array(columns).T  # (numbers, amplitudes)
    if not np.any(by_z):
        return {}
    span = by_z / np.linalg.norm(by_z, axis=0).max()
    shares = np.diag(span @ np.linalg.pinv(span))
    return {n: row for n, row, share in zip(tunable, by_z, shares, strict=True) if share > 1 - 1e-6}


def _response(machine: Machine) -> ComplexArray:
    """Return the response of the machine's model in the middle of its bed: (3, 3, 3), at three frequencies."""
    centre, hz = np.array(machine.kinematics.centre_mm), np.array([3.0, 30.0, 300.0])
    return machine.vibration.carriage_response(centre, 2j * np.pi * hz)


def _full(effect: Effect, p: EffectParameter, line: int = 0) -> str:
    return f"effects.{effect.name}.{p.name}{f'[{line}]' if p.size == 'lines' else ''}"


def _searched(effect: Effect) -> list[EffectParameter]:
    return [p for p in effect.shapes if p.default is None or p.starts]


def _finer_of(effect: Effect, scales: MotionScales | None = None) -> tuple[Parameter, ...]:
    """Return the shapes that have a usual value; `scales` : of an axis by itself."""
    shapes = [_placed(p, scales) for p in effect.shapes if not p.starts]
    return tuple(_finer(effect, p, p.default) for p in shapes if p.default is not None)


def _placed(p: EffectParameter, scales: MotionScales | None) -> EffectParameter:
    """Return a shape with the range in which a fit looks for it, and the usual value there."""
    if scales is None:
        return replace(p, bounds=p.on_printers or p.bounds)
    if p.tried is None or p.default is None:
        return p
    starts = _axis_starts(p, scales)
    return replace(p, default=starts[len(starts) // 2], bounds=_within(p, starts))


def _finer(effect: Effect, p: EffectParameter, usual: float) -> Parameter:
    if p.logarithmic:
        low, high = (math.log(max(x, 1e-3)) for x in p.bounds)
        return Parameter(_full(effect, p), math.log(usual), 1.5, low, high)
    return Parameter(_full(effect, p), usual, p.typical[1] / 2, *p.bounds)


def _grid(starts: Iterable[tuple[str, Sequence[float]]]) -> tuple[dict[str, float], ...]:
    """List every combination of the shapes' starting values, by their names."""
    grid: list[dict[str, float]] = [{}]
    for name, values in starts:
        grid = [{**point, name: value} for point in grid for value in values]
    return tuple(grid)


# ---- of a printer --------------------------------------------------------------------------------


def printer_candidates(machine: Machine, commands: Sequence[FloatArray], names: Sequence[str]) -> list[Candidate]:
    """List the effects that the printer may lack and that these recordings could separate from its own numbers.

    commands : (n, 3) mm of the carriages, of each recording
    names : the effects that are looked for
    """
    possible, idle = _possible_effects(machine, commands), _idle_actuators(machine, commands)
    effects = [CATALOGUE[n] for n in names if n in possible and n not in machine.effects]
    moved = [command @ machine.kinematics.motors.T for command in commands]
    travels = {
        "q_centre_mm": _travel(moved),
        "x_centre_mm": _travel([machine.kinematics.forward(command)[:, :1] for command in commands]),
    }
    longest = float(max(np.ptp(each, axis=0).max() for each in moved)) / 2.0
    limited = (within_travel(_printer_candidate(machine, effect, idle), longest, travels) for effect in effects)
    return [with_replaced(machine, candidate) for candidate in limited if candidate is not None]


def _possible_effects(machine: Machine, commands: Sequence[FloatArray]) -> list[str]:
    """List the effects of this kind of machine that these recordings could separate from its own numbers.

    What depends on a place is no more than another number of the file where all is recorded at one place.
    """
    places = np.array([machine.kinematics.forward(command.mean(axis=0)[None])[0] for command in commands])
    spread = np.ptp(places, axis=0)
    return [n for n in effects_of(machine.vibration.moves) if np.all(spread >= CATALOGUE[n].spread_mm)]


def _idle_actuators(machine: Machine, commands: Sequence[FloatArray]) -> frozenset[int]:
    """Return which actuators rest in all recordings, and their motors with them: they cannot be identified."""
    travel = np.max([np.ptp(command, axis=0) for command in commands], axis=0)
    moves = travel > RESTS_MM
    driven = np.abs(machine.kinematics.motors) @ moves > 0
    return frozenset(np.flatnonzero(~(moves | driven)).tolist()) if moves.any() else frozenset()


def _travel(places: Sequence[FloatArray]) -> tuple[float, float, float]:
    """Return the ends of what was travelled, mm, and where a search for a centre begins.

    That is the middle, where the effect changes nothing on average, as a number of the file does; but where all is
    recorded at one place, away from it: there the effect is no more than such a number.

    places : (n, k) of what moves, in each recording.
    """
    ends = np.array([(each.min(axis=0), each.max(axis=0)) for each in places])
    first, last = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
    moves = last - first > RESTS_MM
    low, high = (float(first[moves].min()), float(last[moves].max())) if moves.any() else (0.0, 0.0)
    one_place = np.ptp(ends.mean(axis=1), axis=0).max() < PLACES_APART_MM
    return low, high, high + SPAN_MM if one_place else (low + high) / 2


def within_travel(
    candidate: Candidate, longest_mm: float, travels: Mapping[str, tuple[float, float, float]]
) -> Candidate | None:
    """Limit a pitch to half a travel, and a centre to one travel beyond its ends, or 100 mm; None if no pitch is left.

    With less than two periods nothing repeats; what changes about a place far beyond the ends is the same all along.
    """

    def placed(n: Parameter) -> Parameter:
        key = n.name.rpartition(".")[2]
        if key in travels:
            first, last, start = travels[key]
            width = max(last - first, SPAN_MM)
            return Parameter(n.name, start, width, first - width, last + width)
        if key == "pitch_mm":
            return replace(n, start=min(n.start, longest_mm), high=min(n.high, longest_mm))
        return n

    shapes = tuple(map(placed, candidate.shapes))
    centres = {n.name: n.start for n in shapes if n.name.rpartition(".")[2] in travels}
    grid = tuple(
        {**point, **centres}
        for point in candidate.grid
        if all(x <= longest_mm for name, x in point.items() if name.endswith(".pitch_mm"))
    )
    if not grid:
        return None
    other = None if candidate.other is None else within_travel(candidate.other, longest_mm, travels)
    return replace(candidate, shapes=shapes, grid=grid, other=other)


def _printer_candidate(machine: Machine, effect: Effect, idle: frozenset[int]) -> Candidate:
    """Make a candidate of an effect; `idle` : actuators that rested."""
    if not effect.amplitudes:
        name = f"effects.{effect.name}.{WHOLE}"
        return Candidate(effect.name, (Parameter(name, 0.0, 1.0, 1.0, 1.0),), {name: 1.0}, switch=True)
    shared = _shared(machine, effect, idle, each=False)
    if any(p.size == "direction" for p in effect.shapes):
        return replace(shared, other=replace(shared, shapes=tuple(_in_both(n) for n in shared.shapes)))
    if all(p.size != "per_tower" for p in effect.amplitudes):
        return shared
    return replace(shared, other=_shared(machine, effect, idle, each=True))


def _in_both(shape: Parameter) -> Parameter:
    """Fix the direction to both: alike in x and y."""
    return replace(shape, start=BOTH, low=BOTH, high=BOTH) if shape.name.endswith(".direction") else shape


def _shared(machine: Machine, effect: Effect, idle: frozenset[int], each: bool) -> Candidate:
    """Make the candidate of an effect.

    each : a value for each tower that is not idle, or one that all share.
    """
    amplitudes = [n for p in effect.amplitudes for n in _amplitude(effect, p, idle, each)]
    probe = {n.name: _linear(p, p.probe) for p in effect.amplitudes for n in _amplitude(effect, p, idle, each)}
    searched = [(p, _starts(p, machine)) for p in _searched(effect)]
    shapes = tuple(_shape(effect, p, starts[0]) for p, starts in searched)
    alternative = tuple(n for p in effect.of_printers for n in _alternative(effect, p, idle, each))
    grid = _grid((_full(effect, p), starts) for p, starts in searched)
    return Candidate(effect.name, tuple(amplitudes), probe, shapes, grid, _finer_of(effect), alternative)


def _alternative(effect: Effect, p: EffectParameter, idle: frozenset[int], each: bool) -> list[Parameter]:
    """Make one parameter, or one an axis, of a shape whose default is to have no say."""
    usual = _finer(effect, p, math.sqrt(p.typical[0] * p.typical[1]))
    if not each:
        return [usual]
    return [replace(usual, name=f"{usual.name}[{i}]") for i in range(3) if i not in idle]


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


def _shape(effect: Effect, p: EffectParameter, first: float) -> Parameter:
    if p.size == "direction":
        return Parameter(_full(effect, p), 0.0, 2.0, -2 * np.pi, 2 * np.pi)
    low, high = p.typical
    return Parameter(_full(effect, p), first, max(high - low, abs(first)) / 2, *(p.on_printers or p.bounds))


def _starts(p: EffectParameter, machine: Machine) -> list[float]:
    if p.starts:
        return list(p.starts)
    if p.size == "direction":
        return [0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4]
    if p.is_pitch:
        # it repeats every full step, or every four
        return [steps / float(machine.steps.full_per_motor[0]) for steps in (1.0, 4.0)]
    low, high = p.typical
    if p.name.endswith("_centre_mm"):
        return [0.0]  # see `within_travel`
    if p.name == "damping_ratio":
        return [float(np.sqrt(low * high))]
    return [float(x) for x in np.geomspace(low, high, 20 if p.name == "frequency_hz" else 3)]


# ---- of an axis by itself --------------------------------------------------------------------------


def axis_candidates(
    machine: Machine,
    scales: MotionScales,
    signals: Sequence[str],
    names: Sequence[str],
    pitches: Sequence[float] = (),
    lines: Sequence[float] = (),
) -> tuple[Candidate, ...]:
    """List the effects that the axis may lack and that its signals could show.

    pitches : mm, where a search for a ripple begins; none: evenly over the travel.
    lines : the same, mm, of several lines that were seen in a measured force.
    """
    axis = driven_axis(machine)
    able = [
        CATALOGUE[name]
        for name in axis_effects(machine)
        if name in names
        and name not in machine.effects
        and (CATALOGUE[name].needs != "accelerometer" or "acc_q" in signals)
        # one sensor alone lags as its drive does; and where an axis restarts all the time, it remembers nothing
        and (CATALOGUE[name].needs != "two sensors" or (len(signals) > 1 and not axis.free))
        and (CATALOGUE[name].needs != "turning" or scales.travel_m > 0.5)  # rad; below, a weight pulls as a spring does
        and any(p.usual is not None for p in CATALOGUE[name].amplitudes)
    ]
    candidates = tuple(
        _with_lines(_axis_candidate(effect, scales, signals, lines or pitches), effect, scales, lines)
        for effect in able
    )
    if not axis.load_mass_kg or axis.free:
        return tuple(with_replaced(machine, c) for c in candidates)
    drive = replace(scales, stiffness_n_per_m=axis.stiffness_n_per_m, stretch_m=scales.force_n / axis.stiffness_n_per_m)
    either = [_of_either_spring(c, effect, drive, signals) for c, effect in zip(candidates, able, strict=True)]
    return tuple(with_replaced(machine, c) for c in either)


def _with_lines(candidate: Candidate, effect: Effect, scales: MotionScales, pitches: Sequence[float]) -> Candidate:
    """Let a force that repeats along the axis have several lines, as another form, where the force was measured."""
    if len(pitches) < 2 or not any(p.size == "lines" for p in effect.shapes):
        return candidate
    lines = range(len(pitches))
    amplitudes = tuple(_axis_amplitude(effect, p, scales, i) for i in lines for p in effect.amplitudes)
    names = [_full(effect, p, i) for i in lines for p in effect.shapes]
    shapes = tuple(_seen(n, p, 1e3 * scales.travel_m) for n, p in zip(names, pitches, strict=True))
    grid = (dict(zip(names, pitches, strict=True)),)
    probe = {a.name: PROBE * a.sd for a in amplitudes}
    return replace(candidate, other=Candidate(effect.name, amplitudes, probe, shapes, grid))


def _seen(name: str, pitch: float, travel_mm: float) -> Parameter:
    """Return the pitch of a line that was seen, which is known to half a period over the whole travel."""
    low, high = (1 / (1 / pitch + side * 0.5 / travel_mm) for side in (1.0, -1.0))
    return Parameter(name, pitch, (high - low) / 10, low, high)


def _of_either_spring(candidate: Candidate, effect: Effect, drive: MotionScales, signals: Sequence[str]) -> Candidate:
    """Let an effect of belts be of the drive too, as another form: it may be in either of the two springs."""
    if AT_DRIVE not in effect.of_axis:
        return candidate
    there = _axis_candidate(effect, drive, signals)
    chosen = Parameter(_full(effect, AT_DRIVE), 1.0, 1.0, 1.0, 1.0)
    return replace(candidate, other=replace(there, shapes=(*there.shapes, chosen)))


def _axis_candidate(
    effect: Effect, scales: MotionScales, signals: Sequence[str], pitches: Sequence[float] = ()
) -> Candidate:
    sized = [p for p in effect.amplitudes if p.usual is not None]
    amplitudes = tuple(_axis_amplitude(effect, p, scales, i) for p in sized for i in _numbers_of(p, signals))
    searched = _searched(effect)
    starts = {p.name: _axis_starts(p, scales) for p in searched}
    shapes = tuple(_axis_shape(effect, p, starts[p.name], scales) for p in searched)
    if pitches and any(p.is_pitch for p in searched):
        starts |= {p.name: list(pitches) for p in searched if p.is_pitch}
        shapes = tuple(_near(n, pitches) if p.is_pitch else n for n, p in zip(shapes, searched, strict=True))
    grid = _grid((_full(effect, p), starts[p.name]) for p in searched)
    probe = {a.name: PROBE * a.sd for a in amplitudes}
    return Candidate(effect.name, amplitudes, probe, shapes, grid, _finer_of(effect, scales))


def _numbers_of(p: EffectParameter, signals: Sequence[str]) -> list[int]:
    """Return which of a vector's numbers these signals show; of one number, the first."""
    return [i for i, s in enumerate(p.signals) if s in signals] if p.size == "vector3" else [0]


def _axis_amplitude(effect: Effect, p: EffectParameter, scales: MotionScales, line: int = 0) -> Parameter:
    suffix = f"[{line}]" if p.size == "vector3" else ""
    low, high = p.bounds
    size = USUAL_SHARE * p.usual(scales) if p.usual is not None else 0.0
    return Parameter(_full(effect, p, line) + suffix, 0.0, size, low if p.lowest is None else p.lowest, high)


def _axis_starts(p: EffectParameter, scales: MotionScales) -> list[float]:
    """Return the values of a shape where a search begins."""
    starts = (p.starts or p.typical) if p.starts or p.tried is None else p.tried(scales)
    return list(dict.fromkeys(float(np.clip(x, *p.bounds)) for x in starts))


def _axis_shape(effect: Effect, p: EffectParameter, starts: Sequence[float], scales: MotionScales) -> Parameter:
    """Make a shape's parameter; no pitch may be longer than half the travel, or nothing repeats."""
    low, high = p.bounds if p.is_pitch or p.starts else _within(p, starts)
    if p.is_pitch:
        high = min(high, 1e3 * scales.travel_m / 2)
    begin = min(max(starts[len(starts) // 2], low), high)
    return Parameter(_full(effect, p), begin, max(abs(x) for x in starts), low, high)


def _within(p: EffectParameter, starts: Sequence[float]) -> tuple[float, float]:
    """Return the range of a shape: far below its starts nothing changes any more, and every step is short."""
    return max(p.bounds[0], min(starts) / 10), min(p.bounds[1], max(starts) * 10)


def _near(pitch: Parameter, pitches: Sequence[float]) -> Parameter:
    """Keep a pitch near those that the data show: it is known to a part of a period in the whole travel."""
    return replace(
        pitch,
        start=pitches[0],
        sd=0.05 * max(pitches),
        low=min(pitches) / 2,
        high=min(pitch.high, 2 * max(pitches)),
    )


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
            table[key] = file_value(effect.by_name[key], value)
        else:
            each = effect.by_name[key]
            none = file_value(each, 0.0, True) if each.default is None else each.default
            row = table.setdefault(key, [] if each.size == "lines" else [none, none, none])
            row += [none] * (int(index) + 1 - len(row))
            row[int(index)] = file_value(each, value, True)
    acting = {name: table for name, table in tables.items() if _acts(CATALOGUE[name], table)}
    return {name: {key: x for key, x in table.items() if key != WHOLE} for name, table in acting.items()}


def _acts(effect: Effect, table: Mapping[str, Any]) -> bool:
    if WHOLE in table:
        return bool(table[WHOLE] > 0.5)
    return any(np.any(np.asarray(table[a.name]) != a.neutral) for a in effect.amplitudes if a.name in table)


def file_value(parameter: EffectParameter, value: float, of_three: bool = False) -> Any:
    """Return a fitted number, an angle or a `value ** power`, as the machine file states it."""
    if parameter.logarithmic:
        return math.exp(value)
    if parameter.size == "direction":
        return "both" if value == BOTH else [round(float(f(value)), 6) for f in (np.cos, np.sin)]
    if parameter.power == 1:
        return value
    if of_three and parameter.power < 0:  # a list has no room for infinity: the largest value does nothing either
        return min(float(max(value, 1e-300) ** (1 / parameter.power)), parameter.bounds[1])
    return float(value ** (1 / parameter.power)) if value > 0 else parameter.neutral
