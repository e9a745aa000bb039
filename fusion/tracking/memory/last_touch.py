"""The last contacts of a track, as far as tells whether the next ones are these again.

A driver that hangs gives the contacts that it has beside where the robot is now, and fingers that have moved on are
taken to touch where they were. No contacts of fingers that have moved are those of before, number for number, in the
world: a sensor is carried along, and what it feels of an object that stands still is felt elsewhere on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.memory.last_image import BENT, MOVED, TURNED
from scenes.geometry import poses as se3
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# Fewest contacts that tell (no unit): a corner that one finger leans on may be told by its vertex, again and again.
FEWEST = 2


@dataclass(frozen=True)
class LastTouch:
    """index: of the frame that contacts came with first; points (n, 3): these; hand (4, 4) world_from_hand and joints
    (rad) by name then; hung: they have come again. World frame, metres.
    """

    index: int
    points: Array
    hand: Array
    joints: dict[str, float]
    hung: bool = False

    @staticmethod
    def of(frame: Frame) -> LastTouch | None:
        """Of a frame; None where too little is felt to tell, or nobody says where the hand is."""
        if len(frame.contacts) < FEWEST or frame.world_from_hand is None:
            return None
        return LastTouch(frame.index, frame.contacts.points, frame.world_from_hand, dict(frame.joints or {}))

    def is_again(self, other: LastTouch) -> bool:
        """Whether the contacts of a later frame, `other`, are these, while the hand or a finger of it has moved."""
        if not np.array_equal(self.points, other.points):
            return False
        since = se3.difference(other.hand, self.hand, np.zeros(3))
        bent = [abs(value - self.joints[name]) for name, value in other.joints.items() if name in self.joints]
        moved = np.linalg.norm(since[:3]) > TURNED or np.linalg.norm(since[3:]) > MOVED
        return self.hung or bool(moved) or max(bent, default=0.0) > BENT
