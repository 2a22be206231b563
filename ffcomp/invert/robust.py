"""What may be wanted of a machine that is not exactly known.

The numbers of a machine file have standard deviations (its `[uncertainty]`), so its FRF G is one draw of many. At one
place, the command K r that keeps the expected squared error smallest is

    K = (E[GᴴG] + ρ I)⁻¹ E[G]ᴴ      instead of      K₀ = (G₀ᴴG₀ + ρ I)⁻¹ G₀ᴴ

and K = K₀ T: the plain inverse of a softened wish T r. T is one where the machine is known, and less than one where the
draws disagree: at a lightly damped mode whose frequency nobody knows to a few percent, whatever is commanded comes out
wrong, so less of it is asked for. T is a two-sided filter of a fifth of a second, worked out for the places of a grid.

The wish is softened for the sweeps only: a command begins and ends on the path, at rest.

The minimum of an expected error over uncertain parameters: Ljung & Söderström, or Nagy & Braatz, J. Process Control 14
(2004) 411-422, for the optimal control of uncertain plants; the Wiener filter of a random plant.
"""

from __future__ import annotations

from threading import Lock

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.machine import Machine
from models.parameters import dynamic_numbers, value_of, with_values
from models.receptance import nozzle_frf

FloatArray = NDArray[np.float64]

DRAWS = 32
FARTHEST = 2.5  # standard deviations
PITCH_MM = 30.0
HALF = 50  # rows on either side
LINES = 64  # of frequency, up to half the rate of the rows
NEAR_MM = 2.0  # so near to a place its filter still serves


class Softening:
    """T − I over the bed of one machine, for rows `row_s` apart."""

    def __init__(self, machine: Machine, row_s: float, bandwidth_hz: float, effort: float) -> None:
        """effort : ρ against one row, as in the sweeps"""
        self.machine, self.row_s, self.bandwidth_hz, self.effort = machine, row_s, bandwidth_hz, effort
        self.possible = _draws(machine)
        self._half = max(int(np.ceil(machine.kinematics.model_reach_mm / PITCH_MM)), 1)
        across = 2 * self._half + 1
        self._kernels = np.zeros((across, across, 2 * HALF + 1, 3, 3))
        self._known = np.zeros((across, across), dtype=np.bool_)
        self._working = Lock()

    def of(self, rows: FloatArray) -> FloatArray:
        """By how much the wish is softened, (n, 3) mm, of the path (n + 2 HALF, 3) mm: HALF rows more at either end."""
        place = rows[HALF : len(rows) - HALF, :2] / PITCH_MM + self._half
        low = np.clip(np.floor(place), 0, 2 * self._half - 1).astype(np.int64)
        with self._working:
            for i, j in np.unique(low, axis=0).tolist():
                for node in ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)):
                    if not self._known[node]:
                        self._kernels[node] = self._kernel((np.array(node) - self._half) * PITCH_MM)
                        self._known[node] = True
        return _filtered(self._kernels, place, rows)

    def _kernel(self, xy: FloatArray) -> FloatArray:
        """T − I at one place, (2 HALF + 1, 3, 3) of rows from the past to the future."""
        reach = self.machine.kinematics.model_reach_mm
        xy = xy * min(1.0, reach / max(float(np.hypot(*xy)), 1e-9))
        f = np.linspace(0.0, 0.5 / self.row_s, LINES + 1)
        known = nozzle_frf(self.machine, xy, f)
        draws = np.array([nozzle_frf(machine, xy, f) for machine in self.possible])
        mean, square = draws.mean(axis=0), (_h(draws) @ draws).mean(axis=0)
        bend = (2 * np.sin(np.pi * f * 2 * self.row_s)) ** 4  # of the command, over a segment of two rows
        weight = (self.effort / 2 * bend)[:, None, None] * np.eye(3)
        softened = np.linalg.solve(square + weight, _h(mean))
        plain = np.linalg.solve(_h(known) @ known + weight, _h(known))
        t = np.linalg.solve(plain, softened) - np.eye(3)
        # beyond the bandwidth nothing is commanded: leave the wish alone
        t *= np.clip(2.0 - f / self.bandwidth_hz, 0.0, 1.0)[:, None, None]
        taps = np.fft.irfft(t, axis=0)
        m = np.arange(-HALF, HALF + 1)
        # out[k] = Σ h[m] x[k − m]: what comes m rows later has the tap −m
        kernel = taps[(-m) % (2 * LINES)] * (0.5 + 0.5 * np.cos(np.pi * m / (HALF + 1)))[:, None, None]
        return np.asarray(_blind_to_lines(kernel, m))


def _draws(machine: Machine) -> list[Machine]:
    """Machines as the uncertainties allow them, the same ones every time."""
    names = dynamic_numbers(machine)
    sd = machine.uncertainty
    spread = np.array([sd.get(name, sd.get(name.split("[")[0], sd.get("default", 0.0))) for name in names])
    rng = np.random.default_rng(1)
    half = np.clip(rng.standard_normal((DRAWS // 2, len(names))), -FARTHEST, FARTHEST)
    draws = np.concatenate([half, -half]) * spread  # in pairs: their mean is the machine
    nominal = np.array([value_of(machine, name) for name in names])
    factors = np.maximum(1.0 + draws, 0.2)
    return [with_values(machine, dict(zip(names, row.tolist(), strict=True))) for row in nominal * factors]


def _blind_to_lines(kernel: FloatArray, m: NDArray[np.int64]) -> FloatArray:
    """The kernel without its answer to rest and to steady motion: Σ K = 0, Σ m K = 0."""
    window = (0.5 + 0.5 * np.cos(np.pi * m / (HALF + 1)))[:, None, None]
    ramp = m[:, None, None] * window
    kernel = kernel - window * (kernel.sum(axis=0) / window.sum())
    return kernel - ramp * ((m[:, None, None] * kernel).sum(axis=0) / (m[:, None, None] * ramp).sum())


def _h(matrix: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return np.conj(np.swapaxes(matrix, -1, -2))


@njit(cache=True, nogil=True)
def _filtered(kernels: FloatArray, place: FloatArray, rows: FloatArray) -> FloatArray:
    """kernels (g, g, taps, 3, 3), place (n, 2) in the grid, rows (n + taps − 1, 3) mm -> (n, 3) mm."""
    n, taps = len(place), kernels.shape[2]
    out, here = np.zeros((n, 3)), np.empty((taps, 3, 3))
    at_x, at_y, near = np.inf, np.inf, NEAR_MM / PITCH_MM
    for k in range(n):
        if not (abs(place[k, 0] - at_x) < near and abs(place[k, 1] - at_y) < near):
            at_x, at_y = place[k, 0], place[k, 1]
            i, j = min(max(int(at_x), 0), len(kernels) - 2), min(max(int(at_y), 0), len(kernels) - 2)
            fx, fy = min(max(at_x - i, 0.0), 1.0), min(max(at_y - j, 0.0), 1.0)
            for t in range(taps):
                for r in range(3):
                    for c in range(3):
                        here[t, r, c] = (1 - fx) * (
                            (1 - fy) * kernels[i, j, t, r, c] + fy * kernels[i, j + 1, t, r, c]
                        ) + fx * ((1 - fy) * kernels[i + 1, j, t, r, c] + fy * kernels[i + 1, j + 1, t, r, c])
        x, y, z = 0.0, 0.0, 0.0
        for t in range(taps):
            a, b, c = rows[k + t, 0], rows[k + t, 1], rows[k + t, 2]
            x += here[t, 0, 0] * a + here[t, 0, 1] * b + here[t, 0, 2] * c
            y += here[t, 1, 0] * a + here[t, 1, 1] * b + here[t, 1, 2] * c
            z += here[t, 2, 0] * a + here[t, 2, 1] * b + here[t, 2, 2] * c
        out[k, 0], out[k, 1], out[k, 2] = x, y, z
    return out
