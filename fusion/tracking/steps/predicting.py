"""Where the object and its hypotheses are in the next frame, before anything is sensed in it. Camera frame, metres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.answer import Because, TrackSettings
from fusion.tracking.filter import Belief
from fusion.tracking.memory import hypotheses as several
from fusion.tracking.memory.hypotheses import Hypotheses
from fusion.tracking.memory.state import TrackState
from fusion.tracking.motion import HandMotion, calibration_drift, drift_since
from fusion.tracking.slip import SlipWatch
from fusion.tracking.steps.marking import with_marks
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import CalibrationModel
from scenes.recordings.frames import Frame
from vision.look.hand.hand import camera_from_hand
from vision.look.pixels import median, read_pixels
from vision.look.regions import in_front
from vision.tracking.by_image import Motion
from vision.tracking.by_vision import ConstantVelocity

Array = NDArray[np.float64]

SHOWN_ELSEWHERE: Because = ("the mask shows it elsewhere", "moved there")
# Readings of a mask, and points of the surface, that are compared.
_READINGS = 400
_SURFACE = 200


@dataclass(frozen=True)
class Predicted:
    """The leader's belief, all hypotheses, and what they went with, in words."""

    belief: Belief
    hypotheses: Hypotheses
    why: str


def predict(
    model: ObjectModel,
    frame: Frame,
    belief: Belief,
    state: TrackState,
    velocity: ConstantVelocity,
    hand_motion: HandMotion,
    watch: SlipWatch,
    calibration: CalibrationModel,
    correction: Array | None,
    seen: Motion | None = None,
) -> Predicted:
    """With the palm and the fingertips where the robot tells of them, else at the last velocity and as it is `seen` to
    have moved; `watch` is told.

    correction (4, 4): camera_from_camera of what the robot reports, as the image has shown it; None where it has not.
    """
    now = camera_from_hand(frame)
    if state.hand is None or now is None:
        state.lateness = state.lateness.unmoved
        pose, noise = velocity.predict(frame.index)
        why = "at its last velocity"
        if seen is not None:
            pose, noise = with_marks(model, seen, belief.pose, pose, noise)
            why = f"as {len(seen.marks.uv)} marks in the image have moved"
        motion = pose @ se3.inverse(belief.pose)
        watch.restart()  # nothing holds it that could lose it
        moved = replace(belief.moved(motion), pose=pose)
        carried = several.moved(state.hypotheses, motion)
        return Predicted(moved.widened(noise), carried, why)
    before, right = state.hand.camera_from_hand, np.eye(4) if correction is None else correction
    told = state.seen_at is None or np.array_equal(state.seen_at, before)
    before, now = right @ before, right @ now
    motion = now @ se3.inverse(before)
    hold = se3.inverse(before) @ belief.pose
    steps = max(1, abs(frame.index - state.index))
    along = np.asarray(se3.difference(motion @ belief.pose, belief.pose, model.centroid), dtype=np.float64)
    state.lateness = state.lateness.moving(along, frame.index, state.index)
    expected = hand_motion.in_hand(state.hand, frame, hold, steps)
    expected = expected.turned(now[:3, :3])
    moved = belief.moved(motion)
    centre = se3.apply(moved.pose, model.centroid[None])[0]
    left = hand_motion.settings.left(correction is not None)
    drift = left * calibration_drift(before, now, centre, calibration)
    watch.predict(motion, expected, drift)
    if state.seen_at is not None and not told:
        # no camera has told in between what the calibration did
        drift = np.maximum(drift, left * drift_since(right @ state.seen_at, before, now, centre, calibration))
    delta, noise = expected.motion, expected.noise + drift
    whole = se3.perturb(motion @ belief.pose, delta, model.centroid) @ se3.inverse(belief.pose)
    fingers = f"with palm and fingertips, {1e3 * np.linalg.norm(delta[3:]):.2f} mm"
    why = fingers if delta.any() else "with the palm"
    return Predicted(moved.shifted(delta, noise, model.centroid), several.moved(state.hypotheses, whole), why)


def as_moved(model: ObjectModel, ahead: Predicted, pose: Array) -> Predicted:
    """The prediction of a frame that has been solved to a pose (4, 4) farther from it than it knew: all of it there,
    and as unsure as the two are apart.
    """
    belief = ahead.belief
    apart = se3.difference(pose, belief.pose, model.centroid)
    motion = pose @ se3.inverse(belief.pose)
    there = replace(belief.moved(motion), pose=pose)
    wide = replace(there, own=there.own + np.outer(apart, apart))
    far = f"{ahead.why}, and {1e3 * np.linalg.norm(apart[3:]):.0f} mm from there"
    return Predicted(wide, several.moved(ahead.hypotheses, motion), far)


def where_shown(
    model: ObjectModel, frame: Frame, ahead: Predicted, state: TrackState, settings: TrackSettings
) -> Predicted | None:
    """The prediction, moved to where the frame's mask shows the object and turned as it was, when that is elsewhere and
    no hand tells how it moves; None otherwise. Of mask and surface the middles are compared.

    A camera at a few images a second sees a thing move by its own size between two. A frame that came late begins
    nothing anew.
    """
    camera, slack = frame.camera, settings.look.slack
    if state.hand is not None or frame.mask is None or frame.depth is None or camera is None:
        return None
    if frame.index < state.index:
        return None
    shown = read_pixels(frame.depth, camera, (0, 0, camera.width, camera.height), _READINGS, frame.mask).points
    if len(shown) < settings.fewest_pixels:
        return None
    shown, pose = in_front(shown, model.diameter + slack, settings.first.look.seen_through), ahead.belief.pose
    if _near(model, shown, pose, slack) >= settings.shown:
        return None
    points, normals = model.sample_surface(_SURFACE)
    points = se3.apply(pose, points)
    # what faces the camera is seen by as much of it as it turns towards it
    weight = np.maximum(-np.einsum("ij,ij->i", normals @ pose[:3, :3].T, points), 0.0)
    total = float(weight.sum())
    if not total > 0.0:
        return None
    there = pose.copy()
    there[:3, 3] += median(shown) - weight @ points / total
    return as_moved(model, ahead, there) if _near(model, shown, there, slack) >= settings.shown else None


def _near(model: ObjectModel, points: Array, pose: Array, reach: float) -> float:
    """Share of points (n, 3), one at least, nearer than `reach` (m) to the surface at a pose (4, 4)."""
    return float((np.abs(model.field.distance(se3.apply(se3.inverse(pose), points))) < reach).mean())
