"""A mask's pixels that a pose leaves uncovered are against it."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from scenes.evidence.align import AlignSettings, align, costs
from scenes.evidence.table import GATE_ABOVE, GATE_BELOW, SIGMA
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.recordings.beliefs import DepthModel
from scenes.synthesis import library
from vision.picture.masked import beside, core_of, missing, uncovered
from vision.picture.predictor import Predictor
from vision.visibility import visibility


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


def test_how_much_of_a_mask_is_bare_is_told_of_a_pose():
    frame, model = plain_view("drill"), library.make("drill")
    truth = frame.camera_from_object_truth
    whole = outline(model, frame.camera, truth)
    frame = replace(frame, mask=whole)
    assert visibility(frame, model, truth).bare == 0.0
    width = np.ptp(np.nonzero(whole)[1]) / frame.camera.fx * truth[2, 3]
    aside = poses.make_pose(np.eye(3), np.array([0.5 * width, 0.0, 0.0])) @ truth
    assert 0.3 < visibility(frame, model, aside).bare < 0.9
    assert np.isnan(visibility(replace(frame, mask=None), model, aside).bare)
    # where the object is out of the image the mask is all bare
    gone = poses.make_pose(np.eye(3), np.array([10.0, 0.0, 0.0])) @ truth
    assert visibility(frame, model, gone).bare == 1.0


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


@pytest.mark.parametrize("name", ["box", "mug"])
def test_the_place_beside_an_object_is_the_nearest_on_its_ray(name, rng):
    """By three thousand places along each ray."""
    frame, model = plain_view(name), library.make(name)
    truth = frame.camera_from_object_truth
    some = np.array([poses.displaced(truth, 0.5, 0.5 * model.radius, model.centroid, rng) for _ in range(30)])
    rays = rng.normal(size=(30, 3)) * [0.05, 0.05, 0.0] + [0.0, 0.0, 1.0] + truth[:3, 3] * [1.0, 1.0, 0.0] / truth[2, 3]
    places = beside(model, rays, some, 12)
    np.testing.assert_allclose(np.cross(places, rays), 0.0, atol=1e-9)
    for place, ray, pose in zip(places, rays, some):
        along = ray / np.linalg.norm(ray)
        near = poses.apply(pose, model.centroid[None])[0] @ along
        tried = np.linspace(near - model.radius, near + model.radius, 3000)[:, None] * along
        inward = poses.inverse(pose)
        least = model.field.distance(poses.apply(inward, tried)).min()
        found = model.field.distance(poses.apply(inward, place[None]))[0]
        # inside it any place will do
        assert min(found, 0.0) <= least + 0.02 * model.radius
        assert least > 0.0 or found < 0.02 * model.radius
        assert found < max(least, 0.0) + 0.02 * model.radius


def test_of_an_object_behind_the_camera_the_place_is_in_front_of_it():
    model = library.make("box")
    pose = poses.make_pose(None, [0.0, 0.0, -0.5])
    assert (beside(model, np.array([[0.1, 0.0, 1.0]]), pose[None], 12)[:, 2] > 0.0).all()


@pytest.mark.parametrize("name", ["box", "drill"])
def test_what_of_a_mask_a_pose_leaves_bare_draws_it_there(name):
    frame, model = plain_view(name), library.make(name)
    truth = frame.camera_from_object_truth
    masked = replace(frame, mask=outline(model, frame.camera, truth))
    told, bare = Predictor(masked, model, DepthModel()), Predictor(frame, model, DepthModel())
    aside = poses.make_pose(None, [0.5 * model.radius, -0.3 * model.radius, 0.0]) @ truth
    assert [len(rows) for rows in bare.covering(np.array([truth, aside]))] == [0, 0]
    none, some = told.covering(np.array([truth, aside]))
    assert not len(none)
    pixels, _ = told._core
    assert len(some) == missing(model, frame.camera, pixels, aside[None]).sum() > 0
    assert told.covering(np.zeros((0, 4, 4))) == []
    # they say something of what is outside alone, and no pixel that was read
    assert (some.rows[:, GATE_ABOVE] > 0).all()
    assert not some.rows[:, GATE_BELOW].any()
    assert not some.on.any()
    # the place beside a wrong pose need not be at the depth of the right one
    assert costs(model, some, truth[None])[0] < 0.3 * costs(model, some, aside[None])[0]
    nearer = align(model, some, aside[None], None, AlignSettings(iterations=20)).poses
    assert uncovered(model, frame.camera, pixels, nearer)[0] < uncovered(model, frame.camera, pixels, aside[None])[0]
    assert (some.rows[:, SIGMA] == told.settings.cover.sigma).all()
