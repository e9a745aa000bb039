"""Whether images are of another instant than what the robot reports beside them, as the hand in view tells.

A camera's stamps are late by what it takes to expose, read out and match: a frame or two of motion. A hand that moves
is then seen where it was: off by its velocity times the delay, and by what the calibration is off, which stays. So the
delay is the slope of how far looks have the hand off, over how it moves. Once it is known, the robot's reports are
taken as of the image (`steps.doubts.delays`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from vision.look.hand.hand import HandTold

Array = NDArray[np.float64]

# Looks from which a delay may be told, and its standard deviations from which one is there (no unit): of 36 sequences
# of tuning families without one (24 frames each) one is told half a frame.
FEWEST, SURE = 3.0, 4.0
# The same where what the hand holds tells, and no hand: what slips or is turned in it drifts, too (of 52 sequences
# without a delay, five tuning families whose hands were left out, two reach 4.6, and one 5.8 as if images came early).
SURE_HELD = 5.0
# Frames whose reports are remembered: more than images are late by, and come late by themselves.
REMEMBERED = 12
# How well a look has the hand, at least (rad, m, per axis): what an alignment is off by itself. And what nothing tells
# of (rad, m): any hand is in view.
LOOK_TURN, LOOK = 0.01, 0.0007
UNKNOWN_TURN, UNKNOWN_MOVE = 1.0, 0.1
# Squared residuals (no unit) that one look adds, from which no delay explains it, and the camera has been moved: of 270
# looks of 36 sequences of tuning families the largest is 34, of 678 with images late 143; after a camera was bumped by
# 15 mm and 2 degrees half have more.
STRANGE = 200.0
# A hand that is reported to leap: by so much (m a frame) and this share of its motion before and after (no unit) it
# moves otherwise than in between. No hand does that at 30 frames a second; a camera that has been moved has it so.
LEAP, SWING = 0.006, 0.7
# A faster motion (m a frame, of the object's surface) than this leaves the pixels that a look takes for the hand's.
FASTEST = 0.025
# A shorter delay (frames) than this is what the exposure of any image makes, and a longer one is not believed.
SHORTEST, LONGEST = 0.25, 5.0
# Share of recordings whose images are late, and by how many frames (standard deviation), before any look has said so:
# by judgement, many cameras are stamped when they are read, and what that takes is a frame or two. A fiftieth instead
# leaves 87 % of regions held where images are two frames late, and this 93.
RARE, BELIEVED = 0.1, 1.5
# What a look counts for at the next one (no unit): an image hides how far a hand is off that has left its own pixels,
# so the first looks find less than there is, and those at a hand that is expected where it is find the rest.
KEPT = 0.85

_ORIGIN = np.zeros(3)


def of_look(information: Array, pull: Array) -> tuple[Array, Array]:
    """What a look is worth (6, 6), and how far off it has the hand (6,), from what its pixels say."""
    wide = np.linalg.inv(information + np.diag(np.repeat([UNKNOWN_TURN, UNKNOWN_MOVE], 3) ** -2.0))
    return np.linalg.inv(wide + np.diag(np.repeat([LOOK_TURN, LOOK], 3) ** 2.0)), wide @ pull


@dataclass(frozen=True)
class Lateness:
    """velocity (6,): of what the hand holds, a frame, in this one (rad and m; camera axes, about its centroid); used:
    frames by which images are taken to be late already, and `was` in the frame before; before: numbers of the last
    frames, and (4, 4) camera_from_hand as reported. looks: at the hand, in full, as many as they count for; sums over
    these, about a point (3,) `about` of the camera frame: of their information (6, 6), of what it says of how far the
    hand was seen off (6,), of that and of the motion a frame (6,), and of the products of the two. seen: the last;
    held: motion, look and centroid where the next frame tells whether the hand has leapt; hold (4, 4): hand_from_object
    where an image showed the object first, and no hand; None before.
    """

    velocity: Array = field(default_factory=lambda: np.zeros(6))
    used: float = 0.0
    was: float = 0.0
    before: tuple[tuple[int, Array], ...] = ()
    looks: float = 0.0
    about: Array = field(default_factory=lambda: np.zeros(3))
    told: Array = field(default_factory=lambda: np.zeros((6, 6)))
    off: Array = field(default_factory=lambda: np.zeros(6))
    moved: Array = field(default_factory=lambda: np.zeros(6))
    moved_moved: float = 0.0
    moved_off: float = 0.0
    off_off: float = 0.0
    seen: HandTold | None = None
    held: tuple[Array, HandTold, Array] | None = None
    hold: Array | None = None

    def looked(self, seen: HandTold | None, centroid: Array) -> Lateness:
        """After a look at the hand; the same where none was since. centroid (3,): camera frame, of what it holds."""
        if seen is None or (self.seen is not None and seen.is_same(self.seen)):
            return self
        if float(np.linalg.norm(self.velocity[3:])) * (self._doubt if self.used else 1.0) > FASTEST:
            return replace(self, seen=seen)
        if self._leaps(len(self.before) - 2):
            return replace(self, seen=seen, held=(self.velocity, seen, centroid))
        return self._counted(self.velocity, seen, centroid)

    @property
    def of_hand(self) -> Lateness:
        """The same before a look at the hand: what it holds has told until now, which is off by something else."""
        return self if self.hold is None else Lateness(self.velocity, self.used, self.was, self.before)

    def _counted(self, velocity: Array, seen: HandTold, centroid: Array) -> Lateness:
        about = self.about if self.looks else seen.centre
        v = velocity.copy()
        v[3:] += np.cross(v[:3], about - centroid)
        information, e = of_look(*seen.about(about))
        e = e - self.used * v  # as it were without what is known of the delay
        kept, iv, ie = KEPT if self.used else 1.0, information @ v, information @ e
        more = replace(
            self,
            looks=kept * self.looks + 1.0,
            about=about,
            told=kept * self.told + information,
            off=kept * self.off + ie,
            moved=kept * self.moved + iv,
            moved_moved=kept * self.moved_moved + float(v @ iv),
            moved_off=kept * self.moved_off + float(v @ ie),
            off_off=kept * self.off_off + float(e @ ie),
            seen=seen,
        )
        if more._fitted[2] < kept * self._fitted[2] + STRANGE:
            return more
        return self._anew(len(self.before) - 1)._counted(velocity, seen, centroid)

    def _anew(self, first: int) -> Lateness:
        """The camera has been moved, or the hand holds it otherwise: what looks have told is of another calibration or
        hold, and so is what was reported before the `first` of the reports that are remembered.
        """
        return Lateness(self.velocity, self.used, self.was, self.before[first:], seen=self.seen)

    def _leaps(self, step: int) -> bool:
        """Whether the hand moves much otherwise in one step between reports than in those before and after it, of which
        the last may not be there yet.
        """
        if step < 1:
            return False
        around = self.before[step - 1 : step + 3]
        moves = [(end[:3, 3] - start[:3, 3]) / (last - first) for (first, start), (last, end) in pairwise(around)]
        before, this, *after = moves
        usual = 0.5 * (before + after[0]) if after else before
        swing = max(float(np.linalg.norm(one)) for one in (before, *after))
        return float(np.linalg.norm(this - usual)) > LEAP + SWING * swing

    def reported(self, index: int, camera_from_hand: Array) -> Lateness:
        """With where the robot reports its hand (4, 4) in a frame, and as late as is known by now."""
        known = [one for one in self.before if one[0] != index]
        kept = sorted([*known, (index, camera_from_hand)], key=lambda one: one[0])[-REMEMBERED:]
        now = replace(self, before=tuple(kept))
        if now._leaps(len(kept) - 3):
            now = now._anew(len(kept) - 2)
        elif self.held is not None:
            now = replace(now._counted(*self.held), held=None)
        return replace(now, was=self.used, used=float(np.clip(now.there, -1.0, LONGEST)))

    def moving(self, along: Array, index: int, before: int) -> Lateness:
        """With what the hand holds having moved `along` (6,) from one frame's image to another's."""
        frames = index - before - (self.used - self.was)
        return replace(self, velocity=along / frames) if abs(frames) >= SHORTEST else self

    def reported_at(self, frames: float) -> Array | None:
        """Where the robot has reported the hand (4, 4), or would have, at a time between frames or just after the last;
        None where it has not.
        """
        if len(self.before) < 2 or frames < self.before[0][0]:
            return None
        later = next((n for n, one in enumerate(self.before) if one[0] >= frames and n), len(self.before) - 1)
        (first, start), (last, end) = self.before[later - 1], self.before[later]
        return se3.perturb(start, (frames - first) / (last - first) * se3.difference(end, start, _ORIGIN), _ORIGIN)

    @property
    def _doubt(self) -> float:
        """By how many frames the delay may be another than is known."""
        return max(SHORTEST, 2.0 * self.frames[1])

    @property
    def unmoved(self) -> Lateness:
        """The same in a frame whose motion no hand tells: images are as late, and nothing says what that makes."""
        return replace(self, velocity=np.zeros(6))

    @property
    def frames(self) -> tuple[float, float]:
        """By how many frames images are late (early where it is below 0), and its standard deviation."""
        late, across, left = self._fitted
        if self.looks < FEWEST or across <= 1e-6:
            return 0.0, np.inf
        spread = max(1.0, left / max(6.0 * (self.looks - 1.0) - 1.0, 1.0))
        return late, float(np.sqrt(spread / across))

    @property
    def _fitted(self) -> tuple[float, float, float]:
        """The delay that fits the looks (frames), its information, and their squared residuals (no unit)."""
        if not self.looks:
            return 0.0, 0.0, 0.0
        off, moved = np.linalg.solve(self.told, np.stack([self.off, self.moved], axis=1)).T
        across = self.moved_moved - float(self.moved @ moved)
        both = self.moved_off - float(self.moved @ off)
        late = -both / across if across > 1e-6 else 0.0
        return late, across, max(self.off_off - float(self.off @ off) - late * late * max(across, 0.0), 0.0)

    @property
    def there(self) -> float:
        """By how many frames images are late, 0 where nothing says so for sure."""
        late, sigma = self.frames
        if self.hold is not None:
            return late if late > max(SHORTEST, SURE_HELD * sigma) else 0.0
        return late if abs(late) > max(SHORTEST, SURE * sigma) else 0.0

    @property
    def smear(self) -> Array:
        """(6,) by how much what is seen is elsewhere for that, in this frame: what is known of it is taken off, and
        leaves what it may be off by; while nothing is known for sure, what it may be.
        """
        late = self.there
        if not late and not self.used:
            return self.maybe * self.velocity
        left = float(np.hypot(late - self.used, self.frames[1])) if self.used else late
        return left * self.velocity

    @property
    def maybe(self) -> float:
        """Frames (root mean square) by which images may be late by what looks have told: with a probability of `RARE`
        before any of them by 0, give or take `BELIEVED`, else by none; Bayes' rule between the two.
        """
        late, sigma = self.frames
        if not np.isfinite(sigma):
            return float(np.sqrt(RARE) * BELIEVED)
        trust = BELIEVED**2 / (sigma**2 + BELIEVED**2)
        nats = 0.5 * trust * (late / max(sigma, 1e-9)) ** 2 + 0.5 * np.log(max(1.0 - trust, 1e-12))
        share = RARE / (RARE + (1.0 - RARE) * np.exp(-min(nats, 50.0)))
        return float(np.sqrt(share * trust * (sigma**2 + trust * late**2)))

    @property
    def said(self) -> tuple[str, ...]:
        """A note, where images are late."""
        late = self.there
        if not late:
            return ()
        word = "late" if late > 0.0 else "early"
        return (f"images are {abs(late):.1f} frames {word}, as the hand is seen to move: check the stamps",)
