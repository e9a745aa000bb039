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
        chosen = order[best[:keep]]
        width = share * np.repeat([s.angle, s.distance], 3)
        delta = rng.normal(size=(len(chosen), draws, 6)) * width
        fresh = se3.perturb(poses[chosen, None], delta, model.centroid).reshape(-1, 4, 4)
        poses, at = np.concatenate([poses[chosen], fresh]), np.concatenate([at[chosen], costs(fresh)])
    order = np.argsort(at, kind="stable")
    best, _ = leaders(model, poses[order], apart)
    return poses[order[best[: s.rounds[-1][0]]]]
