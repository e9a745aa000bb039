"""The ICP baseline must be a strong opponent on clean data, and say when it has nothing to go on."""

import numpy as np
import pytest
import trimesh

from fusion.truth import metrics
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from vision.published.icp import CloudIcpSettings, icp, is_degenerate, point_to_plane_hessian


@pytest.fixture(scope="module")
def tool():
    """A drill-like shape without symmetry: body, grip and chuck."""
    body = trimesh.creation.box((0.16, 0.05, 0.06))
    grip = trimesh.creation.box((0.04, 0.04, 0.12), trimesh.transformations.translation_matrix((-0.05, 0, -0.08)))
    chuck = trimesh.creation.cylinder(0.015, 0.05, sections=48)
    chuck.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0)))
    chuck.apply_translation((0.1, 0, 0.005))
    mesh = trimesh.util.concatenate([body, grip, chuck])
    return ObjectModel("tool", mesh.vertices, mesh.faces)


def half_view(model, pose, count=4000, hidden=0.5, seed=0):
    """Camera-frame points of the side that faces the camera, without a share of them on one side of a line."""
    points, normals = model.sample_surface(count, seed + 1)
    points, normals = poses.apply(pose, points), normals @ pose[:3, :3].T
    points = points[np.einsum("ni,ni->n", points, normals) < 0]
    return points[points[:, 0] >= np.quantile(points[:, 0], hidden)]


def cases(model, count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.02, -0.01, 0.6])
        yield truth, poses.displaced(truth, np.deg2rad(20), 0.015, model.centroid, rng)


def test_finds_a_half_hidden_object_from_a_coarse_start(tool):
    points = metrics.model_points(tool, 2000)
    errors = [
        metrics.add_s(icp(half_view(tool, truth), tool, start).pose, truth, points) for truth, start in cases(tool, 25)
    ]
    assert metrics.recall(errors, 0.005) >= 0.8
    assert np.median(errors) < 2e-4


def test_is_deterministic_and_does_not_care_where_the_world_is(tool):
    truth, start = next(cases(tool, 1, seed=4))
    seen = half_view(tool, truth)
    first, again = icp(seen, tool, start), icp(seen, tool, start)
    assert np.array_equal(first.pose, again.pose)
    move = poses.exp([0.3, -0.2, 0.5, 0.4, 0.1, -0.3])
    moved = icp(poses.apply(move, seen), tool, move @ start)
    assert moved.pose == pytest.approx(move @ first.pose, abs=1e-5)


def test_a_robust_kernel_withstands_flying_pixels(tool):
    rng = np.random.default_rng(7)
    truth, start = next(cases(tool, 1, seed=7))
    seen = half_view(tool, truth, hidden=0.2)
    wrong = rng.choice(len(seen), len(seen) // 4, replace=False)
    seen[wrong] += rng.uniform(0.001, 0.004, (len(wrong), 1)) * (
        seen[wrong] / np.linalg.norm(seen[wrong], axis=1)[:, None]
    )
    robust = icp(seen, tool, start)
    plain = icp(seen, tool, start, CloudIcpSettings(kernel="none"))
    error = [metrics.add(result.pose, truth, tool.vertices) for result in (robust, plain)]
    assert error[0] < error[1]
    assert error[0] < 0.5e-3


def test_drops_rows_that_are_not_finite(tool):
    truth, start = next(cases(tool, 1))
    seen = half_view(tool, truth)
    broken = np.concatenate([seen, np.full((5, 3), np.nan), [[np.inf, 0, 0]]])
    result, clean = icp(broken, tool, start), icp(seen, tool, start)
    assert result.dropped == 6
    assert np.array_equal(result.pose, clean.pose)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_too_few_points_return_the_start(tool, count):
    truth, start = next(cases(tool, 1))
    result = icp(half_view(tool, truth)[:count], tool, start)
    assert result.degenerate
    assert result.fitness == 0.0
    assert result.pose == pytest.approx(start)


def test_points_out_of_reach_return_the_start(tool):
    truth, start = next(cases(tool, 1))
    result = icp(half_view(tool, truth) + np.array([0, 0, 3.0]), tool, start)
    assert result.degenerate
    assert result.pose == pytest.approx(start)


def test_a_single_plane_is_degenerate_however_well_it_fits(tool):
    grid = np.stack(np.meshgrid(np.linspace(-0.03, 0.03, 30), np.linspace(-0.015, 0.015, 30)), -1).reshape(-1, 2)
    side = np.stack([grid[:, 0], np.full(len(grid), 0.025), grid[:, 1]], axis=1)
    truth = poses.make_pose(poses.exp_rotation([0.2, 0.1, 0.3]), [0, 0, 0.6])
    result = icp(poses.apply(truth, side), tool, poses.perturb(truth, [0.02, 0, 0, 0.003, 0, 0], tool.centroid))
    assert result.fitness > 0.95
    assert result.rmse < 1.5e-3
    assert result.degenerate
    assert not icp(half_view(tool, truth, hidden=0.0), tool, truth).degenerate


def test_hessian_equals_finite_differences_and_knows_cylinder_and_ball():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(40, 3))
    normals = poses.random_unit_vectors(40, rng)
    radius, step = 0.7, 1e-6

    def distances(delta):
        centred = points - points.mean(axis=0)
        moved = centred @ poses.exp_rotation(delta[:3]).T + radius * delta[3:]
        return np.einsum("ni,ni->n", moved - centred, normals) / radius

    jacobian = np.stack([(distances(step * e) - distances(-step * e)) / (2 * step) for e in np.eye(6)], axis=1)
    assert point_to_plane_hessian(points, normals, radius) == pytest.approx(jacobian.T @ jacobian / 40, abs=1e-7)

    ball = poses.random_unit_vectors(500, rng)
    assert is_degenerate(0.05 * ball, ball, 0.05, 1e-3)
    angle, z = rng.uniform(0, 2 * np.pi, 500), rng.uniform(-0.1, 0.1, 500)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(500)], 1)
    assert is_degenerate(0.03 * out + z[:, None] * [0, 0, 1.0], out, 0.1, 1e-3)
    assert not is_degenerate(points, normals, 1.0, 1e-3)


def test_agrees_with_an_independent_implementation(tool):
    small_gicp = pytest.importorskip("small_gicp", reason="small_gicp, the compiled peer, is not installed")
    truth, _ = next(cases(tool, 1, seed=2))
    start = poses.displaced(truth, np.deg2rad(5), 0.004, tool.centroid, np.random.default_rng(2))
    seen = half_view(tool, truth, hidden=0.0)
    target, _ = tool.sample_surface(20_000, seed=0)

    cloud = small_gicp.PointCloud(target)
    small_gicp.estimate_normals(cloud, num_neighbors=10)
    peer = small_gicp.align(
        cloud,
        small_gicp.PointCloud(seen),
        small_gicp.KdTree(cloud),
        init_T_target_source=poses.inverse(start),
        registration_type="PLANE_ICP",
        max_correspondence_distance=0.01,
        translation_epsilon=1e-6,
        rotation_epsilon=1e-5,
    )
    ours = icp(seen, tool, start)
    assert metrics.add(ours.pose, truth, tool.vertices) < 1e-3
    assert metrics.add(ours.pose, poses.inverse(peer.T_target_source), tool.vertices) < 1.5e-3


def test_refuses_bad_input(tool):
    with pytest.raises(InputError, match=r"points of shape \(n, 3\)"):
        icp(np.zeros((4, 2)), tool, np.eye(4))
    with pytest.raises(InputError, match="icp start"):
        icp(np.zeros((10, 3)), tool, np.zeros((4, 4)))
    with pytest.raises(InputError, match="kernel"):
        icp(
            half_view(tool, poses.make_pose(translation=[0, 0, 0.5])),
            tool,
            poses.make_pose(translation=[0, 0, 0.5]),
            CloudIcpSettings(kernel="soft"),
        )
    with pytest.raises(InputError, match="distances"):
        CloudIcpSettings(distances=())
