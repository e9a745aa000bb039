"""The picture of a synthetic scene: background, clutter, depth with its errors, colour, mask. Camera frame, metres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer, shade
from scenes.geometry.objects import ObjectModel
from scenes.synthesis.noise import presets as noise_models
from scenes.synthesis.noise.colour_camera import colour_image
from scenes.synthesis.noise.presets import DepthErrors, DepthNoise, LastingErrors, NoisePreset
from scenes.synthesis.optics.units import CameraUnit
from scenes.synthesis.settings import SynthesisSettings

Array = NDArray[np.float64]

COLOURS = {"object": (206, 116, 58), "hand": (222, 186, 164), "background": (138, 142, 146)}
FINGER_COLOUR = (196, 160, 140)
# Depths that differ by more (m) are of two things; share of the pixels between them that give no reading. By judgement.
SMEAR_STEP, SMEAR_LOST = 0.015, 0.4
CLUTTER_COLOURS = ((96, 132, 168), (150, 120, 168), (104, 150, 110), (190, 170, 96), (168, 104, 110), (120, 120, 120))


def photograph(
    scene: dict[str, Array],
    renderer: Renderer,
    preset: NoisePreset,
    rng: np.random.Generator,
    settings: SynthesisSettings,
    errors: LastingErrors | None = None,
) -> dict[str, Any]:
    """depth, and rgb and mask when asked for, of a scene of camera_from_mesh poses.

    A camera imitated from its optics delivers its infra-red image as rgb, grey, unless settings.infrared is off or a
    colour camera of the preset's is beside it. errors: those that last.
    """
    infrared, optical = None, not isinstance(preset.depth, DepthNoise)
    coloured = settings.rgb and preset.colour is None and not (optical and settings.infrared)
    # a camera imitated from its optics casts rays of its own
    rendering = renderer.render(settings.camera, scene) if not optical or settings.mask or coloured else None
    if isinstance(preset.depth, DepthNoise):
        assert rendering is not None
        lasting = errors.depth if errors is not None and isinstance(errors.depth, DepthErrors) else None
        depth = noise_models.observe_depth(rendering, settings.camera, preset, rng, lasting)
    else:
        from scenes.synthesis.optics import take

        unit = errors.depth if errors is not None and isinstance(errors.depth, CameraUnit) else None
        shot = take(renderer, scene, settings.camera, preset.depth, rng, unit)
        depth, infrared = shot.depth, shot.infrared
    depth = np.where(depth < settings.depth_unit * np.iinfo(np.uint16).max, depth, 0.0)  # what 16 bits can hold
    image: dict[str, Any] = {"depth": (np.rint(depth / settings.depth_unit) * settings.depth_unit).astype(np.float32)}
    if settings.mask and rendering is not None:
        image["mask"] = rendering.mask("object")
    if settings.rgb and preset.colour is not None:
        lasting_colour = None if errors is None else errors.colour
        image["rgb"] = colour_image(renderer, scene, settings.camera, preset.colour, rng, lasting_colour)
    elif settings.rgb and settings.infrared and infrared is not None:
        image["rgb"] = np.repeat(infrared[..., None], 3, axis=2)
    elif rendering is not None and settings.rgb:
        image["rgb"] = shade(rendering, {name: _colour(name) for name in scene})
    return image


def smeared(first: dict[str, Any], last: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """One exposure from images (see `photograph`) at its beginning and its end.

    Colours average. Where depth changes by less than a step between things, it averages, too; across an edge that has
    moved, a camera reads one of the two, or nothing. The mask is that of the beginning and the end.
    """
    a, b = first["depth"].astype(np.float64), last["depth"].astype(np.float64)
    both = (a > 0) & (b > 0)
    edge = both & (np.abs(a - b) > SMEAR_STEP)
    draw = rng.uniform(size=a.shape)
    depth = np.where(both, 0.5 * (a + b), 0.0)
    depth = np.where(edge, np.where(draw < SMEAR_LOST, 0.0, np.where(draw < 0.5 + 0.5 * SMEAR_LOST, a, b)), depth)
    out: dict[str, Any] = {"depth": depth.astype(np.float32)}
    if "mask" in first:
        out["mask"] = first["mask"] & last["mask"]
    if "rgb" in first:
        mean = 0.5 * (first["rgb"].astype(np.float64) + last["rgb"].astype(np.float64))
        out["rgb"] = np.rint(mean).astype(np.uint8)
    return out


def _colour(name: str) -> tuple[int, int, int]:
    if name.startswith("clutter"):
        return CLUTTER_COLOURS[int(name.removeprefix("clutter")) % len(CLUTTER_COLOURS)]
    return COLOURS.get(name, FINGER_COLOUR)


def add_background(
    model: ObjectModel,
    scene: dict[str, Array],
    renderer: Renderer,
    rng: np.random.Generator,
    settings: SynthesisSettings,
    others: tuple[Array, ...] = (),
) -> Array:
    """Add a wide wall behind object and hand; returns its camera_from_mesh.

    others: points (n, 3), camera frame, that must be before it too (where things will move).
    """
    centre = poses.apply(scene["object"], model.centroid[None])[0]
    turn = rng.uniform(0.0, 2 * np.pi)
    tilt = settings.background_tilt * np.sqrt(rng.uniform())
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    # Far enough for nothing to stick into it
    behind = min(float((renderer.vertices(name, pose) @ normal).min()) for name, pose in scene.items())
    behind = min([behind, *(float((points @ normal).min()) for points in others)])
    gap = rng.uniform(*settings.background_distance)
    level = min(float(centre @ normal) - gap * float(np.cos(tilt)), behind - 0.01)
    place = centre * (level / float(centre @ normal))
    right = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    right /= np.linalg.norm(right)
    size = 30.0  # m: fills the image at any tilt allowed
    corners = size * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    renderer.add("background", corners, [[0, 1, 2], [0, 2, 3]])
    return poses.make_pose(np.stack([right, np.cross(normal, right), normal], axis=1), place)
