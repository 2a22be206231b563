"""Define the errors that a user's input can cause, and the exit code of each.

The whole tree; each class has its exit code as the attribute `exit_code`:

    FfcompError                 1  something else is wrong: a cluster that is lost, a package that is not installed
    ├── RequestError            2  options that do not go together, or not with this machine (also a ValueError)
    ├── NothingToDo             3  the file holds nothing to compensate
    ├── MeasurementError        5  a measurement that cannot be used (also a ValueError)
    ├── PrinterConfigError      5  a printer's configuration that cannot be read (ffcomp/importers/values.py)
    ├── LimitsError             6  a limit of the machine cannot be met
    └── SolverError             7  a solver has not found a solution
    ValueError
    ├── GcodeError              4  G-code that cannot be followed (gcode/errors.py)
    │   ├── UnsupportedGcode    4  well-formed G-code about which ffcomp does not guess
    │   └── StepsError          4  a step archive that cannot be executed (ffcomp/steps/archive.py)
    ├── MachineFileError        5  a machine file that cannot be used (models/errors.py)
    └── UnreachableError        4  points out of the machine's reach; raised again as a GcodeError with its line
    OSError                     2  a file that cannot be opened or written; one that is missing, whatever its kind
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from gcode.errors import GcodeError
from models.errors import FaultyFile, MachineFileError


class FfcompError(Exception):
    """An error that the user can do something about."""

    exit_code = 1


class RequestError(FfcompError, ValueError):
    """Options that do not go together, or not with this machine or these data."""

    exit_code = 2


class NothingToDo(FfcompError):
    """A file that holds nothing to compensate."""

    exit_code = 3


class MeasurementError(FfcompError, FaultyFile):
    """A measurement that cannot be used."""

    exit_code = 5


class LimitsError(FfcompError):
    """A limit of the machine that cannot be met."""

    exit_code = 6


class SolverError(FfcompError):
    """A solver that has not found a solution."""

    exit_code = 7


EXTRAS = {
    "matplotlib": ("plot", "Figures and pages need Matplotlib"),
    "control": ("control", "This needs python-control"),
    "PIL": ("scan", "Pictures need Pillow"),
    "starlette": ("serve", "The page needs Starlette and Uvicorn"),
    "uvicorn": ("serve", "The page needs Starlette and Uvicorn"),
    "numba": ("jit", "What this needs did not come compiled with ffcomp for this machine and processor"),
}
"""Packages that only an extra installs: its name, and who needs it."""


def not_installed(package: str) -> FfcompError:
    """Return the error that says which extra brings a package of EXTRAS."""
    extra, need = EXTRAS[package]
    name = "pillow" if package == "PIL" else package  # as it is installed
    return FfcompError(f"{need}: pip install 'ffcomp[{extra}]' (with pipx: pipx inject ffcomp {name}).")


@contextmanager
def missing_extras_explained() -> Iterator[None]:
    """Say which extra brings a package that is missing; also a decorator.

    Raises FfcompError in place of the ModuleNotFoundError of a package of EXTRAS.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        raise not_installed(package) from None


INPUT_ERRORS = (FfcompError, GcodeError, MachineFileError, OSError)
"""Errors that end in a sentence and an exit code; any other is a fault of ffcomp's own."""


def explain(error: FfcompError | GcodeError | MachineFileError | OSError, path: str = "A file") -> tuple[str, int]:
    """Return the sentence that a user is shown for one of INPUT_ERRORS, and the exit code.

    path : the file to name where an OSError names none
    """
    if isinstance(error, OSError):
        return f"{error.filename or path}: {error.strerror or error}.", 2
    missing = isinstance(error.__cause__ or error.__context__, FileNotFoundError)
    return str(error), 2 if missing else error.exit_code


@contextmanager
def interrupts_restored() -> Iterator[None]:
    """Raise an interrupt as itself when compiled code has wrapped it.

    A signal's handler may run while compiled code calls back into Python. What it raises then comes out as the cause of
    a SystemError, and nobody would take that for Ctrl-C or the request to end.

    Raises KeyboardInterrupt, SystemExit as the handler raised them.
    """
    try:
        yield
    except SystemError as error:
        cause = error.__cause__
        while cause is not None and not isinstance(cause, KeyboardInterrupt | SystemExit):
            cause = cause.__cause__
        if cause is None:
            raise
        raise cause from None
