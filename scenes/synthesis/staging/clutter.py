"""Other things that hide an object: a second object before it, clutter on the table, the border of the image.

Camera frame, metres.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library
from scenes.synthesis.settings import SynthesisSettings
from scenes.synthesis.staging.views import draw_views

Array = NDArray[np.float64]

# Halvings of a second object's place or of a camera's aim until the hidden share is right.
HALVINGS = 16
# Second objects tried, and places tried for each thing that stands about.
TRIES = 12
# Between second object and object along the viewing direction (m).
CLEARANCE = 0.004


def second_object(
    renderer: Renderer,
    model: ObjectModel,
    camera_from_object: Array,
    wanted: float,
    camera: Camera,
    rng: np.random.Generator,
    accepted: float = 0.01,
) -> Array:
    """Slide another object of the library before this one until it hides `wanted` of its own pixels.

    Adds the mesh "clutter0" to the renderer; returns its camera_from_mesh. Raises InputError when no object reaches it.
    """
    centre = poses.apply(camera_from_object, model.centroid[None])[0]
    nearest = float(renderer.vertices("object", camera_from_object)[:, 2].min())
    best = 0.0
    for _ in range(TRIES):
        names = [name for name in library.names() if name not in (model.name, "pencil")]
        other = library.make(str(rng.choice(names)))
        rotation = poses.random_rotations(1, rng)[0]
        vertices = (other.vertices - other.centroid) @ rotation.T
        depth = nearest - CLEARANCE - float(vertices[:, 2].max())
        if depth - other.radius < 0.15:
            continue
        renderer.add("clutter0", vertices, other.faces)
        angle = rng.uniform(0, 2 * np.pi)
        aside = np.array([np.cos(angle), np.sin(angle), 0.0])
        middle = centre * (depth / centre[2])
        reach = (model.radius + other.radius) * 1.2

        def hidden(share: float, middle: Array = middle, aside: Array = aside, reach: float = reach) -> float:
            pose = poses.make_pose(None, middle + (1 - share) * reach * aside)
            scene = {"object": camera_from_object, "clutter0": pose}
            return 1.0 - renderer.visible_fraction(camera, scene, "object")

        most = hidden(1.0)
        best = max(best, most)
        if most < wanted - accepted:
            continue
        low, high, share = 0.0, 1.0, 1.0
        for _ in range(HALVINGS):
            share = (low + high) / 2
            found = hidden(share)
            if abs(found - wanted) <= accepted:
                break
            low, high = (share, high) if found < wanted else (low, share)
        if abs(hidden(share) - wanted) <= accepted:
            return poses.make_pose(None, middle + (1 - share) * reach * aside)
    raise InputError(f"occlusion: expected a share that a second object can hide, up to {best:.2f}, got {wanted:.2f}")


def beyond_border(
    renderer: Renderer,
    model: ObjectModel,
    wanted: float,
    rng: np.random.Generator,
    settings: SynthesisSettings,
    accepted: float = 0.01,
) -> Array:
    """camera_from_object (4, 4) at which the image's border cuts off `wanted` of the object's pixels.

    The share is counted on an image three times as wide and high, where nothing is cut off.
    """
    camera = settings.camera
    wide = replace(
        camera,
        cx=camera.cx + camera.width,
        cy=camera.cy + camera.height,
        width=3 * camera.width,
        height=3 * camera.height,
    )
    view = draw_views(1, camera, model.radius, rng, settings.views)[0]
    angle = rng.uniform(0, 2 * np.pi)
    aside = np.array([np.cos(angle), np.sin(angle)])
    half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
    # as far as the border in that direction, and the object's own radius beyond it
    far = float(np.min(half / np.maximum(np.abs(aside), 1e-9))) + 1.5 * model.radius / view.distance

    def cut(share: float) -> tuple[Array, float]:
        pose = replace(view, tangent=share * far * aside).camera_from_scene(model.centroid)
        inside, _ = renderer.own_pixels(camera, {"object": pose}, "object")
        whole, _ = renderer.own_pixels(wide, {"object": pose}, "object")
        return pose, 1.0 - inside / max(whole, 1)

    low, high = 0.0, 1.0
    pose, found = cut(0.0)
    for _ in range(HALVINGS):
        if abs(found - wanted) <= accepted:
            return pose
        middle = (low + high) / 2
        pose, found = cut(middle)
        low, high = (middle, high) if found < wanted else (low, middle)
    if abs(found - wanted) > 3 * accepted:
        raise InputError(f"occlusion: expected a share that the border can cut off, got {wanted:.2f}")
    return pose


def stand_about(
    renderer: Renderer,
    scene: dict[str, Array],
    camera: Camera,
    rng: np.random.Generator,
    settings: SynthesisSettings,
    first: int = 1,
) -> dict[str, Array]:
    """Objects of the library on the table (the mesh "background" of the scene) or hanging about where there is none.

    They may come near to the object in the image and in depth but hide at most `settings.clutter_hides` of it. Adds the
    meshes "clutter1" ...; returns their camera_from_mesh.
    """
    count = int(rng.integers(settings.clutter[0], settings.clutter[1] + 1))
    placed: dict[str, Array] = {}
    before = renderer.visible_fraction(camera, scene, "object")
    target = poses.apply(scene["object"], renderer.vertices("object", np.eye(4)).mean(axis=0)[None])[0]
    for number in range(first, first + count):
        name = f"clutter{number}"
        other = library.make(str(rng.choice(library.names())))
        vertices = other.vertices - other.centroid
        renderer.add(name, vertices, other.faces)
        for _ in range(TRIES):
            pose = _on_table(scene, vertices, target, rng)
            if pose[2, 3] < 0.25 or _enters(renderer, {**scene, **placed}, name, pose):
                continue
            with_it = {**scene, **placed, name: pose}
            if before - renderer.visible_fraction(camera, with_it, "object") <= settings.clutter_hides:
                placed[name] = pose
                break
    return placed


def _on_table(scene: dict[str, Array], vertices: Array, target: Array, rng: np.random.Generator) -> Array:
    """A random stand on the table near where the target is seen before it."""
    table = scene.get("background")
    turn = poses.random_rotations(1, rng)[0]
    if table is None:
        return poses.make_pose(turn, target + rng.normal(0.0, 0.15, 3) + [0, 0, 0.1])
    normal, place = table[:3, 2], table[:3, 3]
    behind = target * (float(place @ normal) / float(target @ normal))
    spot = behind + table[:3, :2] @ rng.normal(0.0, 0.22, 2)
    lift = -float((vertices @ turn.T @ normal).min())
    return poses.make_pose(turn, spot + (lift + 1e-4) * normal)


def _enters(renderer: Renderer, scene: dict[str, Array], name: str, pose: Array) -> bool:
    """Whether the boxes of this and of another thing, camera axes, overlap."""
    own = renderer.vertices(name, pose)
    low, high = own.min(axis=0), own.max(axis=0)
    for other, place in scene.items():
        if other == "background":
            continue
        points = renderer.vertices(other, place)
        if (points.min(axis=0) < high).all() and (points.max(axis=0) > low).all():
            return True
    return False
