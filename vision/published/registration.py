"""Registration as others do it, to compare with: global (no start) and local (from a coarse start).

Every function takes the same segmented points (n, 3), camera frame, metres, and returns a pose (4, 4)
camera_from_object; fewer than `fewest` finite points, or a method that finds nothing, gives back the start, or the
points' middle when there is none. Observed points look for partners on the model, never the other way.

    fpfh_ransac   Rusu, Blodow and Beetz, Fast Point Feature Histograms (ICRA 2009), RANSAC, then ICP; by Open3D
    fgr           Zhou, Park and Koltun, Fast Global Registration (ECCV 2016) on the same features, then ICP; by Open3D
    ppf           Drost et al., Model Globally, Match Locally (CVPR 2010), its own ICP; by OpenCV
    small_gicp    Koide, small_gicp (JOSS 2024): generalised ICP from a start; an optional package
    icp           point-to-plane ICP from a start (vision.published.icp)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes._open3d import open3d
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from vision.published.icp import CloudIcpSettings, icp

Array = NDArray[np.float64]

GLOBAL = ("fpfh_ransac", "fgr", "ppf")
LOCAL = ("icp", "small_gicp")


@dataclass(frozen=True)
class BaselineSettings:
    """The methods' usual choices, in shares of the object's size, with weights that forgive outliers; then tuned on
    48 generated captures other than the benchmark's: voxels of 3 or 5 %, four times the RANSAC iterations, mutual
    filtering (no better), twice the inlier distance or wider features for FGR (the same), three schedules of distances
    for small_gicp (the widest is best: 88, 85 and 75 % within 5 mm).
    """

    # Voxel of features as a share of the object's diameter, and its limits (m).
    voxel_share: float = 0.03
    voxel_limits: tuple[float, float] = (0.003, 0.006)
    # Radii of normals and features, in voxels.
    normal_radius: float = 3.0
    feature_radius: float = 6.0
    # RANSAC: iterations at most, confidence, points a sample, likeness of edges, distance of an inlier in voxels.
    ransac_iterations: int = 50_000
    ransac_confidence: float = 0.999
    ransac_points: int = 3
    ransac_edges: float = 0.85
    inlier: float = 1.5
    # Only features that are each other's nearest; with few points too few remain.
    mutual: bool = False
    # Fast global registration: distance of an inlier in voxels, iterations.
    fgr_inlier: float = 1.0
    fgr_iterations: int = 64
    # Point pair features: sampling step of the model and bin of the distance, as shares of the object's diameter; every
    # how manyeth scene point is a reference; poses refined, by that method's own ICP, of which the best is kept.
    ppf_step: float = 0.05
    ppf_distance: float = 0.05
    ppf_reference: float = 1.0 / 5.0
    ppf_refined: int = 5
    ppf_iterations: int = 60
    # small_gicp: downsampling (m), and largest distance of a pair (m), pass after pass.
    gicp_voxel: float = 0.003
    gicp_distances: tuple[float, ...] = (0.050, 0.020, 0.008)
    # Model samples of features.
    model_points: int = 20_000
    # Below this many points nothing is tried.
    fewest: int = 10
    # After a global method: the levels of ICP that a start which may be right needs.
    icp: CloudIcpSettings = field(default_factory=lambda: CloudIcpSettings((0.015, 0.006, 0.004)))


def available() -> tuple[str, ...]:
    """Names of the methods that this installation can run."""
    return tuple(name for name in (*GLOBAL, *LOCAL) if name != "small_gicp" or find_spec("small_gicp") is not None)


def register(
    method: str,
    points: ArrayLike,
    model: ObjectModel,
    start: ArrayLike | None = None,
    seed: int = 0,
    settings: BaselineSettings | None = None,
) -> Array:
    """The pose (4, 4) camera_from_object that `method` finds; global methods ignore the start, local ones need it.

    Raises InputError for an unknown method, one that is not installed, or a local one without a start.
    """
    settings = settings or BaselineSettings()
    if method not in available():
        raise InputError(f"baseline: expected one of {', '.join(available())}, got {method!r}")
    rows = np.asarray(points, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"baseline: expected points of shape (n, 3), got {rows.shape}")
    rows = np.ascontiguousarray(rows[np.isfinite(rows).all(axis=1)])
    if method in LOCAL:
        if start is None:
            raise InputError(f"baseline: expected a start for {method!r}, got none")
        begin = poses.check_pose(start, "baseline start")
        if method == "icp":
            return icp(rows, model, begin).pose
        return _small_gicp(rows, model, begin, settings) if len(rows) >= settings.fewest else begin
    if len(rows) < settings.fewest:
        return middle_start(rows, model)
    if method == "ppf":
        return _ppf(rows, model, settings)
    return _by_features(method, rows, model, seed, settings)


def middle_start(points: Array, model: ObjectModel) -> Array:
    """(4, 4) the object unturned, its centroid where the points (n, 3) are; a metre ahead when there are none."""
    middle = np.median(points, axis=0) if len(points) else np.array([0.0, 0.0, 1.0])
    return poses.make_pose(translation=middle - model.centroid)


# ---- features: Open3D


_FEATURES: WeakKeyDictionary[ObjectModel, dict[Any, Any]] = WeakKeyDictionary()


def _kept(model: ObjectModel, key: Any, make: Any) -> Any:
    """What a method prepares once per object."""
    kept = _FEATURES.setdefault(model, {})
    if key not in kept:
        kept[key] = make()
    return kept[key]


def _by_features(method: str, points: Array, model: ObjectModel, seed: int, settings: BaselineSettings) -> Array:
    o3d = open3d()
    registration = o3d.pipelines.registration
    voxel = float(np.clip(settings.voxel_share * model.diameter, *settings.voxel_limits))
    target, target_features = _kept(
        model,
        ("fpfh", voxel, settings.feature_radius, settings.model_points),
        lambda: _model_features(model, voxel, settings),
    )
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(settings.normal_radius * voxel, 30))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    if len(cloud.points) < settings.fewest:
        return middle_start(points, model)
    features = registration.compute_fpfh_feature(
        cloud, o3d.geometry.KDTreeSearchParamHybrid(settings.feature_radius * voxel, 100)
    )
    o3d.utility.random.seed(seed)
    if method == "fgr":
        option = registration.FastGlobalRegistrationOption(
            maximum_correspondence_distance=settings.fgr_inlier * voxel,
            iteration_number=settings.fgr_iterations,
        )
        # a start that finds too few pairs is no news for a terminal
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            found = registration.registration_fgr_based_on_feature_matching(
                cloud, target, features, target_features, option
            )
    else:
        distance = settings.inlier * voxel
        found = registration.registration_ransac_based_on_feature_matching(
            cloud,
            target,
            features,
            target_features,
            settings.mutual,
            distance,
            registration.TransformationEstimationPointToPoint(False),
            settings.ransac_points,
            [
                registration.CorrespondenceCheckerBasedOnEdgeLength(settings.ransac_edges),
                registration.CorrespondenceCheckerBasedOnDistance(distance),
            ],
            registration.RANSACConvergenceCriteria(settings.ransac_iterations, settings.ransac_confidence),
        )
    object_from_camera = np.array(found.transformation)
    if not np.isfinite(object_from_camera).all() or np.allclose(object_from_camera, np.eye(4)):
        return middle_start(points, model)
    return _refined(points, model, object_from_camera, settings)


def _refined(points: Array, model: ObjectModel, object_from_camera: Array, settings: BaselineSettings) -> Array:
    rotation = poses.nearest_rotation(object_from_camera[None, :3, :3])[0]
    start = poses.inverse(poses.make_pose(rotation, object_from_camera[:3, 3]))
    return icp(points, model, start, settings.icp).pose


def _model_features(model: ObjectModel, voxel: float, settings: BaselineSettings) -> tuple[Any, Any]:
    o3d = open3d()
    points, normals = model.sample_surface(settings.model_points, seed=0)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    cloud = cloud.voxel_down_sample(voxel)
    cloud.normalize_normals()
    features = o3d.pipelines.registration.compute_fpfh_feature(
        cloud, o3d.geometry.KDTreeSearchParamHybrid(settings.feature_radius * voxel, 100)
    )
    return cloud, features


# ---- point pair features: OpenCV


def _ppf(points: Array, model: ObjectModel, settings: BaselineSettings) -> Array:
    import cv2  # its stubs know nothing of contrib

    matching: Any = cv2
    o3d = open3d()
    # OpenCV's matcher loses digits away from 1: lengths in object diameters
    unit = model.diameter
    prepared = ("ppf", settings.ppf_step, settings.ppf_distance, settings.model_points)
    detector, oriented = _kept(model, prepared, lambda: _ppf_detector(model, settings))
    voxel = float(np.clip(settings.voxel_share * unit, *settings.voxel_limits))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(settings.normal_radius * voxel, 30))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    middle = points.mean(axis=0)
    scene = np.concatenate([(points - middle) / unit, np.asarray(cloud.normals)], axis=1).astype(np.float32)
    try:
        found = detector.match(scene, settings.ppf_reference, settings.ppf_distance)[: settings.ppf_refined]
        if not found:
            return middle_start(points, model)
        refine = matching.ppf_match_3d_ICP(settings.ppf_iterations, 0.005, 2.5, 6)
        _, found = refine.registerModelToScene(oriented, scene, found)
    except cv2.error:  # too few points for its own sampling
        return middle_start(points, model)
    candidates = []
    for entry in found:
        pose = np.array(entry.pose, dtype=np.float64)
        if not np.isfinite(pose).all() or abs(np.linalg.det(pose[:3, :3])) < 1e-6:
            continue
        rotation = poses.nearest_rotation(pose[None, :3, :3])[0]
        centred = poses.make_pose(rotation, unit * pose[:3, 3] + middle)
        candidates.append(centred @ poses.make_pose(translation=-model.centroid))
    results = [icp(points, model, candidate, settings.icp) for candidate in candidates]
    if not results:
        return middle_start(points, model)
    return max(results, key=lambda result: (result.fitness, -result.rmse)).pose


def _ppf_detector(model: ObjectModel, settings: BaselineSettings) -> tuple[Any, Any]:
    import cv2

    matching: Any = cv2
    points, normals = model.sample_surface(settings.model_points // 2, seed=0)
    oriented = np.concatenate([(points - model.centroid) / model.diameter, normals], axis=1).astype(np.float32)
    detector = matching.ppf_match_3d_PPF3DDetector(settings.ppf_step, settings.ppf_distance)
    detector.trainModel(oriented)
    return detector, oriented[:: max(1, len(oriented) // 2000)]


# ---- from a start: small_gicp


def _small_gicp(points: Array, model: ObjectModel, start: Array, settings: BaselineSettings) -> Array:
    import small_gicp

    def prepared() -> tuple[Any, Any]:
        samples, _ = model.sample_surface(settings.model_points, seed=0)
        return small_gicp.preprocess_points(samples, settings.gicp_voxel, num_neighbors=10, num_threads=1)

    target, tree = _kept(model, ("gicp", settings.gicp_voxel), prepared)
    source, _ = small_gicp.preprocess_points(points, settings.gicp_voxel, num_neighbors=10, num_threads=1)
    if source.size() < settings.fewest:
        return start
    object_from_camera = poses.inverse(start)
    for distance in settings.gicp_distances:
        result = small_gicp.align(
            target,
            source,
            tree,
            object_from_camera,
            registration_type="GICP",
            max_correspondence_distance=distance,
            num_threads=1,
            max_iterations=40,
        )
        if np.isfinite(result.T_target_source).all():
            object_from_camera = np.array(result.T_target_source)
    rotation = poses.nearest_rotation(object_from_camera[None, :3, :3])[0]
    return poses.inverse(poses.make_pose(rotation, object_from_camera[:3, 3]))
