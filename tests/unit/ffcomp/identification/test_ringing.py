"""Frequencies read off a print: what they move in a machine file, and what they leave alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from ffcomp.identification.axis_spectra import Spectrum
from ffcomp.identification.belts import BeltComparison, compare_belts
from ffcomp.identification.fitting import READ_SD, fit_ringing
from ffcomp.identification.request import RingingRequest
from ffcomp.identification.resonance_tests import BeltTest
from ffcomp.report.identify import belts_figure
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


# ---- belts ----


FloatArray = NDArray[np.float64]

F = np.arange(7, 83) * 1.5625
COREXY, DELTA = load_machine("voron-300"), load_machine("mp-delta-pro")
BELTS = np.array([[1.0, 1.0], [1.0, -1.0]])
TOWERS = np.linalg.inv(DELTA.kinematics.jacobian(np.zeros((1, 2)))[0])[:, :2]
MASS_KG, SPRING = 1.2, 1.0e5


def test_of(rows: FloatArray, stiffness: Sequence[float], ratio: float, along: FloatArray, seed: int) -> BeltTest:
    """The power of all axes in a sweep along one direction, seen through a window of one line, 5 % off."""
    d = along / np.linalg.norm(along)
    k = SPRING * np.einsum("m,mi,mj->ij", np.array(stiffness), rows, rows)
    mass = MASS_KG * np.diag([1.0, ratio])
    fine = F[:, None] + np.arange(-2, 2.01, 0.25) * 1.5625
    s = 2j * np.pi * fine[..., None, None]
    damping = 2e-4 * k + 5.0 * mass
    answer = np.linalg.solve(k + s * damping + s**2 * mass, (k + s * 2e-4 * k) @ d[:, None])[..., 0]
    weight = np.kaiser(17, 8.0)
    power = ((fine**2) * (np.abs(answer) ** 2).sum(axis=-1)) @ weight / weight.sum()
    error = gaussian_filter1d(np.random.default_rng(seed).normal(size=len(F)), 2.0)
    power = power * np.exp(0.05 * error / error.std()) + 1e-4 * power.max()
    return BeltTest(Spectrum(f"test{seed}.csv", "", F, power, 200), d, None)


test_of.__test__ = False  # type: ignore[attr-defined]


def belts(stiffness: Sequence[float], ratio: float) -> BeltComparison:
    return compare_belts(COREXY, [test_of(BELTS, stiffness, ratio, row, n) for n, row in enumerate(BELTS)])


def test_the_softer_belt_of_a_corexy_is_named() -> None:
    found = belts([1.0, 0.88], 1.3)
    softer = found.relative_stiffness["1,-1"]
    assert softer.low < -0.12 < softer.high and softer.sd < 0.05
    assert found.sentence.startswith("The belt of axis=1,-1 is ") and "softer than the other one" in found.sentence
    true = np.sqrt(np.linalg.eigvals(SPRING * (BELTS.T * [1.0, 0.88]) @ BELTS / MASS_KG / [[1.0], [1.3]]))
    np.testing.assert_allclose([e.value for e in found.modes_hz], np.sort(true) / (2 * np.pi), rtol=0.02)


def test_a_soft_tower_is_named_and_drawn() -> None:
    tests = [test_of(TOWERS, [1.0, 0.9, 1.0], 1.0, row, n) for n, row in enumerate(TOWERS)]
    found = compare_belts(DELTA, tests)
    assert found.relative_stiffness["B"].low < -0.10 < found.relative_stiffness["B"].high
    assert found.sentence.startswith("Tower B's belt is ") and "softer than the other two" in found.sentence
    axes = belts_figure(found, "mine").axes[0]
    assert axes.get_xlabel() == "frequency, Hz" and len(axes.get_legend().get_texts()) == 4
    assert "tower B (axis=" in axes.get_legend().get_texts()[1].get_text()
