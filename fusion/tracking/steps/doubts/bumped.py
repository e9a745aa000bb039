"""Has the camera been moved against the robot, or is the robot seen to be elsewhere than it reports?

A camera that is bumped, and a calibration that is loaded anew, have the robot jump against the image from one frame to
the next; so has an image of another instant. What the hand holds was not moved by that: it goes where the hand is seen
to, not where it is reported to.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.memory.lateness import of_look
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs, CalibrationModel
from scenes.recordings.frames import Frame
from vision.look.hand.hand import HandTold, camera_from_hand
from vision.look.hand.hand_search import HandSearchSettings, here_alone, shares

Array = NDArray[np.float64]

# How far (m) what the hand holds is moved by that at least, and how many standard deviations (no unit) of two looks.
FAR, SURE = 0.006, 6.0
# By what share of its surface (no unit) the hand must be seen better there: where depth is noise of 10 mm an alignment
# wanders by as much, but explains no more (0.03 at most but once, in 27 sequences of tuning families; 0.11 at least
# where the camera was moved).
BETTER = 0.08
_SEARCH = HandSearchSettings()


def bump(model: ObjectModel, frame: Frame, pose: Array, before: HandTold | None, now: HandTold | None) -> Array | None:
    """(4, 4) camera_from_camera: by what the hand is seen to be elsewhere than the robot has it from the look before to
    that at this frame; None where it is about where it was. pose (4, 4): of what it holds.
    """
    if before is None or now is None or now is before:
        return None
    centre = se3.apply(pose, model.centroid[None])[0]
    motion = now.correction @ se3.inverse(before.correction)
    if not np.linalg.norm(se3.apply(motion, centre[None])[0] - centre) > FAR:
        return None
    (information, there), (known, here) = of_look(*now.about(centre)), of_look(*before.about(centre))
    apart = there - here
    surely = float(apart @ np.linalg.solve(np.linalg.inv(information) + np.linalg.inv(known), apart))
    if surely <= SURE**2 or frame.hand is None or frame.joints is None:
        return None
    reported, points = camera_from_hand(frame), frame.hand.points_on_surface(frame.joints, most=_SEARCH.points)
    if reported is None or frame.depth is None or frame.camera is None:
        return None
    near = here_alone(), _SEARCH.close, _SEARCH.beyond
    was, told = (float(shares(frame, points, one.correction @ reported, *near).max()) for one in (before, now))
    return motion if told > was + BETTER else None


def recalibrated(beliefs: Beliefs, seen: Array | None) -> Beliefs:
    """Beliefs of a robot that has been seen to be elsewhere by a correction (4, 4) camera_from_camera: its calibration
    may be as far off as that, per axis. The same for None, where it has not been seen.
    """
    if seen is None:
        return beliefs
    off, was = se3.difference(seen, np.eye(4), np.zeros(3)), beliefs.calibration
    turn, move = (float(np.linalg.norm(part)) / np.sqrt(3.0) for part in (off[:3], off[3:]))
    sigmas = max(was.translation_sigma, move), max(was.rotation_sigma, turn)
    return replace(beliefs, calibration=CalibrationModel(*sigmas))
