"""The mean of what the joint solution leaves open, by what must be seen: the last word of the predicted picture.

The joint solution is of rows: pixels inside an outline that like to be on the surface. Along a flat side of a large
box they like it everywhere, and a pose slides by centimetres until the outline is where nothing is, which no row minds
much and the picture does. So poses drawn from the solution's own covariance are weighed by it (importance sampling).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
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


def why_not_asked(predictor: Predictor) -> str:
    """Why the picture is not asked; "" where it is. Where it is known what hides the object, its pixels say as much."""
    if not predictor.sees:
        return "nothing is seen"
    return "it is known what hides the object" if predictor.told_apart else ""


def with_picture(
    model: ObjectModel,
    mode: Mode,
    seen_from: Array,
    predictor: Predictor,
    seed: int,
    settings: PictureMeanSettings | None = None,
) -> tuple[Mode, float]:
    """The mode at its mean by what must be seen, where that is likelier by enough, and by how many nats; its covariance
    stays. seen_from (4, 4): takes a pose to where the uncorrected depth image shows the object.
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
