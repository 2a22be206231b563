"""A virtual laboratory: the paper's measurements as time records, made by plants that share no line with ours.

Excitations are multisines in whole periods: exact functions of time, so the integrator reads them at its own nodes and
no spectrum leaks. Records are sampled positions of carriages or accelerations of the effector, with the sensors' noise
put on afterwards; what the laboratory hands out are records of command (or force) and answer, nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.plants import delta_plant

FloatArray = NDArray[np.float64]

STEP_S = 1 / 12800
RATE_HZ = 1600.0
PERIOD_S = 2.0  # lines every 0.5 Hz, as the paper's
PERIODS = 5  # the first of which settles


@dataclass(frozen=True, eq=False)
class Record:
    """One experiment: uniform samples at RATE_HZ, PERIODS periods."""

    excited: FloatArray  # (n,) m, or N for the hammer
    answer: FloatArray  # (n, o) m or m/s²


def multisine(lowest_hz: float, highest_hz: float, peak_m: float, slope: float, seed: int) -> tuple[FloatArray, ...]:
    """Lines (Hz), amplitudes (m) ∝ f^slope, random phases; scaled to a peak of `peak_m`."""
    f = np.arange(np.ceil(lowest_hz * PERIOD_S), highest_hz * PERIOD_S + 1e-9) / PERIOD_S
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(f))
    amplitude = f**slope
    one = _sum(np.arange(0, PERIOD_S, 1 / 3200), f, amplitude, phase)
    return f, amplitude * peak_m / np.max(np.abs(one)), phase


def _sum(t: FloatArray, f: FloatArray, amplitude: FloatArray, phase: FloatArray) -> FloatArray:
    """One period by FFT, exact at multiples of the step, repeated."""
    n = round(PERIOD_S / (t[1] - t[0]))
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[np.rint(f * PERIOD_S).astype(int)] = amplitude * np.exp(1j * phase) * n / 2
    return np.resize(np.fft.irfft(spectrum, n), len(t))


def excitation(wave: tuple[FloatArray, ...], step_s: float) -> FloatArray:
    """(2 n + 1,) at half steps over all periods."""
    count = 2 * round(PERIODS * PERIOD_S / step_s) + 1
    return _sum(np.arange(count) * step_s / 2, *wave)


# ---- the whole printer ---------------------------------------------------------------------------


def assembly(
    machine: dict[str, Any], place_mm: tuple[float, float, float], direction: str, wave: tuple[FloatArray, ...]
) -> Record:
    """Command along x, y, z (nozzle) or A, B, C (one carriage) → the carriages' positions."""
    moved = excitation(wave, STEP_S) * 1e3
    rest = np.array([place_mm])
    if direction in "ABC":
        command = delta_plant.carriages_of(machine, rest) + moved[:, None] * np.eye(3)["ABC".index(direction)]
    else:
        command = delta_plant.carriages_of(machine, rest + moved[:, None] * np.eye(3)["xyz".index(direction)])
    every = round(1 / RATE_HZ / STEP_S)
    found = delta_plant.simulate(machine, command, STEP_S, gravity=True, keep_every=every)
    return Record(moved[:: 2 * every][:-1] / 1e3, found["carriage_mm"][:-1] / 1e3)


# ---- a carriage alone ----------------------------------------------------------------------------


def carriage(machine: dict[str, Any], tower: int, added_kg: float, wave: tuple[FloatArray, ...]) -> Record:
    """Command → position of one carriage with the upper halves of its arms, without the effector."""
    parts, moved = machine["carriage"], excitation(wave, STEP_S) * 1e3
    towers = {"carriage_mass_kg": [parts["mass_kg"]] * 3, **machine.get("towers", {})}
    masses = towers["carriage_mass_kg"] + added_kg * np.eye(3)[tower]
    command = delta_plant.carriages_of(machine, np.zeros((1, 3))) + moved[:, None] * np.eye(3)[tower]
    every = round(1 / RATE_HZ / STEP_S)
    found = delta_plant.simulate(
        {**machine, "towers": {**towers, "carriage_mass_kg": masses}},
        command,
        STEP_S,
        keep_every=every,
        hidden={"shares": np.zeros((3, 3))},  # of the effector's load
    )
    place = found["carriage_mm"][:-1, [tower]] / 1e3
    return Record(moved[:: 2 * every][:-1] / 1e3, place - (command[0, tower] - moved[0]) / 1e3)


# ---- the effector alone --------------------------------------------------------------------------


def effector(machine: dict[str, Any], axis: int, wave: tuple[FloatArray, ...]) -> Record:
    """Force on the free nozzle holder → its acceleration along the same axis, without the arms' halves.

    A periodic force in the hammer's place: the same frequency response, no leakage. Solved line by line from the two
    equations of motion, m_1 ẍ = F − k (x − x_2) − b (ẋ − ẋ_2) and m_2 ẍ_2 = k (x − x_2) + b (ẋ − ẋ_2).
    """
    parts = machine["effector"]
    m1, m2 = parts["nozzle_mass_kg"], parts["extruder_mass_kg"]
    k, b = parts["extruder_stiffness_n_per_m"][axis], parts["extruder_damping_n_s_per_m"][axis]
    f, amplitude, phase = wave
    s = 2j * np.pi * f
    spring = k + b * s
    left = np.moveaxis(np.array([[m1 * s**2 + spring, -spring], [-spring, m2 * s**2 + spring]]), 2, 0)
    force = amplitude * np.exp(1j * phase)
    x = np.linalg.solve(left, np.stack([force, 0 * force], axis=1)[:, :, None])[:, 0, 0]
    acceleration = s**2 * x
    t = np.arange(round(PERIODS * PERIOD_S * RATE_HZ)) / RATE_HZ
    answer = _sum(t, f, np.abs(acceleration), np.angle(acceleration))
    return Record(_sum(t, f, amplitude, phase), answer[:, None])


def noisy(record: Record, snr_db: float, rng: np.random.Generator) -> Record:
    """The answers with white noise, so far under their own rms; the command is known."""
    level = np.sqrt(np.var(record.answer, axis=0)) * 10 ** (-snr_db / 20)
    return Record(record.excited, record.answer + rng.normal(size=record.answer.shape) * level)
