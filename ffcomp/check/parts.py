"""What of a printer may change between two checks, and what that would change in what its sensor feels.

A part is one number: belts (all, or each), mass on the nozzle holder, damping and dry friction of the guides; of
straight axes frequency and damping of each mode. Its signature is a difference of two simulations by the machine file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.check.signals import ByExperiment, SensorSignal, in_band, rows_of, weighed
from ffcomp.record.clock import RATE_HZ, simulated
from ffcomp.record.plan import Commanded, Experiment
from models.arrays import FloatArray
from models.effects.catalogue import effects_of, measured
from models.machine import Machine, value_of, with_values

SPARE_S = 0.4  # simulated before and after
GUIDES = "ABC"  # each has a belt
HIGHER, STIFFER, MORE = ("higher", "lower"), ("stiffer", "softer"), ("more", "less")


@dataclass(frozen=True)
class Range:
    """How much a part changes."""

    probe: float  # for its signature
    usual: float  # from printer to file: the prior's standard deviation
    lowest: float  # sensible changes
    highest: float


STIFFNESS, MASS, DAMPING = Range(-0.02, 0.2, -0.6, 1.5), Range(0.02, 0.1, -0.3, 1.0), Range(3.0, 15.0, -100.0, 300.0)
OF_MODES = {"frequency_hz": Range(-0.01, 0.1, -0.5, 0.8), "damping_ratio": Range(0.2, 0.5, -0.95, 4.0)}


@dataclass(frozen=True)
class Part:
    """One number of the printer, as a change from the machine file."""

    name: str
    unit: str  # empty: a relative change
    range: Range
    changed: Callable[[Machine, float], Machine]
    sentence: str  # with {size} and {way}
    scale: float = 100.0  # of the size in the sentence
    ways: tuple[str, str] = HIGHER
    worth: float | None = None  # a check that would miss so much is inconclusive
    special: bool = False  # a case of another part: one belt of all

    def words(self, value: float) -> str:
        """Say that the part has changed by so much."""
        return self.sentence.format(size=self.scale * abs(value), way=self.ways[value <= 0])


def parts_of(machine: Machine) -> list[Part]:
    """List what may change, the simple before the special."""
    modes = [(name, key) for name in machine.vibration.tunable for key in OF_MODES if f".{key}[" in name]
    parts = [_belts(None), *map(_belts, range(3)), _friction(machine, None)]
    if "effector_mass" in effects_of(machine.vibration.moves):
        grams, heavier = "the nozzle holder carries {size:.0f} g {way}", _effect("effector_mass", "added_kg")
        parts.append(Part("mass on the nozzle holder", "kg", MASS, heavier, grams, 1e3, MORE, worth=0.1))
    if not modes:
        words, damped = (
            "damping is {way}, as by {size:.0f} N s/m in all guides",
            _effect("guide_damping", "added_n_s_per_m"),
        )
        parts += [_friction(machine, guide) for guide in range(3)]
        parts.append(Part("damping of the guides", "N s/m", DAMPING, damped, words, 1.0))
    return parts + [_mode(machine, name, key) for name, key in modes]


def _belts(only: int | None) -> Part:
    name, what = ("belts", "all belts are") if only is None else (f"belt {GUIDES[only]}", f"belt {GUIDES[only]} is")
    changed = _effect("belt_stiffness", "relative_change", np.ones(3) if only is None else np.eye(3)[only])
    sentence, special = what + " {size:.0f} % {way}", only is not None
    return Part(name, "", STIFFNESS, changed, sentence, 100.0, STIFFER, None if special else 0.1, special)


def _friction(machine: Machine, only: int | None) -> Part:
    name, what = ("friction", "the guides") if only is None else (f"friction {GUIDES[only]}", f"guide {GUIDES[only]}")
    unit, special = "N/kg" if machine.vibration.per_kilogram else "N", only is not None
    already = float(np.min(machine.effects.get("coulomb_friction", {}).get("force_n", 0.0)))
    changed = _effect("coulomb_friction", "force_n", 1.0 if only is None else np.eye(3)[only])
    sentence = f"dry friction of {what} is {{size:.1f}} {unit} {{way}}"
    return Part(
        name, unit, Range(0.5, 3.0, -already, 20.0), changed, sentence, 1.0, HIGHER, None if special else 3.0, special
    )


def _mode(machine: Machine, name: str, key: str) -> Part:
    """Make a part of `axes.x.frequency_hz[0]` or its like."""
    what = "the damping of the mode" if key == "damping_ratio" else "the mode"
    hertz = value_of(machine, name.replace(key, "frequency_hz"))

    def changed(machine: Machine, relative: float) -> Machine:
        return with_values(machine, {name: value_of(machine, name) * (1.0 + relative)})

    sentence = f"{what} of {name.split('.')[1]} near {hertz:.0f} Hz is {{size:.0f}} % {{way}}"
    return Part(name, "", OF_MODES[key], changed, sentence)


def _effect(effect: str, key: str, which: FloatArray | float = 1.0) -> Callable[[Machine, float], Machine]:
    """Return what adds so much to an effect of a machine, in the guides that are marked by 1."""

    def changed(machine: Machine, added: float) -> Machine:
        known = machine.effects.get(effect, {})
        more = np.asarray(known.get(key, 0.0), dtype=np.float64) + added * which
        return replace(machine, effects={**machine.effects, effect: {**known, key: more.tolist()}})

    return changed


def expected_signals(machines: Sequence[Machine], motion: Commanded) -> FloatArray:
    """Simulate what the sensor feels in an experiment: (m, n, 3) m/s² at its rows, thinned as recordings are.

    Raises
    ------
    UnreachableError
        If a machine cannot execute the motion.
    """
    t = np.arange(-SPARE_S, motion.duration_s + SPARE_S, 1.0 / RATE_HZ)
    command = machines[0].kinematics.inverse(motion.nozzle(t))
    rows = rows_of(motion.duration_s)
    motions = zip(machines, simulated(machines, [command] * len(machines)), strict=True)
    sensed = [in_band(measured(machine, played.signals).nozzle, RATE_HZ) for machine, played in motions]
    return np.array([CubicSpline(t, each)(rows) for each in sensed])


UNSEEN = 1e-3  # of the signal, root mean squares: a part that changes less is left out
FITS = 2  # of the last check


class Signatures:
    """What a machine's printer feels, and what its parts would change, by their units."""

    def __init__(self, machine: Machine, experiments: Sequence[Experiment]) -> None:
        self.machine, self.experiments = machine, experiments
        parts = parts_of(machine)
        probed = [part.changed(machine, part.range.probe) for part in parts]
        played = {each.name: expected_signals([machine, *probed], each.motion) for each in experiments}
        self.expected: ByExperiment = {name: signals[0] for name, signals in played.items()}
        size = np.sqrt(sum(np.sum(values**2) for values in self.expected.values()))
        self.of: dict[Part, ByExperiment] = {}
        for k, part in enumerate(parts):
            signature = {name: (signals[k + 1] - signals[0]) / part.range.probe for name, signals in played.items()}
            if np.sqrt(sum(np.sum((part.range.probe * values) ** 2) for values in signature.values())) > UNSEEN * size:
                self.of[part] = signature

    def at(self, sizes: Mapping[Part, float]) -> dict[Part, tuple[ByExperiment, ByExperiment]]:
        """Return, of parts changed by so much each, what that changes and the signature there."""
        many = [part.changed(self.machine, x) for part, size in sizes.items() for x in (size, size + part.range.probe)]
        changes: dict[Part, tuple[dict[str, Any], dict[str, Any]]] = {part: ({}, {}) for part in sizes}
        for each in self.experiments:
            played = expected_signals(many, each.motion)
            for k, part in enumerate(sizes):
                changes[part][0][each.name] = played[2 * k] - self.expected[each.name]
                changes[part][1][each.name] = (played[2 * k + 1] - played[2 * k]) / part.range.probe
        return dict(changes)


def fitted(first: Signatures, measured_signals: Sequence[SensorSignal]) -> Signatures:
    """Return the signatures around the printer that was measured."""
    around = first
    for _ in range(FITS):
        expected = [each.replaced(around.expected[each.name]) for each in measured_signals]
        problem = weighed([(now, then) for now, then in zip(measured_signals, expected, strict=True)])
        parts = [part for part in around.of if not part.special]
        columns = [problem.column(around.of[part]) for part in parts]
        values = problem.fit(columns, [part.range.usual for part in parts]).values
        machine = around.machine
        for part, value in zip(parts, values.tolist(), strict=True):
            machine = part.changed(machine, float(np.clip(value, part.range.lowest, part.range.highest)))
        around = Signatures(machine, first.experiments)
    return around
