"""Axes told by their modes: poles, shares and responses against the closed form, and what no chain of masses can be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from models.arrays import constant
from models.effects.catalogue import effective_machine, with_effect
from models.kinematics.cartesian import CARTESIAN, CartesianKinematics
from models.machine import Machine, MotionLimits
from models.vibration.modal import Axis, ModalAxes

RIGID = Axis()
BOX = CartesianKinematics(constant([[0, 200], [0, 200], [0, 200]]), CARTESIAN)
F = np.linspace(1.0, 120.0, 240)


def machine(*axes: Axis) -> Machine:
    return Machine("axes", BOX, ModalAxes.of([*axes, *[RIGID] * (3 - len(axes))]), MotionLimits(200.0, 3000.0))


def closed_form(axis: Axis, f: NDArray[np.float64]) -> NDArray[np.complex128]:
    omega, s = 2 * np.pi * np.asarray(axis.frequency_hz), 2j * np.pi * f[:, None]
    return np.asarray(
        (np.asarray(axis.share) * omega**2 / (s**2 + 2 * np.asarray(axis.damping_ratio) * omega * s + omega**2)).sum(1)
    )


def test_one_mode_is_the_textbook_resonance() -> None:
    axis = Axis([47.0], [0.06])
    found = machine(axis, RIGID).vibration.frequency_response(np.array([20.0, 180.0]), F, "nozzle", "nozzle")
    assert np.abs(found[:, 0, 0] - closed_form(axis, F)).max() < 2e-3 * np.abs(closed_form(axis, F)).max()
    assert np.abs(found[:, 1, 1] - 1.0).max() < 7e-3
    off_diagonal = found.copy()
    off_diagonal[:, range(3), range(3)] = 0.0
    assert not off_diagonal.any()


@pytest.mark.parametrize("share", [0.15, 0.5, 1.0])
def test_what_the_belts_damp_follows_the_command(share: float) -> None:
    """q/u = (s c λ + k)/(m λ² + c λ + k), c = 2 ζ ω m; the effect is what the file may state."""
    omega, s = 2 * np.pi * 47.0, 2j * np.pi * F
    expected = (share * 0.3 * omega * s + omega**2) / (s**2 + 0.3 * omega * s + omega**2)
    stated = machine(Axis([47.0], [0.15], belt_damping_share=share))
    effect = effective_machine(with_effect(machine(Axis([47.0], [0.15])), "belt_damping", share=[share, 0.0, 0.0]))
    for each in (stated, effect):
        np.testing.assert_allclose(each.vibration.carriage_response(np.zeros(2), s)[:, 0, 0], expected, rtol=1e-12)
    tau, bend = stated.vibration.low_frequency(np.zeros((1, 2)))
    small = np.array([0.5j])
    series = 1 + tau[0] * small + bend[0, 0, 0] * small**2
    np.testing.assert_allclose(1 / stated.vibration.carriage_response(np.zeros(2), small)[0, 0, 0], series, rtol=1e-7)
    slower = stated.vibration.with_parameters({"axes.x.frequency_hz[0]": 40.0, "axes.x.damping_ratio[0]": 0.1})
    mode = slower.axes[0][0]
    assert (mode.belt_share, mode.damping_ratio) == pytest.approx((share, 0.1))


def test_a_belts_damper_pulls_at_every_mode_as_its_spring_does() -> None:
    """A tool on a carriage, damped in proportion: the masses' own equations, against the modes of a file."""
    carriage, tool, belt, mount, damper = 0.3, 0.1, 3e4, 2.5e4, 12.0
    mass, s = np.diag([carriage, tool]), 2j * np.pi * F[:, None, None]
    stiff = np.array([[belt + mount, -mount], [-mount, mount]])
    damp = 20.0 * mass + 3e-4 * stiff  # of guides and belt, 15 N s/m act on the carriage
    pulled = np.zeros((len(F), 2, 1), dtype=complex)
    pulled[:, 0] = belt + damper * s[:, 0]
    expected = np.linalg.solve(mass * s**2 + damp * s + stiff, pulled)[:, 1, 0]
    square, shape = np.linalg.eigh(np.linalg.inv(np.sqrt(mass)) @ stiff @ np.linalg.inv(np.sqrt(mass)))
    shape = np.linalg.inv(np.sqrt(mass)) @ shape
    lost = np.einsum("im,ij,jm->m", shape, damp, shape)
    axis = Axis(
        list(np.sqrt(square) / (2 * np.pi)),
        list(lost / (2 * np.sqrt(square))),
        list(belt * shape[0] * shape[1] / square),
        mount_frequency_hz=float(np.sqrt(mount / tool) / (2 * np.pi)),
        belt_damping_share=float(damper * shape[0, 0] ** 2 / lost[0]),
    )
    found = machine(axis).vibration.carriage_response(np.zeros(2), s[:, 0, 0])[:, 0, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@given(st.floats(20, 80), st.floats(1.0, 3.0), st.floats(0.01, 0.3), st.floats(0.01, 0.3), st.floats(0.05, 0.95))
def test_two_modes_add_up(f: float, ratio: float, first: float, second: float, share: float) -> None:
    axis = Axis([f, f * ratio], [first, second], [share, 1.0 - share])
    known, place = machine(axis), np.zeros(2)
    assert known.vibration.frequency_response(place, F, "nozzle", "nozzle")[:, 0, 0] == pytest.approx(
        closed_form(axis, F), rel=1e-9
    )
    found = known.vibration.modes_at(place)  # what is silent or rigid does not swing
    assert found.frequencies_hz == pytest.approx(axis.frequency_hz, rel=1e-5)


def test_the_state_matrices_say_the_same_as_the_responses() -> None:
    known = machine(Axis([40.0, 70.0], [0.05, 0.06], [0.7, 0.3]), Axis([33.0], [0.1]))
    plant = known.vibration.state_space(np.zeros((1, 2)))
    s = 2j * np.pi * 35.0
    b = plant.b_command[0] + s * plant.b_slope[0]
    answer = np.linalg.solve(s * np.eye(len(plant.names)) - plant.a[0], b)
    assert plant.carriage @ answer == pytest.approx(
        known.vibration.frequency_response(np.zeros(2), np.array([35.0]), "nozzle", "nozzle")[0], abs=1e-9
    )
    assert answer[1::2] == pytest.approx(s * answer[::2])
    assert len(plant.names) == 8, "two states for each mode, a rigid axis among them"


def chain(k1: float, k2: float, m1: float, m2: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies, Hz, and the nozzle's shares of two masses: the belt k1 drives m1, on which k2 holds m2."""
    inverse = np.diag(1 / np.sqrt([m1, m2]))
    squares, shapes = np.linalg.eigh(inverse @ np.array([[k1 + k2, -k2], [-k2, k2]]) @ inverse)
    first, second = inverse @ shapes
    return np.sqrt(squares) / (2 * np.pi), k1 * first * second / squares


def test_the_frequency_of_the_mount_makes_two_modes_a_chain_of_two_masses() -> None:
    """A stiffer belt changes both modes as it does those of the chain."""
    k1, k2, m1, m2 = 2e4, 3e4, 0.35, 0.12
    frequency, share = chain(k1, k2, m1, m2)
    mount = float(np.sqrt(k2 / m2) / (2 * np.pi))
    axis = Axis(tuple(frequency), (0.0, 0.0), tuple(share), mass_kg=m1 + m2, mount_frequency_hz=mount)
    model = ModalAxes.of([axis, Axis(), Axis()])
    assert model.drive_stiffness[0] == pytest.approx(k1, rel=1e-9)
    changed, (expected, shares) = (model.with_belts(np.array([0.3, 0.0, 0.0]), np.eye(3)), chain(1.3 * k1, k2, m1, m2))
    assert [o.frequency_hz for o in changed.axes[0]] == pytest.approx(expected, rel=1e-9)
    assert [o.share for o in changed.axes[0]] == pytest.approx(shares, rel=1e-9)
    parts = model.printer_modes()[:2, 4, 0]
    still = parts @ (share * frequency**2 / (frequency**2 - mount**2))
    assert still == pytest.approx(
        0.0, abs=1e-9
    )  # the belt's end rests while the nozzle swings at the mount's frequency


def test_a_mount_that_nobody_stated_is_guessed_and_may_be_fitted() -> None:
    frequency, share = chain(2e4, 3e4, 0.35, 0.12)
    name = "axes.x.mount_frequency_hz"
    model = ModalAxes.of([Axis(tuple(frequency), (0.05, 0.05), tuple(share)), Axis([40.0], [0.05]), Axis()])
    assert name in model.tunable and name in model.guessed
    guess = model.value(name)
    stated = model.with_parameters({name: guess})
    assert stated.printer_modes() == pytest.approx(model.printer_modes(), rel=1e-9)
    assert not stated.guessed and stated.value(name) == guess
    with pytest.raises(KeyError):
        model.value("axes.y.mount_frequency_hz")
    s = 2j * np.pi * np.linspace(5.0, 150.0, 30)
    other = model.with_parameters({name: 0.9 * guess})
    assert other.axis_frf(s) == pytest.approx(model.axis_frf(s))  # what commands do does not depend on it
    assert other.drive_stiffness[0] != pytest.approx(model.drive_stiffness[0], rel=0.01)


def test_a_mount_stays_between_the_modes_when_they_move() -> None:
    """A fit may take the higher mode below a mount: there the belt does not drive that mode, and a file may say so."""
    frequency, share = chain(2e4, 3e4, 0.35, 0.12)
    model = ModalAxes.of(
        [Axis(tuple(frequency), (0.05, 0.05), tuple(share), mount_frequency_hz=0.98 * frequency[1]), Axis(), Axis()]
    )
    lower = model.with_parameters({"axes.x.frequency_hz[1]": 0.95 * float(frequency[1])})
    low, high = (o.frequency_hz for o in lower.axes[0])
    assert low < lower.value("axes.x.mount_frequency_hz") < high
    assert lower.value("axes.x.mount_frequency_hz") == pytest.approx(high, rel=0.01)
