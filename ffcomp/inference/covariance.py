"""The covariance and the scatter of a fit whose errors are correlated within clusters: a motion, or near lines."""

from __future__ import annotations

import numpy as np

from models.arrays import FloatArray, IntArray

MOST_LEVERAGE = 0.9  # of a cluster: the residual of one that determines a value alone does not show its error


def clustered_covariance(
    jacobian: FloatArray, residual: FloatArray, clusters: IntArray, precision: FloatArray
) -> FloatArray:
    """Estimate the covariance (p, p), at least as wide as by leaving out each cluster (jackknife).

    Without cluster c, to first order, the fit moves by (N − J_cᵀ J_c)⁻¹ J_cᵀ r_c with N = JᵀJ + precision (MacKinnon &
    White, J. Econometrics 29, 1985; for clusters Liang & Zeger, Biometrika 73, 1986). It so includes the model's error,
    which keeps its sign throughout a cluster. It never falls below N⁻¹, the covariance with white noise alone.

    Parameters
    ----------
    jacobian, residual : (rows, p), (rows,) in standard deviations.
    clusters : (rows,) number of each row's cluster; −1: an independent row, in none.
    precision : (p,) of the prior.
    """
    normal = jacobian.T @ jacobian + np.diag(precision)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    squares, vectors = np.linalg.eigh(normal / np.outer(size, size))
    certain = squares > 1e-15 * squares[-1]
    root = vectors[:, certain] / np.sqrt(squares[certain]) / size[:, None]  # N⁻¹ = root rootᵀ
    bread = root @ root.T
    alike = clusters >= 0
    if not alike.any():
        return bread
    rows = np.flatnonzero(alike)[np.argsort(clusters[alike], kind="stable")]
    ends = np.flatnonzero(np.diff(clusters[rows])) + 1
    moved = np.zeros((root.shape[1], root.shape[1]))
    for part in np.split(rows, ends):
        own = jacobian[part] @ root
        if len(part) < own.shape[1]:  # the leverage from the smaller side
            values, sides = np.linalg.eigh(own @ own.T)
            step = own.T @ (sides @ ((sides.T @ residual[part]) / (1.0 - np.minimum(values, MOST_LEVERAGE))))
        else:
            values, sides = np.linalg.eigh(own.T @ own)
            step = sides @ ((sides.T @ (own.T @ residual[part])) / (1.0 - np.minimum(values, MOST_LEVERAGE)))
        moved += np.outer(step, step)
    lone = jacobian[~alike] @ root
    by_itself = lone.T @ lone + root.T @ (precision[:, None] * root)
    spread = np.einsum("ij,jk,ik->i", root, moved + by_itself, root)
    wider = np.sqrt(np.maximum(1.0, spread / np.maximum(np.diag(bread), 1e-300)))
    return bread * np.outer(wider, wider)


def overdispersion(misfit: float, block_rows: float) -> float:
    """Return the ratio of the scatter of |r|² from noise and model error to that from noise alone.

    The shapes of a model are never exactly those of a machine. Of a misfit v, 1/v is noise, which is white, and the
    rest is model error, which keeps its sign over a block of rows: quasi-likelihood with correlated errors (McCullagh &
    Nelder, Generalized Linear Models, 1989, chapter 9).

    Parameters
    ----------
    misfit : the mean square of the whitened residual; below one it counts as one.
    block_rows : rows over which the model's error keeps its sign.
    """
    v = max(misfit, 1.0)
    return v * (1 + (block_rows - 1) * (1 - 1 / v))
