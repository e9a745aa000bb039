"""A parallel gripper, made from a few lengths: two fingers with flat pads that slide apart, on a body and an arm.

Hand frame = link "body": origin between the fingers' roots, x along the fingers, y the way in which they open; metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from scenes.geometry import poses
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.urdf import Joint, Mimic, Robot, Shape, make_shape

NAME = "parallel_gripper"
JOINT = "finger_left_slide"


@dataclass(frozen=True)
class GripperShape:
    """Metres; sizes as those of two-finger grippers for arms that carry a few kilograms."""

    # Each finger: length along x, thickness along y (away from the object), width along z.
    finger: tuple[float, float, float] = (0.075, 0.014, 0.022)
    # Travel of one finger: the pads open by twice as much.
    travel: float = 0.055
    body: tuple[float, float, float] = (0.100, 0.150, 0.062)
    arm_radius: float = 0.042
    arm_length: float = 0.25


@cache
def parallel_gripper(shape: GripperShape | None = None) -> Hand:
    """The gripper with one driven joint (m: half the opening), its twin, and a sensor "left_pad", "right_pad" in each
    finger's inner face.
    """
    shape = shape or GripperShape()
    length, thickness, width = shape.finger
    behind = poses.make_pose(translation=(-shape.body[0] / 2, 0.0, 0.0))
    turned = poses.make_pose(poses.exp_rotation((0.0, np.pi / 2, 0.0)), (-shape.body[0] - shape.arm_length / 2, 0, 0))
    body = make_shape("box", shape.body, behind)
    arm = make_shape("cylinder", (shape.arm_radius, shape.arm_length), turned)
    links: dict[str, tuple[Shape, ...]] = {"body": (body, arm)}
    joints, sensors = [], {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        link = f"finger_{side}"
        middle = poses.make_pose(translation=(length / 2, sign * thickness / 2, 0.0))
        links[link] = (make_shape("box", shape.finger, middle),)
        mimic = None if side == "left" else Mimic(JOINT, 1.0)
        axis = np.array([0.0, sign, 0.0])
        joints.append(Joint(f"{link}_slide", "prismatic", "body", link, np.eye(4), axis, 0.0, shape.travel, mimic))
        pad = poses.make_pose(translation=(length - width / 2, 0.0, 0.0))
        sensors[f"{side}_pad"] = Sensor(f"{side}_pad", link, "point", pad)
    return Hand(Robot(NAME, "body", links, tuple(joints)), sensors)
