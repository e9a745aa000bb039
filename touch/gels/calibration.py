"""Photometric calibration of a gel: which colours mean which slope, from presses of a ball of known radius.

A matt skin under lights shows I_c = r_c (a_c + b_c . n): its colours are linear in its normal, and the relative
difference q_c = I_c / I0_c - 1 from the untouched skin does not know the reflectance r_c, nor the brightness of a lamp.
So the normal's change n - n0 is linear in q, with coefficients that vary slowly over the image, as lamps are near:
n - n0 = sum_k A_k f_k(u, v) q, f of second order. A ball's outline on the skin tells where its centre is, its radius
then every normal inside: a small ridge regression gives A.

The radius itself is not in the colours: a ball twice as large with half the slopes explains them as well (the normal's
x and y are linear in 1 / radius, and so is what the lamps' unknown brightness multiplies). Too small a radius shows in
slopes that no skin follows; one that is too large only beside another sensor's calibration (`alike`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.robot.gels import Gel, check_image
from touch.gels.colour import ColourSettings, Moved, moved_skin

Array = NDArray[np.float64]

FORMAT = "palpate-gel-calibration"
VERSION = 1
# Terms of the polynomial over the image (see _terms), and channels.
TERMS = 6


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
    # Ridge on the coefficients of normalised features, as a share of the samples: what the presses do not show stays 0.
    ridge: float = 2e-3
    # Background darker than this (of 255; no unit) has no relative difference: counts as that bright.
    darkest: float = 12.0
    # Slopes of the presses, in the mean square, that the fit may leave (no unit): beyond, radius or lights are wrong.
    misfit: float = 0.35
    # Pixels taken of each press, and of the untouched skin around it.
    samples: int = 3000


@dataclass(frozen=True)
class Photometry:
    """coefficients (3, TERMS * 3): the change of the normal's x, y and z by features; size (width, height) of the
    images; darkest (counts) as in the settings; ball (m), presses and misfit (share of the slopes that is left);
    depths (m) of the presses, if the ball has that radius.
    """

    coefficients: Array
    size: tuple[int, int]
    darkest: float
    ball: float = 0.0
    presses: int = 0
    misfit: float = 0.0
    depths: tuple[float, ...] = ()

    def normals(self, difference: NDArray[np.float32], gel: Gel) -> Array:
        """(h, w, 3) normals of the skin, sensor frame, of unit length up to the calibration's error; working pixels."""
        q = relative(difference, gel, self.darkest)
        out = gel.untouched_normals.copy()
        for channel, table in enumerate(self._tables(gel)):
            out += table * q[..., channel, None]
        return out

    def _tables(self, gel: Gel) -> list[Array]:
        """For each channel (h, w, 3): the change of the normal by a relative difference of 1; kept for the last gel."""
        kept = self.__dict__.get("_kept")
        if kept is None or kept[0] is not gel:
            terms = np.stack(_terms(gel.width, gel.height), axis=2)
            by_term = self.coefficients.reshape(3, TERMS, 3)
            kept = gel, [terms @ by_term[:, :, channel].T for channel in range(3)]
            self.__dict__["_kept"] = kept
        return kept[1]

    def to_json(self) -> dict[str, Any]:
        """The calibration file's content."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "size": list(self.size),
            "darkest": self.darkest,
            "coefficients": self.coefficients.tolist(),
            "ball_mm": 1e3 * self.ball,
            "presses": self.presses,
            "misfit": self.misfit,
            "depths_mm": [1e3 * depth for depth in self.depths],
        }

    @staticmethod
    def from_json(entry: Mapping[str, Any], where: str) -> Photometry:
        """Raises InputError for another format, shape or numbers that are not finite."""
        if entry.get("format") != FORMAT or entry.get("version") != VERSION:
            raise InputError(f"{where}: expected a gel's calibration ({FORMAT} {VERSION}), got {entry.get('format')!r}")
        try:
            coefficients = np.array(entry["coefficients"], dtype=np.float64)
            depths = tuple(1e-3 * float(x) for x in entry.get("depths_mm", ()))
            width, height = (int(x) for x in entry["size"])
            values = [float(entry.get(name, 0.0)) for name in ("darkest", "ball_mm", "presses", "misfit")]
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{where}: expected coefficients, size and darkest in the calibration") from error
        if coefficients.shape != (3, 3 * TERMS) or not np.isfinite(coefficients).all() or not np.isfinite(values).all():
            raise InputError(f"{where}: expected finite coefficients (3, {3 * TERMS}), got {coefficients.shape}")
        if not np.isfinite(depths).all():
            raise InputError(f"{where}: expected finite depths_mm, got {depths}")
        if values[0] <= 0:
            raise InputError(f"{where}: expected darkest above 0 counts, got {values[0]:g}")
        ball, presses, misfit = 1e-3 * values[1], int(values[2]), values[3]
        return Photometry(coefficients, (width, height), values[0], ball, presses, misfit, depths)


_KEPT: WeakKeyDictionary[Gel, Photometry] = WeakKeyDictionary()


def photometry_of(gel: Gel, where: str) -> Photometry:
    """The gel's calibration, read once. Raises InputError for one that is malformed or of another size."""
    assert gel.calibration is not None
    found = _KEPT.get(gel)
    if found is None:
        found = Photometry.from_json(gel.calibration, where)
        if found.size != (gel.width, gel.height):
            got = f"{found.size[0]}x{found.size[1]}"
            raise InputError(f"{where}: expected a calibration of {gel.width}x{gel.height} pixels, got one of {got}")
        _KEPT[gel] = found
    return found


def read_photometry(path: Path) -> Photometry:
    """A calibration file. Raises InputError, one line, for what is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a gel's calibration, it cannot be read as JSON") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a gel's calibration, got {type(content).__name__}")
    return Photometry.from_json(content, str(path))


def relative(difference: NDArray[np.float32], gel: Gel, darkest: float) -> NDArray[np.float32]:
    """(h, w, 3) differences of colours as shares of the background's; working pixels."""
    return np.asarray(difference / np.maximum(gel.level, np.float32(darkest)))


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
    terms = _terms(work.width, work.height)
    features, targets, depths, ratios = [], [], [], []
    for number, image in enumerate(images):
        where = names[number] if names is not None else f"press {number}"
        check_image(image, gel, where)
        moved = moved_skin(image, gel, settings.colour)
        inside, change, depth = ball_normals(moved, work, radius, where, settings)
        depths.append(depth)
        if like is not None:
            ratios.append(_ratio(like.normals(moved.difference, work) - work.untouched_normals, change, inside))
        q = relative(moved.difference, work, settings.darkest)
        for chosen in (inside, ~moved.inside):
            index = np.flatnonzero(chosen)
            index = index[:: max(1, len(index) // settings.samples)]
            one = q.reshape(-1, 3)[index]
            features.append(np.concatenate([term.reshape(-1)[index, None] * one for term in terms], axis=1))
            targets.append(change.reshape(-1, 3)[index])
    if like is not None:
        _check_like(ratios, radius, settings)
    x, y = np.concatenate(features), np.concatenate(targets)
    scale = np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-9)
    normalised = x / scale
    gram = normalised.T @ normalised + settings.ridge * len(x) * np.eye(x.shape[1])
    coefficients = (np.linalg.solve(gram, normalised.T @ y) / scale[:, None]).T
    slope = np.linalg.norm(y[:, :2], axis=1) > 0.02
    left = (x @ coefficients.T - y)[slope, :2]
    misfit = float(np.sqrt((left**2).sum() / max((y[slope, :2] ** 2).sum(), 1e-300)))
    if not misfit < settings.misfit:
        said = f"left {100 * misfit:.0f} % of the ball's slopes unexplained"
        raise InputError(f"calibration: expected colours that tell the slopes of a {1e3 * radius:g} mm ball, {said}")
    size = gel.width, gel.height
    return Photometry(coefficients, size, settings.darkest, radius, len(images), misfit, tuple(depths))


def _ratio(expected: Array, change: Array, inside: NDArray[np.bool_]) -> float:
    """How many times as steep `expected` is as `change` (h, w, 3) inside (h, w)."""
    one, other = expected[inside, :2], change[inside, :2]
    return float((one * other).sum() / max((other**2).sum(), 1e-300))


def _check_like(ratios: list[float], radius: float, settings: GelCalibrationSettings) -> None:
    """Raise InputError when another sensor's calibration sees a ball of another radius."""
    ratio = float(np.median(ratios))
    if not 1.0 / settings.alike < ratio < settings.alike:
        said = f"got ones of {1e3 * radius / ratio:.2g} mm" if ratio > 0.01 else "got ones of nothing round"
        by = "by the calibration to compare with"
        raise InputError(
            f"calibration: expected presses of a {1e3 * radius:g} mm ball, {said} {by}: is the radius right?"
        )


def ball_normals(
    moved: Moved, gel: Gel, radius: float, where: str, settings: GelCalibrationSettings
) -> tuple[NDArray[np.bool_], Array, float]:
    """Where (h, w) the skin lies on the ball, by how much (h, w, 3) its normal differs there from the untouched, and
    how deep (m) the ball is pressed in beyond its outline.

    The outline's points on the skin lie on a circle, over whose middle the ball's centre is.
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
    change = np.linalg.norm(moved.difference, axis=2)[moved.core]
    profile = np.bincount(ring, change) / np.maximum(np.bincount(ring), 1)
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
    return met, np.where(met[..., None], normal - gel.untouched_normals, 0.0), depth


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


def _terms(width: int, height: int) -> list[Array]:
    """(h, w) each: 1, u, v, u^2, uv, v^2 with u and v from -1 to 1 over the image."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height))
    return [np.ones_like(u), u, v, u * u, u * v, v * v]
