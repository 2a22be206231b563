"""The judge is judged: real labelled runs, an energy balance, the order of convergence, and closed forms."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from validation.plants import delta_plant as plant

FloatArray = NDArray[np.float64]
V, ETA = slice(3, 6), slice(6, 9)  # of a state

MACHINE: dict[str, Any] = {
    "kinematics": {
        "arm_length_mm": 300.0,
        "delta_radius_mm": 140.0,
        "tower_angles_deg": [0.0, 120.0, 240.0],
        "effector_height_mm": 50.0,
    },
    "carriage": {
        "mass_kg": 0.179,
        "arm_pair_mass_kg": 0.032,
        "belt_stiffness_n_per_m": 1.21e5,
        "belt_damping_n_s_per_m": 5.31,
        "guide_damping_n_s_per_m": 13.4,
        "drive": {"d0_per_s2": 1.43e5, "d1_per_s": -212.1, "d2_per_s": 36.2},
    },
    "effector": {
        "nozzle_mass_kg": 0.542,
        "extruder_mass_kg": 0.109,
        "extruder_stiffness_n_per_m": [3.31e3, 7.04e3, 1.29e5],
        "extruder_damping_n_s_per_m": [20.4, 40.5, 19.6],
    },
}


def changed(**tables: dict[str, Any]) -> dict[str, Any]:
    """MACHINE with some keys of its tables replaced; `drive=None` makes the drive ideal."""
    machine = copy.deepcopy(MACHINE)
    for table, keys in tables.items():
        machine[table].update(keys)
    if machine["carriage"]["drive"] is None:
        del machine["carriage"]["drive"]
    return machine


CONSERVATIVE = changed(
    carriage={
        "belt_stiffness_n_per_m": 400.0,
        "belt_damping_n_s_per_m": 0.0,
        "guide_damping_n_s_per_m": 0.0,
        "drive": None,
    },
    effector={
        "extruder_stiffness_n_per_m": [90.0, 150.0, 300.0],
        "extruder_damping_n_s_per_m": [0.0, 0.0, 0.0],
    },
)  # so soft that the nozzle swings by centimetres: every nonlinear term is at work


IDEAL_DRIVE = changed(carriage={"belt_damping_n_s_per_m": 300.0, "drive": None})  # here the command's speed counts
DRIVES = pytest.mark.parametrize("machine", [MACHINE, IDEAL_DRIVE], ids=["drive", "ideal drive"])


def at_rest(machine: dict[str, Any], xyz_mm: tuple[float, float, float], steps: int) -> FloatArray:
    return np.tile(plant.carriages_of(machine, np.array([xyz_mm])), (2 * steps + 1, 1))


# ---- labelled runs from outside ------------------------------------------------------------------


@pytest.fixture(scope="module")
def nothing_hidden() -> Path:
    root = Path(os.environ.get("FFCOMP_DATA", Path(__file__).parents[4] / "shared" / "data"))
    folder = root / "runs" / "nothing-hidden"
    if not folder.is_dir():
        pytest.skip(f"the labelled runs are not here: {folder} does not exist (FFCOMP_DATA names their folder)")
    return folder


def residual(folder: Path, run: str) -> FloatArray:
    """Measured minus simulated accelerations : (n, 6) m/s², columns A B C x y z.

    The command between its 1600 Hz samples is the cubic spline through them; 1/12800 s steps; weight
    switched on.
    """
    table = np.genfromtxt(folder / "runs" / run, delimiter=",", names=True)
    command = np.column_stack([table[f"cmd_{tower}_mm"] for tower in "ABC"])
    measured = np.column_stack([table[f"acc_{signal}_m_per_s2"] for signal in "ABCxyz"])
    halves = np.arange((len(table) - 1) * 16 + 1) / 16
    fine = CubicSpline(np.arange(len(table)), command)(halves)
    machine = plant.load_machine(folder / "machine.toml")
    played = plant.simulate(machine, fine, 1 / 12800, gravity=True, keep_every=8)
    return measured - np.hstack([played["carriage_acc_m_per_s2"], played["nozzle_acc_m_per_s2"]])


@pytest.mark.parametrize(
    "run", ["infill-centre-1", "infill-front", "multisine-centre-large", "multisine-left", "slow-back"]
)
def test_a_labelled_run_leaves_nothing_but_its_noise(nothing_hidden: Path, run: str) -> None:
    rms = np.sqrt(np.mean(residual(nothing_hidden, f"{run}.csv") ** 2, axis=0))
    assert rms == pytest.approx(np.full(6, 0.121), rel=0.06)  # truth.toml: 0.121 m/s²


def test_the_mean_of_four_repeats_leaves_half_the_noise(nothing_hidden: Path) -> None:
    """A model error common to the repeats would not average out: it is below a fifth of the noise."""
    repeats = np.array([residual(nothing_hidden, f"multisine-centre-{i}.csv") for i in range(1, 5)])
    noise = np.sqrt(np.mean(np.var(repeats, axis=0, ddof=1)))
    common = np.mean(repeats.mean(axis=0) ** 2) - noise**2 / 4
    assert noise == pytest.approx(0.121, rel=0.02)
    assert common < (0.2 * noise) ** 2


# ---- kinematics ----------------------------------------------------------------------------------


def test_carriage_height_above_the_centre_is_pythagoras() -> None:
    assert plant.carriages_of(MACHINE, [[0.0, 0.0, 30.0]]) == pytest.approx(80.0 + np.sqrt(300.0**2 - 140.0**2))


def test_towers_go_counter_clockwise_from_x() -> None:
    """Towards tower B the carriage B rises; A and C, equally far, fall alike."""
    direction = np.array([np.cos(np.radians(120)), np.sin(np.radians(120)), 0.0])
    a, b, c = (plant.carriages_of(MACHINE, [60 * direction]) - plant.carriages_of(MACHINE, [[0, 0, 0]]))[0]
    assert b > 0 > a and a == pytest.approx(c)


def test_a_nozzle_out_of_reach_is_named_with_its_tower() -> None:
    with pytest.raises(ValueError, match="farther from tower A than its arm"):
        plant.carriages_of(MACHINE, [[0.0, 0.0, 0.0], [-200.0, 0.0, 0.0]])


def test_each_tower_may_have_its_own_arm_and_radius() -> None:
    machine = changed(kinematics={"arm_lengths_mm": [300.0, 310.0, 305.0], "delta_radii_mm": [140.0, 141.0, 139.0]})
    expected = 50.0 + np.sqrt(np.array([300.0, 310.0, 305.0]) ** 2 - np.array([140.0, 141.0, 139.0]) ** 2)
    assert plant.carriages_of(machine, [[0.0, 0.0, 0.0]])[0] == pytest.approx(expected)


# ---- rest and weight -----------------------------------------------------------------------------


@DRIVES
@pytest.mark.parametrize("gravity", [False, True])
def test_rest_stays_rest(machine: dict[str, Any], gravity: bool) -> None:
    played = plant.simulate(machine, at_rest(machine, (60.0, -40.0, 10.0), 640), 1 / 12800, gravity=gravity)
    assert np.max(np.ptp(played["nozzle_mm"], axis=0)) < 1e-9
    assert np.max(np.abs(played["carriage_acc_m_per_s2"])) < 1e-6


def test_the_weight_stretches_the_belts_by_its_share() -> None:
    """Total weight over three belts, closed form at the centre where the arms share it equally."""
    p = plant.plant_of(MACHINE, gravity=True)
    q = plant.carriages_of(MACHINE, [[0.0, 0.0, 10.0]])[0]
    sagged = plant.rest(q / 1e3, p)[:3]
    weight = (3 * (0.179 + 0.016) + 0.542 + 3 * 0.016 + 0.109) * p.gravity
    assert sagged == pytest.approx([0.0, 0.0, 0.010 - weight / (3 * 1.21e5)], abs=1e-12)


# ---- energy and order ----------------------------------------------------------------------------


def energy(p: Any, state: FloatArray, u: FloatArray) -> float:
    """½m|q̇|² + ½M|Ẋ|² + ½m₂|Ẋ + η̇|² + ½k|u - q|² + ½ηᵀKη + weight, J; q̇ by differences, not by A."""

    def carriages(xyz: FloatArray) -> FloatArray:
        return p.height + xyz[2] + np.sqrt(p.arms**2 - np.sum((xyz[:2] - p.towers) ** 2, axis=1))

    x, v, eta, eta_v = state[:12].reshape(4, 3)
    q, dq = carriages(x), (carriages(x + 1e-6 * v) - carriages(x - 1e-6 * v)) / 2e-6
    kinetic = dq @ (p.carriage * dq) + p.holder * v @ v + p.extruder * (v + eta_v) @ (v + eta_v)
    strain = (u - q) @ (p.belt_k * (u - q)) + eta @ (p.mount_k * eta)
    heights = p.carriage @ q + p.holder * x[2] + p.extruder * (x[2] + eta[2])
    return float(kinetic / 2 + strain / 2 + p.gravity * heights)


def kicked(p: Any, command: FloatArray) -> FloatArray:
    state = plant.rest(command[0] / 1e3, p)
    state[V] = [0.9, -0.5, 0.3]
    state[ETA] += [0.01, 0.02, -0.005]
    return state


@pytest.mark.parametrize("gravity", [False, True])
def test_a_large_free_swing_keeps_its_energy(gravity: bool) -> None:
    """1 s with swings over 60 mm: without J̇q̇ the books would be out by percents."""
    command = at_rest(CONSERVATIVE, (40.0, 20.0, 10.0), 12800)
    p = plant.plant_of(CONSERVATIVE, gravity=gravity)
    start = kicked(p, command)
    played = plant.simulate(CONSERVATIVE, command, 1 / 12800, gravity=gravity, start=start)
    u = command[0] / 1e3
    moved = p.holder * start[V] @ start[V] / 2
    assert np.max(np.ptp(played["nozzle_mm"], axis=0)) > 60.0
    assert abs(energy(p, played["state"], u) - energy(p, start, u)) < 1e-9 * moved


def test_dissipation_accounts_for_all_the_energy_lost() -> None:
    """dE/dt = -c|q̇|² - b|q̇|² (no extruder damping), integrated over the kept carriages."""
    machine = copy.deepcopy(CONSERVATIVE)
    machine["carriage"].update(belt_damping_n_s_per_m=1.5, guide_damping_n_s_per_m=0.7)
    command, h = at_rest(machine, (40.0, 20.0, 10.0), 3200), 1 / 12800
    p = plant.plant_of(machine)
    start = kicked(p, command)
    played = plant.simulate(machine, command, h, start=start)
    dq = CubicSpline(played["t"], played["carriage_mm"] / 1e3).derivative()(played["t"])
    lost = CubicSpline(played["t"], 2.2 * np.sum(dq**2, axis=1)).integrate(0.0, played["t"][-1])
    u = command[0] / 1e3
    assert lost > 0.05
    assert energy(p, start, u) - energy(p, played["state"], u) == pytest.approx(lost, rel=1e-6)


def smooth_command(machine: dict[str, Any], h: float) -> FloatArray:
    t = np.arange(round(0.2 / h) * 2 + 1) * h / 2
    swing = np.sin(np.pi * t / 0.2) ** 4
    path = [30 + 40 * swing * np.cos(40 * t), -20 + 30 * swing * np.sin(55 * t), 10 + 5 * swing]
    return plant.carriages_of(machine, np.column_stack(path))


@DRIVES
def test_halving_the_step_divides_the_error_by_sixteen(machine: dict[str, Any]) -> None:
    def end(h: float) -> FloatArray:
        return plant.simulate(machine, smooth_command(machine, h), h)["nozzle_mm"][-1]

    exact = end(1 / 51200)
    errors = [np.linalg.norm(end(h) - exact) for h in (1 / 800, 1 / 1600, 1 / 3200)]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.25)
    assert errors[1] / errors[2] == pytest.approx(16, rel=0.25)


@DRIVES
def test_one_step_of_a_12800th_second_costs_less_than_a_nanometre(machine: dict[str, Any]) -> None:
    coarse = plant.simulate(machine, smooth_command(machine, 1 / 12800), 1 / 12800)["nozzle_mm"]
    fine = plant.simulate(machine, smooth_command(machine, 1 / 51200), 1 / 51200, keep_every=4)["nozzle_mm"]
    assert np.max(np.abs(coarse - fine)) < 1e-6


def test_a_command_in_chunks_is_the_command_in_one() -> None:
    command = smooth_command(MACHINE, 1 / 3200)
    whole = plant.simulate(MACHINE, command, 1 / 3200)
    first = plant.simulate(MACHINE, command[:401], 1 / 3200)
    second = plant.simulate(MACHINE, command[400:], 1 / 3200, start=first["state"])
    assert np.array_equal(whole["nozzle_mm"][200:], second["nozzle_mm"])


def test_turning_command_and_towers_by_120_degrees_turns_the_answer() -> None:
    """Not with three different extruder springs, which stay where they are: they are made alike here."""
    machine = changed(
        effector={
            "extruder_stiffness_n_per_m": [5e3, 5e3, 1e5],
            "extruder_damping_n_s_per_m": [30.0, 30.0, 20.0],
        }
    )
    command = smooth_command(machine, 1 / 3200)
    plain = plant.simulate(machine, command, 1 / 3200)["nozzle_mm"]
    turned = plant.simulate(machine, np.roll(command, 1, axis=1), 1 / 3200)["nozzle_mm"]
    c, s = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
    assert turned == pytest.approx(plain @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), abs=1e-9)


# ---- small motions against closed forms ----------------------------------------------------------


def ring_down_hz(machine: dict[str, Any], direction: FloatArray) -> float:
    """Frequency of the free motion after a tiny push, from its zero crossings."""
    command, h = at_rest(machine, (0.0, 0.0, 10.0), 6400), 1 / 12800
    state = plant.rest(command[0] / 1e3, plant.plant_of(machine))
    state[V] = 1e-5 * direction
    along = plant.simulate(machine, command, h, start=state)["nozzle_mm"] @ direction
    along = along - (10.0 * direction[2])
    rises = np.flatnonzero((along[:-1] < 0) & (along[1:] >= 0))
    at = (rises - along[rises] / (along[rises + 1] - along[rises])) * h
    return float((len(at) - 1) / (at[-1] - at[0]))


@pytest.mark.parametrize(
    ("direction", "sigma2"), [((1, 0, 0), 2 / 3 * (300**2 / 140**2 - 1)), ((0, 0, 1), 1 / 3)], ids=["x", "z"]
)
def test_modes_of_a_rigid_effector_at_the_centre(direction: tuple[int, int, int], sigma2: float) -> None:
    """ω_r = √(k/(m + M σ_r²)), σ² = 1/3 and twice ⅔ (h/R)²: 43.5 and 86 Hz for the 0.651 kg effector."""
    machine = changed(
        carriage={
            "arm_pair_mass_kg": 0.0,
            "mass_kg": 0.195,
            "belt_damping_n_s_per_m": 0.0,
            "guide_damping_n_s_per_m": 0.0,
            "drive": None,
        },
        effector={"nozzle_mass_kg": 0.651, "extruder_mass_kg": 0.0},
    )
    expected = np.sqrt(1.21e5 / (0.195 + 0.651 * sigma2)) / (2 * np.pi)
    assert ring_down_hz(machine, np.array(direction, dtype=float)) == pytest.approx(expected, rel=1e-4)


def closed_form(machine: dict[str, Any], xyz_mm: tuple[float, float, float], s: complex) -> NDArray[np.complex128]:
    """G = [(m s² + (c+b) s + k) I + JᵀWJ]⁻¹ (c s + k) G_e : (3, 3), carriages' commands → carriages.

    W = M₁s² + D - D (m₂s² + D)⁻¹ D with D = Bs + K; J by inverting differences of the inverse kinematics.
    """
    p = plant.plant_of(machine)
    nudges = 1e-3 * np.vstack([np.eye(3), -np.eye(3)])
    around = plant.carriages_of(machine, np.array(xyz_mm) + nudges)
    jacobian = np.linalg.inv((around[:3] - around[3:]).T / 2e-3)
    d = p.mount_b * s + p.mount_k
    w = p.holder * s**2 + d - d**2 / (p.extruder * s**2 + d)
    inertia = np.diag(p.carriage * s**2 + (p.belt_c + p.guide_b) * s + p.belt_k)
    d0, d1, d2 = p.drive
    drive = 1.0 if p.ideal else (d1 * s + d0) / (s**2 + d2 * s + d0)
    return np.linalg.inv(inertia + jacobian.T @ np.diag(w) @ jacobian) * ((p.belt_c * s + p.belt_k) * drive)


def measured_response(machine: dict[str, Any], xyz_mm: tuple[float, float, float], hz: float) -> NDArray[np.complex128]:
    """Complex amplitudes of the carriages : (3,), for 1 µm on motor B, fitted after the transient died."""
    h, command = 1 / 12800, at_rest(machine, xyz_mm, 12800)
    omega = 2 * np.pi * hz
    command[:, 1] += 1e-3 * np.sin(omega * np.arange(len(command)) * h / 2)
    played = plant.simulate(machine, command, h)
    late = played["t"] > 0.8
    t = played["t"][late]
    waves = np.column_stack([np.sin(omega * t), np.cos(omega * t), np.ones_like(t)])
    fit = np.linalg.lstsq(waves, played["carriage_mm"][late], rcond=None)[0]
    return (fit[0] + 1j * fit[1]) / 1e-3


@pytest.mark.parametrize("hz", [10.0, 45.0, 90.0])
@DRIVES
def test_small_vibrations_are_the_coupled_receptances(machine: dict[str, Any], hz: float) -> None:
    place = (70.0, -40.0, 10.0)
    expected = closed_form(machine, place, 2j * np.pi * hz)[:, 1]
    assert np.max(np.abs(measured_response(machine, place, hz) - expected)) < 2e-4 * np.max(np.abs(expected))


# ---- what it refuses -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("attempt", "message"),
    [
        (lambda: plant.simulate(MACHINE, np.zeros((4, 3)), 1e-4), r"must be \(2 n \+ 1, 3\)"),
        (lambda: plant.plant_of({**MACHINE, "effects": {"cogging": {}}}), "no effects.*cogging"),
        (
            lambda: plant.simulate(
                MACHINE,
                at_rest(MACHINE, (0.0, 0.0, 9.0), 400) + np.linspace(0, 1, 801)[:, None] * [900, 0, 0],
                1e-4,
            ),
            "left the arms' reach",
        ),
    ],
    ids=["shape", "effects", "reach"],
)
def test_refusals_say_why(attempt: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        attempt()
