"""Small pieces of the joint solution: cross products, the robust loss of rows, a marginal covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cross(a: Array, b: Array) -> Array:
    """(n, 3) cross products of rows; NumPy's own takes many times as long on few of them."""
    out = np.zeros(a.shape)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return out


def robust(square: Array, gate: Array) -> tuple[Array, Array]:
    """Loss and belonging of each row, the kernel's `_robust` for arrays (see scenes.evidence)."""
    over = np.clip(0.5 * (square - gate * gate), -40.0, 40.0)
    floor = np.log1p(np.exp(-0.5 * np.minimum(gate, 30.0) ** 2))
    loss = np.where(over >= 40.0, gate * gate, square - 2.0 * np.log1p(np.exp(over))) + 2.0 * floor
    silent = gate == 0.0
    return np.where(silent, 0.0, loss), np.where(silent, 0.0, 1.0 / (1.0 + np.exp(over)))


def marginal(normal: Array) -> tuple[Array, float]:
    """(6, 6) covariance of the pose with all else marginalised, and the log-determinant of the whole system."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * scale * scale[:, None]
    # unit diagonal: a billionth more keeps the factor of a singular system finite, and changes no digit of another
    factor = np.linalg.cholesky(scaled + 1e-9 * np.eye(len(normal)))
    half = np.linalg.solve(factor, np.eye(len(normal))[:, :6])
    covariance = (half.T @ half) * scale[:6] * scale[:6, None]
    return covariance, float(2.0 * np.log(np.diag(factor)).sum() - 2.0 * np.log(scale).sum())
