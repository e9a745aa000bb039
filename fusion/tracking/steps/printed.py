"""Which way round a tracked object is, as its print has it. Camera frame, metres.

A track keeps the way round that it began with, and geometry alone never doubts it. So frames that are looked at in full
are asked for what is printed; where that decides, the answer turns to it. Another way round of the same shape costs
every other sense the same, so nothing else changes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.estimation.answer import Estimate
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.steps.facing import as_seen_printed
from fusion.tracking.answer import TrackedEstimate, TrackSettings
from fusion.tracking.memory.state import TrackState
from fusion.tracking.slip import SlipWatch
from fusion.tracking.steps.sensing import Sensed, part_with_colours
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from vision.tracking.by_vision import ConstantVelocity


def as_printed(
    model: ObjectModel,
    sensed: Sensed | None,
    state: TrackState,
    moving: tuple[ConstantVelocity, SlipWatch],
    answer: TrackedEstimate,
    settings: TrackSettings,
) -> TrackedEstimate:
    """The answer of a tracked frame the way round that the object's print shows, and the track's state with it; as it
    was where no print decides, or none is looked at: none on the mesh, no colours, only a glance at the frame.
    """
    how = settings.first.texture
    if model.texture is None or not how.used or model.symmetries.is_spherical:
        return answer
    if answer.how != "tracked" or answer.verdict == "lost" or state.belief is None or state.index != answer.frame:
        return answer
    if sensed is None or sensed.pool is None or sensed.viewed.index != answer.frame or sensed.viewed.rgb is None:
        return answer
    if not sensed.pool.predictor.sees:
        return answer
    told, facing = as_seen_printed(part_with_colours(sensed), model, sensed.pool.predictor, answer.pose, how)
    if not facing.decides(how):
        return replace(answer, print_share=facing.share)
    off = float(se3.rotation_angle(answer.pose[:3, :3].T @ told[:3, :3]))
    if off <= (how.same if np.isnan(facing.turn) else max(how.least_turn, 2.0 * facing.turn)):
        return replace(answer, print_share=facing.share)
    state.belief = replace(state.belief, pose=told)
    state.hypotheses = replace(state.hypotheses[0], pose=told), *state.hypotheses[1:]
    state.known = None
    velocity, watch = moving
    velocity.restart(answer.frame, told)
    watch.restart()
    turn = se3.inverse(answer.pose) @ told
    in_hand = None if answer.hand_from_object is None else answer.hand_from_object @ turn
    modes = replace(answer.modes[0], pose=told), *answer.modes[1:]
    return replace(answer, pose=told, modes=modes, hand_from_object=in_hand, print_share=facing.share)


def as_before(model: ObjectModel, found: Estimate, lost: Estimate, settings: EstimateSettings) -> Estimate:
    """An estimate of an object that was lost, the way round nearest to where it was, unless its print tells."""
    if found.print_share >= settings.texture.decides:
        return found
    pose = model.symmetries.nearest(found.pose, lost.pose)
    turn = se3.inverse(found.pose) @ pose
    in_hand, as_seen = (None if one is None else one @ turn for one in (found.hand_from_object, found.as_seen))
    modes = replace(found.modes[0], pose=pose), *found.modes[1:]
    return replace(found, pose=pose, modes=modes, hand_from_object=in_hand, as_seen=as_seen)
