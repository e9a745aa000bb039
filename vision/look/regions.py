"""Where in a frame the object is looked for: a ball in the camera frame, metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.look.pixels import Region, median, read_pixels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def find_region(
    frame: Frame,
    model: ObjectModel,
    start: Array | None,
    slack: float,
    mask: Mask | None = None,
    through: float = 1.0,
) -> Region | None:
    """Around the start (4, 4) camera_from_object, else the mask (h, w), the contacts, the hand's fingertips; None is
    everywhere. slack: room (m) beyond the object's own size. through: share of the mask's readings, see `in_front`.
    """
    if start is not None:
        return Region(start[:3, :3] @ model.centroid + start[:3, 3], model.radius + slack)
    if mask is not None and frame.depth is not None and frame.camera is not None and mask.any():
        camera = frame.camera
        every = read_pixels(
            frame.depth, camera, (0, 0, camera.width, camera.height), camera.width * camera.height, mask
        )
        points = every.points
        if len(points):
            reach = model.diameter + slack
            return Region(median(in_front(points, reach, through)), reach)
    if len(frame.contacts):
        middle = frame.contacts.moved(frame.camera_from_world).points.mean(axis=0)
        return Region(middle, model.diameter + slack)
    if frame.hand is not None and frame.joints is not None and frame.world_from_hand is not None:
        sensors = frame.hand.hand_from_sensor(frame.joints)
        if sensors:  # what a hand holds is among its fingertips
            middle = np.mean([pose[:3, 3] for pose in sensors.values()], axis=0)
            camera_from_hand = frame.camera_from_world @ frame.world_from_hand
            centre = camera_from_hand[:3, :3] @ middle + camera_from_hand[:3, 3]
            return Region(centre, model.diameter + slack)
    return None


def in_front(points: Array, reach: float, through: float) -> Array:
    """Those of a mask's points (n, 3) that are the object's: where at least the share `through` of all lies before the
    middle by more than any part of the object can (reach, m), the others were seen past it or through it.

    Glass and wire let most of a mask's rays through, holes are filled with what is behind, and depth that was moved to
    another image has the wall at an object's edge: the middle of such a mask is not on the object.
    """
    least = max(through * len(points), 1.0)
    while True:
        before = points[points[:, 2] < median(points)[2] - reach]
        if len(before) < least:
            return points
        points = before


def region_around(model: ObjectModel, candidates: Array, slack: float) -> Region:
    """The ball that holds the object at each of the poses (n, 4, 4) camera_from_object, with `slack` metres more."""
    middles = candidates[:, :3, :3] @ model.centroid + candidates[:, :3, 3]
    centre = 0.5 * (middles.min(axis=0) + middles.max(axis=0))
    reach = float(np.linalg.norm(middles - centre, axis=1).max())
    return Region(centre, model.radius + slack + reach)
