"""A delta as calibration leaves it: each arm and radius its own, towers not at 120°; on the independent plant."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import tomlkit

from models.file import load_machine
from models.vibration.scheduled import plant_table
from validation import judge

ROOT = Path(__file__).parents[2]
CROOKED = {
    "arm_lengths_mm": [299.6, 300.7, 300.1],
    "delta_radii_mm": [139.2, 140.6, 140.1],
    "tower_angles_deg": [211.3, 329.2, 90.8],
}
LAYERS = 2


def crooked_machine(folder: Path) -> Path:
    document = tomlkit.parse(judge.MACHINE_FILE.read_text())
    for key in ("arm_length_mm", "delta_radius_mm"):
        del document["kinematics"][key]
    document["kinematics"].update(CROOKED)
    path = folder / "crooked.toml"
    path.write_text(tomlkit.dumps(document))
    return path


def test_a_crooked_delta_prints_as_well_as_a_straight_one(tmp_path: Path) -> None:
    machine_file = crooked_machine(tmp_path)
    assert tomllib.loads(machine_file.read_text())["kinematics"]["arm_lengths_mm"] == CROOKED["arm_lengths_mm"]
    text = (ROOT / "sample_prints/ringing_tower.gcode").read_bytes()
    few = b";LAYER_CHANGE".join(text.split(b";LAYER_CHANGE")[: LAYERS + 1])
    original = judge.Original(few, "few.gcode", machine_file)
    found = judge.compensated(original)
    ours = judge.segments(original, found)
    before = judge.judge(original, original.motion)
    after = judge.judge(original, judge.motion_of(ours.trajectory, ours.clock(ours.trajectory.start_t)))
    assert before.contour_rms_um > 30.0
    assert after.contour_rms_um < 2.0
    assert after.peak_m_per_s2 < 1.2 * before.peak_m_per_s2


def test_arms_that_reach_little_farther_than_the_bed_do(tmp_path: Path) -> None:
    """The models' table goes beyond the rim, but not beyond the arms: many small deltas have just enough of them."""
    document = tomlkit.parse(judge.MACHINE_FILE.read_text())
    reach = float(document["kinematics"]["delta_radius_mm"]) + float(document["kinematics"]["print_radius_mm"])
    document["kinematics"]["arm_length_mm"] = reach + 3.0
    path = tmp_path / "short.toml"
    path.write_text(tomlkit.dumps(document))
    machine = load_machine(path)
    table = plant_table(machine.kinematics, machine.vibration, 1e-3)
    assert np.isfinite(table.plant.a).all() and np.isfinite(table.jacobian).all()
