"""Shapers on an even grid, settings by search, and frequencies over the bed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp import shapers
from ffcomp.shapers.apply import on_grid, shape_samples
from ffcomp.shapers.search import Scan, search
from models.arrays import FloatArray, constant
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.vibration.modal import Axis, ModalAxes

STEP_S, MARGIN = 5e-4, 200
MAKERS = {
    "mzv": shapers.SHAPERS["mzv"](41.3, 0.07),
    "3hump_ei": shapers.SHAPERS["3hump_ei"](57.0),
    "smooth_si": shapers.SHAPERS["smooth_si"](44.0, 0.1),
}


def corner(t: FloatArray) -> FloatArray:
    """100 mm/s along x, then along y, each from rest to rest at 5 m/s²; z climbs a little."""
    x, y = (_ramped(t - begin) for begin in (0.05, 0.25))
    return np.column_stack([x, y, 0.3 * x])


def _ramped(t: FloatArray) -> FloatArray:
    since = np.clip(t, 0.0, 0.2)
    up, down = np.minimum(since, 0.02), np.maximum(since - 0.18, 0.0)
    return 2500 * up**2 + 100 * np.maximum(since - 0.02, 0.0) - 2500 * down**2


@pytest.mark.parametrize("name", MAKERS)
def test_samples_are_shaped_as_the_motion_is(name: str) -> None:
    """To 0.3 µm, where shaping moves the nozzle by 90 µm and more."""
    t = STEP_S * np.arange(-MARGIN, 1201 + MARGIN)
    shaper = MAKERS[name]
    exact = shapers.shape(corner, t[MARGIN:-MARGIN], shaper, None, shaper)
    found = shape_samples(corner(t), (shaper, None, shaper), STEP_S, MARGIN)
    assert np.abs(found - exact).max() < 3e-4
    assert np.abs(exact - corner(t[MARGIN:-MARGIN])).max() > 0.08
    assert np.array_equal(found[:, 1], corner(t[MARGIN:-MARGIN])[:, 1])


def test_a_parabola_is_shaped_exactly() -> None:
    shaper = shapers.SHAPERS["ei"](37.7)
    first, weights = on_grid(shaper, STEP_S)
    delay = STEP_S * (first + np.arange(len(weights)))
    for power in (0, 1, 2):
        assert weights @ delay**power == pytest.approx(shaper.amplitude @ shaper.time**power, abs=1e-15)


# ---- settings ------------------------------------------------------------------------------------


def bowl(settings: FloatArray) -> float:
    """Least at 47, 62 and 0.13; forbidden above 90."""
    if settings.max() > 90.0:
        return float("inf")
    return float(np.sum(np.log(settings / [47.0, 62.0, 0.13]) ** 2 * [1.0, 3.0, 0.1]))


def test_the_search_finds_the_least() -> None:
    scans = (Scan((0, 1), (0.7, 1.4, 2.0)), Scan((2,), (0.5, 2.0)))
    found = search(bowl, np.array([30.0, 30.0, 0.1]), scans)
    assert found.settings == pytest.approx([47.0, 62.0, 0.13], rel=0.02)
    assert found.cost == bowl(found.settings)


# ---- the machine ---------------------------------------------------------------------------------


def rigid() -> Machine:
    """Hardly damped, an ideal drive, an extruder that does not flex, arms without mass."""
    machine = load_machine("kossel")
    carriage = replace(
        delta_vibration(machine).carriage,
        arm_pair_mass_kg=0.0,
        drive=None,
        belt_damping_n_s_per_m=0.1,
        guide_damping_n_s_per_m=0.1,
    )
    effector = replace(
        delta_vibration(machine).effector,
        extruder_stiffness_n_per_m=constant([1e9] * 3),
        center_of_mass_mm=constant([0.0] * 3),
        force_map="virtual_work",
    )
    return with_parts(machine, carriage=carriage, effector=effector)


def test_at_the_centre_the_dominant_mode_is_the_closed_form() -> None:
    """ω = √(k/(m + M σ²)), σ² = ⅔ (h/R)², h² = L² - R²: the effector swings sideways."""
    machine = rigid()
    length, radius = machine.kinematics.arm_lengths_mm[0], machine.kinematics.delta_radii_mm[0]
    sigma_squared = 2 / 3 * (length**2 - radius**2) / radius**2
    load = delta_vibration(machine).nozzle_side_mass_kg + delta_vibration(machine).effector.extruder_mass_kg
    omega = np.sqrt(
        delta_vibration(machine).carriage.belt_stiffness_n_per_m
        / (delta_vibration(machine).carriage.mass_kg + load * sigma_squared)
    )
    assert shapers.dominant_frequencies(machine, np.zeros(2)) == pytest.approx([omega / (2 * np.pi)] * 2, rel=1e-3)


def test_of_two_modes_the_one_dominates_that_moves_the_nozzle_more_for_the_same_acceleration() -> None:
    """At resonance share/(2 ζ ω²): 40 Hz with four tenths outweighs 80 Hz with six."""
    axis = Axis((40.0, 80.0), (0.05, 0.05), (0.4, 0.6))
    machine = replace(load_machine("voron-300"), vibration=ModalAxes.of([axis] * 3))
    assert shapers.dominant_frequencies(machine, np.zeros(2)) == pytest.approx([40.0, 40.0])
