"""docs/reference/library.md: a row for every machine of the library, as its file says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.file import load_machine
from models.finding import LIBRARY
from models.kinematics.cartesian import CartesianKinematics
from models.machine import Machine, assumed_modes
from tests.support.reference import REFERENCE, rows_of

PAGE = REFERENCE / "library.md"
FILES = sorted(LIBRARY.glob("*.toml"))


def expected(machine: Machine) -> list[str]:
    name = machine.name.removesuffix(" (assumed dynamics)")
    modes = machine.vibration.modes_at(np.array(machine.kinematics.centre_mm)).frequencies_hz
    slowest = ", ".join(f"{f:.0f}" for f in sorted(modes)[:2])
    assumed = "assumed" if assumed_modes(machine) else "measured"
    return [f"`{Path(machine.path).stem}`", name, reach(machine), f"{slowest}, {assumed}", machine.flavor]


def reach(machine: Machine) -> str:
    kinematics = machine.kinematics
    if isinstance(kinematics, CartesianKinematics):
        return ", ".join(f"{low:g} to {high:g}" for low, high in kinematics.range_mm)
    return f"radius {kinematics.print_radius_mm:g}, height {kinematics.print_height_mm:g}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_machine_has_its_row(path: Path) -> None:
    rows = [row for kind in ("Deltas", "CoreXY", "Cartesian") for row in rows_of(PAGE, kind)]
    assert expected(load_machine(path)) in rows


def test_there_are_no_other_rows() -> None:
    rows = [row for kind in ("Deltas", "CoreXY", "Cartesian") for row in rows_of(PAGE, kind)]
    assert sorted(row[0].strip("`") for row in rows) == sorted(path.stem for path in FILES)
