"""Images of ROS messages as arrays: sensor_msgs Image and CompressedImage, depth in millimetre counts or metres.

Encodings: sensor_msgs/image_encodings; depth units: REP 118 (16UC1 millimetres, 32FC1 metres); compressedDepth:
compressed_depth_image_transport (a header of 12 bytes, then PNG; 32FC1 as quantised inverse depth).
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError
from scenes.files.formats.images import decode

# name -> (type, channels, order of red, green, blue)
COLOURS: dict[str, tuple[int, tuple[int, int, int]]] = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "8UC4": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
    "8UC1": (1, (0, 0, 0)),
}
DEPTHS = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}
COMPRESSED_HEADER = struct.Struct("<iff")


def _compressed(message: Any) -> bool:
    return hasattr(message, "format")


def decode_depth(message: Any, where: str) -> NDArray[Any]:
    """(h, w): uint16 counts as published, or float32 metres, 0 where there is no reading.

    Raises CaptureError for another encoding or data that is not such an image.
    """
    if _compressed(message):
        return _compressed_depth(message, where)
    if message.encoding not in DEPTHS:
        raise CaptureError(f"{where}: expected the encoding {', '.join(DEPTHS)}, got {message.encoding!r}")
    image = _raw(message, np.dtype(DEPTHS[message.encoding]), 1, where)[:, :, 0]
    return _finite(image) if image.dtype == np.float32 else image


def decode_rgb(message: Any, where: str) -> NDArray[np.uint8]:
    """(h, w, 3) uint8, red first; grey images are repeated. Raises CaptureError for another encoding."""
    if _compressed(message):
        image = _opened(message, bytes(message.data), where)
        if image.dtype != np.uint8:
            raise CaptureError(f"{where}: expected a colour image of 8 bit, got {8 * image.dtype.itemsize} bit")
        if image.ndim == 2:
            return np.repeat(image[:, :, None], 3, axis=2)
        return np.ascontiguousarray(image[:, :, 2::-1])
    if message.encoding not in COLOURS:
        raise CaptureError(f"{where}: expected the encoding {', '.join(COLOURS)}, got {message.encoding!r}")
    channels, order = COLOURS[message.encoding]
    return np.ascontiguousarray(_raw(message, np.dtype(np.uint8), channels, where)[:, :, list(order)])


def decode_mask(message: Any, where: str) -> NDArray[np.bool_]:
    """(h, w) bool: true where the first channel of an 8 or 16 bit image is not 0."""
    if _compressed(message):
        image = _opened(message, bytes(message.data), where)
        return np.asarray(image.reshape(*image.shape[:2], -1)[:, :, 0] > 0)
    if message.encoding in ("16UC1", "mono16"):
        return np.asarray(_raw(message, np.dtype(np.uint16), 1, where)[:, :, 0] > 0)
    return np.asarray(decode_rgb(message, where)[:, :, 0] > 0)


def _raw(message: Any, kind: np.dtype[Any], channels: int, where: str) -> NDArray[Any]:
    """(h, w, channels) of rows that may be padded, in this machine's byte order."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    least, data = width * channels * kind.itemsize, np.asarray(message.data, dtype=np.uint8)
    if height < 1 or width < 1 or step < least or len(data) < step * (height - 1) + least:
        raise CaptureError(
            f"{where}: expected {height} rows of {least} bytes or more for {width}x{height} {message.encoding},"
            f" got step {step} and {len(data)} bytes"
        )
    padded = np.zeros(step * height, dtype=np.uint8)
    padded[: min(len(data), len(padded))] = data[: len(padded)]
    rows = np.ascontiguousarray(padded.reshape(height, step)[:, :least])
    image = rows.view(kind.newbyteorder(">" if message.is_bigendian else "<")).reshape(height, width, channels)
    return image.astype(kind.newbyteorder("="))


def _opened(message: Any, data: bytes, where: str) -> NDArray[Any]:
    image = decode(data)
    if image is None:
        raise CaptureError(f"{where}: expected a compressed image ({message.format!r}), got {len(data)} bytes of none")
    return image


def _compressed_depth(message: Any, where: str) -> NDArray[Any]:
    """A plain PNG of 16 bit, or one after compressedDepth's header."""
    kind = str(message.format)
    data = bytes(message.data)
    if "compressedDepth" not in kind:
        image = _opened(message, data, where)
        if image.dtype != np.uint16 or image.ndim != 2:
            raise CaptureError(f"{where}: expected a depth image of 16 bit, 1 channel, got {image.dtype} {image.shape}")
        return image
    if "rvl" in kind.lower():
        raise CaptureError(f"{where}: expected compressedDepth as PNG, got {kind!r}")
    if len(data) <= COMPRESSED_HEADER.size:
        raise CaptureError(f"{where}: expected a header of {COMPRESSED_HEADER.size} bytes and a PNG, got {len(data)}")
    _, a, b = COMPRESSED_HEADER.unpack_from(data)
    image = _opened(message, data[COMPRESSED_HEADER.size :], where)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise CaptureError(f"{where}: expected a depth image of 16 bit, 1 channel, got {image.dtype} {image.shape}")
    if not kind.strip().startswith("32FC1"):
        return image
    # quantised inverse depth: count = a / metres + b, 0 for no reading
    counts = image.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.where(image > 0, a / (counts - b), 0.0)
    return _finite(metres.astype(np.float32))


def _finite(metres: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0.0)).astype(np.float32)
