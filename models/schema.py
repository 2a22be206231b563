"""What a machine file may say: its tables, ranges and rules, and every mistake as a sentence.

pydantic finds the mistakes; it is imported nowhere else.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from models.arrays import FloatArray, constant
from models.axis.machine import MOVES, AxisMachine, AxisParameters
from models.effects.catalogue import CATALOGUE, effects_of
from models.effects.effect import PER_KILOGRAM
from models.errors import MachineFileError
from models.kinematics.base import Kinematics
from models.kinematics.cartesian import CARTESIAN, COREXY, CartesianKinematics
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine, MotionLimits, Steps
from models.pressure import CORNER_MM_PER_S, REFERENCE_MM_PER_S, Pressure
from models.vibration.base import VibrationModel
from models.vibration.carriage import Carriage, Drive
from models.vibration.delta import DeltaVibration
from models.vibration.effector import Effector
from models.vibration.modal import Axis, ModalAxes

# The ranges hold any printer, and catch most numbers in a wrong unit.
Length = Annotated[float, Field(ge=10, le=2000)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Offset = Annotated[float, Field(ge=-500, le=500)]
Place = Annotated[float, Field(ge=-1000, le=10000)]
Stiffness = Annotated[float, Field(ge=1, le=1e9)]
Damping = Annotated[float, Field(ge=0, le=1e5)]
TWO, THREE = Field(min_length=2, max_length=2), Field(min_length=3, max_length=3)
MODES = Field(min_length=1, max_length=8)

DEFAULT_LIMITS = MotionLimits(velocity_mm_per_s=0, acceleration_mm_per_s2=0)  # these two have no default
DEFAULT_STEPS = Steps()
DEFAULT_UNCERTAINTY = 0.02
NO_PRINTER = (
    'This machine is one axis by itself (kinematics.type = "axis") and has no nozzle, so there is no G-code to plan, '
    "compensate, simulate or record; ffcomp gap, ffcomp diagnose and ffcomp identify fit work on it."
)


class Table(BaseModel):
    """Base of every table: no unknown keys, no conversions."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class StraightTable(Table):
    """Cartesian and CoreXY machines: axes that do not disturb each other."""

    type: Literal["cartesian", "corexy"]
    x_range_mm: Annotated[list[Place], TWO]
    y_range_mm: Annotated[list[Place], TWO]
    z_range_mm: Annotated[list[Place], TWO]

    @model_validator(mode="after")
    def _possible(self) -> StraightTable:
        _refuse(
            f"kinematics.{key} = {value} must be the lowest place first, then the highest one (mm)."
            for key, value in self.model_dump(exclude={"type"}).items()
            if not value[0] < value[1]
        )
        return self

    def geometry(self) -> CartesianKinematics:
        """Return the kinematics."""
        ranges = constant([self.x_range_mm, self.y_range_mm, self.z_range_mm])
        return CartesianKinematics(ranges, CARTESIAN if self.type == "cartesian" else COREXY)


class AxisTable(Table):
    """`[axes.x]` and its like: the modes of one axis."""

    frequency_hz: Annotated[list[Annotated[float, Field(ge=1, le=1000)]], MODES]
    damping_ratio: Annotated[list[Annotated[float, Field(ge=0, lt=1)]], MODES]
    share: Annotated[list[Annotated[float, Field(ge=-10, le=10)]], MODES] | None = None
    mass_kg: float | None = Field(None, ge=0.001, le=1000)

    def axis(self) -> Axis:
        """Return the axis with its modes."""
        return Axis(self.frequency_hz, self.damping_ratio, self.share or [1.0], self.mass_kg)


class AxesTable(Table):
    """How each axis answers to its command; one that is left out is rigid."""

    x: AxisTable | None = None
    y: AxisTable | None = None
    z: AxisTable | None = None

    @model_validator(mode="after")
    def _possible(self) -> AxesTable:
        tables = {name: getattr(self, name) for name in "xyz" if getattr(self, name) is not None}
        _refuse(problem for name, table in tables.items() for problem in _axis_problems(name, table))
        weighed = [name for name, table in tables.items() if table.mass_kg is not None]
        if weighed and len(weighed) < len(tables):
            lacking = next(name for name in tables if name not in weighed)
            _refuse(
                [f"axes.{lacking}.mass_kg is missing; axes.{weighed[0]} has one. State the mass of all, or of none."]
            )
        return self

    def axes(self) -> list[Axis]:
        """Return three axes X Y Z."""
        return [Axis() if table is None else table.axis() for table in (self.x, self.y, self.z)]


class KinematicsTable(Table):
    """`[kinematics]` of a delta."""

    type: Literal["delta"]
    arm_length_mm: Length | None = None
    arm_lengths_mm: Annotated[list[Length], THREE] | None = None
    delta_radius_mm: Length | None = None
    delta_radii_mm: Annotated[list[Length], THREE] | None = None
    tower_angles_deg: Annotated[list[Angle], THREE]
    effector_height_mm: float = Field(ge=0, le=500)
    print_radius_mm: float = Field(ge=5, le=1500)
    print_height_mm: float = Field(ge=5, le=5000)

    @model_validator(mode="after")
    def _possible(self) -> KinematicsTable:
        if self.arms_mm is not None and self.radii_mm is not None:
            _refuse([*_tower_problems(self), *_arm_problems(self)])
        return self  # a missing length is found by _missing_lengths, together with all else that is wrong

    @property
    def arms_mm(self) -> list[float] | None:
        """Of each tower; the numbers per tower go before the one for all."""
        return self.arm_lengths_mm or (self.arm_length_mm and [self.arm_length_mm] * 3) or None

    @property
    def radii_mm(self) -> list[float] | None:
        """Return the radius of each tower."""
        return self.delta_radii_mm or (self.delta_radius_mm and [self.delta_radius_mm] * 3) or None

    def geometry(self) -> DeltaKinematics:
        """Return the kinematics."""
        return DeltaKinematics(
            arm_lengths_mm=_known(self.arms_mm),
            delta_radii_mm=_known(self.radii_mm),
            tower_angles_deg=constant(self.tower_angles_deg),
            effector_height_mm=self.effector_height_mm,
            print_radius_mm=self.print_radius_mm,
            print_height_mm=self.print_height_mm,
        )


class OneAxisTable(Table):
    """`[kinematics]` of one axis by itself."""

    type: Literal["axis"]


class DrivenAxisTable(Table):
    """`[axis]` of one axis by itself."""

    input: Literal["position", "force"]
    mass_kg: float = Field(ge=0.0001, le=1e6)
    stiffness_n_per_m: float = Field(ge=0, le=1e12)
    damping_n_s_per_m: float = Field(ge=0, le=1e9)
    load_mass_kg: float | None = Field(None, ge=0.0001, le=1e6)
    coupling_stiffness_n_per_m: float | None = Field(None, ge=1e-3, le=1e12)
    coupling_damping_n_s_per_m: float = Field(0.0, ge=0, le=1e9)
    offset_n: float = Field(0.0, ge=-1e6, le=1e6)

    @model_validator(mode="after")
    def _possible(self) -> DrivenAxisTable:
        _refuse(_driven_problems(self))
        return self


class DriveTable(Table):
    """`[carriage.drive]`."""

    d0_per_s2: float = Field(ge=100, le=1e10)
    d1_per_s: float = Field(ge=-1e6, le=1e6)
    d2_per_s: float = Field(ge=0.01, le=1e6)


class CarriageTable(Table):
    """`[carriage]`."""

    mass_kg: float = Field(ge=0.001, le=20)
    arm_pair_mass_kg: float = Field(ge=0, le=5)
    arm_mass_share_at_ends: float = Field(1.0, ge=0, le=1)
    belt_stiffness_n_per_m: float = Field(ge=1e3, le=1e9)
    belt_damping_n_s_per_m: Damping
    guide_damping_n_s_per_m: Damping
    drive: DriveTable | None = None

    def carriage(self) -> Carriage:
        """Return the carriage."""
        drive = None if self.drive is None else Drive(**self.drive.model_dump())
        return Carriage(**self.model_dump(exclude={"drive"}), drive=drive)


class EffectorTable(Table):
    """`[effector]`."""

    nozzle_mass_kg: float = Field(ge=0.001, le=20)
    extruder_mass_kg: float = Field(ge=0.0001, le=20)
    extruder_stiffness_n_per_m: Annotated[list[Stiffness], THREE]
    extruder_damping_n_s_per_m: Annotated[list[Damping], THREE]
    joint_radius_mm: float = Field(ge=1, le=500)
    center_of_mass_mm: Annotated[list[Offset], THREE]
    force_map: Literal["virtual_work", "paper"] = "virtual_work"

    def effector(self) -> Effector:
        """Return the effector."""
        values = self.model_dump()
        arrays = {key: constant(value) for key, value in values.items() if isinstance(value, list)}
        return Effector(**{**values, **arrays})


class LimitsTable(Table):
    """`[limits]`."""

    velocity_mm_per_s: float = Field(ge=1, le=1e4)
    acceleration_mm_per_s2: float = Field(ge=10, le=1e6)
    square_corner_velocity_mm_per_s: float = Field(DEFAULT_LIMITS.square_corner_velocity_mm_per_s, ge=0, le=1000)
    carriage_velocity_mm_per_s: float = Field(DEFAULT_LIMITS.carriage_velocity_mm_per_s, ge=1, le=1e4)
    carriage_acceleration_mm_per_s2: float = Field(DEFAULT_LIMITS.carriage_acceleration_mm_per_s2, ge=10, le=1e7)
    z_velocity_mm_per_s: float | None = Field(None, ge=0.1, le=1e4)
    z_acceleration_mm_per_s2: float | None = Field(None, ge=1, le=1e6)
    carriage_travel_mm: Annotated[list[Place], TWO] | None = None
    step_rate_hz: float | None = Field(None, ge=100, le=1e8)

    @model_validator(mode="after")
    def _possible(self) -> LimitsTable:
        travel = self.carriage_travel_mm
        if travel is not None and not travel[0] < travel[1]:
            _refuse([f"limits.carriage_travel_mm = {travel} must be the lower place first, then the higher one (mm)."])
        return self

    def limits(self) -> MotionLimits:
        """Return the limits."""
        travel = self.carriage_travel_mm
        return MotionLimits(
            **self.model_dump(exclude={"carriage_travel_mm"}),
            carriage_travel_mm=None if travel is None else (travel[0], travel[1]),
        )


Microsteps = Annotated[float, Field(ge=1, le=1e5)]
FullSteps = Annotated[float, Field(ge=0.1, le=1000)]


class StepsTable(Table):
    """`[steps]`."""

    steps_per_mm: Microsteps | Annotated[list[Microsteps], THREE] = 80.0
    full_steps_per_mm: FullSteps | Annotated[list[FullSteps], THREE] = 5.0
    extruder_steps_per_mm: float | None = Field(None, ge=1, le=1e5)

    @model_validator(mode="after")
    def _microsteps(self) -> StepsTable:
        whole, micro = self.full_steps_per_mm, self.steps_per_mm
        if (np.atleast_1d(whole) > np.atleast_1d(micro)).any():
            rule = f"must not exceed steps_per_mm = {_shown(micro)}: a full step holds at least one microstep."
            _refuse([f"steps.full_steps_per_mm = {_shown(whole)} {rule}"])
        return self

    def steps(self) -> Steps:
        """Return the steps."""
        return Steps(
            _number_or_tuple(self.steps_per_mm),
            _number_or_tuple(self.full_steps_per_mm),
            self.extruder_steps_per_mm,
            tuple(sorted(self.model_fields_set)),
        )


class ExtruderTable(Table):
    """`[extruder]`: what the hot end keeps back."""

    pressure_time_constant_s: float = Field(gt=0, le=2)
    pressure_flow_exponent: float = Field(1.0, ge=0.2, le=2)
    pressure_reference_mm_per_s: float = Field(REFERENCE_MM_PER_S, ge=0.01, le=100)
    firmware_advance_s: float = Field(0.0, ge=0, le=2)
    corner_velocity_mm_per_s: float = Field(CORNER_MM_PER_S, ge=0.01, le=1000)

    def pressure(self) -> Pressure:
        """Return the model of the pressure."""
        return Pressure(
            self.pressure_time_constant_s,
            self.pressure_flow_exponent,
            self.pressure_reference_mm_per_s,
            self.firmware_advance_s,
            self.corner_velocity_mm_per_s,
        )


class FirmwareTable(Table):
    """`[firmware]`: which one the printer runs."""

    flavor: Literal["klipper", "marlin", "reprapfirmware"] | None = None


MacroName = Annotated[str, Field(pattern=r"^@?[A-Za-z_]\w*$")]


class MacrosTable(Table):
    """`[macros]`: what is known of the printer's own."""

    returns: list[MacroName] | None = None
    still: list[MacroName] | None = None


class HomingTable(Table):
    """`[homing]`: where homing all axes ends."""

    position_mm: Annotated[list[Place], THREE] | None = None


def _number_or_tuple(value: float | list[float]) -> float | tuple[float, ...]:
    return tuple(value) if isinstance(value, list) else value


def _shown(value: float | list[float]) -> str:
    return ", ".join(f"{number:g}" for number in np.atleast_1d(value))


class Document(Table):
    """What every kind of machine has."""

    moves: ClassVar[str]  # as in `Effect.of`
    format: Literal["ffcomp-machine/1"]
    name: str = Field(min_length=1)

    @field_validator("effects", check_fields=False)
    @classmethod
    def _known_effects(cls, effects: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        _refuse(problem for name, table in effects.items() for problem in _effect_problems(name, table))
        return effects

    @field_validator("uncertainty", check_fields=False)
    @classmethod
    def _known_numbers(cls, uncertainty: dict[str, float]) -> dict[str, float]:
        known = ["default", *number_keys(cls), *_effect_keys()]
        _refuse(
            f'uncertainty."{key}" names no number of this file.{did_you_mean(key, known)}'
            for key in uncertainty
            if key not in known
        )
        return uncertainty

    @field_validator("effects", check_fields=False)
    @classmethod
    def _of_this_kind(cls, effects: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        _refuse_others(effects, cls.moves, NO_EFFECT_OF[cls.moves])
        return effects

    @property
    def per_kilogram(self) -> bool:
        """Return whether the file states forces of effects per kilogram."""
        return False

    @classmethod
    def missing(cls, document: Mapping[str, Any]) -> list[str]:
        """Return sentences about tables' keys of which one or another must be there."""
        return []


NO_EFFECT_OF: Mapping[str, str] = {
    "carriages": "a delta: it has no straight axes",
    "axes": "a machine with straight axes: they have no arms and no effector",
    "axis": "one axis by itself: it is no printer",
}


class PrinterDocument(Document):
    """What every printer has."""

    limits: LimitsTable
    steps: StepsTable = StepsTable()
    extruder: ExtruderTable | None = None
    firmware: FirmwareTable = FirmwareTable()
    macros: MacrosTable = MacrosTable()
    homing: HomingTable = HomingTable()
    effects: dict[str, dict[str, Any]] = {}
    uncertainty: dict[str, Annotated[float, Field(ge=0, le=10)]] = {}
    provenance: dict[str, Any] = {}

    def machine_parts(self) -> tuple[Kinematics, VibrationModel]:
        """Return kinematics and vibration model."""
        raise NotImplementedError

    def machine(self, sha256: str, path: str) -> Machine:
        """Return the machine that the file describes."""
        return self.printer(sha256, path)

    def printer(self, sha256: str, path: str) -> Machine:
        """Return the printer that the file describes."""
        kinematics, vibration = self.machine_parts()
        home = self.homing.position_mm
        return Machine(
            name=self.name,
            kinematics=kinematics,
            vibration=vibration,
            limits=self.limits.limits(),
            steps=self.steps.steps(),
            effects=self.effects,
            uncertainty={"default": DEFAULT_UNCERTAINTY, **self.uncertainty},
            provenance=self.provenance,
            sha256=sha256,
            path=path,
            returns=tuple(self.macros.returns or ()),
            still=tuple(self.macros.still or ()),
            homed_mm=None if home is None else (home[0], home[1], home[2]),
            flavor=self.firmware.flavor or "",
            pressure=None if self.extruder is None else self.extruder.pressure(),
        )


class DeltaDocument(PrinterDocument):
    """The file of a delta."""

    moves: ClassVar[str] = "carriages"
    kinematics: KinematicsTable
    carriage: CarriageTable
    effector: EffectorTable

    @classmethod
    def missing(cls, document: Mapping[str, Any]) -> list[str]:
        """Return sentences about lengths that are not there."""
        return _missing_lengths(document)

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
        return self.kinematics.geometry(), ModalAxes.of(self.axes.axes())

    @property
    def per_kilogram(self) -> bool:
        """Return whether the file states forces of effects per kilogram: no axis states its mass."""
        return self.machine_parts()[1].per_kilogram

    @model_validator(mode="before")
    @classmethod
    def _forces_per_kilogram(cls, document: Any) -> Any:
        """Read `force_n_per_kg` as `force_n` of axes whose mass is 1, where no axis states its mass."""
        tables, axes = document.get("effects"), document.get("axes")
        if not isinstance(tables, dict):
            return document
        weighed = isinstance(axes, dict) and any(isinstance(t, dict) and "mass_kg" in t for t in axes.values())
        _refuse(
            problem for name, table in tables.items() for problem in _mass_problems(name, table, weighed) if problem
        )
        return {**document, "effects": {name: _plain_keys(table) for name, table in tables.items()}}


class AxisDocument(Document):
    """The file of one axis by itself."""

    moves: ClassVar[str] = MOVES
    kinematics: OneAxisTable
    axis: DrivenAxisTable
    effects: dict[str, dict[str, Any]] = {}
    uncertainty: dict[str, Annotated[float, Field(ge=0, le=10)]] = {}
    provenance: dict[str, Any] = {}

    def machine(self, sha256: str, path: str) -> AxisMachine:
        """Return the axis that the file describes."""
        return AxisMachine(
            self.name,
            AxisParameters(**self.axis.model_dump()),
            self.effects,
            {"default": DEFAULT_UNCERTAINTY, **self.uncertainty},
            self.provenance,
            sha256,
            path,
        )

    def printer(self, sha256: str, path: str) -> Machine:
        """Refuse: there is no printer in it."""
        raise MachineFileError(path or self.name, [NO_PRINTER])


AnyDocument = DeltaDocument | StraightDocument | AxisDocument

# kinematics.type -> what a file of this kind holds; of any other, a delta's mistakes are told
KINDS: Mapping[str, type[AnyDocument]] = {
    "delta": DeltaDocument,
    "cartesian": StraightDocument,
    "corexy": StraightDocument,
    "axis": AxisDocument,
}


def validated(document: Mapping[str, Any], path: str) -> AnyDocument:
    """Return the document, checked; raise MachineFileError with every mistake otherwise."""
    kind = KINDS.get(str(_kind(document)), DeltaDocument)
    problems = kind.missing(document)
    try:
        checked = kind.model_validate(document)
    except ValidationError as error:
        problems += [sentence for mistake in error.errors() for sentence in _sentences(mistake, kind)]
    if problems:
        raise MachineFileError(path, problems)
    return checked


def _kind(document: Mapping[str, Any]) -> object:
    table = document.get("kinematics")
    return table.get("type") if isinstance(table, dict) else None


def number_keys(table: type[BaseModel]) -> Iterator[str]:
    """Every number a machine file may hold, as `table.key`."""
    for name, field in table.model_fields.items():
        inner = _table_of(field.annotation)
        if inner is not None:
            yield from (f"{name}.{key}" for key in number_keys(inner))
        elif unit_of(name) or name == "damping_ratio":
            yield name


# --- Rules between numbers. Sentences, so that one validator can report several mistakes.


def _refuse(problems: Iterable[str]) -> None:
    """Tell pydantic, which carries the text to `_sentences`."""
    text = "\n".join(problems)
    if text:
        raise ValueError(text)


def _refuse_others(effects: Iterable[str], moves: str, kind: str) -> None:
    """Refuse effects that this kind of machine cannot have."""
    able = effects_of(moves)
    _refuse(
        f"effects.{name} is none of {kind}. Known there: {', '.join(able)}."
        for name in effects
        if name in CATALOGUE and name not in able
    )


def _mass_problems(name: str, table: Any, weighed: bool) -> Iterator[str]:
    """Yield what is wrong with the keys of forces of an effect on axes whose mass is stated, or is not."""
    if name not in CATALOGUE or not isinstance(table, dict):
        return
    for key in table:
        plain = key.removesuffix(PER_KILOGRAM)
        if plain not in CATALOGUE[name].by_name or not CATALOGUE[name].parameter(plain).of_mass:
            continue
        if weighed and plain != key:
            yield f"effects.{name}.{key}: the axes state their mass_kg, so this is {plain}."
        elif not weighed and plain == key:
            yield (
                f"effects.{name}.{key}: no axis states its mass. State axes.x.mass_kg and axes.y.mass_kg, "
                f"or give {key}{PER_KILOGRAM}, per kilogram of what the axis moves."
            )


def _plain_keys(table: Any) -> Any:
    if not isinstance(table, dict):
        return table
    return {key.removesuffix(PER_KILOGRAM): value for key, value in table.items()}


def _axis_problems(name: str, table: AxisTable) -> Iterator[str]:
    modes = len(table.frequency_hz)
    if len(table.damping_ratio) != modes or len(table.share or table.frequency_hz) != modes:
        yield f"axes.{name}: frequency_hz, damping_ratio and share must have as many numbers each, one for each mode."
    elif table.share is None and modes > 1:
        yield f"axes.{name}.share is missing; of several modes it says how much each takes of the response at rest."
    elif table.share is not None and abs(sum(table.share) - 1.0) > 1e-3:
        yield f"axes.{name}.share = {table.share} must sum to 1: at rest an axis stands where it is told to."


def _driven_problems(table: DrivenAxisTable) -> Iterator[str]:
    if table.input == "position" and table.stiffness_n_per_m == 0:
        yield (
            "axis.stiffness_n_per_m = 0: nothing ties the axis to its commanded position. Give the stiffness of its "
            'drive (belt, screw, servo), or input = "force".'
        )
    if (table.load_mass_kg is None) != (table.coupling_stiffness_n_per_m is None):
        yield "axis.load_mass_kg and axis.coupling_stiffness_n_per_m belong together: a load hangs at a coupling."
    if table.load_mass_kg is None and table.coupling_damping_n_s_per_m:
        yield "axis.coupling_damping_n_s_per_m is of a coupling; give axis.load_mass_kg and its stiffness, or neither."


def _missing_lengths(document: Mapping[str, Any]) -> list[str]:
    table = document.get("kinematics")
    if not isinstance(table, dict):
        return []
    pairs = (("arm_length_mm", "arm_lengths_mm"), ("delta_radius_mm", "delta_radii_mm"))
    return [
        f"kinematics.{one} is missing; give it, or {three} with a number for each tower."
        for one, three in pairs
        if one not in table and three not in table
    ]


def _known(lengths: list[float] | None) -> FloatArray:
    assert lengths is not None, "validated() refuses a file without its lengths"
    return constant(lengths)


def _tower_problems(table: KinematicsTable) -> Iterator[str]:
    angles = np.sort(np.mod(table.tower_angles_deg, 360))
    gaps = [*(after - before for before, after in pairwise(angles)), angles[0] + 360 - angles[2]]
    if max(gaps) >= 180 or min(gaps) < 30:
        yield (
            f"kinematics.tower_angles_deg = {table.tower_angles_deg}: the towers must stand around the bed, "
            "neighbours at least 30 and less than 180 degrees apart."
        )


def _arm_problems(table: KinematicsTable) -> Iterator[str]:
    geometry = table.geometry()
    farthest = geometry.delta_radii_mm + geometry.print_radius_mm
    for tower, arm, needed in zip("ABC", geometry.arm_lengths_mm, farthest, strict=True):
        if arm <= needed:
            yield (
                f"kinematics: the arm of tower {tower}, {arm:g} mm, is too short: it must be longer than the "
                f"delta radius and print_radius_mm together, {needed:g} mm, to reach the bed's far side."
            )


def _effect_problems(name: str, table: Mapping[str, Any]) -> Iterator[str]:
    if name not in CATALOGUE:
        yield f"effects.{name} is not an effect ffcomp knows.{did_you_mean(name, CATALOGUE)}"
        return
    effect = CATALOGUE[name]
    for key, value in table.items():
        if key not in effect.by_name:
            yield f"effects.{name}.{key} is not a parameter of this effect.{did_you_mean(key, effect.by_name)}"
        elif rule := effect.parameter(key).problem(value):
            yield f"effects.{name}.{key} = {value!r} {rule}."
    for key in effect.missing(table):
        yield f"effects.{name}.{key} is missing; {effect.parameter(key).meaning}."


def _effect_keys() -> Iterator[str]:
    for name, effect in CATALOGUE.items():
        yield from (f"effects.{name}.{parameter}" for parameter in effect.by_name)


def _table_of(annotation: Any) -> type[Table] | None:
    """Return the table behind `X` or `X | None`."""
    for candidate in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, Table):
            return candidate
    return None


# --- Mistakes as sentences

UNITS = {  # endings of keys; a longer one goes before one it ends in
    "_n_s_per_m": "N s/m",
    "_mm_per_s2": "mm/s²",
    "_mm_per_s": "mm/s",
    "_n_per_m": "N/m",
    "_per_mm": "1/mm",
    "_per_s2": "1/s²",
    "_per_s": "1/s",
    "_deg": "degrees",
    "_mm": "mm",
    "_kg": "kg",
    "_hz": "Hz",
}

RULES = {  # pydantic's type of error -> our rule, filled in from its context
    "greater_than_equal": "must be at least {ge:g}{unit}",
    "less_than_equal": "must be at most {le:g}{unit}",
    "greater_than": "must be greater than {gt:g}{unit}",
    "less_than": "must be less than {lt:g}{unit}",
    "float_type": "must be a number{unit}",
    "finite_number": "must be a finite number{unit}",
    "string_type": "must be a text in quotes",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must be a name: a letter or _ first, then letters, digits and _",
    "list_type": "must be a list of {count} numbers{unit}",
    "too_short": "must be a list of {count} numbers{unit}",
    "too_long": "must be a list of {count} numbers{unit}",
    "dict_type": "must be a table",
    "model_type": "must be a table",
}


PAIRS = ("limits.carriage_travel_mm", *(f"kinematics.{axis}_range_mm" for axis in "xyz"))  # lists of two numbers


def unit_of(key: str) -> str:
    """Return the unit a key's name ends in, '' if none."""
    return next((unit for ending, unit in UNITS.items() if key.endswith(ending)), "")


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """' Did you mean …?' or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" Did you mean {close[0]!r}?" if close else ""


def _sentences(error: Mapping[str, Any], kind: type[Document]) -> list[str]:
    """One of pydantic's errors in our words (a validator of ours may have found several mistakes)."""
    context = {**error.get("ctx", {}), "document": kind}
    if error["type"] == "value_error":
        return str(context["error"]).split("\n")
    write = SENTENCES.get(error["type"], _broken_rule)
    return [write(error["loc"], error["input"], error["type"], context)]


def _missing(loc: tuple[int | str, ...], value: object, kind: str, context: Mapping[str, Any]) -> str:
    return f"{_key(loc)} is missing."


def _unknown_key(loc: tuple[int | str, ...], value: object, kind: str, context: Mapping[str, Any]) -> str:
    return f"{_key(loc)} is not a key of a machine file.{_right_key(loc, context['document'])}"


def _wrong_word(loc: tuple[int | str, ...], value: object, kind: str, context: Mapping[str, Any]) -> str:
    expected = context["expected"]
    return f"{_key(loc)} = {value!r} must be {expected}.{did_you_mean(str(value), expected.split(chr(39)))}"


def _broken_rule(loc: tuple[int | str, ...], value: object, kind: str, context: Mapping[str, Any]) -> str:
    unit = unit_of(_key(loc).split("[")[0])
    count = "two" if _key(loc) in PAIRS else "one to eight" if _key(loc).startswith("axes.") else "three"
    rule = RULES[kind].format(**context, count=count, unit=f" ({unit})" if unit else "")
    return f"{_key(loc)} = {'{…}' if isinstance(value, dict) else repr(value)} {rule}."


SENTENCES: dict[str, Callable[..., str]] = {
    "missing": _missing,
    "extra_forbidden": _unknown_key,
    "literal_error": _wrong_word,
}


def _key(loc: tuple[int | str, ...]) -> str:
    """`table.key`, or `table.key[index]` of a list."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc).lstrip(".")


def _right_key(loc: tuple[int | str, ...], document: type[Table]) -> str:
    """Suggest for an unknown key the same key in another table, or the nearest one in its own."""
    word = str(loc[-1])
    elsewhere = [key for key in number_keys(document) if key.endswith(f".{word}")]
    if elsewhere:
        return f" Did you mean {elsewhere[0]!r}?"
    table = document
    for part in loc[:-1]:
        table = _table_of(table.model_fields[str(part)].annotation) or table
    return did_you_mean(word, table.model_fields)
