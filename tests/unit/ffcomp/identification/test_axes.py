"""What x and y exchange is found from responses across the axes, apart from a sensor that is turned."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ffcomp.identification.axes import Exchange, IdentifiedAxes, find_exchange, identify_axes
from ffcomp.identification.axis_spectra import usable
from ffcomp.identification.machine_fit import Origin, axes_file_text
from ffcomp.identification.modal_fit import AxisFit, AxisMode
from ffcomp.identification.uncertainty import normal
from ffcomp.measurement.frf import FrequencyResponse
from models.arrays import FloatArray
from models.file import load_machine, machine_of_text
from models.kinematics.cartesian import COREXY
from models.vibration.modal import Axis, ModalAxes

F = np.arange(8.0, 140.0, 1.5)
AXES = (Axis([57.0, 90.0], [0.07, 0.05], [0.8, 0.2]), Axis([48.0], [0.06]), Axis())


def measured(delta: float, turned: float = 0.0, noise: float = 0.02, mixed: float = 0.0) -> list[FrequencyResponse]:
    """Return four responses of a machine that exchanges, by a sensor turned about z, 1.5 ms late; and a stranger."""
    rng = np.random.default_rng(3)
    g = ModalAxes.of(AXES, delta).frequency_response(np.zeros(2), F, "acceleration")
    c, s = np.cos(turned), np.sin(turned)
    g = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ g * np.exp(-2j * np.pi * F * 1.5e-3)[:, None, None]
    found = []
    for i, command in enumerate("xy"):
        for k, answer in enumerate("xy"):
            level = noise * np.sqrt(np.mean(np.abs(g[:, i, i]) ** 2))
            extra = mixed * g[:, i, i] * np.exp(2j * np.pi * F * 0.04) if i != k else 0.0
            error = level / np.sqrt(2) * (rng.standard_normal(len(F)) + 1j * rng.standard_normal(len(F)))
            value, variance = g[:, k, i] + extra + error, np.full(len(F), level**2)
            found.append(FrequencyResponse(f"cmd_{command}", f"acc_{answer}", F, value, variance, source=command))
    return found


def known(name: str, axis: Axis) -> AxisFit:
    """Return a fit that found the truth."""
    each = zip(axis.frequency_hz, axis.damping_ratio, axis.share, strict=True)
    modes = tuple(AxisMode(normal(f, 0.1), normal(zeta, 1e-3), normal(share, 1e-3)) for f, zeta, share in each)
    return AxisFit(name, modes, (), (), (), "", ())


def found_in(*args: float) -> Exchange:
    answers, _ = usable(measured(*args))
    found = find_exchange([known("x", AXES[0]), known("y", AXES[1])], answers)
    assert found is not None
    return found


@cache
def fitted(delta: float, mixed: float = 0.0) -> IdentifiedAxes:
    return identify_axes([], measured(delta, mixed=mixed))


@pytest.mark.parametrize("delta", [0.05, -0.03, 0.12, 0.0])
@pytest.mark.parametrize("turned", [0.0, 0.1])
def test_exchange_is_found_whether_or_not_the_sensor_is_turned(delta: float, turned: float) -> None:
    found = found_in(delta, turned)
    assert abs(found.delta.value - delta) < max(0.05 * abs(delta), 3 * found.delta.sd)
    assert found.delta.sd < 0.05 * abs(delta) + 0.002
    np.testing.assert_allclose([*found.turned_rad.values()], [-turned, turned], atol=0.01)
    assert found.left < 0.03


def test_it_is_written_with_its_interval_and_read_again() -> None:
    found = fitted(0.05)
    text = axes_file_text(Origin(load_machine("voron-300"), "mine", ["a.csv"], "today"), found)
    model = machine_of_text(text, "mine").vibration
    assert isinstance(model, ModalAxes) and model.exchange == pytest.approx(0.05, rel=0.05)
    assert '"axes.exchange" = "identified today' in text and "90 % interval" in text
    assert "axes.exchange = 0.05" in " ".join(found.advice)


def crossed(model: ModalAxes) -> FloatArray:
    return np.abs(model.frequency_response(np.zeros(2), F)[:, 0, 1])


def test_the_files_number_is_that_of_one_stiffer_belt() -> None:
    """Of a CoreXY with one belt stiffer by r, δ = r/(2 + r)."""
    belt = ModalAxes.of(AXES).with_belts(np.array([0.2, 0.0, 0.0]), COREXY)
    assert belt.exchange == pytest.approx(0.2 / 2.2)
    assert crossed(belt).max() == pytest.approx(crossed(ModalAxes.of(AXES, 0.2 / 2.2)).max(), rel=0.1)
