"""Shape a planned motion, with the same shapers everywhere or with a frequency that changes over the bed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffcomp.shapers.kinds import SHAPERS
from ffcomp.shapers.pulses import DAMPING_RATIO, Shaper
from models.arrays import FloatArray
from models.kinematics.base import Compiled

Position = Callable[[FloatArray], FloatArray]  # t : (k,) s → (k, 3) mm, at any time, resting before and after
FrequencyOfPosition = Callable[[FloatArray], FloatArray]  # (k, 2) mm, columns X Y → (k, 2) Hz, of the x and y shapers


def shape(
    position: Position,
    t: FloatArray,
    x: Shaper | None = None,
    y: Shaper | None = None,
    z: Shaper | None = None,
) -> FloatArray:
    """Return the shaped position : (k, 3) mm at the times t : (k,) s; an axis without a shaper stays as planned.

    Exact: the planned motion is evaluated at the pulses' own times, never interpolated between samples.
    """
    by_axis = (x, y, z)
    out = np.array(position(t), dtype=float)
    for shaper in {id(s): s for s in by_axis if s is not None}.values():
        axes = [j for j in range(3) if by_axis[j] is shaper]
        out[:, axes] = sum(
            a * position(t - delay)[:, axes] for a, delay in zip(shaper.amplitude, shaper.time, strict=True)
        )
    return out


def shape_carriages(
    position: Position, t: FloatArray, kinematics: Compiled, by_carriage: tuple[Shaper, Shaper, Shaper]
) -> FloatArray:
    """Return the position : (k, 3) mm of a nozzle each of whose carriages is shaped by itself, at the times t : (k,) s.

    What Klipper's author tried on his delta: one shaper per tower, after the inverse kinematics instead of before.
    """

    def carriages(at: FloatArray) -> FloatArray:
        return kinematics.inverse(np.ascontiguousarray(position(at)))

    return kinematics.forward(shape(carriages, t, *by_carriage))


def scheduled_shape(
    position: Position,
    t: FloatArray,
    frequency_of_position: FrequencyOfPosition,
    kind: str,
    damping_ratio: float = DAMPING_RATIO,
) -> FloatArray:
    """Shape with x and y shapers whose frequency is that of the position where the plan is at each time.

    x_s(t) = Σ A_i x(t - T_i / f(x(t))), T_i in periods. No firmware has it: Marlin's frequency may follow the
    height or the printed mass, elsewhere a change of the shaper is a full stop. Looked up at t, not when the
    pulses set out: so the amplitudes still sum to one, rest stays rest, and the position is as continuous as
    the frequency is over the bed.

    NOTE: mzv wants the frequency of the mode itself; the wider shapers want more, so that the mode lies at the low end
    of what they suppress and they smooth less: on three sample prints 1.2-1.3 times for zvd and ei, 1.45-1.6 times for
    2hump_ei.

    Parameters
    ----------
    position : callable
        The planned motion.
    t : (k,) array
        Times in s.
    frequency_of_position : callable
        Frequencies of the x and y shapers.
    kind : str
        A name in `SHAPERS`.
    damping_ratio : float

    Returns
    -------
    (k, 3) array
        In mm, z as planned.
    """
    in_periods = SHAPERS[kind](1.0, damping_ratio)
    out = np.array(position(t), dtype=float)
    frequency = _checked(frequency_of_position(out[:, :2].copy()))
    for axis in range(2):
        out[:, axis] = sum(
            a * position(t - delay / frequency[:, axis])[:, axis]
            for a, delay in zip(in_periods.amplitude, in_periods.time, strict=True)
        )
    return out


def _checked(frequency_hz: FloatArray) -> FloatArray:
    wrong = frequency_hz[~(frequency_hz > 0)]
    if wrong.size:
        raise ValueError(f"A shaper's frequency must be above zero at every position, not {wrong[0]} Hz.")
    return frequency_hz
