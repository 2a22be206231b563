"""When a machine's modes are said to be assumed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from models.file import load_machine
from models.machine import Machine, assumed_modes


@pytest.fixture
def voron() -> Machine:
    return load_machine("voron-300")


def with_origin(machine: Machine, **origins: str) -> Machine:
    changed = {f"axes.{axis}.frequency_hz": origin for axis, origin in origins.items()}
    return replace(machine, provenance={**machine.provenance, **changed})


def test_measured_axes_are_told_from_assumed_ones(voron: Machine) -> None:
    measured = "identified 2026-11-22 by ffcomp identify fit; 90 % interval 51.8 to 52.1"
    half = assumed_modes(with_origin(voron, x=measured))
    assert half is not None
    assert half.startswith("The modes of voron-300 are assumed in part (axes.y.frequency_hz), not measured")
    assert assumed_modes(with_origin(voron, x=measured, y=measured)) is None
