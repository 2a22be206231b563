"""Centre lines of strokes in pictures of a page, each as its distance from the slow line next to it.

A line is sampled across every 0.1 mm; its middle is the centroid of the ink. The slow line's own deviation, smoothed
over 1 mm, is what scanner, lens and paper do there; it is subtracted from the stroke's at the same line of the scanner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.signal import savgol_filter

from ffcomp.errors import MeasurementError
from ffcomp.identification.page.picture import RETAKE, Sight
from ffcomp.record.page import Line, last_line, twins
from ffcomp.record.plan import Experiment, Plan
from models.arrays import FloatArray

STEP_MM, ENDS_MM = 0.1, (0.9, 1.2)  # along a line; left out at its foot and at its end
REACH_MM, CORE_MM = 0.85, 0.5  # across: read; around the middle for the centroid
SMOOTHED_MM = 1.1  # of a slow line
LEAST_INK, BROKEN_SHARE = 0.15, 0.25  # of a line's middle; of a line that may be missing
OUTLIER_MM, WAVE_SHARE = 0.03, 0.4  # from the median around: dust, unless the line waves as much there
LEAST_LINES_SHARE = 0.6
CALM_SHARE = 0.5  # of a stroke's line, from which it hardly rings
WOBBLE_MM, WOBBLE_NOISE_MM, WOBBLE_LENGTH_MM = 0.2, 0.008, 4.0  # of a scanner's carriage: most; noise of 3 mm of a line


@dataclass(frozen=True, eq=False)
class ReadLine:
    """A stroke's drawn line: n places along it."""

    stroke: Experiment
    line: Line
    s_mm: FloatArray  # (n,) from the line's foot
    across_mm: FloatArray  # (n,) to the left of its direction, against the slow line beside it
    picture: str


def read_lines(sights: Sequence[Sight], plan: Plan) -> list[ReadLine]:
    """Read every stroke in every picture that shows it; MeasurementError if too few lines can be read."""
    read: list[ReadLine] = []
    for rough in sights:
        sight = _refined(rough, plan)
        for stroke, slow in twins(plan):
            if (one := _read(sight, stroke, slow)) is not None:
                read.append(one)
    strokes = {each.stroke.name for each in read}
    if len(strokes) < LEAST_LINES_SHARE * len(twins(plan)):
        raise MeasurementError(
            ", ".join(each.picture.path for each in sights),
            [
                f"{len(strokes)} of {len(twins(plan))} strokes can be read: lines are missing, torn, faint, blurred or "
                f"under a glare. Clean the bed, print the page again if it is torn or not complete. {RETAKE}."
            ],
        )
    return read


def _refined(sight: Sight, plan: Plan) -> Sight:
    """Fit the map to the slow lines, twice: the first readings may lie aside."""
    for _ in range(2):
        at, across, off = _offsets(sight, [last_line(slow.motion) for _, slow in twins(plan)])
        if len(at) < 20:
            return sight
        normal = sight.pixels(at + 0.05 * across) - sight.pixels(at - 0.05 * across)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        sight = sight.refined(at, sight.pixels(at + off[:, None] * across), normal)
    return _steadied(sight, plan)


def _offsets(sight: Sight, lines: Sequence[Line], calm: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return places (n, 2) every 3 mm of lines, from a share of their length, normals, and how far off they are."""
    at, across, off = [], [], []
    for line in lines:
        s = np.arange(max(ENDS_MM[0], calm * line.length_mm), line.length_mm - ENDS_MM[1], 0.5)
        if sight.holds(line.at(s, REACH_MM)):
            middle, ink = _middles(sight, line, s)
            good = np.isfinite(middle) & (ink > LEAST_INK)
            blocks = s // 3.0
            for block in np.unique(blocks[good]):
                part = good & (blocks == block)
                at.append(line.at(np.array(np.mean(s[part]))))
                across.append(line.across)
                off.append(float(np.median(middle[part])))
    return np.array(at).reshape(-1, 2), np.array(across).reshape(-1, 2), np.array(off)


def _steadied(sight: Sight, plan: Plan) -> Sight:
    """Take out the unsteady run of a scanner's carriage, by all lines along its rows where they do not ring.

    The shift is a Gaussian process of the row, as strong as the lines lie off, of Matérn's kernel 3/2 (Rasmussen &
    Williams, 2006, eq. 4.17). It counts along the other lines, whose waves it would stretch.
    """
    lines = [
        (last_line(each.motion), calm)
        for pair in twins(plan)
        for each, calm in zip(pair, (CALM_SHARE, 0.0), strict=True)
    ]
    rows, shifts = [], []
    for line, calm in lines:
        ends = sight.pixels(np.stack([line.at(np.array(0.0)), line.at(np.array(line.length_mm))]))
        if abs(ends[1, 1] - ends[0, 1]) < 0.3 * abs(ends[1, 0] - ends[0, 0]):
            at, across, off = _offsets(sight, [line], calm)
            here = sight.pixels(at)[:, 1]
            rows.append(here)
            shifts.append(sight.pixels(at + off[:, None] * across)[:, 1] - here)
    row, shift = np.concatenate([np.empty(0), *rows]), np.concatenate([np.empty(0), *shifts])
    if len(row) < 10:
        return sight
    scale = sight.pixels_per_mm(lines[0][0].foot)
    noise = WOBBLE_NOISE_MM * scale
    shift = np.clip(shift, -WOBBLE_MM * scale, WOBBLE_MM * scale)

    def kernel(a: FloatArray, b: FloatArray) -> FloatArray:
        away = np.sqrt(3.0) * np.abs(a[:, None] - b) / (WOBBLE_LENGTH_MM * scale)
        return (1.0 + away) * np.exp(-away)

    power = max(float(np.mean(shift**2)) - noise**2, 1e-9)
    weights = np.linalg.solve(power * kernel(row, row) + noise**2 * np.eye(len(row)), shift)
    at = np.arange(0.0, sight.picture.ink.shape[0], 0.5 * scale)
    return replace(sight, wobble=np.stack([at, power * kernel(at, row) @ weights]))


def _read(sight: Sight, stroke: Experiment, slow: Experiment) -> ReadLine | None:
    line, twin = last_line(stroke.motion), last_line(slow.motion)
    s = np.arange(ENDS_MM[0], line.length_mm - ENDS_MM[1], STEP_MM)
    if not (sight.holds(line.at(s, REACH_MM)) and sight.holds(twin.at(s, REACH_MM))):
        return None
    ours, theirs = _clean(*_middles(sight, line, s)), _clean(*_middles(sight, twin, s))
    if ours is None or theirs is None:
        return None
    window = 2 * round(0.5 * SMOOTHED_MM / STEP_MM) + 1
    smooth = savgol_filter(theirs, window, 2)
    shift = _row_shift(sight, line, twin)
    beside = np.interp(s + shift, s, smooth)
    return ReadLine(stroke, line, s, ours - beside, sight.picture.path)


def _row_shift(sight: Sight, line: Line, twin: Line) -> float:
    """Return how much further along the slow line the scanner's same line crosses it, mm."""
    middle = line.at(np.array(0.5 * line.length_mm))
    along = sight.pixels(middle + line.along) - sight.pixels(middle - line.along)
    aside = sight.pixels(middle + line.across) - sight.pixels(middle - line.across)
    distance = float((twin.foot - line.foot) @ line.across)
    if abs(along[1]) < 0.5 * np.linalg.norm(along):
        return 0.0
    return float(-distance * aside[1] / along[1])


def _middles(sight: Sight, line: Line, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the ink's middle is across a line at s (n,) mm, and how dark it is there: (n,) mm, (n,)."""
    scale = sight.pixels_per_mm(line.at(np.array(0.5 * line.length_mm)))
    step = float(s[1] - s[0])
    many = max(1, round(step * scale))
    fine = (s[:, None] + step * ((np.arange(many) + 0.5) / many - 0.5)).ravel()
    half = int(np.ceil(REACH_MM * scale * 1.3))
    t = np.linspace(-REACH_MM, REACH_MM, 2 * half + 1)
    px = sight.pixels(line.at(np.repeat(fine[:, None], len(t), 1), np.repeat(t[None], len(fine), 0)))
    low = np.floor(px.reshape(-1, 2).min(axis=0)).astype(int) - 2
    high = np.ceil(px.reshape(-1, 2).max(axis=0)).astype(int) + 3
    low = np.maximum(low, 0)
    part = sight.picture.ink[low[1] : high[1], low[0] : high[0]]
    ink = ndimage.map_coordinates(part, [px[..., 1] - low[1], px[..., 0] - low[0]], order=1, mode="nearest")
    profile = ink.reshape(len(s), many, len(t)).mean(axis=1)
    return _centroids(profile, t)


def _centroids(profile: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the middle of ink (n, m) across t (m,) mm, and its darkness."""
    edge = np.abs(t) > REACH_MM - 0.15
    paper = np.median(profile[:, edge], axis=1)
    raised = profile - paper[:, None]
    dark = np.sort(raised, axis=1)[:, -max(3, len(t) // 10) :].mean(axis=1)
    weight = np.clip(raised - 0.12 * dark[:, None], 0.0, None)
    smooth = ndimage.gaussian_filter(weight, (3.0, len(t) / 16))
    middle = t[np.argmax(smooth - 0.02 * smooth.max() * np.abs(t), axis=1)]
    middle = ndimage.median_filter(middle, 9, mode="nearest")
    for _ in range(4):
        # the window's soft edges keep a centroid from jumping with single pixels
        window = np.clip((CORE_MM - np.abs(t[None] - middle[:, None])) / 0.1 + 0.5, 0.0, 1.0)
        mass = np.sum(weight * window, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = np.where(mass > 0, np.sum(weight * window * t, axis=1) / mass, np.nan)
        middle = np.where(np.isfinite(middle), middle, np.nanmedian(middle))
    return middle, dark


def _clean(middle: FloatArray, ink: FloatArray) -> FloatArray | None:
    """Replace dust and gaps by their neighbourhood; None for a line that is not there."""
    usual = ndimage.median_filter(middle, 7, mode="nearest")
    waving = ndimage.maximum_filter1d(usual, 15) - ndimage.minimum_filter1d(usual, 15)
    bad = (
        (np.abs(middle - usual) > np.maximum(OUTLIER_MM, WAVE_SHARE * waving))
        | (ink < LEAST_INK)
        | (ink < 0.5 * np.median(ink))
    )
    if bad.mean() > BROKEN_SHARE or np.ptp(usual) > 1.2:
        return None
    index = np.arange(len(middle))
    return np.asarray(np.interp(index, index[~bad], middle[~bad]))
