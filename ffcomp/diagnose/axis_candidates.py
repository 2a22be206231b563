"""Effects that an axis may lack, as candidates: how large each may be follows from the sizes of the motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ffcomp.diagnose.problem import Candidate, Parameter
from ffcomp.identify.axis_shots import Scales
from models.axis.machine import AxisMachine
from models.axis.simulate import axis_effects
from models.effects.catalogue import CATALOGUE
from models.effects.effect import AT_DRIVE, Effect
from models.effects.effect import Parameter as EffectParameter

LARGE, PROBE = 0.3, 0.1  # of a force, what a usual effect takes; of that, what a signature is taken with
NEAR = 0.05  # of a pitch that the data show, by which it may be off
PITCHES = 12  # that are tried, from a fortieth of the travel to half of it
TURN_APART = 0.7  # of a turn over the travel, by which pitches of a force are apart: one between them is half seen
SPREAD = 1.5  # of ln, of a number that is known by its order of magnitude
LEAST = 1e-3
RESISTING = frozenset({"quadratic_drag"})  # what pushes is none: it would mop up how a damping thins with speed
BEYOND = 10.0  # times the values at which a search begins, to either side

_Sizes = Mapping[str, float]


def axis_candidates(
    machine: AxisMachine,
    scales: Scales,
    band_hz: tuple[float, float],
    signals: Sequence[str],
    names: Sequence[str],
    pitches: Sequence[float] = (),
) -> tuple[Candidate, ...]:
    """List the effects that the axis may lack and that its signals could show.

    Parameters
    ----------
    pitches : mm, at which a search for a ripple begins; none: evenly over the travel.
    """
    able = [n for n in axis_effects(machine) if n in names and n not in machine.effects]
    if "acc_q" not in signals:
        able = [n for n in able if n != "sensor_gain"]
    axis = machine.axis
    sizes = _sizes(scales, band_hz, axis.last_stiffness)
    found = [_candidate(CATALOGUE[name], sizes, scales, pitches) for name in able]
    if not axis.load_mass_kg or axis.free:
        return tuple(found)
    drive = _sizes(scales, band_hz, axis.stiffness_n_per_m)
    return tuple(_of_either_spring(c, CATALOGUE[c.name], drive, scales) for c in found)


def _of_either_spring(candidate: Candidate, effect: Effect, drive: _Sizes, scales: Scales) -> Candidate:
    """Let an effect of belts be of the drive too, as another form: nobody knows which of two springs it is of."""
    if AT_DRIVE not in effect.of_axis:
        return candidate
    there = _candidate(effect, drive, scales)
    chosen = Parameter(_full(effect, AT_DRIVE), 1.0, 1.0, 1.0, 1.0)
    return replace(candidate, other=replace(there, shapes=(*there.shapes, chosen)))


def _sizes(s: Scales, band_hz: tuple[float, float], stiffness: float) -> _Sizes:
    """Return effect.key -> the size that a usual effect has on this axis, in the machine file's units.

    Parameters
    ----------
    stiffness : of the spring that effects of belts are of; 0: there is none.
    """
    force, stretch_m = LARGE * s.force_n, s.force_n / stiffness if stiffness else s.stretch_m
    stretch = 1e3 * stretch_m
    return {
        "coulomb_friction.force_n": force,
        "stribeck_friction.force_n": force,
        "stribeck_friction.extra_force_n": force / 2,
        "bristle_friction.force_n": force,
        "guide_damping.added_n_s_per_m": force / s.speed_m_per_s,
        "friction_by_direction.damping_difference_n_s_per_m": force / s.speed_m_per_s,
        "quadratic_drag.force_n_s2_per_m2": force / s.speed_m_per_s**2,
        "ground_spring.stiffness_n_per_m": force / s.way_m,
        "cogging_force.sine_n": force / 3,
        "cogging_force.cosine_n": force / 3,
        "cogging.amplitude_mm": LARGE * stretch,
        "belt_stiffness.relative_change": LARGE,
        "belt_backlash.width_mm": LARGE * stretch,
        "belt_hardening.cubic_n_per_m3": LARGE * max(stiffness, 1.0) / stretch_m**2,
        "command_delay.delay_s": LARGE / band_hz[1],
        "sensor_gain.nozzle_relative_change": 0.1,
    }


def _candidate(effect: Effect, sizes: _Sizes, scales: Scales, pitches: Sequence[float] = ()) -> Candidate:
    """Make the candidate of one effect."""
    sized = [(p, sizes[f"{effect.name}.{p.name}"]) for p in effect.amplitudes if f"{effect.name}.{p.name}" in sizes]
    amplitudes = tuple(_amplitude(effect, p, size) for p, size in sized)
    probe = {a.name: PROBE * a.sd for a in amplitudes}
    searched = [p for p in effect.shapes if p.default is None or p.starts]
    starts = {p.name: _starts(effect, p, scales) for p in searched}
    shapes = tuple(_shape(effect, p, starts[p.name], scales) for p in searched)
    if pitches and "pitch_mm" in starts:
        starts["pitch_mm"] = list(pitches)
        shapes = tuple(_near(n, pitches) if n.name.endswith(".pitch_mm") else n for n in shapes)
    grid: list[dict[str, float]] = [{}]
    for p in searched:
        grid = [{**point, _full(effect, p): value} for point in grid for value in starts[p.name]]
    finer = tuple(_finer(effect, p, p.default) for p in effect.shapes if p.default is not None and not p.starts)
    return Candidate(effect.name, amplitudes, probe, shapes, tuple(grid), finer)


def _full(effect: Effect, p: EffectParameter) -> str:
    return f"effects.{effect.name}.{p.name}"


def _amplitude(effect: Effect, p: EffectParameter, size: float) -> Parameter:
    suffix = "[0]" if p.size == "vector3" else ""
    low, high = p.bounds
    return Parameter(_full(effect, p) + suffix, 0.0, size, 0.0 if effect.name in RESISTING else low, high)


def _starts(effect: Effect, p: EffectParameter, s: Scales) -> list[float]:
    """Return the values of a shape at which a search begins."""
    if p.starts:
        return list(p.starts)
    if p.name == "pitch_mm" and effect.name == "cogging_force":
        return [1e3 * s.travel_m / each for each in np.arange(2.0, 40.0, TURN_APART).tolist()]
    if p.name == "pitch_mm":
        return [float(x) for x in np.geomspace(1e3 * s.travel_m / 40, 1e3 * s.travel_m / 2, PITCHES)]
    if p.name == "velocity_mm_per_s":
        return [1e3 * s.speed_m_per_s * share for share in (0.03, 0.1, 0.3)]
    return [1e3 * s.way_m * share for share in (0.003, 0.03, 0.3)]


def _shape(effect: Effect, p: EffectParameter, starts: Sequence[float], s: Scales) -> Parameter:
    """Make a shape's parameter; no pitch may be longer than half the travel, or nothing repeats."""
    low, high = p.bounds
    if p.name == "pitch_mm":
        high = min(high, 1e3 * s.travel_m / 2)
    elif not p.starts:  # far below, nothing changes any more, and every step is short
        low, high = max(low, min(starts) / BEYOND), min(high, max(starts) * BEYOND)
    begin = min(max(starts[len(starts) // 2], low), high)
    return Parameter(_full(effect, p), begin, max(abs(x) for x in starts), low, high)


def _near(pitch: Parameter, found: Sequence[float]) -> Parameter:
    """Keep a pitch near those that the data show: it is known to a part of a period in the whole travel."""
    return replace(
        pitch, start=found[0], sd=NEAR * max(found), low=min(found) / 2, high=min(pitch.high, 2 * max(found))
    )


def _finer(effect: Effect, p: EffectParameter, usual: float) -> Parameter:
    if p.logarithmic:
        low, high = (math.log(max(x, LEAST)) for x in p.bounds)
        return Parameter(_full(effect, p), math.log(usual), SPREAD, low, high)
    return Parameter(_full(effect, p), usual, p.typical[1] / 2, *p.bounds)
