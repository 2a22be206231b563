"""Tables of one axis by itself, and the rules between their numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field, model_validator

from models.schema.table import Table, refuse


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
