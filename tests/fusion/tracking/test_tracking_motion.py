"""Prediction from the hand: rigid motion exactly, contacts by least squares; honest beliefs; the slip test."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.estimation.solve.settings import JointSettings, Rig
from fusion.tracking.filter import Belief, Measurement, SlipTest, block, positive_part, scales, surplus, update
from fusion.tracking.motion import (
    HandMotion,
    HandMotionSettings,
    HandState,
    calibration_drift,
    carried_by_contacts,
    drift_since,
    grasp_transpose,
    palm_motion,
)
from fusion.tracking.spans import SpanTest
from fusion.tracking.steps.refining import level_of, mean_level
from scenes.geometry import poses
from scenes.recordings.beliefs import CalibrationModel
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library

SEEDS = st.integers(0, 2**31)


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def random_pose(rng):
    return poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3))


def random_covariance(rng, size=0.01):
    root = size * rng.normal(size=(6, 8))
    return root @ root.T


@given(SEEDS)
def test_a_belief_moves_rigidly_with_the_hand(mug, seed):
    rng = np.random.default_rng(seed)
    belief = Belief(random_pose(rng), random_covariance(rng), random_covariance(rng))
    before, now = random_pose(rng), random_pose(rng)
    motion = now @ poses.inverse(before)
    moved = belief.moved(motion)
    # the hold is what it was
    np.testing.assert_allclose(poses.inverse(now) @ moved.pose, poses.inverse(before) @ belief.pose, atol=1e-12)
    # an error of the belief is carried along: perturbing before or after the motion is the same
    delta = 0.1 * rng.normal(size=6)
    after = poses.perturb(moved.pose, block(motion[:3, :3]) @ delta, mug.centroid)
    np.testing.assert_allclose(after, motion @ poses.perturb(belief.pose, delta, mug.centroid), atol=1e-12)
    np.testing.assert_allclose(np.linalg.eigvalsh(moved.own), np.linalg.eigvalsh(belief.own), atol=1e-12)


@given(SEEDS, st.integers(1, 6))
def test_contacts_carry_the_object_as_least_squares_says(seed, count):
    rng = np.random.default_rng(seed)
    s = HandMotionSettings()
    points, centre = 0.05 * rng.normal(size=(count, 3)), 0.02 * rng.normal(size=3)
    u = 0.001 * rng.normal(size=(count, 3))
    motion, covariance, misfit = carried_by_contacts(points, u, centre, s)
    jacobian = np.concatenate([np.concatenate([-poses.skew(p - centre), np.eye(3)], axis=1) for p in points])
    np.testing.assert_allclose(grasp_transpose(points, centre), jacobian, atol=1e-15)
    width = np.repeat([s.turn, s.move], 3)
    stacked = np.concatenate([jacobian / s.creep, np.diag(1 / width)])
    expected = np.linalg.lstsq(stacked, np.concatenate([u.ravel() / s.creep, np.zeros(6)]), rcond=None)[0]
    np.testing.assert_allclose(motion, expected, atol=1e-9)
    residual = (u.ravel() - jacobian @ expected) / s.creep
    assert misfit == pytest.approx(max(0.0, residual @ residual - max(0, 3 * count - 6)), abs=1e-6)
    assert np.linalg.eigvalsh(covariance).min() > 0


@given(SEEDS)
def test_three_sticking_contacts_tell_a_rigid_motion(seed):
    rng = np.random.default_rng(seed)
    points = 0.04 * np.array([[1.0, 0, 0], [-0.5, 0.9, 0], [-0.5, -0.9, 0.2], [0, 0, 1.0]])
    centre, delta = np.zeros(3), np.concatenate([0.003 * rng.normal(size=3), 3e-4 * rng.normal(size=3)])
    moved = poses.perturb(np.eye(4), delta, centre)
    motion, _, misfit = carried_by_contacts(points, poses.apply(moved, points) - points, centre)
    assert misfit == 0.0
    # the prior holds a few hundredths back, more about the axis that the contacts lie nearest to
    np.testing.assert_allclose(motion, delta, atol=0.15 * np.abs(delta).max())


def test_fingers_that_move_move_the_object(mug, hand):
    joints = dict.fromkeys(hand.joint_names, 0.3)
    sensors = list(hand.sensors)[:3]
    frames = hand.forward_kinematics(joints)
    points = np.array([frames[hand.sensors[n].link][:3, 3] for n in sensors])
    contacts = Contacts(points, sensors=sensors)
    frame = Frame(0, hand=hand, joints=joints, world_from_hand=np.eye(4), contacts=contacts)
    state = HandState.of(frame, contacts)
    motion = HandMotion(mug)
    hold = poses.make_pose(None, points.mean(axis=0))
    still = motion.in_hand(state, frame, hold, 1)
    np.testing.assert_array_equal(still.motion, 0.0)
    assert still.sliding == 0.0
    closed = Frame(1, hand=hand, joints=dict.fromkeys(hand.joint_names, 0.35), world_from_hand=np.eye(4))
    moved = motion.in_hand(state, closed, hold, 1)
    assert np.linalg.norm(moved.motion[3:]) > 5e-4
    assert np.trace(moved.noise) > np.trace(moved.sticking) > np.trace(still.sticking)
    assert np.trace(moved.turned(poses.exp_rotation([0.3, 0.2, 0.1])).noise) == pytest.approx(np.trace(moved.noise))
    assert HandState.of(Frame(2), contacts) is None


def test_fingers_of_another_hand_say_nothing(mug, hand):
    """A tool changer: sensors may have the same names, the joints have not."""
    frame = Frame(1, hand=hand, joints=dict.fromkeys(hand.joint_names, 0.3), world_from_hand=np.eye(4))
    before = HandState(np.eye(4), {"finger_left_slide": 0.01}, (next(iter(hand.sensors)),), np.zeros((1, 3)))
    moved = HandMotion(mug).in_hand(before, frame, np.eye(4), 1)
    np.testing.assert_array_equal(moved.motion, np.zeros(6))


@given(SEEDS)
def test_an_update_is_the_kalman_filters_when_nothing_is_shared(mug, seed):
    rng = np.random.default_rng(seed)
    p, r = random_covariance(rng), random_covariance(rng)
    pose = random_pose(rng)
    delta = 0.01 * rng.normal(size=6)
    measured = Measurement(poses.perturb(pose, delta, mug.centroid), r, np.zeros((6, 6)))
    after = update(mug, Belief(pose, p, np.zeros((6, 6))), measured)
    gain = p @ np.linalg.inv(p + r)
    np.testing.assert_allclose(after.own, p - gain @ p, atol=1e-9)
    np.testing.assert_allclose(poses.difference(after.pose, pose, mug.centroid), gain @ delta, atol=1e-9)


def test_what_all_frames_share_is_not_averaged_out(mug):
    shared, own = 1e-6 * np.eye(6), 1e-5 * np.eye(6)
    belief = Belief(np.eye(4), own, shared)
    for _ in range(200):
        belief = update(mug, belief, Measurement(np.eye(4), own, shared))
    assert np.trace(belief.own) < 0.01 * np.trace(own)
    np.testing.assert_allclose(belief.shared, shared, rtol=1e-6)


def test_a_measurement_loses_nothing_of_its_frame_and_averages_out_what_changes():
    independent, shared, biased = 4e-6 * np.eye(6), 9e-6 * np.eye(6), 5e-6 * np.eye(6)
    measured = Measurement.of(np.eye(4), independent, shared, biased, 0.6)
    np.testing.assert_allclose(measured.own + measured.shared, independent + shared)
    np.testing.assert_allclose(measured.own, 0.6 * independent)
    np.testing.assert_allclose(measured.biased, biased)


def test_one_rig_is_as_wide_as_the_mixture_that_it_stands_for():
    """The law of total variance: levels by their squares, of robot and scale as of the depth's smooth bias."""
    kinds = (Rig(0.25, 0.1), Rig(1.0, 0.7), Rig(2.0, 0.2))
    settings = JointSettings(rigs=kinds, biases=kinds[:2])
    level = np.array([kind.level for kind in kinds])

    def solved(shares, bias_shares):
        return SimpleNamespace(shares=shares, bias_shares=bias_shares)

    frames = [((0.9, 0.1, 0.0), (1.0, 0.0)), ((0.5, 0.25, 0.25), (0.2, 0.8))]
    mean = mean_level([level_of(solved(*frame), settings) for frame in frames])
    assert mean.rig**2 == pytest.approx(np.mean([np.dot(shares, level**2) for shares, _ in frames]))
    assert mean.bias**2 == pytest.approx(np.mean([np.dot(shares, level[:2] ** 2) for _, shares in frames]))
    # a frame that is almost sure of small errors does not make a track sure of them
    assert level_of(solved((0.9, 0.1, 0.0), (1.0, 0.0)), settings).rig > 1.5 * kinds[0].level


def test_only_the_depth_bias_is_otherwise_elsewhere_in_the_image(mug):
    """A step of 2 mm while the object crosses the image: a slip, unless the camera's bias may have made it."""
    own, wide = 1e-8 * np.eye(6), 4e-6 * np.eye(6)
    for biased, slips in ((0 * wide, True), (wide, False)):
        test = SlipTest(mug, 40.0)
        said = []
        for index in range(8):
            pose = poses.make_pose(None, [0.0, 0.0, 0.002 * (index >= 5)])
            measured = Measurement(pose, own, wide, biased)
            test.predict(np.eye(4), np.zeros(6), 1e-10 * np.eye(6))
            said.append(test.step(measured, Belief(pose, own, wide), np.array([100.0 + 100.0 * (index >= 5), 50.0])))
        assert any(said) == slips


def test_a_direction_without_information_stays_as_it_was(mug):
    belief = Belief(np.eye(4), 1e-6 * np.eye(6), 1e-6 * np.eye(6))
    blind = Measurement(np.eye(4), np.zeros((6, 6)), np.diag([1.0, 0, 0, 0, 0, 0]))
    after = update(mug, belief, blind)
    assert after.own[0, 0] == pytest.approx(1e-6, rel=1e-3)
    assert after.covariance[0, 0] < 3e-6


@given(SEEDS)
def test_positive_part_keeps_what_is_positive(mug, seed):
    rng = np.random.default_rng(seed)
    matrix = random_covariance(rng)
    np.testing.assert_allclose(positive_part(matrix, scales(mug)), matrix, atol=1e-12)
    assert np.linalg.eigvalsh(positive_part(matrix - 2 * np.eye(6), scales(mug))).min() > -1e-12


def test_what_a_calibration_makes_of_a_way_adds_up_over_its_steps():
    """One calibration's error acts on every step: a way of many small ones ends as far off as one of a single step."""
    calibration, rng = CalibrationModel(), np.random.default_rng(2)
    begun, object_pose = poses.make_pose(None, [0.0, 0.0, 0.6]), poses.make_pose(None, [0.0, 0.0, 0.6])
    way = [poses.perturb(begun, k * np.array([0.01, 0.02, 0, 0.004, 0, 0.002]), np.zeros(3)) for k in range(21)]
    coherent, independent, back = (np.zeros((6, 6)) for _ in range(3))
    for before, now in pairwise(way):
        centre = (now @ poses.inverse(begun) @ object_pose)[:3, 3]
        independent += calibration_drift(before, now, (before @ poses.inverse(begun) @ object_pose)[:3, 3], calibration)
        coherent += drift_since(begun, before, now, centre, calibration)
        back += drift_since(begun, now, before, object_pose[:3, 3], calibration)
    whole = calibration_drift(begun, way[-1], object_pose[:3, 3], calibration)
    np.testing.assert_allclose(coherent, whole, rtol=1e-6, atol=1e-18)
    assert back.max() < 1e-3 * coherent.max()
    sigma = np.repeat([calibration.rotation_sigma, calibration.translation_sigma], 3)
    off = []
    for error in poses.exp(sigma * rng.normal(size=(300, 6))):
        reported = error @ way[-1] @ poses.inverse(error @ begun)
        true = way[-1] @ poses.inverse(begun)
        off.append(poses.difference(reported @ object_pose, true @ object_pose, np.zeros(3)))
    found = np.mean(np.square(off), axis=0)
    for part in (slice(0, 3), slice(3, 6)):
        assert found[part].mean() > 3.0 * np.diag(independent)[part].mean()
        assert 0.3 < found[part].mean() / np.diag(whole)[part].mean() < 1.2


def test_a_calibration_that_was_seen_moves_nothing_otherwise():
    """The palm's motion as the robot reports it, corrected, is the true one; what is left of a drift is less."""
    rng = np.random.default_rng(4)
    true = [HandState(random_pose(rng), None, (), np.zeros((0, 3))) for _ in range(2)]
    error = poses.exp(np.array([0.01, -0.02, 0.005, 0.004, 0.003, -0.006]))
    reported = [replace(one, camera_from_hand=error @ one.camera_from_hand) for one in true]
    corrected = palm_motion(*reported, poses.inverse(error))
    np.testing.assert_allclose(corrected, palm_motion(*true, None), atol=1e-12)
    assert np.abs(palm_motion(*reported, None) - corrected).max() > 1e-3
    left = HandMotionSettings().left
    assert (left(False) == 1.0).all()
    assert np.linalg.eigvalsh(left(True)).min() > -1e-12
    assert left(True).max() < 0.5


def test_calibration_drifts_only_with_motion():
    calibration = CalibrationModel()
    pose = poses.make_pose(None, [0.0, 0.0, 0.6])
    centre = np.array([0.0, 0.0, 0.6])
    assert calibration_drift(pose, pose, centre, calibration).max() == 0.0
    moved = poses.perturb(pose, [0.05, 0, 0, 0.01, 0, 0], np.zeros(3))
    drift = calibration_drift(pose, moved, centre, calibration)
    # the true error of a random calibration is within three of its sigmas
    rng = np.random.default_rng(0)
    sigma = np.repeat([calibration.rotation_sigma, calibration.translation_sigma], 3)
    for error in poses.exp(sigma * rng.normal(size=(100, 6))):
        reported = error @ moved @ poses.inverse(error @ pose)
        true = moved @ poses.inverse(pose)
        object_pose = poses.make_pose(None, centre)
        delta = poses.difference(reported @ object_pose, true @ object_pose, np.zeros(3))
        assert (np.abs(delta) < 4.5 * np.sqrt(np.diag(drift))).all()


@pytest.mark.parametrize("slow", [False, True])
def test_slips_sudden_and_slow_are_told_from_noise(mug, slow):
    rng = np.random.default_rng(1)
    own = np.diag(np.repeat([0.005, 0.0005], 3) ** 2)
    test = SlipTest(mug, 40.0)
    hold, alarms = np.eye(4), []
    for index in range(80):
        if index >= 60 and (slow or index == 60):
            step = np.array([0.012, 0, 0, 0, 0.001, 0]) if slow else np.array([0.07, 0, 0, 0, 0.005, 0])
            hold = poses.perturb(hold, step, mug.centroid)
        noisy = poses.perturb(hold, np.sqrt(np.diag(own)) * rng.normal(size=6), mug.centroid)
        test.predict(np.eye(4), np.zeros(6), 1e-10 * np.eye(6))
        measured = Measurement(noisy, own, np.zeros((6, 6)))
        if test.step(measured, Belief(noisy, own, np.zeros((6, 6))), None):
            alarms.append(index)
    assert alarms
    assert 60 <= alarms[0] <= (66 if slow else 60)


@pytest.mark.parametrize("slips", [False, True])
def test_a_small_step_is_told_from_a_drift_that_is_as_large(mug, slips):
    """A step in six frames, of which one frame tells half a millimetre; or a drift in forty while the hand moves."""
    rng = np.random.default_rng(5)
    own = np.diag(np.repeat([0.006, 0.0005], 3) ** 2)
    hand = poses.make_pose(poses.exp_rotation(np.array([0.0, 0.01, 0.0])), [0.001, 0.0, 0.0])
    said = []
    for _ in range(12):
        test, begun, held = SpanTest(mug, 40.0), poses.make_pose(None, [0.0, 0.0, 0.5]), []
        for index in range(40):
            far = np.clip((index - 20) / 6, 0, 1) if slips else index / 40
            test.predict(hand, np.zeros(6), 1e-10 * np.eye(6), np.zeros(6))
            begun = hand @ begun
            step = np.r_[0.2, 0, 0, 0, 0.0016, 0] * far if slips else np.r_[0, 0, 0, 0, 0.0006, 0] * far
            noisy = poses.perturb(begun, step + np.sqrt(np.diag(own)) * rng.normal(size=6), mug.centroid)
            held.append(test.add(noisy, own, 0 * own, 0 * own, None, 0 * own)[0])
        assert held[:9] == [0.0] * 9
        said.append(max(held[:30]) > test.settings.limit)
    assert np.mean(said) > 0.9 if slips else np.mean(said) < 0.3


def test_spans_go_with_the_hand_and_the_fingers(mug):
    """Whatever hand and fingers do, an object that does the same has not moved; one that stays has."""
    rng = np.random.default_rng(6)
    own = 1e-6 * np.eye(6)
    for stays in (False, True):
        test, pose, found = SpanTest(mug, 40.0), poses.make_pose(None, [0.0, 0.0, 0.5]), 0.0
        for _ in range(20):
            motion, delta = poses.exp(0.01 * rng.normal(size=6)), 0.002 * rng.normal(size=6)
            test.predict(motion, delta, 1e-12 * np.eye(6), np.zeros(6))
            pose = pose if stays else poses.perturb(motion @ pose, delta, mug.centroid)
            found, step = test.add(pose, own, 0 * own, 0 * own, np.array([10.0, 10.0]), 0 * own)
        assert (found > 100.0) == stays
        if not stays:
            np.testing.assert_allclose(step, 0.0, atol=1e-12)


@pytest.mark.parametrize("by_touch", [True, False])
def test_a_calibration_that_touch_alone_has_moves_nothing_in_the_hand(mug, by_touch):
    """Images, and between them frames of touch that a calibration has put four millimetres beside."""
    test, own, none = SlipTest(mug, 40.0), np.diag(np.repeat([0.003, 0.0002], 3) ** 2), np.zeros((6, 6))
    bias, calibration = 1e-8 * np.eye(6), np.diag(np.repeat([0.01, 0.004], 3) ** 2)
    beside = poses.perturb(np.eye(4), np.r_[0.0, 0.0, 0.0, 0.004, 0.0, 0.0], mug.centroid)
    image = Measurement(np.eye(4), own, bias, bias)
    between = Measurement(beside, own, bias + calibration, none if by_touch else bias)
    assert surplus(mug, between, bias).any() == by_touch
    said = []
    for index in range(24):
        test.predict(np.eye(4), np.zeros(6), 1e-12 * np.eye(6))
        measured = between if index % 3 else image
        said.append(test.step(measured, Belief(np.eye(4), own, bias), np.array([10.0, 10.0])))
    assert any(said) != by_touch  # what an image has moved has moved


def test_fingertips_that_no_rigid_motion_explains_slide(mug):
    test = SlipTest(mug, 40.0)
    own = 1e-6 * np.eye(6)
    belief = Belief(np.eye(4), own, 0 * own)
    said = []
    for index in range(12):
        test.predict(np.eye(4), np.zeros(6), 1e-10 * np.eye(6), sliding=25.0 if index >= 8 else 2.0)
        said.append(test.step(Measurement(np.eye(4), own, 0 * own), belief, None))
    assert not any(said[:8])
    assert any(said[8:])
