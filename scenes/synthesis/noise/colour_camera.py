"""A colour camera of its own beside a depth camera, and what its calibration leaves: turned, moved, scaled and bent
against depth, with the blur and the grain of a small sensor, of things with colours, patches and shades of their own.

The image is brought to the depth camera's frame as cameras on sale do it, by a calibration that is believed: it has the
depth camera's size and is taken for its own view. Camera frame, metres; pixel centres on integers.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer, Rendering
from scenes.geometry.cameras import Camera

Array = NDArray[np.float64]

# Slack of a shade (m): without it rounding would let surfaces shade themselves; pixels of the lamp's own view, and from
# where (m) it shines.
SHADE_SLACK, LAMP_PIXELS, LAMP_AWAY = 0.004, 900, 2.0
# Share of light that is left in a shade and on what faces away.
AMBIENT = (0.3, 0.6)
# Directions to the lamp: straight from the camera and up to this far beside it (rad).
LAMP_TILT = float(np.deg2rad(60.0))
# What a recording's look draws beside its things, which are numbered from 0.
LAMP, GAINS = 1001, 1002


@dataclass(frozen=True)
class ColourCamera:
    """Errors of a colour camera's image against depth, standard deviations where nothing else is said. By judgement:
    consumer cameras are calibrated to a few tenths of a degree and a millimetre, which leaves 1 to 3 px.
    """

    # Turn about each axis (rad), and shift along each (m).
    turn: float = float(np.deg2rad(0.14))
    shift: float = 0.0011
    # Focal length, a share; and the cube of a ray's tangent that a lens model leaves (no unit): 1 to 2 px in a corner.
    focal: float = 0.0026
    cubic: float = 0.007
    # Lens: blur (px, least and most). Sensor: grain (levels of 255, least and most); gain of each channel.
    blur: tuple[float, float] = (0.5, 1.1)
    grain: tuple[float, float] = (2.0, 6.0)
    gains: tuple[float, float] = (0.65, 1.05)
    # Patches of a surface: their size (m), and how far their brightness and colour go from the thing's own (share).
    patch: float = 0.018
    patchy: float = 0.25
    # Those of what stands behind: larger and as strong.
    patch_behind: float = 0.06
    # Rays to a pixel's side.
    samples: int = 2


@dataclass(frozen=True)
class ColourErrors:
    """One camera's: colour_from_depth (4, 4), what nobody knows of it; factor of its focal length; cube of tangents.
    look: seed of what things and their light look like to it, None where every frame draws its own.
    """

    moved: Array
    focal: float
    cubic: float
    look: int | None = None


def draw_colour_errors(camera: ColourCamera, rng: np.random.Generator) -> ColourErrors:
    """A calibration's draw: of one camera, or of one frame."""
    turn = poses.exp_rotation(camera.turn * rng.normal(size=(1, 3)))[0]
    moved = poses.make_pose(turn, camera.shift * rng.normal(size=3))
    return ColourErrors(moved, 1.0 + camera.focal * rng.normal(), camera.cubic * rng.normal())


def draw_lasting(camera: ColourCamera, rng: np.random.Generator) -> ColourErrors:
    """Those of a recording: things keep their colours and patches, the lamp its place, the sensor its gains."""
    return replace(draw_colour_errors(camera, rng), look=int(rng.integers(2**31)))


def colour_image(
    renderer: Renderer,
    scene: dict[str, Array],
    lens: Camera,
    camera: ColourCamera,
    rng: np.random.Generator,
    errors: ColourErrors | None = None,
) -> NDArray[np.uint8]:
    """(h, w, 3) what the colour camera sees of a scene of camera_from_mesh poses, as the depth camera's view (lens) is
    believed to be. errors: the recording's lasting ones; drawn anew without them.
    """
    import cv2

    own = errors or draw_colour_errors(camera, rng)
    view = replace(lens, fx=lens.fx * own.focal, fy=lens.fy * own.focal)
    moved = {name: own.moved @ pose for name, pose in scene.items()}
    rendering = renderer.render(view.scaled(camera.samples), moved)
    fine = _painted(renderer, rendering, moved, view.scaled(camera.samples), camera, rng, own.look)
    light = np.asarray(cv2.resize(fine, (lens.width, lens.height), interpolation=cv2.INTER_AREA))
    light = _bent(light.astype(np.float32), lens, own.cubic)
    light = np.asarray(cv2.GaussianBlur(light, (0, 0), rng.uniform(*camera.blur)))
    gains = rng if own.look is None else np.random.default_rng([own.look, GAINS])
    light = light * gains.uniform(*camera.gains, 3).astype(np.float32)
    light = light + np.float32(rng.uniform(*camera.grain)) * rng.standard_normal(light.shape, dtype=np.float32)
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)


def _painted(
    renderer: Renderer,
    rendering: Rendering,
    scene: dict[str, Array],
    lens: Camera,
    camera: ColourCamera,
    rng: np.random.Generator,
    look: int | None,
) -> NDArray[np.float32]:
    """(h, w, 3) levels of 255: things in colours and patches of their own under one lamp that throws shades. look: seed
    of all of these, None to draw them.
    """
    seen = rendering.ids >= 0
    names = rendering.names
    points = lens.back_project(rendering.depth, seen)
    of = rendering.ids[seen]
    colour = np.zeros((len(points), 3))
    for index, name in enumerate(names):
        mine = of == index
        if not mine.any():
            continue
        local = poses.apply(poses.inverse(scene[name]), points[mine])
        size = camera.patch_behind if name in ("background", "table", "wall") else camera.patch
        # by its number, for a thing may be out of sight
        own = rng if look is None else np.random.default_rng([look, index])
        colour[mine] = _patches(local, _own_colour(own), size, camera.patchy, own)
    rng = rng if look is None else np.random.default_rng([look, LAMP])
    ambient = rng.uniform(*AMBIENT)
    tilt, turn = LAMP_TILT * np.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * np.pi)
    toward = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    facing = np.clip(rendering.normals[seen] @ toward, 0.0, 1.0)
    facing = np.where(_shaded(renderer, scene, points, toward), 0.0, facing)
    out = np.full((*rendering.ids.shape, 3), 20.0, dtype=np.float32)
    out[seen] = 255.0 * colour * (ambient + (1.0 - ambient) * facing)[:, None]
    return out


def _own_colour(rng: np.random.Generator) -> Array:
    """(3,) shares of white: from grey to strong, from dark to bright."""
    return np.array(colorsys.hsv_to_rgb(rng.uniform(), 0.8 * rng.uniform() ** 1.5, rng.uniform(0.15, 0.95)))


def _patches(points: Array, colour: Array, size: float, strength: float, rng: np.random.Generator) -> Array:
    """(n, 3) colour of points (n, 3), mesh frame: patches with clear borders, about so large, and smooth clouds."""
    total = np.zeros((len(points), 2))
    for column, wave in enumerate((size, 4.0 * size)):
        along = poses.random_unit_vectors(5, rng) * (2.0 * np.pi / wave) * rng.uniform(0.6, 1.4, (5, 1))
        total[:, column] = np.sin(points @ along.T + rng.uniform(0.0, 2.0 * np.pi, 5)).sum(axis=1) / np.sqrt(2.5)
    other = strength * rng.normal(size=3)
    inked = (total[:, 0] > 0.4) & (total[:, 1] > -0.3)
    return np.clip(colour * (1.0 + 0.3 * strength * total[:, 1:]) + np.where(inked[:, None], other, 0.0), 0.02, 1.0)


def _shaded(renderer: Renderer, scene: dict[str, Array], points: Array, toward: Array) -> NDArray[np.bool_]:
    """(n,) which points (n, 3) something hides from a lamp in this direction (3,)."""
    if "object" not in scene:
        return np.zeros(len(points), dtype=bool)
    vertices = renderer.vertices("object", scene["object"])
    middle = vertices.mean(axis=0)
    reach = 3.0 * float(np.linalg.norm(vertices - middle, axis=1).max())
    right = np.cross([0.0, 1.0, 0.0], -toward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-toward, right), -toward])
    lamp_from_camera = poses.make_pose(rotation, np.zeros(3))
    lamp_from_camera[:3, 3] = np.array([0.0, 0.0, LAMP_AWAY]) - rotation @ middle
    focal = 0.5 * LAMP_PIXELS * LAMP_AWAY / reach
    centre = 0.5 * (LAMP_PIXELS - 1)
    lamp = Camera(focal, focal, centre, centre, LAMP_PIXELS, LAMP_PIXELS)
    lit = renderer.render(lamp, {name: lamp_from_camera @ pose for name, pose in scene.items()}).depth
    uv, z = lamp.project(poses.apply(lamp_from_camera, points))
    at = np.rint(np.nan_to_num(uv, nan=-1.0)).astype(np.int64)
    inside = (z > 0) & (at >= 0).all(axis=1) & (at < LAMP_PIXELS).all(axis=1)
    at = np.where(inside[:, None], at, 0)
    nearest = lit[at[:, 1], at[:, 0]]
    return np.asarray(inside & (nearest > 0) & (z > nearest + SHADE_SLACK))


def _bent(image: NDArray[np.float32], camera: Camera, cubic: float) -> NDArray[np.float32]:
    """An image (h, w, 3) through a lens whose tangents are off by `cubic` times their cube."""
    import cv2

    rays = camera.rays()[..., :2]
    off = rays * (cubic * np.einsum("ijk,ijk->ij", rays, rays))[..., None]
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    maps = (u + camera.fx * off[..., 0]).astype(np.float32), (v + camera.fy * off[..., 1]).astype(np.float32)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
