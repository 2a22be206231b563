"""Kinematics of a machine: nozzle position from actuator positions, reach, and the firmware's view of both.

An actuator ("carriage") is commanded and vibrates on its belt: a delta's three carriages, or the three axes of a
machine with independent axes. A motor makes steps: on deltas and cartesian machines each carriage has its own; on
CoreXY x and y share two.

mm, s; arrays of n points; carriages in the order A B C or X Y Z, motors A B C.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Protocol

import numpy as np

from models.arrays import BoolArray, FloatArray
from models.errors import UnreachableError

SLACK_MM = 1e-6  # a point on the rim, written with rounded digits, is inside
INSIDE_MM = 1e-4  # margin of a command to the border: the last digit of the text

TOWERS, AXES = ("A", "B", "C"), ("x", "y", "z")
ALONG: Mapping[str, tuple[str, ...]] = {"xy": AXES[:2], **{axis: (axis,) for axis in AXES}}


class Compiled(Protocol):
    """The equations compiled and unchecked, (n, 3) in and out; points out of reach become NaN."""

    def inverse(self, xyz: FloatArray) -> FloatArray:
        """Return carriages of nozzle positions, mm."""

    def forward(self, q: FloatArray) -> FloatArray:
        """Return nozzle positions of carriages, mm."""

    def rate_term(self, xyz: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return J̇ q̇, mm/s²."""


class Kinematics(ABC):
    """One kind of kinematics with its numbers."""

    calibration_tolerances: ClassVar[Mapping[str, float]]
    """Field -> difference that two files of the same printer may have."""
    excitation_directions: ClassVar[Mapping[str, tuple[str, ...]]]
    """Name of a group -> what to excite, one after the other; the first group is the default."""
    raisable_axes: ClassVar[str]
    """Axes whose limits a compensated file may raise above the plan's."""

    @abstractmethod
    def inverse(self, xyz: FloatArray) -> FloatArray:
        """Return carriages (n, 3) mm of nozzle positions (n, 3) mm."""

    @abstractmethod
    def forward(self, q: FloatArray) -> FloatArray:
        """Return nozzle positions (n, 3) mm of carriages (n, 3) mm."""

    @abstractmethod
    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return J with Ẋ = J q̇ at positions (n, 2) mm; further columns are ignored. (n, 3, 3), rows X Y Z."""

    @abstractmethod
    def compiled(self) -> Compiled:
        """Return the compiled equations, for inner loops."""

    @abstractmethod
    def volume_rules(self, xyz: FloatArray) -> list[tuple[BoolArray, str]]:
        """Return which of the points (n, 3) mm obey each rule of the print volume, and where the others lie."""

    def check_reach(self, xyz: FloatArray) -> None:
        """Raise UnreachableError if any of the points (n, 3) mm lies outside the print volume."""
        for good, where in self.volume_rules(xyz):
            require(good, xyz, f"The point X = {{:.3f}}, Y = {{:.3f}}, Z = {{:.3f}} mm lies {where}.")

    def reachable(self, xyz: FloatArray) -> BoolArray:
        """Return which of the points (n, 3) mm lie in the print volume."""
        return np.asarray(np.all([good for good, _ in self.volume_rules(xyz)], axis=0))

    @abstractmethod
    def contains(self, xyz: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Return which of the points (n, 2) or (n, 3) mm lie over the bed and, if z is given, in the volume.

        margin_mm : by how much a point may lie outside
        """

    @abstractmethod
    def volume_text(self) -> str:
        """Describe the print volume as the end of a sentence: "has a radius of 60 mm and …"."""

    @abstractmethod
    def drawn_in(self, xyz: FloatArray, heights: FloatArray) -> FloatArray:
        """Return a command (n, 3) mm clipped to the firmware's limits, for a path with these heights (m,) mm."""

    @abstractmethod
    def centring(self, xy: FloatArray) -> tuple[float, float]:
        """Return the shift, whole mm, that puts points (n, 2) mm in the middle of the bed."""

    @abstractmethod
    def widening(self, xyz: FloatArray) -> str:
        """Return the machine-file keys that would make these points (n, 3) mm reachable; empty if none would."""

    @abstractmethod
    def rings(self, radii: int, directions: int) -> FloatArray:
        """Return the bed's centre and rings around it out to the border, (1 + radii · directions, 2) mm."""

    @abstractmethod
    def around(self, share: float, margin_mm: float) -> FloatArray:
        """Return six positions (6, 2) mm around the centre, at a share of the way out and a margin from the border."""

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Return the middle of the bed."""
        return 0.0, 0.0

    @property
    @abstractmethod
    def bed_radius_mm(self) -> float:
        """Return how far from the middle of the bed the nozzle may go."""

    @property
    @abstractmethod
    def height_mm(self) -> float:
        """Return the greatest height of the nozzle."""

    @property
    def model_reach_mm(self) -> float:
        """Return how far from the origin the vibrations change with position; zero where they are the same."""
        return 0.0

    @property
    def spare_reach_mm(self) -> float:
        """Return how far beyond `model_reach_mm` the arms could still go before one lies flat."""
        return np.inf

    @property
    @abstractmethod
    def motor_rows(self) -> FloatArray:
        """Return (3, 8), a row per motor: tower x y mm, L² mm², base mm, and weights of X Y Z E.

        A motor stands at base + (X Y Z E) · its last four + √(L² − |xy − tower|²); without an arm L² is zero.
        """

    @property
    def motors(self) -> FloatArray:
        """Return (3, 3) mm/mm: the motors' motion from the carriages'."""
        return np.eye(3)

    @property
    def shares_motors(self) -> bool:
        """Return whether the same motors, and their belts, move several axes."""
        return bool(np.count_nonzero(self.motors) > 3)

    @property
    def slow_zones(self) -> tuple[float, float] | None:
        """Return the lengths that decide where carriages outrun the nozzle, so that firmware slows down; None: nowhere.

        Radius and shortest arm, mm.
        """
        return None

    @property
    def tower_directions(self) -> Mapping[str, FloatArray]:
        """Return the unit vectors (2,) from the centre to each tower; empty without towers."""
        return {}

    @property
    def sample_positions(self) -> Mapping[str, FloatArray]:
        """Return name -> position (2,) mm: the few that show how vibrations change over the bed."""
        return {"centre": np.array(self.centre_mm)}

    @property
    @abstractmethod
    def actuator_names(self) -> tuple[str, str, str]:
        """Return the names of carriages or motors A B C in messages about limits."""

    @property
    @abstractmethod
    def setup_notes(self) -> list[str]:
        """Return a checklist for the printer before its vibrations are measured."""

    def printer_parameters(self) -> dict[str, FloatArray | float]:
        """Return the fields of the nonlinear printer's record that follow from the kinematics, SI."""
        return {}


def require(good: BoolArray, points: FloatArray, sentence: str) -> None:
    """Raise UnreachableError unless all are good; `sentence` is formatted with the first bad point."""
    bad = np.flatnonzero(~good)
    if bad.size:
        raise UnreachableError(sentence.format(*points[bad[0]]), bad)


def rings(radius: FloatArray, directions: int) -> FloatArray:
    """Return the origin and circles of these radii (k,) around it, (1 + k · directions, 2)."""
    angle = np.linspace(0, 2 * np.pi, directions, endpoint=False)
    around = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1).reshape(-1, 2)
    return np.concatenate([np.zeros((1, 2)), around])
