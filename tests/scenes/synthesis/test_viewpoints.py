"""Cameras are where they were asked to be, and hide what they were asked to hide."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.synthesis.staging.views import ViewSettings, draw_views, find_view, look_at

CAMERA = Camera(570.0, 570.0, 300.0, 250.0, 640, 480)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.3, 1.0), st.floats(-3.0, 3.0))
def test_look_at_puts_the_target_on_the_axis(seed, distance, roll):
    rng = np.random.default_rng(seed)
    direction, target = poses.random_unit_vectors(1, rng)[0], rng.normal(size=3)
    camera_from_scene = look_at(direction, target, distance, roll)
    poses.check_pose(camera_from_scene)
    np.testing.assert_allclose(poses.apply(camera_from_scene, target[None])[0], [0, 0, distance], atol=1e-12)
    eye = poses.inverse(camera_from_scene)[:3, 3]
    np.testing.assert_allclose(eye, target + distance * direction, atol=1e-12)


def test_drawn_views_keep_the_object_in_the_image():
    rng = np.random.default_rng(0)
    ball = 0.08 * poses.random_unit_vectors(200, rng) + [1.0, 2.0, 3.0]
    views = draw_views(100, CAMERA, 0.08, rng, ViewSettings())
    inside = []
    for view in views:
        pixels, depth = CAMERA.project(poses.apply(view.camera_from_scene(np.array([1.0, 2.0, 3.0])), ball))
        inside.append((pixels > -8).all() and (pixels < [648, 488]).all())  # perspective stretches a ball a little
        assert 0.37 < depth.min() < depth.max() < 0.83
    assert all(inside)
    assert np.ptp([view.tangent for view in views]) > 0.1


@pytest.mark.parametrize("wanted", [0.1, 0.5, 0.85])
def test_the_found_view_hides_the_asked_share(wanted):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
    plate = trimesh.creation.box(extents=(0.12, 0.12, 0.01))
    renderer = Renderer({"object": (ball.vertices, ball.faces), "plate": (plate.vertices, plate.faces)})
    scene = {"object": np.eye(4), "plate": poses.make_pose(None, [0, 0, 0.06])}
    args = (renderer, scene, "object", np.zeros(3), 0.04, wanted, CAMERA)
    pose, reached = find_view(*args, np.random.default_rng(1))
    shares = 1 - renderer.visible_fraction(CAMERA, {k: pose @ v for k, v in scene.items()}, "object")
    assert shares == pytest.approx(wanted, abs=0.025)
    assert len(reached) > 0
    np.testing.assert_array_equal(pose, find_view(*args, np.random.default_rng(1))[0])


def test_an_impossible_share_is_not_found():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.04)
    renderer = Renderer({"object": (ball.vertices, ball.faces)})
    pose, reached = find_view(
        renderer, {"object": np.eye(4)}, "object", np.zeros(3), 0.04, 0.5, CAMERA, np.random.default_rng(0)
    )
    assert pose is None
    assert set(reached) == {0.0}


@pytest.mark.parametrize("wanted", [0.0, 0.97])
def test_shares_that_few_directions_give_are_climbed_to(wanted):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
    plate = trimesh.creation.box(extents=(0.075, 0.075, 0.01))
    renderer = Renderer({"object": (ball.vertices, ball.faces), "plate": (plate.vertices, plate.faces)})
    scene = {"object": np.eye(4), "plate": poses.make_pose(None, [0, 0, 0.06])}
    few = ViewSettings(draws=20, batch=20)
    args = (renderer, scene, "object", np.zeros(3), 0.04, wanted, CAMERA)
    pose, _ = find_view(*args, np.random.default_rng(1), few)
    assert pose is not None
    share = 1 - renderer.visible_fraction(CAMERA, {k: pose @ v for k, v in scene.items()}, "object")
    assert share == pytest.approx(wanted, abs=0.025)
    without = ViewSettings(draws=20, batch=20, climbs=0)
    assert wanted == 0.0 or find_view(*args, np.random.default_rng(1), without)[0] is None
