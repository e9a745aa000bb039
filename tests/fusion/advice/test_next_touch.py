"""Where to touch next: what is predicted is what a contact there would do, and it is where it matters."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.advice.next_touch import NextTouchSettings, best_apart, hand_around, nearest_finger, next_touches
from fusion.estimation.answer import ContactResidual, Estimate, Mode
from fusion.estimation.posterior.verdict import contributions
from fusion.truth.metrics import model_points
from scenes.evidence import table as evidence
from scenes.evidence.align import Prior, terms
from scenes.evidence.modes import covariance_of
from scenes.evidence.table import TOUCH, VISION
from scenes.geometry import poses
from scenes.synthesis import library
from scenes.synthesis.recording import synthesize_frames

TIGHT = np.diag([1e-3**2] * 3 + [2e-4**2] * 3)


def answer_of(pose, covariance, modes=None):
    modes = modes or (Mode(pose, 1.0, 0.0, covariance),)
    return Estimate(0, pose, covariance, modes, "ok")


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def test_a_mug_of_unknown_turn_is_touched_at_its_handle(mug, rng):
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], [0.1, 0.0, 0.6])
    axis = pose[:3, 2]
    wide = TIGHT.copy()
    wide[:3, :3] += np.deg2rad(8.0) ** 2 * np.outer(axis, axis)
    first = next_touches(mug, answer_of(pose, wide))[0]
    body = np.abs(np.linalg.norm(mug.vertices[:, :2], axis=1) - np.linalg.norm(first.point[:2]))
    assert np.linalg.norm(first.point[:2]) > 0.045, f"expected the handle, got {first.point}, {body.min()}"
    assert first.sigma_rotation < np.deg2rad(4.0)
    assert np.allclose(first.camera_point, poses.apply(pose, first.point[None])[0])


def test_what_is_left_is_the_posterior_with_the_contact(drill, rng):
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.0, 0.5])
    root = rng.normal(size=(6, 6)) * np.repeat([0.05, 0.003], 3)[:, None]
    covariance = root @ root.T + TIGHT
    settings = NextTouchSettings(sigma_point=5e-4)
    for touch in next_touches(drill, answer_of(pose, covariance), settings=settings):
        outward = pose[:3, :3] @ touch.normal
        row = evidence.make(
            touch.camera_point[None],
            settings.sigma_point,
            TOUCH,
            normals=outward[None],
            sigma_normal=settings.sigma_normal,
            from_outside=True,
        )
        information = np.linalg.inv(covariance) + terms(drill, row, pose)[2]
        left = np.linalg.inv(information)
        assert touch.sigma_position == pytest.approx(np.sqrt(np.linalg.eigvalsh(left[3:, 3:])[-1]), rel=1e-3)
        assert touch.sigma_rotation == pytest.approx(np.sqrt(np.linalg.eigvalsh(left[:3, :3])[-1]), rel=1e-3)
        gain = 0.5 * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(left)[1])
        assert touch.gain == pytest.approx(gain, rel=1e-3)
        assert touch.between_modes == 0.0


def test_two_modes_are_told_apart_where_they_differ(mug):
    pose = poses.make_pose(np.eye(3), [0.0, 0.0, 0.5])
    turned = pose @ poses.make_pose(poses.exp_rotation(np.array([[0, 0, np.pi / 2]]))[0], np.zeros(3))
    modes = (Mode(pose, 0.5, 0.0, TIGHT), Mode(turned, 0.5, 0.0, TIGHT))
    first = next_touches(mug, answer_of(pose, TIGHT, modes))[0]
    assert 0.5 < first.between_modes <= np.log(2) + 1e-9
    assert np.linalg.norm(first.point[:2]) > 0.045


def test_places_are_apart_and_the_hands_are_left_out(drill, hand, rng):
    answer = answer_of(poses.make_pose(np.eye(3), [0.0, 0.0, 0.5]), TIGHT)
    found = next_touches(drill, answer, count=4)
    points = np.array([t.point for t in found])
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(4, 1)]
    assert gaps.min() > 0.2 * drill.radius
    assert [t.gain for t in found] == sorted((t.gain for t in found), reverse=True)
    assert all(t.finger is None for t in found)

    frame = synthesize_frames(drill, hand, 1, 0.3, noise="clean", seed=3)[0]
    truth = frame.camera_from_object_truth
    camera_from_hand = frame.camera_from_world @ frame.world_from_hand
    held = replace(
        answer_of(truth, TIGHT),
        hand_from_object=poses.inverse(camera_from_hand) @ truth,
        contacts=(ContactResidual("thumb_tip", 0.0, 0.0, False),),
    )
    surface = poses.apply(camera_from_hand, frame.hand.points_on_surface(frame.joints))
    for touch in next_touches(drill, held, frame):
        assert np.linalg.norm(surface - touch.camera_point, axis=1).min() > NextTouchSettings().room
        assert touch.finger in frame.hand.sensors
        assert touch.finger != "thumb_tip"


def test_no_sensor_of_a_finger_that_touches_is_free(hand, drill):
    frame = synthesize_frames(drill, hand, 1, 0.3, noise="clean", seed=3, touch=("wrench", "array"))[0]
    truth, sensors = frame.camera_from_object_truth, frame.hand.sensors
    camera_from_hand = frame.camera_from_world @ frame.world_from_hand
    in_hand = poses.inverse(camera_from_hand) @ truth
    felt = (ContactResidual("thumb_tip", 0.0, 0.0, False),)
    free, _ = hand_around(frame, replace(answer_of(truth, TIGHT), hand_from_object=in_hand, contacts=felt))
    assert free
    assert all(sensors[name].link != sensors["thumb_tip"].link for name in free)
    assert sum(sensor.link == sensors["thumb_tip"].link for sensor in sensors.values()) > 1


@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e6])
def test_any_covariance_gives_numbers(drill, scale):
    pose = poses.make_pose(np.eye(3), [0.0, 0.0, 0.5])
    for touch in next_touches(drill, answer_of(pose, scale * np.eye(6))):
        assert np.isfinite([touch.gain, touch.sigma_position, touch.sigma_rotation]).all()
        assert touch.gain >= 0.0


def test_what_each_source_added(drill, rng):
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.0, 0.5])
    points, normals = drill.sample_surface(60, seed=1)
    points, normals = poses.apply(pose, points), normals @ pose[:3, :3].T
    seen = evidence.make(points[:50], 0.002, VISION)
    felt = evidence.make(points[50:], 0.001, TOUCH, normals=normals[50:], sigma_normal=0.1)
    prior = Prior.isotropic(pose, 0.2, 0.02)
    rows = evidence.stack(seen, felt)
    by_rows = covariance_of(drill, terms(drill, rows, pose, prior)[2])
    # errors that all rows share make the answer wider than its rows are
    covariance = by_rows + np.diag([1e-4, 0.0, 0.0, 0.0, 4e-6, 0.0])
    both = contributions(drill, rows, pose, covariance, prior)
    assert [c.source for c in both] == ["vision", "touch", "prior"]
    assert [c.rows for c in both] == [50, 10, 0]
    for c in both:
        assert c.position_with == pytest.approx(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))
        assert c.rotation_with == pytest.approx(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
        assert c.position_with <= c.position_without + 1e-12
        assert c.rotation_with <= c.rotation_without + 1e-12
    alone = contributions(drill, felt, pose, covariance_of(drill, terms(drill, felt, pose)[2]))
    assert [c.source for c in alone] == ["touch"]
    assert alone[0].position_without > 10 * alone[0].position_with  # nothing else holds it
    assert contributions(drill, evidence.empty(), pose, np.eye(6)) == ()


def test_places_are_the_best_that_are_apart(rng):
    places, gain = rng.normal(size=(60, 3)), rng.normal(size=60)
    gain[:20] = -np.inf
    chosen = best_apart(places, gain, 5, 0.8)
    assert chosen[0] == np.argmax(gain)
    assert np.all(np.diff(gain[chosen]) <= 0)
    gaps = np.linalg.norm(places[chosen][:, None] - places[chosen][None], axis=2)[np.triu_indices(len(chosen), 1)]
    assert gaps.min() > 0.8
    for i in np.flatnonzero(gain > gain[chosen[-1]]):  # whatever is better stands beside one that is better still
        better = [j for j in chosen if gain[j] >= gain[i]]
        assert i in chosen or np.linalg.norm(places[better] - places[i], axis=1).min() <= 0.8
    assert best_apart(places, np.full(60, -np.inf), 5, 0.8) == []


def test_the_nearest_finger():
    tips = {"far": np.array([0.0, 0.0, 1.0]), "near": np.array([0.0, 0.3, 0.4])}
    assert nearest_finger(tips, np.zeros(3)) == ("near", pytest.approx(0.5))
    assert nearest_finger({}, np.zeros(3)) == (None, None)


def test_what_is_told_is_the_callers_own(drill):
    answer = answer_of(np.eye(4), TIGHT)
    before = next_touches(drill, answer)
    told = [place.point.tolist() for place in before]
    for place in before:
        for part in (place.point, place.normal, place.camera_point):
            part *= 1000.0
    points = model_points(drill, 500)
    points += 1.0
    assert [place.point.tolist() for place in next_touches(drill, answer)] == told
    assert np.abs(model_points(drill, 500)).max() < 1.0
