"""The signed-distance lattice against exact distances (libigl), and its cache against accidents."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh

from scenes.errors import InputError
from scenes.geometry import distance_field, lattice
from scenes.geometry.distance_field import DistanceField, FieldSettings, build, load_or_build
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library

COARSE = FieldSettings(cells_per_diameter=40.0)


def exact(model, points):
    """Exact distances, signs by generalised winding numbers."""
    return igl.signed_distance(
        np.ascontiguousarray(points), model.vertices, model.faces, igl.SIGNED_DISTANCE_TYPE_WINDING_NUMBER
    )[0]


def box_points(model, count, margin, seed=0):
    low, high = model.vertices.min(axis=0) - margin, model.vertices.max(axis=0) + margin
    return np.random.default_rng(seed).uniform(low, high, size=(count, 3))


def near_points(model, count, spread, seed=0):
    points, normals = model.sample_surface(count, seed=seed)
    return points + np.random.default_rng(seed).uniform(-spread, spread, size=(count, 1)) * normals


@pytest.mark.parametrize("name", ["box", "mug", "drill", "wine_glass", "pencil", "sphere"])
def test_distances_are_exact_to_the_stated_error(name):
    model = library.make(name)
    field = model.field
    # a thin wall has its medial axis in the middle, where a trilinear cell rounds the crest off: stay nearer than that
    near = near_points(model, 600, 0.5 * field.spacing)
    error = field.distance(near) - exact(model, near)
    assert np.sqrt(np.mean(error**2)) < max(2 * field.rms_error, 4e-5)
    assert np.abs(error).max() < field.spacing
    anywhere = box_points(model, 1500, field.spacing)
    distance, truth = field.distance(anywhere), exact(model, anywhere)
    assert np.abs(distance - truth).max() < 2 * field.spacing
    clear = np.abs(truth) > field.spacing
    assert (np.sign(distance) == np.sign(truth))[clear].all()


@pytest.mark.parametrize("name", ["box", "mug", "drill", "bottle"])
def test_the_stated_error_is_the_measured_one_and_small(name):
    model = library.make(name)
    points, _ = model.sample_surface(20_000, seed=3)
    error = model.field.distance(points)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(model.field.rms_error, rel=0.15)
    assert model.field.rms_error < 1e-4


@pytest.mark.parametrize("name", ["mug", "drill"])
def test_the_distance_goes_on_outside_the_box(name):
    model = library.make(name)
    rng = np.random.default_rng(1)
    far = model.centroid + 5 * model.diameter * rng.normal(size=(200, 3))
    distance, gradient = model.field.distance_and_gradient(far)
    truth = exact(model, far)
    # the way to the box and on from there is longer than the straight one, never shorter, by at most the detour
    assert (distance > truth - model.field.spacing).all()
    assert (distance < truth + model.diameter).all()
    # walking against the gradient leads back
    stepped = far - 0.5 * distance[:, None] * gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    assert (model.field.distance(stepped) < 0.8 * distance).all()


def test_the_value_does_not_jump_at_the_boxs_side():
    field = library.make("mug").field
    side = field.origin + field.spacing * (np.array(field.values.shape) - 1)
    middle = 0.5 * (field.origin + side)
    for axis in range(3):
        for face in (field.origin[axis], side[axis]):
            points = np.tile(middle + 0.013, (3, 1))
            points[:, axis] = face + np.array([-1e-6, 0.0, 1e-6])
            values = field.distance(points)
            assert np.abs(np.diff(values)).max() < 1e-3 * field.spacing + 3e-6


@pytest.mark.parametrize("name", ["mug", "drill", "sphere"])
def test_the_gradient_is_that_of_the_value(name):
    model = library.make(name)
    field = model.field
    points = np.concatenate([box_points(model, 400, 0.0), box_points(model, 400, model.diameter, seed=1)])
    # inside one cell the value is a polynomial: keep differences away from the cells' faces
    cell = (points - field.origin) / field.spacing
    points = points[(np.abs(cell - np.round(cell)) > 0.02).all(axis=1)]
    _, gradient = field.distance_and_gradient(points)
    step = 1e-3 * field.spacing
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        numeric = (field.distance(points + shift) - field.distance(points - shift)) / (2 * step)
        assert np.allclose(gradient[:, axis], numeric, atol=2e-6)


def test_every_second_node_is_a_coarser_lattice_of_the_same():
    model = library.make("mug")
    field, coarse = model.field, model.field.coarser
    assert coarse.spacing == 2 * field.spacing
    assert coarse.step == field.step
    assert coarse.values.nbytes < field.values.nbytes / 7
    nodes = field.origin + coarse.spacing * np.array([[3, 4, 5], [7, 2, 9]])
    np.testing.assert_allclose(coarse.distance(nodes), field.distance(nodes), atol=1e-7)
    points = box_points(model, 500, 0.02)
    assert np.abs(coarse.distance(points) - field.distance(points)).mean() < 0.1 * field.spacing
    # the corners of the box are the same: what lies outside is as far
    assert np.allclose(
        field.origin + field.spacing * (np.array(field.values.shape) - 1),
        coarse.origin + coarse.spacing * (np.array(coarse.values.shape) - 1),
    )


def test_value_alone_is_the_value_with_gradient():
    model = library.make("mug")
    field = model.field
    for point in box_points(model, 200, 0.05):
        alone = lattice.value_at(field.values, field.origin, field.spacing, *point)
        assert alone == pytest.approx(lattice.distance_at(field.values, field.origin, field.spacing, *point)[0])


def test_smooth_normals_match_the_meshs():
    model = library.make("sphere")
    points, normals = model.sample_surface(300, seed=1)
    assert (np.sum(model.field.normals(points) * normals, axis=1) > np.cos(np.deg2rad(3))).all()


def test_normals_are_unit_gradients():
    model = library.make("mug")
    field = model.field
    points = np.concatenate([near_points(model, 40, field.spacing, seed=3), box_points(model, 20, 0.05)])
    for point, normal in zip(points, field.normals(points)):
        gradient = np.zeros(3)
        lattice.normal_at(field.values, field.origin, field.spacing, *point, gradient, np.zeros((3, 3)))
        np.testing.assert_allclose(normal, gradient / max(np.linalg.norm(gradient), 1e-12), rtol=1e-12)


def test_the_jacobian_of_the_smooth_gradient():
    model = library.make("mug")
    field = model.field
    points = near_points(model, 60, field.spacing, seed=2)
    cell = (points - field.origin) / field.spacing
    points = points[(np.abs(cell - np.round(cell)) > 0.02).all(axis=1)]
    step = 1e-4 * field.spacing

    def smooth(point):
        gradient, hessian = np.zeros(3), np.zeros((3, 3))
        lattice.normal_at(field.values, field.origin, field.spacing, *point, gradient, hessian)
        return gradient, hessian

    for point in points:
        _, hessian = smooth(point)
        numeric = [(smooth(point + step * e)[0] - smooth(point - step * e)[0]) / (2 * step) for e in np.eye(3)]
        assert np.allclose(hessian, np.transpose(numeric), atol=1e-4 * max(1.0, np.abs(hessian).max()))


def test_ten_centimetres_inside_a_big_object_there_is_a_way_out():
    mesh = trimesh.creation.box((0.30, 0.34, 0.38))
    field = build(np.array(mesh.vertices), np.array(mesh.faces), COARSE)
    start = np.random.default_rng(0).uniform(-0.045, 0.045, size=(100, 3))
    distance, gradient = field.distance_and_gradient(start)
    assert (distance < -0.095).all()
    assert (np.linalg.norm(gradient, axis=1) > 0.2).all()
    points = start
    for _ in range(60):
        _, gradient = field.distance_and_gradient(points)
        points = points + 0.005 * gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9)
    assert (field.distance(points) > 0).all()


@pytest.mark.parametrize("wall", [0.003, 0.004])
def test_a_thin_wall_keeps_its_inside(wall):
    outer, inner = trimesh.creation.cylinder(0.04, 0.1), trimesh.creation.cylinder(0.04 - wall, 0.1 - 2 * wall)
    inner.invert()
    cup = trimesh.util.concatenate([outer, inner])
    model = ObjectModel.from_mesh(np.array(cup.vertices), np.array(cup.faces), "can")
    field = build(model.vertices, model.faces, FieldSettings())
    angle = np.linspace(0, 2 * np.pi, 300)
    r = 0.04 - 0.5 * wall
    middle = np.stack([r * np.cos(angle), r * np.sin(angle), np.linspace(-0.03, 0.03, 300)], axis=1)
    assert (field.distance(middle) < -0.25 * wall).all()
    assert field.distance(np.zeros((1, 3)))[0] > 0.03


def test_the_mugs_wall_and_hollow():
    model = library.make("mug")
    points, normals = model.sample_surface(3000, seed=0)
    inside = points - 0.0012 * normals
    truth = exact(model, inside)
    distance = model.field.distance(inside)
    assert (distance[truth < -0.0008] < 0).all()


def _signs(vertices, faces, inside, outside):
    model = ObjectModel.from_mesh(np.asarray(vertices), np.asarray(faces), "test")
    field = build(model.vertices, model.faces, COARSE)
    assert (field.distance(np.atleast_2d(inside)) < 0).all()
    assert (field.distance(np.atleast_2d(outside)) > 0).all()


def test_signs_of_an_inverted_mesh():
    mesh = trimesh.creation.icosphere(radius=0.05)
    _signs(mesh.vertices, mesh.faces[:, ::-1], [[0, 0, 0], [0.04, 0, 0]], [[0.06, 0, 0], [0.2, 0.2, 0.2]])


def test_signs_of_a_mesh_that_overlaps_itself():
    a, b = trimesh.creation.icosphere(radius=0.05), trimesh.creation.icosphere(radius=0.05)
    b.apply_translation([0.05, 0.003, 0.001])
    both = trimesh.util.concatenate([a, b])
    inside = [[-0.03, 0, 0], [0.025, 0, 0], [0.08, 0, 0], [0.02, 0.01, 0.0]]
    _signs(both.vertices, both.faces, inside, [[0.025, 0.048, 0], [0.12, 0, 0], [-0.06, 0, 0]])


def test_signs_of_a_mesh_with_t_junctions():
    # one side of a box is one pair of triangles, its neighbour is split in the middle of the shared edge
    mesh = trimesh.creation.box((0.1, 0.08, 0.06))
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    face = faces[0]
    middle = 0.5 * (vertices[face[0]] + vertices[face[1]])
    vertices = np.vstack([vertices, middle])
    new = len(vertices) - 1
    faces = np.vstack([faces[1:], [[face[0], new, face[2]], [new, face[1], face[2]]]])
    assert not trimesh.Trimesh(vertices, faces, process=False).is_watertight
    _signs(vertices, faces, [[0, 0, 0], [0.04, 0.03, 0.02]], [[0.06, 0, 0], [0, 0.05, 0], [0, 0, -0.04]])


def test_a_mesh_far_from_its_origin_loses_no_digits():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    offset = np.array([3.0, -2.0, 1.0])
    here = build(np.array(mesh.vertices), np.array(mesh.faces), COARSE)
    there = build(np.array(mesh.vertices) + offset, np.array(mesh.faces), COARSE)
    points = np.random.default_rng(0).uniform(-0.06, 0.06, size=(300, 3))
    assert np.allclose(here.distance(points), there.distance(points + offset), atol=1e-6)


def test_a_point_seen_through_a_thin_wall_belongs_to_the_side_that_faces_the_camera():
    mesh = trimesh.creation.box((0.1, 0.1, 0.004))
    field = build(np.array(mesh.vertices), np.array(mesh.faces), FieldSettings())
    rays = np.array([[0.0, 0.0, 1.0]])  # looking along +z: the face at z = -2 mm is seen
    depths = np.linspace(-0.006, 0.006, 25)
    points = np.stack([0 * depths + 0.01, 0 * depths + 0.02, depths], axis=1)
    seen, gradient = field.seen_distance_and_gradient(points, np.repeat(rays, 25, axis=0), np.ones(25, dtype=bool))
    assert np.allclose(seen, -(depths + 0.002), atol=2e-4)
    assert np.allclose(gradient, [[0.0, 0.0, -1.0]] * 25, atol=1e-2)
    both, plain = field.seen_distance_and_gradient(points, np.repeat(rays, 25, axis=0), np.zeros(25, dtype=bool))
    assert np.array_equal(both, field.distance(points))
    assert np.array_equal(plain, field.distance_and_gradient(points)[1])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_queries_that_are_not_finite_are_refused(bad):
    field = library.make("box").field
    points = np.zeros((3, 3))
    points[1, 2] = bad
    for query in (field.distance, field.distance_and_gradient, field.normals):
        with pytest.raises(InputError, match="expected finite points, got 1 bad rows"):
            query(points)
    with pytest.raises(InputError, match=r"shape \(n, 3\), got \(3,\)"):
        field.distance(np.zeros(3))


def test_no_points_give_no_distances():
    field = library.make("box").field
    assert field.distance(np.zeros((0, 3))).shape == (0,)
    assert field.distance_and_gradient(np.zeros((0, 3)))[1].shape == (0, 3)


# ---- the cache ----

MESH = trimesh.creation.icosphere(subdivisions=2, radius=0.04)
VERTICES, FACES = np.array(MESH.vertices), np.array(MESH.faces, dtype=np.int64)


def same(a: DistanceField, b: DistanceField) -> bool:
    return np.array_equal(a.values, b.values) and np.array_equal(a.origin, b.origin) and a.spacing == b.spacing


def test_the_second_time_the_field_is_read(tmp_path, monkeypatch):
    monkeypatch.setenv("PALPATE_CACHE", str(tmp_path))
    first = load_or_build(VERTICES, FACES, COARSE)
    assert len(list(tmp_path.glob("field-*.npz"))) == 1
    monkeypatch.setattr(distance_field, "build", lambda *_: pytest.fail("built again"))
    assert same(load_or_build(VERTICES, FACES, COARSE), first)


def test_other_content_is_another_entry(tmp_path, monkeypatch):
    monkeypatch.setenv("PALPATE_CACHE", str(tmp_path))
    load_or_build(VERTICES, FACES, COARSE)
    load_or_build(VERTICES * 1.001, FACES, COARSE)
    load_or_build(VERTICES, FACES, FieldSettings(cells_per_diameter=41.0))
    assert len(list(tmp_path.glob("field-*.npz"))) == 3


@pytest.mark.parametrize("damage", ["empty", "truncated", "garbage", "flipped byte", "other content", "text"])
def test_a_damaged_file_is_built_again(tmp_path, monkeypatch, damage):
    monkeypatch.setenv("PALPATE_CACHE", str(tmp_path))
    first = load_or_build(VERTICES, FACES, COARSE)
    (path,) = tmp_path.glob("field-*.npz")
    content = path.read_bytes()
    if damage == "other content":
        np.savez(path, values=np.zeros(3), origin=np.zeros(2), spacing=np.nan, rms_error=0.0, max_error=0.0)
    else:
        path.write_bytes(
            {
                "empty": b"",
                "truncated": content[: len(content) // 2],
                "garbage": b"PK\x03\x04" + os.urandom(500),
                "flipped byte": content[:5000] + bytes([content[5000] ^ 0xFF]) + content[5001:],
                "text": b"not a field\n",
            }[damage]
        )
    assert same(load_or_build(VERTICES, FACES, COARSE), first)
    assert same(load_or_build(VERTICES, FACES, COARSE), first)


def test_a_cache_folder_that_cannot_be_written_costs_time_only(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("PALPATE_CACHE", str(blocked / "cache"))
    assert load_or_build(VERTICES, FACES, COARSE).values.size > 0
    readonly = tmp_path / "readonly"
    readonly.mkdir()
    readonly.chmod(0o500)
    monkeypatch.setenv("PALPATE_CACHE", str(readonly))
    assert load_or_build(VERTICES, FACES, COARSE).values.size > 0
    readonly.chmod(0o700)


def test_a_full_disk_leaves_no_half_file(tmp_path, monkeypatch):
    monkeypatch.setenv("PALPATE_CACHE", str(tmp_path))

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    assert load_or_build(VERTICES, FACES, COARSE).values.size > 0
    assert list(tmp_path.iterdir()) == []


def test_two_processes_build_the_same_field_at_once(tmp_path):
    program = (
        "import hashlib, trimesh, numpy as np\n"
        "from scenes.geometry.distance_field import FieldSettings, load_or_build\n"
        "mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.04)\n"
        "field = load_or_build(np.array(mesh.vertices), np.array(mesh.faces), FieldSettings(cells_per_diameter=40.0))\n"
        "print(hashlib.sha256(field.values.tobytes()).hexdigest())\n"
    )
    root = Path(__file__).resolve().parents[3]
    environment = {**os.environ, "PALPATE_CACHE": str(tmp_path), "PYTHONPATH": str(root)}
    running = [
        subprocess.Popen([sys.executable, "-c", program], cwd=root, env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    hashes = [process.communicate(timeout=120)[0].strip() for process in running]
    assert all(process.returncode == 0 for process in running)
    assert len(set(hashes)) == 1
    assert len(hashes[0]) == 64
    assert [p.suffix for p in tmp_path.iterdir()] == [".npz"]


def test_the_size_of_the_lattice_is_bounded():
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    limits = FieldSettings(max_nodes=200_000)
    field = build(np.array(mesh.vertices), np.array(mesh.faces), limits)
    assert field.values.size < 1.3 * limits.max_nodes


def test_a_mesh_of_many_faces_gets_the_same_lattice_from_fewer_queries():
    model = library.make("mug")
    exact = build(model.vertices, model.faces, FieldSettings())
    quick = build(model.vertices, model.faces, replace(FieldSettings(), most_faces=0))
    assert quick.values.shape == exact.values.shape
    error = np.abs(quick.values - exact.values)
    near = np.abs(exact.values) < 1.5 * exact.spacing
    assert error[near].max() < 1e-6
    # away from the surface both are approximate, the first by interpolating every fourth node: on the medial axis,
    # where distances fold, that is off by up to a good part of four cells
    assert np.sqrt(np.mean(error**2)) < 0.15 * exact.spacing
    assert error.max() < 4 * exact.spacing
    assert (np.sign(quick.values) == np.sign(exact.values)).mean() > 0.99999
