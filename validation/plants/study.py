"""The paper's measurements in the virtual laboratory, brought to frequency responses."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffcomp.identification.predict import mean_absolute_percentage_accuracy
from ffcomp.measurement.estimators import periodic_frf
from ffcomp.measurement.frf import FrequencyResponse
from models.arrays import ComplexArray
from validation.plants import lab

PLACES = ((0.0, 0.0, 30.0), (-80.0, 0.0, 30.0), (40.0, -69.0, 30.0), (40.0, 69.0, 30.0))
LOWEST_HZ, HIGHEST_HZ, HAMMER_HZ = 2.0, 125.0, 400.0
CARRIAGE_M, PRINTER_M = 2e-3, 1e-3  # peak of a command: more, and the geometry distorts; less, and friction does
SLOPE = -1.0  # amplitude ∝ 1/f: equal speed at all frequencies
ADDED_KG = 0.2


def uneven(machine: dict[str, Any], seed: int, friction_n: float) -> dict[str, Any]:
    """Towers that differ: belts by 2 %, masses by 2 %, dampings by 5 %, friction by 20 % (standard deviations)."""
    rng = np.random.default_rng(seed)
    parts = machine["carriage"]
    spread = {
        "carriage_mass_kg": (parts["mass_kg"], 0.02),
        "belt_stiffness_n_per_m": (parts["belt_stiffness_n_per_m"], 0.02),
        "belt_damping_n_s_per_m": (parts["belt_damping_n_s_per_m"], 0.05),
        "guide_damping_n_s_per_m": (parts["guide_damping_n_s_per_m"], 0.05),
        "friction_n": (friction_n, 0.2),
    }
    towers = {key: (mean * (1 + sd * rng.standard_normal(3))).tolist() for key, (mean, sd) in spread.items()}
    return {**machine, "towers": {**towers, "stiction": 0.3}}


def measure_bench(machine: dict[str, Any], snr_db: float, seed: int) -> list[FrequencyResponse]:
    """Carriage A alone and with 200 g, the effector along x y z, the printer at the centre along x y z."""
    rng = np.random.default_rng(seed)
    wave = lab.multisine(LOWEST_HZ, HIGHEST_HZ, CARRIAGE_M, SLOPE, seed)
    found = []
    for setup, added in (("carriage", 0.0), ("carriage+mass", ADDED_KG)):
        record = lab.noisy(lab.carriage(machine, 0, added, wave), snr_db, rng)
        found += _responses(record, "cmd_A", ["pos_A"], setup=setup, added_mass_kg=added)
    force = lab.multisine(5.0, HAMMER_HZ, 10.0, 0.0, seed + 1)
    for i, axis in enumerate("xyz"):
        record = lab.noisy(lab.effector(machine, i, force), snr_db, rng)
        found += _responses(record, f"force_{axis}", [f"acc_{axis}"], setup="effector")
    for i, axis in enumerate("xyz"):
        own = lab.multisine(LOWEST_HZ, HIGHEST_HZ, PRINTER_M, SLOPE, seed + 2 + i)
        record = lab.noisy(lab.assembly(machine, PLACES[0], axis, own), snr_db, rng)
        answers = _responses(record, f"cmd_{axis}", ["pos_A", "pos_B", "pos_C"], position_mm=PLACES[0])
        found += [a for a in answers if (axis, a.output) != ("y", "pos_A")]  # y does not move A at the centre
    return found


def measure_places(machine: dict[str, Any], snr_db: float, seed: int) -> list[FrequencyResponse]:
    """A to A, B to B, C to C at the paper's four places."""
    rng = np.random.default_rng(seed)
    found = []
    for place in PLACES:
        for i, tower in enumerate("ABC"):
            wave = lab.multisine(LOWEST_HZ, HIGHEST_HZ, PRINTER_M, SLOPE, seed + i)
            record = lab.noisy(lab.assembly(machine, place, tower, wave), snr_db, rng)
            answers = _responses(record, f"cmd_{tower}", ["pos_A", "pos_B", "pos_C"], position_mm=place)
            found.append(answers[i])
    return found


def _responses(record: lab.Record, excited: str, answers: list[str], **about: Any) -> list[FrequencyResponse]:
    period = round(lab.PERIOD_S * lab.RATE_HZ)
    lifted = record.answer - record.answer.mean(axis=0)  # where a carriage stands is not how it answers
    matrix = periodic_frf(record.excited[:, None], lifted, lab.RATE_HZ, period)
    return matrix.responses([excited], answers, (0.0, lab.RATE_HZ), **about)


def error_reduction(
    measured: ComplexArray, predicted: ComplexArray, baseline: ComplexArray, smallest_phase_deg: float
) -> tuple[float, float]:
    """How much smaller the error is than that of a baseline model, of magnitude and of phase, % (Eq. 72)."""
    (magnitude, phase), (without, late) = (
        mean_absolute_percentage_accuracy(measured, model, smallest_phase_deg) for model in (predicted, baseline)
    )
    return 100 * (1 - (100 - magnitude) / (100 - without)), 100 * (1 - (100 - phase) / (100 - late))
