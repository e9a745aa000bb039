"""Gel sensors: a camera behind a soft pad that looks at how its skin is pressed in. Metres; pixels (u right, v down).

Sensor frame: z out of the finger, x and y along the image's columns and rows. The untouched skin is a height map over
the image. A pixel looks along its own line: parallel to z where the sensor says millimetres per pixel, through the
camera's centre (on the z axis, `distance` behind the plane z = 0) where it says intrinsics. Pressing moves the skin's
point on that line down by the indentation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError, PalpateError, unknown
from scenes.files.formats import images
from scenes.files.inside import stays_inside

Array = NDArray[np.float64]

# Heights of a skin and indentations are kept as 16-bit micrometres.
MICROMETRE = 1e-6
# Pixels of an image's side: fewer show no shape, more has no gel's camera.
SIDES = (8, 4096)
# Millimetres per pixel of any gel: from a microscope's to a hand's breadth over eight pixels.
PITCHES = (1e-4, 10.0)
# Focal lengths and principal points of a pinhole camera, in sides of the image (no unit): from a fisheye's to a
# telescope's, and no farther beside the image than its own side; other numbers are not in pixels.
FOCAL_LENGTHS = (0.1, 50.0)
CENTRES = (-1.0, 2.0)
# Share of a focal length that is rounding and no skew.
NEARLY_ZERO = 1e-6
# What the file may say of a gel, and of its camera.
KEYS = ("size", "mm_per_pixel", "camera", "surface", "thickness", "background", "calibration")
CAMERA_KEYS = ("cam_K", "distance")
# Pixels of the shorter side that are worked with: of a thumbnail-sized gel, every 0.15 mm.
WORKING_SIDE = 110
# The same where only what changes slowly is told: lamps, and how deep the skin is on the whole.
COARSE_SIDE = 30
# A channel at 255 in more than this share of an image shows no shape there.
SATURATED = 0.25
# Smoothing (pixels) of a background's brightness.
LEVEL_BLUR = 3.0
# Thickest gel (m) and the one assumed when a file does not say (a DIGIT's).
THICKEST = 0.05
USUAL_THICKNESS = 0.004


@dataclass(frozen=True, eq=False)
class Gel:
    """What a gel sensor is made of.

    width, height: of its images (pixels). pitch: metres per pixel of a camera that looks along z everywhere, or None
    and matrix (3, 3), distance (m) of a pinhole camera. surface (h, w): height (m) of the untouched skin over the plane
    z = 0. thickness (m) of the gel. background (h, w, 3) uint8, red first: the untouched skin's image, None when only
    indentations are recorded. calibration: photometric, as its file says it, or None.
    """

    width: int
    height: int
    surface: Array
    pitch: float | None = None
    matrix: Array | None = None
    distance: float | None = None
    thickness: float = USUAL_THICKNESS
    background: NDArray[np.uint8] | None = None
    calibration: Mapping[str, Any] | None = None

    @cached_property
    def rays(self) -> Array:
        """(h, w, 2): x and y that a pixel's line moves by for each metre of depth (pinhole), or where it stands (m)."""
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        if self.matrix is None:
            assert self.pitch is not None
            return np.stack([u - 0.5 * (self.width - 1), v - 0.5 * (self.height - 1)], axis=2) * self.pitch
        k = self.matrix
        y = (v - k[1, 2]) / k[1, 1]
        return np.stack([(u - k[0, 2] - k[0, 1] * y) / k[0, 0], y], axis=2)

    @cached_property
    def lines(self) -> tuple[Array, Array]:
        """(h, w, 3) directions of the pixels' lines, and (2, 3) how what is seen at the depth 1 (pinhole) or anywhere
        (parallel lines) moves from column to column and from row to row.
        """
        if self.matrix is None:
            assert self.pitch is not None
            upright = np.zeros((self.height, self.width, 3))
            upright[..., 2] = 1.0
            return upright, self.pitch * np.eye(3)[:2]
        k = self.matrix
        directions = np.concatenate([self.rays, np.ones((self.height, self.width, 1))], axis=2)
        skew = -k[0, 1] / (k[0, 0] * k[1, 1])
        return directions, np.array([[1.0 / k[0, 0], 0.0, 0.0], [skew, 1.0 / k[1, 1], 0.0]])

    def points(self, indentation: Array | float = 0.0) -> Array:
        """(h, w, 3) sensor frame (m): the skin when it is pressed in by `indentation` (m, (h, w) or one for all)."""
        z = self.surface - indentation
        across = self.rays if self.distance is None else self.rays * (self.distance + z)[..., None]
        return np.concatenate([across, z[..., None]], axis=2)

    @cached_property
    def spacing(self) -> float:
        """Distance (m) of neighbouring pixels on the skin, in its middle."""
        if self.pitch is not None:
            return self.pitch
        assert self.matrix is not None
        assert self.distance is not None
        middle = float(self.surface[self.height // 2, self.width // 2])
        return (self.distance + middle) / float(np.sqrt(self.matrix[0, 0] * self.matrix[1, 1]))

    @cached_property
    def level(self) -> NDArray[np.float32]:
        """(h, w, 3) brightness of the background without its grain, counts; zeros without a background."""
        import cv2

        if self.background is None:
            return np.zeros((self.height, self.width, 3), dtype=np.float32)
        return np.asarray(cv2.GaussianBlur(self.background.astype(np.float32), (0, 0), LEVEL_BLUR))

    @cached_property
    def working(self) -> Gel:
        """The gel with every k-th pixel only, so many that smoothed images lose nothing; itself when it is coarse."""
        return self if self.working_step == 1 else self.every(self.working_step)

    def every(self, step: int) -> Gel:
        """The gel with every step-th pixel of a row and column only, to be worked with as it is."""
        part = (slice(None, None, step), slice(None, None, step))
        surface = self.surface[part]
        background = None if self.background is None else np.ascontiguousarray(self.background[part])
        height, width = surface.shape
        pitch = None if self.pitch is None else step * self.pitch
        matrix = None if self.matrix is None else np.diag([1.0 / step, 1.0 / step, 1.0]) @ self.matrix
        thin = Gel(width, height, surface, pitch, matrix, self.distance, self.thickness, background, self.calibration)
        # the same lines of the same pixels, not those of an image whose middle is elsewhere
        thin.__dict__["rays"] = np.ascontiguousarray(self.rays[part])
        thin.__dict__["level"] = np.ascontiguousarray(self.level[part])
        thin.__dict__["working_step"] = 1
        return thin

    @cached_property
    def coarse_step(self) -> int:
        """Every so many-th pixel tells all that changes slowly over the image."""
        return max(1, min(self.width, self.height) // COARSE_SIDE)

    @cached_property
    def coarse(self) -> Gel:
        """The gel with every `coarse_step`-th pixel only."""
        return self if self.coarse_step == 1 else self.every(self.coarse_step)

    @cached_property
    def working_step(self) -> int:
        """Every so many-th pixel of a row or column is worked with."""
        return max(1, min(self.width, self.height) // WORKING_SIDE)

    @cached_property
    def untouched_normals(self) -> Array:
        """(h, w, 3) of the untouched skin."""
        return self.normals()

    def normals(self, indentation: Array | float = 0.0) -> Array:
        """(h, w, 3) unit normals of the skin, out of the finger, sensor frame."""
        points = self.points(indentation)
        normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
        length = np.linalg.norm(normal, axis=2, keepdims=True)
        return normal / np.maximum(length, 1e-300)

    def to_json(self) -> dict[str, Any]:
        """Its entry of sensors.json, without what is kept in files of its own."""
        entry: dict[str, Any] = {"size": [self.width, self.height], "thickness": float(self.thickness)}
        if self.matrix is None:
            assert self.pitch is not None
            entry["mm_per_pixel"] = 1e3 * self.pitch
        else:
            assert self.distance is not None
            entry["camera"] = {"cam_K": [float(x) for x in self.matrix.ravel()], "distance": float(self.distance)}
        return entry


def write_gel(gel: Gel, folder: Path, name: str) -> dict[str, Any]:
    """The entry of sensors.json, its images and calibration written into `folder`/gels, named after the sensor."""
    import json

    entry = gel.to_json()
    top = float(gel.surface.max())
    if np.ptp(gel.surface) > 0 or top:
        below = np.rint((top - gel.surface) / MICROMETRE)
        images.write_counts(folder / "gels" / f"{name}_surface.png", below)
        entry["surface"] = {"file": f"gels/{name}_surface.png", "top": top}
    if gel.background is not None:
        images.write_rgb(folder / "gels" / f"{name}_background.png", gel.background)
        entry["background"] = f"gels/{name}_background.png"
    if gel.calibration is not None:
        (folder / "gels").mkdir(exist_ok=True)
        text = json.dumps(dict(gel.calibration)) + "\n"
        (folder / "gels" / f"{name}_calibration.json").write_text(text, encoding="utf-8")
        entry["calibration"] = f"gels/{name}_calibration.json"
    return entry


def read_gel(entry: Any, where: str, folder: Path, within: Path | None = None) -> Gel:
    """A gel from its entry of sensors.json; files are named relative to `folder`. Raises InputError, one line.

    within: a folder out of which its files may not lie (CaptureError); by default anywhere.
    """
    where = f"{where}: gel"
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected an object with size and mm_per_pixel or camera, got {entry!r}")
    for place, known, part in ((where, KEYS, entry), (f"{where}: camera", CAMERA_KEYS, entry.get("camera"))):
        wrong = next((key for key in part if key not in known), None) if isinstance(part, dict) else None
        if wrong is not None:
            raise unknown(place, wrong, known, "keys of")
    size = numbers(entry.get("size"), 2, f"{where}: size")
    if (size != np.rint(size)).any() or not ((size >= SIDES[0]) & (size <= SIDES[1])).all():
        raise InputError(f"{where}: size: expected width and height of {SIDES[0]} to {SIDES[1]} pixels, got {size}")
    width, height = int(size[0]), int(size[1])
    pitch = matrix = distance = None
    if ("mm_per_pixel" in entry) == ("camera" in entry):
        raise InputError(f"{where}: expected one of mm_per_pixel and camera, got {', '.join(entry)}")
    if "mm_per_pixel" in entry:
        millimetres = float(numbers(entry["mm_per_pixel"], 1, f"{where}: mm_per_pixel")[0])
        if not PITCHES[0] <= millimetres <= PITCHES[1]:
            raise InputError(f"{where}: mm_per_pixel: expected {PITCHES[0]:g} to {PITCHES[1]:g}, got {millimetres:g}")
        pitch = 1e-3 * millimetres
    else:
        camera = entry["camera"] if isinstance(entry["camera"], dict) else {}
        matrix = numbers(camera.get("cam_K"), 9, f"{where}: camera: cam_K").reshape(3, 3)
        distance = float(numbers(camera.get("distance"), 1, f"{where}: camera: distance")[0])
        if min(matrix[0, 0], matrix[1, 1]) <= 0 or not 0 < distance < 1:
            raise InputError(f"{where}: camera: expected focal lengths (pixels) and distance (m, below 1) above 0")
        _check_intrinsics(matrix, (width, height), f"{where}: camera: cam_K")
    thickness = float(numbers(entry.get("thickness", USUAL_THICKNESS), 1, f"{where}: thickness")[0])
    if not 0 < thickness <= THICKEST:
        raise InputError(f"{where}: thickness: expected metres above 0, up to {THICKEST:g}, got {thickness:g}")
    surface = _surface(entry.get("surface"), (height, width), f"{where}: surface", folder, within)
    if distance is not None and (surface <= -0.9 * distance).any():
        raise InputError(f"{where}: surface: expected a skin before the camera, got one {-surface.min():.3g} m below 0")
    background = None
    if entry.get("background") is not None:
        background = _file(entry["background"], f"{where}: background", folder, within, images.read_rgb)
        _check_size(background, (height, width), f"{where}: background")
    calibration = None
    if entry.get("calibration") is not None:
        calibration = _file(entry["calibration"], f"{where}: calibration", folder, within, _read_json)
    return Gel(width, height, surface, pitch, matrix, distance, thickness, background, calibration)


def _check_intrinsics(matrix: Array, size: tuple[int, int], where: str) -> None:
    """Raise InputError for a K (3, 3) that no pinhole camera with images of this size (pixels) has; skew may be."""
    tiny = NEARLY_ZERO * float(matrix[0, 0])
    last = (0.0, 0.0, 1.0)
    if not (np.abs(matrix[2] - last) <= tiny).all():
        hint = ": is it transposed?" if (np.abs(matrix[:, 2] - last) <= tiny).all() else ""
        raise InputError(f"{where}: expected a K whose last row is 0 0 1, got {matrix[2]}{hint}")
    if abs(matrix[1, 0]) > tiny:
        raise InputError(f"{where}: expected a K with 0 before fy, got {matrix[1, 0]:.3g}")
    low, high = FOCAL_LENGTHS
    for name, axis in (("x", 0), ("y", 1)):
        focal, centre = float(matrix[axis, axis]), float(matrix[axis, 2])
        if not low <= focal / max(size) <= high:
            raise InputError(f"{where}: expected f{name} in pixels, got {focal:g} for {size[0]}x{size[1]} pixels")
        if not CENTRES[0] <= centre / size[axis] <= CENTRES[1]:
            raise InputError(f"{where}: expected c{name} near the image, got {centre:g} for {size[axis]} pixels")


def image_problem(image: NDArray[Any], gel: Gel) -> str | None:
    """What makes an image none of this gel's: another size, colours without a background, saturated; None when good.

    image: (h, w) micrometres of indentation, or (h, w, 3) uint8 colours.
    """
    if image.shape[:2] != (gel.height, gel.width):
        got = f"{image.shape[1]}x{image.shape[0]}"
        return f"expected an image of {gel.width}x{gel.height} pixels as the gel's, got {got}"
    if image.ndim == 2:
        deepest = MICROMETRE * float(image.max(initial=0))
        if deepest > gel.thickness:
            return f"expected indentations up to the gel's {1e3 * gel.thickness:g} mm, got {1e3 * deepest:.3g} mm"
        return None
    if gel.background is None:
        return "expected the untouched background for a colour image, the sensor has none"
    lowest, highest = image.min(), image.max()
    if lowest == highest:
        return "expected an image of the gel, got one colour all over"
    if highest < 255:
        return None
    for channel, name in enumerate(("red", "green", "blue")):
        share = float(np.mean(image[:, :, channel] == 255))
        if share > SATURATED:
            return f"expected colours below 255, got {name} saturated in {100 * share:.0f} % of the image"
    return None


def check_image(image: NDArray[Any], gel: Gel, where: str) -> None:
    """Raise InputError, one line beginning with `where`, for an `image_problem`."""
    problem = image_problem(image, gel)
    if problem is not None:
        raise InputError(f"{where}: {problem}")


def dome(width: int, height: int, rays: Array, distance: float, radius: float, drop: float, reach: float) -> Array:
    """(h, w) heights (m) of a skin bulged as a cap of a sphere of `radius` (m), its sag scaled so that it is `drop` (m)
    lower at `reach` (m) from its top; over a pinhole camera's rays (h, w, 2), `distance` (m) below the top.
    """
    most = radius - np.sqrt(radius**2 - min(reach, 0.999 * radius) ** 2)
    z = np.zeros((height, width))
    for _ in range(20):  # the skin is flat beside the rays: each step is ten times nearer
        square = ((rays * (distance + z)[..., None]) ** 2).sum(axis=2)
        z = -drop * (radius - np.sqrt(np.maximum(radius**2 - square, 0.0))) / most
    return z


def _surface(entry: Any, shape: tuple[int, int], where: str, folder: Path, within: Path | None) -> Array:
    if entry is None or entry == "flat":
        return np.zeros(shape)
    if not isinstance(entry, dict) or "file" not in entry:
        raise InputError(f'{where}: expected "flat" or an object with file and top, got {entry!r}')
    top = float(numbers(entry.get("top", 0.0), 1, f"{where}: top")[0])
    below = _file(entry["file"], where, folder, within, images.read_counts)
    _check_size(below, shape, where)
    return top - MICROMETRE * below.astype(np.float64)


def _check_size(image: NDArray[Any], shape: tuple[int, int], where: str) -> None:
    if image.shape[:2] != shape:
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"{where}: expected an image of {shape[1]}x{shape[0]} pixels as the gel's, got {got}")


def _file(name: Any, where: str, folder: Path, within: Path | None, read: Any) -> Any:
    if not isinstance(name, str):
        raise InputError(f"{where}: expected a file name, got {name!r}")
    path = stays_inside(folder / name, within, where)
    if not path.is_file():
        raise InputError(f"{where}: expected the file {path}, found none")
    try:
        return read(path)
    except PalpateError as error:
        raise InputError(f"{where}: {path}: {error}") from error


def _read_json(path: Path) -> dict[str, Any]:
    from scenes.files.formats.json_text import parsed

    try:
        content = parsed(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise InputError(f"expected JSON, got malformed text: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"expected an object, got {type(content).__name__}")
    return content


def numbers(values: Any, count: int, where: str) -> Array:
    """(count,) finite float64; raises InputError."""
    try:
        array = np.atleast_1d(np.array(values, dtype=np.float64)).ravel()
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: expected {count} numbers, got {values!r}") from error
    if len(array) != count or not np.isfinite(array).all():
        raise InputError(f"{where}: expected {count} finite numbers, got {values!r}")
    return array
