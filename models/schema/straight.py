"""Tables of straight axes: of cartesian and CoreXY printers with their modes, and of one axis by itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from models.arrays import constant
from models.kinematics.cartesian import CARTESIAN, COREXY, CartesianKinematics
from models.schema.table import MODES, TWO, Place, Table, refuse
from models.vibration.modal import Axis, ModalAxes


class StraightTable(Table):
    """Cartesian and CoreXY machines: straight axes, and the box that the nozzle moves in."""

    type: Literal["cartesian", "corexy"]
    x_range_mm: Annotated[list[Place], TWO]
    y_range_mm: Annotated[list[Place], TWO]
    z_range_mm: Annotated[list[Place], TWO]

    @model_validator(mode="after")
    def _possible(self) -> StraightTable:
        refuse(
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
    mount_frequency_hz: float | None = Field(None, ge=1, le=1000)
    belt_damping_share: float | None = Field(None, ge=0, le=1)

    def axis(self) -> Axis:
        """Return the axis with its modes."""
        return Axis(
            self.frequency_hz,
            self.damping_ratio,
            self.share or [1.0],
            self.mass_kg,
            self.mount_frequency_hz,
            self.belt_damping_share or 0.0,
        )


class AxesTable(Table):
    """How each axis answers to its command; one that is left out is rigid."""

    x: AxisTable | None = None
    y: AxisTable | None = None
    z: AxisTable | None = None
    exchange: float | None = Field(None, ge=-0.5, le=0.5)

    @model_validator(mode="after")
    def _possible(self) -> AxesTable:
        tables = {name: getattr(self, name) for name in "xyz" if getattr(self, name) is not None}
        refuse(problem for name, table in tables.items() for problem in _axis_problems(name, table))
        if self.exchange and not (self.x and self.y):
            refuse([f"axes.exchange = {self.exchange:g} needs the modes of both, [axes.x] and [axes.y]."])
        weighed = [name for name, table in tables.items() if table.mass_kg is not None]
        if weighed and len(weighed) < len(tables):
            lacking = next(name for name in tables if name not in weighed)
            refuse(
                [f"axes.{lacking}.mass_kg is missing; axes.{weighed[0]} has one. State the mass of all, or of none."]
            )
        return self

    def model(self) -> ModalAxes:
        """Return the model of the three axes X Y Z, and of what x and y exchange."""
        axes = [Axis() if table is None else table.axis() for table in (self.x, self.y, self.z)]
        return ModalAxes.of(axes, self.exchange or 0.0)


def _axis_problems(name: str, table: AxisTable) -> Iterator[str]:
    modes = len(table.frequency_hz)
    if len(table.damping_ratio) != modes or len(table.share or table.frequency_hz) != modes:
        yield f"axes.{name}: frequency_hz, damping_ratio and share must have as many numbers each, one for each mode."
    elif table.share is None and modes > 1:
        yield f"axes.{name}.share is missing; of several modes it says how much each takes of the response at rest."
    elif table.share is not None and abs(sum(table.share) - 1.0) > 1e-3:
        yield f"axes.{name}.share = {table.share} must sum to 1: at rest an axis stands where it is told to."
    elif table.mount_frequency_hz is not None and not _is_between(table, table.mount_frequency_hz):
        yield (
            f"axes.{name}.mount_frequency_hz = {table.mount_frequency_hz:g} must lie between the frequencies of two "
            "modes, of which the higher one has a share below zero."
        )


def _is_between(table: AxisTable, mount_hz: float) -> bool:
    modes = sorted(zip(table.frequency_hz, table.share or [1.0], strict=True))
    return len(modes) == 2 and modes[0][0] < mount_hz < modes[1][0] and modes[0][1] > 0 > modes[1][1]


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
        refuse(_driven_problems(self))
        return self


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
