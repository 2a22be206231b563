"""An axis with gravity is simulated in one piece only if the recorded motion is pulled back to one place."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ffcomp.identification.axis_shots import _pulled_back, _speed
from ffcomp.measurement.axis_run import AxisRun
from models.arrays import FloatArray

RATE_HZ = 200.0
TORQUE, INERTIA, DAMPING = 0.5, 0.006, 0.004  # N m, kg m², N m s/rad


def recorded(angle: float, gain: float, speed: float = 0.0) -> AxisRun:
    """Simulate an arm, angles from hanging down, that a controller of this gain drives along a slow sine about π."""
    t = np.arange(0, 6, 1 / RATE_HZ)

    def drive(time: FloatArray, q: FloatArray, v: FloatArray) -> FloatArray:
        return np.asarray(gain * (np.pi + 0.5 * np.sin(3 * time) - q) - 0.1 * np.sqrt(gain) * v)

    def change(time: float, state: FloatArray) -> list[float]:
        q, v = state
        force = float(drive(np.array(time), np.array(q), np.array(v)))
        return [v, (force - TORQUE * np.sin(q) - DAMPING * v) / INERTIA]

    q, v = solve_ivp(change, (0, 6), [angle, speed], t_eval=t, rtol=1e-9, atol=1e-11).y
    moved = 1e3 * (q + 1e-4 * np.random.default_rng(1).normal(size=len(q)))
    return AxisRun("arm.csv", t, 1e3 * drive(t, q, v), True, {}, {"pos_q": moved}, {})


@pytest.mark.parametrize(
    ("angle", "gain", "speed", "held"),
    [
        (1.2, 0.0, 0.0, True),  # swings out
        (np.pi, 4.0, 0.0, False),  # stands up, and is held there
        (0.3, 0.0, 30.0, False),  # turns over and over
    ],
)
def test_an_arm_is_held_where_it_is_pulled_back(angle: float, gain: float, speed: float, held: bool) -> None:
    run = recorded(angle, gain, speed)
    assert _pulled_back([run], [_speed(run.position["pos_q"], RATE_HZ)]) is held
