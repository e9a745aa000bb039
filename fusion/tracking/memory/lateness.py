"""Whether images are of another instant than what the robot reports beside them, as the hand in view tells.

A camera's stamps are late by what it takes to expose, read out and match: a frame or two of motion. A hand that moves
is then seen where it was: off by its velocity times the delay, and by what the calibration is off, which stays. So the
delay is the slope of how far looks have the hand off, over how it moves.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Looks from which a delay may be told, and its standard deviations from which one is there (no unit): of 27 sequences
# of tuning families without one (24 frames each) the largest is 3.7.
FEWEST, SURE = 4, 4.0
# How well a look has the hand, at least (m, per axis, of the object's surface): what an alignment is off by itself.
LOOK = 0.0007
# A faster motion (m a frame, of the object's surface) than this leaves the pixels that a look takes for the hand's.
FASTEST = 0.010
# A shorter delay (frames) than this is what the exposure of any image makes.
SHORTEST = 0.25


@dataclass(frozen=True)
class Lateness:
    """velocity (6,): of what the hand holds, a frame, in this one (rad and m; camera axes, about its centroid); looks:
    at the hand, in full; sums over these, turns times the object's radius (m): of velocities (6,), of how far the hand
    was seen off (6,), and of their products. seen (4, 4): correction that the last of them made.
    """

    velocity: Array = field(default_factory=lambda: np.zeros(6))
    looks: int = 0
    moved: Array = field(default_factory=lambda: np.zeros(6))
    off: Array = field(default_factory=lambda: np.zeros(6))
    moved_moved: float = 0.0
    moved_off: float = 0.0
    off_off: float = 0.0
    seen: Array | None = None

    def looked(self, seen: Array | None, off: Array, units: Array) -> Lateness:
        """After a look that has the hand off by so much (6,); the same where no look was since. seen: the correction
        (4, 4) that a look made; units (6,): of turns and moves.
        """
        if seen is None or seen is self.seen:
            return self
        v, e = units * self.velocity, units * off
        if float(np.linalg.norm(v)) > FASTEST:
            return replace(self, seen=seen)
        return replace(
            self,
            looks=self.looks + 1,
            moved=self.moved + v,
            off=self.off + e,
            moved_moved=self.moved_moved + float(v @ v),
            moved_off=self.moved_off + float(v @ e),
            off_off=self.off_off + float(e @ e),
            seen=seen,
        )

    @property
    def unmoved(self) -> Lateness:
        """The same in a frame whose motion no hand tells: images are as late, and nothing says what that makes."""
        return replace(self, velocity=np.zeros(6))

    @property
    def frames(self) -> tuple[float, float]:
        """By how many frames images are late (early where it is below 0), and its standard deviation."""
        n = self.looks
        if n < FEWEST:
            return 0.0, np.inf
        across = self.moved_moved - float(self.moved @ self.moved) / n
        both = self.moved_off - float(self.moved @ self.off) / n
        off = self.off_off - float(self.off @ self.off) / n
        if across <= 1e-12:
            return 0.0, np.inf
        late = -both / across
        left = max(off - late * late * across, 0.0) / max(6 * (n - 1) - 1, 1)
        return late, float(np.sqrt((left + LOOK**2) / across))

    @property
    def there(self) -> float:
        """By how many frames images are late, 0 where none says so for sure."""
        late, sigma = self.frames
        return late if abs(late) > max(SHORTEST, SURE * sigma) else 0.0

    @property
    def smear(self) -> Array:
        """(6,) by how much what is seen is elsewhere for that, in this frame."""
        return self.there * self.velocity

    @property
    def said(self) -> tuple[str, ...]:
        """A note, where images are late."""
        late = self.there
        if not late:
            return ()
        word = "late" if late > 0.0 else "early"
        return (f"images are {abs(late):.1f} frames {word}, as the hand is seen to move: check the stamps",)
