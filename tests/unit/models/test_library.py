"""The library's machine files: each loads, is sound, and says of every number where it is from."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import settings_for
from models.file import LIBRARY, entries, load_machine
from models.machine import ASSUMED

FILES = sorted(LIBRARY.glob("*.toml"))
PAPER = ("paper", "derived")  # beginnings of an origin in the two files of the paper's machine


@pytest.fixture(params=FILES, ids=lambda path: path.stem)
def path(request: pytest.FixtureRequest) -> Path:
    return Path(request.param)


def unsourced(path: Path) -> Iterator[str]:
    """Every value whose origin is neither assumed nor one of the file's sources; none of a text needs one."""
    sources = tomllib.loads(path.read_text(encoding="utf-8"))["provenance"].get("sources", {})
    known = (ASSUMED, *(f"{title}: " for title in sources), *(PAPER if path.stem.startswith("mp-delta-pro") else ()))
    for entry in entries(path):
        stated = entry.provenance.removeprefix("x, y: ")  # of one axis after the other
        if not isinstance(entry.value, str) and not stated.startswith(known):
            yield f"{entry.key}: {entry.provenance!r}"


def test_every_number_is_from_a_source_or_assumed(path: Path) -> None:
    assert list(unsourced(path)) == []


def test_the_motors_can_do_what_the_plan_asks_of_them(path: Path) -> None:
    """Without a margin the compensation would slow every fast move down."""
    machine = load_machine(path)
    centre = np.array([[*machine.kinematics.centre_mm, 0.0]])
    actuators = np.linalg.inv(machine.kinematics.jacobian(centre)[0])[:, :2]  # per mm of the nozzle along x and y
    demand = np.linalg.norm(actuators, axis=1).max()
    assert machine.limits.carriage_velocity_mm_per_s > demand * machine.limits.velocity_mm_per_s
    assert machine.limits.carriage_acceleration_mm_per_s2 > demand * machine.limits.acceleration_mm_per_s2


def test_an_inverse_can_be_made(path: Path) -> None:
    machine = load_machine(path)
    model = InverseModel(machine, replace(settings_for(machine), one_model=True))  # of the bed's middle: quick
    assert 60.0 <= model.settings.bandwidth_hz <= 0.46 * 250.0
    assert np.isfinite(model.control_weight) and model.control_weight > 0
    assert model.gains is not None
