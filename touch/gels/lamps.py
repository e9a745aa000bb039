"""What one image says of its own lamps, beside the calibration: how its colours mix, and how its exposure drifted.

Two sensors of one kind differ in their lamps' brightness and colours: what the calibration knows as red is another
mixture here, q = (1 + e) (1 + (I + E) (S (n - n0) + d h)) - 1 with E (3, 3) and e one number. Three colours tell more
than a surface needs. A normal has length 1, so that colours must agree on how steep and how bright a slope is, and
slopes must be those of a surface, zero where the skin is untouched. What E leaves least of that unexplained, near
enough to 0, is this sensor's own (photometric stereo under unknown lamps: Hayakawa, JOSA A 1994; what surfaces alone
leave open: Belhumeur, Kriegman and Yuille, IJCV 1999; here the untouched skin's normals are known, too).

Gauss-Newton on a coarse image: for each E the slopes that colours tell best are integrated; their own change by E is
linear, and so is the integration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.robot.gels import Gel
from touch.gels.colour import Moved
from touch.gels.kernels import face
from touch.gels.photometry import Photometry, relative
from touch.gels.surfaces import as_depth, facing, integrate, level, slopes

Array = NDArray[np.float64]

# Gauss-Newton steps of each pixel's normal from the untouched one, and from one that is nearly right.
FROM_REST, FROM_NEAR = 4, 2


@dataclass(frozen=True)
class LampSettings:
    """How far lamps may be from the calibration's. Values by judgement."""

    # Standard deviation of a colour's own share in what it was calibrated as, and of another colour's share in it (no
    # unit): light-emitting diodes of one kind scatter so in brightness and in what their light mixes.
    own: float = 0.2
    mixed: float = 0.25
    # Of the exposure (share): where untouched skin tells it, and where none is left.
    drift_known: float = 0.01
    drift_unknown: float = 0.02
    # Share of the image that must be untouched for that.
    untouched: float = 0.03
    # Share of the changes that no lamps explain (places of the lamps, bridging skin), and places of an image whose
    # share of that is their own.
    unexplained: float = 0.15
    places: float = 40.0
    # So many times what is usually unexplained counts half.
    outlier: float = 3.0
    # Steps, and the largest of a parameter in its standard deviations.
    rounds: int = 2
    farthest: float = 2.5
    # Weight of the untouched normal in each pixel's own (in squares of relative changes by a unit of slope): where a
    # skin is black, colours tell nothing.
    pull: float = 1e-3
    # Longest part of a normal along the image (no unit): 75 degrees.
    steepest: float = 0.97


@dataclass(frozen=True)
class Lit:
    """mixture (3, 3): I + E; drift: e; depth (h, w) m of the coarse image's indentation; sigma (10,): how well E, row
    by row, and e are known.
    """

    mixture: Array
    drift: float
    depth: Array
    sigma: Array


def normals_of(moved: Moved, gel: Gel, photometry: Photometry, settings: LampSettings | None = None) -> Array:
    """(m, 3) the skin's normals where it moved, sensor frame, of the working pixels in their order."""
    import cv2

    settings = settings or LampSettings()
    seen = relative(moved.difference, gel, photometry.darkest)
    found = lamps_of(seen, moved.inside, gel, photometry, settings)
    index = np.flatnonzero(moved.inside)
    by_normal, by_depth = photometry.maps(gel)
    size = (gel.width, gel.height)
    depth = cv2.resize(found.depth.astype(np.float32), size, interpolation=cv2.INTER_LINEAR).ravel()[index]
    change = ((1.0 + seen.reshape(-1, 3)[index]) / (1.0 + found.drift) - 1.0) @ np.linalg.inv(found.mixture).T
    change -= by_depth.reshape(-1, 3)[index] * depth[:, None]
    rest = gel.untouched_normals.reshape(-1, 3)[index]
    normal = rest.copy()
    sensitivity = by_normal.reshape(-1, 3, 3)[index]
    face(sensitivity, change, rest, settings.pull, settings.steepest, FROM_REST, normal)
    return normal


def lamps_of(
    seen: NDArray[np.float32], inside: NDArray[np.bool_], gel: Gel, photometry: Photometry, settings: LampSettings
) -> Lit:
    """Of relative changes (h, w, 3) of working pixels, moved inside (h, w): the lamps that explain them best."""
    import cv2

    step, coarse = gel.coarse_step, gel.coarse
    smooth = np.asarray(cv2.blur(seen, (step, step)))[::step, ::step].astype(np.float64)
    within = np.ascontiguousarray(inside[::step, ::step])
    index = np.flatnonzero(within)
    known = bool((~within).mean() > settings.untouched)
    wide = np.full(10, settings.mixed)
    wide[[0, 4, 8]] = settings.own
    wide[9] = settings.drift_known if known else settings.drift_unknown
    lit = Lit(np.eye(3), 0.0, np.zeros(within.shape), wide)
    if len(index) < 20:
        return lit
    by_normal, by_depth = (part.reshape(-1, *part.shape[2:])[index] for part in photometry.maps(coarse))
    q = smooth.reshape(-1, 3)[index]
    rest = coarse.untouched_normals.reshape(-1, 3)[index]
    base = np.stack(slopes(coarse.untouched_normals.reshape(-1, 3)[index], coarse, index), axis=1)
    size = max(float(np.sqrt((q**2).sum(axis=1).mean())), 1e-6)
    weight = settings.places * len(index) / within.size / len(index) / (settings.unexplained * size) ** 2
    normal, depth = rest.copy(), np.zeros(len(index))
    theta, information = np.zeros(10), np.diag(wide**-2.0)
    for turn in range(settings.rounds + 1):
        mixture, drift = np.eye(3) + theta[:9].reshape(3, 3), float(theta[9])
        sensitivity, deeper = mixture @ by_normal, by_depth @ mixture.T
        corrected = (1.0 + q) / (1.0 + drift) - 1.0
        steps = FROM_NEAR if turn else FROM_REST
        face(sensitivity, corrected - deeper * depth[:, None], rest, settings.pull, settings.steepest, steps, normal)
        told = np.stack(slopes(normal, coarse, index), axis=1)
        change = _surfaces((told - base)[..., None], index, within)[0]
        change -= level(change, within)
        depth = as_depth(change, coarse).ravel()[index]
        if turn == settings.rounds:
            break
        # colours that the surface would have
        surface = base + np.stack([part.ravel()[index] for part in np.gradient(change)[::-1]], axis=1)
        level_normal = facing(surface[:, 0], surface[:, 1], coarse, index)
        model = np.einsum("pci,pi->pc", by_normal, level_normal - rest) + by_depth * depth[:, None]
        left = corrected - model @ mixture.T
        ways = np.zeros((len(index), 3, 10))
        for row in range(3):
            ways[:, row, 3 * row : 3 * row + 3] = model
        ways[:, :, 9] = 1.0 + q
        # slopes follow the lamps (least squares, a pixel each), and the surface follows the slopes
        own = _by_slope(sensitivity, normal, told, coarse, index)
        square = np.swapaxes(own, 1, 2) @ own
        square[:, [0, 1], [0, 1]] += 1e-3 * np.einsum("pii->p", square)[:, None] + 1e-12
        follow = np.asarray(-np.linalg.solve(square, np.swapaxes(own, 1, 2) @ ways), dtype=np.float64)
        fields = _surfaces(follow, index, within)
        bent = np.stack([part.reshape(10, -1)[:, index] for part in np.gradient(fields, axis=(2, 1))], axis=0)
        by_slope = _by_slope(sensitivity, level_normal, surface, coarse, index)
        jacobian = -ways - np.einsum("pcs,skp->pck", by_slope, bent)
        trust = 1.0 / (1.0 + (left**2).sum(axis=1) / (settings.unexplained * size * settings.outlier) ** 2)
        flat = jacobian.reshape(-1, 10)
        heavy = weight * (flat * np.repeat(trust, 3)[:, None]).T
        information = heavy @ flat + np.diag(wide**-2.0)
        theta = theta - np.linalg.solve(information, heavy @ left.ravel() + theta / wide**2)
        theta = np.clip(theta, -settings.farthest * wide, settings.farthest * wide)
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    out = np.zeros(within.size)
    out[index] = depth
    return Lit(np.eye(3) + theta[:9].reshape(3, 3), float(theta[9]), out.reshape(within.shape), sigma)


def _surfaces(along: Array, index: NDArray[np.int64], within: NDArray[np.bool_]) -> Array:
    """(k, h, w) surfaces by slopes (m, 2, k) at the pixels `index` (m,), 0 at others."""
    fields = np.zeros((2, along.shape[2], within.size))
    fields[:, :, index] = along.transpose(1, 2, 0)
    return integrate(*fields.reshape(2, -1, *within.shape))


def _by_slope(by_normal: Array, normal: Array, told: Array, gel: Gel, index: NDArray[np.int64]) -> Array:
    """(m, 3, 2) the colours' change by slopes, of unit normals (m, 3) with slopes told (m, 2), by_normal (m, 3, 3)."""
    small = 1e-5
    upright = np.maximum(normal[:, 2], 0.1)
    turned = np.zeros((len(normal), 2, 2))
    for axis in range(2):
        moved = normal.copy()
        moved[:, axis] += small
        moved[:, 2] -= small * normal[:, axis] / upright
        turned[:, :, axis] = (np.stack(slopes(moved, gel, index), axis=1) - told) / small
    along = by_normal[:, :, :2] - by_normal[:, :, 2:] * (normal[:, :2] / upright[:, None])[:, None]
    determinant = turned[:, 0, 0] * turned[:, 1, 1] - turned[:, 0, 1] * turned[:, 1, 0]
    determinant = np.copysign(np.maximum(np.abs(determinant), 1e-300), determinant)
    inverse = np.stack(
        [
            np.stack([turned[:, 1, 1], -turned[:, 0, 1]], axis=1),
            np.stack([-turned[:, 1, 0], turned[:, 0, 0]], axis=1),
        ],
        axis=1,
    )
    return np.asarray(along @ inverse / determinant[:, None, None])
