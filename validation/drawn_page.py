"""A page as an independent printer would draw it, and as a scanner would see it.

The nozzle moves as the plant does: masses on belts that damp, a second mass on its mount, bristles that rub. The bead
conserves volume: pressure lags behind the extruder, so that a line begins thin and ends in a blot. It is pulled after
the nozzle (a tractrix), averaged over the bore, and has two rough edges that know nothing of each other. The scanner's
carriage wobbles and stretches; the picture has blur, shading, dust and noise. Wrong conditions of a print are drawn
too: a speed factor, an input shaper. Nothing here is shared with `ffcomp/identification` or with the vibration models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter1d
from scipy.signal import lfilter

from ffcomp.record.page import SLOW, STROKE
from ffcomp.record.plan import Experiment, Plan
from ffcomp.shapers.apply import shape
from ffcomp.shapers.pulses import PULSES, Shaper
from validation.plants import straight_plant

Array = NDArray[np.float64]

LEAD_S, AFTER_S = 0.05, 0.02  # at rest before a drawing, and after it
PATH_MM = 0.03  # from point to point of a bead
FILAMENT_MM2 = np.pi * 1.75**2 / 4


@dataclass(frozen=True)
class Bead:
    """From the nozzle's motion to the line on the bed."""

    foot_mm: float = 0.04  # added to the width by the first layer's squeeze
    drag_mm: float = 0.18
    bore_mm: float = 0.3  # over which the melt averages the path
    pressure_s: float = 0.004  # by which the flow lags; pressure advance leaves some milliseconds
    rough_mm: float = 0.008  # of each edge
    rough_length_mm: float = 0.25
    uneven: float = 0.05  # of the width, over some millimetres


@dataclass(frozen=True, eq=False)
class Drawing:
    """One bead: n points."""

    points_mm: Array  # (n, 2) of its middle
    width_mm: Array  # (n,)


@dataclass(frozen=True)
class Conditions:
    """How the G-code of a page is executed: by the plan, or not."""

    speed_factor: float = 1.0
    shapers: tuple[Shaper, ...] = ()  # of x and y

    def command(self, experiment: Experiment) -> Any:
        """Return the motors' command in place of the experiment's."""
        motion = replace(experiment.motion, speed=experiment.motion.speed * self.speed_factor)

        def nozzle(t: Array) -> Array:
            return shape(motion.nozzle, t, *self.shapers)

        def volume(t: Array) -> Array:
            return FILAMENT_MM2 * motion.trajectory.position(t)[:, 3]

        return SimpleNamespace(duration_s=motion.duration_s, motion=SimpleNamespace(nozzle=nozzle, volume=volume))


def zv(hz: tuple[float, float], damping: float = 0.1) -> Conditions:
    """Return a print with the shaper ZV on, tuned to x and y (Singer & Seering, 1990)."""
    return Conditions(shapers=tuple(PULSES["zv"](each, damping) for each in hz))


# ---- what the printer draws ----------------------------------------------------------------------


def straight_player(plant: straight_plant.Plant) -> Callable[[Any, float], Array]:
    """Return a function that plays an experiment on the independent printer: (n, 2) mm every so many seconds."""

    def play(experiment: Any, step_s: float) -> Array:
        rows = int((experiment.duration_s + LEAD_S + AFTER_S) / step_s)
        t = step_s * np.arange(rows + 1, dtype=np.float64) - LEAD_S
        return straight_plant.simulate(plant, experiment.motion.nozzle(t)[:, :2], 1 / step_s)["position_mm"]

    return play


AS_WRITTEN = Conditions()


def draw(
    plan: Plan, play: Callable[[Any, float], Array], bead: Bead, seed: int, conditions: Conditions = AS_WRITTEN
) -> list[Drawing]:
    """Draw all of a page: strokes and slow lines as the plant moves, everything else as commanded."""
    rng = np.random.default_rng(seed)
    drawings = []
    for each in plan.experiments:
        step, command = 1 / 6400, conditions.command(each)
        if each.kind in (STROKE, SLOW):
            path = play(command, step)
        else:
            step = 1 / 1000
            path = command.motion.nozzle(step * np.arange(int(command.duration_s / step) + 1) - LEAD_S)[:, :2]
        volume = command.motion.volume(step * np.arange(len(path)) - LEAD_S)
        drawings.append(_bead(path, volume, each.position_mm[2], step, bead, rng))
    return drawings


def _bead(path: Array, volume: Array, height: float, step_s: float, bead: Bead, rng: np.random.Generator) -> Drawing:
    """Lay the extruded volume (n,) mm³ along the path (n, 2); the remainder in the nozzle ends as a blot."""
    laid = _pulled(path, bead.drag_mm)
    share = min(step_s / bead.pressure_s, 1.0)  # of what the melt still has to come, in a step
    out = lfilter([share], [1.0, share - 1.0], volume, zi=[(1.0 - share) * volume[0]])[0]
    moved = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(laid, axis=0), axis=1)))
    at = np.arange(0.0, moved[-1], PATH_MM)
    keep = np.append(True, np.diff(moved) > 1e-9)
    points = np.column_stack([np.interp(at, moved[keep], laid[keep, i]) for i in range(2)])
    last = len(out) - 1 - int(np.argmax(keep[::-1]))  # after it nothing moves
    window = max(1, round(bead.bore_mm / PATH_MM))
    volume_there = np.interp(at, moved[keep], out[keep])
    points, extruded = (uniform_filter1d(each, window, axis=0, mode="nearest") for each in (points, volume_there))
    width = np.gradient(extruded, PATH_MM) / height
    width = np.clip(width, 0.1, 1.2) + bead.foot_mm
    width *= 1.0 + bead.uneven * _noise(len(at), 3.0 / PATH_MM, rng)
    left, right = (bead.rough_mm * _noise(len(at), bead.rough_length_mm / PATH_MM, rng) for _ in range(2))
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    points, width = points + 0.5 * (left - right)[:, None] * normal, width + left + right
    blot = 2 * np.sqrt(width[-1] ** 2 / 4 + max(volume[-1] - out[last], 0.0) / (np.pi * height))
    return Drawing(np.vstack([points, points[-1:], points[-1:]]), np.append(width, [blot, blot]))


@njit(cache=True)
def _pulled(path: Array, length: float) -> Array:
    """Pull a point after the nozzle on a string."""
    laid = np.empty_like(path)
    laid[0] = path[0]
    for k in range(1, len(path)):
        away = path[k] - laid[k - 1]
        distance = np.sqrt(away[0] ** 2 + away[1] ** 2)
        laid[k] = laid[k - 1] if distance <= length else path[k] - away * (length / distance)
    return laid


def _noise(n: int, length: float, rng: np.random.Generator) -> Array:
    """Return noise of unit variance, correlated over so many rows."""
    reach = int(3 * length) + 1
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / length) ** 2)
    return np.convolve(rng.standard_normal(n + 2 * reach), kernel / np.linalg.norm(kernel), "valid")


# ---- what the camera sees ------------------------------------------------------------------------


@dataclass(frozen=True)
class Camera:
    """A flatbed scanner."""

    dpi: float = 600.0
    turn_deg: float = 1.0
    stretch: float = 0.002  # of one axis
    wobble_mm: float = 0.03  # rms, of the carriage
    blur_px: float = 0.8
    noise: float = 0.01
    shade: float = 0.05  # by which the light falls off
    glint: float = 0.1  # of edges
    dust: int = 200
    margin_mm: float = 12.0
    ink: float = 0.15  # brightness of the bead
    paper: float = 0.9


SCANNER = Camera()


def photograph(drawings: list[Drawing], camera: Camera, seed: int) -> NDArray[np.uint8]:
    """Return the picture (rows, columns) of a page."""
    rng = np.random.default_rng(seed)
    points = np.concatenate([each.points_mm for each in drawings])
    low, high = points.min(axis=0) - camera.margin_mm, points.max(axis=0) + camera.margin_mm
    project, shape = _projection(camera, low, high, rng)
    light = np.zeros(shape)
    for each in drawings:
        step = project(each.points_mm + np.array([[0.05, 0.0]])) - project(each.points_mm - np.array([[0.05, 0.0]]))
        side = project(each.points_mm + np.array([[0.0, 0.05]])) - project(each.points_mm - np.array([[0.0, 0.05]]))
        scale = np.sqrt(np.abs(step[:, 0] * side[:, 1] - step[:, 1] * side[:, 0])) / 0.1  # pixels a mm
        _cover(light, project(each.points_mm), 0.5 * each.width_mm * scale)
    return _developed(light, camera, shape, rng)


def _projection(
    camera: Camera, low: Array, high: Array, rng: np.random.Generator
) -> tuple[Callable[[Array], Array], tuple[int, int]]:
    """Return page mm (n, 2) -> pixels (n, 2) columns column, row; and the picture's shape."""
    middle, size, scale = 0.5 * (low + high), high - low, camera.dpi / 25.4
    cos, sin = np.cos(np.radians(camera.turn_deg)), np.sin(np.radians(camera.turn_deg))
    turn = np.array([[cos, -sin], [sin, cos]])
    shape = (int(size[1] * scale * 1.02), int(size[0] * scale * 1.02))
    half = 0.5 * np.array([shape[1], shape[0]])
    periods = np.exp(rng.uniform(np.log(3.0), np.log(60.0), (6, 2))) * scale  # px
    phases = rng.uniform(0, 2 * np.pi, (6, 2))

    def project(xy: Array) -> Array:
        px = scale * ((xy - middle) @ turn.T) * [1.0 + camera.stretch, -1.0] + half
        wave = np.sin(2 * np.pi * px[:, 1:2, None] / periods.T[None] + phases.T[None]).sum(axis=2)
        return np.asarray(px + camera.wobble_mm * scale * wave / np.sqrt(3.0))

    return project, shape


@njit(cache=True)
def _cover(light: Array, px: Array, half: Array) -> None:
    """Raise each pixel's share that is covered by a bead's points (n, 2) of half widths (n,), all in pixels."""
    rows, columns = light.shape
    for k in range(len(px) - 1):
        ax, ay = px[k]
        dx, dy = px[k + 1, 0] - ax, px[k + 1, 1] - ay
        length2 = dx * dx + dy * dy
        r = half[k]
        reach = r + 1.0
        for row in range(max(0, int(min(ay, ay + dy) - reach)), min(rows, int(max(ay, ay + dy) + reach) + 2)):
            for column in range(max(0, int(min(ax, ax + dx) - reach)), min(columns, int(max(ax, ax + dx) + reach) + 2)):
                u = 0.0
                if length2 > 0.0:
                    u = min(max(((column - ax) * dx + (row - ay) * dy) / length2, 0.0), 1.0)
                distance = np.sqrt((column - ax - u * dx) ** 2 + (row - ay - u * dy) ** 2)
                share = min(max(r + 0.5 - distance, 0.0), 1.0)
                if share > light[row, column]:
                    light[row, column] = share


def _developed(covered: Array, camera: Camera, shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.uint8]:
    rows, columns = shape
    y, x = np.mgrid[0:rows, 0:columns].astype(np.float32)
    shade = 1.0 - camera.shade * (0.7 * x / columns + 0.3 * (y / rows) ** 2)
    paper = camera.paper * np.ones(shape)
    for _ in range(camera.dust):
        row, column, size = rng.integers(rows), rng.integers(columns), rng.integers(1, 5)
        paper[row : row + size, column : column + rng.integers(1, 9)] *= rng.uniform(0.3, 0.9)
    ink = camera.ink + camera.glint * np.clip(np.gradient(gaussian_filter(covered, 2.0), axis=1) * 4.0, 0.0, 1.0)
    picture = gaussian_filter(shade * (paper * (1.0 - covered) + ink * covered), camera.blur_px)
    picture += camera.noise * rng.standard_normal(shape)
    return np.asarray(np.clip(255 * picture, 0, 255), dtype=np.uint8)
