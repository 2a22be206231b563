"""What of a printer may change between two checks, and what that would change in what its sensor feels.

A part is one number: belts (all, or each), mass on the nozzle holder, damping and dry friction of the guides; of
straight axes frequency and damping of each mode. Its signature is a difference of two simulations by the machine file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
WORDS = {
    "frequency_hz": ("the mode of {} near {:.0f} Hz is {:.0f} % {}", "higher", "lower"),
    "damping_ratio": ("the damping of the mode of {} near {:.0f} Hz is {:.0f} % {}", "higher", "lower"),
}


@dataclass(frozen=True)
class Part:
    """One number of the printer, as a change from the machine file."""

    name: str
    unit: str
    probe: float  # for its signature
    usual: float  # from printer to file: the prior's standard deviation
    lowest: float  # sensible changes
    highest: float
    changed: Callable[[Machine, float], Machine]
    words: Callable[[float], str]
    worth: float | None = None  # a check that would not see so much tells nothing
    special: bool = False  # a case of another part: one belt of all


def parts_of(machine: Machine) -> list[Part]:
    """List what may change, the simple before the special."""
    possible = effects_of(machine.vibration.moves)
    modes = [name for name in machine.vibration.tunable if name.partition("[")[0].rpartition(".")[2] in WORDS]
    per_kg = "/kg" if machine.vibration.per_kilogram else ""
    belts = partial(_with_effect, effect="belt_stiffness", key="relative_change")
    parts = [
        Part("belts", "", -0.02, 0.2, -0.6, 1.5, _each(belts, np.ones(3)), partial(_stiffer, "all belts are"), 0.1),
        *(
            Part(
                f"belt {letter}",
                "",
                -0.02,
                0.2,
                -0.6,
                1.5,
                _each(belts, np.eye(3)[i]),
                partial(_stiffer, f"belt {letter} is"),
                special=True,
            )
            for i, letter in enumerate("ABC")
        ),
        _friction(machine, per_kg),
    ]
    if "effector_mass" in possible:
        change = partial(_with_effect, effect="effector_mass", key="added_kg")
        parts.append(Part("mass on the nozzle holder", "kg", 0.02, 0.1, -0.3, 1.0, change, _heavier, 0.1))
    if not modes:
        change = partial(_with_effect, effect="guide_damping", key="added_n_s_per_m")
        parts += [_friction(machine, per_kg, guide) for guide in range(3)]
        parts.append(Part("damping of the guides", "N s/m", 3.0, 15.0, -100.0, 300.0, change, _damped))
    return parts + [_mode(machine, name) for name in modes]


def _friction(machine: Machine, per_kg: str, guide: int | None = None) -> Part:
    change: Callable[[Machine, float], Machine] = partial(_with_effect, effect="coulomb_friction", key="force_n")
    letter = None if guide is None else "ABC"[guide]
    if guide is not None:
        change = _each(change, np.eye(3)[guide])
    words = partial(_rubbing, f"guide {letter}" if letter else "the guides", per_kg)
    name = f"friction {letter}" if letter else "friction"
    already = float(np.min(machine.effects.get("coulomb_friction", {}).get("force_n", 0.0)))
    return Part(
        name, f"N{per_kg}", 0.5, 3.0, -already, 20.0, change, words, None if letter else 3.0, special=bool(letter)
    )


def _mode(machine: Machine, name: str) -> Part:
    """Make a part of `axes.x.frequency_hz[0]` or its like."""
    place, _, index = name.partition("[")
    _, axis, key = place.split(".")
    hertz = value_of(machine, f"axes.{axis}.frequency_hz[{index}")
    pattern, more, less = WORDS[key]

    def changed(machine: Machine, relative: float) -> Machine:
        return with_values(machine, {name: value_of(machine, name) * (1.0 + relative)})

    def words(relative: float) -> str:
        return pattern.format(axis, hertz, 100 * abs(relative), more if relative > 0 else less)

    wide = key == "damping_ratio"
    probe, usual, low, high = (0.2, 0.5, -0.95, 4.0) if wide else (-0.01, 0.1, -0.5, 0.8)
    return Part(name, "", probe, usual, low, high, changed, words)


def _with_effect(machine: Machine, added: Any, effect: str, key: str) -> Machine:
    """Return the machine with so much more of an effect."""
    known = machine.effects.get(effect, {})
    more = np.asarray(known.get(key, 0.0), dtype=np.float64) + np.asarray(added, dtype=np.float64)
    return replace(machine, effects={**machine.effects, effect: {**known, key: more.tolist()}})


def _each(change: Callable[..., Machine], which: FloatArray) -> Callable[[Machine, float], Machine]:
    return lambda machine, value: change(machine, value * which)


def _stiffer(what: str, value: float) -> str:
    return f"{what} {100 * abs(value):.0f} % {'stiffer' if value > 0 else 'softer'}"


def _heavier(value: float) -> str:
    return f"the nozzle holder carries {1e3 * abs(value):.0f} g {'more' if value > 0 else 'less'}"


def _damped(value: float) -> str:
    return f"damping is {'higher' if value > 0 else 'lower'}, as by {abs(value):.0f} N s/m in all guides"


def _rubbing(what: str, per_kg: str, value: float) -> str:
    return f"dry friction of {what} is {abs(value):.1f} N{per_kg} {'higher' if value > 0 else 'lower'}"


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


UNSEEN = 1e-3  # of the signal, root mean squares: nothing can be said of such a part
FITS = 2  # of the last check


class Signatures:
    """What a machine's printer feels, and what its parts would change, by their units."""

    def __init__(self, machine: Machine, experiments: Sequence[Experiment]) -> None:
        self.machine, self.experiments = machine, experiments
        parts = parts_of(machine)
        probed = [part.changed(machine, part.probe) for part in parts]
        played = {each.name: expected_signals([machine, *probed], each.motion) for each in experiments}
        self.expected: ByExperiment = {name: signals[0] for name, signals in played.items()}
        size = np.sqrt(sum(np.sum(values**2) for values in self.expected.values()))
        self.of: dict[Part, ByExperiment] = {}
        for k, part in enumerate(parts):
            signature = {name: (signals[k + 1] - signals[0]) / part.probe for name, signals in played.items()}
            if np.sqrt(sum(np.sum((part.probe * values) ** 2) for values in signature.values())) > UNSEEN * size:
                self.of[part] = signature

    def at(self, sizes: Mapping[Part, float]) -> dict[Part, tuple[ByExperiment, ByExperiment]]:
        """Return, of parts changed by so much each, what that changes and the signature there."""
        many = [part.changed(self.machine, x) for part, size in sizes.items() for x in (size, size + part.probe)]
        changes: dict[Part, tuple[dict[str, Any], dict[str, Any]]] = {part: ({}, {}) for part in sizes}
        for each in self.experiments:
            played = expected_signals(many, each.motion)
            for k, part in enumerate(sizes):
                changes[part][0][each.name] = played[2 * k] - self.expected[each.name]
                changes[part][1][each.name] = (played[2 * k + 1] - played[2 * k]) / part.probe
        return dict(changes)


def fitted(first: Signatures, measured_signals: Sequence[SensorSignal]) -> Signatures:
    """Return the signatures around the printer that was measured."""
    around = first
    for _ in range(FITS):
        expected = [each.replaced(around.expected[each.name]) for each in measured_signals]
        problem = weighed([(now, then) for now, then in zip(measured_signals, expected, strict=True)])
        parts = [part for part in around.of if not part.special]
        columns = [problem.column(around.of[part]) for part in parts]
        values = problem.fit(columns, [part.usual for part in parts]).values
        machine = around.machine
        for part, value in zip(parts, values.tolist(), strict=True):
            machine = part.changed(machine, float(np.clip(value, part.lowest, part.highest)))
        around = Signatures(machine, first.experiments)
    return around
