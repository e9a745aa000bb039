"""Rendering against exact geometry: back-projected pixels lie on the surface, occlusion counts are right."""

import pickle
import time

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer, region_rays, shade
from scenes.geometry.cameras import Camera
from scenes.synthesis import library
from scenes.threads import thread_count

CAMERA = Camera(570.0, 572.0, 319.3, 238.9, 640, 480)
SMALL = CAMERA.scaled(0.25)
BOX = trimesh.creation.box(extents=(0.10, 0.07, 0.05))


def box_distance(points, half):
    outside = np.abs(points) - half
    return np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(axis=1), 0)


def placed(seed, distance=0.6):
    rng = np.random.default_rng(seed)
    return poses.make_pose(poses.random_rotations(1, rng)[0], [*rng.uniform(-0.05, 0.05, 2), distance])


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.25, 1.5), st.floats(-3.0, 3.0))
def test_back_projected_pixels_lie_on_the_surface(seed, distance, away):
    """Also for a mesh far from its own origin, where float32 alone would lose the digits."""
    offset = np.array([away, -away, 2 * away])
    camera_from_box = placed(seed, distance)
    shifted = camera_from_box @ poses.make_pose(None, -offset)
    rendering = Renderer({"box": (BOX.vertices + offset, BOX.faces)}).render(SMALL, {"box": shifted})
    points = poses.apply(poses.inverse(camera_from_box), SMALL.back_project(rendering.depth))
    assert len(points) > 50
    assert np.abs(box_distance(points, BOX.extents / 2)).max() < 1e-6


def test_normals_face_the_camera_and_match_the_sides():
    pose = placed(3)
    rendering = Renderer({"box": (BOX.vertices, BOX.faces)}).render(CAMERA, {"box": pose})
    seen = rendering.ids == 0
    local = rendering.normals[seen] @ pose[:3, :3]
    np.testing.assert_allclose(np.abs(local).max(axis=1), 1.0, atol=1e-12)
    rays = CAMERA.rays()[seen]
    assert (np.einsum("ij,ij->i", rendering.normals[seen], rays) < 0).all()
    points = poses.apply(poses.inverse(pose), CAMERA.back_project(rendering.depth))
    side = np.argmax(np.abs(local), axis=1)
    sign = np.take_along_axis(local, side[:, None], 1)[:, 0]
    at = np.take_along_axis(points, side[:, None], 1)[:, 0]
    np.testing.assert_allclose(at, sign * BOX.extents[side] / 2, atol=1e-6)


def test_silhouette_agrees_with_an_independent_ray_caster():
    pose = placed(11)
    rendering = Renderer({"box": (BOX.vertices, BOX.faces)}).render(SMALL, {"box": pose})
    moved = BOX.copy()
    moved.apply_transform(pose)
    rays = SMALL.rays().reshape(-1, 3)
    hit = moved.ray.intersects_any(np.zeros_like(rays), rays)
    assert np.sum(hit != (rendering.ids >= 0).ravel()) <= 2  # a ray through an edge may go either way
    assert hit.sum() > 100


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.tuples(*[st.integers(-50, 700)] * 4))
def test_region_equals_the_crop_of_the_whole(seed, corners):
    renderer = Renderer({"a": (BOX.vertices, BOX.faces), "b": (BOX.vertices, BOX.faces)})
    where = {"a": placed(seed), "b": placed(seed + 1, 0.5)}
    whole = renderer.render(CAMERA, where)
    part = renderer.render(CAMERA, where, corners)
    u0, v0, u1, v1 = part.region
    np.testing.assert_array_equal(part.depth, whole.depth[v0:v1, u0:u1])
    np.testing.assert_array_equal(part.ids, whole.ids[v0:v1, u0:u1])
    np.testing.assert_allclose(region_rays(CAMERA, part.region), CAMERA.rays()[v0:v1, u0:u1])


def test_the_nearer_mesh_hides_the_farther_and_the_share_is_exact():
    plate = trimesh.creation.box(extents=(0.2, 0.2, 0.01))
    renderer = Renderer({"object": (plate.vertices, plate.faces), "cover": (plate.vertices, plate.faces)})
    camera = Camera(500.0, 500.0, 99.5, 99.5, 200, 200)
    where = {"object": poses.make_pose(None, [0, 0, 0.605]), "cover": poses.make_pose(None, [0.1, 0, 0.505])}
    # Front faces at 0.6 m and 0.5 m: the plate spans |u| < 83.3 px, the cover u > 0: half of the plate is hidden
    assert renderer.visible_fraction(camera, where, "object") == pytest.approx(0.5, abs=1e-9)
    rendering = renderer.render(camera, where)
    alone, seen = renderer.own_pixels(camera, where, "object")
    assert rendering.mask("object").sum() == seen
    assert alone == 2 * seen
    assert rendering.depth[100, 50] == np.float32(0.6)
    assert rendering.depth[100, 120] == np.float32(0.5)
    assert not rendering.mask("absent").any()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_own_pixels_agree_with_the_rendered_ids(seed):
    renderer = Renderer({"a": (BOX.vertices, BOX.faces), "b": (BOX.vertices, BOX.faces)})
    where = {"a": placed(seed), "b": placed(seed + 1, 0.5)}
    alone, seen = renderer.own_pixels(SMALL, where, "a")
    assert seen == renderer.render(SMALL, where).mask("a").sum()
    assert alone == renderer.render(SMALL, {"a": where["a"]}).mask("a").sum()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.06, 0.9))
def test_own_pixels_of_many_vertices_behind_several_things(seed, distance):
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    assert len(ball.vertices) > 4000
    ball.vertices *= (1.0, 0.3, 2.0)
    wall = np.array([[-0.05, -1, 0], [1, -1, 0], [1, 1, 0.1], [-0.05, 1, 0.1]]), np.array([[0, 1, 2], [0, 2, 3]])
    shapes = {"a": (ball.vertices, ball.faces), "wall": wall, "b": (BOX.vertices, BOX.faces)}
    renderer = Renderer(shapes)
    where = {"a": placed(seed, distance), "wall": placed(seed + 1, 0.4), "b": placed(seed + 2, 0.5)}
    for _ in range(2):  # then once more in a view that is known
        alone, seen = renderer.own_pixels(SMALL, where, "a")
        assert seen == renderer.render(SMALL, where).mask("a").sum()
        assert alone == renderer.render(SMALL, {"a": where["a"]}).mask("a").sum()
    assert renderer.copy().own_pixels(SMALL, {"a": where["a"]}, "a") == (alone, alone)
    renderer.add("a", *shapes["b"])
    assert renderer.own_pixels(SMALL, {"a": where["a"]}, "a") == Renderer({"a": shapes["b"]}).own_pixels(
        SMALL, {"a": where["a"]}, "a"
    )


def test_nothing_to_see_is_zero_depth():
    renderer = Renderer({"none": (np.zeros((0, 3)), np.zeros((0, 3))), "box": (BOX.vertices, BOX.faces)})
    behind = poses.make_pose(None, [0, 0, -1.0])
    rendering = renderer.render(SMALL, {"none": np.eye(4), "box": behind})
    assert (rendering.depth == 0).all()
    assert (rendering.ids == -1).all()
    assert renderer.visible_fraction(SMALL, {"box": behind}, "box") == 0.0
    assert Renderer().render(SMALL, {}).depth.shape == (120, 160)


def test_a_mesh_around_the_camera_is_seen_from_inside():
    room = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    rendering = Renderer({"room": (room.vertices, room.faces)}).render(SMALL, {"room": np.eye(4)})
    np.testing.assert_allclose(rendering.depth, 1.0)
    np.testing.assert_allclose(rendering.normals, np.broadcast_to([0.0, 0.0, -1.0], (120, 160, 3)), atol=1e-12)


def test_bad_input_is_refused():
    renderer = Renderer({"box": (BOX.vertices, BOX.faces)})
    with pytest.raises(InputError, match="'cup'"):
        renderer.render(SMALL, {"cup": np.eye(4)})
    with pytest.raises(InputError, match="pose of 'box'"):
        renderer.render(SMALL, {"box": np.full((4, 4), np.nan)})
    with pytest.raises(InputError, match="finite vertices"):
        renderer.add("bad", [[np.nan, 0, 0]], [[0, 0, 0]])
    with pytest.raises(InputError, match="face indices"):
        renderer.add("bad", [[0, 0, 0]], [[0, 0, 1]])
    with pytest.raises(InputError, match="pose of 'box'"):
        renderer.own_pixels(SMALL, {}, "box")


def test_a_renderer_travels_between_processes():
    renderer = Renderer({"box": (BOX.vertices, BOX.faces)})
    first = renderer.render(SMALL, {"box": placed(5)})
    again = pickle.loads(pickle.dumps(renderer)).render(SMALL, {"box": placed(5)})
    np.testing.assert_array_equal(first.depth, again.depth)


def test_shading_colours_instances():
    rendering = Renderer({"box": (BOX.vertices, BOX.faces)}).render(SMALL, {"box": placed(2)})
    image = shade(rendering, {"box": (0, 200, 0)}, background=(9, 9, 9))
    assert image.dtype == np.uint8
    assert image.shape == (120, 160, 3)
    assert (image[rendering.ids < 0] == 9).all()
    assert (image[rendering.ids == 0][:, [0, 2]] == 0).all()
    assert (image[rendering.ids == 0][:, 1] >= 69).all()


def test_thread_setting(monkeypatch):
    monkeypatch.setenv("PALPATE_THREADS", "3")
    assert thread_count() == 3
    monkeypatch.setenv("PALPATE_THREADS", "many")
    with pytest.raises(InputError, match="'many'"):
        thread_count()
    monkeypatch.delenv("PALPATE_THREADS")
    assert thread_count() >= 1


@pytest.mark.parametrize("seed", range(4))
def test_few_faces_are_seen_as_the_ray_caster_sees_them(seed, monkeypatch):
    wall = ([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    pose = placed(seed, 0.8)
    ours = Renderer({"wall": wall}).render(SMALL, {"wall": pose})
    monkeypatch.setattr("scenes.geometry.appearance.rendering.FEW_FACES", 0)
    theirs = Renderer({"wall": wall}).render(SMALL, {"wall": pose})
    same = ours.ids == theirs.ids
    assert same.mean() > 0.999  # a ray through an edge may go either way
    np.testing.assert_allclose(ours.depth[same], theirs.depth[same], rtol=1e-6)
    np.testing.assert_allclose(ours.normals[same], theirs.normals[same], atol=1e-12)


def test_shading_is_lambert():
    rendering = Renderer({"box": (BOX.vertices, BOX.faces)}).render(SMALL, {"box": placed(5)})
    light = np.array([0.2, -0.4, -1.0])
    facing = np.clip(rendering.normals @ (light / np.linalg.norm(light)), 0.0, 1.0)
    expected = (0.35 + 0.65 * facing)[..., None] * [10, 200, 120]
    expected[rendering.ids < 0] = [24, 26, 30]
    image = shade(rendering, {"box": (10, 200, 120)}, light=light)
    assert np.abs(image.astype(int) - expected.astype(np.uint8)).max() <= 1  # rounding of equal sums


def test_threads_that_share_a_new_renderer_see_the_same(monkeypatch):
    """Frames of a sequence are made in parallel; the first to look builds what the others then use, here slowly."""
    from concurrent.futures import ThreadPoolExecutor

    import open3d

    class Slow(open3d.t.geometry.RaycastingScene):
        def add_triangles(self, *mesh):
            time.sleep(0.05)
            return super().add_triangles(*mesh)

    monkeypatch.setattr(open3d.t.geometry, "RaycastingScene", Slow)
    model = library.make("bust")
    camera = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
    pose = {"object": poses.make_pose(translation=[0.0, 0.0, 0.5])}
    with ThreadPoolExecutor(8) as pool:
        for _ in range(5):
            renderer = Renderer({"object": (model.vertices, model.faces)})
            seen = list(pool.map(lambda _, one=renderer: one.render(camera, pose).depth, range(8)))
            assert all((depth == seen[0]).all() for depth in seen)
            assert (seen[0] > 0).any()
