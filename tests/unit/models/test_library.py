"""The library's machine files: each loads, is sound, and says of every number where it is from."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import settings_for
from models.checks import unstable_positions
from models.file import LIBRARY, entries, load_machine
from models.machine import ASSUMED, assumed_modes

FILES = sorted(LIBRARY.glob("*.toml"))
PAPER = ("paper", "derived")  # beginnings of an origin in the two files of the paper's machine
OWNED = {  # machines that people own, by how they move
    "delta": {"flsun-qqs", "flsun-super-racer", "flsun-t1", "flsun-v400", "kossel"},
    "corexy": {"bambu-p1", "prusa-xl", "ratrig-vcore3-300", "ratrig-vcore4-300"}
    | {"voron-0", "voron-250", "voron-300", "voron-350"},
    "cartesian": {"bambu-a1", "ender-3", "ender-3-v2", "neptune-4", "prusa-mini", "prusa-mk3s", "prusa-mk4"},
}


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


def test_a_number_without_a_source_is_found(tmp_path: Path) -> None:
    text = (LIBRARY / "bambu-p1.toml").read_text(encoding="utf-8")
    changed = tmp_path / "changed.toml"
    changed.write_text(text.replace('"common: machine_max_speed_z"', '"a forum"'), encoding="utf-8")
    assert list(unsourced(changed)) == ["limits.z_velocity_mm_per_s: 'a forum'"]
    changed.write_text(re.sub('"limits.z_velocity_mm_per_s" = .*\n', "", text), encoding="utf-8")
    assert list(unsourced(changed)) == ["limits.z_velocity_mm_per_s: ''"]


def test_sources_are_addresses_that_a_number_uses(path: Path) -> None:
    provenance = tomllib.loads(path.read_text(encoding="utf-8"))["provenance"]
    for title, address in provenance.get("sources", {}).items():
        assert address.startswith("https://")
        assert any(re.search(rf"\b{title}\b", str(origin)) for key, origin in provenance.items() if key != "sources")


def test_the_kinds_are_there() -> None:
    kinds = {stem: load_machine(stem) for stems in OWNED.values() for stem in stems}
    found = {
        stem: tomllib.loads(Path(m.path).read_text(encoding="utf-8"))["kinematics"]["type"] for stem, m in kinds.items()
    }
    assert found == {stem: kind for kind, stems in OWNED.items() for stem in stems}
    assert {path.stem for path in FILES} == {*found, "mp-delta-pro", "mp-delta-pro-as-printed"}


def test_limits_are_positive_and_vibrations_decay(path: Path) -> None:
    machine = load_machine(path)
    limits = {key: value for key, value in asdict(machine.limits).items() if key != "carriage_travel_mm"}
    assert min(value for value in limits.values() if value is not None) > 0
    assert len(unstable_positions(machine)) == 0


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


def test_assumed_modes_are_said(path: Path) -> None:
    sentence = assumed_modes(load_machine(path))
    if path.stem.startswith("mp-delta-pro"):
        assert sentence is None, "these are the paper's"
    else:
        assert sentence is not None and sentence.startswith(f"The modes of {path.stem} are assumed, not measured")
        assert "`ffcomp record plan --for identify`" in sentence
