"""Objects against trimesh; units that cannot be right; exact closest points against libigl."""

import pickle

import igl
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from scenes.errors import InputError, MeshError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel, check_size
from scenes.geometry.surface import Surface, hull_of
from scenes.synthesis import library
from scenes.threads import VARIABLE


def test_a_mesh_is_read_and_repaired_once(tmp_path, monkeypatch):
    monkeypatch.setenv("PALPATE_CACHE", str(tmp_path / "cache"))
    box = trimesh.creation.box((0.08, 0.05, 0.03))
    open_box = trimesh.Trimesh(box.vertices, box.faces[1:], process=False)
    path = tmp_path / "box.stl"
    open_box.export(path)
    first = ObjectModel.load(path)
    with pytest.raises(MeshError, match="diameter"):  # the same bytes in another unit are another object
        ObjectModel.load(path, unit="mm")
    monkeypatch.setattr(trimesh, "load", None)
    again = ObjectModel.load(path, name="known")
    assert again.name == "known"
    assert again.mended == first.mended != ()
    assert (again.vertices == first.vertices).all()
    assert (again.faces == first.faces).all()
    assert again.diameter == first.diameter == pytest.approx(np.linalg.norm([0.08, 0.05, 0.03]))


@pytest.mark.parametrize("name", library.names())
def test_volume_centroid_and_diameter_against_trimesh(name):
    model = library.make(name)
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    assert model.volume == pytest.approx(mesh.volume, rel=1e-9)
    assert np.allclose(model.centroid, mesh.center_mass, atol=1e-9)
    from scipy.spatial.distance import pdist

    hull = mesh.convex_hull.vertices
    if len(hull) < 6000:
        assert model.diameter == pytest.approx(pdist(hull).max(), rel=1e-9)
    assert model.radius == pytest.approx(np.linalg.norm(model.vertices - model.centroid, axis=1).max())
    assert np.allclose(model.face_normals, mesh.face_normals, atol=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_moving_or_renumbering_a_mesh_moves_its_centroid_only(seed):
    rng = np.random.default_rng(seed)
    model = library.make("l_block")
    pose = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    shuffle = rng.permutation(len(model.vertices))
    number = np.argsort(shuffle)
    moved = ObjectModel.from_mesh(
        poses.apply(pose, model.vertices)[shuffle], number[model.faces][rng.permutation(len(model.faces))]
    )
    assert moved.volume == pytest.approx(model.volume, rel=1e-9)
    assert moved.diameter == pytest.approx(model.diameter, rel=1e-9)
    assert np.allclose(moved.centroid, poses.apply(pose, model.centroid[None])[0], atol=1e-10)


def test_surface_samples_lie_on_the_surface_uniformly():
    model = library.make("box")
    points, normals = model.sample_surface(6000, seed=1)
    assert np.abs(igl.signed_distance(points, model.vertices, model.faces)[0]).max() < 1e-9
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
    extent = np.ptp(model.vertices, axis=0)
    area = np.array([extent[1] * extent[2], extent[0] * extent[2], extent[0] * extent[1]])
    share = np.array([(np.abs(normals[:, i]) > 0.5).mean() for i in range(3)])
    assert np.allclose(share, area / area.sum(), atol=0.02)
    # outwards: a step along the normal leaves the object
    assert (model.field.distance(points + 0.002 * normals) > 0.001).all()
    assert np.array_equal(points, model.sample_surface(6000, seed=1)[0])
    assert not np.array_equal(points, model.sample_surface(6000, seed=2)[0])


@pytest.mark.parametrize(
    ("size", "unit", "factor"), [(0.12, "m", 1.0), (12.0, "cm", 0.01), (120.0, "mm", 0.001), (4.7, "inch", 0.0254)]
)
def test_units_are_converted(tmp_path, size, unit, factor):
    path = tmp_path / "thing.ply"
    trimesh.creation.box((size, size / 2, size / 3)).export(path)
    model = ObjectModel.load(path, unit=unit)
    assert np.ptp(model.vertices, axis=0).max() == pytest.approx(size * factor, rel=1e-5)
    assert model.name == "thing"


@pytest.mark.parametrize(
    ("diameter", "likely"),
    [(120.0, "mm"), (250.0, "mm"), (15.0, "cm"), (1.2e-4, "m"), (0.003, None), (1e9, None)],
)
def test_an_impossible_size_names_the_likely_unit(diameter, likely):
    with pytest.raises(MeshError, match="5 mm to 2 m") as caught:
        check_size(diameter, "cup.ply")
    text = str(caught.value)
    assert text.startswith("cup.ply: ")
    assert f"{diameter:.4g} m" in text
    if likely is not None:
        assert f" {likely}?)" in text
    assert "\n" not in text


def test_sizes_a_hand_meets_pass():
    for diameter in (0.005, 0.02, 0.2, 2.0):
        check_size(diameter, "thing")


def test_a_file_in_millimetres_read_as_metres(tmp_path):
    path = tmp_path / "cup.stl"
    trimesh.creation.cylinder(40.0, 95.0).export(path)
    with pytest.raises(MeshError, match=r"cup.stl: .* got a diameter of 124.* m \(124 mm\?\)"):
        ObjectModel.load(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("nothing.ply", None, "found none"),
        ("text.ply", b"hello\n", "expected a mesh"),
        ("empty.stl", b"", "expected a mesh"),
        ("thing.xyzzy", b"1 2 3\n", "expected a mesh"),
        ("points.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
         b"property float z\nend_header\n0 0 0\n", "1 point and no triangle"),
        ("cut.stl", bytes(80) + (12).to_bytes(4, "little") + bytes(2 * 50 + 7), "2 of the 12 triangles .* cut off"),
        ("head.stl", bytes(40), "less than the head of an STL"),
        ("binary.obj", bytes(range(256)), "expected a mesh"),
    ],
)  # fmt: skip
def test_files_that_are_no_mesh(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(MeshError, match=message) as caught:
        ObjectModel.load(path)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


# Some need a package that may be there or not, others have readers with errors of their own.
ENDINGS = (".stp", ".step", ".3mf", ".3dxml", ".ctm", ".dae", ".zip", ".tar.gz", ".tar.bz2", ".xaml", ".glb", ".gltf")


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("content", [b"nothing here\n", b"", bytes(range(256))])
def test_a_format_that_cannot_be_read_here_is_one_line(tmp_path, ending, content):
    path = tmp_path / f"bad{ending}"
    path.write_bytes(content)
    with pytest.raises(MeshError) as caught:
        ObjectModel.load(path)
    said = str(caught.value)
    assert said.startswith(
        f"{path}: expected a mesh (.ply .obj .stl .off .glb …), got a {ending} that cannot be read: "
    )
    assert "\n" not in said


def test_an_unknown_unit():
    with pytest.raises(InputError, match="unit: expected one of m, cm, mm, inch, got 'feet'"):
        ObjectModel.load("cup.ply", unit="feet")


def test_what_was_mended_is_told():
    mesh = trimesh.creation.icosphere(radius=0.05)
    model = ObjectModel.from_mesh(np.array(mesh.vertices), np.array(mesh.faces)[1:, ::-1])
    assert len(model.mended) == 2


def test_a_mesh_that_had_to_be_mended_is_logged(tmp_path, caplog):
    mesh = trimesh.creation.icosphere(radius=0.05)
    trimesh.Trimesh(mesh.vertices, mesh.faces[1:]).export(tmp_path / "ball.stl")
    with caplog.at_level("INFO", "scenes"):
        ObjectModel.load(tmp_path / "ball.stl")
    assert "ball.stl is not closed as it is: 1 hole filled (" in caplog.text


def test_objects_travel_to_other_processes():
    model = library.make("mug")
    model.surface.closest(np.zeros((1, 3)))
    again = pickle.loads(pickle.dumps(model))
    points, _ = model.sample_surface(5, seed=0)
    assert np.array_equal(again.field.distance(points), model.field.distance(points))
    assert np.array_equal(again.surface.closest(points)[0], model.surface.closest(points)[0])


# ---- exact closest points ----


@pytest.mark.parametrize("name", ["mug", "drill", "l_block"])
def test_closest_points_are_exact(name):
    model = library.make(name)
    points, normals = model.sample_surface(800, seed=4)
    points = points + np.random.default_rng(0).uniform(-0.001, 0.02, size=(800, 1)) * normals
    distance, gradient, foot = model.surface.closest(points)
    truth, _, closest, _ = igl.signed_distance(points, model.vertices, model.faces)
    assert np.allclose(np.abs(distance), np.abs(truth), atol=2e-7)
    assert np.allclose(np.linalg.norm(foot - points, axis=1), np.abs(truth), atol=2e-7)
    assert np.allclose(np.linalg.norm(gradient, axis=1), 1.0, atol=1e-9)
    clear = np.abs(truth) > 1e-4
    assert np.allclose((points - foot)[clear], (distance[:, None] * gradient)[clear], atol=1e-7)
    assert np.median(np.linalg.norm(foot - closest, axis=1)) < 1e-7


def test_closest_points_on_the_surface_itself_are_finite():
    model = library.make("box")
    points, normals = model.sample_surface(200, seed=0)
    corners = model.vertices[:8]
    distance, gradient, _ = model.surface.closest(np.concatenate([points, corners]))
    assert np.abs(distance).max() < 1e-8
    assert np.isfinite(gradient).all()
    assert np.allclose(gradient[:200], normals, atol=1e-6)
    assert model.surface.closest(np.zeros((0, 3)))[1].shape == (0, 3)


class Recording:
    """A scene that remembers how many threads it was told to use."""

    def __init__(self, scene):
        self.scene, self.told = scene, []

    def __getattr__(self, name):
        ask = getattr(self.scene, name)

        def asked(tensor, threads=0):
            self.told.append(threads)
            return ask(tensor, threads)

        return asked


def test_rays_and_closest_points_take_as_many_threads_as_are_allowed(monkeypatch, rng):
    """One where a robot's other work needs the rest: the ray caster would take all cores by itself."""
    mesh = trimesh.creation.box((0.1, 0.08, 0.06))
    surface = Surface(mesh.vertices, mesh.faces)
    surface._scene = Recording(surface._scene)
    for threads in (1, 2):
        monkeypatch.setenv(VARIABLE, str(threads))
        surface.cast(np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]]))
        surface.closest(rng.normal(0.0, 0.05, (200, 3)))
        assert surface._scene.told
        assert set(surface._scene.told) == {threads}
        surface._scene.told.clear()


@pytest.mark.parametrize("name", ["drill", "mug"])
@pytest.mark.parametrize("distance", [0.002, 0.03])
def test_no_point_that_is_near_is_sorted_out_as_far(name, distance):
    surface = library.make(name).surface
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.25, 0.25, (4000, 3)) * [1.0, 1.0, 1.5]
    near = np.abs(surface.closest(points)[0]) < distance
    maybe = surface.may_be_within(points, distance)
    assert not (near & ~maybe).any()
    assert maybe.mean() < 0.5
    far = surface.may_be_within(points + 10.0, distance)
    assert not far.any()


def test_cells_near_a_mesh_are_those_that_its_widened_boxes_reach(rng):
    model, distance = library.make("l_block"), 0.0093
    corners = model.vertices[model.faces]
    low, high = corners.min(axis=1) - distance, corners.max(axis=1) + distance
    origin, extent = low.min(axis=0), np.ptp(np.concatenate([low, high]), axis=0)
    cell = max(distance, extent.max() / 64)
    points = rng.uniform(origin - 0.02, origin + extent + 0.02, (2000, 3))
    place = np.floor((points - origin) / cell)[:, None]
    first, last = np.floor((low - origin) / cell), np.floor((high - origin) / cell)
    reached = ((place >= first) & (place <= last)).all(axis=2).any(axis=1)
    assert 0.1 < reached.mean() < 0.9
    assert np.array_equal(model.surface.may_be_within(points, distance), reached)


@pytest.mark.parametrize("name", ["box", "hammer", "light_bulb"])
def test_the_mean_outline_is_a_quarter_of_the_hull(name):
    """Cauchy's formula: the mean projected area of a convex body is a quarter of its surface."""
    model = library.make(name)
    assert model.mean_outline == pytest.approx(0.25 * ConvexHull(model.vertices).area, rel=0.02)


@pytest.mark.parametrize("name", ["box", "mug", "drill"])
def test_few_points_bound_all_of_them_in_every_view(name, rng):
    model = library.make(name)
    points, outer = model.bounding_points(200)
    assert sorted(map(tuple, points)) == sorted(map(tuple, model.sample_surface(200)[0]))
    assert outer < 150
    for some, all_of_them in ((points[:outer], points), (model.outer_vertices, model.vertices)):
        for rotation in poses.random_rotations(40, rng):
            few, many = (there @ rotation.T + [0.0, 0.0, 0.5] for there in (some, all_of_them))
            for end in (np.min, np.max):
                np.testing.assert_allclose(end(few[:, :2] / few[:, 2:], 0), end(many[:, :2] / many[:, 2:], 0))
    flat = np.concatenate([rng.random((30, 2)), np.zeros((30, 1))], axis=1)
    assert len(hull_of(flat)) == 30
