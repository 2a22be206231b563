"""Linear-quadratic optimal control of a plant, or of many plants side by side.

    z⁺ = A z + B w        cost  Σ zᵀQz + wᵀRw + 2 zᵀNw        w = −F z

The names are those of dlqr in python-control; leading axes of the matrices count the plants. A state's value is zᵀPz.

Anderson & Moore, Optimal Control: Linear Quadratic Methods, 1990, ch. 4 and 10; the stationary value by structured
doubling (Chu, Fan, Lin & Wang, Int. J. Control 77 (2004) 767-788), for all plants at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.arrays import FloatArray

DOUBLINGS = 9  # 512 steps: the state is forgotten by then


@dataclass(frozen=True, slots=True)
class LinearQuadratic:
    """The problems of one or many plants with n states and m controls."""

    a: FloatArray  # (…, n, n)
    b: FloatArray  # (…, n, m)
    q: FloatArray  # (…, n, n)
    r: FloatArray  # (…, m, m)
    n: FloatArray  # (…, n, m)

    def feedback(self, value: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the best F (…, m, n) one step before the value P (…, n, n), and R + BᵀPB (…, m, m)."""
        ahead = transposed(self.b) @ value
        curvature = self.r + ahead @ self.b
        gain: Any = np.linalg.solve(curvature, transposed(self.n) + ahead @ self.a)
        return gain, curvature

    def value_before(self, value: FloatArray, feedback: FloatArray) -> FloatArray:
        """Return the value P one step before, under any F."""
        closed, half = self.a - self.b @ feedback, 0.5 * self.r @ feedback - transposed(self.n)
        now = transposed(feedback) @ half
        return np.asarray(self.q + now + transposed(now) + transposed(closed) @ value @ closed)

    def stationary_value(self) -> FloatArray:
        """Return P of the problem without an end."""
        cross = np.linalg.solve(self.r, transposed(self.n))
        a = self.a - self.b @ cross
        h = self.q - self.n @ cross
        g = self.b @ np.linalg.solve(self.r, transposed(self.b))
        size = a.shape[-1]
        eye = np.eye(size)
        for _ in range(DOUBLINGS):  # a: the remainder of a state after 1, 2, 4, … steps
            solved = np.linalg.solve(eye + g @ h, np.concatenate([a, g @ transposed(a)], axis=-1))
            ahead, spread = solved[..., :size], solved[..., size:]
            h = h + transposed(a) @ h @ ahead
            g = g + a @ spread
            a = a @ ahead
            h, g = 0.5 * (h + transposed(h)), 0.5 * (g + transposed(g))
        return np.asarray(h)


def transposed(matrices: NDArray[Any]) -> NDArray[Any]:
    """Return matrices (…, i, j) as (…, j, i)."""
    return np.swapaxes(matrices, -1, -2)
