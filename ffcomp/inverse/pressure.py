"""How far the filament must be ahead of its path, so that what flows out follows it.

The nozzle follows the plan within some µm, so what should flow at each time is the plan's. The pressure model of one
state is inverted exactly: v_in = v_out + ds/dt. What the firmware's own pressure advance adds to the written filament
is taken off: with e written, it pushes e + K de/dt.

A firmware lets the extruder's speed jump by little between two segments, and slows down where it would jump by more.
So the lead is smoothed until it does not; where that is not enough, only a share of it is written.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.planner.trajectory import PlannedMotion
from models.arrays import FloatArray
from models.compiled import kernel
from models.machine import Pressure

SUBSTEPS = 4  # of a segment
SMOOTHED = (0, 1, 2, 4, 6)  # segments to either side, tried in this order
HALVINGS = 6
STANDS_MM = 1e-9
STEEP = 1.02  # times the jump that is allowed: what rounding may add


@dataclass(frozen=True, eq=False)
class Lead:
    """How far the filament is ahead at n + 1 knots."""

    mm: FloatArray  # (n + 1,)
    share: float  # of what the model asks for; below 1 where the firmware's extruder cannot follow


def lead_of(trajectory: PlannedMotion, begin_s: float, end_s: float, knots_t: FloatArray, pressure: Pressure) -> Lead:
    """Return the lead of a motion from rest to rest.

    Parameters
    ----------
    trajectory : PlannedMotion
    begin_s, end_s : float
        Where the motion begins and ends on the plan's clock, s.
    knots_t : (n + 1,) array
        Times of its knots, s.
    pressure : Pressure
    """
    last = np.nextafter(end_s, -np.inf)
    t = np.linspace(knots_t[0], knots_t[-1], SUBSTEPS * (len(knots_t) - 1) + 1)
    position = trajectory.position(np.clip(t, begin_s, last))
    step_s = float(t[1] - t[0])
    wanted = _lead(position, step_s, pressure)
    moving = (knots_t > begin_s) & (knots_t < end_s)
    inside = np.flatnonzero((t > begin_s) & (t < end_s))
    if not len(inside) or not wanted.any():
        return Lead(np.zeros(len(knots_t)), 1.0)
    path = position[::SUBSTEPS]
    allowed = max(pressure.corner_velocity_mm_per_s, _jump(path, np.zeros(len(path)), knots_t)) * STEEP
    mm = np.zeros(len(knots_t))
    for segments in SMOOTHED:
        smooth = wanted.copy()
        smooth[inside] = _smoothed(wanted[inside], SUBSTEPS * segments)
        mm = np.where(moving, smooth[::SUBSTEPS], 0.0)
        if _jump(path, mm, knots_t) <= allowed:
            return Lead(mm, 1.0)
    share = _largest_share(path, mm, knots_t, allowed)
    return Lead(share * mm, share)


def _lead(position: FloatArray, step_s: float, pressure: Pressure) -> FloatArray:
    """Return by how much the written filament is ahead, (m,) mm: position is (m, 4) mm, even steps."""
    steps = np.diff(position, axis=0)
    along = np.sqrt((steps[:, :3] ** 2).sum(axis=1)) > STANDS_MM
    flow = np.where(along & (steps[:, 3] > 0.0), steps[:, 3], 0.0) / step_s
    flow = np.append(flow, 0.0)
    flow[1:-1] = 0.5 * (flow[1:-1] + flow[:-2])  # at the samples, not between them
    compressed = pressure.compressed(flow)
    if not pressure.firmware_advance_s:
        return compressed
    return np.asarray(_lagging(compressed - pressure.firmware_advance_s * flow, step_s / pressure.firmware_advance_s))


@kernel
def _lagging(wanted: FloatArray, step: float) -> FloatArray:
    """Return the lag of first order of (m,) values, `step` of its time constant apart."""
    out = np.zeros(len(wanted))
    keeps = np.exp(-step)
    for k in range(1, len(wanted)):
        out[k] = keeps * out[k - 1] + (1.0 - keeps) * wanted[k]
    return out


def _smoothed(values: FloatArray, half: int) -> FloatArray:
    """Return values (m,) under a triangle so many samples to either side; zero at both ends, as at rest."""
    if not half:
        return values
    half = min(half, len(values))
    mirrored = np.concatenate([-values[:half][::-1], values, -values[-half:][::-1]])
    window = np.bartlett(2 * half + 1)
    return np.asarray(np.convolve(mirrored, window / window.sum(), mode="same")[half : half + len(values)])


def _jump(path: FloatArray, lead: FloatArray, knots_t: FloatArray) -> float:
    """Return by how much the extruder's speed jumps at most between two segments as firmwares see it, mm/s."""
    way = np.sqrt((np.diff(path[:, :3], axis=0) ** 2).sum(axis=1))
    goes = way > STANDS_MM
    ratio = np.divide(np.diff(path[:, 3] + lead), way, out=np.zeros(len(way)), where=goes)
    speed = way / np.diff(knots_t)
    both = goes[1:] & goes[:-1]
    jumps = np.abs(np.diff(ratio)) * np.minimum(speed[1:], speed[:-1])
    return float(jumps[both].max(initial=0.0))


def _largest_share(path: FloatArray, lead: FloatArray, knots_t: FloatArray, allowed: float) -> float:
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _jump(path, middle * lead, knots_t) <= allowed else (low, middle)
    return low
