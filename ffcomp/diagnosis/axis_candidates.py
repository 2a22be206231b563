"""Effects that an axis may lack, as candidates: how large each may be follows from the sizes of the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffcomp.diagnosis.problem import Candidate, Parameter
from models.effects.catalogue import CATALOGUE
from models.effects.effect import AT_DRIVE, Effect, MotionScales
from models.effects.effect import Parameter as EffectParameter
from models.kinds import driven_axis
from models.machine import Machine
from models.printer.one_axis import axis_effects

PROBE = 0.1  # of what a usual effect takes, with which a signature is taken
PITCH_SPREAD = 0.05  # of a pitch that the data show, by which it may be off
LINE_SD = 0.003  # of a pitch of several lines, which the data tell well
LOG_SPREAD = 1.5  # of ln, of a number that is known by its order of magnitude
LEAST = 1e-3
LEAST_TURN = 0.5  # rad of travel, or m of a file that writes 1 rad as 1 m: below, a weight pulls as a spring does
BEYOND = 10.0  # times the values at which a search begins, to either side


def axis_candidates(
    machine: Machine,
    scales: MotionScales,
    signals: Sequence[str],
    names: Sequence[str],
    pitches: Sequence[float] = (),
    lines: Sequence[float] = (),
) -> tuple[Candidate, ...]:
    """List the effects that the axis may lack and that its signals could show.

    Parameters
    ----------
    pitches : mm, at which a search for a ripple begins; none: evenly over the travel.
    lines : the same, mm, of several lines that were seen in a measured force.
    """
    able = [
        CATALOGUE[name]
        for name in axis_effects(machine)
        if name in names
        and name not in machine.effects
        and (CATALOGUE[name].needs != "accelerometer" or "acc_q" in signals)
        and (CATALOGUE[name].needs != "turning" or scales.travel_m > LEAST_TURN)
        and any(p.on_axis.size is not None for p in CATALOGUE[name].amplitudes)
    ]
    axis = driven_axis(machine)
    candidates = tuple(
        _with_lines(_candidate(effect, scales, lines or pitches), effect, scales, lines) for effect in able
    )
    if not axis.load_mass_kg or axis.free:
        return candidates
    drive = replace(scales, stiffness_n_per_m=axis.stiffness_n_per_m, stretch_m=scales.force_n / axis.stiffness_n_per_m)
    return tuple(_of_either_spring(c, effect, drive) for c, effect in zip(candidates, able, strict=True))


def _with_lines(candidate: Candidate, effect: Effect, scales: MotionScales, pitches: Sequence[float]) -> Candidate:
    """Let a force that repeats along the axis have several lines, as another form, where the force was measured."""
    if len(pitches) < 2 or not any(p.size == "lines" for p in effect.shapes):
        return candidate
    lines = range(len(pitches))
    amplitudes = tuple(_amplitude(effect, p, scales, i) for i in lines for p in effect.amplitudes)
    names = [_full(effect, p, i) for i in lines for p in effect.shapes]
    shapes = tuple(Parameter(n, p, LINE_SD * p, 0.97 * p, 1.03 * p) for n, p in zip(names, pitches, strict=True))
    grid = (dict(zip(names, pitches, strict=True)),)
    probe = {a.name: PROBE * a.sd for a in amplitudes}
    return replace(candidate, other=Candidate(effect.name, amplitudes, probe, shapes, grid))


def _of_either_spring(candidate: Candidate, effect: Effect, drive: MotionScales) -> Candidate:
    """Let an effect of belts be of the drive too, as another form: nobody knows which of two springs it is of."""
    if AT_DRIVE not in effect.of_axis:
        return candidate
    there = _candidate(effect, drive)
    chosen = Parameter(_full(effect, AT_DRIVE), 1.0, 1.0, 1.0, 1.0)
    return replace(candidate, other=replace(there, shapes=(*there.shapes, chosen)))


def _candidate(effect: Effect, scales: MotionScales, pitches: Sequence[float] = ()) -> Candidate:
    amplitudes = tuple(_amplitude(effect, p, scales) for p in effect.amplitudes if p.on_axis.size is not None)
    searched = [p for p in effect.shapes if p.default is None or p.starts]
    starts = {p.name: list(dict.fromkeys(float(np.clip(x, *p.bounds)) for x in _starts(p, scales))) for p in searched}
    shapes = tuple(_shape(effect, p, starts[p.name], scales) for p in searched)
    if pitches and any(p.is_pitch for p in searched):
        starts |= {p.name: list(pitches) for p in searched if p.is_pitch}
        shapes = tuple(_near(n, pitches) if p.is_pitch else n for n, p in zip(shapes, searched, strict=True))
    grid: list[dict[str, float]] = [{}]
    for p in searched:
        grid = [{**point, _full(effect, p): value} for point in grid for value in starts[p.name]]
    finer = tuple(_finer(effect, p, p.default) for p in effect.shapes if p.default is not None and not p.starts)
    return Candidate(effect.name, amplitudes, {a.name: PROBE * a.sd for a in amplitudes}, shapes, tuple(grid), finer)


def _full(effect: Effect, p: EffectParameter, line: int = 0) -> str:
    return f"effects.{effect.name}.{p.name}{f'[{line}]' if p.size == 'lines' else ''}"


def _amplitude(effect: Effect, p: EffectParameter, scales: MotionScales, line: int = 0) -> Parameter:
    suffix = "[0]" if p.size == "vector3" else ""
    low, high = p.bounds
    size = p.on_axis.size(scales) if p.on_axis.size is not None else 0.0
    return Parameter(
        _full(effect, p, line) + suffix, 0.0, size, low if p.on_axis.lowest is None else p.on_axis.lowest, high
    )


def _starts(p: EffectParameter, scales: MotionScales) -> list[float]:
    """Return the values of a shape at which a search begins."""
    if p.starts or p.on_axis.starts is None:
        return list(p.starts or p.typical)
    return list(p.on_axis.starts(scales))


def _shape(effect: Effect, p: EffectParameter, starts: Sequence[float], scales: MotionScales) -> Parameter:
    """Make a shape's parameter; no pitch may be longer than half the travel, or nothing repeats."""
    low, high = p.bounds
    if p.is_pitch:
        high = min(high, 1e3 * scales.travel_m / 2)
    elif not p.starts:  # far below, nothing changes any more, and every step is short
        low, high = max(low, min(starts) / BEYOND), min(high, max(starts) * BEYOND)
    begin = min(max(starts[len(starts) // 2], low), high)
    return Parameter(_full(effect, p), begin, max(abs(x) for x in starts), low, high)


def _near(pitch: Parameter, pitches: Sequence[float]) -> Parameter:
    """Keep a pitch near those that the data show: it is known to a part of a period in the whole travel."""
    return replace(
        pitch,
        start=pitches[0],
        sd=PITCH_SPREAD * max(pitches),
        low=min(pitches) / 2,
        high=min(pitch.high, 2 * max(pitches)),
    )


def _finer(effect: Effect, p: EffectParameter, usual: float) -> Parameter:
    if p.logarithmic:
        low, high = (math.log(max(x, LEAST)) for x in p.bounds)
        return Parameter(_full(effect, p), math.log(usual), LOG_SPREAD, low, high)
    return Parameter(_full(effect, p), usual, p.typical[1] / 2, *p.bounds)
