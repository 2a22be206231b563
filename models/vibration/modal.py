"""Axes that vibrate by themselves, told by their modes: the numbers that a shaper calibration or an FRF gives.

An axis q with commanded place u is the sum of two oscillators side by side, p₁ + p₂, with shares σ₁ + σ₂ = 1:

    m p̈₁ = k (σ₁ u − p₁) + c (σ₁ u̇ − ṗ₁) − b ṗ₁          m₂ p̈₂ = K (σ₂ u − p₂) − B ṗ₂
    q/u = σ₁ (c s + k)/(m s² + (c + b) s + k) + σ₂ K/(m₂ s² + B s + K)

A mode of natural frequency ω and damping ratio ζ has k = ω² m and b = 2 ζ ω m. Written with η = p₂ − σ₂ q, which is
zero at rest, the states are those of a delta's carriages and extruder (`plant.py`), and so are the numbers' names; only
ratios to the masses matter. An axis with one mode has no second oscillator (σ₂ = 0); a rigid one is a stiff first
one, damped by c, which does not make it lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.arrays import ComplexArray, FloatArray, constant
from models.machine import Carriage, Effector, Machine

SILENT_HZ, SILENT_DAMPING = 400.0, 1.1  # of a second oscillator that takes no part; it does not swing
RIGID_HZ, RIGID_DAMPING = 1500.0, 1.1


@dataclass(frozen=True)
class Axis:
    """One axis; without modes it is rigid."""

    frequency_hz: Sequence[float] = ()  # one or two, undamped
    damping_ratio: Sequence[float] = ()
    share: Sequence[float] = (1.0,)


def parts(axes: Sequence[Axis]) -> dict[str, Any]:
    """Three axes X Y Z as the fields of a `Machine`."""
    first = np.array([axis.frequency_hz[0] if axis.frequency_hz else RIGID_HZ for axis in axes])
    damping = np.array([axis.damping_ratio[0] if axis.frequency_hz else RIGID_DAMPING for axis in axes])
    rigid = np.array([not axis.frequency_hz for axis in axes])
    both = [len(axis.frequency_hz) == 2 for axis in axes]
    second = np.array([axis.frequency_hz[1] if two else SILENT_HZ for axis, two in zip(axes, both, strict=True)])
    fading = np.array([axis.damping_ratio[1] if two else SILENT_DAMPING for axis, two in zip(axes, both, strict=True)])
    share = np.array([axis.share[0] if two else 1.0 for axis, two in zip(axes, both, strict=True)])
    omega, omega_2 = 2 * np.pi * first, 2 * np.pi * second
    numbers: dict[str, Any] = {
        "mass_kg": constant(np.ones(3)),
        "belt_stiffness_n_per_m": constant(omega**2),
        "belt_damping_n_s_per_m": constant(np.where(rigid, 2 * damping * omega, 0.0)),
        "guide_damping_n_s_per_m": constant(np.where(rigid, 0.0, 2 * damping * omega)),
    }
    effector = Effector(
        nozzle_mass_kg=1.0,
        extruder_mass_kg=1.0,
        extruder_stiffness_n_per_m=constant(omega_2**2),
        extruder_damping_n_s_per_m=constant(2 * fading * omega_2),
        joint_radius_mm=0.0,
        center_of_mass_mm=constant(np.zeros(3)),
    )
    return {
        "carriage": Carriage(**numbers, arm_pair_mass_kg=0.0),
        "effector": effector,
        "first_share": constant(share),
    }


@dataclass(frozen=True)
class _Numbers:
    """Of the three axes, each (3,)."""

    k: FloatArray  # 1/s², per mass as all of them
    c: FloatArray  # 1/s
    b: FloatArray
    k_2: FloatArray
    b_2: FloatArray
    share: FloatArray  # σ₁


def _numbers(machine: Machine) -> _Numbers:
    carriage, effector = machine.carriage, machine.effector
    assert machine.first_share is not None, "a machine with straight axes"
    return _Numbers(
        np.asarray(carriage.belt_stiffness_n_per_m / carriage.moving_mass_kg),
        np.asarray(carriage.belt_damping_n_s_per_m / carriage.moving_mass_kg),
        np.asarray(carriage.guide_damping_n_s_per_m / carriage.moving_mass_kg),
        effector.extruder_stiffness_n_per_m / effector.extruder_mass_kg,
        effector.extruder_damping_n_s_per_m / effector.extruder_mass_kg,
        machine.first_share,
    )


def oscillators(machine: Machine) -> tuple[FloatArray, FloatArray]:
    """p̈₁ and p̈₂ of each axis, (2, 3, 6): of q, q̇, η, η̇, u, u̇; and σ₁ (3,)."""
    n = _numbers(machine)
    zero, other = np.zeros(3), 1.0 - n.share
    first = [-n.k * n.share, -(n.c + n.b) * n.share, n.k, n.c + n.b, n.k * n.share, n.c * n.share]
    second = [-n.k_2 * other, -n.b_2 * other, -n.k_2, -n.b_2, n.k_2 * other, zero]
    return np.stack([np.stack(first, axis=-1), np.stack(second, axis=-1)]), n.share


def axis_frf(machine: Machine, s: ComplexArray) -> ComplexArray:
    """q/u of each axis: (k, 3) for s (k,) 1/s."""
    n, s = _numbers(machine), s[:, None]
    first = (n.c * s + n.k) / (s**2 + (n.c + n.b) * s + n.k)
    return np.asarray(n.share * first + (1.0 - n.share) * n.k_2 / (s**2 + n.b_2 * s + n.k_2))


def low_frequency(machine: Machine) -> tuple[FloatArray, FloatArray]:
    """τ s and C s² of (q/u)⁻¹ ≈ 1 + τ s + C s², (3,) each: the sums' series at s = 0, turned over."""
    n = _numbers(machine)
    lag, lag_2 = n.b / n.k, n.b_2 / n.k_2
    bend, bend_2 = 1.0 / n.k - lag * (n.c / n.k + lag), 1.0 / n.k_2 - lag_2**2
    tau = n.share * lag + (1.0 - n.share) * lag_2
    return tau, n.share * bend + (1.0 - n.share) * bend_2 + tau**2


def uncertainties(axis: int, frequency: float, damping: float) -> dict[str, float]:
    """Relative uncertainties of the model's numbers from those of an axis' modes: stiffness is frequency squared."""
    stiffness = (f"carriage.belt_stiffness_n_per_m[{axis}]", f"effector.extruder_stiffness_n_per_m[{axis}]")
    dampers = (f"carriage.guide_damping_n_s_per_m[{axis}]", f"effector.extruder_damping_n_s_per_m[{axis}]")
    return {**dict.fromkeys(stiffness, 2 * frequency), **dict.fromkeys(dampers, damping)}
