"""The pictures of a track's report, made while each frame is in memory: a window around the object, a small JPEG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.results.report.pictures import NO_READING, STOPS, Crop, choose_crop
from fusion.tracking.answer import TrackedEstimate
from scenes.files.whole import named
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# Width (pixels) of a picture, and how much room around the object it shows (shares of the object's extent).
WIDE = 320
MARGIN = 0.9
# A report has pictures of this many frames, evenly spread, beside those in which something changes: 40 MB an hour.
MOST = 3000
# Of a JPEG, 0 to 100: 10 KB a picture.
QUALITY = 78
# Depths that the colours span, before and behind the object's middle (object radii).
DEPTH_REACH = 3.0
# Vertices that tell where in the image the object is.
CORNERS = 200


class Photographer:
    """Takes the pictures of one track."""

    def __init__(self, folder: Path, model: ObjectModel, frames: int) -> None:
        """folder: to write to, which exists; frames: of the recording."""
        self._folder, self._model = folder, model
        self._every = every(frames)
        self._corners = model.vertices[:: max(1, len(model.vertices) // CORNERS)]
        self._before: tuple[object, ...] | None = None

    def take(self, frame: Frame, answer: TrackedEstimate, position: int) -> dict[str, Any] | None:
        """Write the picture of a frame that deserves one; returns what it shows: its file, window [left, top, width,
        height] and camera [fx, fy, cx, cy], pixels. None without a picture.
        """
        now = (answer.verdict, answer.how, answer.slip)
        changed, self._before = now != self._before, now
        if (position % self._every and not changed) or frame.camera is None:
            return None
        camera, pose = frame.camera, answer.pose
        seen = poses.apply(pose, self._corners)
        seen = seen[np.isfinite(seen).all(axis=1)]
        pixels = camera.project(seen[seen[:, 2] > 1e-3])[0]
        crop = choose_crop(pixels, (camera.width, camera.height), MARGIN, WIDE)
        if frame.rgb is not None:
            picture = _resized(_window(frame.rgb, crop), crop)
        elif frame.depth is not None:
            middle = float(poses.apply(pose, self._model.centroid[None])[0, 2])
            picture = _resized(
                _depth_colours(_window(frame.depth, crop), middle, DEPTH_REACH * self._model.radius), crop
            )
        else:
            return None
        name = f"{frame.index:06d}.jpg"
        with named(self._folder / name):
            (self._folder / name).write_bytes(_jpeg(picture))
        window = [crop.left, crop.top, crop.width, crop.height]
        return {"frame": frame.index, "window": window, "camera": [camera.fx, camera.fy, camera.cx, camera.cy]}


def every(frames: int) -> int:
    """Of a recording of so many frames, every so manieth has a picture."""
    return -(-frames // MOST)


def _window(image: NDArray[Any], crop: Crop) -> NDArray[Any]:
    return image[crop.top : crop.top + crop.height, crop.left : crop.left + crop.width]


def _depth_colours(depth: NDArray[np.floating], middle: float, reach: float) -> NDArray[np.uint8]:
    """A depth image (m, 0 = no reading) in 256 colours around the object's depth: a table, for it is made between two
    frames.
    """
    valid = np.isfinite(depth) & (depth > 0)
    share = np.clip((np.where(valid, depth, 0.0) - (middle - reach)) / (2.0 * reach), 0.0, 1.0)
    colours = np.stack([np.interp(np.linspace(0, 1, 256), np.linspace(0, 1, len(STOPS)), c) for c in STOPS.T], axis=1)
    out = np.rint(colours).astype(np.uint8)[np.rint(255 * share).astype(np.uint8)]
    out[~valid] = NO_READING
    return out


def _resized(image: NDArray[np.uint8], crop: Crop) -> NDArray[np.uint8]:
    import cv2

    size = (round(crop.width * crop.scale), round(crop.height * crop.scale))
    return np.asarray(cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    """An (h, w, 3) image, red first, as the bytes of a file."""
    import cv2

    _, coded = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return bytes(coded.tobytes())
