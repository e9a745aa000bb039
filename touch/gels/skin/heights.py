"""How deep a gel is pressed in, from its colours: normals by the calibration, heights by integrating their slopes.

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
from touch.gels.skin.colour import ColourSettings, Mask, Moved, moved_skin
from touch.gels.skin.kernels import relax
from touch.gels.skin.lamps import LampSettings, slopes_of
from touch.gels.skin.photometry import photometry_of, relative
from touch.gels.skin.surfaces import UNTOUCHED, as_depth, integrate, level, slopes

Array = NDArray[np.float64]

# What is smooth between held values is found from coarse to fine: the coarsest grid's side (cells), the most sweeps of
# one grid, and the change of a cell, as a share of all, at which it is found: a hundredth of a micrometre.
COARSEST, SWEEPS, SETTLED = 6, 60, 1e-4


@dataclass(frozen=True)
class HeightSettings:
    """What indentations are worth."""

    colour: ColourSettings = field(default_factory=ColourSettings)
    lamps: LampSettings = field(default_factory=LampSettings)
    # Touched is what is deeper than this share of the deepest: flatter parts are skin that bridges to the rest.
    share: float = 0.25
    # and than this (m): below, heights are the integration's own drift.
    least: float = 0.00006
    # Error of a measured indentation: a share of it (gain of the calibration), in proportion more where it is deeper
    # than the calibration's own presses, and a floor (m). Of 137 simulated presses the RMS error is 0.9 of it, median.
    gain: float = 0.08
    floor: float = 0.00004
    # Without calibration: the usual indentation as a share of the gel's thickness, its error as a share of itself, and
    # that of an indentation whose depth another sensor knows.
    usual_share: float = 0.25
    usual_error: float = 0.6
    known_error: float = 0.2
    # The cap's slopes that its own colours may leave unexplained, as a share: beyond, the outline alone counts.
    unexplained: float = 0.8
    # How far (m) beyond what moved for sure heights are integrated: the skin's last slopes are below the noise of a
    # pixel, not of all together, and 0.04 mm were missing in every height without them. Farther, drift comes in.
    skirt: float = 0.0006
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
    wide = widened(moved.inside, work, settings.skirt)
    photometry = photometry_of(gel, where)
    fields = slopes_of(moved, wide, work, photometry, settings.lamps)
    deepest = max(photometry.depths, default=np.inf)
    return from_depth(heights(wide, fields, work, settings.cells), work, settings, moved.inside, deepest)


def from_depth(
    depth: Array, gel: Gel, settings: HeightSettings, moved: Mask | None = None, known: float = np.inf
) -> Indentation:
    """The measured indentation (h, w) m with what of it is touched; known: how deep (m) calibration has pressed."""
    deepest = float(depth.max(initial=0.0))
    threshold = max(settings.share * deepest, settings.least)
    touched = depth > threshold
    if moved is None:
        moved = depth > settings.least
    else:
        touched &= moved
    beyond = np.maximum(depth / max(known, settings.floor), 1.0)
    sigma = np.hypot(settings.gain * beyond * np.maximum(depth, 0.0), settings.floor)
    return Indentation(gel, np.maximum(depth, 0.0), touched, moved, sigma, True)


def widened(inside: Mask, gel: Gel, skirt: float) -> Mask:
    """The mask (h, w) grown by `skirt` (m) to all sides."""
    import cv2

    reach = round(skirt / gel.spacing)
    if reach < 1:
        return inside
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(inside.astype(np.uint8), disc), dtype=bool)


def heights(inside: Mask, fields: NDArray[np.float32], gel: Gel, cells: int = 48) -> Array:
    """(h, w) m by which the skin is pressed in, 0 outside of `inside` (h, w): slopes fields (2, h, w) less those of the
    untouched skin, 0 outside.
    """
    if not inside.any():
        return np.zeros((gel.height, gel.width))
    change = integrate(fields[0], fields[1])
    change -= level(change, inside)
    if (~inside).mean() > UNTOUCHED:
        # slopes that do not close leave a step at the outline, where the skin is held: taken off as smoothly as can be
        change -= harmonic(change.astype(np.float64), inside, cells).astype(change.dtype, copy=False)
    return np.where(inside, as_depth(change, gel), 0.0).astype(np.float64)


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
    q = relative(moved.difference, gel, settings.colour.darkest)[inside].astype(np.float64)
    untouched = gel.untouched_normals[inside]
    change = gel.normals(cap)[inside] - untouched
    gram = q.T @ q + 1e-3 * float((q**2).sum()) * np.eye(3)
    coefficients = np.linalg.solve(gram, q.T @ change)
    told = q @ coefficients
    left = (change - told)[:, :2]
    if not (left**2).sum() < settings.unexplained**2 * (change[:, :2] ** 2).sum():
        return None
    index, fields = np.flatnonzero(inside), np.zeros((2, inside.size), dtype=np.float32)
    tilted, level_ = slopes(untouched + told, gel, index), slopes(untouched, gel, index)
    for field_, new, old in zip(fields, tilted, level_):
        field_[index] = new - old
    depth = heights(inside, fields.reshape(2, *inside.shape), gel, settings.cells)
    return depth if depth.max() > 0 else None


def membrane(inside: Mask, cells: int = 48) -> Array:
    """(h, w), 1 at its highest: the solution of Poisson's equation with a constant right side, 0 at the outline of
    `inside` (h, w); free where it meets the image's border.
    """
    share = _shrunk(inside.astype(np.float32), cells)
    grid = share > 0.5
    if not grid.any() or grid.all():  # nothing holds what covers the whole image
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
    """(h, w) solution of minus Laplace z = load on the grid (h, w), z = held (h, w) on other cells, of which there is
    one or more, free at the border. From coarse to fine.
    """
    height, width = grid.shape
    if min(height, width) <= COARSEST:
        out = np.where(grid, held[~grid].mean(), held)
    else:
        size = (height + 1) // 2, (width + 1) // 2
        share = _area(~grid, size)
        half = share < 0.5
        if half.all():
            half[np.unravel_index(int(np.argmax(share)), size)] = False
        coarse = _relaxed(half, 4.0 * load, _area(held * ~grid, size) / np.maximum(share, 1e-6))
        out = np.where(grid, _grown(coarse, grid.shape), held)
    # the best factor of an empty rectangle (Young 1954); smaller regions settle sooner
    factor = 2.0 / (1.0 + np.sin(np.pi / (max(height, width) + 1)))
    enough = SETTLED * max(float(np.ptp(held[~grid])), load * height * width / 16.0, 1e-300)
    relax(out, grid, load, factor, SWEEPS, enough)
    return np.asarray(out)


def _area(values: Array | Mask, size: tuple[int, int]) -> Array:
    """The mean of values (h, w) in each cell of a coarser grid of size (h, w)."""
    import cv2

    return np.asarray(cv2.resize(values.astype(np.float64), size[::-1], interpolation=cv2.INTER_AREA))
