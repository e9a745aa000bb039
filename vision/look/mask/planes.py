"""Table, wall and floor: planes that many readings lie on. Camera frame, metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from vision.look.mask.piece_kernels import count_votes, mark_planes, runs_on_behind
from vision.look.mask.settings import MaskSettings
from vision.look.pixels import median, read_pixels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def on_planes(points: Array, planes: Array, depth_model: DepthModel, settings: MaskSettings) -> Mask:
    """(...) whether points (..., 3) are on one of planes (k, 6), within what a camera makes of it, or behind the first.

    A plane: see `find_plane`.
    """
    on = np.zeros(points.shape[:-1], dtype=bool)
    if len(planes):
        flat = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
        mark_planes(flat, *for_kernels(planes, depth_model, settings), on.reshape(-1))
    return on


def for_kernels(
    planes: Array, depth_model: DepthModel, settings: MaskSettings
) -> tuple[Array, tuple[float, float, float], tuple[float, float]]:
    """Planes (k, 6), a depth camera's noise and the margins of a plane, as compiled loops take them."""
    own = depth_model.axial_floor, depth_model.axial_growth, depth_model.axial_from
    return np.ascontiguousarray(planes, np.float64), own, (settings.plane_margin, settings.plane_sigmas)


def find_planes(
    frame: Frame,
    settings: MaskSettings,
    depth_model: DepthModel,
    extent: float,
    meant: Array | None = None,
    floor_only: bool = False,
) -> Array:
    """(k, 6) table, wall and floor: planes that many readings lie on, most first, each of them larger than extent (m).

    A plane: see `find_plane`. Behind the first there is nothing; a further one may be a box's side, beside which more
    is seen. meant (3,): about where the object is, camera frame, behind none of them; None where nobody knows.
    floor_only: no more than that first one.
    """
    points, each = some_points(frame, settings)
    found, left = np.zeros((0, 6)), points
    for k in range(settings.most_planes):
        share = settings.plane_share if not k else settings.next_plane_share * len(points) / max(len(left), 1)
        plane = find_plane(left, settings, depth_model, share, each, np.inf if k else settings.plane_most_behind)
        if plane is None:
            break
        in_front = meant is not None and plane[:3] @ meant + plane[3] < -settings.plane_hides
        plane[5] = 0.0 if k or in_front else np.inf
        on = on_planes(left, plane[None], depth_model, settings)
        low, high = np.percentile(left[on], [5, 95], axis=0)
        if not in_front and float(np.linalg.norm(high - low)) <= extent:
            break
        # in front is an arm's side
        found, left = found if in_front else np.concatenate([found, plane[None]]), left[~on]
        if floor_only and len(found):
            break
    return found


def floors_of(planes: Array) -> Array:
    """(m, 6) those of planes (k, 6) behind which there is nothing."""
    return planes[np.isinf(planes[:, 5])]


def floors_under(points: Array, planes: Array, settings: MaskSettings, depth_model: DepthModel) -> Array:
    """(m, 6) those of planes (k, 6) behind which there is nothing, not even of the object, of which points (n, 3) are.

    What hangs beside a table's edge, or is sunk in what looks like a table, is behind it.
    """
    room = settings.plane_margin + settings.plane_sigmas * depth_model.independent_sigma(points[:, 2])
    floors = floors_of(planes)
    behind = [np.count_nonzero(points @ floor[:3] + floor[3] < -room) for floor in floors]
    return floors[np.array(behind, dtype=np.float64) <= settings.plane_most_behind * len(points)]


def some_points(frame: Frame, settings: MaskSettings) -> tuple[Array, float]:
    """(n, 3) points of the whole image, thinned, and the share of the image that each stands for."""
    assert frame.depth is not None
    assert frame.camera is not None
    box = (0, 0, frame.camera.width, frame.camera.height)
    read = read_pixels(frame.depth, frame.camera, box, settings.plane_points)
    return read.points, read.area / max(frame.camera.width * frame.camera.height, 1)


def find_plane(
    points: Array,
    settings: MaskSettings,
    depth_model: DepthModel,
    least_share: float | None = None,
    each: float = 1.0,
    most_behind: float = np.inf,
) -> Array | None:
    """(6,) the plane that most of the points (n, 3) lie on; None when there is no such plane, or when much is seen
    beyond it.

    A hand and what it holds are none: each, the share of the image that a point stands for, says how much of it the
    plane fills, and what scatters as far as a hand does is no camera's noise.

    Unit normal towards the camera and offset, height = n . p + o; how many times as far as is believed of the camera
    they scatter about it, 1 at least; and how far behind it (m) there is nothing else, inf. least_share: of the points;
    None for the settings'. most_behind: see `MaskSettings.plane_most_behind`.
    """
    if len(points) < 50:
        return None
    tolerance = settings.plane_margin + settings.plane_sigmas * depth_model.independent_sigma(points[:, 2])
    rng = np.random.default_rng(0)
    corners = points[rng.integers(len(points), size=(settings.plane_tries, 3))]
    normals = poses.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 1e-6] / length[length > 1e-6, None]
    offsets = -np.einsum("ni,ni->n", normals, corners[length > 1e-6][:, 0])
    if not len(normals):
        return None
    votes = np.zeros(len(normals), dtype=np.int64)
    count_votes(np.ascontiguousarray(points), tolerance, normals, offsets, settings.plane_voters, votes)
    best = int(votes.argmax())
    normal, offset = normals[best], offsets[best]
    chosen = np.abs(points @ normal + offset) < tolerance
    if chosen.sum() < 50:
        return None
    for _ in range(3):
        on = points[chosen]
        middle = on.mean(axis=0)
        on -= middle
        # of many points the axes of their second moments are had in a tenth of the time of their singular vectors
        axis = np.linalg.eigh(on.T @ on)[1][:, 0]
        normal = axis * (1.0 if axis @ middle <= 0 else -1.0)
        offset = -float(normal @ middle)
        chosen = np.abs(points @ normal + offset) < tolerance
        if chosen.sum() < 50:
            return None
    height = points @ normal + offset
    beyond = float((height < -2 * tolerance).mean())
    share = float(chosen.mean())
    if share <= (settings.plane_share if least_share is None else least_share) or beyond >= 0.5 * share:
        return None
    scatter = _scatter(height, tolerance, points[:, 2], depth_model, settings)
    if chosen.sum() * each < settings.plane_image or scatter >= settings.plane_most_scatter:
        return None
    if runs_on_behind(points, tolerance, normal, offset, settings.plane_part, settings.plane_behind) >= most_behind:
        return None
    return np.concatenate([normal, [offset, scatter, np.inf]])


def _scatter(height: Array, tolerance: Array, z: Array, depth_model: DepthModel, settings: MaskSettings) -> float:
    """How many times as far as is believed readings at depths z (n,) scatter about a plane, 1 at least.

    height (n,) above it, m. Nothing stands behind a table or wall: what is read there, as far as it may be the plane
    (four times the tolerance (n,)), is noise, and its median is 0.67 standard deviations.
    """
    behind = (height < 0.0) & (height > -4.0 * tolerance)
    if not behind.any():
        return 1.0
    sigma = np.hypot(depth_model.independent_sigma(z[behind]), settings.plane_margin / settings.plane_sigmas)
    seen = float(median(-height[behind] / sigma)) / 0.6745
    return float(max(seen, 1.0))
