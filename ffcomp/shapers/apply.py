"""Shape a planned motion, and find the frequencies of the modes over the bed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ffcomp.shapers.pulses import Shaper
from models.arrays import FloatArray
from models.machine import Machine

Position = Callable[[FloatArray], FloatArray]  # t : (k,) s → (k, 3) mm, at any time, resting before and after


def shape(
    position: Position, t: FloatArray, x: Shaper | None = None, y: Shaper | None = None, z: Shaper | None = None
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


def shape_samples(samples: FloatArray, by_column: Sequence[Shaper | None], step_s: float, margin: int) -> FloatArray:
    """Return the shaped columns (n, m) of samples (margin + n + margin, m) that are step_s apart.

    The margins hold the motion before and after; what reaches beyond them stays where it is there.
    """
    columns = []
    for column, shaper in zip(samples.T, by_column, strict=True):
        if shaper is None:
            columns.append(column[margin : len(column) - margin])
            continue
        first, weights = on_grid(shaper, step_s)
        before, after = max(0, first + len(weights) - 1 - margin), max(0, -first - margin)
        padded = np.pad(column, (before, after), mode="edge")
        shaped = np.convolve(padded, weights, mode="valid")
        begin = before + margin - (first + len(weights) - 1)
        columns.append(shaped[begin : begin + len(column) - 2 * margin])
    return np.stack(columns, axis=1)


def on_grid(shaper: Shaper, step_s: float) -> tuple[int, FloatArray]:
    """Return the delay of the first weight, in steps, and the weights of a shaper on an even grid.

    Each pulse becomes three, which do to a parabola what it does.
    """
    at = shaper.time / step_s
    middle = np.rint(at).astype(np.int64)
    off = at - middle
    first = int(middle.min()) - 1
    weights = np.zeros(int(middle.max()) + 2 - first)
    for shift, share in ((-1, (off**2 - off) / 2), (0, 1 - off**2), (1, (off**2 + off) / 2)):
        np.add.at(weights, middle + shift - first, shaper.amplitude * share)
    return first, weights


def dominant_frequencies(machine: Machine, xy: FloatArray) -> FloatArray:
    """Return the frequencies (2,) Hz of the modes at a position (2,) mm that the nozzle vibrates most in along X and Y.

    For the same commanded acceleration, that is the largest |X/Ẍ_d| = |G|/ω² at a natural frequency, with G from
    commanded to real nozzle. The drive's resonance is not among the modes: it is the same everywhere.
    """
    natural = next(iter(machine.vibration.modes(xy[None]))).frequencies_hz
    response = machine.vibration.frequency_response(xy, natural, "nozzle", "nozzle")  # (modes, 3, 3)
    loudness = np.abs(response) / natural[:, None, None] ** 2
    return np.asarray(natural[np.argmax(loudness[:, [0, 1], [0, 1]], axis=0)])
