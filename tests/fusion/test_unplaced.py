"""Sensors of a hand that nothing places: they are left out with a note, and the rest answers."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.advice.grasp import assess
from fusion.estimation.estimate import estimate
from fusion.tracking.tracker import Tracker
from fusion.truth.compare import compare_frame
from fusion.truth.errors import Judge
from scenes.errors import CaptureError
from scenes.geometry import poses
from scenes.recordings.frames import Frame, Wrench
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.urdf import Robot
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import synthesize_frames
from touch.contacts import feel, placed, places_touched

LACKS = [
    ({"joints": None}, "no joints known"),
    ({"world_from_hand": None}, "no pose known"),
    ({"joints": None, "world_from_hand": None}, "no pose and joints known"),
    ({"hand": None, "joints": None, "world_from_hand": None}, "no hand known"),
]


@pytest.fixture(scope="module", params=["wrench", "array"])
def felt(request, hand, drill):
    """A frame whose fingers feel by one kind of sensor, and what notes call that."""
    frame = synthesize_frames(drill, hand, occlusion=0.4, touch=(request.param,), noise="clean", seed=5)[0]
    return frame, {"wrench": "wrenches", "array": "arrays"}[request.param]


@pytest.mark.parametrize(("lacks", "why"), LACKS, ids=[why for _, why in LACKS])
def test_what_nothing_places_is_left_out_and_the_rest_answers(felt, drill, lacks, why):
    frame, kind = felt
    bare = replace(frame, **lacks)
    note = f"{kind} are left out: {why}"
    answer = estimate(bare, drill)
    assert note in answer.notes
    assert not answer.contacts
    seen = estimate(bare.without_touch(), drill)
    np.testing.assert_array_equal(answer.pose, seen.pose)
    assert note not in seen.notes
    assert note not in estimate(bare, drill, use=("vision",)).notes
    alone = estimate(bare, drill, use=("touch",))
    assert alone.verdict == "lost"
    assert note in alone.notes
    assert not len(places_touched(bare))


def test_a_track_goes_on_without_them(felt, drill):
    frame, kind = felt
    note = f"{kind} are left out: no joints known"
    tracker = Tracker(drill)
    assert not any("left out" in said for said in tracker.step(frame).notes)
    later = tracker.step(replace(frame, index=1, joints=None))
    assert later.how == "tracked"
    assert later.notes.count(note) == 1
    begun = Tracker(drill).step(replace(frame, joints=None))
    assert begun.notes.count(note) == 1


def test_given_poses_and_grasps_are_judged_without_them(felt, drill):
    frame, kind = felt
    bare = replace(frame, joints=None)
    answer = estimate(bare, drill)
    for row in compare_frame(bare, Judge(drill), ("icp_touch", "fused")):
        assert np.isnan(row.agreement.contacts)
        assert np.isfinite(row.agreement.cloud)
    grasp = assess(drill, answer, bare)
    assert not grasp.sensors
    assert grasp.to_json()["notes"] == [f"{kind} are left out: no joints known"]


def test_a_wrench_of_a_sensor_without_a_surface_is_no_contact(hand, drill):
    frame = synthesize_frames(drill, hand, occlusion=0.4, touch=("wrench",), noise="clean", seed=5)[0]
    wrist = Sensor("wrist", "palm", "wrench", np.eye(4))
    assert "palm" in hand.robot.links
    with_wrist = replace(
        frame,
        hand=Hand(hand.robot, {**hand.sensors, "wrist": wrist}),
        wrenches=(*frame.wrenches, Wrench("wrist", np.ones(3), np.zeros(3))),
    )
    found = feel(with_wrist)
    assert found.left_out == ("wrenches of wrist are left out: no surface known to find contacts on",)
    np.testing.assert_array_equal(found.contacts.points, feel(frame).contacts.points)
    with pytest.raises(CaptureError, match="expected a sensor of the hand"):  # a name that is none is a mistake
        feel(replace(frame, wrenches=(Wrench("no such sensor", np.ones(3), np.zeros(3)),)))


def test_sensors_of_a_hand_without_joints_need_none():
    probe = Sensor("tip", "rod", "wrench", np.eye(4), {"sphere": {"radius": 0.01}})
    shape = next(one for link in five_finger_hand().robot.links.values() for one in link)
    hand = Hand(Robot("probe", "rod", {"rod": (shape,)}, ()), {"tip": probe})
    world_from_hand = poses.make_pose(translation=[0.1, 0.0, 0.4])
    frame = Frame(0, hand=hand, world_from_hand=world_from_hand, wrenches=(Wrench("tip", [0, 0, -1.0], np.zeros(3)),))
    assert placed(frame)[1] == ()
    np.testing.assert_allclose(places_touched(frame), [[0.1, 0.0, 0.41]], atol=1e-9)
