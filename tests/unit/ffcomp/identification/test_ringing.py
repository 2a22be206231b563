"""Frequencies read off a print: what they move in a machine file, and what they leave alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.identification.fitting import READ_SD, fit_ringing
from ffcomp.identification.request import RingingRequest
from models.file import load_machine, machine_of_text
from models.machine import value_of

AXES = tuple(f"axes.{axis}.{kind}[0]" for axis in "xy" for kind in ("frequency_hz", "damping_ratio"))


def test_the_modes_of_straight_axes_lie_where_they_were_read() -> None:
    start = load_machine("ender-3")
    result = fit_ringing(start, RingingRequest(machine="ender-3", x_hz=48.0, output=Path("mine.toml")))
    mine = machine_of_text(result.text, "mine")
    moved = {key: (value_of(start, key), value_of(mine, key)) for key in AXES}
    assert moved.pop("axes.x.frequency_hz[0]")[1] == pytest.approx(48.0)
    assert all(before == after for before, after in moved.values())  # y was not read, and damping cannot be
    assert mine.uncertainty["axes.x.frequency_hz"] == READ_SD
    assert "axes.y.frequency_hz" not in mine.uncertainty
    assert mine.name == "mine"


def test_the_belts_of_a_delta_are_tuned_until_it_rings_there() -> None:
    start = load_machine("mp-delta-pro")
    result = fit_ringing(start, RingingRequest(machine="mp-delta-pro", y_hz=35.0, output=Path("mine.toml")))
    mine, f = machine_of_text(result.text, "mine"), np.arange(20.0, 60.0, 0.25)
    response = np.abs(mine.vibration.frequency_response(np.zeros(2), f, "nozzle", "nozzle")[:, 1, 1])
    assert f[int(np.argmax(response))] == pytest.approx(35.0, abs=1.0)
    assert value_of(mine, "carriage.mass_kg") == value_of(start, "carriage.mass_kg")
    assert value_of(mine, "carriage.guide_damping_n_s_per_m") == value_of(start, "carriage.guide_damping_n_s_per_m")
