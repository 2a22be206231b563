"""The errors of a machine: each names the place and the rule.

MachineFileError          a machine file that cannot be used (FaultyFile: file, all its mistakes)
UnreachableError          points that the machine cannot reach (indices, rule)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from models.arrays import IntArray


class FaultyFile(ValueError):
    """A file that is missing, unreadable or wrong.

    path : the file, or what it is of, as the user gave it
    problems : full sentences, one per mistake: its place, the value and the rule it breaks
    """

    def __init__(self, path: str, problems: Sequence[str]) -> None:
        self.path, self.problems = path, tuple(problems)
        super().__init__(path, self.problems)

    def __str__(self) -> str:
        return "\n".join(f"{self.path}: {problem}" for problem in self.problems)


class MachineFileError(FaultyFile):
    """A machine file that cannot be used."""

    exit_code = 5


class UnreachableError(ValueError):
    """Points out of the machine's reach.

    rule : a sentence with the first bad point and the rule it breaks
    indices : (k,) row of every bad point in the checked array, so that a caller can name its G-code line
    """

    exit_code = 4

    def __init__(self, rule: str, indices: IntArray) -> None:
        self.rule, self.indices = rule, indices
        super().__init__(rule, indices)

    def __str__(self) -> str:
        others = len(self.indices) - 1
        return f"{self.rule} ({others} more points are out of reach.)" if others else self.rule
