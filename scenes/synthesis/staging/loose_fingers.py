"""Unknown occluders: a few finger-like capsules before an object, of which the estimator knows nothing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer, Rendering
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import shapes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LooseFingerSettings:
    """How fingers are laid over an object. Values by judgement; a person's finger is 8 mm in radius."""

    # How many fingers.
    fewest: int = 3
    most: int = 5
    # Radii that are tried (m): from a thin robot finger to one in a glove. When the thickest at the surface hide too
    # little, they come nearer to the camera, at most to this share of the object's distance.
    thinnest: float = 0.005
    thickest: float = 0.016
    nearest: float = 0.55
    # Fingers lie across the silhouette's long axis, give or take (rad, standard deviation).
    spread: float = float(np.deg2rad(15.0))
    # Clearance between finger and surface (m).
    clearance: float = 0.002
    # Hidden share: accepted error (no unit), and halvings of the finger size to get there.
    accepted: float = 0.01
    halvings: int = 18


def capsule_mesh(start: Array, end: Array, radius: float) -> shapes.Mesh:
    """A closed capsule between two points (3,): vertices (n, 3) metres and faces (m, 3)."""
    length = float(np.linalg.norm(end - start))
    angle = np.linspace(-np.pi / 2, 0.0, 7)
    low = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    low[0, 0] = 0.0
    high = low[::-1] * [1.0, -1.0] + [0.0, length]
    vertices, faces = shapes.revolve(np.concatenate([low, high]), segments=20)
    forward = (end - start) / length
    across = np.cross(np.eye(3)[np.argmin(np.abs(forward))], forward)
    across /= np.linalg.norm(across)
    return vertices @ np.stack([across, np.cross(forward, across), forward]) + start, faces


def lay_fingers(
    renderer: Renderer,
    name: str,
    camera_from_object: Array,
    wanted: float,
    camera: Camera,
    rng: np.random.Generator,
    settings: LooseFingerSettings | None = None,
) -> dict[str, Array]:
    """Add fingers to the renderer until they hide `wanted` of the named object's own pixels.

    Meshes "finger0" ... are given in the camera frame. Returns their poses (identity), to render them with. Raises
    InputError when the share cannot be reached.
    """
    settings = settings or LooseFingerSettings()
    if wanted <= 0:
        return {}
    count = int(rng.integers(settings.fewest, settings.most + 1))
    alone = renderer.render(camera, {name: camera_from_object})
    layout = _layout(alone.mask(name), count, rng, settings)
    scene: dict[str, Array] = {name: camera_from_object, **{f"finger{i}": np.eye(4) for i in range(count)}}

    def hidden(size: float) -> float:
        for i in range(count):
            mesh = _finger(alone.depth, layout[i], size, camera, settings)
            renderer.add(f"finger{i}", *mesh)
        return 1.0 - renderer.visible_fraction(camera, scene, name)

    low, high = 0.0, 2.0
    least, most = hidden(low), hidden(high)
    if not least <= wanted + settings.accepted or not most >= wanted - settings.accepted:
        raise InputError(
            f"occlusion: expected a share that {count} fingers can hide, {least:.2f} to {most:.2f}, got {wanted:.2f}"
        )
    for _ in range(settings.halvings):
        size = (low + high) / 2
        share = hidden(size)
        if abs(share - wanted) <= settings.accepted:
            break
        low, high = (size, high) if share < wanted else (low, size)
    return {key: pose for key, pose in scene.items() if key != name}


def _layout(mask: NDArray[np.bool_], count: int, rng: np.random.Generator, settings: LooseFingerSettings) -> Array:
    """(count, 3, 2) pixels of fingers side by side across a silhouette: deepest tip, root, and where they enter it."""
    v, u = np.nonzero(mask)
    pixels = np.stack([u, v], axis=1).astype(np.float64)
    if len(pixels) < 30:
        raise InputError(f"occlusion: expected an object of at least 30 pixels, got {len(pixels)}")
    middle = pixels.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((pixels - middle).T))
    along, across = axes[:, 1], axes[:, 0] * rng.choice([-1.0, 1.0])
    reach = (pixels - middle) @ along
    width = (pixels - middle) @ across
    low, high = np.percentile(reach, [2, 98])
    slots = low + (np.arange(count) + rng.uniform(0.3, 0.7, count)) * (high - low) / count
    ends = []
    for slot in slots:
        angle = settings.spread * rng.normal()
        direction = np.cos(angle) * across + np.sin(angle) * along
        near = np.abs(reach - slot) < (high - low) / (2 * count)
        left, right = (width[near].min(), width[near].max()) if near.any() else (width.min(), width.max())
        centre = middle + slot * along
        tip = centre + (right - rng.uniform(0.0, 0.2) * (right - left)) * direction
        # The root is well outside: the finger comes from somewhere
        root = centre + (left - rng.uniform(0.6, 1.0) * (right - left) - 40.0) * direction
        ends.append([tip, root, centre + left * direction])
    return np.array(ends)


def _finger(
    depth: NDArray[np.float32], ends: Array, size: float, camera: Camera, settings: LooseFingerSettings
) -> shapes.Mesh:
    """A capsule in the camera frame before the nearest surface under it; size 0 to 1 pushes and thickens it, 1 to 2
    lifts it.
    """
    radius = settings.thinnest + min(size, 1.0) * (settings.thickest - settings.thinnest)
    deepest, root, entry = ends
    tip = entry + min(1.0, 0.25 + size) * (deepest - entry)
    line = np.rint(tip + np.linspace(0.0, 1.0, 60)[:, None] * (root - tip)).astype(int)
    # Half the width of the strip under the finger in pixels, at the object's depth
    seen = depth[depth > 0]
    half = int(np.ceil(camera.fx * radius / max(float(seen.min()), 0.05)))
    nearest = float(seen.max())
    for u, v in line:
        window = depth[max(v - half, 0) : max(v + half + 1, 0), max(u - half, 0) : max(u + half + 1, 0)]
        positive = window[window > 0]
        if len(positive):
            nearest = min(nearest, float(positive.min()))
    z = nearest - settings.clearance - radius
    z *= 1.0 - max(size - 1.0, 0.0) * (1.0 - settings.nearest)
    centre = np.array([camera.cx, camera.cy])
    focal = np.array([camera.fx, camera.fy])
    first, last = (np.append((end - centre) / focal * z, z) for end in (tip, root))
    return capsule_mesh(first, last, radius)


@lru_cache(maxsize=8)
def object_renderer(model: ObjectModel) -> Renderer:
    """Of the mesh "object" alone, made once for all frames of an object; not to be added to."""
    return Renderer({"object": (model.vertices, model.faces)})


def random_contacts(model: ObjectModel, count: int, rng: np.random.Generator) -> Contacts:
    """Exact contacts (count of them) where random rays from outside first meet the object; object frame, metres."""
    renderer = object_renderer(model)
    lens = Camera(64.0, 64.0, 31.5, 31.5, 64, 64)
    points: list[Array] = []
    normals: list[Array] = []
    while len(points) < count:
        view = _random_view(model, rng)
        seen: Rendering = renderer.render(lens, {"object": view})
        v, u = np.nonzero(seen.ids >= 0)
        if not len(v):
            continue
        pick = int(rng.integers(len(v)))
        pixel = np.zeros(seen.depth.shape, dtype=bool)
        pixel[v[pick], u[pick]] = True
        object_from_camera = poses.inverse(view)
        points.append(poses.apply(object_from_camera, lens.back_project(seen.depth, pixel))[0])
        normals.append(object_from_camera[:3, :3] @ seen.normals[v[pick], u[pick]])
    return Contacts(np.reshape(points, (-1, 3)), np.reshape(normals, (-1, 3)))


def _random_view(model: ObjectModel, rng: np.random.Generator) -> Array:
    from scenes.synthesis.staging.views import look_at

    return look_at(poses.random_unit_vectors(1, rng)[0], model.centroid, 2.5 * model.radius)
