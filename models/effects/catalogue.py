"""Find every effect by name, and apply a machine's `[effects]` to its parameters and to its sensor signals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

from models.arrays import FloatArray
from models.effects import delta_parts, drives, friction, sensors, structure
from models.effects.effect import PER_KILOGRAM, Effect, Signals, Terms
from models.machine import Machine
from models.quantities import Quantities

_DECLARED = [each for family in (delta_parts, drives, friction, sensors, structure) for each in vars(family).values()]
CATALOGUE: Mapping[str, Effect] = dict(sorted((each.name, each) for each in _DECLARED if isinstance(each, Effect)))


def effect_named(name: str) -> Effect:
    """Return the effect of that name; ValueError if there is none."""
    if name not in CATALOGUE:
        raise ValueError(f"effects.{name} is not a known effect; known are {', '.join(CATALOGUE)}.")
    return CATALOGUE[name]


@lru_cache(maxsize=8)
def catalogue_of(quantities: Quantities, moves: str) -> Mapping[str, Effect]:
    """Return the effects by name, in the words, keys and units for such a machine."""
    if moves != "axis":
        return CATALOGUE
    return {name: effect.on_axis(quantities) if moves in effect.of else effect for name, effect in CATALOGUE.items()}


def effects_of(*moves: str) -> tuple[str, ...]:
    """Return the names of the effects of machines with one of these `VibrationModel.moves`; none: of printers."""
    return tuple(name for name, effect in CATALOGUE.items() if set(effect.of) & set(moves or ("carriages", "axes")))


def key_in_file(effect: str, key: str, quantities: Quantities) -> str:
    """Return the key of a parameter in a machine file: `force_n`, or `force_n_per_kg`, or `torque_n_m`."""
    per_kilogram = quantities.per_kilogram and effect_named(effect).by_name[key].of_mass
    return f"{key}{PER_KILOGRAM}" if per_kilogram else quantities.key(key)


def values_of(machine: Machine, name: str) -> dict[str, FloatArray] | None:
    """Return the parameters of a machine's effect as arrays (see `EffectParameter.as_array`); None if it is absent.

    A missing amplitude has its neutral value, a missing shape its default. An effect without any amplitude is
    absent.

    Raises ValueError if an amplitude is given without the parameters that shape it, or a parameter is unknown.
    """
    effect, table = effect_named(name), machine.effects.get(name)
    if table is None:
        return None
    if unknown := set(table) - set(effect.by_name):
        raise ValueError(
            f"effects.{name}.{min(unknown)} is not a parameter of this effect: {', '.join(effect.by_name)}."
        )
    if effect.amplitudes and not any(a.name in table for a in effect.amplitudes):
        return None
    if missing := effect.missing(table):
        raise ValueError(f"effects.{name}.{missing[0]} is missing; the effect needs it.")
    return {name: p.as_array(table.get(name, p.absent)) for name, p in effect.by_name.items()}


def terms_of(machine: Machine, printer: Terms) -> dict[str, Any]:
    """Return the printer's terms with those of the machine's effects, in the order of the catalogue."""
    terms = dict(printer)
    for effect in CATALOGUE.values():
        if effect.terms is not None and (values := values_of(machine, effect.name)) is not None:
            terms |= effect.terms(values, terms)
    return terms


def with_effect(machine: Machine, name: str, **parameters: Any) -> Machine:
    """Return the machine with this effect, added or replaced."""
    return replace(machine, effects={**machine.effects, effect_named(name).name: parameters})


def with_effects(machine: Machine, effects: Mapping[str, Mapping[str, Any]]) -> Machine:
    """Return the machine with these effects added or replaced."""
    for name in effects:
        effect_named(name)
    return replace(machine, effects={**machine.effects, **effects})


def without_effects(machine: Machine, *names: str) -> Machine:
    """Return the machine without these effects, or without any if none is named."""
    kept = {name: table for name, table in machine.effects.items() if names and name not in names}
    return replace(machine, effects=kept)


def effective_machine(machine: Machine) -> Machine:
    """Apply every effect that only changes the machine's parameters; the others stay in its `effects`.

    A value per tower makes a carriage's parameter an array (3,), A B C. Without such an effect the machine itself
    is returned, so that caches keyed by it stay valid.
    """
    folded = [name for name in machine.effects if effect_named(name).kind == "parameter"]
    if not folded:
        return machine
    effective = without_effects(machine, *folded)
    for name in folded:
        fold, values = CATALOGUE[name].fold, values_of(machine, name)
        if fold is not None and values is not None:
            effective = fold(effective, values)
    return effective


def design_machine(machine: Machine) -> tuple[Machine, tuple[str, ...]]:
    """Return the machine for the linear design model, and the names of the effects that it cannot include.

    The geometry stays the firmware's, which converts the nozzle's path to carriage paths. Sensor effects are not part
    of the machine.
    """
    effective = effective_machine(machine)
    known = effective if effective is machine else replace(effective, kinematics=machine.kinematics)
    left = [n for n in machine.effects if effect_named(n).kind not in ("parameter", "sensor") or n == "arm_geometry"]
    return known, tuple(left)


def measured(machine: Machine, true: Signals) -> Signals:
    """Apply the machine's sensor effects to the signals of a true motion, in the order of its `effects`."""
    for name in machine.effects:
        measure, values = effect_named(name).measure, values_of(machine, name)
        if measure is not None and values is not None:
            true = measure(true, values)
    return true
