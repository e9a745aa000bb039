"""Rigid transforms: 4x4 float64 arrays named target_from_source, metres and radians.

Tangent vectors are ordered (rotation, translation). Two charts are used:
- `exp`, `log`: the SE(3) exponential (twist applied from the left, in the target frame);
- `perturb`, `difference`: rotation and translation applied separately *about a point of the
  object* (its centroid), the chart of every covariance in this package. There a millimetre means
  a millimetre of the object, however far the camera is.

Small angles use Taylor branches (Solà et al., "A micro Lie theory", 2018, appendix B).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError

Array = NDArray[np.float64]

# Metres: nothing that is felt or seen is as far as the Moon, and squares of much larger numbers overflow.
FARTHEST = 1e9
# The last row of a transform, and what rounding may make of each number.
_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_LAST_ROW_TOLERANCE = np.array([1e-9, 1e-9, 1e-9, 1e-5])
# Rotations whose columns are off orthonormal by more than this are refused, not silently repaired.
ORTHONORMAL_TOLERANCE = 1e-4
# What is off a rotation by more than this factor in any direction (no unit) was never one: rounding and averaging leave
# some per cent.
STRETCH = 2.0


def refuse_masked(value: object, what: str) -> None:
    """Raise InputError for a masked array of which something is masked: what is declared invalid would be taken."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        hidden = int(np.ma.getmaskarray(value).sum())
        raise InputError(f"{what}: expected values, got a masked array with {hidden} of {value.size} masked")


def check_pose(pose: ArrayLike, name: str = "pose") -> Array:
    """Validate a rigid transform.

    Parameters: pose, shape (4, 4) or (..., 4, 4), target_from_source.
    Returns the same as a contiguous float64 array, rotation re-orthonormalised to double precision.
    Raises InputError when the shape is wrong, a value is not finite, the last row is not
    (0, 0, 0, 1), the rotation is scaled, sheared or mirrored, or the translation beyond FARTHEST.
    """
    refuse_masked(pose, name)
    try:
        array = np.array(pose, dtype=np.float64)
    except (TypeError, ValueError) as why:
        raise InputError(f"{name}: expected a 4x4 transform of numbers: {why}") from why
    if array.shape[-2:] != (4, 4):
        raise InputError(f"{name}: expected a 4x4 transform, got shape {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers, got {int((~np.isfinite(array)).sum())} not finite")
    if np.abs(array[..., :3, 3]).max(initial=0.0) > FARTHEST:
        raise InputError(f"{name}: expected metres, got a translation of {np.abs(array[..., :3, 3]).max():.3g}")
    if (np.abs(array[..., 3, :] - _LAST_ROW) > _LAST_ROW_TOLERANCE).any():
        raise InputError(f"{name}: expected last row 0 0 0 1, got {array[..., 3, :].reshape(-1, 4)[0]}")
    rotation = array[..., :3, :3]
    gram = np.swapaxes(rotation, -1, -2) @ rotation
    error = float(np.abs(gram - np.eye(3)).max(initial=0.0))
    if error > ORTHONORMAL_TOLERANCE:
        raise InputError(f"{name}: expected a rotation matrix, got columns off orthonormal by {error:.2g}")
    if np.any(np.linalg.det(rotation) < 0):
        raise InputError(f"{name}: expected a rotation matrix, got a mirrored one (determinant -1)")
    array[..., :3, :3] = nearest_rotation(rotation)
    return array


def project_to_rotation(matrix: Array) -> Array:
    """Nearest rotation (Frobenius) to each (..., 3, 3) matrix, by singular value decomposition.

    Raises InputError for what no rounding has made of a rotation: a mirrored or flat matrix, one that stretches a
    direction by more than STRETCH or shrinks it as much, and what is not finite.
    """
    matrix = np.asarray(matrix)
    if matrix.shape[-2:] != (3, 3) or matrix.dtype.kind not in "fiu" or not np.isfinite(matrix).all():
        raise InputError(f"rotation: expected finite matrices (..., 3, 3), got {matrix.dtype} of shape {matrix.shape}")
    if (np.linalg.det(matrix) <= 0).any():
        raise InputError("rotation: expected a determinant of 1, got 0 or below: is an axis mirrored or missing?")
    stretch = np.linalg.svd(matrix, compute_uv=False)
    if stretch.size and not (stretch.min() >= 1.0 / STRETCH and stretch.max() <= STRETCH):
        worst = f"{stretch.min():.3g} to {stretch.max():.3g}"
        raise InputError(f"rotation: expected lengths kept within a factor of {STRETCH:g}, got {worst}")
    return nearest_rotation(matrix)


def nearest_rotation(matrix: Array) -> Array:
    """As `project_to_rotation`, of any finite matrix: of a mirrored or flat one, too, as point sets that lie in a plane
    make of their covariance (Kabsch, Acta Cryst. A 32, 1976).
    """
    u, _, vt = np.linalg.svd(matrix)
    sign = np.linalg.det(u @ vt)
    u = u.copy()
    u[..., :, 2] *= sign[..., None]
    return u @ vt


def straightened(rotations: Array) -> Array:
    """Rotations (..., 3, 3) that rounding has bent by 1e-6 or less, made orthonormal to the last digits: a step of
    Newton's iteration for the polar factor (Higham, SIAM J. Sci. Stat. Comput. 7, 1986), which squares the error.
    """
    gram = np.swapaxes(rotations, -1, -2) @ rotations
    return np.asarray(rotations @ (1.5 * np.eye(3) - 0.5 * gram))


def make_pose(rotation: ArrayLike | None = None, translation: ArrayLike | None = None) -> Array:
    """4x4 transform from a (3, 3) rotation (default identity) and a (3,) translation (default zero).

    Raises InputError for other shapes: NumPy would take three angles for three equal rows.
    """
    pose = np.eye(4)
    if rotation is not None:
        pose[:3, :3] = _of_shape(rotation, (3, 3), "rotation", " (from_quaternion, exp_rotation)")
    if translation is not None:
        pose[:3, 3] = _of_shape(translation, (3,), "translation", "")
    return pose


def _of_shape(values: ArrayLike, shape: tuple[int, ...], name: str, how: str) -> Array:
    array = np.asarray(values)
    if array.shape != shape:
        raise InputError(f"{name}: expected an array of shape {shape}{how}, got shape {array.shape}")
    return array


def make_poses(rotations: Array, translations: Array) -> Array:
    """(n, 4, 4) transforms from rotations (n, 3, 3) and translations (n, 3)."""
    out = np.zeros((len(rotations), 4, 4))
    out[:, :3, :3] = rotations
    out[:, :3, 3] = translations
    out[:, 3, 3] = 1.0
    return out


def inverse(pose: Array) -> Array:
    """source_from_target of each (..., 4, 4) target_from_source."""
    out = np.zeros(pose.shape, pose.dtype)
    if pose.ndim == 2:
        out[:3, :3] = pose[:3, :3].T
        out[:3, 3] = -(out[:3, :3] @ pose[:3, 3])
        out[3, 3] = 1.0
        return out
    rotation_t = np.swapaxes(pose[..., :3, :3], -1, -2)
    out[..., :3, :3] = rotation_t
    out[..., :3, 3] = -(rotation_t @ pose[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def apply(pose: Array, points: Array) -> Array:
    """Points (n, 3) of the source frame in the target frame; pose (4, 4) or (b, 4, 4) -> (b, n, 3)."""
    return points @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3]


def skew(vector: Array) -> Array:
    """Cross-product matrices (..., 3, 3) of (..., 3) vectors."""
    vector = np.asarray(vector, dtype=np.float64)
    out = np.zeros((*vector.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -vector[..., 2], vector[..., 1]
    out[..., 1, 0], out[..., 1, 2] = vector[..., 2], -vector[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return out


def cross(a: Array, b: Array) -> Array:
    """(n, 3) cross products of rows; NumPy's own takes many times as long on few of them."""
    out = np.zeros(a.shape)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return out


def exp_rotation(vector: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), radians (Rodrigues)."""
    vector = np.asarray(vector, dtype=np.float64)
    if vector.shape == (3,):
        return _one_rotation(*vector.tolist())
    square = np.sum(vector * vector, axis=-1)[..., None, None]
    angle = np.sqrt(square)
    small = square < 1e-8
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - square / 6.0, np.sin(safe) / safe)
    # 2 sin^2(x/2)/x^2 does not cancel near zero as (1 - cos x)/x^2 does
    b = np.where(small, 0.5 - square / 24.0, 2.0 * (np.sin(0.5 * safe) / safe) ** 2)
    k = skew(vector)
    return np.eye(3) + a * k + b * (k @ k)


def _one_rotation(x: float, y: float, z: float) -> Array:
    """`exp_rotation` of one vector: arrays of so few numbers take NumPy twenty times as long."""
    square = x * x + y * y + z * z
    if not square < math.inf:
        return np.full((3, 3), np.nan)  # no number of turns
    if square < 1e-8:
        a, b = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = math.sqrt(square)
        a, b = math.sin(angle) / angle, 2.0 * (math.sin(0.5 * angle) / angle) ** 2
    xx, yy, zz, xy, xz, yz = b * x * x, b * y * y, b * z * z, b * x * y, b * x * z, b * y * z
    return np.array(
        [
            [1.0 - yy - zz, xy - a * z, xz + a * y],
            [xy + a * z, 1.0 - xx - zz, yz - a * x],
            [xz - a * y, yz + a * x, 1.0 - xx - yy],
        ]
    )


def to_quaternion(rotation: Array) -> Array:
    """Unit quaternions (..., 4), scalar first and non-negative, of rotations (..., 3, 3).

    Shepperd's method: the largest of four candidates is divided by, so no rotation is singular.
    """
    r = np.asarray(rotation, dtype=np.float64)
    if r.shape == (3, 3):
        return _one_quaternion(r.tolist())
    d = np.diagonal(r, axis1=-2, axis2=-1)
    trace = d.sum(-1)
    picks = np.argmax(np.concatenate([trace[..., None], d], axis=-1), axis=-1)
    w0 = np.stack(
        [1 + trace, r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], -1
    )
    candidates = [w0]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        q = np.zeros((*r.shape[:-2], 4))
        q[..., 0] = r[..., k, j] - r[..., j, k]
        q[..., 1 + i] = 1 + d[..., i] - d[..., j] - d[..., k]
        q[..., 1 + j] = r[..., j, i] + r[..., i, j]
        q[..., 1 + k] = r[..., k, i] + r[..., i, k]
        candidates.append(q)
    q = np.take_along_axis(np.stack(candidates, -2), picks[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def _one_quaternion(r: list[list[float]]) -> Array:
    """`to_quaternion` of one rotation."""
    trace = r[0][0] + r[1][1] + r[2][2]
    largest = max(range(4), key=lambda pick: trace if pick == 0 else r[pick - 1][pick - 1])
    if largest == 0:
        q = [1.0 + trace, r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = [r[k][j] - r[j][k], 0.0, 0.0, 0.0]
        q[1 + i] = 1.0 + r[i][i] - r[j][j] - r[k][k]
        q[1 + j] = r[j][i] + r[i][j]
        q[1 + k] = r[k][i] + r[i][k]
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    length = -length if q[0] < 0.0 else length
    return np.array([part / length for part in q])


def from_quaternion(quaternion: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of quaternions (..., 4), scalar first (ROS and SciPy have it last: np.roll(q, 1, axis=-1));
    any non-zero length. Raises InputError for other shapes.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if q.shape[-1:] != (4,):
        raise InputError(f"quaternion: expected four numbers w, x, y, z, got shape {q.shape}")
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, v = q[..., 0, None, None], q[..., 1:]
    k = skew(v)
    return np.eye(3) + 2 * w * k + 2 * (k @ k)


def log_rotation(rotation: Array) -> Array:
    """Rotation vectors (..., 3) of length at most pi; exact near 0 and near pi (through quaternions)."""
    q = to_quaternion(rotation)
    w, v = q[..., 0], q[..., 1:]
    norm = np.linalg.norm(v, axis=-1)
    small = norm < 1e-7
    factor = np.where(small, 2.0, 2.0 * np.arctan2(norm, w) / np.where(small, 1.0, norm))
    return v * factor[..., None]


def rotation_angle(rotation: Array) -> Array:
    """Angle in [0, pi] of each (..., 3, 3) rotation; no arccos, so no loss near 0 and pi."""
    q = to_quaternion(rotation)
    return 2.0 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), q[..., 0])


def _left_jacobian(vector: Array) -> Array:
    square = np.sum(vector * vector, axis=-1)[..., None, None]
    angle = np.sqrt(square)
    small = square < 1e-6
    safe = np.where(small, 1.0, angle)
    b = np.where(small, 0.5 - square / 24.0, 2.0 * (np.sin(0.5 * safe) / safe) ** 2)
    c = np.where(small, 1.0 / 6.0 - square / 120.0, (safe - np.sin(safe)) / safe**3)
    k = skew(vector)
    return np.eye(3) + b * k + c * (k @ k)


def exp(twist: ArrayLike) -> Array:
    """SE(3) exponential: (..., 6) twists (rotation, translation) to (..., 4, 4) transforms."""
    twist = np.asarray(twist, dtype=np.float64)
    pose = np.zeros((*twist.shape[:-1], 4, 4))
    pose[..., :3, :3] = exp_rotation(twist[..., :3])
    pose[..., :3, 3] = (_left_jacobian(twist[..., :3]) @ twist[..., 3:, None])[..., 0]
    pose[..., 3, 3] = 1.0
    return pose


def log(pose: Array) -> Array:
    """SE(3) logarithm: (..., 4, 4) transforms to (..., 6) twists, rotation part at most pi long."""
    rotation = log_rotation(pose[..., :3, :3])
    jacobian = _left_jacobian(rotation)
    translation = np.linalg.solve(jacobian, pose[..., :3, 3, None])[..., 0]
    return np.concatenate([rotation, translation], axis=-1)


def adjoint(pose: Array) -> Array:
    """(..., 6, 6) adjoint: pose @ exp(x) @ inverse(pose) = exp(adjoint(pose) @ x)."""
    rotation, translation = pose[..., :3, :3], pose[..., :3, 3]
    out = np.zeros((*pose.shape[:-2], 6, 6))
    out[..., :3, :3] = rotation
    out[..., 3:, 3:] = rotation
    out[..., 3:, :3] = skew(translation) @ rotation
    return out


def turned_covariance(covariance: Array, target_from_source: Array) -> Array:
    """The covariance (..., 6, 6) of a pose, rotation (rad) then translation (m), in the axes of another frame.

    Of source_from_object, in the source's axes: then of target_from_source @ source_from_object, in the target's. It
    stays about the same point of the object, and target_from_source (4, 4) counts as exactly known.
    """
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = check_pose(target_from_source, "target_from_source")[:3, :3]
    return turn @ np.asarray(covariance) @ turn.T


def shifted_covariance(covariance: Array, offset: ArrayLike) -> Array:
    """The covariance (..., 6, 6) of a pose, rotation (rad) then translation (m), about another point of the object,
    which lies at `offset` (3,), metres in the covariance's axes, from the point that it was about.

    From the centroid to the object's origin, as most programs have it: offset = -pose[:3, :3] @ model.centroid.
    """
    lever = np.eye(6)
    lever[3:, :3] = -skew(_of_shape(offset, (3,), "offset", ""))
    return lever @ np.asarray(covariance) @ lever.T


def perturb(pose: Array, delta: ArrayLike, centre: ArrayLike) -> Array:
    """Turn by delta[:3] about the object's `centre` (object frame, metres), then move it by delta[3:].

    pose (..., 4, 4) target_from_object, delta (..., 6): rotation vector and displacement of the
    centre, both in target axes. Inverse of `difference`.
    """
    from scenes.geometry.rotation_kernels import perturbed

    pose, delta = np.asarray(pose, dtype=np.float64), np.asarray(delta, dtype=np.float64)
    if pose.ndim > 2 and pose.shape[:-2] != delta.shape[:-1]:
        shape = np.broadcast_shapes(pose.shape[:-2], delta.shape[:-1])
        pose, delta = np.broadcast_to(pose, (*shape, 4, 4)), np.broadcast_to(delta, (*shape, 6))
    out = np.zeros((*delta.shape[:-1], 4, 4))
    perturbed(_rows(pose, 4, 4), _rows(delta, 6), _rows(centre), out.reshape(-1, 4, 4))
    return out


def difference(pose: Array, reference: Array, centre: ArrayLike) -> Array:
    """The (..., 6) delta with perturb(reference, delta, centre) == pose."""
    from scenes.geometry.rotation_kernels import differences

    pose, reference = np.asarray(pose, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if reference.ndim > 2 and pose.shape != reference.shape:
        pose, reference = np.broadcast_arrays(pose, reference)
    out = np.zeros((*pose.shape[:-2], 6))
    differences(_rows(pose, 4, 4), _rows(reference, 4, 4), _rows(centre), out.reshape(-1, 6))
    return out


def _rows(values: ArrayLike, *shape: int) -> Array:
    """(n, *shape) of numbers that lie one after the other, as kernels take them: for numba an array that may not be
    written is of another type, for which it would compile again.
    """
    rows = np.ascontiguousarray(values, dtype=np.float64)
    return (rows if rows.flags.writeable else rows.copy()).reshape(-1, *shape)


def random_rotations(count: int, rng: np.random.Generator) -> Array:
    """(count, 3, 3) rotations, uniform over SO(3)."""
    return from_quaternion(rng.normal(size=(count, 4)))


def random_unit_vectors(count: int, rng: np.random.Generator) -> Array:
    """(count, 3) directions, uniform over the sphere."""
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def displaced(pose: Array, angle: float, distance: float, centre: ArrayLike, rng: np.random.Generator) -> Array:
    """The pose turned by exactly `angle` (rad) about a random axis through `centre` and its centre
    moved by exactly `distance` (m) in a random direction: a coarse start as in T1 section 4.3.
    """
    directions = random_unit_vectors(2, rng)
    return perturb(pose, np.concatenate([angle * directions[0], distance * directions[1]]), centre)


@lru_cache(maxsize=8)
def around(count: int) -> Array:
    """(count, 3) unit vectors evenly over the sphere (Fibonacci lattice)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - height**2)
    out = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    out.setflags(write=False)
    return out
