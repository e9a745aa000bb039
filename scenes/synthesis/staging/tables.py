"""Tables and walls: objects at rest on them, and hands above them. Camera frame, metres; a table's frame has z up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.synthesis.staging.views import ViewSettings

Array = NDArray[np.float64]

# Vertices this near to the plane on which an object stands carry it (m): what a soft table cloth gives way.
SUPPORT = 3e-4
# The centre of mass stays this far inside the support, or the object would rock (m).
STEADY = 5e-4


@dataclass(frozen=True)
class TableSettings:
    """How tables are seen. By judgement."""

    # Elevation of the camera above the table (rad): as the tables of recorded data sets are seen.
    elevation: tuple[float, float] = (float(np.deg2rad(30.0)), float(np.deg2rad(60.0)))
    # The camera's roll, standard deviation (rad): mounted by hand.
    roll: float = float(np.deg2rad(3.0))
    # Half of the table's width and depth (m), and how far the wall is behind the object (m, horizontally).
    half: tuple[float, float] = (0.8, 0.5)
    wall: tuple[float, float] = (0.4, 1.2)
    # Between table and the lowest point of hand and object (m).
    above: tuple[float, float] = (0.01, 0.15)


def resting_rotation(model: ObjectModel, rng: np.random.Generator) -> Array:
    """(3, 3) table_from_object of a stable rest: the centre of mass above the inside of a face of the hull.

    Faces are drawn in proportion to their area; the object is then turned about the vertical at random.
    """
    from scipy.spatial import ConvexHull

    hull = ConvexHull(model.vertices)
    outward = hull.equations[:, :3]
    corners = model.vertices[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    points = model.vertices[hull.vertices]
    order = rng.choice(len(area), len(area), replace=False, p=np.maximum(area, 1e-300) / np.maximum(area, 1e-300).sum())
    # the lowest centre of mass is always a rest: what is left where chance meets none
    lowest = int(np.argmin(-hull.equations[:, 3] - outward @ model.centroid))
    for face in (*order, lowest):
        rotation = _down(outward[face])
        if _is_steady(points @ rotation.T, rotation @ model.centroid):
            break
    return np.asarray(poses.exp_rotation([0.0, 0.0, rng.uniform(0, 2 * np.pi)]) @ rotation)


def _down(normal: Array) -> Array:
    """A rotation (3, 3) that turns a unit vector to -z."""
    z = -normal
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _is_steady(points: Array, centre: Array) -> bool:
    """Whether the centre of mass is above the inside of the polygon of the lowest points."""
    from scipy.spatial import ConvexHull, QhullError

    flat = points[points[:, 2] < points[:, 2].min() + SUPPORT, :2]
    if len(flat) < 3:
        return False
    try:
        sides = ConvexHull(flat).equations  # n x + d <= 0 inside
    except QhullError:  # a line
        return False
    return bool((sides[:, :2] @ centre[:2] + sides[:, 2] < -STEADY).all())


def at_rest(model: ObjectModel, rng: np.random.Generator) -> Array:
    """table_from_object (4, 4): at rest, its centroid above the table's origin."""
    rotation = resting_rotation(model, rng)
    lowest = float((model.vertices @ rotation[2]).min())
    middle = rotation @ model.centroid
    return poses.make_pose(rotation, [-middle[0], -middle[1], -lowest])


def camera_above(
    target: Array, radius: float, camera: Camera, rng: np.random.Generator, views: ViewSettings, settings: TableSettings
) -> Array:
    """camera_from_table (4, 4) of an upright camera that sees a ball of `radius` (m) about `target` (3,) whole."""
    elevation, turn = rng.uniform(*settings.elevation), rng.uniform(0, 2 * np.pi)
    distance = rng.uniform(views.nearest, views.farthest)
    forward = -np.array([np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation)])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)  # the elevation is below 90 degrees
    rotation = poses.exp_rotation([0.0, 0.0, settings.roll * rng.normal()])
    rotation = rotation @ np.stack([right, np.cross(forward, right), forward])
    half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
    middle = np.array([(camera.width - 1) / 2 - camera.cx, (camera.height - 1) / 2 - camera.cy])
    room = np.maximum(half - radius / distance, 0.0)
    tangent = middle / [camera.fx, camera.fy] + views.off_centre * rng.uniform(-1.0, 1.0, 2) * room
    return poses.make_pose(rotation, distance * np.append(tangent, 1.0) - rotation @ target)


def add_table(
    renderer: Renderer, camera_from_table: Array, rng: np.random.Generator, settings: TableSettings
) -> dict[str, Array]:
    """Add the table (mesh "background"), its long side along the image, its middle near its frame's origin; returns its
    camera_from_mesh, the mesh's z being the table's.
    """
    away = _horizontal(camera_from_table)
    turn = np.stack([np.cross(away, [0.0, 0.0, 1.0]), away, [0.0, 0.0, 1.0]], axis=1)
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*settings.half, 1.0]
    corners = corners + np.append(rng.uniform(-0.3, 0.3, 2) * settings.half, 0.0)
    renderer.add("background", corners @ turn.T, [[0, 1, 2], [0, 2, 3]])
    return {"background": camera_from_table}


def add_wall(
    renderer: Renderer, camera_from_table: Array, rng: np.random.Generator, settings: TableSettings
) -> dict[str, Array]:
    """Add an upright wall (mesh "wall") behind the table's origin; returns its camera_from_mesh."""
    away = _horizontal(camera_from_table)
    turn = rng.normal(0.0, np.deg2rad(10.0))
    away = poses.exp_rotation([0.0, 0.0, turn]) @ away
    side = np.cross([0.0, 0.0, 1.0], away)
    middle = rng.uniform(*settings.wall) * away
    low, high = -0.8, 5.0  # m: below the table, above the picture
    corners = [middle + s * 10.0 * side + [0.0, 0.0, h] for s, h in ((-1, low), (1, low), (1, high), (-1, high))]
    renderer.add("wall", np.array(corners), [[0, 1, 2], [0, 2, 3]])
    return {"wall": camera_from_table}


def _horizontal(camera_from_table: Array) -> Array:
    """(3,) unit, table frame: where the camera looks, without its slope."""
    forward = camera_from_table[2, :3] * [1.0, 1.0, 0.0]
    length = float(np.linalg.norm(forward))
    return np.asarray(forward / length if length > 1e-6 else np.array([0.0, 1.0, 0.0]))


def table_below(points: Array, target: Array, rng: np.random.Generator, settings: TableSettings) -> Array:
    """camera_from_table (4, 4) of a table seen from above that passes below points (n, 3) in mid-air; its origin is
    below the target (3,).
    """
    elevation = rng.uniform(*settings.elevation)
    up = poses.exp_rotation([0.0, 0.0, settings.roll * rng.normal()]) @ [0.0, -np.cos(elevation), -np.sin(elevation)]
    right = np.cross([0.0, 0.0, 1.0], up)
    right /= np.linalg.norm(right)
    level = float((points @ up).min()) - rng.uniform(*settings.above)
    origin = target + (level - float(target @ up)) * up
    return poses.make_pose(np.stack([right, np.cross(up, right), up], axis=1), origin)
