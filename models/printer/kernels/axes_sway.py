"""What moves pushes back: frame and gantry in the quick steps of straight axes, see `axes.py` for the equations."""

from __future__ import annotations

from typing import TypeAlias

from models.arrays import FloatArray
from models.printer.kernels.axes import (
    BY_X,
    BY_X_CENTRE,
    BY_X_SQUARED,
    DIRECTIONS,
    FRAME,
    FRAME_B,
    FRAME_K,
    GROWTH,
    LEAST_STIFFER,
    YAW_ARM,
    YAW_B,
    YAW_CENTRE,
    YAW_INERTIA,
    YAW_K,
    YAW_SHARE,
)
from models.printer.kernels.jit import inlined
from models.printer.kernels.record import LANES
from models.printer.kernels.vectors import at

Sway: TypeAlias = tuple[float, float, float, float, float, float]  # θ, θ̇; d and ḋ of the frame's two directions
Pull: TypeAlias = tuple[float, float]  # m/s², what they take off the modes of x and y
Two: TypeAlias = tuple[float, float]


@inlined
def sway_rates(m: FloatArray, l: int, sway: Sway, forces: Two, driven: Two, x: float) -> Sway:
    """Evaluate the rates of frame and gantry.

    Parameters
    ----------
    forces : Σ N f of x and y.
    driven : accelerations of the driven points of x and y.
    x : of the driven point, m.
    """
    theta, turning, d0, d1, dd0, dd1 = sway
    off, inertia = x - at(m, YAW_CENTRE, l), at(m, YAW_INERTIA, l)
    torque = at(m, YAW_ARM, l) * driven[0] - off * driven[1]
    torque -= inertia * (at(m, YAW_K, l) * theta + at(m, YAW_B, l) * turning)
    whole = inertia + (1.0 - at(m, YAW_SHARE, l)) * off * off
    turn = torque / whole if inertia > 0.0 else 0.0
    return turning, turn, dd0, dd1, _swayed(m, 0, l, d0, dd0, forces), _swayed(m, 1, l, d1, dd1, forces)


@inlined
def _swayed(m: FloatArray, j: int, l: int, d: float, dd: float, forces: Two) -> float:
    force = at(m, DIRECTIONS + 2 * j, l) * forces[0] + at(m, DIRECTIONS + 2 * j + 1, l) * forces[1]
    return -at(m, FRAME_K, l) * d - at(m, FRAME_B, l) * dd - at(m, FRAME, l) * force


@inlined
def pull_of(m: FloatArray, l: int, rates: Sway, x: float) -> Pull:
    """Return what the accelerations of frame and gantry take off the modes."""
    along = at(m, DIRECTIONS, l) * rates[4] + at(m, DIRECTIONS + 2, l) * rates[5]
    across = at(m, DIRECTIONS + 1, l) * rates[4] + at(m, DIRECTIONS + 3, l) * rates[5]
    return along, across + at(m, YAW_SHARE, l) * (x - at(m, YAW_CENTRE, l)) * rates[1]


@inlined
def lighter(m: FloatArray, n: int, height: float) -> float:
    """Return the mass at the bed over that at this height."""
    return 1.0 / (1.0 + at(m, GROWTH, n) * height)


@inlined
def stiffer(m: FloatArray, n: int, x: float) -> float:
    """Return what x adds to ω² of the highest mode, relative to it."""
    off = x - at(m, BY_X_CENTRE, n % LANES)
    return max((at(m, BY_X, n) + at(m, BY_X_SQUARED, n) * off) * off, LEAST_STIFFER)
