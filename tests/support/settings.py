"""Settings for tests of the inverse itself."""

from __future__ import annotations

from dataclasses import replace

from ffcomp.inverse.settings import Settings, WriterSettings, settings_for
from models.machine import Machine


def finely_joined(machine: Machine) -> Settings:
    """Return a machine's settings with segments joined so little that only the inverse's own error is left."""
    return replace(settings_for(machine), writer=WriterSettings(merge_um=0.2, merge_along_um=0.2))
