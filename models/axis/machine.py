"""One axis as frozen data: what drives it, its masses, springs and dampers, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

MOVES = "axis"  # in `Effect.of`, as `VibrationModel.moves` of printers


@dataclass(frozen=True)
class AxisParameters:
    """The `[axis]` table of a machine file."""

    input: Literal["position", "force"]
    mass_kg: float  # of the motor's side, or of all
    stiffness_n_per_m: float  # to the commanded position, or to the ground where a force drives; 0: none
    damping_n_s_per_m: float  # of the first mass against the ground
    load_mass_kg: float | None = None  # of a second mass that hangs at the first
    coupling_stiffness_n_per_m: float | None = None
    coupling_damping_n_s_per_m: float = 0.0
    offset_n: float = 0.0  # a force that is always there: a slope, or the zero of the force's sensor

    @property
    def by_force(self) -> bool:
        """Tell whether a force drives the axis, not a position."""
        return self.input == "force"

    @property
    def free(self) -> bool:
        """Tell whether nothing holds the axis at a place."""
        return self.stiffness_n_per_m == 0.0

    @property
    def moved_kg(self) -> float:
        """Return the mass of all that moves."""
        return self.mass_kg + (self.load_mass_kg or 0.0)

    @property
    def last_stiffness(self) -> float:
        """Return the stiffness of the spring at the end, which may have play and may harden; 0: there is none."""
        return self.coupling_stiffness_n_per_m or self.stiffness_n_per_m


@dataclass(frozen=True, eq=False)
class AxisMachine:
    """Everything the machine file of an axis says."""

    name: str
    axis: AxisParameters
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""
    path: str = ""

    moves: ClassVar[str] = MOVES

    @property
    def tunable(self) -> tuple[str, ...]:
        """Return the file's numbers that a measurement may correct."""
        names = ("mass_kg", "stiffness_n_per_m", "damping_n_s_per_m", "load_mass_kg", "coupling_stiffness_n_per_m")
        return tuple(f"axis.{n}" for n in (*names, "coupling_damping_n_s_per_m") if getattr(self.axis, n))

    def value(self, name: str) -> float:
        """Return one of the file's numbers, `axis.mass_kg`."""
        return float(getattr(self.axis, name.removeprefix("axis.")))

    def with_values(self, values: Mapping[str, float]) -> AxisMachine:
        """Return the axis with some of its numbers replaced."""
        own: dict[str, Any] = {
            name.removeprefix("axis."): float(x) for name, x in values.items() if name.startswith("axis.")
        }
        return replace(self, axis=replace(self.axis, **own)) if own else self
