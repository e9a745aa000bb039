"""What the joint solution leaves open, by what must be seen: the last word of the predicted picture.

The joint solution is of rows: pixels inside an outline that like to be on the surface. Along a flat side of a large
box they like it everywhere, and a pose slides by centimetres until the outline is where nothing is, which no row minds
much and the picture does. So poses drawn from the solution's own covariance are weighed by it (importance sampling):
their mean is the answer where nobody knows what hides the object, and directions in which the surface may be
millimetres off are as wide as the picture leaves them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.words import counted
from vision.picture.predictor import Predictor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PictureMeanSettings:
    """How the picture has the last word. Tuned on 288 frames of the tuning families by vision with a start, hand and
    mask kept back: 252 right before, 256 after, 257 without `least`; and on 288 others, 253 before and after.
    """

    # Poses drawn, and the share of the picture's nats that counts: pixels share errors, as for modes.
    draws: int = 200
    temper: float = 0.5
    # Nats by which the mean's picture must be likelier, by so many rays along each side: aspects, which weigh the
    # draws, are off by 3 to 4.
    least: float = 3.0
    side: int = 32
    # Standard deviation (m, of the surface) from which a direction is open; draws along those, and rounds of them, each
    # about what the last found; share of the draws that must count for that to be enough, and how many (no unit) for
    # anything to be believed. Tuned on 992 answers with a start to twelve tuning families (of 3, 5, 6 and 8 mm).
    open_from: float = 0.006
    open_draws: int = 96
    open_rounds: int = 2
    open_enough: float = 0.3
    open_fewest: float = 6.0
    # Share of the picture's nats that counts there, and of a direction's variance that stays whatever it says: with
    # half of the nats and 0.02 left, regions of `crude`, whose camera is the worst, hold 82 % instead of 85.
    open_temper: float = 0.25
    open_left: float = 0.05


def left_open(model: ObjectModel, mode: Mode, settings: PictureMeanSettings | None = None) -> Array:
    """(6, k) directions, as long as a standard deviation, in which the mode leaves the surface open by `open_from` or
    more: about the centroid, rad and m. A turn about the object's own axis moves nothing.
    """
    s = settings or PictureMeanSettings()
    known = model.symmetries.quotient(mode.pose[:3, :3], model.centroid)
    unit = np.repeat([1.0 / max(model.radius, 1e-9), 1.0], 3)
    told = known @ mode.covariance @ known.T / unit / unit[:, None]
    values, vectors = np.linalg.eigh(0.5 * (told + told.T))
    wide = values > s.open_from**2
    return np.asarray(unit[:, None] * vectors[:, wide] * np.sqrt(values[wide]))


def why_not_asked(
    model: ObjectModel, mode: Mode, predictor: Predictor, settings: PictureMeanSettings | None = None
) -> str:
    """Why the picture is not asked; "" where it is. Where it is known what hides the object, its pixels say as much of
    what they do not leave open.
    """
    if not predictor.sees:
        return "nothing is seen"
    if predictor.told_apart and not left_open(model, mode, settings).shape[1]:
        return "no direction is open"
    return ""


def asked_picture(
    model: ObjectModel,
    mode: Mode,
    seen_from: Array,
    predictor: Predictor,
    seed: int,
    settings: PictureMeanSettings | None = None,
) -> tuple[Mode, str]:
    """The mode as the picture has it, and what that changed, in words. seen_from (4, 4): takes a pose to where the
    uncorrected depth image shows the object.
    """
    words = []
    if not predictor.told_apart:
        mode, gained = with_picture(model, mode, seen_from, predictor, seed, settings)
        words.append(f"likelier by {gained:.1f} nats" if gained else "nothing near is likelier")
    mode, count, left = narrowed(model, mode, seen_from, predictor, seed, settings)
    if count:
        words.append(f"{counted(count, 'open direction')}, {left:.0%} left")
    return mode, ", ".join(words)


def narrowed(
    model: ObjectModel,
    mode: Mode,
    seen_from: Array,
    predictor: Predictor,
    seed: int,
    settings: PictureMeanSettings | None = None,
) -> tuple[Mode, int, float]:
    """The mode with its open directions as wide as the picture leaves them and at the mean of that; how many these are,
    and the share of their widest that is left. A direction never gets wider.
    """
    s, basis = settings or PictureMeanSettings(), left_open(model, mode, settings)
    count, rng = basis.shape[1], np.random.default_rng(seed)
    if not count:
        return mode, 0, 1.0
    mean, spread, effective = np.zeros(count), np.eye(count), 0.0
    for again in range(s.open_rounds):
        if again:
            # wider than what few draws found, for they find too little
            spread = 1.3 * spread
        z = rng.normal(size=(s.open_draws, count))
        z[0] = 0.0
        drawn = mean + z @ np.linalg.cholesky(spread).T
        costs = predictor.costs(seen_from @ se3.perturb(mode.pose, drawn @ basis.T, model.centroid))
        log = -s.open_temper * costs - 0.5 * np.sum(drawn**2, axis=1) + 0.5 * np.sum(z**2, axis=1)
        weight = np.exp(log - log.max())
        weight /= weight.sum()
        effective = float(1.0 / np.sum(weight**2))
        mean = weight @ drawn
        spread = (weight[:, None] * (drawn - mean)).T @ (drawn - mean) + s.open_left * np.eye(count)
        if effective >= s.open_enough * s.open_draws:
            break
    if effective < s.open_fewest:
        return mode, count, 1.0
    values, vectors = np.linalg.eigh(spread)
    covariance = _as_wide(model, mode, basis, np.minimum(values, 1.0), vectors)
    pose = se3.perturb(mode.pose, (basis @ mean)[None], model.centroid)[0]
    left = float(np.sqrt(min(values[-1], 1.0)))
    return replace(mode, pose=pose, covariance=0.5 * (covariance + covariance.T)), count, left


def _as_wide(model: ObjectModel, mode: Mode, basis: Array, values: Array, vectors: Array) -> Array:
    """(6, 6) the mode's covariance with its open directions, basis (6, k), as wide as the eigenvalues (k,) and vectors
    (k, k) of their spread say, in place of the identity.
    """
    if not model.symmetries.axes:
        return np.asarray(mode.covariance + basis @ ((vectors * values) @ vectors.T - np.eye(len(values))) @ basis.T)
    # A turn about the object's own axis is no doubt and not in these directions, but goes with them: to take off what
    # is told of them alone would leave less than nothing of both together. Each motion is made smaller instead.
    unit = np.repeat([1.0 / max(model.radius, 1e-9), 1.0], 3)
    told = np.linalg.pinv(basis / unit[:, None]) / unit @ model.symmetries.quotient(mode.pose[:3, :3], model.centroid)
    smaller = np.eye(6) + basis @ ((vectors * np.sqrt(values)) @ vectors.T - np.eye(len(values))) @ told
    return np.asarray(smaller @ mode.covariance @ smaller.T)


def with_picture(
    model: ObjectModel,
    mode: Mode,
    seen_from: Array,
    predictor: Predictor,
    seed: int,
    settings: PictureMeanSettings | None = None,
) -> tuple[Mode, float]:
    """The mode at its mean by what must be seen, where that is likelier by enough, and by how many nats; its covariance
    stays. seen_from: as `asked_picture` takes it.
    """
    s = settings or PictureMeanSettings()
    values, vectors = np.linalg.eigh(0.5 * (mode.covariance + mode.covariance.T))
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    delta = np.random.default_rng(seed).normal(size=(s.draws, 6)) @ half.T
    delta[0] = 0.0
    costs = predictor.rough_costs(seen_from @ se3.perturb(mode.pose, delta, model.centroid))
    weight = np.exp(-s.temper * (costs - costs.min()))
    moved = se3.perturb(mode.pose, (weight @ delta / weight.sum())[None], model.centroid)[0]
    before, after = predictor.costs(seen_from @ np.array([mode.pose, moved]), s.side)
    gained = float(before - after)
    return (replace(mode, pose=moved), gained) if gained >= s.least else (mode, 0.0)
