"""Which vibration is which: what a mode moves, and one mode followed over the whole bed.

Over the bed modes approach, veer and cross, so their order by frequency means little. Here a mode is followed by its
shape: neighbouring places are matched by the modal assurance criterion (R. Allemang, "The modal assurance criterion",
Sound and Vibration, 2003), from the centre outwards, the surest pair of neighbours first. So a doubtful step, at a
place where two modes meet, is taken only if no other way leads around it.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.arrays import ComplexArray, FloatArray, IntArray
from models.vibration.base import Modes
from models.vibration.delta import DeltaVibration

Node = tuple[int, int]  # a place on the grid
Matched = list[int | None]  # indices of the centre's modes at a place; None: overdamped there

AXES = "xyz"
DOMINANT_SHARE = 0.7  # of a mode's energy: a mode with more than this along one axis is named after it
MINOR_SHARE = 0.15  # of a mode's energy: less than this along an axis is not mentioned
CLOSE_MODES_SHARE = (
    0.1  # of a frequency: modes closer than this are doubtful, even where symmetry keeps their shapes apart
)
DEGENERATE_SHARE = 1e-3  # of a frequency: closer modes are the pair of a symmetric printer


@dataclass(frozen=True, eq=False)
class ModeMap:
    """The m modes of the centre, followed over a square grid of k × k places, first axis X.

    Just off the bed, values repeat the nearest place on the rim, so that maps can be drawn round; NaN farther out
    and where a mode does not swing.
    """

    x_mm: FloatArray  # (k,) both axes; the middle one is 0
    on_bed: NDArray[np.bool_]  # (k, k)
    frequency_hz: FloatArray  # (k, k, m)
    damping_ratio: FloatArray  # (k, k, m)
    motion: ComplexArray  # (k, k, m, 6) √mass times motion: nozzle side X Y Z, extruder X Y Z; length 1
    kinds: tuple[str, ...]  # (m,) description of each, averaged over the inner half of the bed


def kinds(model: DeltaVibration, xy: FloatArray, modes: Modes) -> list[str]:
    """Describe what each mode at one position moves."""
    j = model.kinematics.jacobian(xy[None])[0]
    axes, extruder = _shares(np.concatenate(_motion(model, j, modes.shapes), axis=1))
    return [_words(a, e) for a, e in zip(axes, extruder.tolist(), strict=True)]


def mode_map(model: DeltaVibration, pitch_mm: float = 6.0) -> ModeMap:
    """Every mode of the centre, followed to every place of the bed."""
    reach = model.kinematics.bed_radius_mm
    half = int(np.ceil(reach / pitch_mm))
    x = np.linspace(-reach, reach, 2 * half + 1)
    radius = np.hypot(x[:, None], x)
    near: list[Node] = [(int(i), int(k)) for i, k in np.argwhere(radius <= reach + 2 * pitch_mm)]
    places = np.array([[x[i], x[k]] for i, k in near])
    places *= np.minimum(1.0, reach / np.maximum(np.hypot(*places.T), pitch_mm / 2))[:, None]
    j = model.kinematics.jacobian(places)
    stations = {
        node: _Station(modes, np.concatenate(_motion(model, j_here, modes.shapes), axis=1))
        for node, j_here, modes in zip(near, j, model.modes(places), strict=True)
    }
    return _assembled(x, radius <= reach * (1 + 1e-9), stations, _follow(stations, (half, half)))


def numbers(model: DeltaVibration, over: ModeMap, xy: FloatArray, modes: Modes) -> list[int]:
    """Which modes of the map, counted from 1, those found at one place are; 0 for one that is not on the map there."""
    from scipy.optimize import linear_sum_assignment

    i, k = (int(np.abs(over.x_mm - at).argmin()) for at in xy)
    j = model.kinematics.jacobian(xy[None])[0]
    here = np.concatenate(_motion(model, j, modes.shapes), axis=1)
    mac = np.nan_to_num(np.abs(here.conj() @ over.motion[i, k].T) ** 2)
    rows, columns = linear_sum_assignment(-mac)
    there = {row: column + 1 for row, column in zip(rows.tolist(), columns.tolist(), strict=True) if mac[row, column]}
    return [there.get(row, 0) for row in range(len(here))]


@dataclass(frozen=True, eq=False)
class _Station:
    """The modes at one place. √mass times motion, because seen from the nozzle a place's neighbours look alike."""

    modes: Modes  # b of them
    motion: ComplexArray  # (b, 6) nozzle side X Y Z, extruder X Y Z; length 1

    @property
    def poles(self) -> ComplexArray:
        """(b,) per 2π s."""
        zeta = self.modes.damping_ratios
        return np.asarray(self.modes.frequencies_hz * (-zeta + 1j * np.sqrt(1 - zeta**2)))

    @property
    def apart(self) -> float:
        """How far the two closest modes are from each other, 1 if farther than NEAR of their frequency."""
        poles = self.poles
        gap = np.abs(poles[:, None] - poles) / np.abs(poles) + np.eye(len(poles))
        return float(min(1.0, gap.min(initial=1.0) / CLOSE_MODES_SHARE))


def _follow(stations: Mapping[Node, _Station], centre: Node) -> dict[Node, Matched]:
    """For every place, the index of each of the centre's modes there."""
    order: dict[Node, Matched] = {}
    edge: list[tuple[float, Node, Matched]] = [(-1.0, centre, list(range(len(stations[centre].motion))))]
    while edge:
        _, node, matched = heapq.heappop(edge)
        if node in order:
            continue
        order[node] = matched
        for across, up in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            other = (node[0] + across, node[1] + up)
            if other in stations and other not in order:
                there, surety = _match(stations[node], matched, stations[other])
                heapq.heappush(edge, (-surety, other, there))
    return order


def _match(here: _Station, which: Matched, there: _Station) -> tuple[Matched, float]:
    """Match the modes to a neighbour's; surety is the worst MAC, less where two modes all but meet."""
    from scipy.optimize import linear_sum_assignment

    mac = np.abs(here.motion.conj() @ there.motion.T) ** 2
    rows, columns = linear_sum_assignment(-mac)
    at = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    matched = [None if index is None else at.get(index) for index in which]
    return matched, float(mac[rows, columns].min()) * there.apart


def _assembled(
    x: FloatArray, on_bed: NDArray[np.bool_], stations: Mapping[Node, _Station], order: Mapping[Node, Matched]
) -> ModeMap:
    k, m = len(x), len(next(iter(order.values())))
    frequency = np.full((k, k, m), np.nan)
    damping, motion = frequency.copy(), np.full((k, k, m, 6), np.nan, dtype=np.complex128)
    for node, matched in order.items():
        mode = [number for number, index in enumerate(matched) if index is not None]
        index = [index for index in matched if index is not None]
        here = stations[node]
        frequency[node][mode] = here.modes.frequencies_hz[index]
        damping[node][mode] = here.modes.damping_ratios[index]
        motion[node][mode] = here.motion[index]
    number = _numbering(frequency)
    motion = motion[:, :, number]
    inner = np.hypot(x[:, None], x) <= x[-1] / 2
    axes, extruder = (np.nanmean(share[inner], axis=0) for share in _shares(motion))
    words = [_words(a, float(e)) for a, e in zip(axes, extruder, strict=True)]
    return ModeMap(x, on_bed, frequency[:, :, number], damping[:, :, number], motion, tuple(words))


def _numbering(frequency: FloatArray) -> IntArray:
    """As at the centre; modes that are one there (of a symmetric printer) by their mean over the bed."""
    centre = frequency[len(frequency) // 2, len(frequency) // 2]
    return np.lexsort((_mean(frequency), np.round(np.log(centre) / DEGENERATE_SHARE)))


def _mean(over_the_bed: FloatArray) -> FloatArray:
    return np.asarray(np.nanmean(over_the_bed, axis=(0, 1)))


def _motion(model: DeltaVibration, j: FloatArray, shapes: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """√mass times motion of the nozzle side and of the extruder, (n, 3) each, from shapes (n, 6); together length 1."""
    nozzle = shapes[:, :3] @ j.T
    parts = (
        np.sqrt(model.nozzle_side_mass_kg) * nozzle,
        np.sqrt(model.effector.extruder_mass_kg) * (nozzle + shapes[:, 3:]),
    )
    length = np.linalg.norm(np.concatenate(parts, axis=1), axis=1, keepdims=True)
    return parts[0] / length, parts[1] / length


def _shares(motion: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Of the effector's kinetic energy: along each axis (..., 3), and the extruder's (...,), from motion (..., 6)."""
    energy = np.abs(motion) ** 2
    return energy[..., :3] + energy[..., 3:], energy[..., 3:].sum(axis=-1)


def _words(axes: FloatArray, extruder: float) -> str:
    part = [axis for axis, share in zip(AXES, axes.tolist(), strict=True) if share > MINOR_SHARE]
    listed = " and ".join([", ".join(part[:-1]), *part[-1:]] if len(part) > 1 else part)
    along = f"mostly {AXES[int(np.argmax(axes))]}" if axes.max() > DOMINANT_SHARE else listed
    return f"extruder, {along}" if extruder > 0.5 else along
