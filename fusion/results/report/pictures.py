"""The pictures of a report: a depth image that one can read, cropped around the object, as images and as data URIs."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Near to far: sand, clay, violet, night. Light is near, as under a lamp held at the camera.
STOPS = np.array([(250, 232, 200), (240, 170, 120), (190, 92, 110), (104, 62, 120), (44, 40, 84), (20, 22, 44)], float)
NO_READING = (10, 11, 18)


@dataclass(frozen=True)
class Crop:
    """A window of the image: left, top, width, height in pixels; scale: picture pixels per image pixel."""

    left: int
    top: int
    width: int
    height: int
    scale: float


def choose_crop(points: Array, image_size: tuple[int, int], margin: float = 0.45, wide: int = 640) -> Crop:
    """A 4:3 window around pixels `points` (n, 2) with `margin` of their extent as context, inside the image.

    image_size: (width, height). wide: width of the picture in its own pixels; small crops are enlarged up to 3 times.
    The whole image when there are no points.
    """
    width, height = image_size
    points = points[np.isfinite(points).all(axis=1)]
    if len(points):
        low = np.clip(points.min(axis=0), 0, (width - 1, height - 1))
        high = np.clip(points.max(axis=0), 0, (width - 1, height - 1))
        centre, extent = (low + high) / 2, (high - low) * (1 + margin)
        w = max(extent[0], extent[1] * 4 / 3, 96.0)
    else:
        centre, w = np.array([width / 2, height / 2]), float(max(width, height * 4 / 3))
    w, h = min(round(w), width), min(round(w * 3 / 4), height)
    left = int(np.clip(round(centre[0] - w / 2), 0, width - w))
    top = int(np.clip(round(centre[1] - h / 2), 0, height - h))
    return Crop(left, top, int(w), int(h), float(min(3.0, wide / w)))


def depth_range(depth: NDArray[np.floating], middle: float | None = None, radius: float = 0.0) -> tuple[float, float]:
    """Depths (m) that the colours span: object and hand where the object's depth `middle` (m) and its radius (m) are
    known, else most of what the image holds.
    """
    valid = depth[np.isfinite(depth) & (depth > 0)]
    if not valid.size:
        return 0.0, 1.0
    low, high = np.percentile(valid, (2, 90))
    if middle is not None and middle > 0:
        # what is before the object is the hand: all of it within reach; what is behind is background
        low = np.clip(low, middle - 4.0 * radius, middle - radius)
        high = middle + 2.6 * radius
    low = max(0.0, float(low))
    return low, float(max(high, low + 1e-3))


def depth_image(depth: NDArray[np.floating], crop: Crop, near: float, far: float) -> Image:
    """The window of a (h, w) depth image (m, 0 = no reading) in colours, (h, w, 3).

    Colour tells depth between `near` and `far`; shading by the local slope shows the shape that colour alone hides.
    """
    import cv2

    part = np.asarray(depth[crop.top : crop.top + crop.height, crop.left : crop.left + crop.width], dtype=np.float64)
    valid = np.isfinite(part) & (part > 0)
    share = np.clip((np.where(valid, part, far) - near) / max(far - near, 1e-6), 0.0, 1.0)
    stops = np.linspace(0, 1, len(STOPS))
    colour = np.stack([np.interp(share, stops, STOPS[:, channel]) for channel in range(3)], axis=-1)
    # slope in units of the depth range, so that the relief is as strong for a pencil as for a box
    # the median takes out flying pixels, which would glitter along every edge
    smooth = cv2.GaussianBlur(cv2.medianBlur(share.astype(np.float32), 5).astype(np.float64), (0, 0), 1.2)
    down, right = np.gradient(smooth)
    relief = np.clip(1.0 + 12.0 * (right + down), 0.68, 1.22)
    return _resized(np.where(valid[..., None], colour * relief[..., None], NO_READING), crop)


def colour_image(rgb: Image, crop: Crop) -> Image:
    """The window of an (h, w, 3) uint8 colour image."""
    return _resized(rgb[crop.top : crop.top + crop.height, crop.left : crop.left + crop.width], crop)


def jpeg(image: Image, quality: int = 80) -> bytes:
    """An (h, w, 3) image as the bytes of a file."""
    import cv2

    _, coded = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(coded.tobytes())


def data_uri(image: Image) -> str:
    """An (h, w, 3) image as a page carries it."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg(image)).decode()


def _resized(colour: NDArray[np.generic], crop: Crop) -> Image:
    import cv2

    size = (round(crop.width * crop.scale), round(crop.height * crop.scale))
    kind = cv2.INTER_CUBIC if crop.scale > 1 else cv2.INTER_AREA
    return np.asarray(cv2.resize(np.clip(colour, 0, 255).astype(np.uint8), size, interpolation=kind))
