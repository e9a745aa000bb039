"""The last depth image of a track, as far as tells whether the next one is it again.

A driver that hangs gives the image that it has beside the robot's reports of now, and what was seen then is taken for
where the object is. No image of a camera is that of another instant reading for reading. One that a program draws
without noise may be, while nothing in it moves; so it takes fingers that feel the object, or a hand in view, that has
moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.recordings.frames import Frame
from vision.look.hand.hand import camera_from_hand

Array = NDArray[np.float64]

# Readings of an image that are compared, about, and the fewest that tell (no unit).
COMPARED, FEWEST = 4096, 100
# By how much a hand has moved before its camera (m, rad), one of its joints (rad) or its contacts (m; more than they
# scatter from reading to reading), that cannot look as before.
MOVED, TURNED = 0.002, float(np.deg2rad(0.6))
BENT = float(np.deg2rad(3.0))
FELT_ELSEWHERE = 0.006


@dataclass(frozen=True)
class LastImage:
    """index: of the frame that an image came with first; readings (n,): some of it; hand (4, 4): camera_from_hand then,
    None where no hand is told; joints (rad) by name; sensors, felt (k, 3): its contacts then, before the camera;
    hung: it has come again.
    """

    index: int
    readings: NDArray[np.float64]
    hand: Array | None
    joints: dict[str, float]
    sensors: tuple[str, ...]
    felt: Array
    hung: bool = False

    @staticmethod
    def of(frame: Frame) -> LastImage | None:
        """Of a frame; None where it has no depth image, or one that tells too little."""
        if frame.depth is None:
            return None
        flat = frame.depth.reshape(-1)
        readings = np.asarray(flat[:: max(1, flat.size // COMPARED)], dtype=np.float64)
        if np.count_nonzero(readings > 0.0) < FEWEST:
            return None
        felt = se3.apply(frame.camera_from_world, frame.contacts.points)
        joints, sensors = dict(frame.joints or {}), tuple(frame.contacts.sensors)
        return LastImage(frame.index, readings, camera_from_hand(frame), joints, sensors, felt)

    def is_again(self, other: LastImage, in_view: bool = False) -> bool:
        """Whether the image of a later frame, `other`, is this one, while what is in it has moved: fingers that feel
        something, or a hand that is `in_view`.
        """
        if not np.array_equal(self.readings, other.readings):
            return False
        if self.hung or not (in_view or (len(self.felt) and len(other.felt))):
            return self.hung
        if self.hand is not None and other.hand is not None:
            since = se3.difference(other.hand, self.hand, np.zeros(3))
            if np.linalg.norm(since[:3]) > TURNED or np.linalg.norm(since[3:]) > MOVED:
                return True
        bent = [abs(value - self.joints[name]) for name, value in other.joints.items() if name in self.joints]
        if max(bent, default=0.0) > BENT:
            return True
        before, now = self._by_sensor(), other._by_sensor()
        moved = [np.linalg.norm(now[name] - place) for name, place in before.items() if name in now]
        return len(moved) > 1 and bool(np.median(moved) > FELT_ELSEWHERE)

    def _by_sensor(self) -> dict[str, Array]:
        """Where each sensor felt something, on average (3,)."""
        names = np.array(self.sensors)
        return {name: self.felt[names == name].mean(axis=0) for name in dict.fromkeys(self.sensors)}
