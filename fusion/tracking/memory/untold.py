"""What no frame of a track tells: directions in which the evidence is no Gaussian, a handle out of sight for one.

Samples of a frame's cost say how wide such a direction is (`moments`). They need luck where the cost is
rough: one frame's find the whole basin, another's too few that carry weight, and then say nothing. All frames have the
same direction open, so what some of them found holds for all, and is not averaged out: a filter that took each frame's
width for its own would keep the narrowest. Object's axes, about the centroid: rad, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.filter import WIDE, block, scales
from scenes.evidence.symmetry.near_symmetries import round_axes
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Looks whose mean counts: what comes into view is told from then on, and the width is gone as soon.
LOOKS = 4
# What a single one of them finds counts as so many times (of standard deviations, the root of the trace) the mean of
# the others at most, and these as so much at least (rad, radii of the object): samples of one look may follow something
# that is no direction of the object's, and 59 mm of one made a track of 1 mm unsure for 13 frames. By judgement.
ALONE, LEAST = 3.0, 0.02
# A turn about an axis about which an object is round but for little, of which frames leave more open than is wide, may
# be any: samples about one minimum reach the next ones, not those behind them. By judgement.
# It is as wide as this then (rad, a standard deviation), evenly from -pi to pi.
ANY_TURN = float(np.pi / np.sqrt(3.0))


@dataclass(frozen=True)
class Untold:
    """roots: of the last looks that could tell, (6, 6) each, square roots of the covariance beyond the Gaussian's, rad
    and radii of the object. Their mean counts: of standard deviations, for variances of few samples have long tails.
    around: the same of what turns about axes of roundness leave open beside it, which needs no luck.
    turns: whether the start, or looks since then, have left open a turn about an axis of roundness.
    """

    roots: tuple[Array, ...] = ()
    around: tuple[Array, ...] = ()
    turns: bool = False

    def learned(self, model: ObjectModel, pose: Array, added: Array | None, around: Array | None = None) -> Untold:
        """After a look that found the object at pose (4, 4): added, around (6, 6), camera axes; None where it cannot
        tell.
        """
        found = self
        if added is not None:
            found = replace(found, roots=(*self.roots[-LOOKS + 1 :], _root(model, pose, added)))
        if around is not None:
            found = replace(found, around=(*self.around[-LOOKS + 1 :], _root(model, pose, around)))
        if found is self:
            return self
        return replace(found, turns=self.turns or leaves_turn(model, pose, found._of_looks(model, pose)))

    @property
    def root(self) -> Array:
        """(6, 6) of all looks, with little of what one of them alone has found."""
        if not self.roots:
            return np.zeros((6, 6))
        sizes = np.array([float(np.linalg.norm(root)) for root in self.roots])
        widest = int(np.argmax(sizes))
        others = max(float(np.sum(np.delete(sizes, widest))) / max(len(sizes) - 1, 1), LEAST)
        share = np.ones(len(sizes))
        share[widest] = min(1.0, ALONE * others / max(sizes[widest], 1e-300))
        return np.asarray(np.tensordot(share, np.stack(self.roots), axes=1) / len(sizes))

    def at(self, model: ObjectModel, pose: Array) -> Array:
        """(6, 6) covariance in camera axes of the object at pose (4, 4)."""
        found = self._of_looks(model, pose)
        return any_turn(model, pose, found) if self.turns else found

    def _of_looks(self, model: ObjectModel, pose: Array) -> Array:
        axes = block(pose[:3, :3]) * scales(model)
        each = [self.root, *([np.mean(self.around, axis=0)] if self.around else ())]
        return np.asarray(sum(axes @ root @ root @ axes.T for root in each))


def _root(model: ObjectModel, pose: Array, covariance: Array) -> Array:
    """Square root (6, 6), rad and radii, object's axes, of a covariance (6, 6), camera axes, at pose (4, 4)."""
    turn, scale = block(pose[:3, :3].T), scales(model)
    values, vectors = np.linalg.eigh(turn @ covariance @ turn.T / scale / scale[:, None])
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def leaves_turn(model: ObjectModel, pose: Array, covariance: Array) -> bool:
    """Whether a covariance (6, 6), camera axes, of an object at pose (4, 4) leaves much open of a turn about an axis of
    roundness; never of one with a print, which tells.
    """
    axes = () if model.texture is not None else round_axes(model)
    turned = [pose[:3, :3] @ axis for axis in axes]
    return any(float(axis @ covariance[:3, :3] @ axis) > WIDE**2 for axis in turned)


def any_turn(model: ObjectModel, pose: Array, covariance: Array) -> Array:
    """A covariance (6, 6), camera axes, of an object at pose (4, 4), and any turn about the axes about which it is
    round.
    """
    out = covariance.copy()
    for axis in round_axes(model):
        turned = pose[:3, :3] @ axis
        variance = float(turned @ out[:3, :3] @ turned)
        out[:3, :3] += max(ANY_TURN**2 - variance, 0.0) * np.outer(turned, turned)
    return out
