"""A track reads the outline in the image beside depth, as an estimate does."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import Tracker
from fusion.benchmarks.families.making import settings_of
from fusion.benchmarks.families.table import FAMILIES
from fusion.tracking.answer import TrackSettings
from scenes.geometry import poses
from scenes.synthesis.recording import synthesize_frames

FRAMES, SEEDS = 4, range(4, 12)


@pytest.fixture(scope="module")
def sequences(drill, hand):
    optics = FAMILIES["d435"]
    how = {"noise": optics.preset(), "settings": settings_of(optics), "motion": "carry"}
    return [synthesize_frames(drill, hand, FRAMES, 0.3, seed=seed, **how) for seed in SEEDS]


@pytest.fixture(scope="module")
def frames(sequences):
    return sequences[0]


def every_frame_in_full():
    usual = TrackSettings()
    return replace(usual, glance=replace(usual.glance, every=1))


def followed(frames, model, settings=None):
    tracker = Tracker(model, settings=settings or every_frame_in_full())
    return [tracker.step(frame) for frame in frames]


def across_mm(answers, frames, model):
    """Median distance (mm) of the centroid from the truth across the ray, without the first frame."""
    off = []
    for answer, frame in zip(answers[1:], frames[1:]):
        was, now = (poses.apply(p, model.centroid[None])[0] for p in (frame.camera_from_object_truth, answer.pose))
        ray = was / np.linalg.norm(was)
        off.append(np.linalg.norm((now - was) - ray * (ray @ (now - was))))
    return 1e3 * float(np.median(off))


def read_in(answer):
    """The lines of the outline that an answer's own frame was read by."""
    return sum(stage.rows for stage in answer.trace if stage.name == "outline" and stage.ran)


def test_tracks_are_nearer_across_the_ray_with_it(sequences, drill):
    with_it, without, read = [], [], 0
    for frames in sequences:
        seen = followed(frames, drill)
        blind = followed([replace(frame, rgb=None) for frame in frames], drill)
        read += sum(read_in(answer) > 0 for answer in seen[1:])
        assert not any(read_in(answer) for answer in blind)
        assert min(np.linalg.eigvalsh(answer.covariance).min() for answer in seen) > 0.0
        with_it.append(across_mm(seen, frames, drill))
        without.append(across_mm(blind, frames, drill))
    assert np.mean(with_it) < np.mean(without)  # half a millimetre, and 0.6
    assert read >= 0.75 * len(SEEDS) * (FRAMES - 1)  # an outline that contradicts depth is left out: one in ten


def test_a_black_image_changes_nothing(frames, drill):
    dark = [replace(frame, rgb=np.zeros_like(frame.rgb)) for frame in frames]
    for one, other in zip(followed(dark, drill), followed([replace(f, rgb=None) for f in frames], drill)):
        np.testing.assert_allclose(one.pose, other.pose, atol=1e-9)


def test_it_can_be_left_out(frames, drill):
    settings = every_frame_in_full()
    contour = replace(settings.first.contour, used=False, own=False)
    settings = replace(settings, first=replace(settings.first, contour=contour))
    assert not any(read_in(answer) for answer in followed(frames, drill, settings))
