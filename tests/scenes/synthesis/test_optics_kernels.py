"""The compiled loops of the optics against plain NumPy."""

import numpy as np
import pytest

from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.synthesis.optics.light import bounce_kernels, light_kernels
from scenes.synthesis.optics.light.infrared import Projector, expose
from scenes.synthesis.optics.light.pattern import Texture, _add_dots, pattern_texture
from scenes.synthesis.optics.light.things import Material, draw_material, material_table
from scenes.synthesis.optics.light.views import Scene, see
from scenes.synthesis.optics.settings import Imager, Pattern

LIGHT = 299792458.0


def test_dots_are_gaussians_and_their_mean_is_the_power():
    image = np.zeros((40, 50), dtype=np.float32)
    columns, rows, peaks = np.array([10.3, 30.8]), np.array([12.6, 25.1]), np.array([1.0, 2.0])
    _add_dots(image, columns, rows, peaks, 1.5)
    v, u = np.mgrid[:40, :50]
    twin = sum(p * np.exp(-((u - c) ** 2 + (v - r) ** 2) / (2 * 1.5**2)) for c, r, p in zip(columns, rows, peaks))
    np.testing.assert_allclose(image, twin, atol=2e-3)
    pattern = Pattern(density=5000.0, radius=0.001, power=0.3)
    texture = pattern_texture(pattern, 1, 1200.0, -0.3, 0.3, -0.2, 0.2)
    assert texture.light.mean() == pytest.approx(0.3, rel=0.1)
    # another part of the same pattern: the same dots at the same tangents
    part = pattern_texture(pattern, 1, 1200.0, -0.1, 0.3, -0.2, 0.2).light
    np.testing.assert_allclose(part[:, 10:-10], texture.light[:, 250 : 250 + part.shape[1] - 20], atol=1e-3)


def test_light_of_a_plane_is_that_of_lambert_and_of_the_lobe():
    camera = Camera(100.0, 100.0, 9.5, 7.5, 20, 16)
    slope, offset, glossy = 0.4, 0.1, Material(albedo=0.6, gloss=0.2, sharpness=12.0)
    corners = [[-9, -9, 1 - 9 * slope], [9, -9, 1 + 9 * slope], [9, 9, 1 + 9 * slope], [-9, 9, 1 - 9 * slope]]
    scene = Scene(
        Renderer({"w": (corners, [[0, 1, 2], [0, 2, 3]])}), {"w": np.eye(4)}, material_table(["w"], 0, {"w": glossy})
    )
    light = Texture(np.full((400, 400), 2.0, dtype=np.float32), 100.0, 200.0, 200.0)
    projector = Projector(offset, light, np.zeros((400, 400), dtype=np.float32), (100.0, 200.0, 200.0))
    lamp = np.array([0.0, -0.6, -0.8])
    laser, room = expose(see(scene, camera, 1, np.eye(4)), scene, projector, np.eye(4), lamp, Imager(blur=0.0))
    rays = camera.rays()
    points = rays * (1.0 / (1.0 - slope * rays[..., :1]))
    normal = np.array([slope, 0.0, -1.0]) / np.hypot(slope, 1.0)

    def twin(towards):
        eye = -points / np.linalg.norm(points, axis=-1, keepdims=True)
        half = towards + eye
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        lobe = 0.2 * (12.0 + 8.0) / 8.0 * np.maximum(half @ normal, 0.0) ** 12.0
        return np.maximum(towards @ normal, 0.0) * (0.6 + lobe)

    way = np.array([offset, 0.0, 0.0]) - points
    far = np.linalg.norm(way, axis=-1)
    np.testing.assert_allclose(laser, 2.0 * twin(way / far[..., None]) / far**2, rtol=1e-4)
    imager = Imager()
    expected = imager.ambient * ((1 - imager.lamp) * 0.6 + imager.lamp * twin(np.broadcast_to(lamp, points.shape)))
    np.testing.assert_allclose(room, expected, rtol=1e-4)


def test_what_stands_before_the_projector_throws_a_shadow():
    camera = Camera(200.0, 200.0, 59.5, 39.5, 120, 80)
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    meshes = {
        "far": (9 * square + [0, 0, 1.0], [[0, 1, 2], [0, 2, 3]]),
        "near": (0.03 * square + [0, 0, 0.5], [[0, 1, 2], [0, 2, 3]]),
    }
    white = {name: Material() for name in meshes}
    scene = Scene(Renderer(meshes), dict.fromkeys(meshes, np.eye(4)), material_table(list(meshes), 0, white))
    from scenes.synthesis.optics.light.infrared import project

    projector = project(scene, camera, Pattern(density=4000.0, radius=0.002, haze=0.5), 0.05, 0.5, 3)
    laser, _ = expose(
        see(scene, camera, 2, np.eye(4)), scene, projector, np.eye(4), np.array([0, 0, -1.0]), Imager(blur=0)
    )
    # the shadow of an edge at x and depth near falls on far at offset + (x - offset) far / near
    shadow = [200.0 * (0.05 + (x - 0.05) * 2.0) + 59.5 for x in (-0.03, 0.03)]
    hidden = [200.0 * x / 0.5 + 59.5 for x in (-0.03, 0.03)]
    left = slice(int(shadow[0]) + 2, int(hidden[0]) - 2)
    assert (laser[35:45, left] == 0).all()
    assert (laser[35:45, : int(shadow[0]) - 2] > 0).all()
    assert (laser[35:45, int(hidden[1]) + 2 :] > 0).all()


def test_texture_belongs_to_the_thing_and_has_its_spread():
    rough = np.array([0.4, 0.2, 0.005, 0.0, 10.0])
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, size=(4000, 3))
    still = np.eye(4)[:3]
    albedo = np.array([light_kernels.reflectance(rough, still, *p) for p in points])
    assert albedo.mean() == pytest.approx(0.4, abs=0.02)
    assert albedo.std() == pytest.approx(0.08, rel=0.3)
    moved = still.copy()
    moved[:, 3] = [0.1, -0.2, 0.3]  # mesh_from_camera
    again = [light_kernels.reflectance(rough, moved, *(p - moved[:, 3])) for p in points[:50]]
    np.testing.assert_allclose(again, albedo[:50], atol=1e-9)
    assert draw_material("hand", 1) == draw_material("hand", 1) != draw_material("hand", 2)


def test_gathered_light_is_the_sum_over_patches():
    rng = np.random.default_rng(1)
    points, senders = rng.normal(size=(7, 3)), rng.normal(size=(9, 3))
    normals, sender_normals = (
        x / np.linalg.norm(x, axis=1, keepdims=True) for x in (rng.normal(size=(n, 3)) for n in (7, 9))
    )
    areas, sent = rng.uniform(0.1, 0.2, 9), rng.normal(size=(9, 2)) + 1j * rng.normal(size=(9, 2))
    waves, out = np.array([3.0, 5.0]), np.zeros((7, 2), dtype=complex)
    bounce_kernels.gather(0, 7, points, normals, senders, sender_normals, areas, sent, waves, out)
    way = senders[None] - points[:, None]
    r = np.linalg.norm(way, axis=2)
    here = np.maximum(np.einsum("pqi,pi->pq", way, normals) / r, 0)
    there = np.maximum(-np.einsum("pqi,qi->pq", way, sender_normals) / r, 0)
    form = here * there * areas / (np.pi * r**2 + areas)
    np.testing.assert_allclose(
        out, np.einsum("pq,pqf,qf->pf", form, np.exp(-1j * r[..., None] * waves), sent), rtol=1e-12
    )


def test_swings_of_a_plane_are_those_of_its_distance():
    camera = Camera(100.0, 100.0, 9.5, 7.5, 20, 16)
    corners = [[-9, -9, 1.0], [9, -9, 1.0], [9, 9, 1.0], [-9, 9, 1.0]]
    matt = material_table(["w"], 0, {"w": Material(albedo=0.6)})
    scene = Scene(Renderer({"w": (corners, [[0, 1, 2], [0, 2, 3]])}), {"w": np.eye(4)}, matt)
    view = see(scene, camera, 1, np.eye(4))
    waves = 2 * np.pi * np.array([120e6, 80e6]) / LIGHT
    swings, steady = np.zeros((16, 20, 2), dtype=complex), np.zeros((16, 20))
    seen = view.rendering
    sparse = (slice(2, None, 4), slice(2, None, 4))
    near = tuple(np.ascontiguousarray(x[sparse]) for x in (seen.ids, seen.normals, seen.depth))
    images = (seen.depth, seen.ids, seen.normals, matt, view.meshes, waves, 4, *near)
    more = np.full((*near[0].shape, 2), 0.1 + 0.2j)
    far = np.linalg.norm(camera.rays(), axis=2)
    for detoured, extra in ((np.zeros((*near[0].shape, 0), dtype=complex), 0.0), (more, 0.1 + 0.2j)):
        swings[:], steady[:] = 0, 0
        bounce_kernels.phasors(0, 16, 1, view.lens, *images, detoured, 0.3, swings, steady)
        light = 0.6 / far / far**2 + 0.6 * extra / far**2
        np.testing.assert_allclose(swings, light[..., None] * np.exp(-2j * far[..., None] * waves), rtol=1e-5)
        np.testing.assert_allclose(steady, 0.6 / far**3 + 0.3 * 0.6, rtol=1e-5)


@pytest.mark.parametrize("frequencies", [(120e6, 80e6, 16e6), (220e6, 180e6, 140e6), (120e6, 90e6, 75e6)])
def test_distances_come_back_from_their_phases(frequencies):
    waves = 2 * np.pi * np.array(frequencies) / LIGHT
    truth = np.linspace(0.2, 6.8, 300).reshape(10, 30)
    rng = np.random.default_rng(2)
    noise = 0.05 * (rng.normal(size=(10, 30, 3)) + 1j * rng.normal(size=(10, 30, 3)))
    swings = np.exp(-2j * truth[..., None] * waves) + noise
    keep = np.ones(truth.shape, dtype=bool)
    keep[0, 0] = False
    out = np.zeros(truth.shape)
    bounce_kernels.distances(0, 10, swings, keep, waves, 7.4, 0.1, out)
    assert out[0, 0] == 0
    # the twin: least squares over a fine grid of distances, weighted alike
    grid = np.arange(0.01, 7.4, 0.0005)
    for i, j in ((1, 3), (4, 20), (9, 29)):
        off = np.angle(np.exp(1j * (-np.angle(swings[i, j])[:, None] - 2 * waves[:, None] * grid))) / (
            2 * waves[:, None]
        )
        weight = waves**2 * np.abs(swings[i, j]) ** 2
        assert out[i, j] == pytest.approx(grid[np.argmin(weight @ off**2)], abs=0.001)
    assert np.median(np.abs(out - truth)[keep]) < 0.01


def test_frequencies_that_disagree_are_no_reading():
    waves = 2 * np.pi * np.array((220e6, 180e6, 140e6)) / LIGHT
    truth = np.linspace(0.5, 3.5, 300).reshape(10, 30, 1)
    mixed = np.exp(-2j * truth * waves) + 0.8 * np.exp(-2j * (truth + 0.4) * waves)  # two depths 0.4 m apart
    out = np.zeros((10, 30))
    bounce_kernels.distances(0, 10, mixed, np.ones((10, 30), dtype=bool), waves, 7.4, 0.02, out)
    assert (out == 0).mean() > 0.9
