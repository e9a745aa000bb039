"""Has the camera been moved against the robot, or is the robot seen to be elsewhere than it reports?

A camera that is bumped, and a calibration that is loaded anew, have the robot jump against the image from one frame to
the next; so has an image of another instant. What the hand holds was not moved by that: it goes where the hand is seen
to, not where it is reported to.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.memory.lateness import of_look
from scenes.geometry import poses as se3
from vision.look.hand.hand import HandTold

Array = NDArray[np.float64]

# How far (m) what the hand holds is moved by that at least, and how many standard deviations (no unit) of two looks.
FAR, SURE = 0.006, 6.0


def bump(before: HandTold | None, now: HandTold | None, centre: Array) -> Array | None:
    """(4, 4) camera_from_camera: by what the hand is seen to be elsewhere than the robot has it from one look to the
    next; None where it is about where it was. centre (3,): of what it holds, camera frame.
    """
    if before is None or now is None or now is before:
        return None
    motion = now.correction @ se3.inverse(before.correction)
    if not np.linalg.norm(se3.apply(motion, centre[None])[0] - centre) > FAR:
        return None
    (told, there), (known, here) = of_look(*now.about(centre)), of_look(*before.about(centre))
    apart = there - here
    surely = float(apart @ np.linalg.solve(np.linalg.inv(told) + np.linalg.inv(known), apart))
    return motion if surely > SURE**2 else None
