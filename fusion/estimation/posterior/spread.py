"""How far a covariance of an object's pose has its surface off.

What slides along itself is nowhere else: points count along their normals. Small turns move a surface in proportion;
one about an axis about which most of an object is round, as a mug is but for its handle, may go all around and moves it
by what the rest of it is off, and no more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.symmetry.alike import STEP, moved
from scenes.evidence.symmetry.near_symmetries import small_turn, turns_about
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# The mean (no unit) of how far a surface is off over its root mean square, as where errors are small.
MEAN_OF_ROOT = 0.8
# Whole turns (no unit) either way that a turn about an axis of roundness may go beyond one.
LAPS = 3

_TURNINGS: WeakKeyDictionary[ObjectModel, tuple[_Turning, ...]] = WeakKeyDictionary()


def mean_square(model: ObjectModel, pose: Array, covariance: Array) -> tuple[float, float]:
    """Mean (m^2) and variance (m^4) of the mean square of how far points of the surface are off along their normals,
    for an error drawn from a covariance (6, 6) about the centroid of a pose (4, 4): what slides along itself is nowhere
    else, and a turn about an axis about which most of an object is round moves it by what the rest of it is off.
    """
    own = np.zeros((6, 6))
    own[:3, :3] = own[3:, 3:] = pose[:3, :3]
    known = model.symmetries.quotient(pose[:3, :3], model.centroid)
    doubtful = own.T @ known @ covariance @ known.T @ own
    for turning in _turnings(model):
        doubtful = turning.bounded(doubtful)
    squares = model.slippage @ doubtful
    return max(float(np.trace(squares)), 0.0), 2.0 * float(np.sum(squares * squares.T))


@dataclass(frozen=True)
class _Turning:
    """An axis of roundness: axis (3,), step (6,) of the centroid for a turn of 1 rad about it, object axes; small: the
    mean square (m^2) of how far that has the surface off if it were small; angles (n,), and moves (n,): how far (m) it
    really has, on average, over `MEAN_OF_ROOT`.
    """

    axis: Array
    step: Array
    small: float
    angles: Array
    moves: Array

    def bounded(self, covariance: Array) -> Array:
        """A covariance (6, 6), object axes, with so much of the turn about the axis as, by a small turn, moves the
        surface as far as it really does: a handle may be anywhere about a mug, and the mug is where it is.
        """
        variance = float(self.axis @ covariance[:3, :3] @ self.axis)
        if not variance > 1e-12:
            return covariance
        laps = 2.0 * np.pi * np.arange(-LAPS, LAPS + 1)
        odds = np.exp(-0.5 * (self.angles + laps[:, None]) ** 2 / max(variance, STEP**2)).sum(axis=0)
        square = float(odds @ self.moves**2 / odds.sum()) * min(1.0, variance / STEP**2)
        less = np.eye(6)
        share = min(1.0, square / max(variance * self.small, 1e-30))
        less[:, :3] -= (1.0 - math.sqrt(share)) * np.outer(self.step, self.axis)
        return np.asarray(less @ covariance @ less.T)


def _turnings(model: ObjectModel) -> tuple[_Turning, ...]:
    found = _TURNINGS.get(model)
    if found is None:
        found = _TURNINGS[model] = tuple(_turning(model, turns) for turns in turns_about(model))
    return found


def _turning(model: ObjectModel, turns: Array) -> _Turning:
    """From turns (n, 4, 4) all around an axis."""
    step = small_turn(model, turns)
    around = np.linspace(0.0, 2.0 * np.pi, len(turns) + 2)
    angles = np.arange(-np.pi, np.pi, STEP / 3.0)
    off = np.concatenate([[0.0], moved(model, np.eye(4), turns)[1] / MEAN_OF_ROOT, [0.0]])
    moves = np.interp(angles % (2.0 * np.pi), around, off)
    return _Turning(step[:3], step, float(step @ model.slippage @ step), angles, moves)


def spread_of(model: ObjectModel, pose: Array, covariance: Array) -> float:
    """Standard deviation (m) of where the object's surface is, all directions together, from a covariance (6, 6) about
    the centroid of a pose (4, 4); turns about the object's own axes move nothing.
    """
    return math.sqrt(max(mean_square(model, pose, covariance)[0], 0.0))
