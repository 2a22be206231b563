"""Declare an accelerometer that is rotated relative to the printer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from models.arrays import FloatArray
from models.effects.effect import Effect, Parameter, Signals


def rotation(angles: FloatArray) -> FloatArray:
    """Return the rotation : (3, 3) by the vector `angles` : (3,) rad (Rodrigues' formula)."""
    angle = float(np.linalg.norm(angles))
    x, y, z = angles
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sinc(angle / np.pi) * cross + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * cross @ cross


def measure(true: Signals, values: Mapping[str, FloatArray]) -> Signals:
    """Rotate the nozzle's signals to the sensor's axes."""
    # A sensor rotated by R reads Rᵀ a in its own axes; as rows, a R.
    return replace(true, nozzle=true.nozzle @ rotation(np.radians(values["angles_deg"])))


EFFECT = Effect(
    name="sensor_misalignment",
    title="The nozzle's accelerometer is mounted askew",
    kind="sensor",
    physics="The sensor's axes are turned against the printer's.",
    equation="a → Rᵀ a, R the turn by the rotation vector φ",
    parameters=(Parameter("angles_deg", "degrees", "φ about x, y, z", (-180, 180), (-5, 5), 1.0, size="vector3"),),
    in_data="A motion along x shows in y and z, in one proportion at all frequencies.",
    confounded_with={"arm_geometry": "Several places: a turned sensor errs alike everywhere."},
    measure=measure,
)
