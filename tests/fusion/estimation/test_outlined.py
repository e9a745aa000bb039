"""The answer with the image's outline: better where it tells, the same where it does not, never worse."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fusion import estimate
from fusion.estimation.settings import EstimateSettings
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.recordings.beliefs import Beliefs, ImageModel
from scenes.synthesis import library
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

USUAL = EstimateSettings()
PLAIN, COLOUR = (replace(USUAL, contour=replace(USUAL.contour, used=used, own=used)) for used in (False, True))


@pytest.fixture(scope="module")
def held(hand):
    """A bottle in a hand that hides a third of it, with a lab's errors, and its colours."""
    settings = SynthesisSettings(prior_angle=0.1, prior_distance=0.01)
    return synthesize_frames(library.make("bottle"), hand, 1, 0.3, noise="lab", seed=8, settings=settings)[0]


def across(pose, frame, model):
    """How far (m) the centroid is from the truth across the ray."""
    at, there = (poses.apply(one, model.centroid[None])[0] for one in (pose, frame.camera_from_object_truth))
    ray = there / np.linalg.norm(there)
    return float(np.linalg.norm((at - there) - ((at - there) @ ray) * ray))


def stage_of(answer):
    return next(stage for stage in answer.trace if stage.name == "outline")


def test_the_outline_has_its_say_and_keeps_the_answer_honest(held):
    model = library.make("bottle")
    before, after = estimate(held, model, settings=PLAIN), estimate(held, model, settings=COLOUR)
    assert not stage_of(before).ran
    assert stage_of(after).rows > 20
    assert across(after.pose, held, model) <= across(before.pose, held, model) + 1e-4
    assert np.linalg.eigvalsh(after.covariance).min() > 0.0
    # it is surer across the ray
    assert np.trace(after.covariance[3:5, 3:5]) < np.trace(before.covariance[3:5, 3:5])
    assert np.array_equal(after.pose, estimate(held, model, settings=COLOUR).pose)


def test_where_lines_are_unclear_the_answer_is_less_sure(held):
    """Half of the picture grey noise, on which no border is clear."""
    model = library.make("bottle")
    noise = np.random.default_rng(4).integers(90, 110, held.rgb.shape).astype(np.uint8)
    half = np.where((np.arange(held.rgb.shape[1]) < held.rgb.shape[1] // 2)[None, :, None], held.rgb, noise)
    wary = replace(COLOUR, contour=replace(COLOUR.contour, unclear=0.8))
    sure = replace(COLOUR, contour=replace(COLOUR.contour, unclear=0.0))
    for rgb in (held.rgb, half):
        frame = replace(held, rgb=rgb)
        least, most = (estimate(frame, model, settings=one) for one in (sure, wary))
        assert np.array_equal(least.pose, most.pose)
        assert np.trace(most.covariance) >= np.trace(least.covariance)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (np.zeros_like, "dark"),
        (lambda rgb: np.full_like(rgb, 255), "overexposed"),
        (lambda rgb: np.full_like(rgb, 128), "no contrast"),
        (lambda rgb: np.roll(rgb, 10, axis=1), "registered"),
        (lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 6.0), "blurred"),
    ],
)
def test_an_image_that_cannot_help_changes_nothing_and_is_said(held, change, said):
    model = library.make("bottle")
    before = estimate(held, model, settings=PLAIN)
    after = estimate(replace(held, rgb=change(held.rgb)), model, settings=COLOUR)
    assert np.array_equal(before.pose, after.pose)
    assert np.array_equal(before.covariance, after.covariance)
    assert said in stage_of(after).why
    assert any(said in note for note in after.notes)


@pytest.mark.parametrize(
    "change",
    [
        lambda rgb: rgb[..., ::-1],
        lambda rgb: np.repeat(rgb[..., :1], 3, axis=2),
        lambda rgb: (rgb // 4).astype(np.uint8),
    ],
)
def test_other_colours_are_no_worse_than_none(held, change):
    model = library.make("bottle")
    before, after = (
        estimate(held, model, settings=PLAIN),
        estimate(replace(held, rgb=change(held.rgb)), model, settings=COLOUR),
    )
    assert across(after.pose, held, model) <= across(before.pose, held, model) + 3e-4


def test_an_image_of_noise_moves_little(held):
    model = library.make("bottle")
    noise = np.random.default_rng(0).integers(0, 256, held.rgb.shape, dtype=np.uint8)
    before, after = estimate(held, model, settings=PLAIN), estimate(replace(held, rgb=noise), model, settings=COLOUR)
    moved = poses.difference(after.pose, before.pose, model.centroid)
    assert np.linalg.norm(moved[3:]) < 5e-4


def test_an_image_of_another_size_is_refused_in_a_line(held):
    with pytest.raises(InputError, match="rgb"):
        replace(held, rgb=held.rgb[:100, :100])


def test_another_outline_may_have_been_read_and_moves_nothing(held):
    """What the image narrows stays open by the chance that it showed another outline; the pose is the same."""
    model = library.make("bottle")
    never, usual, often = (
        estimate(held, model, settings=replace(COLOUR, contour=replace(COLOUR.contour, another=share)))
        for share in (0.0, COLOUR.contour.another, 0.5)
    )
    assert np.array_equal(never.pose, usual.pose)
    assert np.array_equal(never.pose, often.pose)
    sizes = [np.linalg.slogdet(answer.modes[0].covariance[3:, 3:])[1] for answer in (never, usual, often)]
    assert sizes == sorted(sizes)
    assert sizes[0] < sizes[2]


def test_an_image_that_is_told_to_lie_on_depth_moves_the_pose_farther(held):
    """Shifted by two pixels: of a camera that may be, most of it is the camera's; of one that cannot, the object's."""
    model = library.make("bottle")
    shifted = replace(held, rgb=np.roll(held.rgb, 2, axis=1))
    untouched = estimate(shifted, model, settings=PLAIN)
    moved = []
    for sigma in (1.5, 0.25):
        told = replace(shifted, beliefs=Beliefs(image=ImageModel(colour_sigma=sigma)))
        answer = estimate(told, model, settings=COLOUR)
        assert stage_of(answer).rows > 20
        moved.append(float(np.linalg.norm(answer.pose[:3, 3] - untouched.pose[:3, 3])))
    assert moved[1] > moved[0]


def test_the_hand_follows_the_pose(held):
    """hand_from_object: the calibration is corrected with the pose, so that contacts stay where they were felt."""
    model = library.make("bottle")
    before, after = estimate(held, model, settings=PLAIN), estimate(held, model, settings=COLOUR)
    worst = [max(abs(one.residual_mm) for one in answer.contacts) for answer in (before, after)]
    assert worst[1] < worst[0] + 0.5


def test_both_kinds_of_images_are_asked_without_being_told_to(held):
    model = library.make("bottle")
    assert stage_of(estimate(held, model)).rows > 20
    grey = replace(held, rgb=np.repeat(held.rgb[..., :1], 3, axis=2))
    assert stage_of(estimate(grey, model)).rows > 20
    only_own = replace(USUAL, contour=replace(USUAL.contour, used=False))
    assert "not asked for" in stage_of(estimate(held, model, settings=only_own)).why
    # colours and depth of one sensor, and a grey camera beside depth
    told = replace(held, beliefs=Beliefs(image=ImageModel(colour_sigma=0.25)))
    assert stage_of(estimate(told, model, settings=only_own)).rows > 20
    another = replace(grey, beliefs=Beliefs(image=ImageModel().of_another_camera()))
    assert "not asked for" in stage_of(estimate(another, model, settings=only_own)).why
    assert not stage_of(estimate(replace(held, rgb=None), model)).ran


def test_without_it_an_image_changes_nothing(held):
    """Turned off, the answer is bit for bit that of a frame without an image."""
    model = library.make("bottle")
    before, after = estimate(replace(held, rgb=None), model), estimate(held, model, settings=PLAIN)
    assert np.array_equal(before.pose, after.pose)
    assert np.array_equal(before.covariance, after.covariance)
    assert before.notes == after.notes


@pytest.mark.parametrize("shift", [(3, 0), (0, 3), (-2, 2)])
def test_an_image_a_few_pixels_beside_depth_is_no_worse_than_none(held, shift):
    """As a colour camera's calibration leaves it: what all lines share is the image's, not the object's."""
    model = library.make("bottle")
    before = estimate(held, model, settings=PLAIN)
    after = estimate(replace(held, rgb=np.roll(held.rgb, shift, axis=(0, 1))), model, settings=COLOUR)
    assert across(after.pose, held, model) <= across(before.pose, held, model) + 3e-4


def test_distance_stays_with_depth(held):
    """What an outline seems to tell of distance is how fat it looks: two pixels fatter it brings nothing nearer."""
    model = library.make("bottle")
    colour = np.array([206, 116, 58])
    own = (
        np.abs(held.rgb / np.maximum(held.rgb.max(axis=2, keepdims=True), 1) - colour / 206).max(axis=2) < 0.05
    ).astype(np.uint8)
    fat = np.where(
        cv2.dilate(own, np.ones((5, 5), np.uint8))[..., None] > 0, cv2.dilate(held.rgb, np.ones((5, 5))), held.rgb
    )
    before = estimate(held, model, settings=PLAIN)
    after = estimate(replace(held, rgb=fat.astype(np.uint8)), model, settings=COLOUR)
    ray = before.pose[:3, :3] @ model.centroid + before.pose[:3, 3]
    ray = ray / np.linalg.norm(ray)
    moved = poses.difference(after.pose, before.pose, model.centroid)[3:]
    assert abs(moved @ ray) < 1e-3
