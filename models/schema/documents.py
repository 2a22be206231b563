"""The content of each kind of machine file, the rules of its effects, and the check of a whole file.

`KINDS` lists all kinds of machines; nothing else does.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from models.effects.catalogue import CATALOGUE, effects_of
from models.effects.effect import PER_KILOGRAM
from models.errors import MachineFileError
from models.kinds import machine_of_axis
from models.kinematics.base import Kinematics
from models.machine import Machine
from models.quantities import PLAIN, Quantities
from models.schema.delta import CarriageTable, EffectorTable, KinematicsTable, missing_lengths
from models.schema.printer import FirmwareTable, LimitsTable, MacrosTable, StepsTable
from models.schema.straight import AxesTable, DrivenAxisTable, OneAxisTable, StraightTable, quantities_of
from models.schema.table import Table, did_you_mean, number_keys, refuse, sentences
from models.vibration.base import VibrationModel
from models.vibration.delta import DeltaVibration
from models.vibration.driven_axis import DrivenAxis


def refuse_others(effects: Mapping[str, Mapping[str, Any]], moves: str, kind: str) -> None:
    """Refuse effects, and keys of effects, that this kind of machine cannot have."""
    able = effects_of(moves)
    refuse(
        f"effects.{name} does not apply to {kind}. Possible effects: {', '.join(able)}."
        for name in effects
        if name in CATALOGUE and name not in able
    )
    printer = moves != "axis"
    whose = "one axis by itself: it selects one of two springs" if printer else "printers: here use bristle_friction"
    refuse(
        f"effects.{name}.{key.name} is only for {whose}."
        for name, table in effects.items()
        if name in able
        for key in (CATALOGUE[name].of_axis if printer else CATALOGUE[name].of_printers)
        if key.name in table
    )


def mass_problems(name: str, table: Any, weighed: bool) -> Iterator[str]:
    """Yield the mistakes in an effect's force keys, for axes with or without a stated mass."""
    if name not in CATALOGUE or not isinstance(table, dict):
        return
    for key in table:
        plain = key.removesuffix(PER_KILOGRAM)
        if plain not in CATALOGUE[name].by_name or not CATALOGUE[name].by_name[plain].of_mass:
            continue
        if weighed and plain != key:
            yield f"effects.{name}.{key}: use {plain}, because the axes state their mass_kg."
        elif not weighed and plain == key:
            yield (
                f"effects.{name}.{key}: no axis states its mass. State axes.x.mass_kg and axes.y.mass_kg, "
                f"or give {key}{PER_KILOGRAM}, per moving kilogram."
            )


def plain_keys(table: Any) -> Any:
    """Return an effect's table with the keys for axes of known mass."""
    if not isinstance(table, dict):
        return table
    return {key.removesuffix(PER_KILOGRAM): value for key, value in table.items()}


LINES = "lines_per_turn"


def _with_pitch(table: Any) -> Any:
    """Return an effect's table with a pitch in place of lines a turn, 2π rad."""
    if not isinstance(table, dict) or LINES not in table or "pitch_mm" in table:
        return table
    lines = table[LINES]
    each = lines if isinstance(lines, list) else [lines]
    if not all(isinstance(n, int | float) and not isinstance(n, bool) and n > 0 for n in each):
        return table
    pitches = [2e3 * math.pi / n for n in each]
    plain = {key: value for key, value in table.items() if key != LINES}
    return plain | {"pitch_mm": pitches if isinstance(lines, list) else pitches[0]}


def effect_problems(name: str, table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the mistakes in the table of an effect."""
    if name not in CATALOGUE:
        yield f"effects.{name} is not a known effect.{did_you_mean(name, CATALOGUE)}"
        return
    effect = CATALOGUE[name]
    for key, value in table.items():
        if key not in effect.by_name:
            yield f"effects.{name}.{key} is not a parameter of this effect.{did_you_mean(key, effect.by_name)}"
        elif rule := effect.by_name[key].problem(value):
            yield f"effects.{name}.{key} = {value!r} {rule}."
    for key in effect.missing(table):
        yield f"effects.{name}.{key} is missing; {effect.by_name[key].meaning}."
    counts = {
        key: np.size(table[key]) for key in table if key in effect.by_name and effect.by_name[key].size == "lines"
    }
    if len(set(counts.values())) > 1:
        yield f"effects.{name}: {', '.join(counts)} must have as many numbers each, one for each line."


DEFAULT_UNCERTAINTY = 0.02
NO_PRINTER = (
    'This machine is one axis by itself (kinematics.type = "axis") and has no nozzle, so there is no G-code to plan, '
    "compensate, simulate or record; ffcomp gap, ffcomp diagnose and ffcomp identify fit work on it."
)


class Document(Table):
    """The tables of every kind of machine."""

    moves: ClassVar[str]  # as in `Effect.of`
    format: Literal["ffcomp-machine/1"]
    name: str = Field(min_length=1)

    @field_validator("effects", check_fields=False)
    @classmethod
    def _known_effects(cls, effects: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        refuse(problem for name, table in effects.items() for problem in effect_problems(name, table))
        refuse_others(effects, cls.moves, NO_EFFECT_OF[cls.moves])
        return effects

    @field_validator("uncertainty", check_fields=False)
    @classmethod
    def _known_numbers(cls, uncertainty: dict[str, float]) -> dict[str, float]:
        of_effects = (f"effects.{name}.{key}" for name, effect in CATALOGUE.items() for key in effect.by_name)
        known = ["default", *number_keys(cls), *of_effects]
        refuse(
            f'uncertainty."{key}" is not a number of this file.{did_you_mean(key, known)}'
            for key in uncertainty
            if key not in known
        )
        return uncertainty

    @property
    def quantities(self) -> Quantities:
        """Return how the file names and scales its numbers."""
        return PLAIN

    @classmethod
    def missing(cls, document: Mapping[str, Any]) -> list[str]:
        """Return sentences about missing alternatives, where one of several keys is required."""
        return []


NO_EFFECT_OF: Mapping[str, str] = {
    "carriages": "a delta: it has no straight axes",
    "axes": "a machine with straight axes: they have no arms and no effector",
    "axis": "one axis by itself, which is not a printer",
}


class PrinterDocument(Document):
    """The tables of every printer."""

    limits: LimitsTable
    steps: StepsTable = StepsTable()
    firmware: FirmwareTable = FirmwareTable()
    macros: MacrosTable = MacrosTable()
    effects: dict[str, dict[str, Any]] = Field(default_factory=dict)
    uncertainty: dict[str, Annotated[float, Field(ge=0, le=10)]] = Field(default_factory=dict)
    provenance: dict[str, Any] = Field(default_factory=dict)

    def machine_parts(self) -> tuple[Kinematics, VibrationModel]:
        """Return kinematics and vibration model."""
        raise NotImplementedError

    def machine(self, sha256: str, path: str) -> Machine:
        """Return the machine that the file describes."""
        return self.printer(sha256, path)

    def printer(self, sha256: str, path: str) -> Machine:
        """Return the printer that the file describes."""
        kinematics, vibration = self.machine_parts()
        firmware, limits, towers = self.firmware, self.limits.limits(), self.moves == "carriages"
        return Machine(
            name=self.name,
            kinematics=kinematics,
            vibration=vibration,
            limits=limits,
            steps=self.steps.steps(),
            effects=self.effects,
            uncertainty={"default": DEFAULT_UNCERTAINTY, **self.uncertainty},
            provenance=self.provenance,
            sha256=sha256,
            path=path,
            returns=tuple(self.macros.returns or ()),
            input_shaper=None if firmware.input_shaper is None else tuple(firmware.input_shaper),
            flavor=firmware.flavor or "",
            firmware_version=tuple(map(int, re.findall(r"\d+", firmware.version or ""))),
            marlin=None if firmware.marlin is None else firmware.marlin.settings(limits, towers),
            reprapfirmware=None
            if firmware.reprapfirmware is None
            else firmware.reprapfirmware.settings(limits, towers),
        )


class DeltaDocument(PrinterDocument):
    """The file of a delta."""

    moves: ClassVar[str] = "carriages"
    kinematics: KinematicsTable
    carriage: CarriageTable
    effector: EffectorTable

    @classmethod
    def missing(cls, document: Mapping[str, Any]) -> list[str]:
        """Return sentences about missing lengths."""
        return missing_lengths(document)

    def machine_parts(self) -> tuple[Kinematics, VibrationModel]:
        """Return kinematics and vibration model."""
        kinematics = self.kinematics.geometry()
        return kinematics, DeltaVibration(self.carriage.carriage(), self.effector.effector(), kinematics)


class StraightDocument(PrinterDocument):
    """The file of a cartesian or CoreXY machine."""

    moves: ClassVar[str] = "axes"
    kinematics: StraightTable
    axes: AxesTable = Field(default_factory=lambda: AxesTable())

    def machine_parts(self) -> tuple[Kinematics, VibrationModel]:
        """Return kinematics and vibration model."""
        return self.kinematics.geometry(), self.axes.model()

    @model_validator(mode="after")
    def _exchange_needs_common_belts(self) -> StraightDocument:
        if self.axes.exchange and not self.kinematics.geometry().shares_motors:
            refuse(["axes.exchange is only for belts that move x and y together, as on a CoreXY."])
        return self

    @property
    def quantities(self) -> Quantities:
        """Return how the file names its numbers: forces of effects per kilogram, if no axis states its mass."""
        return self.machine_parts()[1].quantities

    @model_validator(mode="before")
    @classmethod
    def _forces_per_kilogram(cls, document: Any) -> Any:
        """Read `force_n_per_kg` as `force_n` of axes whose mass is 1, where no axis states its mass."""
        tables, axes = document.get("effects"), document.get("axes")
        if not isinstance(tables, dict):
            return document
        weighed = isinstance(axes, dict) and any(isinstance(t, dict) and "mass_kg" in t for t in axes.values())
        refuse(problem for name, table in tables.items() for problem in mass_problems(name, table, weighed) if problem)
        return {**document, "effects": {name: plain_keys(table) for name, table in tables.items()}}


class AxisDocument(Document):
    """The file of one axis by itself."""

    moves: ClassVar[str] = DrivenAxis.moves
    kinematics: OneAxisTable
    axis: DrivenAxisTable
    effects: dict[str, dict[str, Any]] = Field(default_factory=dict)
    uncertainty: dict[str, Annotated[float, Field(ge=0, le=10)]] = Field(default_factory=dict)
    provenance: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _inside(cls, document: Any) -> Any:
        """Read an axis that turns, or whose force is a current, with the internal keys and numbers."""
        quantities, out = quantities_of(document), dict(document)
        tables = {name: table for name, table in document.items() if isinstance(table, dict)}
        if "axis" in tables:
            out["axis"] = quantities.read(tables["axis"])
        if "effects" in tables:
            out["effects"] = {name: _with_pitch(table) for name, table in quantities.read(tables["effects"]).items()}
        if "uncertainty" in tables:
            out["uncertainty"] = {quantities.inside(key): value for key, value in tables["uncertainty"].items()}
        return out

    @property
    def quantities(self) -> Quantities:
        """Return how the file names and scales its numbers."""
        return self.axis.axis().quantities

    def machine(self, sha256: str, path: str) -> Machine:
        """Return the axis that the file describes."""
        return machine_of_axis(
            self.name,
            self.axis.axis(),
            effects=self.effects,
            uncertainty={"default": DEFAULT_UNCERTAINTY, **self.uncertainty},
            provenance=self.provenance,
            sha256=sha256,
            path=path,
        )

    def printer(self, sha256: str, path: str) -> Machine:
        """Refuse: it is not a printer."""
        raise MachineFileError(path or self.name, [NO_PRINTER])


AnyDocument = DeltaDocument | StraightDocument | AxisDocument


# kinematics.type -> document; files of an unknown kind are checked as a delta
KINDS: Mapping[str, type[AnyDocument]] = {
    "delta": DeltaDocument,
    "cartesian": StraightDocument,
    "corexy": StraightDocument,
    "axis": AxisDocument,
}


def validated(document: Mapping[str, Any], path: str) -> AnyDocument:
    """Return the document, checked; raise MachineFileError with every mistake otherwise."""
    table = document.get("kinematics")
    kind = KINDS.get(str(table.get("type") if isinstance(table, dict) else None), DeltaDocument)
    problems = kind.missing(document)
    try:
        checked = kind.model_validate(document)
    except ValidationError as error:
        problems += [sentence for mistake in error.errors() for sentence in sentences(mistake, kind)]
    if problems:
        quantities = quantities_of(document)
        raise MachineFileError(path, [quantities.sentence(problem) for problem in problems])
    return checked
