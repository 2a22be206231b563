"""Shapers on an even grid, settings by search, and a shaper for each carriage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp import shapers
from ffcomp.shapers.apply import on_grid, shape_samples
from ffcomp.shapers.search import Scan, search
from models.arrays import constant
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.vibration.modal import Axis, ModalAxes

FloatArray = NDArray[np.float64]

STEP_S, MARGIN = 5e-4, 200
MAKERS = {
    "mzv": shapers.mzv(41.3, 0.07),
    "3hump_ei": shapers.three_hump_ei(57.0),
    "smooth_si": shapers.SHAPERS["smooth_si"](44.0, 0.1),
    "inverse": shapers.mode_inverse("smooth_mzv", 110.0, 47.0, 0.1),
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
    """To 0.3 µm (an inverse: 2), where shaping moves the nozzle by 90 µm and more."""
    t = STEP_S * np.arange(-MARGIN, 1201 + MARGIN)
    shaper = MAKERS[name]
    exact = shapers.shape(corner, t[MARGIN:-MARGIN], shaper, None, shaper)
    found = shape_samples(corner(t), (shaper, None, shaper), STEP_S, MARGIN)
    assert np.abs(found - exact).max() < (2e-3 if name == "inverse" else 3e-4)
    assert np.abs(exact - corner(t[MARGIN:-MARGIN])).max() > 0.08
    assert np.array_equal(found[:, 1], corner(t[MARGIN:-MARGIN])[:, 1])


def test_a_margin_that_is_too_short_holds_the_ends() -> None:
    t = STEP_S * np.arange(1201)
    found = shape_samples(corner(t), (shapers.zv(20.0), None, None), STEP_S, 0)
    assert found.shape == (1201, 3)
    assert found[-1] == pytest.approx(corner(t[-1:])[0])


def test_a_parabola_is_shaped_exactly() -> None:
    shaper = shapers.ei(37.7)
    first, weights = on_grid(shaper, STEP_S)
    delay = STEP_S * (first + np.arange(len(weights)))
    for power in (0, 1, 2):
        assert weights @ delay**power == pytest.approx(shaper.amplitude @ shaper.time**power, abs=1e-15)


# ---- each carriage -------------------------------------------------------------------------------


def test_on_straight_axes_carriages_are_axes() -> None:
    t = np.linspace(-0.05, 0.6, 300)
    each = shapers.mzv(40.0), shapers.zv(50.0), shapers.ei(60.0)
    middle = np.array([100.0, 100.0, 10.0])

    def position(at: FloatArray) -> FloatArray:
        return corner(at) + middle

    compiled = load_machine("ender-3").kinematics.compiled()
    assert shapers.shape_carriages(position, t, compiled, each) == pytest.approx(shapers.shape(position, t, *each))


def test_on_a_delta_each_tower_is_shaped_by_itself() -> None:
    """A climb moves all carriages alike; with three different shapers it leaves the vertical, and comes back to it."""
    t = np.linspace(0.0, 0.6, 300)
    compiled = load_machine("mp-delta-pro").kinematics.compiled()

    def climb(at: FloatArray) -> FloatArray:
        return corner(at)[:, [1, 1, 0]] * [0.0, 0.0, 1.0]

    same = shapers.shape_carriages(climb, t, compiled, (shapers.zv(40.0),) * 3)
    assert same == pytest.approx(shapers.shape(climb, t, z=shapers.zv(40.0)), abs=1e-9)
    apart = shapers.shape_carriages(climb, t, compiled, (shapers.zv(40.0), shapers.zv(30.0), shapers.zv(50.0)))
    assert np.abs(apart[:, :2]).max() > 0.005
    assert apart[-1] == pytest.approx(climb(t[-1:])[0], abs=1e-9)


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


def test_what_is_not_free_stays() -> None:
    found = search(bowl, np.array([30.0, 30.0, 0.1]), free=[1])
    assert found.settings[[0, 2]].tolist() == [30.0, 0.1] and found.settings[1] == pytest.approx(62.0, rel=0.02)


FloatArray = NDArray[np.float64]

T = np.linspace(-0.2, 1.2, 1401)
LENGTH_MM, SPEED, ACCELERATION = 100.0, 150.0, 3000.0


def there_and_rest(t: FloatArray) -> FloatArray:
    """From X = 0 to LENGTH_MM by a trapezoid of speed, and along Y half as far."""
    ramp = SPEED / ACCELERATION
    total = LENGTH_MM / SPEED + ramp
    since = np.clip(t, 0.0, total)
    up, down = np.minimum(since, ramp), np.maximum(since - (total - ramp), 0.0)
    along = ACCELERATION / 2 * up**2 + SPEED * np.maximum(since - ramp, 0.0) - ACCELERATION / 2 * down**2
    return np.column_stack([along, along / 2, np.full_like(along, 7.0)])


def rising(xy: FloatArray) -> FloatArray:
    """35 Hz to 60 Hz along X; half as much more along Y."""
    hz = 35.0 + 0.25 * xy[:, 0]
    return np.column_stack([hz, 35.0 + (hz - 35.0) / 2])


@pytest.mark.parametrize("kind", shapers.SHAPERS)
def test_a_constant_frequency_is_the_fixed_shaper(kind: str) -> None:
    make = shapers.SHAPERS[kind]
    fixed = shapers.shape(there_and_rest, T, x=make(43.0, 0.07), y=make(58.0, 0.07))
    ours = shapers.scheduled_shape(there_and_rest, T, lambda xy: np.full(xy.shape, [43.0, 58.0]), kind, 0.07)
    assert np.abs(ours - fixed).max() < 1e-10


def test_every_moment_is_that_of_the_places_own_shaper() -> None:
    ours = shapers.scheduled_shape(there_and_rest, T, rising, "ei")
    for k in range(150, 1000, 50):
        x_hz, y_hz = rising(there_and_rest(T[k : k + 1])[:, :2])[0]
        here = shapers.shape(there_and_rest, T[k : k + 1], x=shapers.ei(x_hz), y=shapers.ei(y_hz))[0]
        assert ours[k] == pytest.approx(here, abs=1e-10)


def test_rest_stays_rest_and_z_as_planned() -> None:
    ours, plan = shapers.scheduled_shape(there_and_rest, T, rising, "2hump_ei"), there_and_rest(T)
    still = (T < -0.06) | (T > LENGTH_MM / SPEED + SPEED / ACCELERATION + 0.06)
    assert np.abs(ours[still] - plan[still]).max() < 1e-12
    assert np.array_equal(ours[:, 2], plan[:, 2])


def left_after_the_move(position: shapers.Position) -> float:
    """Amplitude (mm) at rest of x'' + 2ζω x' + ω² x = ω² u whose ω is that of the place u, ζ = 0.03; by leapfrog."""
    step = 2e-5
    t = np.arange(-0.1, 0.9, step)
    u = position(t)[:, 0]
    omega = 2 * np.pi * rising(np.column_stack([u, u]))[:, 0]
    x, v = u[0], 0.0
    for w, target in zip(omega, u, strict=True):
        v += step * (w**2 * (target - x) - 0.06 * w * v)
        x += step * v
    return float(np.hypot(x - u[-1], v / omega[-1]))


def test_where_the_vibration_changes_the_scheduled_shaper_leaves_least() -> None:
    def scheduled(t: FloatArray) -> FloatArray:
        return shapers.scheduled_shape(there_and_rest, t, rising, "mzv", 0.03)

    def fixed(hz: float) -> Callable[[FloatArray], FloatArray]:
        return lambda t: shapers.shape(there_and_rest, t, x=shapers.mzv(hz, 0.03))

    assert left_after_the_move(scheduled) < 0.2 * left_after_the_move(fixed(47.5))


def test_a_frequency_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match=r"every position, not 0\.0 Hz"):
        shapers.scheduled_shape(there_and_rest, T, lambda xy: 0.0 * xy, "zv")


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
    assert shapers.dominant_frequencies(machine, np.zeros((1, 2)))[0] == pytest.approx(
        [omega / (2 * np.pi)] * 2, rel=1e-3
    )


def test_of_two_modes_the_one_dominates_that_moves_the_nozzle_more_for_the_same_acceleration() -> None:
    """At resonance share/(2 ζ ω²): 40 Hz with four tenths outweighs 80 Hz with six."""
    axis = Axis((40.0, 80.0), (0.05, 0.05), (0.4, 0.6))
    machine = replace(load_machine("voron-300"), vibration=ModalAxes.of([axis] * 3))
    assert shapers.dominant_frequencies(machine, np.zeros((1, 2)))[0] == pytest.approx([40.0, 40.0])


def test_the_mirrored_place_has_the_same_frequencies() -> None:
    """kossel has a tower on the y axis: left and right are alike."""
    machine = load_machine("kossel")
    left, right, below = shapers.dominant_frequencies(machine, np.array([[-40.0, 30.0], [40.0, 30.0], [40.0, -30.0]]))
    assert left == pytest.approx(right)
    assert left != pytest.approx(below, rel=0.01)


def test_between_the_nodes_a_linear_frequency_is_met_and_outside_the_rim_holds() -> None:
    machine = load_machine("kossel")
    reach = machine.kinematics.print_radius_mm
    of_place = shapers.over_the_bed(machine, lambda xy: 50.0 + np.array([0.1, -0.2]) * xy, pitch_mm=20.0)
    inside = np.array([[3.0, 4.0], [-51.0, 17.0], [0.0, -60.0]])
    assert of_place(inside) == pytest.approx(50.0 + np.array([0.1, -0.2]) * inside)
    far = np.column_stack([reach * np.linspace(1.0, 9.0, 4001), np.zeros(4001)])
    assert of_place(far) == pytest.approx(np.full((4001, 2), [50.0 + 0.1 * reach, 50.0]))


def test_the_table_holds_the_machines_frequencies() -> None:
    machine = load_machine("kossel")
    of_place = shapers.over_the_bed(machine, lambda xy: shapers.dominant_frequencies(machine, xy), pitch_mm=15.0)
    places = np.array([[0.0, 0.0], [-22.0, 41.0], [20.0, -64.0]])
    assert of_place(places) == pytest.approx(shapers.dominant_frequencies(machine, places), rel=0.01)
