"""How wide an answer is told to be: its first mode's covariance, or that of all that may be the case."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Mode
from fusion.estimation.posterior.confidence import ConfidenceSettings
from scenes.evidence.align import Prior
from scenes.evidence.symmetry.alike import Alike, alike
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


def room_about(centre: Array, points: Array) -> float:
    """How far (m, a standard deviation an axis) from a centre (3,) the points (n, 3) lie that might be the object's."""
    if not len(points):
        return 0.0
    return float(np.sqrt(np.mean(np.sum(np.square(points - centre), axis=1)) / 3.0))


def whole_covariance(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    none: float,
    prior: Prior | None,
    settings: ConfidenceSettings | None = None,
    room: float = 0.0,
) -> Array:
    """(6, 6) covariance about the first mode's centroid of all that may be the case: each mode by its weight and, with
    probability `none`, none of them; then the object is where the prior says, or anywhere about: at least as far off
    as what might be it lies, room (m, a standard deviation an axis).
    """
    s = settings or ConfidenceSettings()
    first = modes[0].pose
    wide = np.diag(np.repeat([s.anywhere_angle, max(s.anywhere_share * model.radius, room)], 3) ** 2)
    if prior is not None:
        inverse = np.diag(1.0 / np.diag(wide))
        away = se3.difference(model.symmetries.nearest(prior.pose, first), first, model.centroid)
        wide = np.linalg.inv(prior.information + inverse) + np.outer(away, away)
    out = none * wide
    total = sum(mode.weight for mode in modes)
    for mode in modes:
        apart = se3.difference(model.symmetries.nearest(mode.pose, first), first, model.centroid)
        share = (1.0 - none) * (mode.weight / total if total > 0.0 else 1.0 / len(modes))
        out = out + share * (mode.covariance + np.outer(apart, apart))
    return np.asarray(out, dtype=np.float64)


def told_covariance(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    word: str,
    right: float,
    prior: Prior | None,
    settings: ConfidenceSettings | None = None,
    room: float = 0.0,
    same: Alike | None = None,
) -> Array:
    """(6, 6) covariance of an answer with that verdict: of an `ok` one that of its first mode, or of all that are near
    it where the first does not hold what a region of 95 % must; else of all that may be the case. same: the modes that
    are one answer within the settings' tolerance, None to find them. See `whole_covariance`.
    """
    s = settings or ConfidenceSettings()
    if word != "ok":
        # as right as ever an answer is, it is the first mode
        return whole_covariance(model, modes, max(1.0 - right / s.surest, 0.0), prior, s, room)
    same = same or alike(model, modes, s.tolerance)
    if modes[0].weight >= (1.0 - s.left_out) * same.near_weight:
        return modes[0].covariance
    return whole_covariance(model, same.near, 0.0, prior, s)
