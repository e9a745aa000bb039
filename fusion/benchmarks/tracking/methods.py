"""What each method says of one frame after another. camera_from_object, metres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

METHODS = (
    "icp", "particle filter", "vision", "estimate", "track", "track by vision", "track by touch", "track without hand",
    "track begun wrong", "track begun off",
)  # fmt: skip
# Tracks that use one sense of the two; both know of the hand.
OF_ONE_SENSE = {"track by vision": "vision", "track by touch": "touch"}
# Single frames have no memory, so that some of a sequence speak for all: every so many.
SINGLE_EVERY = 5
# Frames at a sequence's end whose rotation is what it ends with; single frames are asked of each of them, too.
END = 5
# Wrong beginnings: turned by so much about a random axis through the object (rad), and this far off (m). One lies the
# other way round, one is as far off as a start that no estimate has mended.
WRONG_STARTS = {
    "track begun wrong": (float(np.deg2rad(150.0)), 0.01),
    "track begun off": (float(np.deg2rad(20.0)), 0.035),
}


@dataclass(frozen=True)
class Said:
    """What a method said of one frame."""

    pose: Array
    covariance: Array | None = None
    ok: bool = True
    slip: bool = False
    moved: bool = False
    again: bool = False


Step = Callable[["Frame"], Said | None]


def stepper(method: str, model: ObjectModel, seed: int, last: int) -> Step:
    """What a method does with one frame after another; last: index of the last one."""
    makers = {"icp": _icp, "particle filter": _particles, "vision": _vision, "track": _track}
    makers["track without hand"] = _no_hand
    if method in OF_ONE_SENSE:
        return _track(model, seed, (OF_ONE_SENSE[method],))
    if method == "estimate":
        return _estimate(model, seed, last)
    if method in WRONG_STARTS:
        return _begun_wrong(model, seed, *WRONG_STARTS[method])
    return makers[method](model, seed)


def _icp(model: ObjectModel, seed: int) -> Step:
    """Point-to-plane ICP from the last pose, on our segmentation; no velocity, no loss detection."""
    from vision.look.look import object_points
    from vision.published.icp import icp

    pose: Array | None = None

    def step(frame: Frame) -> Said:
        nonlocal pose
        start = pose if pose is not None else frame.prior
        assert start is not None
        pose = icp(object_points(frame, model, start), model, start).pose
        return Said(pose)

    return step


def _particles(model: ObjectModel, seed: int) -> Step:
    from vision.tracking.by_vision import VisionTracker
    from vision.tracking.particles import ParticleTracker

    tracker: ParticleTracker | None = None

    def step(frame: Frame) -> Said:
        nonlocal tracker
        if tracker is None:
            tracker = ParticleTracker(model, VisionTracker(model, seed=seed).step(frame).pose, seed=seed)
        return Said(tracker.step(frame))

    return step


def _vision(model: ObjectModel, seed: int) -> Step:
    from vision.tracking.by_vision import VisionTracker

    tracker = VisionTracker(model, seed=seed)

    def step(frame: Frame) -> Said:
        found = tracker.step(frame)
        return Said(found.pose, found.covariance, not found.lost, again=found.how == "re-initialised")

    return step


def _estimate(model: ObjectModel, seed: int, last: int) -> Step:
    """Every so many frames by itself, and those at the end, from a start as far off as the first frame's."""
    from fusion.estimation.estimate import estimate
    from scenes.geometry import poses
    from scenes.synthesis.recording import SynthesisSettings

    start = SynthesisSettings()

    def step(frame: Frame) -> Said | None:
        truth = frame.camera_from_object_truth
        assert truth is not None
        if frame.index % SINGLE_EVERY and frame.index <= last - END:
            return None
        rng = np.random.default_rng([seed, frame.index])
        prior = poses.displaced(truth, start.prior_angle, start.prior_distance, model.centroid, rng)
        answer = estimate(frame, model, prior, seed=seed)
        return Said(answer.pose, answer.covariance, answer.verdict == "ok")

    return step


def _track(model: ObjectModel, seed: int, use: tuple[str, ...] = ("vision", "touch")) -> Step:
    from fusion.tracking.tracker import Tracker

    tracker = Tracker(model, use=use, seed=seed)

    def step(frame: Frame) -> Said:
        answer = tracker.step(frame)
        again = answer.how == "re-initialised"
        ok = answer.verdict == "ok"
        return Said(answer.pose, answer.covariance, ok, answer.slip, answer.moved_in_hand, again)

    return step


def _no_hand(model: ObjectModel, seed: int) -> Step:
    """The track, of frames from which the hand's model and pose and what it feels are taken away."""
    from dataclasses import replace

    track = _track(model, seed)

    def step(frame: Frame) -> Said | None:
        bare = replace(frame.without_touch(), hand=None, joints=None, world_from_hand=None)
        return track(bare)

    return step


def _begun_wrong(model: ObjectModel, seed: int, turn: float, distance: float) -> Step:
    """The track, made to believe in its first frame that the object is turned (rad) and displaced (m) by so much, and
    to be sure of it.
    """
    from dataclasses import replace

    from fusion.estimation.estimate import estimate
    from fusion.tracking.tracker import Tracker
    from scenes.geometry import poses

    tracker, begun = Tracker(model, seed=seed), False

    def step(frame: Frame) -> Said:
        nonlocal begun
        if begun:
            answer = tracker.step(frame)
            return Said(answer.pose, answer.covariance, answer.verdict == "ok")
        begun = True
        truth = frame.camera_from_object_truth
        assert truth is not None
        rng = np.random.default_rng([seed, 7])
        wrong = poses.displaced(truth, turn, distance, model.centroid, rng)
        found = estimate(frame, model, wrong, seed=seed)
        mode = replace(found.modes[0], pose=wrong, weight=1.0)
        tracker.believe(frame, replace(found, pose=wrong, modes=(mode,), verdict="ok", confidence=0.95))
        return Said(wrong, found.covariance, True)

    return step
