"""A delta as calibration leaves it: each arm and radius its own, towers not at 120°; on the independent plant."""

from __future__ import annotations

import tomllib
from pathlib import Path

import tomlkit

from tests import judge

ROOT = Path(__file__).parents[1]
CROOKED = {
    "arm_lengths_mm": [299.6, 300.7, 300.1],
    "delta_radii_mm": [139.2, 140.6, 140.1],
    "tower_angles_deg": [211.3, 329.2, 90.8],
}
LAYERS = 4


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
    after = judge.judge(original, judge.motion_of(ours.trajectory, ours.clock(found, ours.trajectory.start_t)))
    assert before.contour_rms_um > 30.0
    assert after.contour_rms_um < 2.0
    assert after.peak_m_per_s2 < 1.2 * before.peak_m_per_s2
