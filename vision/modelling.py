"""Views of an object that no model exists of: its pixels told from the hand's and the background's, and its poses.

Where the hand holds the object, the object moves with the hand: the hand's pose, aligned to its own pixels, is the
object's but for a constant. Else the object stands still in the world. Camera frame, metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.reconstruction.volume import DepthView
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from vision.look.hand.hand import view_hand
from vision.look.mask.mask import object_mask
from vision.look.mask.settings import MaskSettings
from vision.look.pixels import read_pixels

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelViewSettings:
    """What may be the object. Values by judgement."""

    # Largest extent of the object (m): no reading farther than this from where it is held is its own.
    size: float = 0.3
    # What is this near (m) to the hand is held by it, across the gap that the fingers hide. Wider than where a model is
    # known: a thing that only stands near does not move with the hand, and the other views see through it.
    held: float = 0.05
    # Pixels around the object's that say nothing: flying ones, and outlines off by a pixel.
    ring: int = 2
    # Pixels of the image among which the hand is looked for.
    most_hand: int = 12_000


def stand_in(size: float) -> ObjectModel:
    """A ball of that diameter (m): all that is known of an object without a model."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5 * size)
    return ObjectModel.from_mesh(np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int64), "unknown object")


def hand_poses(frames: list[Frame], settings: ModelViewSettings | None = None) -> dict[int, Array]:
    """camera_from_object (4, 4) by frame for an object held still in the hand: axes of the hand, origin where it holds.

    Frames without the hand's joints or pose have none.
    """
    settings = settings or ModelViewSettings()
    out: dict[int, Array] = {}
    hand_from_object: Array | None = None
    for frame in frames:
        if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
            continue
        camera_from_hand = frame.camera_from_world @ frame.world_from_hand
        if hand_from_object is None:
            hand_from_object = se3.make_pose(None, _held_at(frame))
        if frame.depth is not None and frame.camera is not None:
            box = (0, 0, frame.camera.width, frame.camera.height)
            pixels = read_pixels(frame.depth, frame.camera, box, settings.most_hand)
            seen = view_hand(frame, pixels, Beliefs())
            camera_from_hand = camera_from_hand if seen is None else seen.aligned
        out[frame.index] = camera_from_hand @ hand_from_object
    return out


def _held_at(frame: Frame) -> Array:
    """(3,) the middle of what the fingers feel, else of the fingertips, hand frame."""
    assert frame.hand is not None
    assert frame.joints is not None
    assert frame.world_from_hand is not None
    if len(frame.contacts):
        return np.asarray(frame.contacts.moved(se3.inverse(frame.world_from_hand)).points.mean(axis=0))
    tips = [pose[:3, 3] for pose in frame.hand.hand_from_sensor(frame.joints).values()]
    return np.mean(tips, axis=0) if tips else np.zeros(3)


def still_poses(frames: list[Frame]) -> dict[int, Array]:
    """camera_from_object by frame of an object that stands still in the world, whose axes it takes."""
    return {frame.index: np.asarray(frame.camera_from_world) for frame in frames}


def views_of(
    frames: list[Frame], camera_from_object: Mapping[int, Array], settings: ModelViewSettings | None = None
) -> list[DepthView]:
    """What each frame with depth and a pose tells of the object; raises InputError when there is none."""
    settings = settings or ModelViewSettings()
    ball = stand_in(settings.size)
    views = []
    for frame in frames:
        if frame.depth is None or frame.camera is None or frame.index not in camera_from_object:
            continue
        views.append(_view(frame, camera_from_object[frame.index], ball, settings))
    if not views:
        raise InputError("views: expected frames with depth, a camera and a pose of the object, got none")
    return views


def _view(frame: Frame, pose: Array, ball: ObjectModel, settings: ModelViewSettings) -> DepthView:
    import cv2

    assert frame.depth is not None
    assert frame.camera is not None
    mask = frame.mask
    if mask is None:
        mask = object_mask(replace(frame, prior=None), ball, settings=MaskSettings(held=settings.held))
    depth = np.where(np.isfinite(frame.depth), frame.depth, 0.0).astype(np.float32)
    mask = mask & (depth > 0)
    ring = np.ones((2 * settings.ring + 1,) * 2, np.uint8)
    beside = (cv2.dilate(mask.astype(np.uint8), ring) > 0) & ~mask
    # a reading beside the object tells of free space only where it is none of the object's surroundings: the hand's own
    # pixels may hide a part of the object that the mask gave to the hand
    points = frame.camera.rays() * depth[..., None]
    middle = np.median(points[mask], axis=0) if mask.any() else pose[:3, 3]
    near = np.linalg.norm(points - middle, axis=2) < settings.size
    core = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    depth[(beside | near | mask) & ~core] = 0.0
    return DepthView(frame.camera, np.asarray(pose), depth, core)
