"""What may be a part of a frame: arrays as users have them become those that the rest expects, or one line says why.

Each check takes the value and where it is for messages, and returns it in the type that `Frame` documents. What is
right already is returned as it is: frames are copied often, and their bits must not change.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry.poses import FARTHEST, ORTHONORMAL_TOLERANCE, refuse_masked

Array = NDArray[np.float64]

# Counts above this are no metres of a table-top: a depth camera's integers are millimetres (or tenths of them).
LARGEST_METRES = 100


def depth_image(value: ArrayLike, where: str) -> NDArray[np.float32]:
    """(h, w) float32 metres, 0 where a masked array has no value. Raises InputError for integers (they are counts of a
    camera, not metres) and shapes.
    """
    if isinstance(value, np.ma.MaskedArray):  # what is declared invalid is no reading
        value = value.filled(0)
    image = _array(value, f"{where}: depth", "an image of metres, shape (h, w)")
    if image.ndim != 2:
        raise InputError(f"{where}: depth: expected an image of shape (h, w), got shape {image.shape}")
    if image.dtype.kind in "iub":
        largest = int(image.max(initial=0))
        hint = "looks like millimetres: divide by 1000" if largest > LARGEST_METRES else "expected floating point"
        raise InputError(f"{where}: depth: expected metres, got {image.dtype} up to {largest}: {hint}")
    if image.dtype == np.float32:
        return image
    with np.errstate(over="ignore", invalid="ignore"):
        return image.astype(np.float32)


def colour_image(value: ArrayLike, where: str) -> NDArray[np.uint8]:
    """(h, w, 3) uint8, red first."""
    image = _array(value, f"{where}: rgb", "an image of uint8, shape (h, w, 3)")
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        found = f"{image.dtype} of shape {image.shape}"
        raise InputError(f"{where}: rgb: expected uint8 of shape (h, w, 3), red first, got {found}")
    return image


def mask_image(value: ArrayLike, where: str) -> NDArray[np.bool_]:
    """(h, w) bool. Two-valued images, as OpenCV's of 0 and 255, are taken as what they mean.

    Raises InputError for other shapes and for images of more values: of several objects, or with a soft edge.
    """
    image = _array(value, f"{where}: mask", "an image of bool, shape (h, w)")
    if image.ndim != 2:
        raise InputError(f"{where}: mask: expected an image of shape (h, w), got shape {image.shape}")
    if image.dtype == np.bool_:
        return image
    high = image.max(initial=0)
    inside = image != 0
    if not (image[inside] == high).all() or high < 0:  # NaN equals nothing
        values = np.unique(image)
        listed = ", ".join(f"{v:g}" for v in values[:4]) + (", …" if len(values) > 4 else "")
        said = "mask == number of your object, or mask > half its largest"
        raise InputError(f"{where}: mask: expected bool, or 0 and one other value, got {listed}: {said}")
    return inside


def points_of(value: ArrayLike, where: str, what: str) -> Array:
    """(n, 3) float64; rows that are no numbers are left to who reads them."""
    points = _array(value, f"{where}: {what}", "points of shape (n, 3)")
    if points.size == 0:
        return np.zeros((0, 3))
    if points.ndim != 2 or points.shape[1] != 3:
        hint = ": reshape(-1, 3)?" if points.ndim == 3 and points.shape[2] == 3 else ""
        raise InputError(f"{where}: {what}: expected points of shape (n, 3), got shape {points.shape}{hint}")
    return points if points.dtype == np.float64 else points.astype(np.float64)


def colours_of(value: ArrayLike, cloud: Array | None, where: str) -> NDArray[np.uint8]:
    """(n, 3) uint8, one row for each of the cloud's points."""
    colours = _array(value, f"{where}: cloud_colours", "uint8 of shape (n, 3)")
    expected = (0 if cloud is None else len(cloud), 3)
    if colours.dtype != np.uint8 or colours.shape != expected:
        found = f"{colours.dtype} of shape {colours.shape}"
        raise InputError(f"{where}: cloud_colours: expected uint8 of shape {expected} like the cloud, got {found}")
    return colours


def rigid(value: ArrayLike, where: str, what: str) -> Array:
    """(4, 4) float64, as given. Raises InputError for what is no rigid transform, as `scenes.geometry.poses` does."""
    pose = _array(value, f"{where}: {what}", "a 4x4 transform")
    if pose.shape != (4, 4):
        raise InputError(f"{where}: {what}: expected a 4x4 transform, got shape {pose.shape}")
    pose = pose if pose.dtype == np.float64 else pose.astype(np.float64)
    if not np.isfinite(pose).all():
        raise InputError(f"{where}: {what}: expected finite numbers, got {int((~np.isfinite(pose)).sum())} not finite")
    if np.abs(pose[:3, 3]).max() > FARTHEST:
        raise InputError(f"{where}: {what}: expected metres, got a translation of {np.abs(pose[:3, 3]).max():.3g}")
    if np.abs(pose[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        hint = ": is it transposed?" if np.abs(pose[:, 3] - (0.0, 0.0, 0.0, 1.0)).max() < 1e-9 else ""
        raise InputError(f"{where}: {what}: expected the last row 0 0 0 1, got {pose[3]}{hint}")
    with np.errstate(over="ignore"):
        error = float(np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max())
    if not error <= ORTHONORMAL_TOLERANCE:
        raise InputError(f"{where}: {what}: expected a rotation, got columns off orthonormal by {error:.2g}")
    if np.linalg.det(pose[:3, :3]) < 0:
        raise InputError(f"{where}: {what}: expected a rotation, got a mirrored one (determinant -1)")
    return pose


def joint_positions(value: object, where: str) -> dict[str, float]:
    """Positions by joint name; their names and numbers are checked by the hand that has them."""
    if not isinstance(value, Mapping):
        hint = "dict(zip(hand.joint_names, values))"
        raise InputError(f"{where}: joints: expected positions by joint name, got {_kind(value)}: {hint}?")
    for name, position in value.items():
        if not isinstance(name, str) or not np.isscalar(position) or isinstance(position, str | bytes):
            got = f"{name!r}: {position!r}"[:60]
            raise InputError(f"{where}: joints: expected one number for each joint name, got {got}")
    return {name: float(position) for name, position in value.items()}


def pressures(value: object, where: str) -> dict[str, Array]:
    """(k,) float64 pressures by sensor name, NaN where a taxel said nothing."""
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: tactile: expected pressures by sensor name, got {_kind(value)}")
    out = {}
    for name, given in value.items():
        array = _array(given, f"{where}: tactile {name!r}", "one pressure a taxel")
        if array.ndim != 1:
            raise InputError(f"{where}: tactile {name!r}: expected one pressure a taxel, got shape {array.shape}")
        out[str(name)] = array if array.dtype == np.float64 else array.astype(np.float64)
    return out


def gel_images(value: object, where: str) -> dict[str, NDArray[np.uint16] | NDArray[np.uint8]]:
    """Images by sensor name: (h, w) uint16 micrometres of indentation, or (h, w, 3) uint8 colours, red first."""
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: gels: expected images by sensor name, got {_kind(value)}")
    out = {}
    for name, given in value.items():
        image = _array(given, f"{where}: gels {name!r}", "a gel's image")
        colours = image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8
        if not colours and not (image.ndim == 2 and image.dtype == np.uint16):
            found = f"{image.dtype} of shape {image.shape}"
            expected = "uint16 micrometres of shape (h, w), or uint8 colours of shape (h, w, 3)"
            raise InputError(f"{where}: gels {name!r}: expected {expected}, got {found}")
        out[str(name)] = image
    return out


def sensor_names(value: Any, what: str = "contacts") -> list[str]:
    """The names of sensors, of contacts or of what else. Raises InputError for what is no list of words, and for one
    word.
    """
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        raise InputError(f"{what}: expected a list of sensor names, got {value!r:.60}")
    names = list(value)
    if not all(isinstance(name, str) for name in names):
        wrong = next(name for name in names if not isinstance(name, str))
        raise InputError(f"{what}: expected words as sensor names, got {wrong!r:.60}")
    return names


def same_size(sizes: Mapping[str, tuple[int, int]], where: str) -> None:
    """Raise InputError unless all (width, height) of an instant's images and its camera are one."""
    (first, expected), *others = sizes.items()
    for name, size in others:
        if size != expected:
            hint = ": register it to the depth image" if (first, name) == ("depth", "rgb") else ""
            message = f"expected {expected[0]}x{expected[1]} pixels like the {first}, got {size[0]}x{size[1]}{hint}"
            raise InputError(f"{where}: {name}: {message}")


def instance(value: Any, kind: type, where: str, what: str, how: str) -> None:
    """Raise InputError unless the value is of this kind; how: what makes one."""
    if not isinstance(value, kind):
        raise InputError(f"{where}: {what}: expected {kind.__name__} ({how}), got {_kind(value)}")


def _array(value: ArrayLike, where: str, expected: str) -> NDArray[Any]:
    refuse_masked(value, where)
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: expected {expected}, got {_kind(value)}: {error}") from error
    if array.dtype.kind not in "fiub":
        raise InputError(f"{where}: expected {expected}, got {_kind(value)}")
    return array


def _kind(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}, shape {value.shape}"
    return type(value).__name__
