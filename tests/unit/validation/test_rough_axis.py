"""The rough axes obey the equations of ours: with what is hidden in the file, the gap is what no file states."""

from __future__ import annotations

import json
from pathlib import Path

from ffcomp.diagnosis.gap import measure_gap
from ffcomp.diagnosis.problems import plant_of, recordings_of
from models.effects.catalogue import with_effects
from models.machine import with_values
from validation.rough_axis import write_case


def test_with_its_weight_in_the_file_most_of_an_arms_gap_is_closed(tmp_path: Path) -> None:
    write_case(4001, "arm", tmp_path / "arm")
    numbers = json.loads((tmp_path / "arm" / "truth.json").read_text())["numbers"]
    inertia, viscous, dry, weight = (numbers[i] for i in (0, 1, 2, 9))
    plant = plant_of(tmp_path / "arm" / "machine.toml")
    runs = recordings_of(plant, sorted((tmp_path / "arm").glob("*.csv")))
    true = with_values(plant, {"axis.mass_kg": inertia, "axis.damping_n_s_per_m": viscous})
    rubbing = with_effects(true, {"coulomb_friction": {"force_n": dry}})
    whole = with_effects(rubbing, {"pendulum_gravity": {"force_n": weight}})
    before, after = (measure_gap(each, runs).residual.total.nrms for each in (rubbing, whole))
    assert after < 0.35 * before
