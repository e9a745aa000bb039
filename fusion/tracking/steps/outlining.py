"""A tracked frame's joint solution moved to where the image beside depth shows its outline. Camera frame, metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.estimation.answer import Mode
from fusion.estimation.solve.joint import JointResult
from fusion.estimation.solve.outlined import asks_for, outlined
from fusion.estimation.trace import Trace
from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import positive_part, scales
from fusion.tracking.steps.sensing import Sensed, part_with_colours
from scenes.geometry import poses as se3
from scenes.recordings.beliefs import Beliefs


def with_outline(
    solved: JointResult, sensed: Sensed, beliefs: Beliefs, settings: TrackSettings, trace: Trace
) -> JointResult:
    """The solution with what lines across the outline say, as for an estimate; as it was where they say nothing.

    It narrows what frames share: a mesh's error, light and the lens are in the next image, too, and so is what it adds.
    Their noise stays that of the rows, by which most frames are followed (`steps.glancing`), and so does how far a
    depth bias moves these from place to place.
    """
    pool, viewed, first = sensed.pool, sensed.viewed, settings.first
    why_not = "no picture of it"
    if pool is not None and pool.predictor.sees:
        why_not = "no image beside depth" if viewed.rgb is None else ""
        if viewed.rgb is not None and not asks_for(viewed.rgb, beliefs, first.contour):
            why_not = "an image beside depth's own is not asked for"
    with trace.stage("outline", not why_not, why_not) as stage:
        if why_not or pool is None:
            return solved
        # what the frame does not tell is as wide as the object without the prediction: with it, little of that leaks
        mode = Mode(solved.pose, 1.0, 0.0, solved.covariance)
        told = outlined(part_with_colours(sensed), pool, solved, mode, beliefs, first)
        stage.note(told.lines, told.why)
        if not told.lines:
            return solved
        shared = solved.shared + solved.unsolved + (told.mode.covariance - solved.covariance)
        moved = se3.difference(told.mode.pose, solved.pose, pool.model.centroid)
        return replace(
            told.solved,
            pose=told.mode.pose,
            as_seen=se3.perturb(solved.as_seen, moved, pool.model.centroid),
            covariance=told.mode.covariance,
            shared=positive_part(shared, scales(pool.model)),
            unsolved=np.zeros((6, 6)),
        )
