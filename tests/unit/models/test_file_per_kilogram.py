"""Keys of forces on axes whose mass nobody states are shown as the file has them."""

from __future__ import annotations

from pathlib import Path

import pytest

from models.file import entries

TEXT = """format = "ffcomp-machine/1"
name = "box"
[kinematics]
type = "corexy"
x_range_mm = [0.0, 200.0]
y_range_mm = [0.0, 200.0]
z_range_mm = [0.0, 200.0]
[axes.x]
frequency_hz = [50.0]
damping_ratio = [0.05]
{mass}
[axes.y]
frequency_hz = [45.0]
damping_ratio = [0.05]
{mass}
[limits]
velocity_mm_per_s = 300.0
acceleration_mm_per_s2 = 5000.0
[effects.coulomb_friction]
{key} = 2.0
[provenance]
"effects.coulomb_friction.{key}" = "measured"
"""


@pytest.mark.parametrize(("mass", "key"), [("", "force_n_per_kg"), ("mass_kg = 0.4", "force_n")])
def test_a_force_is_shown_under_its_own_key(mass: str, key: str, tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    path.write_text(TEXT.format(mass=mass, key=key), encoding="utf-8")
    found = {entry.key: entry.provenance for entry in entries(path) if entry.key.startswith("effects.")}
    assert found == {f"effects.coulomb_friction.{key}": "measured"}
