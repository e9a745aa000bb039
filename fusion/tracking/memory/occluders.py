"""What goes with the object and is not it, learned while it is followed: fingers that nobody has a model of.

A point that is seen well off the object's surface, again and again at the same place of the object's own frame, is a
thing that holds it. Pixels beside such a place are not taken for the object, though they lie near its surface: a
finger's flank does where the finger touches. Object frame, metres; cells of a grid, as whole numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]
Keys = NDArray[np.int64]

# Cells along each axis that keys can tell apart.
_SPAN = 1 << 20


@dataclass(frozen=True)
class OccluderSettings:
    """When something is a thing that goes with the object. By judgement, on `lab` without the hand's model."""

    # Edge of a cell (m): half a finger's width.
    cell: float = 0.005
    # Nearest to the surface (m) that is surely not the object's, and farthest that can be a finger that touches it.
    clear: float = 0.009
    reach: float = 0.030
    # Share of a cell's votes that the next frame inherits, and votes (no unit) from which it is a thing: some five
    # frames of a few pixels each.
    memory: float = 0.9
    enough: float = 3.0
    # Most cells kept, those of most votes.
    most: int = 4000


@dataclass(frozen=True)
class Occluders:
    """keys (n,) of cells, ascending; votes (n,): frames in which each was seen to be filled, fading."""

    keys: Keys = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    votes: Array = field(default_factory=lambda: np.zeros(0))

    def learned(
        self, model: ObjectModel, pose: Array, points: Array, settings: OccluderSettings | None = None
    ) -> Occluders:
        """After a frame: points (n, 3) seen around the object at pose (4, 4), camera frame."""
        s = settings or OccluderSettings()
        local = se3.apply(se3.inverse(pose), points)
        distance = model.field.distance(local)
        seen = np.unique(_keys(local[(distance > s.clear) & (distance < s.reach)], s.cell))
        keys = np.union1d(self.keys, seen)
        votes = np.zeros(len(keys))
        votes[np.searchsorted(keys, self.keys)] = s.memory * self.votes
        votes[np.searchsorted(keys, seen)] += 1.0
        kept = votes > 0.05
        if kept.sum() > s.most:
            kept &= votes >= np.sort(votes)[-s.most]
        return Occluders(keys[kept], votes[kept])

    def beside(self, pose: Array, points: Array, settings: OccluderSettings | None = None) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3), camera frame, are in or next to a place where a thing goes with the object."""
        s = settings or OccluderSettings()
        things = self.keys[self.votes >= s.enough]
        if not len(things) or not len(points):
            return np.zeros(len(points), dtype=bool)
        steps = np.array([(x * _SPAN + y) * _SPAN + z for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
        keys = _keys(se3.apply(se3.inverse(pose), points), s.cell)
        return np.asarray(np.isin(keys[:, None] + steps, things).any(axis=1))


def _keys(local: Array, cell: float) -> Keys:
    """One whole number for the cell of each point (n, 3)."""
    index = np.floor(local / cell).astype(np.int64) + _SPAN // 2
    return np.asarray((index[:, 0] * _SPAN + index[:, 1]) * _SPAN + index[:, 2])
