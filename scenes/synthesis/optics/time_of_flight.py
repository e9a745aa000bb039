"""Time of flight: phases of swinging light, mixed in each pixel, with light that took detours. Camera frame, metres.

A lamp at the lens swings at some frequencies; what comes back to a pixel is the sum of complex amplitudes over the
surfaces that it covers and over the ways to them: straight, or by one or more other surfaces, whose light is followed
between patches (radiosity with phases: Naik et al., "A light transport model for mitigating multipath interference in
time-of-flight sensors", CVPR 2015). Four samples a frequency count electrons, each with its shot noise; the phase is
that of their differences, and frequencies together resolve how many turns it has made (Sell and O'Connor, "The Xbox
One system on a chip and Kinect sensor", IEEE Micro 2014).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import Camera
from scenes.synthesis.optics.light import bounce_kernels as kernels
from scenes.synthesis.optics.light.infrared import as_grey, blurred
from scenes.synthesis.optics.light.light_kernels import reflectance
from scenes.synthesis.optics.light.views import Scene, View, see
from scenes.synthesis.optics.settings import TimeOfFlightCamera
from scenes.synthesis.optics.shots import Shot
from scenes.synthesis.optics.units import CameraUnit
from scenes.threads import run_chunks

Array = NDArray[np.float64]
Swings = NDArray[np.complex128]

LIGHT_SPEED = 299792458.0  # m/s
# Slope of a patch (cosine) is held above this: a patch at grazing incidence would have no bounds.
LEAST_SLOPE = 0.1
# Rows, and points, that are worth a thread.
ROWS, POINTS = 32, 256
# Light of the amplitude image's white: this percentile of the image (it is exposed so).
WHITE = 99.0


def time_of_flight_shot(
    scene: Scene, camera: Camera, built: TimeOfFlightCamera, unit: CameraUnit, rng: np.random.Generator
) -> Shot:
    """The depth that phases tell, and the image of their amplitudes."""
    view = see(scene, camera, built.samples, np.eye(4))
    waves = 2 * np.pi * np.array(built.frequencies) / LIGHT_SPEED
    swings, steady = _received(view, scene, built, waves, (camera.height, camera.width))
    swings, steady = _through_lens(swings, steady, built)
    measured = _samples(swings, steady, built, rng)
    amplitude = np.abs(measured).mean(axis=2)
    full = built.electrons * steady / 4 + built.modulation * built.electrons * np.abs(swings).max(axis=2) / 4
    keep = (np.abs(measured).min(axis=2) >= built.least) & (full < built.full_well)
    way = np.zeros(steady.shape)
    reach = min(1.5 * built.farthest, unambiguous(built.frequencies))  # rays slant: a way is longer than its depth

    def work(rows: slice) -> None:
        kernels.distances(rows.start, rows.stop, measured, keep, waves, reach, built.disagreement, way)

    run_chunks(work, len(way), ROWS)
    way = np.where(way > 0, way + built.delay * unit.flaws[4], 0.0)
    depth = way / np.linalg.norm(camera.rays(), axis=2)
    depth = np.where((depth >= built.nearest) & (depth <= built.farthest), depth, 0.0)
    white = max(float(np.percentile(amplitude, WHITE)), 4 * built.least)
    return Shot(depth.astype(np.float32), as_grey((amplitude / white).astype(np.float32)))


def unambiguous(frequencies: tuple[float, ...]) -> float:
    """Distance (m) after which the phases of all frequencies (Hz) repeat: c / 2 over their common divisor."""
    divisor = int(np.gcd.reduce([max(1, round(f)) for f in frequencies]))
    return LIGHT_SPEED / 2 / divisor


def _received(
    view: View, scene: Scene, built: TimeOfFlightCamera, waves: Array, shape: tuple[int, int]
) -> tuple[Swings, Array]:
    """Complex light (h, w, f) and steady light (h, w) in each pixel, before the lens."""
    swings, steady = np.zeros((*shape, len(waves)), dtype=np.complex128), np.zeros(shape)
    seen, s = view.rendering, view.samples
    step = built.receiver_step * s
    sparse = (slice(step // 2, None, step), slice(step // 2, None, step))
    ids, normals, depth = (np.ascontiguousarray(x[sparse]) for x in (seen.ids, seen.normals, seen.depth))
    near = (ids, normals, depth)
    detoured = np.zeros((*ids.shape, 0), dtype=np.complex128)
    if built.bounces > 0 and (seen.ids >= 0).any():
        detoured = _detoured(view, scene, built, waves, sparse)
    images = (seen.depth, seen.ids, seen.normals, scene.materials, view.meshes)

    def work(rows: slice) -> None:
        part = (rows.start, rows.stop, s, view.lens)
        kernels.phasors(*part, *images, waves, step, *near, detoured, built.ambient, swings, steady)

    run_chunks(work, shape[0], ROWS)
    return swings, steady


def _detoured(view: View, scene: Scene, built: TimeOfFlightCamera, waves: Array, sparse: tuple[slice, slice]) -> Swings:
    """(r, c, f) light by way of other surfaces at sparse rays, with the phase it is behind the straight light there,
    times the squared distance.
    """
    senders, normals, areas, albedo = _patches(view, scene, built.sender_step * view.samples)
    far = np.linalg.norm(senders, axis=1)
    cosine = np.maximum(-np.einsum("ni,ni->n", senders, normals) / far, 0.0)
    received = (cosine / far**2)[:, None] * np.exp(-1j * far[:, None] * waves)
    sent = albedo[:, None] * received
    total = sent.copy()
    for _ in range(built.bounces - 1):
        sent = albedo[:, None] * _gathered(senders, normals, senders, normals, areas, sent, waves)
        total += sent
    seen = view.rendering.ids[sparse] >= 0
    places = _points(view, sparse)[seen]
    out = np.zeros((*seen.shape, len(waves)), dtype=np.complex128)
    came = _gathered(places, view.rendering.normals[sparse][seen], senders, normals, areas, total, waves)
    away = np.linalg.norm(places, axis=1)[:, None]
    out[seen] = came * np.exp(1j * away * waves) * away**2
    return out


def _gathered(
    points: Array, normals: Array, senders: Array, sender_normals: Array, areas: Array, sent: Swings, waves: Array
) -> Swings:
    out = np.zeros((len(points), len(waves)), dtype=np.complex128)
    normals = np.ascontiguousarray(normals)

    def work(part: slice) -> None:
        kernels.gather(part.start, part.stop, points, normals, senders, sender_normals, areas, sent, waves, out)

    run_chunks(work, len(points), POINTS)
    return out


def _points(view: View, sparse: tuple[slice, slice]) -> Array:
    """(r, c, 3) what sparse rays meet."""
    height, width = view.rendering.ids.shape
    v, u = np.meshgrid(np.arange(height)[sparse[0]], np.arange(width)[sparse[1]], indexing="ij")
    rays = np.stack([(u - view.camera.cx) / view.camera.fx, (v - view.camera.cy) / view.camera.fy, np.ones(u.shape)], 2)
    return np.asarray(rays * view.rendering.depth[sparse][..., None].astype(np.float64))


def _patches(view: View, scene: Scene, step: int) -> tuple[Array, Array, Array, Array]:
    """Points (k, 3), normals (k, 3), areas (k,) m^2 and albedos (k,) of every step-th ray that meets something."""
    sparse = (slice(step // 2, None, step), slice(step // 2, None, step))
    ids = view.rendering.ids[sparse]
    seen = ids >= 0
    points, normals = _points(view, sparse)[seen], np.ascontiguousarray(view.rendering.normals[sparse][seen])
    far = np.linalg.norm(points, axis=1)
    slope = np.maximum(-np.einsum("ni,ni->n", points, normals) / far, LEAST_SLOPE)
    areas = (step * points[:, 2]) ** 2 / (view.camera.fx * view.camera.fy) * (far / points[:, 2]) / slope
    albedo = [
        reflectance(scene.materials[i], view.meshes[i], *point) for i, point in zip(ids[seen], points, strict=True)
    ]
    return points, normals, areas, np.array(albedo)


def _through_lens(swings: Swings, steady: Array, built: TimeOfFlightCamera) -> tuple[Swings, Array]:
    """The same after blur and scattering in the lens."""
    out = np.zeros_like(swings)
    for f in range(swings.shape[2]):
        out[..., f] = _scattered(swings[..., f].real, built) + 1j * _scattered(swings[..., f].imag, built)
    return out, _scattered(steady, built)


def _scattered(image: Array, built: TimeOfFlightCamera) -> Array:
    sharp = blurred(image, built.blur).astype(np.float64)
    if built.scattered <= 0:
        return sharp
    import cv2

    # so wide a blur needs few pixels
    height, width = image.shape
    size = (max(1, width // 8), max(1, height // 8))
    small = cv2.resize(sharp, size, interpolation=cv2.INTER_AREA)
    wide = cv2.GaussianBlur(small, (0, 0), built.scatter_length / 8, borderType=cv2.BORDER_REPLICATE)
    wide = cv2.resize(wide, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray((1.0 - built.scattered) * sharp + built.scattered * wide)


def _samples(swings: Swings, steady: Array, built: TimeOfFlightCamera, rng: np.random.Generator) -> Swings:
    """Swings (h, w, f) in electrons as four samples of a quarter of the light each tell them.

    A sample counts (steady + m Re(swing e^(i k pi/2))) / 4 electrons with variance that and the reading's; the
    difference of opposite ones has twice the variance of their mean.
    """
    mean = np.maximum(built.electrons * steady / 4, 0.0)
    sigma = np.sqrt(2 * mean + 2 * built.read_noise**2)[..., None]
    shape = swings.shape
    noise = rng.standard_normal((2, *shape), dtype=np.float32)
    return np.asarray(built.modulation * built.electrons / 2 * swings + sigma * (noise[0] + 1j * noise[1]))
