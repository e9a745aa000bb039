"""The ICP baseline: what a careful user of Open3D does, and the opponent in every table.

Point-to-plane ICP (Chen and Medioni 1992; Rusinkiewicz and Levoy 2001), coarse to fine, with a robust kernel once the
pose is near. Observed points look for partners on the model, never the model's on the observation: the hidden side of
the object has none. Points are in the camera frame, the model in its own, poses are camera_from_object, metres.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes._open3d import open3d
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CloudIcpSettings:
    """Tuned on half-hidden YCB objects from starts 20 degrees and 15 mm off (see the benchmark page)."""

    distances: tuple[float, ...] = (0.030, 0.010, 0.004)
    """Largest distance of a pair at each level, m: the first covers the start's error, the last a depth camera's."""

    iterations: tuple[int, ...] = (40, 40, 40)
    """Most iterations of each level (Open3D does not tell how many it used)."""

    kernel: str = "tukey"
    """Robust kernel of all levels but the first: "tukey", "huber" or "none"."""

    kernel_share: float = 0.5
    """Scale of the kernel as a share of the level's distance."""

    tolerance: float = 1e-6
    """A level ends when fitness and RMSE change by less than this share."""

    model_points: tuple[int, ...] = (4_000, 8_000, 20_000)
    """Samples on the model at each level: 4 mm apart on a hand tool, then 3, then under 2; always below the level's
    distance. Open3D builds a search tree over them at every call, which is most of the time."""

    most_points: int = 2_000
    """Observed points used, picked evenly; more cost time and change the answer by less than their noise."""

    fewest_points: int = 6
    """A pose has six unknowns; with fewer points the start is returned."""

    smallest_eigenvalue: float = 1e-3
    """Below this share of the mean eigenvalue the scaled 6x6 Hessian tells a direction that nothing holds."""

    def __post_init__(self) -> None:
        """Refuse levels that do not fit together."""
        levels = {len(self.distances), len(self.iterations), len(self.model_points)}
        if len(levels) != 1 or not self.distances:
            raise InputError(
                "icp settings: expected as many iterations and model_points as distances,"
                f" got {len(self.distances)}, {len(self.iterations)} and {len(self.model_points)}"
            )


@dataclass(frozen=True)
class IcpResult:
    """What ICP found.

    pose (4, 4) camera_from_object; fitness: share of the points that found a partner at the last level; rmse of those
    pairs, m; ms: wall time, without the model's samples (drawn once); degenerate: the pairs
    leave some motion free, so the pose along it is the start's; points: rows used; dropped: rows that were not finite.
    """

    pose: Array
    fitness: float
    rmse: float
    ms: float
    degenerate: bool
    points: int
    dropped: int = 0


def icp(points: ArrayLike, model: ObjectModel, start: ArrayLike, settings: CloudIcpSettings | None = None) -> IcpResult:
    """Refine `start` so that the observed points lie on the model.

    points (n, 3): camera frame, metres; rows that are not finite are dropped and counted. start (4, 4)
    camera_from_object. With fewer than six usable points, or no pair within reach, the start comes back with fitness
    0 and `degenerate` set: an opponent that has nothing to go on is not an error. Raises InputError for wrong shapes
    or a start that is not a rigid transform.
    """
    settings = settings or CloudIcpSettings()
    start = poses.check_pose(start, "icp start")
    rows = np.asarray(points, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"icp: expected points of shape (n, 3), got {rows.shape}")
    finite = np.isfinite(rows).all(axis=1)
    dropped = int((~finite).sum())
    observed = _evenly(rows[finite], settings.most_points)
    targets = [_target(model, count) for count in settings.model_points]
    began = time.perf_counter()

    def answer(pose: Array, fitness: float, rmse: float, degenerate: bool) -> IcpResult:
        ms = 1e3 * (time.perf_counter() - began)
        return IcpResult(pose, fitness, rmse, ms, degenerate, len(observed), dropped)

    if len(observed) < settings.fewest_points:
        return answer(start, 0.0, float("nan"), True)
    with _one_thread():
        object_from_camera, fitness, rmse, partner = _coarse_to_fine(observed, targets, poses.inverse(start), settings)
    if not np.isfinite(object_from_camera).all() or not len(partner):
        return answer(start, 0.0, float("nan"), True)
    matched, normals = np.asarray(targets[-1].points)[partner], np.asarray(targets[-1].normals)[partner]
    degenerate = is_degenerate(matched, normals, model.radius, settings.smallest_eigenvalue)
    return answer(poses.check_pose(poses.inverse(object_from_camera), "icp result"), fitness, rmse, degenerate)


def point_to_plane_hessian(points: Array, normals: Array, radius: float) -> Array:
    """(6, 6) Gauss-Newton Hessian per pair of point-to-plane distances, rotation (about the points' mean) then
    translation; lengths in units of `radius`, so that both halves weigh alike and eigenvalues have no unit.
    """
    centred = (points - points.mean(axis=0)) / radius
    jacobian = np.concatenate([np.cross(centred, normals), normals], axis=1)
    return jacobian.T @ jacobian / len(points)


def is_degenerate(points: Array, normals: Array, radius: float, smallest: float) -> bool:
    """True when the planes at `points` (n, 3) with `normals` (n, 3) leave some rigid motion free: a plane lets three
    go, a cylinder two, a ball three. Fitness and RMSE are perfect then; only the Hessian tells
    (Gelfand et al., Geometrically stable sampling for the ICP algorithm, 3DIM 2003).
    """
    if len(points) < 6:
        return True
    values = np.linalg.eigvalsh(point_to_plane_hessian(points, normals, radius))
    return bool(not np.isfinite(values).all() or values[0] < smallest * values.mean())


@contextmanager
def _one_thread() -> Iterator[None]:
    """Open3D adds the pairs up in whatever order its threads finish, so two runs differ in the last bits and now and
    then in the answer. On one thread they agree, for about 3 ms of 12.
    """
    utility = open3d().utility
    before = utility.get_max_threads()
    utility.set_max_threads(1)
    try:
        yield
    finally:
        utility.set_max_threads(before)


def _coarse_to_fine(
    observed: Array, targets: list[Any], object_from_camera: Array, settings: CloudIcpSettings
) -> tuple[Array, float, float, NDArray[np.int64]]:
    """All levels: object_from_camera, fitness, rmse and the last level's partners (rows of the last target)."""
    o3d = open3d()
    registration = o3d.pipelines.registration
    source = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(observed))
    fitness, rmse, partner = 0.0, float("nan"), np.zeros(0, dtype=np.int64)
    levels = zip(settings.distances, settings.iterations, targets)
    for level, (distance, most, target) in enumerate(levels):
        criteria = registration.ICPConvergenceCriteria(settings.tolerance, settings.tolerance, most)
        estimation = registration.TransformationEstimationPointToPlane(_kernel(settings, level, distance))
        result = registration.registration_icp(source, target, distance, object_from_camera, estimation, criteria)
        partner = np.asarray(result.correspondence_set, dtype=np.int64).reshape(-1, 2)[:, 1]
        if not len(partner):
            return object_from_camera, 0.0, float("nan"), partner
        object_from_camera = np.array(result.transformation)
        fitness, rmse = float(result.fitness), float(result.inlier_rmse)
    return object_from_camera, fitness, rmse, partner


def _kernel(settings: CloudIcpSettings, level: int, distance: float) -> Any:
    registration = open3d().pipelines.registration
    scale = settings.kernel_share * distance
    kernels = {
        "none": registration.L2Loss,
        "tukey": lambda: registration.TukeyLoss(scale),
        "huber": lambda: registration.HuberLoss(scale),
    }
    if settings.kernel not in kernels:
        raise InputError(f"icp: expected a kernel of {', '.join(kernels)}, got {settings.kernel!r}")
    # far from the answer the outliers of the kernel are the very pairs that pull it there
    return kernels["none" if level == 0 else settings.kernel]()


_TARGETS: WeakKeyDictionary[ObjectModel, dict[int, Any]] = WeakKeyDictionary()


def _target(model: ObjectModel, count: int) -> Any:
    """The model's samples with normals as an Open3D cloud: drawn at the first use, kept while the model lives."""
    kept = _TARGETS.setdefault(model, {})
    if count not in kept:
        o3d = open3d()
        points, normals = model.sample_surface(count, seed=0)
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        cloud.normals = o3d.utility.Vector3dVector(normals)
        kept[count] = cloud
    return kept[count]


def _evenly(points: Array, most: int) -> Array:
    """At most `most` rows, at even steps: pixels come in scan order, so this keeps the whole picture."""
    if len(points) <= most:
        return np.ascontiguousarray(points)
    return np.ascontiguousarray(points[np.linspace(0, len(points) - 1, most).astype(np.int64)])
