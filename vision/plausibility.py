"""What in a depth image cannot be as it is said to be: the robot knows the shape and the place of its own hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.geometry.cameras import FARTHEST_READING, is_reading
from scenes.recordings.beliefs import CalibrationModel, usual_beliefs
from scenes.recordings.checking.frame_problems import centre_problems
from scenes.recordings.frames import Frame
from scenes.words import counted
from vision.look.hand.hand import HandView, camera_from_hand, prior_information
from vision.look.hand.hand_kernels import seen_past


@dataclass(frozen=True)
class PlausibilitySettings:
    """When the hand is not where, or not as large as, it should be. Values tuned on generated captures."""

    # Standard deviations by which a usual calibration may be off (a norm of six numbers of which each has one).
    most_sigmas: float = 4.5
    # The hand's points looked up, the distance (m) within which a reading is the hand's, and the share of readings that
    # may be far behind it: the camera then sees past a hand that must be there.
    points: int = 600
    near: float = 0.012
    most_past: float = 0.35
    # Fewer points than this in the image tell nothing.
    fewest: int = 60


def doubts(
    frame: Frame,
    hand: HandView | None,
    calibration: CalibrationModel | None = None,
    settings: PlausibilitySettings | None = None,
    pixels: int | None = None,
) -> tuple[str, ...]:
    """In words, why mask, intrinsics, depth unit or camera-robot calibration of a frame may be wrong; none when all
    agrees.

    hand: the hand as seen (vision.look.hand). Without a hand that the robot tells of, only depth, mask and principal
    point are looked at. pixels: how many were taken for the object, where that is known.
    """
    settings, calibration = settings or PlausibilitySettings(), calibration or usual_beliefs().calibration
    if frame.depth is None or frame.camera is None:
        return ()
    # where some were taken, there are readings
    empty = () if pixels else no_depth(frame)
    found = [*empty, *centre_problems(frame.camera)]
    if frame.mask is not None and not empty:
        masked = int(np.count_nonzero(is_reading(frame.depth) & frame.mask))
        if not masked:
            found.append("the mask holds no reading of depth: nothing that the camera sees is taken for the object")
        elif pixels == 0:
            found.append(f"none of the mask's {counted(masked, 'reading')} may be the object's: vision is not used")
    return (*found, *hand_doubts(frame, hand, calibration, settings))


def hand_doubts(
    frame: Frame,
    hand: HandView | None,
    calibration: CalibrationModel | None = None,
    settings: PlausibilitySettings | None = None,
) -> tuple[str, ...]:
    """In words, why a hand that the robot tells of may not be as it says; see `doubts`."""
    settings, calibration = settings or PlausibilitySettings(), calibration or usual_beliefs().calibration
    if frame.depth is None or frame.camera is None or hand is None:
        return ()
    found = []
    if is_displaced(hand, calibration, settings):
        millimetres = 1e3 * float(np.linalg.norm(hand.xi[3:]))
        found.append(f"the hand is seen {millimetres:.0f} mm from where the robot says: check the calibration")
    past = share_seen_past(frame, hand, settings)
    if past > settings.most_past:
        found.append(f"the camera sees past {past:.0%} of the hand: check intrinsics, depth unit and calibration")
    return tuple(found)


def is_displaced(hand: HandView, calibration: CalibrationModel, settings: PlausibilitySettings) -> bool:
    """Whether a hand is seen farther from where the robot says than its calibration may be off."""
    if not len(hand.points):
        return False
    off = float(np.sqrt(max(float(hand.xi @ prior_information(calibration, hand.centre) @ hand.xi), 0.0)))
    return off > settings.most_sigmas


def share_seen_past(frame: Frame, hand: HandView, settings: PlausibilitySettings) -> float:
    """Share of the hand's points in the image behind which the camera reads something; 0 where few are in it."""
    past, count = _seen_past(frame, hand, settings)
    return past if count >= settings.fewest else 0.0


def no_depth(frame: Frame) -> tuple[str, ...]:
    """In words, why nothing of a frame's depth image is used; none when a pixel of it is a reading."""
    depth = frame.depth
    if depth is None or is_reading(depth).any():
        return ()
    kinds = {
        "without a reading": depth == 0,
        "not finite": ~np.isfinite(depth),
        "below 0": np.isfinite(depth) & (depth < 0),
        f"beyond {FARTHEST_READING:g} m": np.isfinite(depth) & (depth > 0),
    }
    told = ", ".join(f"{int(np.count_nonzero(of_it))} are {kind}" for kind, of_it in kinds.items() if of_it.any())
    return (f"no usable depth: of {depth.size} pixels {told or 'none is one'}: vision is not used",)


def _seen_past(frame: Frame, hand: HandView, settings: PlausibilitySettings) -> tuple[float, int]:
    """Share of the hand's points in the image behind which the camera reads something, and how many they are."""
    measured = camera_from_hand(frame)
    if measured is None or frame.hand is None or frame.joints is None or frame.depth is None or frame.camera is None:
        return 0.0, 0
    points = frame.hand.points_on_surface(frame.joints, most=settings.points)
    points = points @ hand.aligned[:3, :3].T + hand.aligned[:3, 3]
    camera = frame.camera
    lens = float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)
    # points on the hand's far side are hidden by its near side: never seen past
    read, past = seen_past(points, lens, np.ascontiguousarray(frame.depth), settings.near)
    return past / max(read, 1), read
