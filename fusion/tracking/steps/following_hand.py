"""What a hand that is told does not hold stays where it was, and is not predicted to go with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve.joint import JointResult
from fusion.tracking.answer import Because
from fusion.tracking.filter import Belief
from fusion.tracking.memory import hypotheses as several
from fusion.tracking.memory.held import ELSEWHERE, Instant, shown
from fusion.tracking.memory.reach import out_of_reach
from fusion.tracking.memory.rest import MOVES, TELLS
from fusion.tracking.memory.state import TrackState
from fusion.tracking.slip import SlipWatch
from fusion.tracking.steps.doubts.delays import put_down
from fusion.tracking.steps.sensing import Sensed
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.look.hand.hand import camera_from_hand
from vision.tracking.by_vision import ConstantVelocity

Array = NDArray[np.float64]

SEEN_PAST: Because = ("the camera sees past where it would be", "")


def seen_past(
    model: ObjectModel, frame: Frame, pose: Array, sensed: Sensed | None, because: Because
) -> tuple[bool, Because]:
    """Whether the depth image of a frame that tells nothing of the object shows that it is not at a pose (4, 4) either:
    it sees farther there. And why nothing is told of it: otherwise because .... sensed: at the last look in full.
    """
    past = bool(shown(model, frame, _seen_from(sensed) @ pose) <= ELSEWHERE)
    return past, SEEN_PAST if past else because


def with_hand_or_not(
    model: ObjectModel,
    frame: Frame,
    world: Array,
    belief: Belief,
    state: TrackState,
    velocity: ConstantVelocity,
    watch: SlipWatch,
    correction: Array | None,
    sensed: Sensed | None,
) -> Belief:
    """The belief of the frame before, at the place where the object has stayed if this frame's depth image shows that
    the hand moves without it; the state remembers whether it does, and what goes on from there by itself.

    world (4, 4): camera_from_world as it was told, whatever has been made of a late image's. correction (4, 4):
    camera_from_camera of what the robot reports, None where nothing has told it. sensed: at the last look in full,
    which knows by how much images are off that all frames share.
    """
    if frame.index > state.index:
        _reaches(model, frame, belief, state, correction)
        alone = state.hand is None and state.unseen == 0
        state.rest = state.rest.followed(model, belief.pose if alone else None, world, state.apart)
        put_down(state)
    hand = camera_from_hand(frame)
    if hand is not None and frame.index > state.index and _has_opened(model, frame, state):
        state.released, state.hand = True, None
    if hand is None or frame.depth is None or frame.index <= state.index:
        return belief
    last = state.held.last
    seen = state.unseen == 0 and last is not None and last.index == state.index
    now = Instant(frame.index, world, hand)
    pose = belief.pose if seen else None
    state.held, stayed = state.held.followed(model, frame, now, pose, correction, _seen_from(sensed))
    if stayed is None:
        return belief
    assert last is not None
    # as the camera had it in the frame before
    before = last.world @ se3.inverse(world) @ stayed
    motion = before @ se3.inverse(belief.pose)
    state.belief = replace(belief.moved(motion), pose=before)
    state.hypotheses, state.hand, state.known = several.moved(state.hypotheses, motion), None, None
    velocity.restart(state.index, before)
    watch.let_go()
    return state.belief


def resting(model: ObjectModel, solved: JointResult, sensed: Sensed, state: TrackState) -> JointResult:
    """A frame's solution, where the object has been at rest if the picture of the frame is not better where it was
    found. A hand that is near may push it: then the picture must show enough of it to tell.
    """
    there = None if sensed.pool is None else state.rest.left(model, solved.pose)
    if there is None or sensed.pool is None:
        return solved
    there = model.symmetries.nearest(there, solved.pose)
    seen = solved.as_seen @ se3.inverse(solved.pose) @ there
    near = sensed.told_apart and not state.apart
    if near and sensed.pool.predictor.predict(seen[None]).agree[0] < TELLS:
        return solved
    found, rest = sensed.pool.predictor.costs(np.array([solved.as_seen, seen]))
    return solved if rest > found + MOVES else replace(solved, pose=there, as_seen=seen)


def _seen_from(sensed: Sensed | None) -> Array:
    """(4, 4) that takes a pose to where the depth image, uncorrected, shows it."""
    return np.eye(4) if sensed is None else sensed.seen_from


def _reaches(model: ObjectModel, frame: Frame, belief: Belief, state: TrackState, correction: Array | None) -> None:
    """Let go of an object that the last answer surely had where the hand was clear of it, until the hand is not."""
    at = state.held.last.hand if state.held.last is not None else None
    if state.hand is not None:
        at = state.hand.camera_from_hand
    clear = False
    if at is not None:
        clear = out_of_reach(model, frame, belief.pose, at if correction is None else correction @ at)
    state.apart = clear and (state.apart or state.sure)
    if state.apart:
        state.hand = None


def _has_opened(model: ObjectModel, frame: Frame, state: TrackState) -> bool:
    """Whether the fingers have left the object since they felt it, and feel nothing."""
    if state.released or state.touched is None or len(frame.contacts.points):
        return False
    return state.touched.has_opened(model, frame)
