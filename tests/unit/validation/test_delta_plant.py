"""The judge is judged: real labelled runs, an energy balance, the order of convergence, and closed forms."""

from __future__ import annotations

import copy
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from validation.plants import delta_plant as plant

FloatArray = NDArray[np.float64]

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


@pytest.mark.parametrize("run", ["infill-front", "multisine-centre-large", "slow-back"])
def test_a_labelled_run_leaves_nothing_but_its_noise(nothing_hidden: Path, run: str) -> None:
    rms = np.sqrt(np.mean(residual(nothing_hidden, f"{run}.csv") ** 2, axis=0))
    assert rms == pytest.approx(np.full(6, 0.121), rel=0.06)  # truth.toml: 0.121 m/s²


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


# ---- small motions against closed forms ----------------------------------------------------------


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
