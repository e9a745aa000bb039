"""Starts without a prior: some of the few that are kept are near the truth; normals are the surface's."""

import numpy as np
import pytest
from made_frames import plain_view

from scenes.evidence import table as evidence
from scenes.evidence.table import VISION
from scenes.geometry import poses
from scenes.recordings.beliefs import DepthModel
from scenes.synthesis import library
from vision.sight import Sight, SightSettings
from vision.starts import StartSettings, different, oriented_pixels, pair_starts, seen_starts

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
    found, normals = oriented_pixels(points, ball.radius, rng)
    assert len(found) > 0.5 * SETTINGS.oriented
    outward = found - poses.apply(pose, ball.centroid[None])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.quantile(np.sum(outward * normals, axis=1), 0.1) > np.cos(np.deg2rad(12.0))
    assert (np.sum(found * normals, axis=1) < 0).all()


@pytest.mark.parametrize("name", ["drill", "box"])
def test_a_pair_start_is_near_the_truth(name):
    model, rng = library.make(name), np.random.default_rng(3)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.03, 0.55])
    points, _ = seen_side(model, truth, 3000, noise=1e-3)
    assert nearest(model, pair_starts(model, points, rng), truth) < 0.5 * model.radius


def test_kept_starts_are_few_differ_and_hold_the_truth(drill):
    rng = np.random.default_rng(5)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.03, 0.55])
    points, _ = seen_side(drill, truth, 3000, noise=1e-3)
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    rows = evidence.make(points, 0.0025, VISION, gate_above=2.5, gate_below=5.0, rays=rays, weight=0.1)
    starts = seen_starts(drill, points, rows, no_rank, rng)
    assert len(starts) <= SETTINGS.keep_pairs + SETTINGS.keep_even
    assert nearest(drill, starts, truth) < 0.35 * drill.radius
    again = seen_starts(drill, points, rows, no_rank, np.random.default_rng(9))
    assert np.array_equal(again, seen_starts(drill, points, rows, no_rank, np.random.default_rng(9)))


def test_poses_that_look_the_same_count_once():
    bottle = library.make("bottle")
    turned = bottle.symmetries.poses(12)
    assert len(different(bottle, turned, np.arange(12.0))) <= 3
    drill = library.make("drill")
    assert len(different(drill, turned, np.arange(12.0))) == 12


@pytest.mark.parametrize("count", [0, 1, 5])
def test_too_few_points_give_no_pairs(drill, count):
    points = np.tile([0.0, 0.0, 0.5], (count, 1))
    assert len(pair_starts(drill, points, np.random.default_rng(0))) == 0


def test_a_plane_gives_starts_without_a_number_missing(drill):
    grid = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 40), np.linspace(-0.1, 0.1, 40)), -1).reshape(-1, 2)
    points = np.concatenate([grid, np.full((len(grid), 1), 0.6)], axis=1)
    starts = pair_starts(drill, points, np.random.default_rng(0))
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
