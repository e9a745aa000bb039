"""What the image shows of an object's motion where no hand tells of it. Camera frame, metres, radians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.filter import Belief
from fusion.tracking.state import TrackState
from fusion.tracking.steps.sensing import Sensed
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.tracking.by_image import Marks, MarkSettings, marked, motion_between
from vision.tracking.by_vision import ConstantVelocity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shown:
    """A motion that marks in the image have made: motion (4, 4) camera_from_camera, covariance (6, 6) about where the
    object's centroid has moved to, and the marks that were found.
    """

    motion: Array
    covariance: Array
    marks: Marks

    def beside(self, model: ObjectModel, before: Array, pose: Array, noise: Array) -> tuple[Array, Array]:
        """Where an object at `before` (4, 4) is, by this and by what else is expected of it: pose (4, 4), known to
        covariance noise (6, 6); and the covariance of both together.
        """
        seen = model.symmetries.nearest(self.motion @ before, pose)
        apart = se3.difference(seen, pose, model.centroid)
        gain = np.linalg.solve(noise + self.covariance, noise).T
        both = noise - gain @ noise
        return se3.perturb(pose, gain @ apart, model.centroid), 0.5 * (both + both.T)


def shown_motion(
    model: ObjectModel,
    frame: Frame,
    belief: Belief,
    state: TrackState,
    velocity: ConstantVelocity,
    settings: MarkSettings,
) -> Shown | None:
    """How the image shows the object to have moved since the last frame; None where a hand tells, or nothing does."""
    if state.marks is None or state.hand is not None or state.marks.index != state.index or frame.index <= state.index:
        return None
    expected = velocity.predict(frame.index)[0] @ se3.inverse(belief.pose)
    centre = se3.apply(belief.pose, model.centroid[None])[0]
    found = motion_between(state.marks, frame, expected, centre, settings)
    return None if found is None else Shown(found.motion, found.covariance, found.marks)


def mark(
    model: ObjectModel, sensed: Sensed, pose: Array, shown: Shown | None, state: TrackState, settings: MarkSettings
) -> None:
    """Remember marks on the object at pose (4, 4), of pixels that agree with it: those that have `shown` how it moved,
    and new ones. None where a hand tells how it moves.
    """
    pixels, frame = sensed.looked.pixels, sensed.viewed
    state.marks = None
    if state.hand is None and len(pixels) and frame.index == state.index:
        off = model.field.distance(se3.apply(se3.inverse(pose), pixels.points))
        own = pixels.take(np.abs(off) < settings.near)
        state.marks = marked(frame, own.uv, own.area, None if shown is None else shown.marks, settings)
