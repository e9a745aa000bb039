"""How far an estimated pose is from the truth: pure functions, arrays in, floats out, each with its paper.

Poses are 4x4 camera_from_object (metres); `points` (n, 3) lie on the object in its own frame. The metrics that
average over the object (ADD, ADD-S) want dense points spread evenly over the surface (`model_points`): a box has
only eight vertices, and a scanned mesh crowds its vertices where it is curved. The metrics that take a maximum
(MSSD, MSPD) want the vertices: the displacement between two poses is a convex function of the point, so over each
triangle it is largest at a corner.

Everything here is symmetric under moving the camera; nothing here depends on the unit of length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.nearest import Nearest
from scenes.geometry.symmetries import Symmetries

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Evenly spread points for ADD and ADD-S. On a 20 cm tool neighbours are about 2 mm apart, and the mean over 10,000
# of them is known to a hundredth of the error it measures.
DENSE_POINTS = 10_000

# The convention of YCB-Video (Xiang et al., PoseCNN, RSS 2018): the area is taken up to 10 cm.
AUC_LIMIT = 0.1

# Turns about a continuous axis where a metric has no closed form: as many as BOP takes, so that the vertex farthest
# from the axis moves by at most 1 % of the diameter from one to the next (bop_toolkit, max_sym_disc_step 0.01).
SYMMETRY_STEPS = math.ceil(math.pi / 0.01)


def model_points(model: ObjectModel, count: int = DENSE_POINTS, seed: int = 0) -> Array:
    """(count, 3) points spread uniformly over the model's surface, object frame: the input of `add` and `add_s`."""
    return model.sample_surface(count, seed)[0].copy()  # the caller's own: the model keeps what it has drawn


def add(estimate: ArrayLike, truth: ArrayLike, points: Array) -> float:
    """Mean distance (m) between each point at the estimate and the same point at the truth.

    Hinterstoisser et al., Model based training, detection and pose estimation, ACCV 2012, eq. 7.
    """
    estimate, truth, points = _checked(estimate, truth, points)
    return float(np.linalg.norm(poses.apply(estimate, points) - poses.apply(truth, points), axis=1).mean())


def add_s(estimate: ArrayLike, truth: ArrayLike, points: Array, nearest: Nearest | None = None) -> float:
    """Mean distance (m) from each point at the truth to the nearest point at the estimate: blind to symmetry.

    Hinterstoisser et al., ACCV 2012, eq. 8; named ADD-S by Xiang et al., PoseCNN, RSS 2018. With sampled points the
    value depends on their spacing: slips along the surface shorter than that are not forgiven, and two equivalent
    poses of a symmetric object differ by about half of it instead of zero.
    nearest: the points among which the nearest is sought, when many poses of one object are measured or
    when they are denser than the `points` that are averaged (as they should be, for the reason above).
    """
    estimate, truth, points = _checked(estimate, truth, points)
    nearest = Nearest(points) if nearest is None else nearest
    # distances do not change when both sets are brought back to the object frame: one tree serves every pose
    return float(nearest.distance(poses.apply(poses.inverse(estimate) @ truth, points)).mean())


def bop_symmetries(symmetries: Symmetries) -> Array:
    """(k, 4, 4) equivalents that bop_toolkit tries: turns about each continuous axis after each discrete member.

    Given to `mssd` and `mspd` in place of the Symmetries they yield BOP's numbers to the last digit. The Symmetries
    themselves add the best turn in closed form, which no body of revolution can tell from the others: that is less by
    up to half a step, 0.5 % of the diameter. A sphere is more than two axes: BOP's numbers for one mean little.
    """
    turns = [np.eye(4)[None]] if not symmetries.axes else []
    for axis in symmetries.axes:
        angles = np.linspace(0.0, 2.0 * np.pi, SYMMETRY_STEPS, endpoint=False)
        rotations = poses.exp_rotation(angles[:, None] * axis.direction)
        turns.append(poses.make_poses(rotations, axis.point - rotations @ axis.point))
    return np.concatenate([(turn[None] @ symmetries.discrete[:, None]).reshape(-1, 4, 4) for turn in turns])


def mssd(estimate: ArrayLike, truth: ArrayLike, vertices: Array, symmetries: Symmetries | Array | None = None) -> float:
    """Largest distance (m) of any surface point, for the symmetric equivalent where that is smallest.

    symmetries: of the object, or the (k, 4, 4) equivalents to try (`bop_symmetries`).
    Maximum Symmetry-Aware Surface Distance: Drost et al., Introducing MVTec ITODD, ICCVW 2017; BOP Challenge 2020.
    """
    estimate, truth, vertices = _checked(estimate, truth, vertices)
    moved = poses.apply(estimate, vertices)

    def largest(equivalent: Array) -> float:
        return float(np.sqrt(np.square(moved - poses.apply(equivalent, vertices)).sum(axis=1).max()))

    return min(largest(equivalent) for equivalent in _equivalents(estimate, truth, symmetries))


def mspd(
    estimate: ArrayLike, truth: ArrayLike, vertices: Array, camera: Camera, symmetries: Symmetries | Array | None = None
) -> float:
    """Largest shift (pixels) of any projected vertex, for the symmetric equivalent where that is smallest.

    symmetries: of the object, or the (k, 4, 4) equivalents to try (`bop_symmetries`). Infinite when a vertex is behind
    the camera. Maximum Symmetry-Aware Projection Distance: BOP Challenge 2020 (Hodan et al., ECCVW 2020).
    """
    estimate, truth, vertices = _checked(estimate, truth, vertices)
    moved = camera.project(poses.apply(estimate, vertices))[0]

    def largest(equivalent: Array) -> float:
        shift = np.sqrt(np.square(moved - camera.project(poses.apply(equivalent, vertices))[0]).sum(axis=1).max())
        return float(shift) if np.isfinite(shift) else float("inf")

    return min(largest(equivalent) for equivalent in _equivalents(estimate, truth, symmetries))


def vsd(
    estimate_depth: ArrayLike,
    truth_depth: ArrayLike,
    observed_depth: ArrayLike,
    camera: Camera,
    tau: float | Sequence[float] = 0.02,
    delta: float = 0.015,
) -> float:
    """Share (0..1) of the visible pixels where the rendered surfaces disagree by `tau` metres or more.

    Visible Surface Discrepancy: Hodan et al., On evaluation of 6D object pose estimation, ECCVW 2016; visibility as
    in the BOP Challenge 2019 (a pixel without a reading counts as visible). The three depths are (h, w) metres along
    z, 0 where there is nothing: the object rendered at the estimate, at the truth, and the camera's image.
    tau: one tolerance or several, over which the error is averaged; delta: tolerance of the visibility test.
    Returns 1 when neither pose shows a pixel.
    """
    images = [np.asarray(image, dtype=np.float64) for image in (estimate_depth, truth_depth, observed_depth)]
    tolerances = np.atleast_1d(np.asarray(tau, dtype=np.float64))
    if not tolerances.size or not (np.isfinite([*tolerances.ravel(), delta]).all() and (tolerances > 0).all()):
        raise InputError(f"vsd: expected tau above 0 and delta, finite metres, got {tau} and {delta}")
    shape = (camera.height, camera.width)
    if any(image.shape != shape for image in images):
        raise InputError(f"vsd: expected three depth images of shape {shape}, got {[image.shape for image in images]}")
    # along the ray, not along z: a surface seen at the image's corner is not judged more harshly
    length = np.linalg.norm(camera.rays(), axis=-1)
    estimate, truth, observed = (np.where(np.isfinite(image), image, 0.0) * length for image in images)

    def in_front(surface: Array) -> NDArray[np.bool_]:
        return (surface > 0) & ((observed <= 0) | (surface - observed <= delta))

    seen_truth = in_front(truth)
    # where the true surface is seen, the estimate's cannot be blamed on an occluder
    seen_estimate = in_front(estimate) | (seen_truth & (estimate > 0))
    both = seen_estimate & seen_truth
    union = int((seen_estimate | seen_truth).sum())
    if union == 0:
        return 1.0
    gap = np.abs(estimate[both] - truth[both])
    alone = union - int(both.sum())
    return float(np.mean([(int((gap >= t).sum()) + alone) / union for t in tolerances]))


def rotation_error(estimate: ArrayLike, truth: ArrayLike, symmetries: Symmetries | None = None) -> float:
    """Angle (rad) between the orientations, for the equivalent of the estimate that is nearest to the truth.

    The turn about a continuous axis is found in closed form, so a bottle spun about itself has error 0, not half a
    step. Hodan et al., ECCVW 2016, section 3 (without symmetries).
    """
    nearest, truth = _nearest(estimate, truth, symmetries)
    return float(poses.rotation_angle(nearest[:3, :3] @ truth[:3, :3].T))


def translation_error(
    estimate: ArrayLike, truth: ArrayLike, symmetries: Symmetries | None = None, centre: ArrayLike = (0.0, 0.0, 0.0)
) -> float:
    """Distance (m) between the two positions of `centre` (object frame), for the equivalent nearest in rotation.

    Give the model's centroid as the centre: about a far-away origin every degree of rotation counts as translation.
    Hodan et al., ECCVW 2016, section 3 (there the centre is the origin).
    """
    nearest, truth = _nearest(estimate, truth, symmetries)
    middle = np.asarray(centre, dtype=np.float64)[None]
    return float(np.linalg.norm(poses.apply(nearest, middle) - poses.apply(truth, middle)))


def pose_error(estimate: ArrayLike, truth: ArrayLike, centre: ArrayLike, symmetries: Symmetries | None = None) -> Array:
    """(6,) rotation (rad) and translation (m) that carry the truth to the estimate, in the covariance's chart.

    The error whose NEES is meaningful: camera axes, about the object's `centre` (its centroid), for the equivalent of
    the estimate nearest to the truth.
    """
    nearest, truth = _nearest(estimate, truth, symmetries)
    return poses.difference(nearest, truth, centre)


def nees(error: ArrayLike, covariance: ArrayLike) -> float:
    """Normalised estimation error squared, e^T inv(C) e: on average 6 (the dimension) when C tells the truth.

    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4.
    error (d,), covariance (d, d). A direction of no variance at all (singular covariance) adds nothing when the error
    has no part in it and makes the result infinite when it has: the estimate claimed to know that exactly. NaN when
    the covariance is not finite or is indefinite.
    """
    e, c = np.asarray(error, dtype=np.float64), np.asarray(covariance, dtype=np.float64)
    if e.ndim != 1 or c.shape != (len(e), len(e)):
        raise InputError(f"nees: expected an error (d,) and a covariance (d, d), got {e.shape} and {c.shape}")
    if not (np.isfinite(e).all() and np.isfinite(c).all()) or (np.diag(c) < 0).any():
        return float("nan")
    # radians and metres differ by orders of magnitude: judge singularity on the correlation matrix
    sigma = np.sqrt(np.diag(c))
    scale = np.where(sigma > 0, sigma, 1.0)
    values, vectors = np.linalg.eigh(0.5 * (c + c.T) / np.outer(scale, scale))
    if values[0] < -1e-6:
        return float("nan")
    along = vectors.T @ (e / scale)
    known = values <= 1e-12
    # rounding leaves 1e-9 of a standard deviation in directions that hold none
    if (np.abs(along[known]) > 1e-9 * max(1.0, float(np.abs(along).max()))).any():
        return float("inf")
    return float((along[~known] ** 2 / values[~known]).sum())


def auc(errors: ArrayLike, limit: float = AUC_LIMIT) -> float:
    """Area (0..1) under the curve of recall against the error threshold, from 0 to `limit`.

    Xiang et al., PoseCNN, RSS 2018 (ADD and ADD-S, limit 0.1 m). The curve is a staircase, so its area is exactly the
    mean of 1 - error / limit, clipped at 0; an error that is not finite (no answer) counts as a miss. NaN for none.
    """
    values = np.asarray(errors, dtype=np.float64).ravel()
    if not limit > 0:
        raise InputError(f"auc: expected a limit above 0, got {limit}")
    if not len(values):
        return float("nan")
    return float(np.clip(1.0 - np.where(np.isfinite(values), values, np.inf) / limit, 0.0, 1.0).mean())


def recall(errors: ArrayLike, threshold: float) -> float:
    """Share (0..1) of errors below the threshold; one that is not finite (no answer) counts as a miss. NaN for none."""
    values = np.asarray(errors, dtype=np.float64).ravel()
    return float((values < threshold).mean()) if len(values) else float("nan")


def _checked(estimate: ArrayLike, truth: ArrayLike, points: Array) -> tuple[Array, Array, Array]:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InputError(f"metrics: expected points of shape (n, 3), got {points.shape}")
    return poses.check_pose(estimate, "estimate"), poses.check_pose(truth, "truth"), points


def _nearest(estimate: ArrayLike, truth: ArrayLike, symmetries: Symmetries | None) -> tuple[Array, Array]:
    estimate, truth = poses.check_pose(estimate, "estimate"), poses.check_pose(truth, "truth")
    return (estimate if symmetries is None else symmetries.nearest(estimate, truth)), truth


def _equivalents(estimate: Array, truth: Array, symmetries: Symmetries | Array | None) -> Array:
    """(k, 4, 4) poses that look like the truth; for a sphere the one that matters: turned as the estimate is."""
    if isinstance(symmetries, np.ndarray):
        return truth @ symmetries
    if symmetries is None or symmetries.is_trivial:
        return truth[None]
    nearest = symmetries.nearest(truth, estimate)[None]
    if symmetries.is_spherical:
        return nearest
    return np.concatenate([nearest, truth @ symmetries.poses(SYMMETRY_STEPS)])
