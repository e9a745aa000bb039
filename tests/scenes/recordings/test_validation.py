"""What contradicts itself is suspected: units, frames, images without a reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_frames import some_frame

from scenes.errors import CaptureError
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.recordings.captures import write_capture
from scenes.recordings.checking.validation import check_scale, scale_problem, validate
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make


def test_an_empty_depth_image_is_a_problem(tmp_path):
    blank = replace(some_frame(0), depth=np.zeros((48, 64), np.float32))
    write_capture(tmp_path / "c", [blank], make("box"))
    assert any("an image of zeros" in problem.message for problem in validate(tmp_path / "c"))


def test_wrong_units_are_suspected():
    model, frame = make("box"), some_frame(0)
    assert scale_problem(frame, model) is None
    check_scale(frame, model)
    touched = replace(frame, contacts=Contacts(frame.contacts.points * 1e3), camera_from_object_truth=None, prior=None)
    with pytest.raises(CaptureError, match=r"contacts spread over .* an object of 0.175.*mm read as m"):
        check_scale(touched, model)
    for factor in (1e3, 1e2, 1e-2, 1e-3):
        assert "cloud" in (scale_problem(replace(frame, cloud=frame.cloud * factor), model) or "")
    few = replace(frame, cloud=frame.cloud[:5], cloud_colours=None)
    assert scale_problem(few, model) is None
    assert "mm read as m?" in (scale_problem(replace(few, cloud=few.cloud * 1e3), model) or "")
    deep = replace(frame, depth=frame.depth * 1e3)
    assert "depth readings no nearer than" in (scale_problem(deep, model) or "")
    assert "is" not in (scale_problem(replace(frame, prior=frame.camera_from_object_truth), model) or "")
    far = frame.camera_from_object_truth.copy()
    far[:3, 3] *= 1e3
    assert "the prior" in (scale_problem(replace(frame, prior=far), model) or "")  # beside a truth that is right


@pytest.mark.parametrize("unit", [1 / 640, 6e-6 / 1e-3, 1e3], ids=["of the image's width", "millimetres", "thousands"])
def test_focal_lengths_that_are_not_pixels_are_suspected(unit):
    frame = some_frame(0)
    for fx, fy in ((unit, unit), (1.0, unit)):
        camera = replace(frame.camera, fx=frame.camera.fx * fx, fy=frame.camera.fy * fy)
        assert "expected cam_K in pixels" in (scale_problem(replace(frame, camera=camera), make("box")) or "")


def test_joints_in_degrees_are_suspected(tmp_path):
    hand, model = five_finger_hand(), make("box")
    held = replace(some_frame(0), hand=hand, joints=dict.fromkeys(hand.joint_names, 0.5), world_from_hand=np.eye(4))
    assert scale_problem(held, model) is None
    turned = replace(held, joints={name: np.rad2deg(value) for name, value in held.joints.items()})
    assert "degrees read as rad?" in (scale_problem(turned, model) or "")


def test_contacts_far_from_their_sensors_are_a_problem(tmp_path):
    hand = five_finger_hand()
    joints = dict.fromkeys(hand.joint_names, 0.2)
    held = replace(some_frame(0), hand=hand, joints=joints, world_from_hand=poses.make_pose(translation=[0, 0, 0.6]))
    places = hand.hand_from_sensor(joints)
    names = list(places)[:3]
    points = np.array([(held.world_from_hand @ places[name])[:3, 3] for name in names]) + 0.005
    held = replace(held, contacts=Contacts(points, sensors=names))

    def said(frame):
        return str(validate(write_capture(tmp_path / "c", [frame], make("box"), hand=hand)))

    assert "the hand's sensors" not in said(held)
    inverted = replace(held, world_from_hand=poses.inverse(held.world_from_hand))
    assert "got 1.2 m off: is its pose inverted?" in said(inverted)
    strangers = replace(inverted, contacts=Contacts(points, sensors=["a", "b", "c"]))
    assert "the hand's sensors" not in said(strangers)


def test_something_near_the_lens_is_no_wrong_unit():
    """A forearm at 9 cm hides an object at half a metre: the frame is as it should be."""
    model = make("drill")
    pose = poses.make_pose(translation=[0.0, 0.0, 0.56])
    camera = Camera(80.0, 82.0, 31.5, 23.5, 64, 48)
    frame = Frame(0, camera=camera, depth=np.full((48, 64), 0.09, np.float32), prior=pose)
    assert scale_problem(frame, model) is None
    assert scale_problem(replace(frame, depth=np.full((48, 64), 0.09e-2, np.float32)), model) is not None
    assert scale_problem(replace(frame, depth=np.full((48, 64), 9.0, np.float32)), model) is not None


def test_a_wall_far_behind_something_thin_is_no_wrong_unit():
    """Of the pixels about a pipe most show the wall; only where none is near has the depth another unit."""
    model = make("drill")
    pose = poses.make_pose(translation=[0.0, 0.0, 0.4])
    camera = Camera(80.0, 82.0, 31.5, 23.5, 64, 48)
    depth = np.full((48, 64), 2.5, np.float32)
    assert scale_problem(Frame(0, camera=camera, depth=depth, prior=pose), model) is not None
    depth[:, 30:33] = 0.39
    frame = Frame(0, camera=camera, depth=depth, prior=pose)
    assert scale_problem(frame, model) is None
    assert "no nearer than 3.9 m" in (scale_problem(replace(frame, depth=10 * depth), model) or "")


def test_one_contact_of_nonsense_is_no_wrong_unit():
    model = make("box")
    points = np.array([[0.0, 0.0, 0.5], [0.03, 0.0, 0.5], [0.0, 0.04, 0.52], [0.0, 0.0, 0.0], [9.0, 9.0, 9.0]])
    assert scale_problem(Frame(0, contacts=Contacts(points)), model) is None
    assert "mm read as m?" in (scale_problem(Frame(0, contacts=Contacts(1e3 * points)), model) or "")


def test_hands_and_objects_that_no_camera_sees_are_of_another_unit():
    hand, model = five_finger_hand(), make("box")
    frame = some_frame(0, hand)
    assert scale_problem(frame, model) is None
    far = frame.world_from_hand.copy()
    far[:3, 3] = [100.0, 50.0, 480.0]
    told = scale_problem(replace(frame, world_from_hand=far), model)
    assert "expected the hand where the camera can be, got it 492.8 m away" in (told or "")
    blind = replace(frame, camera=None, depth=None, rgb=None, mask=None, world_from_hand=far)
    assert "expected the hand where the contacts can be" in (scale_problem(blind, model) or "")
    base = poses.make_pose(translation=[0.0, 0.0, -480.0])  # a robot far from where its map begins
    moved = replace(frame, camera_from_world=base, world_from_hand=poses.make_pose(translation=[0.1, 0.0, 480.5]))
    assert scale_problem(replace(moved, contacts=Contacts.none(), cloud=None, cloud_colours=None), model) is None
    truth = frame.camera_from_object_truth.copy()
    truth[:3, 3] = [0.0, 0.0, 700.0]
    told = scale_problem(replace(frame, camera_from_object_truth=truth), model)
    assert "by the ground truth, 700 m away: mm read as m?" in (told or "")
