"""What can go wrong beyond the input files, and the exit code each error ends in.

FfcompError
├── NothingToDo      3   the file holds nothing to compensate
├── MeasurementError 5   a measurement that cannot be used (file, every mistake in it)
├── PrinterConfigError 5 a printer's configuration that cannot be read (ffcomp/importers/values.py)
├── LimitsError      6   a limit of the machine cannot be met
└── SolverError      7   a solver did not find the answer it was asked for

(gcode.errors.GcodeError 4 · models.errors.MachineFileError 5)
"""

from __future__ import annotations

from collections.abc import Sequence


class FfcompError(Exception):
    exit_code = 1


class NothingToDo(FfcompError):
    exit_code = 3


class MeasurementError(FfcompError, ValueError):
    """A measurement that cannot be used.

    Parameters
    ----------
    path : str
        The file, as the user gave it.
    problems : sequence of str
        Full sentences, one per mistake: column (and row), value and the rule it breaks.
    """

    exit_code = 5

    def __init__(self, path: str, problems: Sequence[str]) -> None:
        self.path, self.problems = path, tuple(problems)
        super().__init__(path, self.problems)

    def __str__(self) -> str:
        return "\n".join(f"{self.path}: {problem}" for problem in self.problems)


class LimitsError(FfcompError):
    exit_code = 6


class SolverError(FfcompError):
    exit_code = 7
