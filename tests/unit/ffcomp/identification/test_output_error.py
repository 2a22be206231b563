"""An accelerometer a few degrees off the printer's axes, and masses known up to a common factor."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffcomp.identification.output_error import Fitted, fit_machine
from ffcomp.identification.predict import predicted
from ffcomp.measurement.frf import FrequencyResponse
from models.file import load_machine
from models.machine import value_of
from tests.support.identification import blank

TRUTH = load_machine("mp-delta-pro")
F = np.arange(4.0, 120.1, 4.0)
TILT_DEG = np.array([2.0, -1.0, 1.5])


def captures(tilt_deg: np.ndarray, seed: int = 0) -> list[FrequencyResponse]:
    """Nozzle moved along A, B and C, its acceleration along the sensor's axes, 1 % of noise, one place."""
    bench = [
        blank(F, input=f"cmd_{a}", output=f"acc_{o}", position_mm=(20.0, 10.0, 30.0), clock=f"run-{a}", source=a)
        for a in "ABC"
        for o in "xyz"
    ]
    matrix = Rotation.from_rotvec(np.radians(tilt_deg)).as_matrix()
    rng = np.random.default_rng(seed)
    found, clean = [], predicted(TRUTH, bench)
    for k in range(0, len(bench), 3):
        felt = matrix @ np.stack(clean[k : k + 3])
        sd = 0.01 * np.sqrt(np.mean(np.abs(felt) ** 2))
        noise = sd / np.sqrt(2) * (rng.normal(size=felt.shape) + 1j * rng.normal(size=felt.shape))
        pairs = zip(bench[k : k + 3], felt + noise, strict=True)
        found += [replace(r, value=h, variance=np.full(len(F), sd**2)) for r, h in pairs]
    return found


@cache
def fitted(tilt_deg: tuple[float, ...]) -> Fitted:
    return fit_machine(TRUTH, captures(np.array(tilt_deg)), starts=[{}])


def test_a_tilted_chip_is_found_and_does_no_harm() -> None:
    found = fitted(tuple(TILT_DEG))
    for axis, true in zip("xyz", TILT_DEG, strict=True):
        angle = found.rotation_deg[axis]
        assert angle.value == pytest.approx(true, abs=max(3 * angle.sd, 0.02)) and angle.sd < 0.2
    assert found.model_error == 0.0 and found.misfit == pytest.approx(1.0, abs=0.1)
    ratio = [
        value_of(m, "carriage.belt_stiffness_n_per_m") / value_of(m, "carriage.mass_kg") for m in (found.machine, TRUTH)
    ]
    assert ratio[0] == pytest.approx(ratio[1], rel=0.02)
