"""Vision's trackers: a constant velocity, loss and recovery, looking again, and PCL's particle filter."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from scenes.evidence import table as tables
from scenes.geometry import poses
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames
from vision.look.look import look
from vision.look.warm import Looker
from vision.tracking.by_vision import (
    ConstantVelocity,
    VelocitySettings,
    VisionTracker,
    explained_share,
    track_by_vision,
)
from vision.tracking.particles import ParticleTracker, ParticleTrackerSettings, coherences, thin_cloud

SEEDS = st.integers(0, 2**31)


@pytest.fixture(scope="module")
def sequence(hand, drill):
    settings = SynthesisSettings(rgb=False)
    return synthesize_frames(drill, hand, 8, 0.5, noise="lab", seed=31, motion="carry", settings=settings)


def moved(pose, truth, model):
    delta = poses.difference(pose, truth, model.centroid)
    return np.rad2deg(np.linalg.norm(delta[:3])), 1e3 * np.linalg.norm(delta[3:])


@given(SEEDS, st.integers(1, 4))
def test_a_constant_velocity_is_extrapolated_exactly(seed, gap):
    rng = np.random.default_rng(seed)
    centre, delta = 0.05 * rng.normal(size=3), np.repeat([0.02, 0.004], 3) * rng.normal(size=6)
    start = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3))
    motion = ConstantVelocity(centre, VelocitySettings(damping=1.0))
    motion.restart(0, start)
    motion.update(1, poses.perturb(start, delta, centre))
    predicted, noise = motion.predict(1 + gap)
    # turning about one axis: gap steps are one step gap times as long
    np.testing.assert_allclose(predicted, poses.perturb(start, (1 + gap) * delta, centre), atol=1e-9)
    assert noise[0, 0] == pytest.approx((gap * motion.settings.angle) ** 2)


@pytest.mark.parametrize("step", [[0.0, 0.0, 0.0, 0.3, 0.0, 0.0], [0.6, 0.0, 0.0, 0.0, 0.0, 0.0]])
def test_a_jump_is_no_velocity(step):
    motion = ConstantVelocity(np.zeros(3))
    motion.restart(0, np.eye(4))
    motion.update(1, poses.perturb(np.eye(4), np.array(step), np.zeros(3)))
    assert not motion.velocity.any()
    np.testing.assert_array_equal(motion.predict(2)[0], motion.pose)


def test_a_velocity_fades_and_old_frames_are_not_taken():
    motion = ConstantVelocity(np.zeros(3))
    motion.restart(0, np.eye(4))
    motion.update(1, poses.make_pose(None, [0.01, 0, 0]))
    near, far = (motion.predict(1 + n)[0][0, 3] for n in (1, 100))
    assert near == pytest.approx(0.01 + 0.8 * 0.01)
    assert far < 0.01 + 0.05
    motion.update(1, poses.make_pose(None, [1.0, 0, 0]))
    assert motion.pose[0, 3] == 0.01
    motion.coast(2)
    assert motion.index == 2


def test_a_step_that_noise_explains_is_no_velocity():
    motion = ConstantVelocity(np.zeros(3))
    motion.restart(0, np.eye(4))
    # sure along x, unsure along y
    own = np.diag([0.0, 0.0, 0.0, 1e-10, 1e-2, 1e-10])
    motion.update(1, poses.make_pose(None, [0.01, 0.01, 0.0]), own)
    np.testing.assert_allclose(motion.velocity[3:], [0.01, 0.0, 0.0], atol=1e-5)
    motion.corrected(poses.make_pose(None, [0.02, 0.0, 0.0]))
    assert motion.pose[0, 3] == 0.02
    assert motion.velocity[3] == pytest.approx(0.01, rel=1e-3)


def test_vision_follows_a_carried_object(drill, sequence):
    tracks = list(track_by_vision(sequence, drill))
    assert [t.how for t in tracks] == ["started"] + ["tracked"] * 7
    for t, frame in zip(tracks, sequence):
        turn, move = moved(t.pose, frame.camera_from_object_truth, drill)
        assert turn < 6.0
        assert move < 8.0
        assert not t.lost
        assert t.explained > 0.7


def test_vision_says_that_it_is_lost_and_finds_the_object_again(drill, sequence):
    tracker = VisionTracker(drill)
    for frame in sequence[:3]:
        tracker.step(frame)
    gone = np.zeros_like(sequence[3].depth)
    blind = tracker.step(replace(sequence[3], depth=gone))
    assert blind.lost
    assert blind.how == "coasted"
    # somewhere else, as if the object had been moved meanwhile
    tracker.motion.restart(3, poses.perturb(tracker.motion.pose, [0.1, 0.15, 0, 0.02, 0.01, 0.0], drill.centroid))
    found = [tracker.step(frame) for frame in sequence[4:]]
    turn, move = moved(found[-1].pose, sequence[-1].camera_from_object_truth, drill)
    assert turn < 8.0
    assert move < 8.0


def test_without_pixels_there_is_no_start(drill, sequence):
    track = VisionTracker(drill).step(replace(sequence[0], depth=None))
    assert track.lost
    assert track.pixels == 0


def test_looking_again_sees_what_the_first_look_saw(drill, sequence):
    looker = Looker(drill)
    for frame in sequence[:3]:
        looked = looker.look(frame, frame.camera_from_object_truth)
    full = look(sequence[2], drill, start=sequence[2].camera_from_object_truth)
    a, b = looked.hand.aligned, full.hand.aligned
    assert np.rad2deg(poses.rotation_angle(a[:3, :3] @ b[:3, :3].T)) < 0.4
    assert np.linalg.norm(a[:3, 3] - b[:3, 3]) < 0.0025
    local = poses.apply(poses.inverse(sequence[2].camera_from_object_truth), looked.pixels.points)
    near = np.abs(drill.field.distance(local)) < 0.008
    assert near.mean() > 0.85
    assert len(looked.pixels) > 60


def test_looking_outside_the_image_shows_nothing(drill, sequence):
    away = poses.make_pose(None, [5.0, 0.0, 1.0])
    looked = Looker(drill).look(sequence[0], away)
    assert len(looked.pixels) == 0
    share, count = explained_share(drill, tables.empty(), np.eye(4))
    assert np.isnan(share)
    assert count == 0


@given(SEEDS)
def test_compiled_coherences_are_those_of_a_search_tree(seed):
    rng = np.random.default_rng(seed)
    observed, reference = 0.03 * rng.normal(size=(80, 3)), 0.03 * rng.normal(size=(30, 3))
    candidates = poses.exp(0.05 * rng.normal(size=(5, 6)))
    found = coherences(reference, candidates, observed, 0.01, 0.005)
    tree = cKDTree(observed)
    for pose, value in zip(candidates, found):
        distance, _ = tree.query(poses.apply(pose, reference), distance_upper_bound=0.01)
        near = distance[np.isfinite(distance)]
        assert value == pytest.approx(float(np.sum(1.0 / (1.0 + (near / 0.005) ** 2))), rel=1e-9, abs=1e-12)
    assert coherences(reference, candidates, observed[:0], 0.01, 0.005).sum() == 0.0


def test_thinning_keeps_one_mean_a_cell():
    points = np.array([[0.001, 0, 0], [0.002, 0, 0], [0.011, 0, 0]])
    np.testing.assert_allclose(thin_cloud(points, 0.01), [[0.0015, 0, 0], [0.011, 0, 0]])


def test_the_particle_filter_stays_with_the_object(drill, sequence):
    def run():
        tracker = ParticleTracker(
            drill, sequence[0].camera_from_object_truth, ParticleTrackerSettings(particles=300), seed=4
        )
        return [tracker.step(frame) for frame in sequence]

    found = run()
    for pose, frame in zip(found, sequence):
        turn, move = moved(pose, frame.camera_from_object_truth, drill)
        assert turn < 25.0
        assert move < 25.0
    np.testing.assert_array_equal(found[-1], run()[-1])
