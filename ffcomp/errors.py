"""What can go wrong beyond the input files, and the exit code each error ends in.

FfcompError
├── NothingToDo      3   the file holds nothing to compensate
├── LimitsError      6   a limit of the machine cannot be met
└── SolverError      7   a solver did not find the answer it was asked for

(gcode.errors.GcodeError 4 · models.errors.MachineFileError 5)
"""

from __future__ import annotations


class FfcompError(Exception):
    exit_code = 1


class NothingToDo(FfcompError):
    exit_code = 3


class LimitsError(FfcompError):
    exit_code = 6


class SolverError(FfcompError):
    exit_code = 7
