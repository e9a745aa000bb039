"""What fits between the fingers: grips, thicknesses, and starts near the truth without a single contact."""

import numpy as np
import pytest

from scenes.geometry import poses
from scenes.synthesis import library
from scenes.synthesis.gripper import parallel_gripper
from touch.held import Held, HeldSettings, grips, thicknesses


def test_a_gripper_has_one_grip_as_wide_as_it_is_open():
    hand = parallel_gripper()
    widths = []
    for joint in hand.limits[0]:
        _, axes, gaps = grips(hand, dict.fromkeys(hand.joint_names, float(joint)), -1.0)
        assert len(gaps) == 1
        np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0)
        widths.append(gaps[0])
    assert abs(widths[1] - widths[0]) > 0.01


def test_a_can_is_as_thick_as_its_diameter_and_its_height():
    can = library.make("cylinder")
    middles, lines, thick = thicknesses(can, HeldSettings())
    np.testing.assert_allclose(np.linalg.norm(lines, axis=1), 1.0, atol=1e-6)
    size = np.ptp(can.vertices, axis=0)
    near = np.abs(thick[:, None] - np.array([size.min(), size.max()])).min(axis=1)
    assert np.median(near) < 0.003
    assert np.linalg.norm(middles - can.centroid, axis=1).max() < can.diameter


def test_starts_lie_between_the_fingers_and_repeat(lab_frame, drill):
    camera_from_hand = lab_frame.camera_from_world @ lab_frame.world_from_hand
    held = Held(lab_frame.hand, lab_frame.joints, camera_from_hand)
    first, again = (held.starts(drill, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert len(first) > 50
    np.testing.assert_allclose(np.linalg.det(first[:, :3, :3]), 1.0, atol=1e-9)
    middle = poses.apply(lab_frame.camera_from_object_truth, drill.centroid[None])[0]
    away = np.linalg.norm(first[:, :3, :3] @ drill.centroid + first[:, :3, 3] - middle, axis=1)
    assert away.min() < 0.04
    assert np.median(away) < drill.diameter


def test_nothing_fits_into_a_closed_gap(lab_frame):
    thing = library.make("box")
    closed = HeldSettings(narrowest=1.0)
    held = Held(lab_frame.hand, lab_frame.joints, np.eye(4))
    assert held.starts(thing, np.random.default_rng(0), closed).shape == (0, 4, 4)


@pytest.mark.parametrize("seed", range(2))
def test_a_hand_without_touch_sensors_has_the_ends_of_its_chains(seed):
    from scenes.robot.hands import Hand

    gripper = parallel_gripper()
    bare = Hand(gripper.robot)
    joints = dict.fromkeys(bare.joint_names, float(gripper.limits[0, seed]))
    middles, axes, gaps = grips(bare, joints, -1.0)
    assert len(middles) == len(axes) == len(gaps) >= 1
    assert np.isfinite(middles).all()
