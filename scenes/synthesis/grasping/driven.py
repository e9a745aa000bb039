"""Grippers with one drive: all fingers close together, and the object slides until every tip touches.

A finger that meets the object first pushes it along; the grasp is closed when the last tip has met it. The hand is one
of `scenes.robot.fingers.closing_hand`: its drive closes as it rises. Hand frame, metres, radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.robot.fingers import Finger, reach_bounds
from scenes.synthesis.grasping.closing import TOUCH, ExactClosing

Array = NDArray[np.float64]

# Pushes before a grasp is given up: each halves what the last tip is away, from 20 mm to below TOUCH in ten.
PUSHES = 30
# A tip farther than this (m) from an object that another tip already pushes has missed it.
LOST = 0.05


def is_driven(fingers: tuple[Finger, ...]) -> bool:
    """Whether one joint closes several of the fingers."""
    columns = [j for finger in fingers for j in finger.closing]
    return len(set(columns)) < len(columns)


def close_driven(
    exact: ExactClosing, hand_from_object: Array, start: Array
) -> tuple[Array, Array, dict[str, tuple[Array, Array]]] | None:
    """Close from `start` (j,) until every tip touches: hand_from_object (4, 4) as the fingers leave it, joint values
    (j,), and for each tip the point and outward normal, object frame. None when something is in the way.
    """
    q, pose = start.copy(), hand_from_object.copy()
    direction = np.zeros_like(q)
    for finger in exact.fingers:
        direction[list(finger.closing)] = 1.0
    rows = sorted({row for finger in exact.fingers for row in finger.links})
    bound = float((direction @ reach_bounds(exact.hand).T)[rows].max())
    if bound <= 0:
        return None
    for _ in range(PUSHES):
        points = poses.apply(pose, exact.object_points)

        def clearance(s: float, at: Array = pose, base: Array = q, points: Array = points) -> float:
            return min(exact.clearance(finger, base + s * direction, at, points) for finger in exact.fingers)

        if clearance(0.0) < 0:
            return None
        closing = direction > 0
        end = float(((exact.hand.limits[:, 1] - q)[closing] / direction[closing]).min())
        q = q + exact.advance(clearance, bound, end) * direction
        tips = {finger.sensor: exact.tip_contact(finger, q, pose) for finger in exact.fingers}
        met = [name for name, (_, _, gap) in tips.items() if gap < 2 * TOUCH]
        farthest = max(gap for _, _, gap in tips.values())
        if not met or farthest > LOST:  # at the limit, or a link is in the way of the tips
            return None
        if len(met) == len(tips):
            if exact.is_blocked(q, pose):
                return None
            return pose, q, {name: (point, normal) for name, (point, normal, _) in tips.items()}
        push = -np.sum([pose[:3, :3] @ tips[name][1] for name in met], axis=0)
        length = float(np.linalg.norm(push))
        if length < 1e-6:
            return None
        nearest = min(gap for name, (_, _, gap) in tips.items() if name not in met)
        pose = pose.copy()
        pose[:3, 3] += max(0.5 * nearest, TOUCH) * push / length
    return None
