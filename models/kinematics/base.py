"""What a kind of machine is to everybody else: how its nozzle follows from its carriages, and where it may go.

A carriage is what vibrates by itself on its belt, and is commanded: a delta's three carriages, or the three axes of a
machine whose axes do not disturb each other. A motor is what makes steps: on a delta and on a cartesian machine each
carriage's own, on CoreXY x and y together.

mm, s; arrays of n points; carriages in the order A B C or X Y Z, motors A B C.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from models.arrays import FloatArray
from models.errors import UnreachableError

SLACK_MM = 1e-6  # a point on the rim, written with rounded digits, is inside
INSIDE_MM = 1e-4  # what a command keeps from the border: one digit of the text


class Compiled(Protocol):
    """The equations compiled and unchecked, (n, 3) in and out; what is out of reach becomes NaN."""

    def inverse(self, xyz: FloatArray) -> FloatArray: ...
    def forward(self, q: FloatArray) -> FloatArray: ...
    def rate_term(self, xyz: FloatArray, velocity: FloatArray) -> FloatArray: ...


class Kinematics(ABC):
    """One kind of kinematics with its numbers."""

    @abstractmethod
    def inverse(self, xyz: FloatArray) -> FloatArray:
        """Carriages (n, 3) mm of nozzle positions (n, 3) mm."""

    @abstractmethod
    def forward(self, q: FloatArray) -> FloatArray:
        """Nozzle positions (n, 3) mm of carriages (n, 3) mm."""

    @abstractmethod
    def jacobian(self, xy: FloatArray) -> FloatArray:
        """J with Ẋ = J q̇ at places (n, 2) mm; further columns are ignored. (n, 3, 3), rows X Y Z."""

    @abstractmethod
    def jacobian_rate_term(self, xyz: FloatArray, velocity: FloatArray) -> FloatArray:
        """J̇ q̇ (n, 3) mm/s², the part of Ẍ = J q̈ + J̇ q̇ that is there without any carriage acceleration.

        xyz : (n, 3) mm; z does not matter.   velocity : (n, 3) mm/s, of the nozzle.
        """

    @abstractmethod
    def compiled(self) -> Compiled:
        """The same for loops that cannot wait for arrays of arrays."""

    @abstractmethod
    def check_reach(self, xyz: FloatArray) -> None:
        """Raise UnreachableError if any of the points (n, 3) mm lies outside the print volume."""

    @abstractmethod
    def drawn_in(self, xyz: FloatArray, heights: FloatArray) -> FloatArray:
        """A command (n, 3) mm where the firmware lets it go, for a path that has these heights (m,) mm."""

    @abstractmethod
    def advice(self, xy: FloatArray) -> str:
        """A sentence for a print (n, 2) mm that does not fit: whether it does elsewhere on the bed."""

    @abstractmethod
    def rings(self, radii: int, directions: int) -> FloatArray:
        """The centre of the bed and rings around it out to the border, (1 + radii · directions, 2) mm."""

    @property
    @abstractmethod
    def centre_mm(self) -> tuple[float, float]:
        """The middle of the bed."""

    @property
    @abstractmethod
    def model_reach_mm(self) -> float:
        """How far from the origin the vibrations change with place; zero where they are the same everywhere."""

    @property
    @abstractmethod
    def spare_reach_mm(self) -> float:
        """How far beyond `model_reach_mm` the arms could still go before one lies flat."""

    @property
    @abstractmethod
    def motor_rows(self) -> FloatArray:
        """Of each motor (3, 8): tower x y mm, L² mm², base mm, and what of X Y Z E counts.

        A motor stands at base + (X Y Z E) · its last four + √(L² − |xy − tower|²); without an arm L² is zero.
        """

    @property
    def motors(self) -> FloatArray:
        """(3, 3) mm/mm: the motors' motion from the carriages'."""
        return np.eye(3)


def require(good: NDArray[np.bool_], points: FloatArray, sentence: str) -> None:
    """UnreachableError unless all are good; `sentence` is filled in with the first bad point."""
    bad = np.flatnonzero(~good)
    if bad.size:
        raise UnreachableError(sentence.format(*points[bad[0]]), bad)


def rings(radius: FloatArray, directions: int) -> FloatArray:
    """The origin and circles of these radii (k,) around it, (1 + k · directions, 2)."""
    angle = np.linspace(0, 2 * np.pi, directions, endpoint=False)
    around = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1).reshape(-1, 2)
    return np.concatenate([np.zeros((1, 2)), around])
