"""A picture of a page, and where in it each point of the page is.

File -> contrast of ink to paper -> discs -> which disc is which (an affine map of three, then a perspective of all) ->
perspective and the lens' distortion by least squares. Whatever scanner, lens and paper do beyond that is smooth enough
to shift a stroke and the slow line next to it alike (`lines.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from ffcomp.errors import MeasurementError
from ffcomp.record.page import DISC_MM, TWIN_MM, discs_of, last_line, twins
from ffcomp.record.plan import Plan
from models.arrays import FloatArray, IntArray

Pixels = NDArray[np.float32]  # (rows, columns)

FEWEST_PIXELS, FEWEST_PIXELS_PER_MM = 200, 8.0  # of the picture's shorter side; 200 dpi
COARSE_PX = 1800  # of the picture's longer side, while discs are sought
TILE_PX = 24  # of the coarse picture, for the brightness of the paper
LEAST_CONTRAST = 0.12
ROUND = (0.75, 1.3)  # area of an ellipse by its second moments over its real area
LEAST_DISCS, MOST_TRIPLES = 5, 20000  # of the page; of blots, for three discs
ONE_SIZE, SIZE_STEP, APART = (0.7, 1.45), 1.3, 1.7  # radii and distances of discs in one picture: perspective
NEAR_AFFINE_MM, NEAR_MM, MOST_MISFIT_MM = 9.0, 1.2, 0.2  # from a disc's place: of an affine map; a perspective; the fit
LEAST_TRIANGLE_MM2, LEAST_UPRIGHT, MOST_MAPS = 600.0, 0.33, 3  # no needles; no map that stretches more than 2.6 to 1
LEAST_SHARE = 0.7  # of the discs that lie inside the picture
LEAST_STANDARD_ERRORS = 4.0  # contrast of slow lines to the paper beside them
DISC_SD_MM, LINE_SD_MM, BARREL_SD = 0.03, 0.05, (0.02, 0.005)  # of a map: of its points; its distortion, as a prior

RETAKE = "Take it again, straight from above, with all discs in it, in even light without flash"


@dataclass(frozen=True, eq=False)
class Picture:
    """The darkness of a page's ink against its paper: about 0 on paper, 1 in ink."""

    path: str
    ink: Pixels

    @property
    def middle(self) -> FloatArray:
        """Return the picture's middle, (2,) pixels: column, row."""
        return 0.5 * np.array(self.ink.shape[::-1], dtype=float)


@dataclass(frozen=True, eq=False)
class Sight:
    """A picture with its map from the page: a perspective, then the lens' distortion about the picture's middle."""

    picture: Picture
    perspective: FloatArray  # (3, 3), of (x, y, 1) mm to pixels: column, row
    barrel: FloatArray  # (2,) of the second and the fourth power of the radius
    disc_mm: FloatArray  # (k, 2) where the discs that were seen are on the page
    disc_px: FloatArray  # (k, 2) and in the picture
    wobble: FloatArray = field(default_factory=lambda: np.zeros((2, 1)))  # (2, k) rows, and by how many rows off there

    def pixels(self, xy: FloatArray) -> FloatArray:
        """Return the pixels (..., 2) of page positions (..., 2) mm."""
        px = _distorted(_projected(self.perspective, xy), self.barrel, self.picture.middle)
        px[..., 1] += np.interp(px[..., 1], *self.wobble)
        return px

    def pixels_per_mm(self, xy: FloatArray) -> float:
        """Return the resolution at a page position (2,) mm."""
        right, left, above, below = self.pixels(xy + 0.05 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
        a, b = right - left, above - below
        return float(10.0 * np.sqrt(abs(a[0] * b[1] - a[1] * b[0])))

    def holds(self, xy: FloatArray) -> bool:
        """Tell whether page positions (n, 2) mm all lie in the picture."""
        px = self.pixels(xy)
        return bool(np.all((px >= 0.0) & (px <= 2 * self.picture.middle - 1)))

    @property
    def misfit_mm(self) -> float:
        """Root mean square of the discs' distances from where the map has them."""
        gap = self.pixels(self.disc_mm) - self.disc_px
        return float(np.sqrt(np.sum(gap**2) / (gap.size - 8))) / _scale(self.perspective)  # a perspective's numbers

    def refined(self, at_mm: FloatArray, px: FloatArray, normal: FloatArray) -> Sight:
        """Fit perspective and distortion to the discs and to places of straight lines, which count across them.

        at_mm, px, normal : (n, 2) places on the page, where lines are seen for them, and unit vectors across, pixels.
        """
        k, scale, middle = len(self.disc_mm), _scale(self.perspective), self.picture.middle
        where = np.concatenate([self.disc_mm, self.disc_mm, at_mm])
        seen = np.concatenate([self.disc_px, self.disc_px, px])
        counts = np.concatenate([np.repeat(np.eye(2), k, axis=0), normal])
        sd = scale * np.repeat([DISC_SD_MM, LINE_SD_MM], [2 * k, len(at_mm)])
        unit = np.array([scale, scale, 1.0, scale, scale, 1.0, 1e-5, 1e-5])

        def mapped(z: FloatArray) -> tuple[FloatArray, FloatArray]:
            return self.perspective + np.append(unit * z[:8], 0.0).reshape(3, 3), z[8:] * BARREL_SD

        def residual(z: FloatArray) -> FloatArray:
            perspective, barrel = mapped(z)
            gap = _distorted(_projected(perspective, where), barrel, middle) - seen
            return np.append(np.sum(gap * counts, axis=1) / sd, z[8:])

        start = np.append(np.zeros(8), self.barrel / BARREL_SD)
        found = least_squares(residual, start, method="lm", x_scale="jac", ftol=1e-7, max_nfev=2000)
        perspective, barrel = mapped(found.x)
        return replace(self, perspective=perspective, barrel=barrel)


def _projected(perspective: FloatArray, xy: FloatArray) -> FloatArray:
    flat = xy @ perspective[:, :2].T + perspective[:, 2]
    return np.asarray(flat[..., :2] / flat[..., 2:])


def _distorted(px: FloatArray, barrel: FloatArray, middle: FloatArray) -> FloatArray:
    away = px - middle
    radius2 = np.sum((away / np.linalg.norm(middle)) ** 2, axis=-1, keepdims=True)
    return np.asarray(middle + away * (1.0 + barrel[0] * radius2 + barrel[1] * radius2**2))


def _scale(perspective: FloatArray) -> float:
    """Return pixels a mm, roughly."""
    return float(np.sqrt(abs(np.linalg.det(perspective[:2, :2]))))


# ---- from a file to ink --------------------------------------------------------------------------


def read_picture(path: str | Path) -> Picture:
    """Read a JPEG, PNG or TIFF file.

    Raises MeasurementError for a file that is no picture, or is cut off, or shows nothing.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            as_read = image if image.mode.startswith("I;16") or image.mode in "IF" else image.convert("RGB")
            grey = _grey(np.asarray(ImageOps.exif_transpose(as_read)))
    except UnidentifiedImageError:
        problem = "This is no picture that can be read: give a JPEG, PNG or TIFF file."
        raise MeasurementError(str(path), [problem]) from None
    except Image.DecompressionBombError as error:
        raise MeasurementError(str(path), [f"{error} 600 dpi of one page are enough."]) from None
    except (OSError, SyntaxError, ValueError) as error:
        if isinstance(error, FileNotFoundError | PermissionError | IsADirectoryError):
            raise
        raise MeasurementError(str(path), [f"The picture is not complete ({error}). Copy or scan it again."]) from None
    if min(grey.shape) < FEWEST_PIXELS:
        problem = f"The picture has {grey.shape[1]} x {grey.shape[0]} pixels: too few of a page."
        raise MeasurementError(str(path), [problem])
    return Picture(str(path), _ink(grey))


def _grey(pixels: NDArray[np.generic]) -> Pixels:
    """Choose the channel in which ink and paper differ most."""
    if pixels.ndim == 2:
        return pixels.astype(np.float32)
    low, middle, high = np.percentile(pixels[::7, ::7].reshape(-1, 3).astype(float), [1, 50, 99], axis=0)
    return pixels[..., int(np.argmax(np.maximum(middle - low, high - middle)))].astype(np.float32)


def _ink(grey: Pixels) -> Pixels:
    """Divide by the paper's brightness around, between the lines too, so that shadows do not matter."""
    from PIL import Image

    small = _reduced(grey)
    low, middle, high = np.percentile(small, [0.5, 50, 99.5])
    if high - middle > 1.5 * (middle - low):  # bright ink on a dark bed
        grey, small = grey.max() - grey, grey.max() - small
    padded = np.pad(small, [(0, -n % TILE_PX) for n in small.shape], mode="edge")
    rows, columns = (n // TILE_PX for n in padded.shape)
    tiles = np.percentile(padded.reshape(rows, TILE_PX, columns, TILE_PX), 80, axis=(1, 3))
    tiles = ndimage.gaussian_filter(ndimage.percentile_filter(tiles, 60, size=5, mode="nearest"), 1.0, mode="nearest")
    tiles = np.maximum(tiles, 1e-3 * max(float(small.max()), 1e-6)).astype(np.float32)
    height, width = grey.shape
    tile = TILE_PX * _coarse(grey)
    paper = Image.fromarray(tiles).resize(
        (width, height), Image.Resampling.BILINEAR, box=(0, 0, width / tile, height / tile)
    )
    return np.asarray(1.0 - grey / np.asarray(paper), dtype=np.float32)


def _coarse(picture: Pixels) -> int:
    """Return how many pixels of a picture are one of the coarse picture, along each side."""
    return -(-max(picture.shape) // COARSE_PX)


def _reduced(picture: Pixels) -> Pixels:
    """Return the coarse picture."""
    from PIL import Image

    return np.asarray(Image.fromarray(picture).reduce(_coarse(picture)))


# ---- discs ---------------------------------------------------------------------------------------


def find_page(picture: Picture, plan: Plan) -> Sight:
    """Find a plan's page in a picture.

    Raises MeasurementError if it is not there, mirrored, of another plan, blurred, or too small.
    """
    page, blots = discs_of(plan), _blots(picture)
    sight = _found(picture, plan, blots)
    if sight is None:
        if len(blots) < LEAST_DISCS:
            problem = (
                f"{len(blots)} of the page's {len(page)} discs can be seen, and {LEAST_DISCS} are needed: the picture "
                f"is empty, blurred, or cut off. {RETAKE}."
            )
        elif _found(picture, plan, blots, flip=-1.0) is not None:
            problem = "The page is mirrored. Flip the picture, or scan the printed side (not through a glass plate)."
        else:
            problem = (
                f"There are {len(blots)} round blots, but no {LEAST_DISCS} of them are where this plan's discs are: it "
                "is the page of another plan or of another machine, or too much of it is missing. Give the .json file "
                f"that was written with the G-code of this page, and the whole page. {RETAKE}."
            )
        raise MeasurementError(picture.path, [problem])
    resolution = min(sight.pixels_per_mm(at) for at in sight.disc_mm)
    if resolution < FEWEST_PIXELS_PER_MM:
        problem = (
            f"The picture has {resolution:.1f} pixels a mm ({25.4 * resolution:.0f} dpi), and needs "
            f"{FEWEST_PIXELS_PER_MM:g}. Scan at 600 dpi, or let the page fill the photo."
        )
        raise MeasurementError(picture.path, [problem])
    return sight


def _found(picture: Picture, plan: Plan, blots: FloatArray, flip: float = 1.0) -> Sight | None:
    """Return the map of the page, mirrored if `flip` is -1; None if none fits.

    Discs are of one size; which one is not known, so each is tried, the largest first. Ink where the slow lines are
    proves a map: few discs among many blots fit by chance.
    """
    turned = np.array([flip, 1.0])
    page, none = turned * discs_of(plan), np.empty((0, 2))
    size = float(blots[:, 2].max(initial=0.0))
    while size > blots[:, 2].min(initial=np.inf):
        group = blots[(blots[:, 2] > ONE_SIZE[0] * size) & (blots[:, 2] < ONE_SIZE[1] * size)]
        pairs = _matched(page, group, picture) if len(group) >= LEAST_DISCS else []
        if pairs:
            at = page[[i for i, _ in pairs]]
            px = np.array([_middle_of(picture.ink, *group[j]) for _, j in pairs])
            sight = Sight(picture, _perspective(at, px), np.zeros(2), at, px).refined(none, none, none)
            if sight.misfit_mm < MOST_MISFIT_MM and _lines_are_dark(sight, plan, turned):
                return sight
        size /= SIZE_STEP
    return None


def _lines_are_dark(sight: Sight, plan: Plan, turned: FloatArray) -> bool:
    """Tell whether slow lines are darker than what lies beside them, beyond chance."""
    darker = []
    for _, slow in twins(plan):
        line = last_line(slow.motion)
        s = np.arange(1.0, line.length_mm - 1.0, 0.25)[:, None]
        xy = turned * line.at(np.repeat(s, 5, axis=1), np.array([-0.5 * TWIN_MM, -0.15, 0.0, 0.15, 0.5 * TWIN_MM]))
        if sight.holds(xy):
            px = sight.pixels(xy)
            ink = ndimage.map_coordinates(sight.picture.ink, [px[..., 1], px[..., 0]], order=1).mean(axis=0)
            darker.append(float(ink[1:4].mean() - 0.5 * (ink[0] + ink[4])))
    error = np.std(darker, ddof=1) / np.sqrt(len(darker)) if len(darker) > 2 else np.inf
    return bool(np.mean(darker or [0.0]) > LEAST_STANDARD_ERRORS * error)


def _blots(picture: Picture) -> FloatArray:
    """Find round dark blots of all sizes: (n, 3) columns column, row, radius, pixels of the picture."""
    coarse, k = _reduced(picture.ink), _coarse(picture.ink)
    dark = coarse > max(LEAST_CONTRAST, 0.5 * float(np.percentile(coarse, 99.7)))
    dark = ndimage.binary_closing(dark, iterations=2)  # where the spiral of a disc ends
    depth = ndimage.distance_transform_edt(dark)
    blots: list[tuple[float, float, float, float]] = []
    for deep in np.geomspace(1.5, 60.0, 14):
        labels, count = ndimage.label(depth > deep)
        index = np.arange(1, count + 1)
        for label, box in zip(index, ndimage.find_objects(labels), strict=True):
            inside = labels[box] == label
            row, column = np.nonzero(inside)
            most = float(depth[box][inside].max())
            if not 0.25 < deep / most < 0.75 or len(row) < 6:
                continue
            spread = np.cov(np.stack([row, column])) + np.eye(2) / 12
            ellipse = 4 * np.pi * np.sqrt(max(float(np.linalg.det(spread)), 0.0))
            low, high = np.linalg.eigvalsh(spread)
            if ROUND[0] < ellipse / len(row) < ROUND[1] and low > 0.3 * high:
                r, c = row.mean() + box[0].start, column.mean() + box[1].start
                blots.append((c, r, most, abs(deep / most - 0.5)))
    single = np.empty((0, 3))
    for c, r, radius, _ in sorted(blots, key=lambda each: each[3]):  # each blot once
        apart = np.hypot(single[:, 0] - c, single[:, 1] - r)
        if np.all(apart > np.maximum(single[:, 2], radius)):
            single = np.vstack([single, [c, r, radius]])
    return k * single + [0.5 * (k - 1), 0.5 * (k - 1), 0.0]


def _matched(page: FloatArray, seen: FloatArray, picture: Picture) -> list[tuple[int, int]]:
    """Match discs of the page (n, 2) mm with blots (m, 3) pixels: pairs of indices; rows count downwards.

    Any three discs and any three blots make an affine map, if its scale is that of the blots' sizes; the one that
    brings most others near is grown to a perspective. The first match of all that can be seen ends the search.
    """
    best: list[tuple[int, int]] = []
    nearest = KDTree(seen[:, :2])
    for triple in np.random.default_rng(0).permutation(list(combinations(range(len(page)), 3))):
        for affine in _affine_maps(page, seen, triple, nearest):
            pairs = _grown(page, seen[:, :2], affine)
            expected = _expected(page, seen, pairs, picture) if len(pairs) > len(best) else len(page) + 1
            if len(pairs) >= max(LEAST_DISCS, LEAST_SHARE * expected):
                best = pairs
                if len(pairs) >= expected:
                    return best
    return best


def _affine_maps(page: FloatArray, seen: FloatArray, triple: IntArray, nearest: KDTree) -> list[FloatArray]:
    """Return the affine maps (3, 2) of three discs to any three blots (m, 3) that bring most others near."""
    full = np.column_stack([page, np.ones(len(page))])
    if abs(np.linalg.det(full[triple])) < LEAST_TRIANGLE_MM2:
        return []
    at, per_mm = seen[:, :2], seen[:, 2] / DISC_MM
    apart_mm = np.linalg.norm(at[:, None] - at, axis=2) / np.sqrt(per_mm[:, None] * per_mm)
    sides = np.linalg.norm(page[triple[[0, 0, 1]]] - page[triple[[1, 2, 2]]], axis=1)
    a, b, c = ((apart_mm > each / APART) & (apart_mm < each * APART) for each in sides)
    others = np.argwhere(a[:, :, None] & b[:, None, :] & c[None])
    if len(others) > MOST_TRIPLES:
        others = np.random.default_rng(0).permutation(others)[:MOST_TRIPLES]
    maps = np.einsum("ab,obc->oac", np.linalg.inv(full[triple]), at[others])
    linear = maps[:, :2]
    det = linear[:, 0, 0] * linear[:, 1, 1] - linear[:, 0, 1] * linear[:, 1, 0]
    upright = (det < 0) & (np.abs(det) > LEAST_UPRIGHT * np.sum(linear**2, axis=(1, 2)))
    maps, scale = maps[upright], np.sqrt(np.abs(det[upright]))
    gap = nearest.query(np.einsum("nb,obc->onc", full, maps))[0] / scale[:, None]
    score = (gap < NEAR_AFFINE_MM).sum(axis=1) - 1e-3 * np.minimum(gap, NEAR_AFFINE_MM).sum(axis=1)
    ranked = np.argsort(-score)[:MOST_MAPS]
    return [maps[o] for o in ranked if score[o] > min(LEAST_DISCS, len(seen)) - 1]


def _grown(page: FloatArray, seen: FloatArray, affine: FloatArray) -> list[tuple[int, int]]:
    """Turn an affine map (3, 2) into a perspective of as many pairs as fit it."""
    perspective = np.vstack([affine.T, [0.0, 0.0, 1.0]])
    pairs: list[tuple[int, int]] = []
    for near in (NEAR_AFFINE_MM, 5.0, 3.0, NEAR_MM, NEAR_MM):
        there = _projected(perspective, page)
        gap = np.linalg.norm(there[:, None] - seen[None], axis=2) / _scale(perspective)
        nearest = gap.argmin(axis=1)
        pairs = [(i, int(j)) for i, j in enumerate(nearest) if gap[i, j] < near and gap[:, j].argmin() == i]
        if len(pairs) < LEAST_DISCS:
            return []
        perspective = _perspective(page[[i for i, _ in pairs]], seen[[j for _, j in pairs]])
    return pairs


def _perspective(page: FloatArray, px: FloatArray) -> FloatArray:
    """Fit a perspective (3, 3) to points by the direct linear transform (Hartley & Zisserman, 2004, algorithm 4.2)."""
    to_page, to_px = _normal(page), _normal(px)
    a = np.column_stack([page, np.ones(len(page))]) @ to_page.T
    b = np.column_stack([px, np.ones(len(px))]) @ to_px.T
    zero = np.zeros_like(a)
    rows = np.concatenate([np.hstack([a, zero, -b[:, :1] * a]), np.hstack([zero, a, -b[:, 1:2] * a])], axis=0)
    scaled = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    matrix = np.linalg.inv(to_px) @ scaled @ to_page
    return np.asarray(matrix / matrix[2, 2])


def _normal(points: FloatArray) -> FloatArray:
    middle = points.mean(axis=0)
    scale = np.sqrt(2) / max(float(np.sqrt(np.mean(np.sum((points - middle) ** 2, axis=1)))), 1e-9)
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])


def _expected(page: FloatArray, seen: FloatArray, pairs: Sequence[tuple[int, int]], picture: Picture) -> int:
    """Count the discs that should be in the picture."""
    there = _projected(_perspective(page[[i for i, _ in pairs]], seen[[j for _, j in pairs], :2]), page)
    return int(np.all((there > 0) & (there < 2 * picture.middle), axis=1).sum())


def _middle_of(ink: Pixels, column: float, row: float, radius: float) -> FloatArray:
    """Return a disc's centroid, (2,) pixels."""
    reach = int(1.6 * radius) + 3
    r0, c0 = max(0, int(row) - reach), max(0, int(column) - reach)
    part = ink[r0 : int(row) + reach + 1, c0 : int(column) + reach + 1].astype(float)
    weight = np.clip(part - 0.3 * np.percentile(part, 95), 0.0, 0.5 * np.percentile(part, 95))
    labels, count = ndimage.label(weight > 0)
    if count:
        sizes = ndimage.sum_labels(weight, labels, np.arange(1, count + 1))
        weight = weight * (labels == 1 + int(np.argmax(sizes)))
    r, c = np.mgrid[r0 : r0 + part.shape[0], c0 : c0 + part.shape[1]]
    return np.array([np.sum(weight * c), np.sum(weight * r)]) / np.sum(weight)
