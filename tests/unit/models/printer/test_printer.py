"""The virtual printer without effects: an independent judge, closed forms, the linear plant, invariances, chunks."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from models.arrays import constant
from models.errors import UnreachableError
from models.kinds import delta_vibration, with_parts
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine
from models.printer.parameters import GRAVITY_M_PER_S2
from models.printer.printer import PrinterMotion, simulate_printer
from models.vibration.state_space import discretise
from validation.plants import delta_plant  # the judge: it shares nothing with ours

RATE_HZ = 1600
FIELDS = ("carriage_mm", "nozzle_mm", "motor_mm", "carriage_acceleration", "nozzle_acceleration")


def sweeping(geometry: DeltaKinematics, seconds: float = 1.0) -> np.ndarray:
    """Carriage commands of a curve over half the bed with a shake on it, from rest."""
    t = np.arange(0, seconds, 1 / RATE_HZ)
    x = 30 * np.sin(2 * np.pi * 2 * t) + np.sin(2 * np.pi * 27 * t)
    y = 20 * np.sin(2 * np.pi * 2.3 * t)
    z = 50 + 2 * np.sin(2 * np.pi * 11 * t)
    rise = (1 - np.exp(-((t * 5) ** 4)))[:, None]
    return geometry.inverse(np.column_stack([x, y, z]) * rise + [0, 0, 20])


def judged(machine: Machine, command: np.ndarray, gravity: bool) -> dict[str, np.ndarray]:
    t = np.arange(len(command)) / RATE_HZ
    finer = 16  # half steps of 1/12800 s
    half_steps = CubicSpline(t, command)(np.arange((len(t) - 1) * finer + 1) / (RATE_HZ * finer))
    document = delta_plant.load_machine(machine.path)
    if delta_vibration(machine).carriage.drive is None:
        del document["carriage"]["drive"]
    document["carriage"]["arm_pair_mass_kg"] = delta_vibration(machine).carriage.arm_pair_mass_kg
    document["carriage"]["arm_mass_share_at_ends"] = delta_vibration(machine).carriage.arm_mass_share_at_ends
    document["kinematics"]["arm_lengths_mm"] = list(machine.kinematics.arm_lengths_mm)
    document["kinematics"]["delta_radii_mm"] = list(machine.kinematics.delta_radii_mm)
    return delta_plant.simulate(document, half_steps, 1 / 12800, gravity=gravity, keep_every=8)


def uneven(machine: Machine) -> Machine:
    geometry = machine.kinematics
    arms = geometry.arm_lengths_mm + np.array([0, 1, -1.5])
    radii = geometry.delta_radii_mm + np.array([0.5, -0.7, 0])
    return replace(machine, kinematics=replace(geometry, arm_lengths_mm=constant(arms), delta_radii_mm=constant(radii)))


def ideal(machine: Machine) -> Machine:
    return with_parts(machine, carriage=replace(delta_vibration(machine).carriage, drive=None))


def rods(machine: Machine) -> Machine:
    """Return the uneven machine with arms as heavy as its carriages, a fifth of it at their ends."""
    carriage = replace(delta_vibration(machine).carriage, arm_pair_mass_kg=0.2, arm_mass_share_at_ends=0.2)
    return uneven(with_parts(machine, carriage=carriage))


CHANGES = {"as it is": lambda m: m, "uneven arms": uneven, "ideal drive": ideal, "rods": rods}


@pytest.mark.parametrize("gravity", [True, False])
@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_the_judge_agrees(printer: Machine, change, gravity: bool) -> None:
    machine = change(printer)
    command = sweeping(machine.kinematics)
    ours, theirs = simulate_printer(machine, command, 1 / RATE_HZ, gravity=gravity), judged(machine, command, gravity)
    for field in ("carriage_mm", "nozzle_mm"):
        np.testing.assert_allclose(getattr(ours, field), theirs[field], rtol=0, atol=1e-6)
    atol = (
        1e-4 if delta_vibration(machine).carriage.drive else 1e-2
    )  # the judge differentiates an ideal drive's command numerically
    np.testing.assert_allclose(ours.carriage_acceleration, theirs["carriage_acc_m_per_s2"], atol=atol)
    np.testing.assert_allclose(ours.nozzle_acceleration, theirs["nozzle_acc_m_per_s2"], atol=atol)


def test_the_order_of_convergence_is_four(printer: Machine) -> None:
    command = sweeping(printer.kinematics, 0.4)
    best, *others = (simulate_printer(printer, command, 1 / RATE_HZ, substeps=n).nozzle_mm for n in (32, 1, 2, 4))
    errors = [np.abs(other - best).max() for other in others]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(16, rel=0.1)
    assert errors[2] < 1e-6  # mm, with the step that is chosen for a printer without kinks


# --- Rest


def resting(machine: Machine, seconds: float = 0.05, **options) -> PrinterMotion:
    """At the centre of the bed."""
    q = machine.kinematics.inverse(np.array([[0.0, 0.0, 40.0]]))
    return simulate_printer(machine, np.tile(q, (round(seconds * RATE_HZ), 1)), 1 / RATE_HZ, **options)


def sag_load(machine: Machine) -> float:
    """N on each belt at rest at the centre: the carriage's weight and a third of the effector's."""
    effector = delta_vibration(machine).nozzle_side_mass_kg + delta_vibration(machine).effector.extruder_mass_kg
    return GRAVITY_M_PER_S2 * (delta_vibration(machine).carriage.moving_mass_kg + effector / 3)


def test_belts_carry_the_weight(printer: Machine) -> None:
    motion = resting(printer)
    sag = motion.motor_mm[-1] - motion.carriage_mm[-1]
    np.testing.assert_allclose(
        sag, 1e3 * sag_load(printer) / delta_vibration(printer).carriage.belt_stiffness_n_per_m, rtol=1e-9
    )
    still = resting(printer, gravity=False)
    np.testing.assert_allclose(still.motor_mm, still.carriage_mm, atol=1e-9)


# --- The linear plant


@pytest.mark.parametrize("drive", [True, False])
@pytest.mark.parametrize("force_map", ["virtual_work", "paper"])
def test_small_motions_are_those_of_the_linear_plant(printer: Machine, force_map: str, drive: bool) -> None:
    machine = with_parts(printer, effector=replace(delta_vibration(printer).effector, force_map=force_map))
    machine = machine if drive else ideal(machine)
    place = np.array([[40.0, -30.0, 25.0]])
    steps = 1e-5 * np.random.default_rng(5).standard_normal((200, 3))  # 10 nm: nothing bends
    small = np.cumsum(steps, axis=0) - steps[0]
    command = machine.kinematics.inverse(place) + small
    motion = simulate_printer(machine, command, 1e-3, hold="linear", gravity=False)
    plant = discretise(machine.vibration.state_space(place[:, :2]), 1e-3)
    state = np.zeros(18)
    linear = [state[6:9]]
    for before, after in pairwise(small):
        state = plant.a[0] @ state + plant.b0[0] @ before + plant.b1[0] @ after
        linear.append(state[6:9])
    np.testing.assert_allclose(motion.carriage_mm - command[0], linear, atol=1e-4 * np.abs(small).max())


# --- Invariances


@pytest.fixture
def symmetric(printer: Machine) -> Machine:
    effector = replace(
        delta_vibration(printer).effector,
        extruder_stiffness_n_per_m=constant([5e3, 5e3, 1e5]),
        extruder_damping_n_s_per_m=constant([30, 30, 20]),
        center_of_mass_mm=constant([0, 0, 15]),
    )
    return with_parts(printer, effector=effector)


@pytest.mark.parametrize("force_map", ["virtual_work", "paper"])
def test_a_turn_of_120_degrees_turns_the_answer(symmetric: Machine, force_map: str) -> None:
    machine = with_parts(symmetric, effector=replace(delta_vibration(symmetric).effector, force_map=force_map))
    command = sweeping(machine.kinematics, 0.5)
    motion = simulate_printer(machine, command, 1 / RATE_HZ)
    turned = simulate_printer(machine, np.roll(command, 1, axis=1), 1 / RATE_HZ)  # A's command to B: +120°
    c, s = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(turned.nozzle_mm, motion.nozzle_mm @ turn.T, atol=1e-9)
    np.testing.assert_allclose(turned.nozzle_acceleration, motion.nozzle_acceleration @ turn.T, atol=1e-6)
    np.testing.assert_allclose(turned.carriage_mm, np.roll(motion.carriage_mm, 1, axis=1), atol=1e-9)


# --- Chunks and holds


@pytest.mark.parametrize("hold", ["cubic", "linear"])
def test_chunks_are_the_whole(printer: Machine, hold) -> None:
    command = sweeping(printer.kinematics)
    whole = simulate_printer(printer, command, 1 / RATE_HZ, hold=hold)
    state, first = None, 0
    for last in (300, 301, 900, len(command) - 1):  # one of them a single interval
        ahead = command[last + 1 : last + 31]
        chunk = simulate_printer(printer, command[first : last + 1], 1 / RATE_HZ, start=state, hold=hold, ahead=ahead)
        for field in FIELDS:
            np.testing.assert_allclose(getattr(chunk, field), getattr(whole, field)[first : last + 1], atol=1e-8)
        np.testing.assert_allclose(chunk.t_s, whole.t_s[first : last + 1], atol=1e-12)
        state, first = chunk.state, last


# --- Refusals


def test_a_wrong_command_is_refused(printer: Machine) -> None:
    q = printer.kinematics.inverse(np.array([[0.0, 0.0, 20.0]]))
    with pytest.raises(ValueError, match=r"shape \(1, 3\); it must be"):
        simulate_printer(printer, q, 1e-3)
    with pytest.raises(ValueError, match="from row to row is 0 s"):
        simulate_printer(printer, np.tile(q, (3, 1)), 0)
    with pytest.raises(ValueError, match="Row 2 of the command"):
        simulate_printer(printer, np.vstack([q, q, q * np.nan]), 1e-3)
    state = simulate_printer(printer, np.tile(q, (3, 1)), 1e-3).state
    with pytest.raises(ValueError, match="must repeat the last row of the chunk before"):
        simulate_printer(printer, np.tile(q + 0.1, (3, 1)), 1e-3, start=state)


def test_leaving_the_reach_is_told_with_its_time(printer: Machine) -> None:
    q = printer.kinematics.inverse(np.array([[0.0, 0.0, 20.0]]))
    command = q + np.linspace(0, 1, 800)[:, None] * [700.0, 0.0, 0.0]
    with pytest.raises(UnreachableError, match=r"At t = 0\.\d+ s the simulated nozzle has left") as caught:
        simulate_printer(printer, command, 1e-3)
    assert 300 < caught.value.indices[0] < 799
    with pytest.raises(UnreachableError, match="too far apart"):
        simulate_printer(printer, command[::-1], 1e-3)
