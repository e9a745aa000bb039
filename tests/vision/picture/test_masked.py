"""A mask's pixels that a pose leaves uncovered are against it."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from scenes.geometry import poses
from scenes.geometry.rendering import Renderer
from scenes.recordings.beliefs import DepthModel
from scenes.synthesis import library
from vision.picture.masked import core_of, uncovered
from vision.picture.predictor import Predictor


def outline(model, camera, pose):
    return Renderer({"object": (model.vertices, model.faces)}).render(camera, {"object": pose}).depth > 0


def test_the_core_of_a_mask_is_inside_it_and_a_thin_mask_has_one():
    mask = np.zeros((60, 80), dtype=bool)
    mask[20:45, 10:70] = True
    core = core_of(mask, 6, 40)
    assert len(core) == 40
    assert core[:, 1].min() >= 25
    assert core[:, 1].max() <= 39
    thin = np.zeros_like(mask)
    thin[30:33, 5:75] = True
    core = core_of(thin, 6, 40)
    assert len(core)
    assert thin[core[:, 1], core[:, 0]].all()
    assert not len(core_of(np.zeros_like(mask), 6, 40))


def test_rays_that_meet_nothing_are_the_pixels_outside_the_outline(rng):
    frame, model = plain_view("mug"), library.make("mug")
    truth = frame.camera_from_object_truth
    some = np.array([truth, *(poses.displaced(truth, 0.5, 0.03, model.centroid, rng) for _ in range(4))])
    pixels = core_of(outline(model, frame.camera, truth), 4, 200)
    drawn = [outline(model, frame.camera, pose)[pixels[:, 1], pixels[:, 0]] for pose in some]
    found = uncovered(model, frame.camera, pixels, some)
    np.testing.assert_allclose(found, [1.0 - inside.mean() for inside in drawn], atol=0.02)
    assert found[0] == 0.0


@pytest.mark.parametrize("name", ["box", "drill"])
def test_a_pose_beside_a_mask_costs_what_it_leaves_uncovered(name):
    frame, model = plain_view(name), library.make(name)
    truth = frame.camera_from_object_truth
    masked = replace(frame, mask=outline(model, frame.camera, truth))
    both = np.array([truth, poses.make_pose(None, [0.6 * model.radius, 0.0, 0.0]) @ truth])
    told, bare = Predictor(masked, model, DepthModel()), Predictor(frame, model, DepthModel())
    assert not bare._uncovered_costs(both).any()
    costs = told._uncovered_costs(both)
    assert costs[0] == 0.0
    assert 5.0 < costs[1] <= told.settings.uncovered
    np.testing.assert_allclose(told.costs(both), told._cost_of(both, told.predict(both)) + costs)
