"""Compensate a print in memory."""

from __future__ import annotations

from typing import Any

from ffcomp.compensation.job import Job
from ffcomp.compensation.request import CompensateOptions
from ffcomp.compensation.result import Result
from models.machine import Machine


def plainly(**chosen: Any) -> CompensateOptions:
    """A request of the plain inverse, which takes half the time of the robust one."""
    return CompensateOptions(**{"robust": "off"} | chosen)


def job(
    data: bytes, machine: Machine, path: str = "print.gcode", *, jobs: int = 1, restore: bool = False, **options: Any
) -> Job:
    """A job with these options; restore : compensate the original that the file holds."""
    return Job(data, path, machine, plainly(**options), restore=restore, jobs=jobs)


def compensated(data: bytes, machine: Machine, path: str = "print.gcode", **options: Any) -> tuple[bytes, Result]:
    """The compensated print, and the result."""
    lines = job(data, machine, path, **options).lines()
    return b"".join(lines), lines.value
