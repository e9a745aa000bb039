"""What becomes of the pixels that an object must show at a pose: ray by ray, and in shares. Camera frame, metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vision.picture import columns

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Shares (n,) of the predicted pixels, for n poses; those outside the image are hidden.

    seen: at the depth predicted, falling off smoothly with the difference; beyond: of these, on what goes on beyond the
    outline in one colour, as far as it does; agree: within the tolerance; past: seen through, or under a table; hidden:
    behind something that is not the robot's hand; behind_hand: the hand explains it; outline: of the border, where the
    seen surface runs on smoothly beyond it; within: borders, beside as many as the outline has, across which it runs on
    within the outline to be what hides the object; ends: of the border, where what agrees ends in a step of depth, to
    either side; dark: of the border, beyond which nothing is read; scatter: how far what agrees is off, beside being
    off as a whole (standard deviation, sigmas of noise and bias). count: rays that met the object inside the image.
    area: of the outline (px^2) that they tell of, what the image's border cuts off included. shares (n, SUMS): in the
    columns of vision.picture.columns.
    """

    shares: Array
    beyond: Array
    area: Array

    @property
    def seen(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.SEEN]

    @property
    def agree(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.AGREE]

    @property
    def past(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.PAST]

    @property
    def hidden(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.BEHIND]

    @property
    def behind_hand(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.BEHIND_HAND]

    @property
    def outline(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.OUTLINE]

    @property
    def running(self) -> Array:
        """(n,): outline, and the same along straight sides of it, at which the rays end."""
        return self.shares[:, columns.OUTLINE] + self.shares[:, columns.SIDES]

    @property
    def within(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.WITHIN]

    @property
    def ends(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.ENDS]

    @property
    def dark(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.DARK]

    @property
    def scatter(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.SCATTER]

    @property
    def count(self) -> Array:
        """(n,)."""
        return self.shares[:, columns.HITS]


@dataclass(frozen=True)
class View:
    """The rays of n poses, side^2 each, in a grid: pixels u, v (n, side^2), and step (n, 4): pixels u, v from one
    to the next of its row, and to that in the next row; expected, seen (n, side^2): depth (m) at which a ray meets
    the object, and what is read, 0 for none; state: bits of vision.picture.columns; past: how much of a ray is seen
    past; fade: how well one at the predicted depth agrees; inside (n,): share of the object in the image.
    """

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    step: Array
    expected: Array
    seen: Array
    state: NDArray[np.uint8]
    past: Array
    fade: Array
    inside: Array

    @property
    def side(self) -> int:
        """Rays along each side."""
        return round(self.u.shape[1] ** 0.5)

    def has(self, bit: int) -> NDArray[np.bool_]:
        """(n, side^2) whether rays are as a bit says."""
        return np.asarray((self.state & bit) > 0)

    def at(self, place: NDArray[np.intp]) -> NDArray[np.int64]:
        """(k, 2) pixels (u, v) of rays (k,) of the first pose."""
        return np.stack([self.u[0, place], self.v[0, place]], axis=1)
