"""Machines that many tests share."""

from __future__ import annotations

from functools import cache

from models.file import load_machine
from models.machine import Machine


@cache
def machine() -> Machine:
    """Return the delta of the paper."""
    return load_machine("mp-delta-pro")
