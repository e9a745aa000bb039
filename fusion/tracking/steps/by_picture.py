"""A tracked frame's own answer by what must be seen, where nothing tells what hides the object.

Rows are pixels that like to be on the surface, and fingers without a model like it as much as the object: a track that
follows them slides by a millimetre a frame, each of which its last frame explains. The predicted picture minds where
the outline is. So what a few steps from the prediction find competes with the prediction itself and with draws around
both, as around the answer of a single frame (fusion.estimation.search.sources), and the joint solution's picture has
the last word (fusion.estimation.steps.picture). Camera frame, metres.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.search.walk import walk
from fusion.estimation.solve.joint import JointResult
from fusion.estimation.steps.picture import with_picture
from fusion.tracking.answer import TrackSettings
from fusion.tracking.steps.sensing import Sensed
from scenes.evidence.align import Prior
from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


def walked(model: ObjectModel, prior: Prior, fit: Array, sensed: Sensed, settings: TrackSettings) -> Mode | None:
    """What the whole objective prefers, by enough, to a fit (4, 4) of the rows: of the prior's pose and of draws around
    both, each fitted to the pixels inside its own outline. None where nothing is, or where it is known what hides it.
    """
    if sensed.pool is None or sensed.told_apart:
        return None
    pool, how = replace(sensed.pool, prior=prior), settings.by_picture
    # as many draws as around the answer of a single frame, as wide as a frame's own may be from its prediction
    around = settings.first.proposals.around
    around = replace(around, angle=settings.loose_angle, distance=settings.loose_distance)
    tried = np.array([fit, prior.pose])
    tried = np.concatenate([tried, walk(model, tried, pool.walking, np.random.default_rng(0), around)])
    best = pool.compete(tried, how.fitted)[0]
    before, after = pool.costs(np.array([fit, best.pose]), settings.side)
    return best if before - after >= how.least else None


def meant(model: ObjectModel, solved: JointResult, sensed: Sensed, settings: TrackSettings) -> JointResult:
    """A joint solution at its mean by what must be seen, where that is likelier by enough."""
    if sensed.pool is None or sensed.told_apart:
        return solved
    seen_from = solved.as_seen @ se3.inverse(solved.pose)
    mode, how = Mode(solved.pose, 1.0, 0.0, solved.covariance), settings.first.picture_mean
    moved, gained = with_picture(model, mode, seen_from, sensed.pool.predictor, 0, how)
    return replace(solved, pose=moved.pose, as_seen=seen_from @ moved.pose) if gained else solved
