"""Estimates from more contacts than fingers feel: some of them, spread over what was touched, tell what all do."""

from dataclasses import replace

import numpy as np

from fusion.estimation.estimate import estimate
from fusion.tracking.tracker import Tracker
from fusion.truth.errors import Judge
from scenes.geometry import poses
from scenes.recordings.frames import Contacts, Frame
from touch.contacts import TouchSettings, feel

MOST = TouchSettings().most_contacts


def frame_of(model, count):
    truth = poses.make_poses(poses.random_rotations(1, np.random.default_rng(5)), np.array([[0.1, -0.2, 0.3]]))[0]
    points, normals = model.sample_surface(count, seed=3)
    points = poses.apply(truth, points) + 1e-3 * np.random.default_rng(6).normal(size=points.shape)
    felt = Contacts(points, normals @ truth[:3, :3].T, 1e-3, 0.1)
    return Frame(0, contacts=felt), truth


def test_some_of_many_contacts_are_used_and_it_is_said(drill):
    frame, truth = frame_of(drill, 10_000)
    answer = estimate(frame, drill)
    assert answer.verdict == "ok"
    assert Judge(drill).errors(answer.pose, truth).add_s < 0.001
    assert len(answer.contacts) == MOST
    said = f"{MOST} of 10000 contacts are used, spread over what was touched"
    assert said in answer.notes
    tracker = Tracker(drill, prior=truth)
    for index in range(2):  # found by itself, and followed
        assert said in tracker.step(replace(frame, index=index)).notes


def test_as_many_as_are_searched_with_are_all_used(drill):
    felt = feel(frame_of(drill, MOST)[0])
    assert len(felt.reported_contacts) == MOST
    assert felt.left_out == ()
