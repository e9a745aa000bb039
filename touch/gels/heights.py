"""How deep a gel is pressed in, from its colours: slopes by the calibration, height by Poisson's equation.

With n the skin's normal, P = D r the point on a pixel's line r at depth D: n . P_u = 0, so (ln D)_u = -(n . r_u) /
(n . r) for a pinhole camera, and z_u = -n_x / n_z times the pitch for parallel lines. The difference of these slopes
from the untouched skin's is integrated over the image: the least-squares surface solves Poisson's equation with free
borders, which the discrete cosine transform diagonalises (Frankot and Chellappa, PAMI 1988, for its Fourier sibling).

Without a calibration the outline alone speaks: a skin pressed in by an even load and held at the outline is the
solution of Poisson's equation with a constant right side there (Prandtl's membrane), which for an ellipse is exactly
the cap that a smooth convex object presses. Its depth is not in the outline and has to be known or assumed. Colours
inside follow the cap's slopes on the whole, so the cap calibrates its own image roughly; integrated by that, they show
what the cap does not: ridges, flats, the side on which the object goes on beyond the image.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.robot.gels import Gel, check_image
from touch.gels.calibration import TERMS, GelCalibrationSettings, Photometry, photometry_of, relative
from touch.gels.colour import ColourSettings, Mask, Moved, moved_skin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeightSettings:
    """What indentations are worth."""

    colour: ColourSettings = field(default_factory=ColourSettings)
    # Touched is what is deeper than this share of the deepest: flatter parts are skin that bridges to the rest.
    share: float = 0.25
    # and than this (m): below, heights are the integration's own drift.
    least: float = 0.00006
    # Error of a measured indentation: a share of it (gain of the calibration) and a floor (m).
    gain: float = 0.08
    floor: float = 0.00004
    # Without calibration: the usual indentation as a share of the gel's thickness, its error as a share of itself, and
    # that of an indentation whose depth another sensor knows.
    usual_share: float = 0.25
    usual_error: float = 0.6
    known_error: float = 0.2
    # The cap's slopes that its own colours may leave unexplained, as a share: beyond, the outline alone counts.
    unexplained: float = 0.8
    # Grid (cells along the longer side) of the membrane's equation: a cap has no finer shape.
    cells: int = 48


@dataclass(frozen=True)
class Indentation:
    """On the working pixels of `gel`: depth (h, w) m of the skin's indentation along the pixels' lines; touched (h, w):
    where the object is on the skin; moved (h, w): where the skin moved at all; sigma (h, w) m; measured: False when the
    depth is not the colours' own.
    """

    gel: Gel
    depth: Array
    touched: Mask
    moved: Mask
    sigma: Array
    measured: bool


def indentation_of(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    gel: Gel,
    where: str = "gel",
    known: tuple[int, int, float] | None = None,
    settings: HeightSettings | None = None,
) -> Indentation:
    """How deep the skin is pressed in: from micrometres (h, w) uint16, or from colours (h, w, 3) uint8.

    known: a pixel (u, v) and its indentation (m) by another sensor, for colours without a calibration. Raises
    InputError for no background, another size or a saturated image, beginning with `where`.
    """
    settings = settings or HeightSettings()
    work, step = gel.working, gel.working_step
    check_image(image, gel, where)
    if image.ndim == 2:
        return from_depth(1e-6 * image[::step, ::step].astype(np.float64), work, settings)
    moved = moved_skin(image.astype(np.uint8), gel, settings.colour)
    if gel.calibration is None:
        if known is not None:
            known = min(known[0] // step, work.width - 1), min(known[1] // step, work.height - 1), known[2]
        return from_outline(moved, work, known, settings)
    return from_depth(heights(moved, work, photometry_of(gel, where), settings.cells), work, settings, moved.inside)


def from_depth(depth: Array, gel: Gel, settings: HeightSettings, moved: Mask | None = None) -> Indentation:
    """The measured indentation (h, w) m with what of it is touched."""
    deepest = float(depth.max(initial=0.0))
    threshold = max(settings.share * deepest, settings.least)
    touched = depth > threshold
    if moved is None:
        moved = depth > settings.least
    else:
        touched &= moved
    sigma = np.hypot(settings.gain * np.maximum(depth, 0.0), settings.floor)
    return Indentation(gel, np.maximum(depth, 0.0), touched, moved, sigma, True)


def heights(moved: Moved, gel: Gel, photometry: Photometry, cells: int = 48) -> Array:
    """(h, w) m by which the skin is pressed in, from calibrated colours, on working pixels; 0 outside of what moved."""
    if not moved.inside.any():
        return np.zeros((gel.height, gel.width))
    normal = photometry.normals(moved.difference, gel)
    along_u, along_v = (new - old for new, old in zip(slopes(normal, gel), slopes(gel.untouched_normals, gel)))
    outside = ~moved.inside
    along_u[outside] = 0.0
    along_v[outside] = 0.0
    change = integrate(along_u, along_v)
    # what did not move is level with itself; a contact that fills the image leaves its lowest part
    if outside.mean() > 0.01:
        change -= np.median(change[outside])
        # slopes that do not close leave a step at the outline, where the skin is held: taken off as smoothly as can be
        change -= harmonic(change, moved.inside, cells)
    else:
        change -= np.percentile(change, 98.0)
    # of a pinhole camera it is the logarithm of the depth that was integrated
    pinhole = gel.distance is not None
    depth = -(float(gel.distance or 0.0) + gel.surface) * np.expm1(np.clip(change, -1.0, 1.0)) if pinhole else -change
    depth[outside] = 0.0
    return np.clip(depth, 0.0, gel.thickness)


def slopes(normal: Array, gel: Gel) -> tuple[Array, Array]:
    """(h, w) each: what integrates along u and v to z (m; parallel lines) or ln D (pinhole), by normals (h, w, 3)."""
    if gel.matrix is None:
        assert gel.pitch is not None
        z = np.maximum(normal[..., 2], 0.1)  # a skin steeper than 84 degrees is a wrong colour
        return -gel.pitch * normal[..., 0] / z, -gel.pitch * normal[..., 1] / z
    k, rays = gel.matrix, gel.rays
    facing = normal[..., 0] * rays[..., 0] + normal[..., 1] * rays[..., 1] + normal[..., 2]
    facing = np.maximum(facing, 0.1)
    along_u = normal[..., 0] / k[0, 0]
    along_v = (normal[..., 1] - normal[..., 0] * k[0, 1] / k[0, 0]) / k[1, 1]
    return -along_u / facing, -along_v / facing


def integrate(along_u: Array, along_v: Array) -> Array:
    """(h, w) surface whose differences between neighbours fit slopes (h, w) best in the mean square; mean 0.

    Slopes are a pixel's own; between two pixels the mean of both counts.
    """
    from scipy.fft import dctn, idctn

    height, width = along_u.shape
    between_u = 0.5 * (along_u[:, 1:] + along_u[:, :-1])
    between_v = 0.5 * (along_v[1:] + along_v[:-1])
    # divergence: the normal equations' right side
    right = np.zeros((height, width))
    right[:, :-1] += between_u
    right[:, 1:] -= between_u
    right[:-1] += between_v
    right[1:] -= between_v
    # eigenvalues of minus the Laplacian with free borders
    eigen = (2.0 - 2.0 * np.cos(np.pi * np.arange(height) / height))[:, None]
    eigen = eigen + (2.0 - 2.0 * np.cos(np.pi * np.arange(width) / width))
    spectrum = dctn(right, type=2, norm="ortho")
    eigen[0, 0] = 1.0
    spectrum /= -eigen
    spectrum[0, 0] = 0.0
    return np.asarray(idctn(spectrum, type=2, norm="ortho"))


def from_outline(moved: Moved, gel: Gel, known: tuple[int, int, float] | None, settings: HeightSettings) -> Indentation:
    """The membrane's cap in the outline, as deep as is known of one pixel or usual."""
    shape = membrane(moved.inside, settings.cells)
    peak, error = _peak(shape, gel, known, settings)
    coloured = _own_colours(moved, gel, peak * shape, settings)
    if coloured is not None:
        shape = coloured / max(float(coloured.max()), 1e-300)
        peak, error = _peak(shape, gel, known, settings)
    depth = np.minimum(peak * shape, gel.thickness)
    # the outline itself is sure; in the middle the depth is what is not known
    slope = 2.0 * peak / max(np.sqrt(moved.inside.sum() / np.pi), 1.0)  # of a cap at its edge, metres a pixel
    sigma = np.hypot(error * depth, slope * moved.edge)
    return Indentation(gel, depth, moved.inside.copy(), moved.inside, np.maximum(sigma, settings.floor), False)


def _peak(
    shape: Array, gel: Gel, known: tuple[int, int, float] | None, settings: HeightSettings
) -> tuple[float, float]:
    """The deepest indentation (m) of a shape (h, w; 1 at its deepest) and its relative error: known or usual."""
    if known is not None and known[2] > settings.least:
        at = float(shape[known[1], known[0]])
        if at > 0.1:  # a pixel at the very outline says little of the depth
            return min(known[2] / at, gel.thickness), settings.known_error
    return settings.usual_share * gel.thickness, settings.usual_error


def _own_colours(moved: Moved, gel: Gel, cap: Array, settings: HeightSettings) -> Array | None:
    """Indentation (h, w) m by the colours, calibrated on the cap's own slopes; None where they do not follow it."""
    inside = moved.inside
    if inside.sum() < 100:
        return None
    darkest = GelCalibrationSettings().darkest
    q = relative(moved.difference, gel, darkest)[inside].astype(np.float64)
    change = (gel.normals(cap) - gel.untouched_normals)[inside]
    gram = q.T @ q + 1e-3 * float((q**2).sum()) * np.eye(3)
    coefficients = np.zeros((3, 3 * TERMS))
    coefficients[:, :3] = np.linalg.solve(gram, q.T @ change).T
    left = change[:, :2] - q @ coefficients[:2, :3].T
    if not (left**2).sum() < settings.unexplained**2 * (change[:, :2] ** 2).sum():
        return None
    depth = heights(moved, gel, Photometry(coefficients, (gel.width, gel.height), darkest), settings.cells)
    return depth if depth.max() > 0 else None


def membrane(inside: Mask, cells: int = 48) -> Array:
    """(h, w), 1 at its highest: the solution of Poisson's equation with a constant right side, 0 at the outline of
    `inside` (h, w); free where it meets the image's border.
    """
    share = _shrunk(inside.astype(np.float32), cells)
    grid = share > 0.5
    if not grid.any():
        return inside.astype(np.float64)
    coarse = _relaxed(grid, 1.0, np.zeros(grid.shape))
    fine = _grown(coarse / max(float(coarse.max()), 1e-300), inside.shape)
    fine[~inside] = 0.0
    return fine / max(float(fine.max()), 1e-300)


def harmonic(values: Array, inside: Mask, cells: int = 48) -> Array:
    """(h, w), on a coarse grid: as smooth inside as can be between what values (h, w) are outside; free at the image's
    border.
    """
    outside = (~inside).astype(np.float32)
    share = _shrunk(outside, cells)
    held = _shrunk(values.astype(np.float32) * outside, cells) / np.maximum(share, 1e-6)
    grid = share < 0.5
    if not grid.any() or grid.all():
        return np.zeros_like(values)
    return _grown(np.where(grid, _relaxed(grid, 0.0, held), held), inside.shape)


def _shrunk(values: NDArray[np.float32], cells: int) -> Array:
    """The mean of values (h, w) in each of `cells` cells along the longer side."""
    import cv2

    height, width = values.shape
    step = max(1.0, max(height, width) / cells)
    size = (max(2, round(width / step)), max(2, round(height / step)))
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), dtype=np.float64)


def _grown(coarse: Array, shape: tuple[int, ...]) -> Array:
    import cv2

    fine = cv2.resize(coarse.astype(np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine, dtype=np.float64)


def _relaxed(grid: Mask, load: float, held: Array) -> Array:
    """(h, w) solution of minus Laplace z = load on the grid (h, w), z = held (h, w) on other cells, free at the border;
    0 off the grid.
    """
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import spsolve

    number = np.full(grid.shape, -1)
    count = int(grid.sum())
    number[grid] = np.arange(count)
    diagonal, right = np.zeros(count), np.full(count, load)
    rows, columns = [], []
    for axis in (0, 1):
        one = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        two = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        for own, other in ((one, two), (two, one)):
            here, there = number[own].ravel(), number[other].ravel()
            on = here >= 0
            np.add.at(diagonal, here[on], 1.0)
            both, rim = on & (there >= 0), on & (there < 0)
            np.add.at(right, here[rim], held[other].ravel()[rim])
            rows.append(here[both])
            columns.append(there[both])
    # a piece that nothing holds (the whole image) must not be singular
    r, c = np.concatenate(rows), np.concatenate(columns)
    matrix = coo_matrix((-np.ones(len(r)), (r, c)), shape=(count, count)) + diags(diagonal + 1e-6)
    out = np.zeros(grid.shape)
    out[grid] = spsolve(matrix.tocsc(), right)
    return out
