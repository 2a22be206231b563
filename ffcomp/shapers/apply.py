"""Shape a planned motion, and find the frequencies of the modes over the bed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ffcomp.shapers.pulses import Shaper
from models.arrays import FloatArray
from models.compiled import kernel
from models.machine import Machine

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
    """Return the frequencies (n, 2) Hz of the modes at positions (n, 2) mm that the nozzle vibrates most in along X, Y.

    For the same commanded acceleration, that is the largest |X/Ẍ_d| = |G|/ω² at a natural frequency, with G from
    commanded to real nozzle. The drive's resonance is not among the modes: it is the same everywhere.
    """
    found = np.empty((len(xy), 2))
    for k, modes in enumerate(machine.vibration.modes(xy)):
        natural = modes.frequencies_hz
        response = machine.vibration.frequency_response(xy[k], natural, "nozzle", "nozzle")  # (modes, 3, 3)
        loudness = np.abs(response) / natural[:, None, None] ** 2
        found[k] = natural[np.argmax(loudness[:, [0, 1], [0, 1]], axis=0)]
    return found


def over_the_bed(
    machine: Machine, frequencies_at: Callable[[FloatArray], FloatArray], pitch_mm: float = 10.0
) -> FrequencyOfPosition:
    """Tabulate frequencies, (n, 2) mm → (n, 2) Hz, at the nodes of a square grid, and interpolate between them.

    Where the dominant mode changes, its frequency jumps, and with it the shaped position would; between two nodes the
    interpolation makes a slope of it. Outside the bed the value at the rim's nearest node holds.
    """
    reach = machine.kinematics.model_reach_mm
    if not reach:
        everywhere = frequencies_at(np.zeros((1, 2)))[0]
        return lambda xy: np.tile(everywhere, (len(xy), 1))
    x = np.linspace(-reach, reach, 2 * int(np.ceil(reach / pitch_mm)) + 1)
    nodes = _inside(np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2), reach)
    values = frequencies_at(nodes).reshape(len(x), len(x), 2)

    def of_position(xy: FloatArray) -> FloatArray:
        return _interpolated(np.ascontiguousarray(_inside(xy, reach)), reach, values)

    return of_position


def _inside(xy: FloatArray, reach_mm: float) -> FloatArray:
    """Move positions (n, 2) mm outside the bed to its rim."""
    distance = np.hypot(xy[:, 0], xy[:, 1])
    return xy * (reach_mm / np.maximum(distance, reach_mm))[:, None]


@kernel
def _interpolated(xy: FloatArray, reach_mm: float, values: FloatArray) -> FloatArray:
    """Interpolate values (n, n, 2) at the nodes of a square grid from -reach_mm to reach_mm, linearly in x and in y."""
    out = np.empty((len(xy), 2))
    cells = len(values) - 1
    for k in range(len(xy)):
        across, along = ((xy[k, 0] + reach_mm) * cells / (2 * reach_mm), (xy[k, 1] + reach_mm) * cells / (2 * reach_mm))
        # a position on the rim may round to just outside the grid
        i, j = min(max(int(across), 0), cells - 1), min(max(int(along), 0), cells - 1)
        u, v = across - i, along - j
        for c in range(2):
            low = (1 - v) * values[i, j, c] + v * values[i, j + 1, c]
            high = (1 - v) * values[i + 1, j, c] + v * values[i + 1, j + 1, c]
            out[k, c] = (1 - u) * low + u * high
    return out
