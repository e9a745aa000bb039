"""Proposals by the whole objective itself: poses that walk downhill by what must be seen and felt, not by rows.

Rows of evidence pull a pose onto whatever is near; in clutter that is another thing, and every descent from every start
ends there. The predicted picture has no such pull, and no gradient either: of many draws the best go on, and are drawn
around ever more narrowly (an evolution strategy; Rechenberg 1973). Camera frame, metres, radians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.search import leaders
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WalkSettings:
    """How far and with how many. Tuned on the families `desk`, `loose`, `d435` and `lab`."""

    # Rounds: how many of the best go on, draws around each, and their width as a share of `angle` and `distance`.
    rounds: tuple[tuple[int, int, float], ...] = ((12, 24, 0.6), (10, 24, 0.3), (8, 24, 0.15), (6, 24, 0.08))
    # Standard deviation of the first draws per axis (rad, m): that of a coarse start (T1 section 4.3).
    angle: float = 0.18
    distance: float = 0.02
    # Poses nearer to each other than this share of the object's radius go on as one: valleys, not places in one.
    apart: float = 0.1
    # Share (no unit) of those that go on which are for the best of places where none of the likelier ones is: a
    # gripper's body may have a hundred poses that begin better than the right one, and end no better. Without a start,
    # hand or mask, of 141 frames of tuning families (seeds 91 to 93) 123 were right with a half and 120 with none, in
    # the same time; a bracket beside a gripper, of another generator's frames, was found with it alone.
    of_places: float = 0.0


def walk(
    model: ObjectModel,
    starts: Array,
    costs: Callable[[Array], Array],
    rng: np.random.Generator,
    settings: WalkSettings | None = None,
) -> Array:
    """Where the best of starts (n, 4, 4) end, best first: (k, 4, 4), k at most that of the last round; none for none.

    costs(poses) -> (n,) nats.
    """
    s = settings or WalkSettings()
    poses, apart = starts, s.apart * model.radius
    if not len(starts):
        return poses
    at = costs(poses)
    for keep, draws, share in s.rounds:
        order = np.argsort(at, kind="stable")
        best, _ = leaders(model, poses[order], apart)
        chosen = order[_going_on(model, poses[order], best, keep, s.of_places)]
        width = share * np.repeat([s.angle, s.distance], 3)
        delta = rng.normal(size=(len(chosen), draws, 6)) * width
        fresh = se3.perturb(poses[chosen, None], delta, model.centroid).reshape(-1, 4, 4)
        poses, at = np.concatenate([poses[chosen], fresh]), np.concatenate([at[chosen], costs(fresh)])
    order = np.argsort(at, kind="stable")
    best, _ = leaders(model, poses[order], apart)
    return poses[order[_going_on(model, poses[order], best, s.rounds[-1][0], s.of_places)]]


def _going_on(model: ObjectModel, poses: Array, best: NDArray[np.int64], keep: int, share: float) -> NDArray[np.int64]:
    """Those of `best`, indices into poses (n, 4, 4), best first, that go on, `keep` at most: the first of them, and by
    a share the first of each place where no likelier one has the object's middle within its radius.
    """
    first = keep - int(share * keep)
    if first >= min(keep, len(best)):
        return best[:keep]
    middles = poses[best, :3, :3] @ model.centroid + poses[best, :3, 3]
    known = np.zeros(len(best), dtype=bool)  # at a place of one that goes on
    for k in range(first):
        known |= np.linalg.norm(middles - middles[k], axis=1) <= model.radius
    chosen = list(range(first))
    while len(chosen) < keep and not known.all():
        chosen.append(int(np.argmin(known)))
        known |= np.linalg.norm(middles - middles[chosen[-1]], axis=1) <= model.radius
    rest = np.setdiff1d(np.arange(first, len(best)), chosen)[: keep - len(chosen)]
    return best[np.sort(np.concatenate([chosen, rest]).astype(np.int64))]
