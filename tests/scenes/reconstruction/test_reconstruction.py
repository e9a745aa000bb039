"""Models from views: closed, outward, true where seen, honest where not; and superquadrics."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from fusion.cli.main import main
from scenes.errors import InputError, MeshError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.reconstruction.superquadrics import Superquadric, fit_superquadric
from scenes.reconstruction.volume import DepthView, ReconstructionSettings, reconstruct
from scenes.recordings.bop import PoseRow, write_poses
from scenes.recordings.captures import write_capture
from scenes.synthesis import library

CAMERA = Camera(260.0, 260.0, 159.5, 119.5, 320, 240)
COARSE = ReconstructionSettings(resolution=64)


@pytest.fixture(scope="module")
def block():
    return library.make("l_block")


def views_from(model, directions):
    """Noiseless views of a model from directions (object frame), 0.4 m away; rays that miss it say that all is free."""
    renderer = Renderer({"object": (model.vertices, model.faces)})
    out = []
    for direction in np.asarray(directions, dtype=float):
        ahead = -direction / np.linalg.norm(direction)
        side = np.cross(ahead, np.eye(3)[np.argmin(np.abs(ahead))])
        side /= np.linalg.norm(side)
        rotation = np.stack([side, np.cross(ahead, side), ahead])
        pose = poses.make_pose(rotation, np.array([0, 0, 0.4]) - rotation @ model.centroid)
        seen = renderer.render(CAMERA, {"object": pose})
        mask = seen.mask("object")
        out.append(DepthView(CAMERA, pose, np.where(mask, seen.depth, 2.0).astype(np.float32), mask))
    return out


ALL_ROUND = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)] + [(1, 0, 0), (-1, 0, 0), (0, 1, 0)]


def test_seen_all_round_it_is_the_object(block):
    made = reconstruct(views_from(block, ALL_ROUND), settings=COARSE)
    model = ObjectModel.from_mesh(made.vertices, made.faces)
    assert model.mended == ()  # closed and outward as it is
    assert model.volume == pytest.approx(block.volume, rel=0.08)
    distance = np.abs(block.surface.closest(made.vertices)[0])
    assert np.mean(distance) < 0.4 * made.voxel
    assert made.observed.mean() > 0.9
    assert np.quantile(distance, 0.95) < made.voxel


def test_seen_from_one_side_the_rest_is_called_filled(block):
    made = reconstruct(views_from(block, [(1, 0.2, 0.3), (1, -0.2, 0.3)]), settings=COARSE)
    model = ObjectModel.from_mesh(made.vertices, made.faces)
    assert model.mended == ()
    assert 0.1 < made.observed.mean() < 0.8
    seen = np.abs(block.surface.closest(made.vertices[made.observed])[0])
    assert np.quantile(seen, 0.9) < made.voxel
    assert made.confidence.max() < 1.0


def test_what_is_felt_on_the_far_side_reaches_it(block):
    views = views_from(block, [(1, 0, 0)])
    thin = reconstruct(views, settings=COARSE)
    far = block.vertices[block.vertices[:, 0] < block.vertices[:, 0].min() + 1e-6]
    deep = reconstruct(views, far, settings=COARSE)
    assert np.ptp(deep.vertices[:, 0]) > np.ptp(thin.vertices[:, 0])
    assert np.ptp(deep.vertices[:, 0]) == pytest.approx(np.ptp(block.vertices[:, 0]), abs=3 * deep.voxel)


def test_no_part_of_it_is_in_the_hand(block):
    import trimesh

    views = views_from(block, [(1, 0, 0)])
    far = block.vertices[block.vertices[:, 0] < block.vertices[:, 0].min() + 1e-6]
    low = block.vertices.min(axis=0)
    ball = trimesh.creation.icosphere(radius=0.012)
    hand = np.asarray(ball.vertices) + np.array([low[0] + 0.005, *block.centroid[1:]]), np.asarray(ball.faces)
    made = reconstruct(views, far, hand, COARSE)
    middle = hand[0].mean(axis=0)
    assert np.linalg.norm(made.vertices - middle, axis=1).min() > 0.012 - 2 * made.voxel
    assert ObjectModel.from_mesh(made.vertices, made.faces).surface.closest(middle[None])[0][0] > 0


def test_views_of_nothing_are_refused(block):
    view = views_from(block, [(1, 0, 0)])[0]
    with pytest.raises(MeshError, match="readings of the object"):
        reconstruct([replace(view, mask=np.zeros_like(view.mask))])
    with pytest.raises(MeshError):
        reconstruct([])


# ---- superquadrics


@pytest.mark.parametrize("exponents", [(1.0, 1.0), (0.3, 0.3), (0.3, 1.0)])
def test_a_superquadric_is_found_again(exponents, rng):
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], [0.1, -0.2, 0.3])
    true = Superquadric(np.array([0.03, 0.045, 0.08]), np.array(exponents), pose)
    vertices, faces = true.mesh(4)
    model = ObjectModel.from_mesh(vertices, faces)
    assert model.mended == ()
    found = fit_superquadric(model.sample_surface(600, 1)[0] + 1e-4 * rng.normal(size=(600, 3)))
    assert np.abs(found.radial_distance(model.sample_surface(800, 2)[0])).mean() < 1e-3
    assert np.prod(found.axes) == pytest.approx(np.prod(true.axes), rel=0.1)
    np.testing.assert_allclose(true.inside_outside(vertices), 1.0, atol=1e-6)


def test_a_superquadric_needs_points():
    with pytest.raises(InputError, match="finite points"):
        fit_superquadric(np.zeros((3, 3)))


# ---- the command


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("model") / "box"
    return write_capture(folder, [replace(plain_view(seed=i), index=i) for i in range(6)], library.make("box"))


def test_a_model_that_can_be_estimated_with(capture, tmp_path, capsys):
    mesh, told = tmp_path / "made" / "box.ply", tmp_path / "m.json"
    argv = ["model", str(capture), "-o", str(mesh), "--poses", "truth", "--frame", "truth", "--size", "200"]
    assert main([*argv, "--json", str(told)]) == 0
    assert "observed" in capsys.readouterr().out
    found = json.loads(told.read_text())
    assert found["errors"]["model_to_true_observed"]["mean_mm"] < 1.5
    assert b"property float confidence" in mesh.read_bytes()[:400]
    assert ObjectModel.load(mesh).mended == ()
    assert main(["estimate", str(capture), "--object", str(mesh), "--no-report", "--out", str(tmp_path / "e")]) == 0
    result = json.loads((tmp_path / "e" / "result.json").read_text())
    assert result["errors"]["median_add_s_mm"] < 2.0


def test_an_older_mesh_stays_until_the_new_one_is_whole(capture, tmp_path):
    mesh, older = tmp_path / "box.ply", tmp_path / "older.ply"
    mesh.write_bytes(b"older")
    older.hardlink_to(mesh)  # in place, both names would have the new one
    assert main(["model", str(capture), "-o", str(mesh), "--poses", "truth", "--size", "200"]) == 0
    assert older.read_bytes() == b"older"
    assert mesh.read_bytes().startswith(b"ply")


def test_poses_from_a_file_and_a_superquadric(capture, tmp_path):
    from scenes.recordings.captures import read_capture

    rows = [PoseRow(0, f.index, 1, 1.0, f.camera_from_object_truth, -1.0) for f in read_capture(capture)]
    write_poses(tmp_path / "poses.csv", rows)
    argv = ["model", str(capture), "-o", str(tmp_path / "q.ply"), "--poses", str(tmp_path / "poses.csv")]
    assert main([*argv, "--shape", "superquadric", "--size", "200", "--json", str(tmp_path / "q.json")]) == 0
    found = json.loads((tmp_path / "q.json").read_text())
    assert found["poses"] == "file"
    assert found["errors"]["true_to_model_observed"]["mean_mm"] < 4.0


def test_bad_use_is_one_line(capture, tmp_path, capsys):
    for argv in (
        ["-o", str(tmp_path / "m.obj")],
        ["-o", str(tmp_path / "m.ply"), "--poses", "nowhere"],
        ["-o", str(tmp_path / "m.ply"), "--poses", "hand"],
        ["-o", str(tmp_path / "m.ply"), "--size", "0"],
    ):
        assert main(["model", str(capture), *argv]) == 2
        assert capsys.readouterr().err.count("\n") == 1
