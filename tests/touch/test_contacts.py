"""From what the fingers report to rows: frames of reference, sigmas, the hand as space the object cannot be in."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from scenes.errors import InputError
from scenes.evidence import table as evidence
from scenes.geometry import poses
from scenes.recordings.beliefs import Beliefs, CalibrationModel
from scenes.recordings.frames import Contacts, EmptyRegions, Frame, Wrench
from scenes.synthesis.recording import synthesize_frames
from touch.contacts import TouchSettings, feel, fingers_of, places_touched
from touch.wrenches.intrinsic import wrench_contacts

USUAL = TouchSettings()
NEAR = USUAL.same_finger, USUAL.fingertip


@dataclass(frozen=True)
class Ball:
    centre: np.ndarray
    radius: float


def silent(rows):
    """Rows that speak only of penetration."""
    return rows.rows[:, evidence.GATE_ABOVE] == 0


def test_contacts_come_out_in_the_camera_frame(rng):
    pose = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    contacts = Contacts(rng.normal(size=(4, 3)), poses.random_unit_vectors(4, rng), 2e-3, 0.1)
    felt = feel(Frame(0, camera_from_world=pose, contacts=contacts))
    assert np.allclose(felt.contacts.points, poses.apply(pose, contacts.points))
    assert np.allclose(felt.rows.rows[:, evidence.NORMAL], contacts.normals @ pose[:3, :3].T)
    assert np.allclose(felt.rows.rows[:, evidence.SIGMA], 2e-3)
    assert (felt.rows.rows[:, evidence.GATE_ABOVE] == 4.0).all()
    assert not silent(felt.rows).any()


def test_a_frame_without_touch():
    felt = feel(Frame(0))
    assert len(felt.contacts) == 0
    assert len(felt.rows) == 0


def test_empty_regions_keep_their_radius(rng):
    pose = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    centres = rng.normal(size=(3, 3))
    empty = EmptyRegions(centres, np.array([0.01, 0.02, 0.03]), ["a", "b", "c"])
    felt = feel(Frame(0, camera_from_world=pose, no_contact=empty))
    assert len(felt.rows) == 3
    assert silent(felt.rows).all()
    assert np.allclose(felt.rows.points, poses.apply(pose, centres))
    assert np.array_equal(felt.rows.rows[:, evidence.OFFSET], empty.radius)


def test_the_hand_is_space_that_the_object_cannot_be_in(exact_frame, drill):
    truth = exact_frame.camera_from_object_truth
    centre = poses.apply(truth, drill.centroid[None])[0]
    near = feel(exact_frame, region=Ball(centre, 0.12))
    hidden = silent(near.rows)
    assert hidden.sum() > 50
    assert (~hidden).sum() == len(exact_frame.contacts)
    points = near.rows.points[hidden]
    assert (np.linalg.norm(points - centre, axis=1) < 0.12).all()
    # a hand that grasps touches the object but is not inside it
    assert drill.field.distance(poses.apply(poses.inverse(truth), points)).min() > -0.003
    # together they count like a few
    assert near.rows.rows[hidden, evidence.WEIGHT].sum() <= 20.0 + 1e-9
    away = feel(exact_frame, region=Ball(np.array([5.0, 0.0, 0.0]), 0.1))
    assert not silent(away.rows).any()


def test_joint_errors_widen_contacts_of_a_hand(exact_frame):
    with_hand = feel(exact_frame, np.eye(4))
    without = feel(replace(exact_frame, hand=None, joints=None, world_from_hand=None), np.eye(4))
    on = ~silent(with_hand.rows)
    assert (with_hand.rows.rows[on, evidence.SIGMA] > without.rows.rows[:, evidence.SIGMA]).all()


def test_contacts_of_one_finger_share_what_its_joints_add(exact_frame, rng):
    patch = Contacts(0.004 * rng.normal(size=(30, 3)), sigma_point=np.full(30, 3e-4), sensors=["thumb"] * 30)
    alone = Contacts(rng.normal(size=(2, 3)), sigma_point=[1e-3, 2e-3], sensors=["index", "ring"])
    frame = replace(exact_frame, contacts=Contacts.concatenate([patch, alone]), wrenches=(), tactile={})
    rows = feel(frame, np.eye(4)).rows
    rows = rows.rows[~silent(rows)]
    finger = Beliefs().touch.fingertip_sigma
    told = rows[:, evidence.WEIGHT] / rows[:, evidence.SIGMA] ** 2
    # what a mean of thirty knows of its finger, and no better; others as before
    assert told[:30].sum() == pytest.approx(1.0 / (3e-4**2 / 30 + finger**2))
    assert np.allclose(rows[:, evidence.SIGMA], np.hypot(frame.contacts.sigma_point, finger))
    assert np.allclose(rows[30:, evidence.WEIGHT], 1.0)


def test_contacts_of_one_finger_share_its_error_whoever_tells_of_the_hand(rng):
    patch = Contacts(0.004 * rng.normal(size=(30, 3)), sigma_point=np.full(30, 3e-4), sensors=["thumb"] * 30)
    alone = Contacts(rng.normal(size=(2, 3)), sigma_point=[1e-3, 2e-3], sensors=["index", "ring"])
    rows = feel(Frame(0, contacts=Contacts.concatenate([patch, alone]))).rows.rows
    told = rows[:, evidence.WEIGHT] / rows[:, evidence.SIGMA] ** 2
    assert told[:30].sum() == pytest.approx(1.0 / (3e-4**2 / 30 + Beliefs().touch.fingertip_sigma ** 2))
    # one contact of a finger said what it is worth
    assert np.allclose(told[30:], [1e6, 0.25e6])


def test_many_contacts_of_a_finger_that_say_no_sigma_are_worth_what_one_is(rng):
    points = np.array([0.2, 0.0, 0.0]) + 0.003 * rng.normal(size=(20, 3))
    named = feel(Frame(0, contacts=Contacts(points, sensors=["thumb"] * 20))).rows.rows
    told = (named[:, evidence.WEIGHT] / named[:, evidence.SIGMA] ** 2).sum()
    unknown = Beliefs().touch.unknown_sigma
    assert 0.8 * unknown**-2.0 < told < 1.1 * unknown**-2.0
    one = feel(Frame(0, contacts=points[:1])).rows.rows
    assert one[0, evidence.WEIGHT] / one[0, evidence.SIGMA] ** 2 == pytest.approx(unknown**-2.0)


def test_where_to_look_is_told_by_every_contact_in_full(exact_frame, rng):
    patch = Contacts(0.004 * rng.normal(size=(30, 3)), sigma_point=np.full(30, 3e-4), sensors=["thumb"] * 30)
    felt = feel(replace(exact_frame, contacts=patch, wrenches=(), tactile={}), np.eye(4))
    assert (felt.rows.rows[:30, evidence.WEIGHT] < 0.5).all()
    assert (felt.each.rows[:30, evidence.WEIGHT] == 1.0).all()
    others = np.delete(np.arange(felt.each.rows.shape[1]), evidence.WEIGHT)
    assert np.array_equal(felt.each.rows[:, others], felt.rows.rows[:, others])
    assert np.array_equal(felt.each.rows[30:], felt.rows.rows[30:])


def test_contacts_without_names_are_one_fingers_while_next_to_another():
    steps = 0.001 * np.arange(10)
    points = np.stack([np.concatenate([steps, 0.05 + steps, [0.2]]), *np.zeros((2, 21))], axis=1)
    fingers = fingers_of(Contacts(points), NEAR)
    assert [len(set(part)) for part in (fingers[:10], fingers[10:20], fingers)] == [1, 1, 3]
    # names say better, where they are a finger's and not a whole hand's
    named = fingers_of(Contacts(points, sensors=["a"] * 5 + ["b"] * 16), NEAR)
    assert [len(set(part)) for part in (named[:5], named[5:10], named)] == [1, 1, 4]
    assert not set(named[:5]) & set(named[5:])
    assert len(set(fingers_of(Contacts(points, sensors=["hand"] * 21), NEAR))) == 3


def test_taxels_of_two_fingers_are_two_fingers():
    steps = 0.001 * np.arange(6)
    points = np.stack([np.concatenate([steps, 0.05 + steps[:2]]), *np.zeros((2, 8))], axis=1)
    felt = feel(Frame(0, contacts=Contacts(points)), np.eye(4))
    assert felt.fingers == 2
    assert np.allclose(felt.of_finger, [1 / 6] * 6 + [1 / 2] * 2)
    assert feel(Frame(0), np.eye(4)).fingers == 0


def test_an_uncorrected_calibration_widens_everything(exact_frame):
    beliefs = Beliefs(calibration=CalibrationModel(0.002, 0.005))
    told = feel(exact_frame, np.eye(4), beliefs)
    wide = feel(exact_frame, None, beliefs)
    before = told.rows.rows[:, evidence.SIGMA]
    slack = np.hypot(0.002, 0.005 * np.linalg.norm(told.rows.points.mean(axis=0)))
    assert np.allclose(wide.rows.rows[:, evidence.SIGMA], np.hypot(before, slack))
    assert np.array_equal(wide.reported_rows.rows[:, evidence.SIGMA], before)
    # once corrected it is as sure as its own sigmas say
    assert np.array_equal(wide.corrected(np.eye(4)).rows.rows[:, evidence.SIGMA], before)


def test_a_correction_moves_contacts_and_rows_alike(exact_frame, rng):
    correction = poses.exp(0.01 * rng.normal(size=6))
    felt = feel(exact_frame, correction)
    contacts = len(felt.contacts)
    assert np.allclose(felt.contacts.points, poses.apply(correction, felt.reported_contacts.points))
    assert np.allclose(felt.rows.points[:contacts], felt.contacts.points)
    assert np.array_equal(felt.reported_rows.rows, feel(exact_frame).reported_rows.rows)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": [[0, 0, np.nan]]}, "finite points, got row 0"),
        ({"points": np.zeros((2, 2))}, r"shape \(n, 3\)"),
        ({"points": np.zeros((2, 3)), "normals": np.zeros((3, 3))}, r"normals of shape \(2, 3\)"),
        ({"points": np.zeros((2, 3)), "sigma_point": -1.0}, "sigma_point above 0"),
        ({"points": np.zeros((2, 3)), "sigma_normal": np.inf}, "sigma_normal above 0"),
        ({"points": np.zeros((2, 3)), "sensors": ["a"]}, "2 sensor names, got 1"),
    ],
)
def test_contacts_that_cannot_be(arguments, message):
    with pytest.raises(InputError, match=message):
        Contacts(**arguments)


def test_contacts_normalise_and_forget_what_is_unknown():
    contacts = Contacts(np.zeros((3, 3)), [[0, 0, 5.0], [0, 0, 0], [np.nan] * 3], [1e-3, np.nan, 2e-3])
    assert np.array_equal(contacts.has_normal, [True, False, False])
    assert np.array_equal(contacts.normals[0], [0, 0, 1])
    assert np.array_equal(contacts.sigma_told, [True, False, True])
    assert not contacts.sigma_known
    assert np.isfinite(contacts.sigma_point).all()
    assert not Contacts(np.zeros((3, 3))).sigma_told.any()
    contacts = contacts.take([0, 2, 2])
    assert contacts.sigma_known
    both = Contacts.concatenate([contacts, contacts.take([0])])
    assert len(both) == 4
    assert np.array_equal(both.points, np.zeros((4, 3)))
    # what is known of sigmas is not lost beside a part without contacts, nor claimed for a part without sigmas
    assert Contacts.concatenate([contacts, Contacts(np.zeros((0, 3)))]).sigma_known
    assert not Contacts.concatenate([contacts, Contacts(np.zeros((1, 3)))]).sigma_known


def test_contacts_of_unknown_worth_are_believed_little_and_never_gated_out():
    felt = feel(Frame(0, contacts=Contacts(np.zeros((2, 3)))))
    assert (felt.rows.rows[:, evidence.SIGMA] > 0.002).all()
    assert (felt.rows.rows[:, evidence.GATE_ABOVE] == evidence.NO_GATE).all()


def test_beside_a_depth_image_one_of_unknown_worth_that_is_far_off_is_false(exact_frame):
    silent_ones = replace(exact_frame, contacts=Contacts(exact_frame.contacts.points), wrenches=(), tactile={})
    count = len(silent_ones.contacts)
    seen = feel(silent_ones, np.eye(4))
    assert (seen.reported_rows.rows[:count, evidence.GATE_ABOVE] == 5.0).all()
    assert seen.untold == ("contacts say no sigma: 4 mm believed of each, those beyond 20 mm taken for false",)
    for felt in (feel(silent_ones.without_vision(), np.eye(4)), feel(silent_ones, np.eye(4), beside_vision=False)):
        assert (felt.reported_rows.rows[:count, evidence.GATE_ABOVE] == evidence.NO_GATE).all()


def test_contacts_that_say_a_sigma_keep_it_beside_one_that_says_none(rng):
    points = rng.normal(size=(6, 3))
    told = feel(Frame(0, contacts=Contacts(points[:5], sigma_point=1e-3)))
    mixed = feel(Frame(0, contacts=Contacts(points, sigma_point=[*[1e-3] * 5, np.nan])))
    np.testing.assert_array_equal(mixed.rows.rows[:5], told.rows.rows)
    assert mixed.rows.rows[5, evidence.SIGMA] == pytest.approx(Beliefs().touch.unknown_sigma)
    assert mixed.rows.rows[5, evidence.GATE_ABOVE] == evidence.NO_GATE
    assert mixed.untold == ("1 of 6 contacts say no sigma: 4 mm believed of each, none taken for false",)


def test_a_finger_whose_wrench_is_reported_as_a_contact_too_touches_once(hand, drill):
    frame = synthesize_frames(drill, hand, 1, 0.3, noise="clean", seed=3, touch=("wrench",))[0]
    once = feel(frame).reported_contacts
    assert len(once) > 2
    twice = feel(replace(frame, contacts=wrench_contacts(frame))).reported_contacts
    assert sorted(twice.sensors) == sorted(once.sensors)
    np.testing.assert_allclose(places_touched(frame), once.points, atol=1e-12)


def test_contacts_that_say_no_sigma_are_told_of(rng):
    points = rng.normal(size=(4, 3))
    (said,) = feel(Frame(0, contacts=Contacts(points))).untold
    assert "4 mm" in said
    wider = Beliefs(touch=replace(Beliefs().touch, unknown_sigma=0.007))
    assert "7 mm" in feel(Frame(0, contacts=Contacts(points)), beliefs=wider).untold[0]
    assert feel(Frame(0, contacts=Contacts(points, sigma_point=1e-3))).untold == ()
    assert feel(Frame(0)).untold == ()


def test_rows_written_twice_are_one_touch(hand, drill, rng):
    frame = synthesize_frames(drill, hand, 1, 0.3, noise="clean", seed=3, touch=("wrench",))[0]
    count, once = len(frame.wrenches), feel(frame)
    twice = feel(replace(frame, wrenches=frame.wrenches + frame.wrenches))
    assert twice.left_out == (f"{count} of {2 * count} wrenches are used, the others repeat them",)
    np.testing.assert_array_equal(twice.rows.rows, once.rows.rows)
    contacts = Contacts(rng.normal(size=(4, 3)), sigma_point=1e-3)
    felt = feel(Frame(0, contacts=contacts.take([0, 1, 2, 3, 1, 1])))
    assert felt.left_out == ("4 of 6 contacts are used, the others repeat them",)
    np.testing.assert_array_equal(felt.rows.rows, feel(Frame(0, contacts=contacts)).rows.rows)


def test_wrenches_that_make_no_contact_are_counted(hand, drill):
    frame = synthesize_frames(drill, hand, 1, 0.3, noise="clean", seed=3, touch=("wrench",))[0]
    assert feel(frame).left_out == ()
    pull = replace(frame, wrenches=(*frame.wrenches[1:], Wrench(frame.wrenches[0].sensor, np.zeros(3), np.zeros(3))))
    why = "no force, or none that presses on the surface"
    assert feel(pull).left_out == (f"1 of {len(frame.wrenches)} wrenches make no contact: {why}",)
