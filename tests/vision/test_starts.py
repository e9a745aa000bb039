"""Starts without a prior: some of the few that are kept are near the truth; normals are the surface's."""

import numpy as np
import pytest
import trimesh
from made_frames import plain_view

from scenes.evidence import table as evidence
from scenes.evidence.table import VISION
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.synthesis import library
from vision.normal_kernels import WINDOW, surface_at
from vision.sight import Sight, SightSettings
from vision.starts import Seen, StartSettings, different, pair_starts, reach_of, seen_starts

SETTINGS = StartSettings()


def seen_side(model, pose, count=1200, noise=0.0, seed=0):
    """Points (n, 3) of the side that faces the camera, and their normals, camera frame."""
    rng = np.random.default_rng(seed)
    points, normals = model.sample_surface(count, seed=seed)
    points, normals = poses.apply(pose, points), normals @ pose[:3, :3].T
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    near = np.sum(normals * rays, axis=1) < -0.3
    return (points + noise * rng.normal(size=(count, 1)) * rays)[near], normals[near]


def no_rank(candidates, blur):
    return np.zeros(len(candidates))


def nearest(model, candidates, truth):
    same = model.symmetries.nearest(candidates, truth)
    delta = poses.difference(same, truth, model.centroid)
    return (np.linalg.norm(delta[:, :3], axis=1) * model.radius + np.linalg.norm(delta[:, 3:], axis=1)).min()


@pytest.mark.parametrize("seed", range(3))
def test_normals_of_a_ball(seed):
    rng = np.random.default_rng(seed)
    ball = library.make("sphere")
    pose = poses.make_pose(translation=[0.02, 0.01, 0.5])
    points, _ = seen_side(ball, pose, 4000, noise=2e-4, seed=seed)
    found, normals = Seen(points).oriented(ball, rng)
    assert len(found) > 0.5 * SETTINGS.oriented
    outward = found - poses.apply(pose, ball.centroid[None])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.quantile(np.sum(outward * normals, axis=1), 0.1) > np.cos(np.deg2rad(12.0))
    assert (np.sum(found * normals, axis=1) < 0).all()


def normals_by_numpy(depth, camera, uv, reach, fewest):
    """Of pixels (n, 2), by singular values of 1 / z against the ray: places, normals, how far readings are off the
    plane (m), and whether there are enough that do not lie on a line.
    """
    depth = depth.astype(np.float64)
    v, u = np.nonzero(depth)
    z = depth[v, u]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], axis=1)
    points, out = rays * z[:, None], []
    for a, b in uv:
        own = np.array([(a - camera.cx) / camera.fx, (b - camera.cy) / camera.fy, 1.0])
        half = int(reach * camera.fx / depth[b, a]), int(reach * camera.fy / depth[b, a])
        steps = [1 + 2 * one // WINDOW for one in half]
        near = (np.linalg.norm(points - own * depth[b, a], axis=1) <= reach) & (np.abs(u - a) <= half[0])
        near &= (np.abs(v - b) <= half[1]) & ((u - a) % steps[0] == 0) & ((v - b) % steps[1] == 0)
        if near.sum() < fewest:
            out.append((own, own, np.inf, False))
            continue
        plane = np.linalg.lstsq(rays[near], 1.0 / z[near], rcond=None)[0]
        spread = np.linalg.eigvalsh(np.cov(rays[near, :2].T))
        off = (rays[near] @ plane * z[near] - 1.0) / np.linalg.norm(plane) / np.linalg.norm(own)
        telling = spread[0] * spread[1] > 0.01 * spread.sum() ** 2
        out.append((own / (own @ plane), -plane / np.linalg.norm(plane), off.std(), telling))
    return (np.array(x) for x in zip(*out))


@pytest.mark.parametrize("reach", [0.004, 0.012])
def test_the_kernel_of_normals_says_what_numpy_says(lab_frame, rng, reach):
    depth, camera = lab_frame.depth, lab_frame.camera
    v, u = np.nonzero(depth)
    uv = np.stack([u, v], axis=1)[rng.permutation(len(u))[:300]]
    (places, normals), good = np.zeros((2, len(uv), 3)), np.zeros(len(uv), dtype=bool)
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    surface_at(depth, lens, uv, reach, SETTINGS.fewest, SETTINGS.thickest, places, normals, good)
    dark = np.argwhere(depth == 0.0)[:1, ::-1].copy()
    there = np.ones(1, dtype=bool)
    surface_at(depth, lens, dark, reach, SETTINGS.fewest, SETTINGS.thickest, np.zeros((1, 3)), np.zeros((1, 3)), there)
    assert not there[0]
    expected_places, expected, off, telling = normals_by_numpy(depth, camera, uv, reach, SETTINGS.fewest)
    clear = np.abs(off - SETTINGS.thickest) > 2e-4
    np.testing.assert_array_equal(good[clear], (telling & (off < SETTINGS.thickest))[clear])
    assert good.sum() > 10
    np.testing.assert_allclose(normals[good], expected[good], atol=1e-6)
    np.testing.assert_allclose(places[good], expected_places[good], atol=1e-6)


def test_a_thin_stick_has_normals_though_few_of_its_pixels_are_looked_at(rng):
    """Of a pipe in the image's whole a few dozen pixels are kept, centimetres apart: what is between tells normals."""
    pipe = trimesh.creation.cylinder(radius=0.01, height=0.3, sections=48)
    model = ObjectModel.from_mesh(np.asarray(pipe.vertices), np.asarray(pipe.faces))
    assert reach_of(model, SETTINGS) < 0.009
    turn = poses.exp_rotation([0.3, 0.0, 0.6]) @ poses.exp_rotation([0.0, np.pi / 2, 0.0])
    pose = poses.make_pose(turn, [0.0, 0.0, 0.6])
    camera = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
    depth = Renderer({"pipe": (model.vertices, model.faces)}).render(camera, {"pipe": pose}).depth
    depth = np.where(depth > 0, depth + rng.normal(0.0, 0.001, depth.shape), 0.0).astype(np.float32)
    v, u = np.nonzero(depth)
    uv = np.stack([u, v], axis=1)[rng.permutation(len(u))[:80]]
    rays = np.stack([(uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy, np.ones(80)], axis=1)
    points = rays * depth[uv[:, 1], uv[:, 0], None]
    found, normals = Seen(points, uv, depth, camera).oriented(model, rng)
    assert len(found) > 60
    local = poses.apply(poses.inverse(pose), found)
    true = np.concatenate([local[:, :2], np.zeros((len(local), 1))], axis=1) @ pose[:3, :3].T
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    assert np.rad2deg(np.arccos(np.clip(np.sum(true * normals, axis=1), -1.0, 1.0))).mean() < 16.0
    # by what was kept alone there are next to none
    assert len(Seen(points).oriented(model, rng)[0]) < 20


@pytest.mark.parametrize("name", ["drill", "box"])
def test_a_pair_start_is_near_the_truth(name):
    model, rng = library.make(name), np.random.default_rng(3)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.03, 0.55])
    points, _ = seen_side(model, truth, 3000, noise=1e-3)
    assert nearest(model, pair_starts(model, Seen(points), rng), truth) < 0.5 * model.radius


def test_kept_starts_are_few_differ_and_hold_the_truth(drill):
    rng = np.random.default_rng(5)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.03, 0.55])
    points, _ = seen_side(drill, truth, 3000, noise=1e-3)
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    rows = evidence.make(points, 0.0025, VISION, gate_above=2.5, gate_below=5.0, rays=rays, weight=0.1)
    starts = seen_starts(drill, Seen(points), rows, no_rank, rng)
    assert len(starts) <= SETTINGS.keep_pairs + SETTINGS.keep_even
    assert nearest(drill, starts, truth) < 0.35 * drill.radius
    again = seen_starts(drill, Seen(points), rows, no_rank, np.random.default_rng(9))
    assert np.array_equal(again, seen_starts(drill, Seen(points), rows, no_rank, np.random.default_rng(9)))


def test_poses_that_look_the_same_count_once():
    bottle = library.make("bottle")
    turned = bottle.symmetries.poses(12)
    assert len(different(bottle, turned, np.arange(12.0))) <= 3
    drill = library.make("drill")
    assert len(different(drill, turned, np.arange(12.0))) == 12


@pytest.mark.parametrize("count", [0, 1, 5])
def test_too_few_points_give_no_pairs(drill, count):
    points = np.tile([0.0, 0.0, 0.5], (count, 1))
    assert len(pair_starts(drill, Seen(points), np.random.default_rng(0))) == 0


def test_a_plane_gives_starts_without_a_number_missing(drill):
    grid = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 40), np.linspace(-0.1, 0.1, 40)), -1).reshape(-1, 2)
    points = np.concatenate([grid, np.full((len(grid), 1), 0.6)], axis=1)
    starts = pair_starts(drill, Seen(points), np.random.default_rng(0))
    assert np.isfinite(starts).all()


def seen_past_by_numpy(sight, frame, model, pose, count, slack):
    """What Sight says of one pose, sample by sample in plain arrays."""
    s, m, camera = sight.settings, DepthModel(), frame.camera
    points, normals = (part[:count] for part in model.sample_surface(s.samples))
    there, facing = poses.apply(pose, points), normals @ pose[:3, :3].T
    cosine = -np.einsum("ij,ij->i", facing, there) / np.linalg.norm(there, axis=1)
    ahead = (cosine > s.least_cosine) & (there[:, 2] > 1e-3)
    z = there[ahead, 2]
    u, v = (
        np.floor(f * there[ahead, k] / z + c + 0.5)
        for k, f, c in ((0, camera.fx, camera.cx), (1, camera.fy, camera.cy))
    )
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    if not inside.any():
        return s.cells * s.cost_hidden
    z, seen = z[inside], frame.depth[v[inside].astype(int), u[inside].astype(int)]
    noise = m.axial_floor + m.axial_growth * (z - m.axial_from) ** 2
    tolerance = 2.5 * np.sqrt(noise**2 + m.bias_sigma**2 + (m.scale_sigma * z) ** 2) + slack
    past, hidden = (seen > z + tolerance).mean(), ((seen > 0) & (seen < z - tolerance)).mean()
    return s.cells * (s.cost_past * max(past - s.free_share, 0.0) + s.cost_hidden * hidden)


@pytest.mark.parametrize(("many", "count"), [(500, 200), (5, 67)])
def test_what_is_seen_past_is_what_plain_arrays_say(rng, many, count):
    model = library.make("mug")
    frame = plain_view("mug")
    pose = frame.camera_from_object_truth
    sight = Sight(frame, model, settings=SightSettings(samples=200, samples_sifting=67, many=many))
    delta = rng.normal(size=(40, 6)) * ([0.6] * 3 + [0.04] * 3)
    tried = poses.perturb(pose, delta, model.centroid)
    tried[1, 0, 3] = 5.0
    tried[2, 2, 3] = -0.5
    for slack in (0.0, 0.01):
        expected = [seen_past_by_numpy(sight, frame, model, one, count, slack) for one in tried]
        np.testing.assert_allclose(sight.costs(tried, slack), expected, atol=1e-9)
    assert len(np.unique(expected)) > 20
