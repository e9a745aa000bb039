"""Folders of images that are no capture yet: plain rgb/ and depth/ with a camera, and the YCBInEOAT layout.

YCBInEOAT: Wen et al., se(3)-TrackNet, IROS 2020: cam_K.txt, rgb/, depth/ (millimetres), annotated_poses/ (4x4,
camera_from_object, metres), masks in gt_mask/ or masks/. Files of one image share their name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError
from scenes.files.formats import images
from scenes.files.problems import refuse
from scenes.formats.bop.scene import IMAGE_ENDINGS
from scenes.formats.conversion import (
    Converted,
    Dropped,
    at_least_one,
    check_undistorted,
    gaps_of,
    located,
    numbers_in_time,
    period_of,
)
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings import bop
from scenes.recordings.captures import write_capture
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

MASK_FOLDERS = ("masks", "gt_mask", "mask", "mask_visib")
# A name of this many digits is a time in nanoseconds since 1970, one of fewer than 7 the number of an image.
STAMP_DIGITS = 19
# A name of so many digits and decimals is a time in seconds since 1970: .5 is later than .10 there.
_SECONDS = re.compile(r"(\d{9,})\.(\d+)")
LARGEST_NUMBER = 999_999
# What other programs call the coefficients of a lens in their camera files.
DISTORTIONS = ("distortion", "dist_coeffs", "distortion_coefficients", "dist", "coeffs", "D", "d")


@dataclass(frozen=True)
class Intrinsics:
    """matrix: K (3, 3), pixels; depth_scale: millimetres per count of the depth images; size (width, height) of the
    images that the matrix is of, None when not told.
    """

    matrix: Array
    depth_scale: float = 1.0
    size: tuple[int, int] | None = None


def is_sequence(folder: str | Path) -> bool:
    """True for the YCBInEOAT layout: cam_K.txt beside depth/ or rgb/."""
    return (Path(folder) / "cam_K.txt").is_file() and is_image_folder(folder)


def is_image_folder(folder: str | Path) -> bool:
    """True for a folder with depth/ or rgb/ that is no capture."""
    folder = Path(folder)
    return any((folder / name).is_dir() for name in ("depth", "rgb")) and not (folder / "capture.json").is_file()


def convert_sequence(folder: Path, out: Path, model: ObjectModel, depth_scale: float = 1.0) -> Converted:
    """A YCBInEOAT sequence as a capture; poses without the name of an image belong to the images in their order.

    depth_scale: millimetres per count of the depth images.
    """
    intrinsics = Intrinsics(_numbers(folder / "cam_K.txt", 9).reshape(3, 3), depth_scale)
    return _convert(folder, out, model, intrinsics, "ycbineoat", lambda *found: _annotated(folder, *found))


def convert_images(folder: Path, out: Path, model: ObjectModel, intrinsics: Intrinsics | None = None) -> Converted:
    """rgb/ and depth/ as a capture; intrinsics default to the folder's camera.json."""
    intrinsics = intrinsics or read_camera(folder / "camera.json")
    return _convert(folder, out, model, intrinsics, "images", lambda *_: {})


def read_camera(path: Path) -> Intrinsics:
    """A camera.json: fx, fy, cx, cy or cam_K (9), depth_scale (millimetres per count, 1 when not said), and width and
    height of its images where they are told. Raises CaptureError, for coefficients of a distortion, too.
    """
    if not path.is_file():
        raise CaptureError(f"{path.parent}: expected camera.json or --intrinsics fx,fy,cx,cy, found neither")
    content = bop.read_json(path, refuse)
    if isinstance(content, dict) and "cam_K" not in content and {"fx", "fy", "cx", "cy"} <= set(content):
        fx, fy, cx, cy = (content[key] for key in ("fx", "fy", "cx", "cy"))
        content = {**content, "cam_K": [fx, 0, cx, 0, fy, cy, 0, 0, 1]}
    try:
        entry = bop.camera_entry(content)
    except InputError as error:
        raise CaptureError(f"{path}: expected fx, fy, cx, cy or cam_K, and depth_scale: {error}") from error
    sides = [content[name] for name in ("width", "height") if name in content]
    if len(sides) == 1:
        raise CaptureError(
            f"{path}: expected width and height, got {'width' if 'width' in content else 'height'} alone"
        )
    if entry.size is not None and list(entry.size) != [float(side) for side in sides]:
        raise CaptureError(f"{path}: expected width and height in whole pixels, got {sides[0]}, {sides[1]}")
    cure = "undistort them, and leave the coefficients out"
    for name in DISTORTIONS:
        if content.get(name) is not None:
            check_undistorted(f"{path}: {name}", _coefficients(content[name], f"{path}: {name}"), cure)
    return Intrinsics(entry.matrix, entry.depth_scale, entry.size)


def _coefficients(said: Any, where: str) -> Array:
    """(k,) numbers of a list, of lists as OpenCV writes them, or of a table with a name for each."""
    if isinstance(said, dict):
        said = list(said.values())
    try:
        return np.asarray(said, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise CaptureError(f"{where}: expected numbers, got {str(said)[:60]}") from error


def read_depth_scale(path: Path) -> float:
    """Millimetres per count that a camera.json says, whatever else it lacks, else 1; raises CaptureError."""
    content = bop.read_json(path, refuse)
    told = {"depth_scale": content["depth_scale"]} if isinstance(content, dict) and "depth_scale" in content else {}
    try:
        return bop.camera_entry({"cam_K": [1, 0, 0, 0, 1, 0, 0, 0, 1], **told}).depth_scale
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error


def _convert(
    folder: Path,
    out: Path,
    model: ObjectModel,
    intrinsics: Intrinsics,
    source: str,
    read_truths: Callable[[list[str], Dropped], dict[str, Path]],
) -> Converted:
    entry = bop.SceneCamera(intrinsics.matrix, intrinsics.depth_scale, None, intrinsics.size)
    files = {name: _files(folder / name) for name in ("depth", "rgb")}
    mask_folder = next((folder / name for name in MASK_FOLDERS if (folder / name).is_dir()), folder / "masks")
    files["mask"] = _files(mask_folder)
    names = list(files["depth"])
    if not names:
        raise CaptureError(f"{folder}: expected depth images ({', '.join(IMAGE_ENDINGS)}) in depth/, found none")
    dropped = Dropped()
    dropped.add("rgb", "no depth image of that name", len(set(files["rgb"]) - set(names)))
    dropped.add("masks", "no depth image of that name", len(set(files["mask"]) - set(names)))
    truths = read_truths(names, dropped)
    numbers = _numbering(names)

    def frames() -> Iterator[Frame]:
        for name in names:
            depth = _read(files["depth"].get(name), lambda path: images.read_depth(path, entry.depth_scale))
            rgb = _read(files["rgb"].get(name), images.read_rgb)
            mask = _read(files["mask"].get(name), images.read_mask)
            seen = [image for image in (depth, rgb, mask) if image is not None]
            if len({image.shape[:2] for image in seen}) > 1:
                sizes = ", ".join(f"{image.shape[1]}x{image.shape[0]}" for image in seen)
                raise CaptureError(f"{folder}, image {name}: expected images of one size, got {sizes}")
            told, (height, width) = intrinsics.size, seen[0].shape[:2]
            if told is not None and told != (width, height):
                expected = f"expected width x height {width}x{height} as the images of {folder}"
                raise CaptureError(f"{folder / 'camera.json'}: {expected}, got {told[0]}x{told[1]}")
            yield Frame(
                index=numbers[name],
                where=f"{folder}, image {name}",
                camera=bop.camera(entry, seen[0].shape),
                depth=depth,
                rgb=rgb,
                mask=mask,
                camera_from_object_truth=_read(truths.get(name), _pose),
            )

    notes: dict[str, Any] = {"source": source}
    remarks: tuple[str, ...] = ()
    if _are_stamps(names):
        notes["stamps_ns"] = {str(numbers[name]): int(name) for name in names}
        remarks = gaps_of(list(numbers.values()), period_of([int(name) for name in names]))
    written = write_capture(
        out, at_least_one(frames(), folder, dropped), model, depth_scale=entry.depth_scale, notes=notes
    )
    return Converted((written,), len(names), dropped, remarks)


def _files(folder: Path) -> dict[str, Path]:
    """Image files by their name without the ending."""
    if not folder.is_dir():
        return {}
    found = {path.stem: path for path in sorted(folder.iterdir()) if path.suffix.lower() in IMAGE_ENDINGS}
    return {name: found[name] for name in sorted(found, key=_in_time)}


def _in_time(name: str) -> tuple[list[str | int], str]:
    """Sorts names by the numbers in them: frame_2 before frame_10, and seconds since 1970 by their decimals."""
    seconds = _SECONDS.fullmatch(name)
    if seconds is not None:
        return ["", int(seconds[1]), ".", int(seconds[2].ljust(STAMP_DIGITS, "0"))], name
    return [int(part) if at % 2 else part for at, part in enumerate(re.split(r"(\d+)", name))], name


def _numbering(names: list[str]) -> dict[str, int]:
    """The names as numbers where they are such, as times where they are those, else their order."""
    if all(name.isdecimal() and int(name) <= LARGEST_NUMBER for name in names):
        numbers = {name: int(name) for name in names}
        if len(set(numbers.values())) == len(names):
            return numbers
    if _are_stamps(names):
        stamps = [int(name) for name in names]
        return dict(zip(names, numbers_in_time(stamps, period_of(stamps))))
    return {name: position for position, name in enumerate(names)}


def _are_stamps(names: list[str]) -> bool:
    return all(len(name) == STAMP_DIGITS and name.isdecimal() for name in names)


def _read(path: Path | None, read: Callable[[Path], Any]) -> Any:
    return None if path is None else located(path, read)


def _numbers(path: Path, count: int) -> Array:
    try:
        words = path.read_text(encoding="utf-8-sig").replace(",", " ").split()
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{path}: expected a text file of {count} numbers, it cannot be read") from error
    try:
        return bop.numbers(words, count, str(path))
    except InputError as error:
        raise CaptureError(str(error)) from error


def _pose(path: Path) -> Array:
    return poses.check_pose(_numbers(path, 16).reshape(4, 4), str(path))


def _annotated(folder: Path, names: list[str], dropped: Dropped) -> dict[str, Path]:
    """Pose file of each image: by name where names agree, else in order when there are as many."""
    place = folder / "annotated_poses"
    files = {path.stem: path for path in sorted(place.glob("*.txt"), key=lambda path: _in_time(path.stem))}
    images_there = set(names)
    named = {name: path for name, path in files.items() if name in images_there}
    if named or not files:
        dropped.add("poses", "no depth image of that name", len(files) - len(named))
        return named
    if len(files) != len(names):
        raise CaptureError(f"{place}: expected a pose for each of {len(names)} images, got {len(files)}")
    return dict(zip(names, files.values()))
