"""Which of several modes do the arrays mean? Modes of rows, told apart by the covariance of patterns and by pressures.

Rows know where each taxel is to within the finger's error, and many poses meet them all. What a pattern says of the
shape under it (an edge along the finger, a corner, a flat) is in two things that rows do not hold: how the covariance
of the object's points in the sensing box agrees with the descriptor's (T1 eq. 5.8), and how likely the pressures are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.modes import Mode
from scenes.geometry.objects import ObjectModel
from touch.arrays.costs import ArrayProblem, ForwardSettings, MatchingSettings
from touch.arrays.readings import Reading

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RankingSettings:
    """What covariances and pressures are worth beside one another. Values by judgement, on generated grasps."""

    # Whether either speaks at all.
    covariance: bool = True
    pressures: bool = True
    # A covariance that differs by this much (m^2, Frobenius norm) in one contact is e times less likely: a tenth of a
    # pad's own, the variance of a step that is wrong by half a taxel.
    variance: float = 25e-6
    # Pressures of one array count like this many independent taxels at most, a fingertip's twelve: finer ones share
    # what the model leaves out of the layer, the layout and the mesh.
    independent: float = 12.0
    # An array is as likely one that tells nothing of this object (a hot taxel, what else it touches, a layout that is
    # not as told) at this many nats: as much as its rows cost at most, two for what feels and two for what does not,
    # each to its gate of five sigmas.
    broken: float = 50.0
    # A mode lies on its contacts: what counts is in the layer, twice its thickness for errors of the finger. (A search,
    # which starts 10 mm away, looks farther.)
    matching: MatchingSettings = field(default_factory=lambda: MatchingSettings(height=0.004))
    forward: ForwardSettings = field(default_factory=ForwardSettings)


def pattern_costs(
    model: ObjectModel, readings: Sequence[Reading], poses: Array, settings: RankingSettings | None = None
) -> Array:
    """Negative log likelihood (b,) of the patterns at poses (b, 4, 4) frame_from_object that meet the contacts, up to a
    constant. readings: in the poses' frame; without one that feels something all poses are alike.
    """
    settings = settings or RankingSettings()
    out = np.zeros(len(poses))
    if not any(reading.active.any() for reading in readings):
        return out
    if settings.covariance:
        out += mismatch(model, readings, poses, settings.matching) / settings.variance
    if settings.pressures:
        each = ArrayProblem(model, readings, forward=settings.forward).forward_each(poses)
        count = np.array([len(reading.taxels) for reading in readings])
        each = each * np.minimum(1.0, settings.independent / count)
        out += (each - np.logaddexp(0.0, each - settings.broken)).sum(axis=1)
    return out


def mismatch(model: ObjectModel, readings: Sequence[Reading], poses: Array, matching: MatchingSettings) -> Array:
    """(b,) m^2: T1 eq. 5.8 alone, summed over contacts; one without points misses by all of its own covariance."""
    whole = ArrayProblem(model, readings, replace(matching, h2=0.0, h3=1.0)).covariance(poses)
    rest = ArrayProblem(model, readings, replace(matching, h2=0.0, h3=0.0)).covariance(poses)
    return np.maximum(whole - rest, 0.0)


def reweighted(modes: tuple[Mode, ...], costs: Array) -> tuple[Mode, ...]:
    """Modes with `costs` (k,) added to theirs: weights and order as these then have them."""
    if len(modes) < 2:
        return modes
    logs = np.log(np.maximum([mode.weight for mode in modes], 1e-300)) - costs
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    found = [replace(m, weight=float(w), cost=m.cost + float(c)) for m, w, c in zip(modes, weights, costs)]
    return tuple(sorted(found, key=lambda mode: mode.cost))
