"""What a page carries of a mesh: few triangles where the surface is, whatever came."""

import numpy as np
import pytest
import trimesh

from fusion.results.report import shapes
from scenes.geometry.objects import ObjectModel
from scenes.geometry.surface import Surface
from scenes.synthesis import library

MOST = 1000


def scanned(name, least):
    """A library's object, as finely cut as a scan: at least that many triangles, on the same surface."""
    model = library.make(name)
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    while len(mesh.faces) < least:
        mesh = mesh.subdivide()
    return ObjectModel(name, np.asarray(mesh.vertices), np.asarray(mesh.faces))


@pytest.mark.parametrize("name", ["mug", "l_block"])
@pytest.mark.parametrize("times", [2, 2 * shapes.THINNED_FIRST], ids=["some too many", "very many"])
def test_a_shown_object_is_small_and_lies_on_the_surface(name, times, tmp_path, monkeypatch):
    monkeypatch.setenv("PALPATE_CACHE", str(tmp_path))
    model = scanned(name, times * MOST)
    vertices, faces = shapes.shown_object(model, MOST)
    assert 0.5 * MOST < len(faces) <= MOST
    shown = trimesh.Trimesh(vertices + model.centroid, faces, process=False)
    distance, _, _ = Surface(model.vertices, model.faces).closest(np.asarray(shown.sample(2000, seed=1)))
    assert np.quantile(np.abs(distance), 0.95) < 0.015 * model.radius
    assert shown.area == pytest.approx(model.area, rel=0.03)


def test_what_is_few_is_shown_as_it_is():
    model = library.make("box")
    vertices, faces = shapes.shown_object(model, 10 * len(model.faces))
    assert faces is model.faces
    np.testing.assert_allclose(vertices + model.centroid, model.vertices)
