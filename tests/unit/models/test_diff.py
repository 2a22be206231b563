"""`ffcomp machines diff`: what changed, by how much, and what it does."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ffcomp.cli.machines import machines as app
from models.file import LIBRARY
from tests.support.cli import CliRunner, Result


def diff(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["diff", *map(str, arguments)])


@pytest.fixture
def changed(tmp_path: Path) -> Path:
    """The paper's machine with a softer belt, a heavier extruder, and friction."""
    text = (LIBRARY / "mp-delta-pro.toml").read_text(encoding="utf-8")
    assert "belt_stiffness_n_per_m = 1.039e5" in text and "extruder_mass_kg = 0.115" in text
    text = text.replace("belt_stiffness_n_per_m = 1.039e5", "belt_stiffness_n_per_m = 0.9351e5")
    text = text.replace("extruder_mass_kg = 0.115", "extruder_mass_kg = 0.230")
    path = tmp_path / "changed.toml"
    path.write_text(text + "\n[effects.coulomb_friction]\nforce_n = 2.1\n", encoding="utf-8")
    return path


def test_every_change_is_told_with_its_size(changed: Path) -> None:
    found = json.loads(diff("mp-delta-pro", changed, "--json").stdout)
    changes = {each["key"]: each for each in found["changes"]}
    assert set(changes) == {
        "carriage.belt_stiffness_n_per_m",
        "effector.extruder_mass_kg",
        "effects.coulomb_friction.force_n",
    }
    assert changes["carriage.belt_stiffness_n_per_m"]["relative"] == pytest.approx([-0.1])
    assert changes["effector.extruder_mass_kg"]["relative"] == pytest.approx([1.0])
    assert changes["effects.coulomb_friction.force_n"]["old"] is None
    assert changes["effects.coulomb_friction.force_n"]["new"] == 2.1
    assert found["frequencies_hz"][1][1] < 0.97 * found["frequencies_hz"][1][0]
