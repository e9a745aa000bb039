"""Images of a capture as PNG: depth (16 bit), colour, masks."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError
from scenes.files.whole import named

LARGEST_COUNT = 65535
# Depth counts are in multiples of a millimetre, metres everywhere else.
MM = 1e-3
# Pixels that no depth camera has: a header that claims more (in a file of a few bytes) would fill the memory.
MOST_PIXELS = 100_000_000
# A PNG begins with this; width and height are the next two big-endian words.
_PNG = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"


def _read(path: Path) -> NDArray[Any]:
    data = path.read_bytes()
    image = decode(data)
    if image is None:
        raise CaptureError(f"expected a PNG image, got {len(data)} bytes that are none")
    return image


def decode(data: bytes) -> NDArray[Any] | None:
    """The image in a file's bytes, channels as OpenCV orders them; None when they are no image or a damaged one.

    Raises CaptureError for a PNG that claims more pixels than any camera has.
    """
    import cv2

    if data[:16] == _PNG and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        if width * height > MOST_PIXELS:
            raise CaptureError(f"expected an image of up to {MOST_PIXELS:g} pixels, got {width}x{height}")
    # OpenCV and libpng print complaints of their own about a PNG that is cut off or overwritten
    if not data or (data.startswith(_PNG[:8]) and not _whole_png(data)):
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None


def _whole_png(data: bytes) -> bool:
    """True when every chunk is there to the last, with the checksum that it says."""
    at, kind = 8, b""
    while kind != b"IEND":
        if at + 12 > len(data):
            return False
        size, kind = struct.unpack_from(">I4s", data, at)
        end = at + 8 + size
        if end + 4 > len(data) or zlib.crc32(data[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return False
        at = end + 4
    return True


def _write(path: Path, image: NDArray[Any]) -> None:
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    good, data = cv2.imencode(".png", image)
    if not good:
        raise CaptureError(f"{path}: the image of shape {image.shape} cannot be written as PNG")
    with named(path):
        path.write_bytes(data.tobytes())


def read_depth(path: Path, depth_scale: float) -> NDArray[np.float32]:
    """(h, w) float32 metres along z, 0 where there is no reading; depth_scale is millimetres per count.

    Raises CaptureError when the image is not 16 bit with one channel.
    """
    image = _read(path)
    if image.dtype != np.uint16 or image.ndim != 2:
        channels = 1 if image.ndim == 2 else image.shape[2]
        got = f"{8 * image.dtype.itemsize} bit, {channels} channel{'s'[: channels > 1]}"
        raise CaptureError(f"expected a depth image of 16 bit, 1 channel, got {got}")
    return (image.astype(np.float64) * (depth_scale * MM)).astype(np.float32)


def write_depth(path: Path, depth: NDArray[Any], depth_scale: float) -> None:
    """Write (h, w) metres as 16-bit counts of depth_scale millimetres; not finite or <= 0 becomes 0.

    Raises CaptureError when a reading is beyond what 16 bits hold.
    """
    metres = np.where(np.isfinite(depth) & (depth > 0), depth, 0.0).astype(np.float64)
    counts = np.rint(metres / (depth_scale * MM))
    if counts.max(initial=0) > LARGEST_COUNT:
        limit = LARGEST_COUNT * depth_scale * MM
        raise CaptureError(f"{path}: expected depths up to {limit:.3g} m at this depth_scale, got {metres.max():.3g} m")
    _write(path, counts.astype(np.uint16))


def read_counts(path: Path) -> NDArray[np.uint16]:
    """(h, w) uint16 as they are. Raises CaptureError when the image is not 16 bit with one channel."""
    image = _read(path)
    if image.dtype != np.uint16 or image.ndim != 2:
        channels = 1 if image.ndim == 2 else image.shape[2]
        got = f"{8 * image.dtype.itemsize} bit, {channels} channel{'s'[: channels > 1]}"
        raise CaptureError(f"expected an image of 16 bit, 1 channel, got {got}")
    return np.asarray(image, dtype=np.uint16)


def write_counts(path: Path, counts: NDArray[Any]) -> None:
    """Write (h, w) whole numbers of 0 to 65535. Raises CaptureError for others."""
    if not np.isfinite(counts).all() or counts.min(initial=0) < 0 or counts.max(initial=0) > LARGEST_COUNT:
        raise CaptureError(f"{path}: expected numbers from 0 to {LARGEST_COUNT}")
    _write(path, np.rint(counts).astype(np.uint16))


def read_gel_image(path: Path) -> NDArray[np.uint16] | NDArray[np.uint8]:
    """A gel's image: (h, w) uint16 micrometres of indentation, or (h, w, 3) uint8 colours, red first.

    Raises CaptureError for anything else.
    """
    image = _read(path)
    if image.dtype == np.uint16 and image.ndim == 2:
        return np.asarray(image, dtype=np.uint16)
    if image.dtype == np.uint8 and image.ndim == 3:
        return np.ascontiguousarray(image[:, :, 2::-1])
    channels = 1 if image.ndim == 2 else image.shape[2]
    got = f"{8 * image.dtype.itemsize} bit, {channels} channel{'s'[: channels > 1]}"
    raise CaptureError(f"expected a gel's image of 8 bit in colour, or of 16 bit in micrometres, got {got}")


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """(h, w, 3) uint8, red first; grey images are repeated, alpha is dropped. Raises CaptureError when not 8 bit."""
    image = _read(path)
    if image.dtype != np.uint8:
        raise CaptureError(f"expected a colour image of 8 bit, got {8 * image.dtype.itemsize} bit")
    if image.ndim == 2:
        image = np.repeat(image[:, :, None], 3, axis=2)
    return np.ascontiguousarray(image[:, :, 2::-1])


def write_rgb(path: Path, rgb: NDArray[np.uint8]) -> None:
    """Write (h, w, 3) uint8, red first."""
    _write(path, np.ascontiguousarray(rgb[:, :, ::-1]))


def read_mask(path: Path) -> NDArray[np.bool_]:
    """(h, w) bool: true where the image is not black."""
    image = _read(path)
    colours = image.reshape(*image.shape[:2], -1)[:, :, :3]  # not what is see-through
    return np.asarray((colours > 0).any(axis=2))


def write_mask(path: Path, mask: NDArray[np.bool_]) -> None:
    """Write (h, w) bool as 0 and 255."""
    _write(path, np.where(mask, 255, 0).astype(np.uint8))
