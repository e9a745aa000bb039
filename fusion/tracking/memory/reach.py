"""Whether a hand reaches the object at all: what it is clear of, it does not hold. Metres, camera frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# A hand whose surface is nowhere so near (m) to the object's holds nothing of it. By judgement: what a calibration that
# nobody measured is believed to be off by (2.8 mm and 0.42 degrees, `CalibrationModel`) has a hand at 0.6 m 5 mm off
# along each axis, which is 27 mm at three standard deviations of all.
CLEAR = 0.030
# Of the hand's surface so many points are asked: a centimetre from one to the next.
POINTS = 600


def out_of_reach(model: ObjectModel, frame: Frame, pose: Array, camera_from_hand: Array) -> bool:
    """Whether a hand at camera_from_hand (4, 4), with the joints of a frame, is clear of an object at a pose (4, 4);
    no where nothing tells, or something is felt.
    """
    if frame.hand is None or frame.joints is None or frame.hand_lacks or len(frame.contacts.points):
        return False
    points = frame.hand.points_on_surface(frame.joints, most=POINTS)
    off = model.field.distance(se3.apply(se3.inverse(pose) @ camera_from_hand, points))
    return bool(len(off) and off.min() > CLEAR)
