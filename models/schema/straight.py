"""Tables of straight axes: of cartesian and CoreXY printers with their modes, and of one axis by itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from models.arrays import constant
from models.kinematics.cartesian import CARTESIAN, COREXY, CartesianKinematics
from models.quantities import Quantities
from models.schema.table import MODES, TWO, Place, Table, refuse
from models.vibration.driven_axis import Drive, DrivenAxis, Hold, Input
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
    """`[axes.x]` and similar: the modes of one axis."""

    frequency_hz: Annotated[list[Annotated[float, Field(ge=1, le=1000)]], MODES]
    damping_ratio: Annotated[list[Annotated[float, Field(ge=0, lt=1)]], MODES]
    share: Annotated[list[Annotated[float, Field(ge=-10, le=10)]], MODES] | None = None
    mass_kg: float | None = Field(None, ge=0.001, le=1000)
    mount_frequency_hz: float | None = Field(None, ge=1, le=1000)
    belt_damping_share: float | None = Field(None, ge=0, le=1)

    def axis(self) -> Axis:
        """Return the axis with its modes."""
        return Axis(**self.model_dump(exclude_none=True))


class AxesTable(Table):
    """Modes of the axes; an axis that is left out is rigid."""

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
        """Return the model of the three axes X Y Z, and of the exchange between x and y."""
        axes = [Axis() if table is None else table.axis() for table in (self.x, self.y, self.z)]
        return ModalAxes.of(axes, self.exchange or 0.0)


def _axis_problems(name: str, table: AxisTable) -> Iterator[str]:
    modes = len(table.frequency_hz)
    if len(table.damping_ratio) != modes or len(table.share or table.frequency_hz) != modes:
        yield f"axes.{name}: frequency_hz, damping_ratio and share must have as many numbers each, one for each mode."
    elif table.share is None and modes > 1:
        yield f"axes.{name}.share is missing; with several modes it is each mode's share of the static response."
    elif table.share is not None and abs(sum(table.share) - 1.0) > 1e-3:
        yield f"axes.{name}.share = {table.share} must sum to 1, because at rest the axis is at its commanded position."
    elif (mount_hz := table.mount_frequency_hz) is not None:
        (low, first), (high, second) = [*sorted(zip(table.frequency_hz, table.share or [1.0], strict=True)), (0, 0)][:2]
        if modes != 2 or not (low < mount_hz < high and first > 0 > second):
            yield (
                f"axes.{name}.mount_frequency_hz = {mount_hz:g} must lie between the frequencies of two modes, and the "
                "higher mode's share must be negative."
            )


class OneAxisTable(Table):
    """`[kinematics]` of one axis by itself."""

    type: Literal["axis"]


class DriveTable(Table):
    """`[axis.drive]` of one axis by itself."""

    force_constant_n_per_a: float | None = Field(None, ge=1e-9, le=1e9)
    resistance_ohm: float | None = Field(None, ge=1e-6, le=1e6)
    supply_v: float | None = Field(None, ge=1e-3, le=1e6)
    gain_v_per_m: float = Field(0.0, ge=0, le=1e12)
    rate_gain_v_s_per_m: float = Field(0.0, ge=0, le=1e12)
    current_limit_a: float | None = Field(None, ge=1e-6, le=1e6)
    force_limit_n: float | None = Field(None, ge=1e-12, le=1e12)
    hold: Hold = "straight"
    delay_s: float = Field(0.0, ge=-0.1, le=0.1)


class DrivenAxisTable(Table):
    """`[axis]` of one axis by itself."""

    input: Input
    unit: Literal["", "mm", "rad"] = ""
    mass_kg: float = Field(ge=1e-12, le=1e6)
    stiffness_n_per_m: float | None = Field(None, ge=0, le=1e12)
    damping_n_s_per_m: float = Field(ge=0, le=1e9)
    load_mass_kg: float | None = Field(None, ge=1e-12, le=1e6)
    coupling_stiffness_n_per_m: float | None = Field(None, ge=1e-9, le=1e12)
    coupling_damping_n_s_per_m: float = Field(0.0, ge=0, le=1e9)
    offset_n: float = Field(0.0, ge=-1e6, le=1e6)
    drive_damping_n_s_per_m: float = Field(0.0, ge=0, le=1e9)
    drive: DriveTable = DriveTable()

    @model_validator(mode="after")
    def _possible(self) -> DrivenAxisTable:
        refuse(_driven_problems(self))
        return self

    def axis(self) -> DrivenAxis:
        """Return the axis."""
        numbers = self.model_dump(exclude={"drive"}) | {"stiffness_n_per_m": self.stiffness_n_per_m or 0.0}
        return DrivenAxis(**numbers, drive=Drive(**self.drive.model_dump()))


def quantities_of(document: Mapping[str, Any]) -> Quantities:
    """Return how a file, checked or not, names and scales its numbers; the printers' way if it is malformed."""
    table = document.get("axis")
    axis: Mapping[str, Any] = table if isinstance(table, Mapping) else {}
    drive = axis.get("drive")
    constant = isinstance(drive, Mapping) and any("_constant_" in str(key) for key in drive)
    inputs = {"current": "A", "voltage": "V", "duty": "V"}
    force = "N" if constant else inputs.get(str(axis.get("input")), "N")
    return Quantities("rad" if axis.get("unit") == "rad" else "m", force)  # type: ignore[arg-type]


def _driven_problems(table: DrivenAxisTable) -> Iterator[str]:
    yield from _drive_problems(table)
    if table.stiffness_n_per_m is None and not table.drive.gain_v_per_m:
        yield "axis.stiffness_n_per_m is missing (0 if nothing holds the axis)."
    elif table.input == "position" and not table.stiffness_n_per_m and not table.drive.gain_v_per_m:
        yield (
            "axis.stiffness_n_per_m = 0: nothing ties the axis to its commanded position. Give the stiffness of its "
            "drive (belt, screw, servo), the law of its servo (axis.drive.gain_v_per_m, force_constant_n_per_a and "
            'resistance_ohm), or input = "force".'
        )
    if (table.load_mass_kg is None) != (table.coupling_stiffness_n_per_m is None):
        yield "axis.load_mass_kg and axis.coupling_stiffness_n_per_m belong together: state both, or neither."
    if table.load_mass_kg is None and table.coupling_damping_n_s_per_m:
        yield "axis.coupling_damping_n_s_per_m needs axis.load_mass_kg and axis.coupling_stiffness_n_per_m."


def _drive_problems(table: DrivenAxisTable) -> Iterator[str]:
    drive, by = table.drive, table.input
    if by != "position" and (table.drive_damping_n_s_per_m or drive.gain_v_per_m or drive.rate_gain_v_s_per_m):
        yield f'axis.input = {by!r}: a damper across the drive and a servo law follow a position, input = "position".'
    if (by in ("voltage", "duty") or drive.gain_v_per_m) and (
        (drive.force_constant_n_per_a is None) != (drive.resistance_ohm is None)
    ):
        yield (
            "axis.drive.force_constant_n_per_a and axis.drive.resistance_ohm belong together with a voltage input: "
            "state both, or neither, and all forces per volt."
        )
    if by == "duty" and drive.force_constant_n_per_a is not None and drive.supply_v is None:
        yield "axis.drive.supply_v is missing; a duty is a fraction of it. A column supply_v of a run overrides it."
    if drive.current_limit_a is not None and by != "current":
        yield 'axis.drive.current_limit_a needs input = "current"; else state axis.drive.force_limit_n.'
    if drive.hold == "steps" and by == "position":
        yield 'axis.drive.hold = "steps" needs a force, current, voltage or duty input; a position is a cubic spline.'
    if drive.rate_gain_v_s_per_m and not drive.gain_v_per_m:
        yield "axis.drive.rate_gain_v_s_per_m needs axis.drive.gain_v_per_m."
