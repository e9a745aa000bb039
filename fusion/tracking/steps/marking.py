"""What the image shows of an object's motion where no hand tells of it. Camera frame, metres, radians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.filter import Belief
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.sensing import Sensed
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.tracking.by_image import MarkSettings, Motion, marked, motion_between
from vision.tracking.by_vision import ConstantVelocity

Array = NDArray[np.float64]


def with_marks(model: ObjectModel, seen: Motion, before: Array, pose: Array, noise: Array) -> tuple[Array, Array]:
    """Where an object at `before` (4, 4) is now, by marks on it and by what else is expected of it: pose (4, 4), known
    to covariance noise (6, 6); and the covariance of both together.
    """
    moved = model.symmetries.nearest(seen.motion @ before, pose)
    apart = se3.difference(moved, pose, model.centroid)
    gain = np.linalg.solve(noise + seen.covariance, noise).T
    both = noise - gain @ noise
    return se3.perturb(pose, gain @ apart, model.centroid), 0.5 * (both + both.T)


def seen_motion(
    model: ObjectModel,
    frame: Frame,
    belief: Belief,
    state: TrackState,
    velocity: ConstantVelocity,
    settings: MarkSettings,
) -> Motion | None:
    """How the image shows the object to have moved since the last frame; None where a hand tells, or nothing does."""
    marks = state.marks
    if marks is None or state.hand is not None or not marks.index == state.index < frame.index:
        return None
    expected = velocity.predict(frame.index)[0] @ se3.inverse(belief.pose)
    centre = se3.apply(belief.pose, model.centroid[None])[0]
    return motion_between(marks, frame, expected, centre, settings)


def mark(
    model: ObjectModel, sensed: Sensed, pose: Array, seen: Motion | None, state: TrackState, settings: MarkSettings
) -> None:
    """Remember marks on the object at pose (4, 4), of pixels that agree with it: those that have been `seen` to move,
    and new ones. None where a hand tells how it moves.
    """
    pixels, frame = sensed.looked.pixels, sensed.viewed
    state.marks = None
    if state.hand is None and len(pixels) and frame.index == state.index:
        off = model.field.distance(se3.apply(se3.inverse(pose), pixels.points))
        own = pixels.take(np.abs(off) < settings.near)
        state.marks = marked(frame, own.uv, own.area, None if seen is None else seen.marks, settings)
