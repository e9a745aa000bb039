"""From a skin's normals to its heights: slopes over the image, and the surface that has them.

With n the skin's normal, P = D r the point on a pixel's line r at depth D: n . P_u = 0, so (ln D)_u = -(n . r_u) /
(n . r) for a pinhole camera, and z_u = -n_x / n_z times the pitch for parallel lines. The difference of these slopes
from the untouched skin's is integrated over the image: the least-squares surface solves Poisson's equation with free
borders, which the discrete cosine transform diagonalises (Frankot and Chellappa, PAMI 1988, for its Fourier sibling).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.robot.gels import Gel
from touch.gels.colour import Mask

Array = NDArray[np.float64]

# Skin steeper than 84 degrees to its pixel's line is a wrong colour.
FLATTEST = 0.1
# Share of an image that must be untouched to be what heights are measured from.
UNTOUCHED = 0.01


def slopes(normal: Array, gel: Gel, index: NDArray[np.int64] | None = None) -> tuple[Array, Array]:
    """What integrates along u and v to z (m; parallel lines) or ln D (pinhole), of normals (..., 3) of all pixels (h,
    w), or of those with flat indices `index` (m,).
    """
    if gel.matrix is None:
        assert gel.pitch is not None
        z = np.maximum(normal[..., 2], FLATTEST)
        return -gel.pitch * normal[..., 0] / z, -gel.pitch * normal[..., 1] / z
    k, rays = gel.matrix, gel.rays if index is None else gel.rays.reshape(-1, 2)[index]
    facing = normal[..., 0] * rays[..., 0] + normal[..., 1] * rays[..., 1] + normal[..., 2]
    facing = np.maximum(facing, FLATTEST)
    along_u = normal[..., 0] / k[0, 0]
    along_v = (normal[..., 1] - normal[..., 0] * k[0, 1] / k[0, 0]) / k[1, 1]
    return -along_u / facing, -along_v / facing


def facing(along_u: Array, along_v: Array, gel: Gel, index: NDArray[np.int64]) -> Array:
    """(m, 3) unit normals by slopes (m,) at pixels of flat indices `index` (m,): `slopes` the other way round."""
    if gel.matrix is None:
        assert gel.pitch is not None
        normal = np.stack([-along_u / gel.pitch, -along_v / gel.pitch, np.ones(len(index))], axis=1)
    else:
        k, rays = gel.matrix, gel.rays.reshape(-1, 2)[index]
        # r, r_u and r_v of r = (x, y, 1), and P_u / D = (ln D)_u r + r_u
        x, y, zero = rays[:, 0], rays[:, 1], np.zeros(len(index))
        over_u = np.stack([along_u * x + 1.0 / k[0, 0], along_u * y, along_u], axis=1)
        skew = -k[0, 1] / (k[0, 0] * k[1, 1])
        over_v = np.stack([along_v * x + skew, along_v * y + 1.0 / k[1, 1], along_v + zero], axis=1)
        normal = np.cross(over_u, over_v)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300))


def integrate(along_u: Array, along_v: Array) -> Array:
    """(..., h, w) surfaces whose differences between neighbours fit slopes (..., h, w) best in the mean square; mean 0.

    Slopes are a pixel's own; between two pixels the mean of both counts.
    """
    from scipy.fft import dctn, idctn

    height, width = along_u.shape[-2:]
    between_u = 0.5 * (along_u[..., 1:] + along_u[..., :-1])
    between_v = 0.5 * (along_v[..., 1:, :] + along_v[..., :-1, :])
    # divergence: the normal equations' right side
    right = np.zeros(along_u.shape)
    right[..., :-1] += between_u
    right[..., 1:] -= between_u
    right[..., :-1, :] += between_v
    right[..., 1:, :] -= between_v
    # eigenvalues of minus the Laplacian with free borders
    eigen = (2.0 - 2.0 * np.cos(np.pi * np.arange(height) / height))[:, None]
    eigen = eigen + (2.0 - 2.0 * np.cos(np.pi * np.arange(width) / width))
    spectrum = dctn(right, type=2, norm="ortho", axes=(-2, -1))
    eigen[0, 0] = 1.0
    spectrum /= -eigen
    spectrum[..., 0, 0] = 0.0
    return np.asarray(idctn(spectrum, type=2, norm="ortho", axes=(-2, -1)))


def level(change: Array, inside: Mask) -> float:
    """What of a surface (h, w) is the untouched skin's: outside of what moved, or else its least indented part."""
    outside = ~inside
    return float(np.median(change[outside]) if outside.mean() > UNTOUCHED else np.percentile(change, 98.0))


def as_depth(change: Array, gel: Gel) -> Array:
    """(h, w) m of indentation, 0 to the gel's thickness, by how z (m) or ln D changed (h, w)."""
    if gel.distance is not None:  # of a pinhole camera it is the logarithm of the depth that was integrated
        change = (gel.distance + gel.surface) * np.expm1(np.clip(change, -1.0, 1.0))
    return np.clip(-change, 0.0, gel.thickness)
