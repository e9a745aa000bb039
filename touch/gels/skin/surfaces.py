"""From a skin's normals to its heights: slopes over the image, and the surface that has them.

With n the skin's normal, P = D r the point on a pixel's line r at depth D: n . P_u = 0, so (ln D)_u = -(n . r_u) /
(n . r) for a pinhole camera, and z_u = -n_x / n_z times the pitch for parallel lines. The difference of these slopes
from the untouched skin's is integrated over the image: the least-squares surface solves Poisson's equation with free
borders, which the discrete cosine transform diagonalises (Frankot and Chellappa, PAMI 1988, for its Fourier sibling).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.robot.gels import Gel
from touch.gels.skin.colour import Mask
from touch.gels.skin.kernels import FLATTEST

Array = NDArray[np.float64]
Fields = NDArray[np.floating[Any]]

# Share of an image that must be untouched to be what heights are measured from.
UNTOUCHED = 0.01


def slopes(normal: Array, gel: Gel, index: NDArray[np.int64] | None = None) -> tuple[Array, Array]:
    """What integrates along u and v to z (m; parallel lines) or ln D (pinhole), of normals (..., 3) of all pixels (h,
    w), or of those with flat indices `index` (m,).
    """
    lines, across = gel.lines
    if index is not None:
        lines = lines.reshape(-1, 3)[index]
    facing = np.maximum((normal * lines).sum(axis=-1), FLATTEST)
    return -(normal @ across[0]) / facing, -(normal @ across[1]) / facing


def integrate(along_u: Fields, along_v: Fields) -> Fields:
    """(..., h, w) surfaces whose differences between neighbours fit slopes (..., h, w) best in the mean square; mean 0.

    Slopes are a pixel's own; between two pixels the mean of both counts. float32 or float64, as the slopes are.
    """
    from scipy.fft import dctn, idctn

    # divergence: the normal equations' right side
    right = np.zeros_like(along_u)
    between = 0.5 * (along_u[..., 1:] + along_u[..., :-1])
    right[..., :-1] = between
    right[..., 1:] -= between
    between = 0.5 * (along_v[..., 1:, :] + along_v[..., :-1, :])
    right[..., :-1, :] += between
    right[..., 1:, :] -= between
    spectrum = dctn(right, type=2, norm="ortho", axes=(-2, -1), overwrite_x=True)
    spectrum *= _inverse_laplacian(*along_u.shape[-2:]).astype(right.dtype, copy=False)
    return np.asarray(idctn(spectrum, type=2, norm="ortho", axes=(-2, -1), overwrite_x=True))


@lru_cache(maxsize=16)
def _inverse_laplacian(height: int, width: int) -> Array:
    """(h, w): one over the eigenvalues of the Laplacian with free borders, 0 for the mean."""
    eigen = (2.0 - 2.0 * np.cos(np.pi * np.arange(height) / height))[:, None]
    eigen = eigen + (2.0 - 2.0 * np.cos(np.pi * np.arange(width) / width))
    eigen[0, 0] = 1.0
    inverse = -1.0 / eigen
    inverse[0, 0] = 0.0
    return np.asarray(inverse)


def fitted(fields: Fields) -> Fields:
    """(..., h, w) amplitudes of the surfaces whose own slopes fit slopes (2, ..., h, w) along u and v best in the mean
    square, mean 0. For small grids; float32 or float64, as the slopes are.

    A surface is a sum of cosines and its slopes are their derivatives, exactly: differences between neighbours would be
    smaller by a tenth where a surface bends over a few pixels, and what they are compared with seem as much larger.
    """
    height, width = fields.shape[-2:]
    (cos_v, sin_v), (cos_u, sin_u) = _waves(height, fields.dtype.char), _waves(width, fields.dtype.char)
    square = np.outer((cos_v**2).sum(axis=0), (sin_u**2).sum(axis=0))
    square += np.outer((sin_v**2).sum(axis=0), (cos_u**2).sum(axis=0))
    square[0, 0] = np.inf  # the mean is not in the slopes
    return np.asarray((cos_v.T @ (fields[0] @ sin_u) + sin_v.T @ (fields[1] @ cos_u)) / square)


def surface_of(waves: Fields) -> Fields:
    """(..., h, w) of `fitted` amplitudes."""
    height, width = waves.shape[-2:]
    return np.asarray(_waves(height, waves.dtype.char)[0] @ waves @ _waves(width, waves.dtype.char)[0].T)


def slopes_of_waves(waves: Fields) -> Fields:
    """(2, ..., h, w) slopes along u and v of `fitted` amplitudes."""
    height, width = waves.shape[-2:]
    (cos_v, sin_v), (cos_u, sin_u) = _waves(height, waves.dtype.char), _waves(width, waves.dtype.char)
    return np.stack([cos_v @ (waves @ sin_u.T), sin_v @ (waves @ cos_u.T)])


@lru_cache(maxsize=16)
def _waves(count: int, kind: str) -> tuple[Array, Array]:
    """(n, n) cosines, and their derivatives, at the middles of n cells (rows), n of them (columns)."""
    phase = np.pi * np.outer(np.arange(count) + 0.5, np.arange(count)) / count
    slope = -np.sin(phase) * (np.pi * np.arange(count) / count)
    return np.cos(phase).astype(kind), slope.astype(kind)


def level(change: Fields, inside: Mask) -> float:
    """What of a surface (h, w) is the untouched skin's: outside of what moved, or else its least indented part."""
    outside = ~inside
    return float(np.median(change[outside]) if outside.mean() > UNTOUCHED else np.percentile(change, 98.0))


def as_depth(change: Fields, gel: Gel) -> Fields:
    """(h, w) m of indentation, 0 to the gel's thickness, by how z (m) or ln D changed (h, w)."""
    if gel.distance is not None:  # of a pinhole camera it is the logarithm of the depth that was integrated
        away = (gel.distance + gel.surface).astype(change.dtype, copy=False)
        change = away * np.expm1(np.clip(change, -1.0, 1.0))
    return np.clip(-change, 0.0, gel.thickness)
