"""Photometric calibration of a gel (touch.gels.skin.photometry): what its colours are worth, from presses of a ball.

A ball's outline on the skin tells where its centre is, its radius then every normal and every depth inside. Colours by
normals and depths, not the other way round, are a small ridge regression: the geometry is exact, colours have noise.

The radius itself is hardly in the colours: a ball twice as large with half the slopes explains them as well, its lamps
being twice as strong, which nobody knows. Too small a radius shows in slopes that no skin follows. Of one that is too
large the brightness tells: a slope s takes off about s^2 / 2 of what shines straight onto the skin, so that with slopes
told too small by a factor f the lamps' share of the light at rest is told too large by f^2; above 1, darkness itself
would have to be less than dark (`largest_ball`). Between, only another sensor's calibration knows (`like`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.robot.gels import Gel, check_image
from touch.gels.skin.colour import ColourSettings, Moved, moved_skin
from touch.gels.skin.photometry import DEPTH_TERMS, MILLIMETRES, TERMS, Photometry, image_terms, relative

Array = NDArray[np.float64]

# A share of the lamps (no unit) above which a radius is doubted aloud. Where they have 0.7 of the light the right
# radius makes 0.66 to 0.79 of it (18 simulated sensors, balls of 3, 4 and 6 mm), one a quarter too large 0.99 to 1.17.
DOUBTED = 0.9


@dataclass(frozen=True)
class GelCalibrationSettings:
    """How presses of a ball are read. Values by judgement."""

    colour: ColourSettings = field(default_factory=ColourSettings)
    # Share of the contact's radius inside which the skin surely lies on the ball.
    inner: float = 0.8
    # Outlines may miss the ball's circle by this share of its radius: rougher ones are no ball, or of another radius.
    roughness: float = 0.2
    # Least depth (m) of a press by its outline: shallower ones hardly change a colour, so the radius must be wrong.
    shallowest: float = 0.00005
    # Steepest skin (no unit, the sine of its slope: 58 degrees) that still lies on a ball: beyond, it bridges, and the
    # radius must be larger.
    steepest: float = 0.85
    # Factor by which slopes may differ from those by a calibration of another such sensor: lamps, skins and presses of
    # one kind of sensor differ by a tenth or two, a diameter taken for a radius by two.
    alike: float = 1.4
    # Ridge on the coefficients of normalised features, as a share of the samples: what the presses hardly show stays
    # near 0. Less follows their errors: by 1e-4 and 0.02 on eight simulated sensors, heights of other sensors were 5
    # and 3 % too flat (median), of the same shape.
    ridge: float = 0.01
    # Changes of colour, in the mean square, that the fit may leave (no unit): beyond, radius or lights are wrong.
    misfit: float = 0.35
    # Largest share of the light at rest that lamps may have, mean over the image and colours (no unit): more than 1 is
    # impossible, and what presses leave open is a tenth or two.
    brightest: float = 1.3
    # Pixels taken of each press.
    samples: int = 1500


@dataclass(frozen=True)
class Lying:
    """Where a skin lies on a ball, inside (h, w): by how much its normal differs from the untouched, change (h, w, 3),
    and how deep it is pressed in, depth (h, w) m; deepest (m): how far the ball reaches beyond its outline.
    """

    inside: NDArray[np.bool_]
    change: Array
    depth: Array
    deepest: float


def calibrate(
    images: Sequence[NDArray[np.uint8]],
    gel: Gel,
    radius: float,
    names: Sequence[str] | None = None,
    like: Photometry | None = None,
    settings: GelCalibrationSettings | None = None,
) -> Photometry:
    """From presses (h, w, 3) uint8 of a ball of `radius` (m) on a gel with its background.

    like: a calibration of another such sensor, whose slopes these have to resemble: it knows a wrong radius. Raises
    InputError, one line with the image's name: no background, another size, a saturated image, nothing pressed, an
    outline that is no circle of such a ball; when slopes do not follow from colours, or are not like those of `like`.
    """
    settings = settings or GelCalibrationSettings()
    if not images:
        raise InputError("calibration: expected images of presses, got none")
    if not (np.isfinite(radius) and 1e-4 <= radius <= 0.1):
        raise InputError(f"ball: expected a radius from 0.1 to 100 mm, got {1e3 * radius:g} mm")
    if like is not None and like.size != (gel.width, gel.height):
        got = f"{like.size[0]}x{like.size[1]}"
        want = f"{gel.width}x{gel.height} pixels"
        raise InputError(f"calibration: expected one of {want} to compare with, got one of {got}")
    work = gel.working
    terms = image_terms(work.width, work.height).reshape(-1, TERMS)
    features, colours, rests, depths, ratios = [], [], [], [], []
    for number, image in enumerate(images):
        where = names[number] if names is not None else f"press {number}"
        check_image(image, gel, where)
        moved = moved_skin(image, gel, settings.colour)
        ball = ball_normals(moved, work, radius, where, settings)
        depths.append(ball.deepest)
        seen = relative(moved.difference, work, settings.colour.darkest).astype(np.float64)
        if like is not None:
            ratios.append(_ratio(like, work, seen, ball))
        index = np.flatnonzero(ball.inside)
        index = index[:: max(1, len(index) // settings.samples)]
        change, deep = ball.change.reshape(-1, 3)[index], MILLIMETRES * ball.depth.reshape(-1)[index]
        columns = [change[:, axis, None] * terms[index] for axis in range(3)]
        features.append(np.concatenate([*columns, deep[:, None] * terms[index, :DEPTH_TERMS]], axis=1))
        colours.append(seen.reshape(-1, 3)[index])
        rest = work.untouched_normals.reshape(-1, 3)[index]
        rests.append(np.concatenate([rest[:, axis, None] * terms[index] for axis in range(3)], axis=1))
    if like is not None:
        _check_like(ratios, radius, settings)
    x, y = np.concatenate(features), np.concatenate(colours)
    scale = np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-9)
    normalised = x / scale
    gram = normalised.T @ normalised + settings.ridge * len(x) * np.eye(x.shape[1])
    coefficients = (np.linalg.solve(gram, normalised.T @ y) / scale[:, None]).T
    left = x @ coefficients.T - y
    misfit = float(np.sqrt((left**2).sum() / max((y**2).sum(), 1e-300)))
    if not misfit < settings.misfit:
        said = f"left {100 * misfit:.0f} % of what the colours of a {1e3 * radius:g} mm ball change by unexplained"
        raise InputError(f"calibration: expected colours that follow from slopes, {said}")
    light = _light(np.concatenate(rests) @ coefficients[:, : 3 * TERMS].T, radius, settings)
    by_normal, by_depth = coefficients[:, : 3 * TERMS].reshape(3, 3, TERMS), coefficients[:, 3 * TERMS :]
    size = gel.width, gel.height
    darkest = settings.colour.darkest
    return Photometry(by_normal, by_depth, size, darkest, radius, len(images), misfit, tuple(depths), 1, light)


def _ratio(like: Photometry, gel: Gel, seen: Array, ball: Lying) -> float:
    """How many times as much colours (h, w, 3) change as they would by `like` on the ball."""
    by_normal, by_depth = like.maps(gel)
    index = ball.inside
    expected = np.einsum("pci,pi->pc", by_normal[index], ball.change[index]) + by_depth[index] * ball.depth[index, None]
    return float((expected * seen[index]).sum() / max((expected**2).sum(), 1e-300))


def _check_like(ratios: list[float], radius: float, settings: GelCalibrationSettings) -> None:
    """Raise InputError when another sensor's calibration sees a ball of another radius."""
    ratio = float(np.median(ratios))
    if not 1.0 / settings.alike < ratio < settings.alike:
        said = f"got ones of {1e3 * radius / ratio:.2g} mm" if ratio > 0.01 else "got ones of nothing round"
        by = "by the calibration to compare with"
        raise InputError(
            f"calibration: expected presses of a {1e3 * radius:g} mm ball, {said} {by}: is the radius right?"
        )


def _light(direct: Array, radius: float, settings: GelCalibrationSettings) -> float:
    """The lamps' share of the light on untouched skin, direct (n, 3). Raises InputError when it is more than all."""
    share = float(direct.mean())
    if share > settings.brightest:
        said = f"their slopes would take away {share:.2g} times the light that there is"
        most = f"expected a ball of {1e3 * radius / np.sqrt(share):.2g} mm or less"
        raise InputError(f"calibration: {most} by the presses' brightness, got {1e3 * radius:g} mm: {said}")
    return max(share, 0.0)


def largest_ball(found: Photometry) -> float:
    """The radius (m) with which the lamps would have all the light on the skin: no ball is larger, by its brightness.

    In simulation it comes out right to 2 % (standard deviation) in a finger that no other light reaches, and where
    lamps have 0.7 of the light, 1.16 times too large. Infinite where nothing is known.
    """
    return found.ball / np.sqrt(found.light) if found.light > 1e-9 else float("inf")


def ball_normals(moved: Moved, gel: Gel, radius: float, where: str, settings: GelCalibrationSettings) -> Lying:
    """Where the skin lies on the ball, and how. The outline's points on the skin lie on a circle, over whose middle the
    ball's centre is.
    """
    import cv2

    outlines, _ = cv2.findContours(moved.core.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        raise InputError(f"{where}: expected a press of the ball, got an image like the background")
    outline = max(outlines, key=cv2.contourArea)[:, 0]
    margin = 2
    free = ((outline > margin) & (outline < np.array([gel.width, gel.height]) - 1 - margin)).all(axis=1)
    if free.sum() < 12 or free.mean() < 0.5:
        raise InputError(f"{where}: expected the ball's whole outline in the image, got it cut off by the border")
    skin = gel.points()
    edge = skin[outline[free, 1], outline[free, 0]]
    foot_of, axis, outline_radius, rough = _circle_of(edge)
    # colours change the most just before the skin leaves the ball: beyond, it bridges back, and they fall to nothing
    away = skin - foot_of
    from_axis = np.sqrt(np.maximum((away**2).sum(axis=2) - (away @ axis) ** 2, 0.0))
    ring = np.minimum(from_axis / gel.spacing, 1e4).astype(np.int64)[moved.core]
    changed = np.linalg.norm(moved.difference, axis=2)[moved.core]
    profile = np.bincount(ring, changed) / np.maximum(np.bincount(ring), 1)
    profile[int(outline_radius / gel.spacing) + 1 :] = 0.0
    across = _fall(profile) * gel.spacing
    if not across < radius:
        said = f"{2e3 * across:.3g} mm across"
        raise InputError(f"{where}: expected the outline of a ball of {2e3 * radius:.3g} mm or less, got one {said}")
    if across > settings.steepest * radius:
        said = f"an outline {2e3 * across:.3g} mm across would be steeper than skin can be"
        least = 1e3 * across / settings.steepest
        raise InputError(f"{where}: expected a ball of {least:.2g} mm radius or more, got {1e3 * radius:g} mm: {said}")
    centre = foot_of + np.sqrt(radius**2 - across**2) * axis
    depth = radius - float(np.sqrt(radius**2 - across**2))
    if not settings.shallowest <= depth <= gel.thickness:
        limits = f"{1e3 * settings.shallowest:g} to {1e3 * gel.thickness:g} mm deep"
        said = f"an outline {2e3 * across:.3g} mm across would be {1e3 * depth:.2g} mm: is the radius right?"
        raise InputError(f"{where}: expected a {1e3 * radius:g} mm ball pressed {limits}, {said}")
    if rough > settings.roughness:
        said = f"it is off by {100 * rough:.0f} % of its radius"
        raise InputError(f"{where}: expected the round outline of a {1e3 * radius:g} mm ball, {said}")
    # where the pixels' lines meet the ball
    rays = gel.rays
    if gel.distance is None:
        foot, direction = np.concatenate([rays, np.zeros((*rays.shape[:2], 1))], axis=2), np.array([0.0, 0.0, 1.0])
    else:
        foot = np.array([0.0, 0.0, -gel.distance])
        direction = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2)
    square = (direction**2).sum(axis=-1)
    along = ((centre - foot) * direction).sum(axis=-1) / square
    aside = ((foot + along[..., None] * direction - centre) ** 2).sum(axis=-1)
    reach = np.sqrt(np.maximum(radius**2 - aside, 0.0) / square)
    place = foot + (along - reach)[..., None] * direction
    normal = (centre - place) / radius  # the skin's normal looks into the ball
    met = (aside < radius**2) & (from_axis < settings.inner * across) & moved.core
    if met.sum() < 30:
        raise InputError(f"{where}: expected a press of at least 30 pixels, got {int(met.sum())}")
    change = np.where(met[..., None], normal - gel.untouched_normals, 0.0)
    return Lying(met, change, np.where(met, gel.surface - place[..., 2], 0.0), depth)


def _fall(profile: Array) -> float:
    """Where (in rings) a profile (n,) by rings, from the middle outwards, has fallen to half its highest value."""
    top = int(np.argmax(profile))
    half = 0.5 * float(profile[top])
    below = np.flatnonzero(profile[top:] < half)
    after = top + int(below[0]) if len(below) else len(profile)
    if after == len(profile) or after == 0:
        return after - 0.5
    high, low = float(profile[after - 1]), float(profile[after])
    return after - 0.5 + (high - half) / max(high - low, 1e-300)  # a ring's value is that of its middle


def _circle_of(edge: Array) -> tuple[Array, Array, float, float]:
    """Of points (n, 3) on a circle: its middle (3,), its unit axis (3,) out of the finger, its radius (m), and the mean
    deviation from it as a share of that.
    """
    middle = edge.mean(axis=0)
    basis = np.linalg.svd(edge - middle, full_matrices=False)[2]
    axis = basis[2] if basis[2, 2] >= 0 else -basis[2]
    # in its plane: algebraic least squares (Kasa 1976)
    local = (edge - middle) @ basis[:2].T
    design = np.concatenate([2.0 * local, np.ones((len(local), 1))], axis=1)
    a, b, c = np.linalg.lstsq(design, (local**2).sum(axis=1), rcond=None)[0]
    across = float(np.sqrt(max(c + a * a + b * b, 1e-18)))
    rough = float(np.abs(np.linalg.norm(local - np.array([a, b]), axis=1) - across).mean()) / across
    return middle + a * basis[0] + b * basis[1], axis, across, rough
