"""Grippers of the common kinds grasp: what their joints do is found from geometry, and refusals say the true reason."""

from __future__ import annotations

from dataclasses import replace

import grippers
import numpy as np
import pytest
import trimesh
from held import check_grasp

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.robot.fingers import closing_hand, find_fingers, reach_bounds
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.urdf import Joint, Robot
from scenes.synthesis.grasping.grasps import plan_grasp
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make
from scenes.synthesis.recording import synthesize_frames

KINDS = {
    "sliding, one drive": lambda folder: grippers.sliding(folder),
    "sliding, a drive each": lambda folder: grippers.sliding(folder, one_drive=False),
    "sliding, rising closes": lambda folder: grippers.sliding(folder, rising_opens=False),
    "turning": lambda folder: grippers.turning(folder),
    "turning, falling closes": lambda folder: grippers.turning(folder, sign=-1),
    "three fingers": lambda folder: grippers.three_fingers(folder),
    "three fingers, falling closes": lambda folder: grippers.three_fingers(folder, spread=False, sign=-1),
}


@pytest.fixture(scope="module", params=KINDS)
def gripper(request, tmp_path_factory) -> Hand:
    return KINDS[request.param](tmp_path_factory.mktemp("gripper"))


@pytest.mark.parametrize("name", ["cylinder", "box"])
def test_it_grasps(gripper, name):
    model = make(name)
    grasp = plan_grasp(gripper, model, seed=1)
    check_grasp(gripper, model, grasp, len(find_fingers(gripper)))
    assert grasp.force_closure
    again = plan_grasp(gripper, model, seed=1)
    assert again.joints == grasp.joints
    np.testing.assert_array_equal(again.hand_from_object, grasp.hand_from_object)


def test_closing_brings_the_tips_together(gripper):
    hand, signs = closing_hand(gripper)
    fingers = find_fingers(hand)
    assert all(way > 0 for finger in fingers for way in finger.ways)
    assert sum(finger.is_thumb for finger in fingers) == 1
    low, high = hand.limits.T
    start = np.where(np.isin(np.arange(len(low)), [j for f in fingers for j in f.closing]), low, 0.0)

    def width(share: float) -> float:
        frames = hand.link_poses(start + share * np.where(start == low, high - low, 0.0))
        tips = [frames[f.tip_link, :3, :3] @ f.centre + frames[f.tip_link, :3, 3] for f in fingers]
        return max(float(np.linalg.norm(a - b)) for a in tips for b in tips)

    assert width(0.2) < width(0.0)
    q = 0.5 * (low + high)
    np.testing.assert_allclose(hand.link_poses(q), gripper.link_poses(signs * q), atol=1e-12)


def test_no_point_outruns_the_bound(gripper):
    rng = np.random.default_rng(0)
    low, high = gripper.limits.T
    bounds = reach_bounds(gripper)
    points, _, link = gripper.surface_samples()
    for _ in range(20):
        q = rng.uniform(low, high)
        step = 1e-6 * rng.normal(size=len(q))
        a, b = gripper.link_poses(np.stack([q, q + step]))
        moved = np.einsum("nij,nj->ni", (b - a)[link][:, :3, :3], points) + (b - a)[link][:, :3, 3]
        assert (np.linalg.norm(moved, axis=1) <= (np.abs(step) @ bounds.T)[link] + 1e-12).all()


def test_one_finger_works_against_two(tmp_path):
    fingers = find_fingers(grippers.three_fingers(tmp_path))
    assert [finger.is_thumb for finger in fingers] == [False, False, True]
    assert [len(finger.closing) for finger in fingers] == [1, 1, 1]  # the spread closes nothing


def test_the_links_of_one_drive_belong_to_their_sides(tmp_path):
    hand = grippers.turning(tmp_path)
    for finger, side in zip(find_fingers(hand), ("left", "right")):
        assert {hand.link_names[row] for row in finger.links} == {side, f"{side}_knuckle", f"{side}_rod"}


def ours_as_a_stranger(turned: tuple[str, ...] = ()) -> Hand:
    """The five-finger hand with names that say nothing, some joints measured the other way, its frame elsewhere."""
    hand = five_finger_hand()
    number = {joint.name: f"j{i}" for i, joint in enumerate(hand.robot.joints)}
    joints = []
    for joint in hand.robot.joints:
        way = -1.0 if joint.name in turned else 1.0
        mimic = joint.mimic
        if mimic is not None:
            factor = -mimic.multiplier if mimic.joint in turned else mimic.multiplier
            mimic = replace(mimic, joint=number[mimic.joint], multiplier=factor)
        low, high = sorted((way * joint.lower, way * joint.upper))
        joints.append(
            replace(joint, name=number[joint.name], axis=way * joint.axis, lower=low, upper=high, mimic=mimic)
        )
    mount = Joint(
        "mount", "fixed", "flange", "palm", poses.exp(np.array([0.4, 1.2, -0.7, 0.1, 0.0, 0.2])), np.eye(3)[0]
    )
    robot = Robot("stranger", "flange", {"flange": (), **hand.robot.links}, (mount, *joints))
    sensors = [
        Sensor(f"s{i}", s.link, s.kind, s.link_from_sensor, s.surface) for i, s in enumerate(hand.sensors.values())
    ]
    return Hand(robot, {sensor.name: sensor for sensor in sensors})


@pytest.mark.parametrize("turned", [(), ("index_mcp", "index_pip", "thumb_mcp", "ring_mcp")])
def test_a_hand_with_names_that_say_nothing(turned):
    hand, ours = ours_as_a_stranger(turned), five_finger_hand()
    number = {joint.name: f"j{i}" for i, joint in enumerate(ours.robot.joints)}
    for finger, known in zip(find_fingers(hand), find_fingers(ours)):
        assert finger.is_thumb == known.is_thumb == (known.sensor == "thumb_tip")
        names = [ours.joint_names[j] for j in known.closing]
        assert [hand.joint_names[j] for j in finger.closing] == [number[name] for name in names]
        assert finger.ways == tuple(-1.0 if name in turned else 1.0 for name in names)


@pytest.mark.slow
def test_a_stranger_grasps():
    hand, model = ours_as_a_stranger(("index_mcp", "index_pip", "thumb_mcp", "ring_mcp")), make("cylinder")
    check_grasp(hand, model, plan_grasp(hand, model, seed=1), 3)


def crate(*size: float) -> ObjectModel:
    mesh = trimesh.creation.box(extents=size)
    return ObjectModel.from_mesh(np.array(mesh.vertices), np.array(mesh.faces), name="crate")


def test_refusals_name_the_opening_and_the_width(tmp_path):
    hand = grippers.turning(tmp_path)
    plan_grasp(hand, crate(0.056, 0.09, 0.12))  # a gripper of 125 mm holds 56 mm
    with pytest.raises(InputError, match=r"less than 116 mm .*tips open 124 mm wide, got 'crate' with 1[23]\d mm"):
        plan_grasp(hand, crate(0.13, 0.14, 0.15))
    with pytest.raises(InputError, match=r"more than 31 mm .* close no further, got 'crate' with 2[0-3] mm"):
        plan_grasp(hand, crate(0.02, 0.02, 0.02))


def test_what_is_missing_is_said(tmp_path):
    hand = grippers.sliding(tmp_path)
    bare = {name: replace(sensor, surface=None) for name, sensor in hand.sensors.items()}
    with pytest.raises(InputError, match="got none: sensor 'left_pad' has no surface"):
        find_fingers(Hand(hand.robot, bare))
    with pytest.raises(InputError, match="got left_pad: only one tip sensor"):
        find_fingers(Hand(hand.robot, {"left_pad": hand.sensors["left_pad"]}))


def test_a_capture_of_a_gripper(tmp_path):
    hand = grippers.turning(tmp_path)
    (frame,) = synthesize_frames(make("cylinder"), hand, occlusion=0.3, noise="none", seed=2, settings=None)[:1]
    assert sorted(frame.contacts.sensors) == ["left_pad", "right_pad"]
    assert set(frame.joints) == {"drive"}
