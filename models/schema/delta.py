"""Tables of a delta: towers, carriages and effector, and the rules between their numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from models.arrays import FloatArray, constant
from models.kinematics.delta import DeltaKinematics
from models.schema.table import THREE, Angle, Damping, Length, Offset, Stiffness, Table, refuse
from models.vibration.substructures import Carriage, Drive, Effector


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
            refuse([*_tower_problems(self), *_arm_problems(self)])
        return self  # a missing length is found by missing_lengths, together with all other mistakes

    @property
    def arms_mm(self) -> list[float] | None:
        """Return the arm of each tower; numbers per tower override the common one."""
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


def missing_lengths(document: Mapping[str, Any]) -> list[str]:
    """Return sentences about lengths that are given neither for all towers nor for each."""
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
