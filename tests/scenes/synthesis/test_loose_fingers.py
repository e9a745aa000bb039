"""Loose fingers hide the asked share, stay out of the object, and random contacts lie on its surface."""

import igl
import numpy as np
import pytest
import trimesh

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.synthesis import library
from scenes.synthesis.staging.loose_fingers import capsule_mesh, lay_fingers, random_contacts
from scenes.synthesis.staging.views import look_at

CAMERA = Camera(570.0, 570.0, 319.5, 239.5, 640, 480)


def test_a_capsule_has_its_volume_and_ends():
    start, end = np.array([0.1, 0.0, 0.3]), np.array([0.13, 0.04, 0.35])
    body = trimesh.Trimesh(*capsule_mesh(start, end, 0.01), process=False)
    assert body.is_watertight
    length = np.linalg.norm(end - start)
    assert body.volume == pytest.approx(np.pi * 0.01**2 * length + 4 / 3 * np.pi * 0.01**3, rel=0.04)
    np.testing.assert_allclose(body.center_mass, (start + end) / 2, atol=1e-9)


@pytest.mark.parametrize("name", ["drill", "mug", "wine_glass"])
@pytest.mark.parametrize("wanted", [0.3, 0.8])
def test_the_share_is_reached_without_touching_the_object(name, wanted):
    model = library.make(name)
    renderer = Renderer({"object": (model.vertices, model.faces)})
    pose = look_at([0.3, -0.5, 0.8], model.centroid, 0.6)
    fingers = lay_fingers(renderer, "object", pose, wanted, CAMERA, np.random.default_rng(3))
    assert 3 <= len(fingers) <= 5
    scene = {"object": pose, **fingers}
    assert 1 - renderer.visible_fraction(CAMERA, scene, "object") == pytest.approx(wanted, abs=0.02)
    points = poses.apply(poses.inverse(pose), np.concatenate([renderer.vertices(k, v) for k, v in fingers.items()]))
    distance = igl.signed_distance(points, model.vertices, model.faces)[0]
    assert distance.min() > -0.001


def test_nothing_to_hide_needs_no_finger_and_the_impossible_is_refused():
    model = library.make("l_block")
    renderer = Renderer({"object": (model.vertices, model.faces)})
    pose = look_at([0, 0, 1], model.centroid, 0.5)
    assert lay_fingers(renderer, "object", pose, 0.0, CAMERA, np.random.default_rng(0)) == {}
    with pytest.raises(InputError, match="30 pixels"):
        lay_fingers(renderer, "object", look_at([0, 0, 1], model.centroid, 40.0), 0.5, CAMERA, np.random.default_rng(0))


def test_random_contacts_lie_on_the_outside_with_outward_normals():
    model = library.make("mug")
    contacts = random_contacts(model, 40, np.random.default_rng(5))
    assert len(contacts) == 40
    distance = igl.signed_distance(contacts.points, model.vertices, model.faces)[0]
    assert np.abs(distance).max() < 1e-6
    lifted = igl.signed_distance(contacts.points + 0.0005 * contacts.normals, model.vertices, model.faces)[0]
    assert (lifted > 0).all()
    assert np.median(lifted) == pytest.approx(0.0005, rel=0.01)
