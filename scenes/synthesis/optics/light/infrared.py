"""Infra-red images of a scene that a projector lights: light, lens, exposure, noise of the sensor, counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.synthesis.optics.light import light_kernels as kernels
from scenes.synthesis.optics.light.pattern import Texture, pattern_texture
from scenes.synthesis.optics.light.views import Scene, View, see
from scenes.synthesis.optics.settings import Imager, Pattern
from scenes.threads import run_chunks

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# Texels of the pattern, and of the projector's own view that tells its shadow, to a pixel of the frame.
TEXELS = 2.0
SHADOW_TEXELS = 1.5
# Slack of the shadow's depth (m): without it rounding would let surfaces shade themselves.
SHADOW_SLACK = 0.001
# Rows that are worth a thread.
ROWS = 32


@dataclass(frozen=True)
class Projector:
    """A projector `offset` (m) to the right of the left eye: its pattern, and the depth (h, w) of what it reaches."""

    offset: float
    light: Texture
    depth: Image
    lens: tuple[float, float, float]

    @property
    def light_lens(self) -> Array:
        """Scale and centre of the pattern's texture."""
        return np.array([self.light.scale, self.light.cx, self.light.cy])


@dataclass(frozen=True)
class Counts:
    """What the sensor delivers: image (h, w) in shares of full, and the standard deviation of its noise (h, w)."""

    image: Image
    noise: Image


def project(scene: Scene, camera: Camera, pattern: Pattern, offset: float, reach: float, seed: int) -> Projector:
    """The projector of a camera; reach: how far (tangent) it lights beyond the frame's left and right edge."""
    left, right = -(camera.cx + 2) / camera.fx - reach, (camera.width - camera.cx + 2) / camera.fx + reach
    top, bottom = -(camera.cy + 2) / camera.fy, (camera.height - camera.cy + 2) / camera.fy
    light = pattern_texture(pattern, seed, TEXELS * camera.fx, left, right, top, bottom)
    f = SHADOW_TEXELS * camera.fx
    wide = Camera(f, f, -left * f, -top * f, int((right - left) * f) + 1, int((bottom - top) * f) + 1)
    seen = see(scene, wide, 1, poses.make_pose(np.eye(3), [-offset, 0.0, 0.0]))
    return Projector(offset, light, seen.rendering.depth, (f, wide.cx, wide.cy))


def expose(
    view: View, scene: Scene, projector: Projector, eye_from_camera: Array, lamp: Array, imager: Imager
) -> tuple[Image, Image]:
    """Light (h, w) of the projector and of the room that falls on the sensor of an eye, blurred by its lens."""
    s, rendering = view.samples, view.rendering
    shape = (rendering.ids.shape[0] // s, rendering.ids.shape[1] // s)
    laser, room = np.zeros(shape), np.zeros(shape)
    projector_from_camera = poses.make_pose(np.eye(3), [-projector.offset, 0.0, 0.0])
    projector_from_eye = np.ascontiguousarray((projector_from_camera @ poses.inverse(eye_from_camera))[:3])
    lit = eye_from_camera[:3, :3] @ lamp
    images = (rendering.depth, rendering.ids, rendering.normals, scene.materials, view.meshes)
    shadow = (projector.depth, np.array(projector.lens), SHADOW_SLACK)
    lights = (projector_from_eye, projector.light.light, projector.light_lens, *shadow)
    room_light = (imager.ambient, imager.lamp, lit)

    def work(rows: slice) -> None:
        kernels.pattern_light(rows.start, rows.stop, s, view.lens, *images, *lights, *room_light, laser, room)

    run_chunks(work, shape[0], ROWS)
    return blurred(laser, imager.blur), blurred(room, imager.blur)


def blurred(image: NDArray[np.floating], sigma: float) -> Image:
    """A Gaussian of this standard deviation (px) over it; none at 0."""
    import cv2

    out = np.asarray(image, dtype=np.float32)
    return np.asarray(cv2.GaussianBlur(out, (0, 0), sigma)) if sigma > 0 else out


def bent(image: Image, camera: Camera, cubic: float) -> Image:
    """An image through a lens whose tangents are off by `cubic` times their cube: no more than the calibration left."""
    import cv2

    if cubic == 0.0:
        return image
    rays = camera.rays()[..., :2]
    off = rays * (cubic * np.einsum("ijk,ijk->ij", rays, rays))[..., None]
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    columns, rows = u + camera.fx * off[..., 0], v + camera.fy * off[..., 1]
    maps = columns.astype(np.float32), rows.astype(np.float32)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


def exposure(image: Image, imager: Imager) -> tuple[float, float]:
    """Exposure (full wells per unit of light) and gain that bring the mean of an image where it is aimed at, less when
    too much of it would be full.
    """
    mean = float(image.mean())
    wanted = imager.aim / mean if mean > 1e-9 else np.inf
    bright = float(np.quantile(image, 1.0 - imager.overexposed))
    wanted = min(wanted, 1.0 / bright) if bright > 1e-9 else wanted
    time = float(np.clip(wanted, *imager.exposure))
    return time, float(np.clip(wanted / time, 1.0, imager.gain))


def read_out(
    laser: Image, room: Image, imager: Imager, setting: tuple[float, float], rng: np.random.Generator
) -> Counts:
    """Speckle, shot noise, read noise, saturation and rounding of the light that fell on a sensor."""
    time, gain = setting
    speckled = np.maximum(1.0 + imager.speckle * rng.standard_normal(laser.shape, dtype=np.float32), 0.0)
    electrons = np.maximum((laser * speckled + room) * np.float32(time * imager.full_well), 0.0)
    variance = electrons + np.float32(imager.read_noise**2)
    read = electrons + np.sqrt(variance) * rng.standard_normal(laser.shape, dtype=np.float32)
    full = np.float32(gain / imager.full_well)
    levels = float(2**imager.bits - 1)
    image = np.rint(np.clip(read * full, 0.0, 1.0) * levels) / levels
    grain = variance + (laser * np.float32(imager.speckle * time * imager.full_well)) ** 2
    return Counts(image.astype(np.float32), (np.sqrt(grain) * full + 0.3 / levels).astype(np.float32))


def as_grey(image: Image) -> NDArray[np.uint8]:
    """(h, w) uint8 of shares of full."""
    return np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
