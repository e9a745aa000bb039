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
from touch.gels.skin.colour import Mask, Moved
from touch.gels.skin.kernels import equations, face, facing, following, slopes_by_colours
from touch.gels.skin.photometry import Photometry, relative
from touch.gels.skin.surfaces import as_depth, fitted, level, slopes, slopes_of_waves, surface_of

Array = NDArray[np.float64]

# Gauss-Newton steps of each pixel's normal from the untouched one, and from one that is nearly right.
FROM_REST, FROM_NEAR = 4, 2


@dataclass(frozen=True)
class LampSettings:
    """How far lamps may be from the calibration's. Values by judgement."""

    # Standard deviation of a colour's own share in what it was calibrated as, and of another colour's share in it (no
    # unit): light-emitting diodes of one kind scatter so in brightness and in what their light mixes; brightness that
    # the background shares cancels.
    own: float = 0.15
    mixed: float = 0.25
    # Of the exposure (share): where untouched skin tells it, and where none is left.
    drift_known: float = 0.01
    drift_unknown: float = 0.02
    # Share of the image that must be untouched for that.
    untouched: float = 0.03
    # Share of the changes that no lamps explain (places of the lamps, bridging skin), and places of an image whose
    # share of that is their own: both set on simulated presses of sensors calibrated on one another, whose heights were
    # 7 % too flat when images were believed more.
    unexplained: float = 0.15
    places: float = 25.0
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


def slopes_of(
    moved: Moved, inside: Mask, gel: Gel, photometry: Photometry, settings: LampSettings | None = None
) -> NDArray[np.float32]:
    """(2, h, w) slopes of the skin along u and v less the untouched skin's (see `surfaces`), on working pixels: by
    colours where `inside` (h, w), 0 elsewhere.
    """
    settings = settings or LampSettings()
    seen = relative(moved.difference, gel, photometry.darkest)
    found = lamps_of(seen, moved.inside, gel, photometry, settings)
    by_normal, by_depth = photometry.maps(gel)
    lines, across = gel.lines
    out = np.zeros((2, inside.size), dtype=np.float32)
    slopes_by_colours(
        seen.reshape(-1, 3),
        np.linalg.inv(found.mixture),
        found.drift,
        by_normal.reshape(-1, 3, 3),
        by_depth.reshape(-1, 3),
        _finer(found.depth, gel).ravel(),
        gel.untouched_normals.reshape(-1, 3),
        lines.reshape(-1, 3),
        across,
        np.flatnonzero(inside),
        gel.width,
        settings.pull,
        settings.steepest,
        FROM_REST,
        FROM_NEAR,
        out,
    )
    return out.reshape(2, *inside.shape)


def lamps_of(seen: NDArray[np.float32], inside: Mask, gel: Gel, photometry: Photometry, settings: LampSettings) -> Lit:
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
    every, across = coarse.lines
    lines = every.reshape(-1, 3)[index]
    base = np.stack(slopes(rest, coarse, index))
    size = max(float(np.sqrt((q**2).sum(axis=1).mean())), 1e-6)
    missed = settings.unexplained * size
    weight = settings.places / within.size / missed**2
    normal, depth = rest.copy(), np.zeros(len(index))
    level_normal, model = np.zeros_like(rest), np.zeros_like(q)
    told, fields = np.zeros((2, within.size)), np.zeros((2, 10, within.size), dtype=np.float32)
    theta, information = np.zeros(10), np.diag(wide**-2.0)
    for turn in range(settings.rounds + 1):
        mixture, drift = np.eye(3) + theta[:9].reshape(3, 3), float(theta[9])
        corrected = (1.0 + q) / (1.0 + drift) - 1.0
        steps = FROM_NEAR if turn else FROM_REST
        left = corrected - depth[:, None] * (by_depth @ mixture.T)
        face(mixture, by_normal, left, rest, settings.pull, settings.steepest, steps, normal)
        told[:, index] = np.stack(slopes(normal, coarse, index)) - base
        waves = fitted(told.reshape(2, *within.shape))
        change = surface_of(waves)
        change -= level(change, within)
        depth = as_depth(change, coarse).ravel()[index].astype(np.float64)
        if turn == settings.rounds:
            break
        # colours that the surface would have; slopes follow the lamps (least squares, a pixel each), and the surface
        # follows the slopes
        facing(base + slopes_of_waves(waves).reshape(2, -1)[:, index], lines, across, level_normal)
        following(
            q, mixture, by_normal, by_depth, depth, rest, normal, level_normal, lines, across, index, model, fields
        )
        bent = slopes_of_waves(fitted(fields.reshape(2, 10, *within.shape))).reshape(2, 10, -1)
        information, gradient = np.zeros((10, 10)), np.zeros(10)
        equations(
            q,
            corrected,
            mixture,
            by_normal,
            level_normal,
            model,
            lines,
            across,
            index,
            bent,
            weight,
            missed * settings.outlier,
            information,
            gradient,
        )
        information += np.diag(wide**-2.0)
        theta = theta - np.linalg.solve(information, gradient + theta / wide**2)
        theta = np.clip(theta, -settings.farthest * wide, settings.farthest * wide)
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    out = np.zeros(within.size)
    out[index] = depth
    return Lit(np.eye(3) + theta[:9].reshape(3, 3), float(theta[9]), out.reshape(within.shape), sigma)


def _finer(coarse: Array, gel: Gel) -> NDArray[np.float32]:
    """(h, w) of working pixels from the coarse ones, which are every so many-th of them."""
    import cv2

    step = float(gel.coarse_step)
    places = np.array([[1.0 / step, 0.0, 0.0], [0.0, 1.0 / step, 0.0]])
    return np.asarray(
        cv2.warpAffine(
            coarse.astype(np.float32),
            places,
            (gel.width, gel.height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
    )
