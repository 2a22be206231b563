"""Accuracy against effort: the bandwidth at the knee."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.inverse.settings import HIGHEST, LOWEST_HZ, _square, control_weight_at, effort_curve, settings_for
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("mp-delta-pro")


@pytest.mark.parametrize("name", ["mp-delta-pro", "kossel", "flsun-qqs"])
def test_the_knee_lies_above_the_modes_that_ring(name: str) -> None:
    machine = load_machine(name)
    curve = effort_curve(machine, 0.004)
    found = machine.vibration.modes_at(np.zeros(2))
    slow = found.frequencies_hz[found.frequencies_hz < 90.0]
    assert curve.knee_hz > slow.max()
    settings = settings_for(machine)
    assert settings.inverse_hz == replace(settings, robust=True).inverse_hz == curve.knee_hz


def test_more_bandwidth_costs_more_and_errs_less(machine: Machine) -> None:
    curve = effort_curve(machine, 0.002)
    assert curve.bandwidth_hz[0] == pytest.approx(LOWEST_HZ) and curve.bandwidth_hz[-1] == pytest.approx(HIGHEST * 500)
    assert curve.error_um[0] > 10 * curve.error_um[curve.knee]
    beyond = slice(curve.knee, None)
    assert (np.diff(curve.peak_mm_per_s2[beyond]) > 0).all()
    assert curve.peak_mm_per_s2[-1] > 5 * curve.peak_mm_per_s2[curve.knee]
    assert curve.knee_hz < 140.0  # where commands of two milliseconds become violent


@pytest.mark.parametrize("name", ["ender-3", "voron-300"])
def test_straight_axes_are_followed_as_far_as_it_costs_little(name: str) -> None:
    curve = effort_curve(load_machine(name), 0.004)
    at = int(np.searchsorted(curve.bandwidth_hz, 80.0))  # where a floor of 1 µm would end
    assert curve.knee_hz > 110.0
    assert curve.error_um[curve.knee] < 0.75 * curve.error_um[at]
    assert curve.peak_mm_per_s2[curve.knee] < 1.15 * curve.peak_mm_per_s2[at]
    settings = settings_for(load_machine(name))
    assert settings.inverse_hz == curve.knee_hz
    assert replace(settings, robust=True).inverse_hz < 90.0  # what is not known is left anyway


def test_grease_in_the_guides_does_not_take_bandwidth_away(machine: Machine) -> None:
    carriage = replace(delta_vibration(machine).carriage, guide_damping_n_s_per_m=120.0)
    assert effort_curve(with_parts(machine, carriage=carriage), 0.004).knee_hz > 80.0


def test_the_weight_is_where_accuracy_and_effort_weigh_alike(machine: Machine) -> None:
    rho = control_weight_at(machine, 90.0, 0.004)
    g = machine.vibration.frequency_response(np.zeros(2), np.array([90.0]), "nozzle", "nozzle")[0] * np.sinc(0.36) ** 2
    bend = (2 * np.sin(np.pi * 0.36)) ** 2
    assert rho * bend**2 == pytest.approx(np.linalg.norm(g) ** 2 / 3, rel=1e-9)


def test_the_square_is_closed_and_keeps_its_acceleration(machine: Machine) -> None:
    path = _square(machine, 0.001)
    np.testing.assert_allclose(path[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(path[-1], 0.0, atol=1e-9)
    assert path.max() == pytest.approx(8.0, abs=1e-9)
    second = np.diff(path[:, 0], 2) / 1e-6
    assert np.median(np.abs(second[np.abs(second) > 1])) == pytest.approx(3000, rel=0.01)
