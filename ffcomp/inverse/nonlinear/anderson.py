"""Anderson's acceleration of a fixed point, at each place of a path by itself (D. G. Anderson, J. ACM 12 (1965) 547).

Of points x_i and their answers f_i, which ought to vanish, the next point is

    x + β f − Σ w_i (Δx_i + β Δf_i),   Δx_i = x − x_i, Δf_i = f − f_i,   w: the least squares of f − Σ w_i Δf_i

With one point before it, this is the secant method. What a command does is over after some ten knots: around each
knot the answers have their own weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.arrays import FloatArray

Tried = tuple[FloatArray, FloatArray]  # a point and its answer, (n, 3) mm

AROUND, EASED = 16, 8  # knots on either side: by which a place is judged, and over which one command becomes another
REGULAR, LEAST_MM2 = 1e-2, 1e-12  # what keeps the weights small: of the squares, and where nothing moves


def mixed(tried: Sequence[Tried], share: float) -> FloatArray:
    """Return the next point (n, 3) mm, from those tried, oldest first, and the share β of an answer to take up."""
    (x, f), before = tried[-1], tried[:-1]
    if not before:
        return np.asarray(x + share * f)
    moved, turned = (np.stack([now - old[part] for old in before], axis=1) for part, now in enumerate((x, f)))
    squares = around(np.einsum("nic,njc->nij", turned, turned), AROUND)
    room = REGULAR * np.trace(squares, axis1=1, axis2=2) + LEAST_MM2
    right = around(np.einsum("nic,nc->ni", turned, f), AROUND)
    weights = np.linalg.solve(squares + room[:, None, None] * np.eye(len(before)), right[..., None])[..., 0]
    return np.asarray(x + share * f - np.einsum("ni,nic->nc", around(weights, EASED), moved + share * turned))


def around(values: FloatArray, knots: int) -> FloatArray:
    """Average over so many knots on either side, (n, …); fewer at the ends."""
    at, n = np.arange(len(values)), len(values)
    low, high = np.maximum(at - knots, 0), np.minimum(at + knots + 1, n)
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    return np.asarray(((sums[high] - sums[low]).T / (high - low)).T)
