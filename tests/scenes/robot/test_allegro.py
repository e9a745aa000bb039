"""A real hand: the Allegro hand as the wheel of `mani_skill` ships it, read at test time only.

    pip download --no-deps mani_skill -d wheels
    PALPATE_ALLEGRO_WHEEL=wheels/mani_skill-*.whl pytest tests/scenes/robot/test_allegro.py

Without the variable nothing is downloaded and everything here is skipped.
"""

from __future__ import annotations

import os
import zipfile
from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest

from scenes.geometry import poses
from scenes.robot.fingers import find_fingers
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.urdf import Joint, Robot
from scenes.synthesis.grasping.grasps import plan_grasp
from scenes.synthesis.library import make

WHEEL = Path(os.environ.get("PALPATE_ALLEGRO_WHEEL") or "no wheel")
FOLDER = "mani_skill/assets/robots/allegro/"
FINGERS = {"index": (0, 1, 2, 3), "middle": (4, 5, 6, 7), "ring": (8, 9, 10, 11), "thumb": (12, 13, 14, 15)}

pytestmark = pytest.mark.skipif(not WHEEL.is_file(), reason="PALPATE_ALLEGRO_WHEEL names no wheel of mani_skill")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("allegro")
    with zipfile.ZipFile(WHEEL) as wheel:
        wheel.extractall(out, [name for name in wheel.namelist() if name.startswith(FOLDER)])
    return out / FOLDER


def our_convention(hand: Hand) -> Hand:
    """The hand with its frame at the wrist, x along the fingers, z out of the palm, joints named by what they do, and
    a touch sensor in the shape of each fingertip's mesh.
    """
    names = {}
    for finger, numbers in FINGERS.items():
        roles = ("opposition", "cmc", "mcp", "ip") if finger == "thumb" else ("abduction", "mcp", "pip", "dip")
        names |= {f"joint_{n}.0": f"{finger}_{role}" for n, role in zip(numbers, roles)}
    joints = [replace(j, name=names.get(j.name, j.name)) for j in hand.robot.joints]
    # its own: z along the fingers, x out of the palm, origin between palm and fingers
    wrist = poses.make_pose(np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]), (0.098, 0.0, 0.0))
    root = Joint("mount", "fixed", "hand", hand.robot.root, wrist, np.array([1.0, 0.0, 0.0]))
    robot = Robot(hand.name, "hand", {"hand": (), **hand.robot.links}, (root, *joints))
    sensors = {}
    for finger, numbers in FINGERS.items():
        link = f"link_{numbers[-1]}.0_tip"
        shape = max(hand.robot.links[link], key=lambda s: len(s.vertices))
        surface = {"mesh": {"vertices": shape.vertices, "faces": shape.faces}}
        sensors[f"{finger}_tip"] = Sensor(f"{finger}_tip", link, "wrench", np.eye(4), surface)
    return Hand(robot, sensors)


@pytest.mark.parametrize("name", ["allegro_hand_left", "allegro_hand_right", "variation/allegro_hand_right_fsr_simple"])
def test_it_is_read(folder, name):
    hand = Hand.load(folder / f"{name}.urdf")
    assert len(hand.joint_names) == 16
    assert len(hand.link_names) in (23, 39)
    vertices, faces, _ = hand.mesh({})
    assert np.isfinite(vertices).all()
    assert 0.2 < np.ptp(vertices, axis=0).max() < 0.35
    assert len(faces) > 20_000
    tips = [hand.forward_kinematics({})[f"link_{n}.0_tip"][:3, 3] for n in (3, 7, 11, 15)]
    assert min(np.linalg.norm(a - b) for i, a in enumerate(tips) for b in tips[:i]) > 0.03


@pytest.mark.slow
def test_it_grasps(folder):
    hand = our_convention(Hand.load(folder / "allegro_hand_right.urdf"))
    assert len(find_fingers(hand)) == 4
    model = make("bottle")
    grasp = plan_grasp(hand, model, seed=1)
    assert len(grasp.contacts) >= 3
    object_from_hand = poses.inverse(grasp.hand_from_object)
    samples = poses.apply(object_from_hand, hand.points_on_surface(grasp.joints, 0.004))
    kind = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    assert igl.signed_distance(samples, model.vertices, model.faces, sign_type=kind)[0].min() > -1e-4
