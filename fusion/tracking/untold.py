"""What no frame of a track tells: directions in which the evidence is no Gaussian, a handle out of sight for one.

Samples of a frame's cost say how wide such a direction is (fusion.estimation.moments). They need luck where the cost is
rough: one frame's find the whole basin, another's too few that carry weight, and then say nothing. All frames have the
same direction open, so what some of them found holds for all, and is not averaged out: a filter that took each frame's
width for its own would keep the narrowest. Object's axes, about the centroid: rad, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.filter import block, scales
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Looks whose mean counts: what comes into view is told from then on, and the width is gone as soon.
LOOKS = 4


@dataclass(frozen=True)
class Untold:
    """root (6, 6): square root of the covariance beyond the Gaussian's, rad and radii of the object, the mean of the
    last looks that could tell: of standard deviations, for the variances of few samples have long tails. looks: how
    many could.
    """

    root: Array = field(default_factory=lambda: np.zeros((6, 6)))
    looks: int = 0

    def learned(self, model: ObjectModel, pose: Array, added: Array | None) -> Untold:
        """After a look that found the object at pose (4, 4): added (6, 6), camera axes; None where it cannot tell."""
        if added is None:
            return self
        turn, scale = block(pose[:3, :3].T), scales(model)
        values, vectors = np.linalg.eigh(turn @ added @ turn.T / scale / scale[:, None])
        root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        looks = min(self.looks + 1, LOOKS)
        return Untold(self.root + (root - self.root) / looks, looks)

    def at(self, model: ObjectModel, pose: Array) -> Array:
        """(6, 6) covariance in camera axes of the object at pose (4, 4)."""
        turn = block(pose[:3, :3]) * scales(model)
        return np.asarray(turn @ self.root @ self.root @ turn.T)
