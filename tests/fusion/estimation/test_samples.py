"""Poses drawn from answers: as their modes and covariances say, of estimates, of touch alone, and of files."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from fusion import sample_poses
from fusion.estimation.answer import Estimate, Mode
from fusion.results.files import read_result, result_json
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch import localize

POSE = poses.exp([0.3, -0.4, 0.2, 0.05, -0.02, 0.6])
NARROW, WIDE = np.diag([0.02**2] * 3 + [0.003**2] * 3), np.diag([0.05**2] * 3 + [0.008**2] * 3)


@pytest.fixture(scope="module")
def box():
    return library.make("box")


def turned_answer():
    """Two modes a quarter turn apart, as wide as each other."""
    turned = POSE @ poses.make_pose(poses.exp_rotation([0, 0, np.pi / 2]))
    modes = (Mode(POSE, 0.75, 0.0, NARROW), Mode(turned, 0.25, 1.0, NARROW))
    return Estimate(3, POSE, NARROW, modes, "ambiguous")


def test_samples_follow_modes_and_covariance(box):
    answer = turned_answer()
    drawn = sample_poses(box, answer, 4000, seed=1)
    first = np.linalg.norm(poses.difference(drawn, POSE, box.centroid)[:, :3], axis=1) < 0.5
    assert first.mean() == pytest.approx(0.75, abs=0.03)
    spread = np.cov(poses.difference(drawn[first], POSE, box.centroid).T)
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), np.sqrt(np.diag(NARROW)), rtol=0.08)
    np.testing.assert_array_equal(drawn, sample_poses(box, answer, 4000, seed=1))
    unknown = replace(answer, modes=(Mode(POSE, 1.0, 0.0, np.full((6, 6), np.nan)),))
    assert len(sample_poses(box, unknown, 10, seed=0)) == 0


def test_answers_of_touch_alone_are_drawn_from(box):
    points, normals = box.sample_surface(20, seed=4)
    where = localize(box, Contacts(points, normals, 0.001, 0.1).moved(POSE), seed=0)
    drawn = sample_poses(box, where, 50)
    assert drawn.shape == (50, 4, 4)
    poses.check_pose(drawn)


def test_a_file_has_each_mode_as_wide_as_it_was(box, tmp_path):
    """Else what is drawn from a result is wider than what is drawn from its estimate."""
    answer = replace(turned_answer(), covariance=WIDE)
    path = tmp_path / "result.json"
    content = result_json("capture", box, [answer], [None], [()])
    path.write_text(json.dumps(content))
    (read,) = read_result(path)[1]
    np.testing.assert_allclose(read.covariance, WIDE)
    np.testing.assert_allclose(sample_poses(box, read, 20), sample_poses(box, answer, 20), atol=1e-12)
    for mode in content["frames"][0]["modes"]:
        del mode["covariance"]  # as before modes said theirs
    path.write_text(json.dumps(content))
    np.testing.assert_allclose(read_result(path)[1][0].modes[1].covariance, WIDE)
