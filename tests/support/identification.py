"""Frequency responses of a machine's own model with noise of a stated level: what an ideal laboratory would bring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ffcomp.identification.predict import predicted
from ffcomp.measurement.frf import FrequencyResponse
from models.machine import Machine

FREQUENCY_HZ = np.arange(2.0, 200.1, 0.5)
HAMMER_HZ = np.arange(5.0, 500.0, 1.0)


def blank(f: NDArray[np.float64], **what: object) -> FrequencyResponse:
    return FrequencyResponse(frequency_hz=f, value=np.zeros(len(f), complex), variance=np.ones(len(f)), **what)  # type: ignore[arg-type]


def paper_bench(f: NDArray[np.float64] = FREQUENCY_HZ) -> list[FrequencyResponse]:
    """The paper's four measurements, all at one place; y at the centre does not move carriage A."""
    alone = [
        blank(f, input="cmd_A", output="pos_A", setup="carriage"),
        blank(f, input="cmd_A", output="pos_A", setup="carriage+mass", added_mass_kg=0.2),
    ]
    struck = [blank(HAMMER_HZ, input=f"force_{a}", output=f"acc_{a}", setup="effector") for a in "xyz"]
    pairs = [(a, c) for a in "xyz" for c in "ABC" if (a, c) != ("y", "A")]
    return [
        *alone,
        *struck,
        *(blank(f, input=f"cmd_{a}", output=f"pos_{c}", position_mm=(0.0, 0.0, 30.0)) for a, c in pairs),
    ]


def towers_bench(x: float, y: float, f: NDArray[np.float64] = FREQUENCY_HZ) -> list[FrequencyResponse]:
    """All nine carriage responses at one place."""
    return [blank(f, input=f"cmd_{a}", output=f"pos_{b}", position_mm=(x, y, 30.0)) for b in "ABC" for a in "ABC"]


def measured(machine: Machine, bench: list[FrequencyResponse], snr_db: float, seed: int) -> list[FrequencyResponse]:
    """Each response with white circular noise, `snr_db` under its rms."""
    rng = np.random.default_rng(seed)
    noisy = []
    for response, h in zip(bench, predicted(machine, bench), strict=True):
        variance = np.full(len(h), np.mean(np.abs(h) ** 2) * 10 ** (-snr_db / 10))
        noise = np.sqrt(variance / 2) * (rng.normal(size=len(h)) + 1j * rng.normal(size=len(h)))
        noisy.append(replace(response, value=h + noise, variance=variance))
    return noisy
