"""A virtual laboratory: the paper's measurements on the independent delta, as frequency responses.

Excitations are multisines in whole periods: exact functions of time, so the integrator reads them at its own nodes and
no spectrum leaks. Records are sampled positions of carriages or accelerations of the effector, with the sensors' noise
put on afterwards; what the laboratory hands out are responses of such records, nothing else.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ffcomp.identification.predict import mean_absolute_percentage_accuracy
from ffcomp.measurement.estimators import periodic_frf
from ffcomp.measurement.frf import FrequencyResponse
from models.arrays import ComplexArray
from validation.plants import delta_plant

FloatArray = NDArray[np.float64]
Record: TypeAlias = tuple[FloatArray, FloatArray]  # (n,) m, or N for the hammer; (n, o) m or m/s²
Place: TypeAlias = tuple[float, float, float]
Wave: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]  # lines Hz, amplitudes, phases

STEP_S, RATE_HZ = 1 / 12800, 1600.0
EVERY = round(1 / RATE_HZ / STEP_S)
PERIOD_S, PERIODS = 2.0, 5  # lines every 0.5 Hz, as the paper's; the first period settles
PLACES: tuple[Place, ...] = ((0.0, 0.0, 30.0), (-80.0, 0.0, 30.0), (40.0, -69.0, 30.0), (40.0, 69.0, 30.0))
LOWEST_HZ, HIGHEST_HZ, HAMMER_HZ = 2.0, 125.0, 400.0
CARRIAGE_M, PRINTER_M = 2e-3, 1e-3  # peak of a command: more, and the geometry distorts; less, and friction does
SLOPE = -1.0  # amplitude ∝ 1/f: equal speed at all frequencies
ADDED_KG = 0.2
TOWERS = ["pos_A", "pos_B", "pos_C"]


def uneven(machine: dict[str, Any], seed: int, friction_n: float) -> dict[str, Any]:
    """Towers that differ: belts by 2 %, masses by 2 %, dampings by 5 %, friction by 20 % (standard deviations)."""
    rng, parts = np.random.default_rng(seed), machine["carriage"]
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
    wave = _multisine(LOWEST_HZ, HIGHEST_HZ, CARRIAGE_M, SLOPE, seed)
    found = []
    for setup, added in (("carriage", 0.0), ("carriage+mass", ADDED_KG)):
        record = _noisy(_carriage(machine, added, wave), snr_db, rng)
        found += _responses(record, "cmd_A", ["pos_A"], setup=setup, added_mass_kg=added)
    force = _multisine(5.0, HAMMER_HZ, 10.0, 0.0, seed + 1)
    for i, axis in enumerate("xyz"):
        record = _noisy(_effector(machine["effector"], i, force), snr_db, rng)
        found += _responses(record, f"force_{axis}", [f"acc_{axis}"], setup="effector")
    for i, axis in enumerate("xyz"):
        answers = _assembly(machine, PLACES[0], axis, snr_db, seed + 2 + i, rng)
        found += [a for a in answers if (axis, a.output) != ("y", "pos_A")]  # y does not move A at the centre
    return found


def measure_places(machine: dict[str, Any], snr_db: float, seed: int) -> list[FrequencyResponse]:
    """A to A, B to B, C to C at the paper's four places."""
    rng = np.random.default_rng(seed)
    excited = [(place, i, tower) for place in PLACES for i, tower in enumerate("ABC")]
    return [_assembly(machine, place, tower, snr_db, seed + i, rng)[i] for place, i, tower in excited]


def error_reduction(
    measured: ComplexArray, predicted: ComplexArray, baseline: ComplexArray, smallest_phase_deg: float
) -> tuple[float, float]:
    """How much smaller the error is than that of a baseline model, of magnitude and of phase, % (Eq. 72)."""
    (magnitude, phase), (without, late) = (
        mean_absolute_percentage_accuracy(measured, model, smallest_phase_deg) for model in (predicted, baseline)
    )
    return 100 * (1 - (100 - magnitude) / (100 - without)), 100 * (1 - (100 - phase) / (100 - late))


# ---- records -------------------------------------------------------------------------------------


def _multisine(lowest_hz: float, highest_hz: float, peak: float, slope: float, seed: int) -> Wave:
    """Lines, amplitudes ∝ f^slope scaled to a peak, and random phases."""
    f = np.arange(np.ceil(lowest_hz * PERIOD_S), highest_hz * PERIOD_S + 1e-9) / PERIOD_S
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(f))
    one = _sum(1 / 3200, round(3200 * PERIOD_S), (f, f**slope, phase))
    return f, f**slope * peak / np.max(np.abs(one)), phase


def _sum(dt: float, count: int, wave: Wave) -> FloatArray:
    """(count,) values of a multisine each dt: one period by FFT, repeated."""
    f, amplitude, phase = wave
    n = round(PERIOD_S / dt)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[np.rint(f * PERIOD_S).astype(int)] = amplitude * np.exp(1j * phase) * n / 2
    return np.resize(np.fft.irfft(spectrum, n), count)


def _excitation(wave: Wave) -> FloatArray:
    """(2 n + 1,) mm at half steps over all periods."""
    return 1e3 * _sum(STEP_S / 2, 2 * round(PERIODS * PERIOD_S / STEP_S) + 1, wave)


def _assembly(
    machine: dict[str, Any], place_mm: Place, direction: str, snr_db: float, seed: int, rng: np.random.Generator
) -> list[FrequencyResponse]:
    """Command along x, y, z (nozzle) or A, B, C (one carriage) → the carriages' positions."""
    moved, rest = _excitation(_multisine(LOWEST_HZ, HIGHEST_HZ, PRINTER_M, SLOPE, seed)), np.array([place_mm])
    if direction in "ABC":
        command = delta_plant.carriages_of(machine, rest) + moved[:, None] * np.eye(3)["ABC".index(direction)]
    else:
        command = delta_plant.carriages_of(machine, rest + moved[:, None] * np.eye(3)["xyz".index(direction)])
    found = delta_plant.simulate(machine, command, STEP_S, gravity=True, keep_every=EVERY)
    record = _noisy((_sampled(moved), found["carriage_mm"][:-1] / 1e3), snr_db, rng)
    return _responses(record, f"cmd_{direction}", TOWERS, position_mm=place_mm)


def _carriage(machine: dict[str, Any], added_kg: float, wave: Wave) -> Record:
    """Command → position of carriage A with the upper halves of its arms, without the effector."""
    moved, along = _excitation(wave), np.array([1.0, 0.0, 0.0])
    towers = {"carriage_mass_kg": [machine["carriage"]["mass_kg"]] * 3, **machine.get("towers", {})}
    towers["carriage_mass_kg"] = towers["carriage_mass_kg"] + added_kg * along
    command = delta_plant.carriages_of(machine, np.zeros((1, 3))) + moved[:, None] * along
    unloaded = {"shares": np.zeros((3, 3))}  # of the effector's load
    own = {**machine, "towers": towers}
    found = delta_plant.simulate(own, command, STEP_S, keep_every=EVERY, hidden=unloaded)
    return _sampled(moved), (found["carriage_mm"][:-1, :1] - (command[0, 0] - moved[0])) / 1e3


def _sampled(moved_mm: FloatArray) -> FloatArray:
    return moved_mm[:: 2 * EVERY][:-1] / 1e3


def _effector(parts: dict[str, Any], axis: int, wave: Wave) -> Record:
    """Force on the free nozzle holder → its acceleration along the same axis, without the arms' halves.

    A periodic force in the hammer's place: the same frequency response, no leakage. Solved line by line from the two
    equations of motion, m_1 ẍ = F − k (x − x_2) − b (ẋ − ẋ_2) and m_2 ẍ_2 = k (x − x_2) + b (ẋ − ẋ_2).
    """
    m1, m2 = parts["nozzle_mass_kg"], parts["extruder_mass_kg"]
    f, amplitude, phase = wave
    s = 2j * np.pi * f
    spring = parts["extruder_stiffness_n_per_m"][axis] + parts["extruder_damping_n_s_per_m"][axis] * s
    felt = amplitude * np.exp(1j * phase) / (m1 + m2 * spring / (m2 * s**2 + spring))  # F = (m_1 + …) ẍ
    count = round(PERIODS * PERIOD_S * RATE_HZ)
    answer = _sum(1 / RATE_HZ, count, (f, np.abs(felt), np.angle(felt)))
    return _sum(1 / RATE_HZ, count, wave), answer[:, None]


def _noisy(record: Record, snr_db: float, rng: np.random.Generator) -> Record:
    """The answers with white noise, so far under their own rms; the command is known."""
    excited, answer = record
    level = np.std(answer, axis=0) * 10 ** (-snr_db / 20)
    return excited, answer + rng.normal(size=answer.shape) * level


def _responses(record: Record, excited: str, answers: list[str], **about: Any) -> list[FrequencyResponse]:
    command, answer = record
    lifted = answer - answer.mean(axis=0)  # where a carriage stands is not how it answers
    matrix = periodic_frf(command[:, None], lifted, RATE_HZ, round(PERIOD_S * RATE_HZ))
    return matrix.responses([excited], answers, (0.0, RATE_HZ), **about)
