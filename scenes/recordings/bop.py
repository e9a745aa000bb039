"""BOP's JSON and CSV files, in and out: the only place where millimetres become metres.

scene_camera, scene_gt, models_info and the results' poses.csv of the BOP benchmark (Hodan et al., BOP: Benchmark for 6D
object pose estimation, ECCV 2018; format described in bop_toolkit). Everything on this side is metres.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError
from scenes.files.formats.images import MM
from scenes.files.formats.json_text import each_once, parsed
from scenes.files.problems import Problem, Report
from scenes.files.whole import replace_file
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.symmetries import Axis, Symmetries

Array = NDArray[np.float64]

# Millimetres per count of a depth image: with less its 65535 counts reach no hand, with more the first is a metre off.
DEPTH_SCALES = (1e-4, 1e3)
POSES_HEADER = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")


@dataclass(frozen=True)
class SceneCamera:
    """One entry of scene_camera.json.

    matrix: K (3, 3), pixels; depth_scale: millimetres per count of the depth image;
    camera_from_world (4, 4), None when not given; size (width, height), None when not given (not in BOP).
    """

    matrix: Array
    depth_scale: float
    camera_from_world: Array | None
    size: tuple[int, int] | None


@dataclass(frozen=True)
class PoseRow:
    """One row of poses.csv: camera_from_object (4, 4) metres; time in seconds, -1 when unknown."""

    scene_id: int
    im_id: int
    obj_id: int
    score: float
    pose: Array
    time: float


def read_json(path: str | Path, report: Report) -> Any:
    """The content of a JSON file, None after a report when there is none."""
    try:
        return parsed(Path(path).read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        report(Problem(str(path), None, "expected a JSON file, found none"))
    except UnicodeDecodeError:
        report(Problem(str(path), None, "expected UTF-8 text, got other bytes"))
    except OSError as error:
        report(Problem(str(path), None, f"cannot be read: {error.strerror}"))
    except (ValueError, RecursionError) as error:
        report(Problem(str(path), None, f"expected JSON: {error}"))
    return None


def write_json(path: str | Path, content: Any) -> None:
    """Strict JSON: NaN is refused, for a reader elsewhere would stumble over it."""
    replace_file(Path(path), (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


# Frames are counted in 64 bits.
LARGEST_FRAME = 2**63 - 1
# Python reads no numbers of thousands of digits, and nobody counts so far.
MOST_DIGITS = 100


class FrameEntries(Mapping[int, Any]):
    """Entries of a JSON file by frame number, read again when they are asked for: an hour of recording has a hundred
    thousand. Raises CaptureError for a file that has changed meanwhile.
    """

    def __init__(self, path: Path, places: Mapping[int, tuple[int, int]]) -> None:
        """places: first byte of each frame's entry, and the byte after it."""
        self._path = path
        if max(places, default=0) > LARGEST_FRAME:
            raise CaptureError(f"{path}: expected frame numbers below 2^63, got {str(max(places))[:30]}")
        self._places = np.array([(frame, *place) for frame, place in places.items()], dtype=np.int64).reshape(-1, 3)
        self._order = np.argsort(self._places[:, 0], kind="stable")

    def __getitem__(self, frame: int) -> Any:
        row = self._row(frame)
        if row is None:
            raise KeyError(frame)
        first, after = map(int, self._places[row, 1:])
        try:
            with self._path.open("rb") as file:
                file.seek(first)
                return json.loads(file.read(after - first))
        except (OSError, ValueError) as error:
            raise CaptureError(
                f"{self._path}, frame {frame}: expected the file as it was when it was opened"
            ) from error

    def __contains__(self, frame: object) -> bool:
        return isinstance(frame, int) and self._row(frame) is not None

    def __iter__(self) -> Iterator[int]:
        return iter(self._places[:, 0].tolist())

    def __len__(self) -> int:
        return len(self._places)

    def _row(self, frame: int) -> int | None:
        at = int(np.searchsorted(self._places[:, 0], frame, sorter=self._order))
        row = int(self._order[at]) if at < len(self._order) else -1
        return row if row >= 0 and self._places[row, 0] == frame else None


def read_frames(path: str | Path, report: Report) -> Mapping[int, Any]:
    """A JSON object keyed by frame number, as {frame: entry}."""
    places = _frame_places(Path(path))
    if places is not None:
        return FrameEntries(Path(path), places)
    content = read_json(path, report)
    if content is None:
        return {}
    if not isinstance(content, dict):
        report(Problem(str(path), None, f"expected an object keyed by frame, got {type(content).__name__}"))
        return {}
    frames = {}
    for key, entry in content.items():
        if key.isdecimal() and len(key) <= MOST_DIGITS:
            if int(key) in frames:
                report(Problem(str(path), int(key), f"expected each frame once, got it twice, once as {key[:40]!r}"))
            frames[int(key)] = entry
        else:
            report(Problem(str(path), None, f"expected frame numbers as keys, got {key[:40]!r}"))
    return frames


_BLANK = re.compile(r"[ \t\n\r]*")


def _frame_places(path: Path) -> dict[int, tuple[int, int]] | None:
    """First byte of each entry of a JSON object keyed by frame, and the byte after it; None for any other file."""
    decoder = json.JSONDecoder(object_pairs_hook=each_once)
    places: dict[int, tuple[int, int]] = {}
    try:
        content = path.read_bytes()
        text = content.decode("utf-8-sig")
        if not text.isascii():  # then bytes are not characters
            return None
        mark_of_order = len(content) - len(text)
        at, mark = _past(text, 0, "{"), ","
        if text[at] == "}":
            at, mark = _blank(text, at + 1), "}"
        while mark == ",":
            key, end = decoder.raw_decode(text, at)
            if not key.isdecimal() or len(key) > MOST_DIGITS or int(key) in places:
                return None
            start = _past(text, end, ":")
            _, end = decoder.raw_decode(text, start)
            places[int(key)] = (mark_of_order + start, mark_of_order + end)
            end = _blank(text, end)
            at, mark = _blank(text, end + 1), text[end]
        return places if mark == "}" and at == len(text) else None
    except (OSError, ValueError, IndexError, AttributeError, RecursionError):
        return None


def _blank(text: str, at: int) -> int:
    """Where what comes next begins."""
    found = _BLANK.match(text, at)
    return at if found is None else found.end()


def _past(text: str, at: int, mark: str) -> int:
    """Where what comes after a mark begins; raises ValueError for another mark."""
    at = _blank(text, at)
    if text[at] != mark:
        raise ValueError(f"expected {mark}")
    return _blank(text, at + 1)


def numbers(value: Any, count: int, what: str) -> Array:
    """A flat (count,) array of finite numbers from JSON; raises InputError naming `what`."""
    if value is None:  # NumPy makes NaN of it
        raise InputError(f"{what}: expected {count} finite number{'s'[: count > 1]}, got nothing (null)")
    try:
        array = np.array(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: expected {count} numbers, got {str(value)[:60]}") from error
    if len(array) != count:
        raise InputError(f"{what}: expected {count} finite numbers, got {len(array)}: {str(value)[:60]}")
    if not np.isfinite(array).all():
        place = int(np.argmin(np.isfinite(array)))
        which = f" as number {place + 1} of them" if count > 1 else ""
        raise InputError(f"{what}: expected {count} finite numbers, got {array[place]:g}{which}")
    return array


def _rigid(entry: dict[str, Any], rotation: str, translation: str) -> Array:
    for key in (rotation, translation):
        if key not in entry:
            raise InputError(f"expected {key}, got {', '.join(entry) or 'nothing'}")
    matrix = numbers(entry[rotation], 9, rotation).reshape(3, 3)
    return poses.check_pose(poses.make_pose(matrix, numbers(entry[translation], 3, translation) * MM), rotation)


def camera_entry(entry: Any) -> SceneCamera:
    """One frame of scene_camera.json; raises InputError."""
    if not isinstance(entry, dict) or "cam_K" not in entry:
        raise InputError(f"expected an object with cam_K, got {str(entry)[:60]}")
    matrix = numbers(entry["cam_K"], 9, "cam_K").reshape(3, 3)
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or not np.allclose(matrix[2], (0, 0, 1)):
        raise InputError(f"cam_K: expected fx 0 cx 0 fy cy 0 0 1 with focal lengths above 0, got {entry['cam_K']}")
    if abs(matrix[0, 1]) > 1e-6 * matrix[0, 0]:
        raise InputError(f"cam_K: expected no skew, got {matrix[0, 1]:.3g}")
    scale = float(numbers(entry.get("depth_scale", 1.0), 1, "depth_scale")[0])
    if not DEPTH_SCALES[0] <= scale <= DEPTH_SCALES[1]:
        low, high = DEPTH_SCALES
        raise InputError(f"depth_scale: expected millimetres per count from {low:g} to {high:g}, got {scale:g}")
    world = None
    if "cam_R_w2c" in entry or "cam_t_w2c" in entry:
        world = _rigid(entry, "cam_R_w2c", "cam_t_w2c")
    size = None
    if "width" in entry and "height" in entry:
        width, height = numbers([entry["width"], entry["height"]], 2, "width, height")
        size = (int(width), int(height))
    return SceneCamera(matrix, scale, world, size)


def rgb_camera_entry(entry: Any) -> tuple[Array, Array]:
    """Intrinsics (3, 3) of a frame's colour camera, and rgb_from_depth (4, 4) in metres, of rgb_camera.json."""
    if not isinstance(entry, dict) or "cam_K" not in entry:
        raise InputError(f"expected an object with cam_K, cam_R_d2c, cam_t_d2c, got {str(entry)[:60]}")
    return camera_entry({"cam_K": entry["cam_K"]}).matrix, _rigid(entry, "cam_R_d2c", "cam_t_d2c")


def camera(entry: SceneCamera, shape: tuple[int, ...] | None) -> Camera:
    """The pinhole camera of images of `shape` (h, w); without an image the size is the entry's, or twice the centre.

    Raises InputError where the entry's size is not the image's: its intrinsics are of another image then.
    """
    if shape is not None:
        height, width = shape[:2]
        if entry.size is not None and entry.size != (width, height):
            told = "x".join(map(str, entry.size))
            raise InputError(
                f"width, height: expected the image's {width}x{height} pixels, got {told}: cam_K is of those"
            )
    elif entry.size is not None:
        width, height = entry.size
    else:
        width, height = (max(1, round(2 * float(c) + 1)) for c in entry.matrix[:2, 2])
    return Camera.from_matrix(entry.matrix, width, height)


def camera_json(camera: SceneCamera) -> dict[str, Any]:
    """The entry of scene_camera.json."""
    entry: dict[str, Any] = {"cam_K": camera.matrix.ravel().tolist(), "depth_scale": camera.depth_scale}
    if camera.camera_from_world is not None:
        entry["cam_R_w2c"] = camera.camera_from_world[:3, :3].ravel().tolist()
        entry["cam_t_w2c"] = (camera.camera_from_world[:3, 3] / MM).tolist()
    if camera.size is not None:
        entry["width"], entry["height"] = camera.size
    return entry


def truth_entry(entry: Any, object_id: int) -> tuple[Array, int] | None:
    """camera_from_object (4, 4) and the row of the object among a frame's ground truths; None when it is not there."""
    if not isinstance(entry, list) or not all(isinstance(row, dict) for row in entry):
        raise InputError(f"expected a list of objects with obj_id, cam_R_m2c, cam_t_m2c, got {str(entry)[:60]}")
    for index, row in enumerate(entry):
        if row.get("obj_id", object_id) == object_id:
            return _rigid(row, "cam_R_m2c", "cam_t_m2c"), index
    return None


def truth_json(pose: Array, object_id: int) -> list[dict[str, Any]]:
    """A frame's entry of scene_gt.json."""
    return [{"obj_id": object_id, "cam_R_m2c": pose[:3, :3].ravel().tolist(), "cam_t_m2c": (pose[:3, 3] / MM).tolist()}]


def prior_entry(entry: Any) -> Array:
    """A frame's camera_from_object in metres: 4x4 nested or 16 numbers; raises InputError."""
    return poses.check_pose(numbers(entry, 16, "prior").reshape(4, 4), "prior")


def read_priors(path: str | Path, report: Report) -> dict[int, Array]:
    """A prior.json: frame -> camera_from_object (4, 4) metres."""

    def checked(frame: int, entry: Any) -> Array | None:
        try:
            return prior_entry(entry)
        except InputError as error:
            report(Problem(str(path), frame, str(error)))
            return None

    priors = {frame: checked(frame, entry) for frame, entry in read_frames(path, report).items()}
    return {frame: prior for frame, prior in priors.items() if prior is not None}


def symmetries_entry(entry: dict[str, Any]) -> Symmetries:
    """The symmetries of one object of models_info.json, in metres; raises InputError."""
    discrete = [np.eye(4)]
    for rows in _symmetries_of(entry, "symmetries_discrete"):
        member = numbers(rows, 16, "symmetries_discrete").reshape(4, 4)
        member[:3, 3] *= MM
        discrete.append(poses.check_pose(member, "symmetries_discrete"))
    axes = []
    for row in _symmetries_of(entry, "symmetries_continuous"):
        if not isinstance(row, dict) or "axis" not in row:
            raise InputError(f"symmetries_continuous: expected objects with axis and offset, got {str(row)[:60]}")
        axis = numbers(row["axis"], 3, "symmetries_continuous axis")
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise InputError("symmetries_continuous axis: expected a direction, got zero")
        axes.append(Axis(numbers(row.get("offset", [0, 0, 0]), 3, "symmetries_continuous offset") * MM, axis / length))
    return Symmetries(np.array(discrete), tuple(axes))


def _symmetries_of(entry: dict[str, Any], name: str) -> list[Any]:
    rows = entry.get(name, [])
    if not isinstance(rows, list):
        raise InputError(f"{name}: expected a list of symmetries, got {str(rows)[:60]}")
    return rows


def model_json(vertices: Array, diameter: float, symmetries: Symmetries) -> dict[str, Any]:
    """One object's entry of models_info.json (millimetres), from metres."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    entry: dict[str, Any] = {"diameter": diameter / MM}
    for name, a, b in zip("xyz", low, high, strict=True):
        entry[f"min_{name}"], entry[f"size_{name}"] = float(a) / MM, float(b - a) / MM
    members = []
    for member in symmetries.discrete:
        if not np.allclose(member, np.eye(4), atol=1e-12):
            scaled = np.array(member)
            scaled[:3, 3] /= MM
            members.append(scaled.ravel().tolist())
    if members:
        entry["symmetries_discrete"] = members
    if symmetries.axes:
        entry["symmetries_continuous"] = [
            {"axis": axis.direction.tolist(), "offset": (axis.point / MM).tolist()} for axis in symmetries.axes
        ]
    return entry


def write_poses(path: str | Path, rows: Iterable[PoseRow]) -> None:
    """Write poses.csv in BOP's format: R row-major, t in millimetres, time in seconds; whole or not at all."""
    replace_file(Path(path), f"{','.join(POSES_HEADER)}\n{pose_lines(rows)}".encode())


def pose_lines(rows: Iterable[PoseRow]) -> str:
    """The rows as lines of a poses.csv, without its header."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    for row in rows:
        rotation = " ".join(repr(x) for x in row.pose[:3, :3].ravel().tolist())
        translation = " ".join(repr(x) for x in (row.pose[:3, 3] / MM).tolist())
        cells = (row.scene_id, row.im_id, row.obj_id, repr(float(row.score)), rotation, translation)
        writer.writerow([*cells, repr(float(row.time))])
    return text.getvalue()


def read_poses(path: str | Path) -> list[PoseRow]:
    """Read poses.csv; raises CaptureError with file and line."""
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: expected UTF-8 text, got other bytes") from error
    except OSError as error:
        raise CaptureError(f"{path}: expected a poses.csv, it cannot be opened: {error.strerror}") from error
    table = csv.DictReader(lines)
    missing = [name for name in POSES_HEADER if name not in (table.fieldnames or [])]
    if missing:
        raise CaptureError(f"{path}: expected the header {','.join(POSES_HEADER)}, missing {', '.join(missing)}")
    rows = []
    for row in table:
        where = f"{path}, line {table.line_num}"
        try:
            rotation = numbers(_split(row["R"]), 9, "R").reshape(3, 3)
            translation = numbers(_split(row["t"]), 3, "t") * MM
            pose = poses.check_pose(poses.make_pose(rotation, translation), "R")
            ids = [int(row[name]) for name in POSES_HEADER[:3]]
            score, time = float(row["score"]), float(row["time"])
        except (InputError, TypeError, ValueError) as error:
            raise CaptureError(f"{where}: {error}") from error
        if not math.isfinite(score):
            raise CaptureError(f"{where}: expected a finite score, got {score}")
        rows.append(PoseRow(ids[0], ids[1], ids[2], score, pose, time))
    return rows


def _split(cell: str | None) -> list[str]:
    return (cell or "").split()
