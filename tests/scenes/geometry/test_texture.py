"""Colours of a surface: read from every kind of mesh file, looked up at any fineness, written and read back."""

import itertools

import numpy as np
import pytest
import trimesh
from PIL import Image

from scenes.errors import MeshError
from scenes.files.formats.off import write_off
from scenes.files.formats.ply import write_ply
from scenes.geometry.appearance.texture import Texture, TextureSettings, coloured_mesh
from scenes.geometry.objects import ObjectModel
from scenes.geometry.surface_kernels import mix_cells
from scenes.synthesis import library
from scenes.synthesis.staging.prints import ink, with_print

SIDE = 0.1
CORNERS = np.array(list(itertools.product((0.0, SIDE), repeat=3)))


def mixed_twin(points, origin, cell, index, colours):
    out = np.full((len(points), 3), np.nan)
    for n, point in enumerate(points):
        place = (point - origin) / cell - 0.5
        low, weights, found = np.floor(place).astype(int), [], []
        for corner in itertools.product((0, 1), repeat=3):
            at = low + corner
            if (at >= 0).all() and (at < index.shape).all() and index[tuple(at)]:
                weights.append(np.prod(1.0 - np.abs(place - at)))
                found.append(colours[index[tuple(at)] - 1])
        if sum(weights) > 1e-6:
            out[n] = np.average(found, axis=0, weights=weights)
    return out


def test_the_kernel_agrees_with_its_twin():
    rng = np.random.default_rng(0)
    index = np.where(rng.random((5, 6, 7)) < 0.4, rng.integers(1, 20, (5, 6, 7)), 0).astype(np.int32)
    colours, origin = rng.random((20, 3)), np.array([0.1, -0.2, 0.3])
    points = origin + rng.uniform(-1.0, 8.0, (500, 3)) * 0.01
    points[0] = np.nan
    out = np.full((500, 3), np.nan)
    mix_cells(points, origin, 0.01, index, colours, out)
    expected = mixed_twin(points[1:], origin, 0.01, index, colours)
    assert 50 < np.isfinite(expected[:, 0]).sum() < 490
    np.testing.assert_allclose(out[1:], expected, atol=1e-12)
    assert np.isnan(out[0]).all()


def test_colours_are_looked_up_where_they_are_and_averaged_from_far_off():
    model = with_print(library.make("box"))
    points, _ = model.sample_surface(2000, seed=5)
    near = model.texture.at(points)
    truth = ink(points, model)
    assert np.median(np.abs(near - truth)) < 0.02
    assert np.mean(np.abs(near - truth) < 0.1) > 0.8  # but for what is at an edge
    assert model.texture.at(points, 0.02).std() < near.std()
    assert np.isnan(model.texture.at(points + 1.0)).all()


def test_points_and_colours_must_fit():
    with pytest.raises(MeshError, match="colours of shape"):
        Texture(np.zeros((4, 3)), np.zeros((3, 3)))
    with pytest.raises(MeshError, match="points of shape"):
        Texture(np.zeros((0, 3)), np.zeros((0, 3)))


def red_above(model):
    """Whether the texture is red on the upper half and blue on the lower."""
    points, _ = model.sample_surface(500, seed=2)
    clear = np.abs(points[:, 2] - 0.5 * SIDE) > 0.01
    found = model.texture.at(points[clear])
    return np.mean((found[:, 0] > found[:, 2]) == (points[clear, 2] > 0.5 * SIDE))


def fine_box():
    mesh = trimesh.creation.box([SIDE] * 3).subdivide().subdivide().subdivide().subdivide()
    mesh.apply_translation([0.5 * SIDE] * 3)
    return mesh


@pytest.mark.parametrize("suffix", ["ply", "off", "glb", "obj"])
def test_vertex_colours_are_read(tmp_path, suffix):
    mesh = fine_box()
    up = mesh.vertices[:, 2] > 0.5 * SIDE
    mesh.visual.vertex_colors = np.where(up[:, None], [255, 0, 0, 255], [0, 0, 255, 255]).astype(np.uint8)
    path = tmp_path / f"box.{suffix}"
    if suffix in ("ply", "off"):
        write = write_ply if suffix == "ply" else write_off
        write(path, mesh.vertices, mesh.faces, mesh.visual.vertex_colors[:, :3])
    else:
        mesh.export(path)
    model = ObjectModel.load(path)
    assert red_above(model) > 0.98
    again = ObjectModel.load(path)  # from the cache
    np.testing.assert_array_equal(model.texture.colours, again.texture.colours)


def test_an_image_laid_over_the_mesh_is_read_and_read_anew_when_it_changes(tmp_path):
    mesh = fine_box()
    uv = np.stack([mesh.vertices[:, 0] / SIDE, mesh.vertices[:, 2] / SIDE], axis=1) * 0.98 + 0.01
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32, :, 0] = image[32:, :, 2] = 255  # its first rows are the upper ones
    mesh.visual = trimesh.visual.TextureVisuals(uv, image=Image.fromarray(image))
    mesh.export(tmp_path / "box.obj")
    assert red_above(ObjectModel.load(tmp_path / "box.obj")) > 0.98
    picture = next(path for path in tmp_path.iterdir() if path.suffix in (".png", ".jpg", ".jpeg"))
    Image.fromarray(image[::-1]).save(picture)
    assert red_above(ObjectModel.load(tmp_path / "box.obj")) < 0.02


def test_one_colour_all_over_is_no_print(tmp_path):
    mesh = fine_box()
    write_ply(tmp_path / "grey.ply", mesh.vertices, mesh.faces, np.full((len(mesh.vertices), 3), 128))
    assert ObjectModel.load(tmp_path / "grey.ply").texture is None
    assert library.make("box").texture is None


def test_a_print_is_written_and_read_back(tmp_path):
    model = with_print(library.make("box"))
    vertices, faces, colours = coloured_mesh(model.vertices, model.faces, model.texture)
    assert len(faces) <= TextureSettings().most_faces
    write_ply(tmp_path / "box.ply", vertices, faces, colours)
    read = ObjectModel.load(tmp_path / "box.ply")
    assert read.diameter == pytest.approx(model.diameter)
    points, _ = model.sample_surface(1000, seed=5)
    assert np.median(np.abs(read.texture.at(points) - model.texture.at(points))) < 0.05
    plain = library.make("box")
    assert coloured_mesh(plain.vertices, plain.faces, None) == (plain.vertices, plain.faces, None)
