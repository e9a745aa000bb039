"""Every problem of a capture at once, and the suspicion that a unit is wrong.

Validation reads the capture with the very code that an estimate reads it with, only that problems are collected.
"""

from __future__ import annotations

from collections.abc import Callable
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError, PalpateError
from scenes.files.problems import Problem
from scenes.files.schema import complaints
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings import bop
from scenes.recordings.captures import CSV_FILES, Capture
from scenes.recordings.checking.frame_problems import NOWHERE, frame_doubts, frame_problems, hand_doubts
from scenes.recordings.checking.strays import masks_of_none, spare_masks, strays
from scenes.recordings.frames import Contacts, Frame
from scenes.recordings.manifest import frame_stamps
from scenes.words import counted

__all__ = [
    "Problem",
    "check_are_contacts",
    "check_below_object",
    "check_is_frame",
    "check_is_model",
    "check_scale",
    "check_seed",
    "check_usable",
    "neglected",
    "scale_problem",
    "usable",
    "validate",
]

Array = NDArray[np.float64]

# Sizes or distances that disagree by more than this were written in different units (the closest confusion is m and
# cm, a factor of 10; a half-hidden view or a rough start explains a factor of 2).
SUSPICIOUS_RATIO = 5.0
# Of the readings about an object this share shows it or what hides it, however thin it is; the others may be of a wall
# far behind (of the ball around a pipe a twentieth is pipe).
SHOWN = 0.02
# What hides an object is not this many times nearer to the lens; a unit mistaken makes 100 or 1000 of it.
NEAREST_RATIO = 50.0
# A cloud may show the whole scene: only a size that no table-top has is suspicious then.
LARGEST_SCENE_RATIO = 50.0
# Focal lengths (of the image's larger side) between a fisheye's and a telescope's; anything else is not in pixels.
FOCAL_LENGTHS = (0.1, 50.0)
# Nothing that is held or holds is farther from the camera or from what is felt (m); a millimetre read as a metre is.
FARTHEST_HELD = 20.0
# A joint that is farther than this (rad) beyond its limits was given in degrees.
FULL_TURN = 2.0 * np.pi
# A median depth (m) that no room has, and an image of millimetres has from 10 cm on; beyond are no readings at all.
MILLIMETRES = (1e2, 1e6)
# Of a depth image every so manieth pixel a side tells its unit as well.
UNIT_STEP = 8
# Of a cloud no more points than this tell its size as well.
MOST_POINTS = 20_000
# About so many pixels around an object tell how far it is.
MOST_READINGS = 2_000
# What an answer is sure to be within (m) where nobody says.
USUAL_ACCURACY = 0.005
# Fewer points may show a small part of what they are of.
FEWEST_POINTS = 30


def validate(
    folder: str | Path, trust_paths: bool = False, doubts: Callable[[Problem], None] | None = None
) -> list[Problem]:
    """Every problem of a capture, in the order of its files and frames; an empty list means that it can be used.

    trust_paths: as for `read_capture`; doubts: called with what may be right and seldom is, each kind once.
    """
    problems: list[Problem] = []
    try:
        capture = Capture(folder, problems.append, trust_paths)
    except CaptureError as error:
        return [*problems, Problem(str(folder), None, str(error))]
    problems += _by_schema(capture, problems)
    problems += _stamp_problems(capture)
    problems += _strays(capture)
    model = _attempt(capture, problems)
    nowhere = True
    doubted: dict[str, list[Problem]] = {}
    for number in capture.frame_ids:
        frame = capture.frame(number)
        nowhere = nowhere and frame.hand_lacks == NOWHERE
        if not any(problem.frame == number for problem in problems):  # what follows from the broken is not news
            problems += frame_problems(capture.path, frame)
        message = None if model is None else scale_problem(frame, model)
        if message is not None:
            problems.append(Problem(str(capture.path), number, message))
        if doubts is not None and not any(problem.frame == number for problem in problems):
            for kind, doubt in frame_doubts(capture.path, frame).items():
                doubted.setdefault(kind, []).append(doubt)
    if nowhere and capture.frame_ids:
        message = f"expected the hand's {NOWHERE} in a frame at least, found none: the hand is left out"
        problems.append(Problem(str(capture.path / "hand_poses.csv"), None, message))
    if doubts is not None:
        alone = [[doubt] for doubt in _hand_doubts(capture)]
        for first, *alike in filter(None, (*alone, *doubted.values(), _other_objects(capture), _spare_masks(capture))):
            more = f" ({counted(len(alike), 'more frame')} alike)" if alike else ""
            doubts(Problem(first.file, first.frame, first.message + more))
    return list(dict.fromkeys(problems))


def _other_objects(capture: Capture) -> list[Problem]:
    """Frames with the truth of other objects and none of the capture's: it is passed over."""
    path, own = capture.path / "scene_gt.json", capture.manifest.object_id
    found = []
    for number, rows in bop.read_frames(path, lambda problem: None).items() if path.is_file() else ():
        told = [row.get("obj_id", own) for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
        if told and own not in told:
            others = ", ".join(dict.fromkeys(map(str, told)))
            message = f"expected the truth of obj_id {own}, as capture.json has it, got {others[:60]}"
            found.append(Problem(str(path), number, message))
    return found


def _spare_masks(capture: Capture) -> list[Problem]:
    """Masks of rows that scene_gt.json has not."""
    path = capture.path / "scene_gt.json"
    told = bop.read_frames(path, lambda problem: None) if path.is_file() else {}
    rows = {number: told.get(number) for number in capture.frame_ids}
    return list(spare_masks(capture.path, {n: len(row) if isinstance(row, list) else 0 for n, row in rows.items()}))


def _sensors_file(capture: Capture) -> Path:
    """The sensors.json of the capture's hand."""
    hand = capture.manifest.hand
    return capture.path / ((hand and (hand[1] or Path(hand[0]).parent / "sensors.json")) or "capture.json")


def _hand_doubts(capture: Capture) -> list[Problem]:
    try:
        hand = capture.hand
    except PalpateError:
        return []
    return [] if hand is None else hand_doubts(hand, _sensors_file(capture))


def neglected(capture: Capture) -> list[Problem]:
    """What `validate` refuses and an estimate can do without: masks of no frame, times that are none."""
    return [*_stamp_problems(capture), *masks_of_none(capture.path, capture.frame_ids)]


def _by_schema(capture: Capture, known: list[Problem]) -> list[Problem]:
    """What the schemas find in capture.json and the hand's sensors.json, when nothing is known of these files yet."""
    files = {"capture": capture.path / "capture.json"}
    hand = capture.manifest.hand
    if hand is not None:
        files["sensors"] = _sensors_file(capture)
    found = []
    for name, path in files.items():
        if path.is_file() and not any(problem.file == str(path) for problem in known):
            content = bop.read_json(path, lambda problem: None)
            if content is not None:
                found += [Problem(str(path), None, complaint) for complaint in complaints(content, name)]
    return found


def _strays(capture: Capture) -> list[Problem]:
    """What is there under another name than is read."""
    content = bop.read_json(capture.path / "capture.json", lambda problem: None)
    return list(strays(capture.path, capture.frame_ids, content, CSV_FILES))


def _stamp_problems(capture: Capture) -> list[Problem]:
    """What is wrong with the notes' times of the frames."""
    try:
        frame_stamps(capture.manifest.notes, capture.frame_ids)
    except InputError as error:
        return [Problem(str(capture.path / "capture.json"), None, str(error))]
    return []


def _attempt(capture: Capture, problems: list[Problem]) -> ObjectModel | None:
    try:
        return capture.model
    except PalpateError as error:
        manifest, model = str(capture.path / "capture.json"), str(capture.path / capture.manifest.model)
        problems.append(Problem(manifest if str(error).startswith(manifest) else model, None, str(error)))
        return None


def check_usable(frame: Frame, model: ObjectModel, vision: bool = True) -> None:
    """Raise CaptureError for a frame that no estimate should be made of: a depth image without a single reading (when
    `vision` is asked for), or sizes that tell of a wrong unit.
    """
    if vision and frame.depth is not None and not (frame.depth > 0).any():
        raise CaptureError(f"{frame.where or f'frame {frame.index}'}: expected depth readings, got an image of zeros")
    check_scale(frame, model)


def usable(
    capture: Capture,
    number: int,
    model: ObjectModel,
    prepare: Callable[[Frame, ObjectModel], Frame] | None = None,
    vision: bool = True,
) -> Frame:
    """The capture's frame of that number, as `prepare` has it; raises CaptureError for one that no estimate should be
    made of: its files are broken, there is nothing in them, or they tell of a wrong unit.
    """
    frame = capture.frame(number)
    frame = frame if prepare is None else prepare(frame, model)
    check_usable(frame, model, vision)
    return frame


def check_is_frame(frame: object) -> None:
    """Raises InputError for what is no Frame."""
    _check_is("frame", frame, Frame, "read_capture(folder)[0], or Frame(0, …)")


def check_is_model(model: object) -> None:
    """Raises InputError for what is no ObjectModel."""
    _check_is("model", model, ObjectModel, "ObjectModel.load(path)")


def check_are_contacts(contacts: object) -> None:
    """Raises InputError for what is no Contacts."""
    _check_is("contacts", contacts, Contacts, "Contacts(points, normals)")


def check_seed(seed: Any) -> None:
    """Raises InputError for what is no whole number from 0."""
    if not isinstance(seed, Integral) or isinstance(seed, bool) or seed < 0:
        raise InputError(f"seed: expected a whole number from 0, got {seed!r}")


def check_below_object(what: str, metres: float, model: ObjectModel) -> None:
    """Raise InputError for an accuracy (m) that the object anywhere in reach has: coarser than its own diameter, and
    than what is asked for where nobody says.
    """
    if metres > max(model.diameter, USUAL_ACCURACY):
        limit = f"metres up to the object's diameter of {model.diameter:.3g} m"
        raise InputError(f"{what}: expected {limit}, got {metres:g} m: mm read as m?")


def _check_is(what: str, value: object, kind: type, how: str) -> None:
    if not isinstance(value, kind):
        raise InputError(f"{what}: expected {kind.__name__} ({how}), got {type(value).__name__}")


def check_scale(frame: Frame, model: ObjectModel) -> None:
    """Raise CaptureError, naming both sizes, when the model's unit and the frame's cannot both be metres.

    Raises InputError for what is no frame or no model.
    """
    check_is_frame(frame)
    check_is_model(model)
    message = scale_problem(frame, model)
    if message is not None:
        raise CaptureError(f"{frame.where or f'frame {frame.index}'}: {message}")


def scale_problem(frame: Frame, model: ObjectModel) -> str | None:
    """What makes one suspect a wrong unit in this frame, with both sizes; None when all agree.

    Compared with the image: the focal lengths. With the hand's limits: the joints. With the object's diameter: the
    extents of most contacts and of the cloud, and the noise of most contacts. With the camera's place and the contacts:
    the hand's. With the poses known from ground truth and prior: the nearest depths around the object's projection, the
    contacts' distance from it and the camera's.
    """
    camera = frame.camera
    if camera is not None and frame.depth is not None:
        side = max(frame.depth.shape)
        if not all(FOCAL_LENGTHS[0] < focal / side < FOCAL_LENGTHS[1] for focal in (camera.fx, camera.fy)):
            size = f"{frame.depth.shape[1]}x{frame.depth.shape[0]}"
            return f"expected cam_K in pixels, got focal lengths of {camera.fx:.4g}, {camera.fy:.4g} for {size} pixels"
    if frame.hand is not None and frame.joints is not None:
        for joint, excess in frame.hand.limit_excess(frame.joints).items():
            if excess > FULL_TURN:
                return f"expected joints in rad, got {joint} {excess:.3g} beyond its limits: degrees read as rad?"
    diameter = model.diameter
    points = frame.contacts.points
    if len(points) > 1:
        # of most: a fingertip that reports nonsense is one contact that is false, a unit mistaken moves them all
        middle = _middle(points)
        extent = 2.0 * _quantile(np.linalg.norm(points - middle, axis=1), 0.5)
        if extent > SUSPICIOUS_RATIO * diameter:
            return _says("contacts spread over", extent, "an object of", diameter)
    told = frame.contacts.sigma_told
    if told.any():
        sigma = _quantile(frame.contacts.sigma_point[told], 0.5)
        if sigma > diameter:
            return _says("a sigma_point of", sigma, "an object of", diameter, "mm read as m?")
    if frame.cloud is not None and len(frame.cloud) > 1:
        extent, few = _extent(frame.cloud), len(frame.cloud) < FEWEST_POINTS
        # one place, or no number at all, has no unit to be wrong
        if extent > LARGEST_SCENE_RATIO * diameter or (0.0 < extent < diameter / SUSPICIOUS_RATIO and not few):
            return _says("a cloud that spreads over", extent, "an object of", diameter)
    far = _far_hand(frame)
    if far is not None:
        return far
    known = (("ground truth", frame.camera_from_object_truth), ("prior", frame.prior))
    found = (_pose_problem(frame, pose, model, source) for source, pose in known if pose is not None)
    return next((message for message in found if message is not None), None) or _depth_problem(frame)


def _far_hand(frame: Frame) -> str | None:
    """What makes the hand's pose one of another unit: it is where no camera and no contact is."""
    if frame.world_from_hand is None or frame.hand is None:
        return None
    place = frame.world_from_hand[:3, 3]
    seen_from = [] if frame.camera is None else [("the camera", poses.inverse(frame.camera_from_world)[:3, 3])]
    felt = [("the contacts", _middle(frame.contacts.points))] if len(frame.contacts) else []
    for what, other in (*seen_from, *felt):
        away = float(np.linalg.norm(place - other))
        if away > FARTHEST_HELD:
            return f"expected the hand where {what} can be, got it {away:.4g} m away: is its pose in metres?"
    return None


def _depth_problem(frame: Frame) -> str | None:
    """What makes a depth image one of millimetres, whatever else is known."""
    if frame.depth is None:
        return None
    some = frame.depth[::UNIT_STEP, ::UNIT_STEP]
    some = some[np.isfinite(some) & (some > 0) & (some < MILLIMETRES[1])]
    # where most are below it the median is
    if 2 * np.count_nonzero(some < MILLIMETRES[0]) > len(some):
        return None
    median = _quantile(some, 0.5) if len(some) else 0.0
    if median < MILLIMETRES[0]:
        return None
    return f"expected depth in metres, got a median of {median:.4g}: looks like millimetres: divide by 1000"


def _pose_problem(frame: Frame, pose: Array, model: ObjectModel, source: str) -> str | None:
    """What makes a pose (4, 4), by its source, of another unit than the contacts or the depth image."""
    centre, diameter = poses.apply(pose, model.centroid[None])[0], model.diameter
    if source == "prior" and frame.camera is not None and centre[2] <= 0:
        said = f"expected a prior of an object before the camera, got one {-centre[2]:.3g} m behind it"
        return f"{said}: is it inverted, or of a camera that looks along -z?"
    away = float(np.linalg.norm(centre))
    if frame.camera is not None and away > max(FARTHEST_HELD, SUSPICIOUS_RATIO * diameter):
        return f"expected an object that the camera can see, got one, by the {source}, {away:.4g} m away: mm read as m?"
    if len(frame.contacts):
        felt = poses.apply(frame.camera_from_world, frame.contacts.points)
        away = float(np.linalg.norm(felt - centre, axis=1).min())
        if away > SUSPICIOUS_RATIO * diameter:
            return _says("contacts no nearer than", away, f"the centre, by the {source}, of an object of", diameter)
    seen = _depths_at(frame, centre, diameter)
    if seen is None:
        return None
    # most may be something near the lens that hides the object, or a wall behind it, but not all are far behind it
    nearest, middle = seen
    hint, other = "are depth_scale and the pose's unit right?", f"an object, by the {source}, at"
    if nearest / centre[2] > SUSPICIOUS_RATIO:
        return _says("depth readings no nearer than", nearest, other, float(centre[2]), hint)
    if centre[2] / middle > NEAREST_RATIO:
        return _says("depth readings about", middle, other, float(centre[2]), hint)
    return None


def _quantile(values: NDArray, share: float) -> float:
    """What a share of at least one value is below, between the two nearest; NumPy's own takes many times as long."""
    place = share * (len(values) - 1)
    low = int(place)
    high = min(low + 1, len(values) - 1)
    parted = np.partition(values, (low, high))
    return float(parted[low]) + (place - low) * (float(parted[high]) - float(parted[low]))


def _middle(points: Array) -> Array:
    """(3,) median of points (n, 3), axis by axis."""
    return np.array([_quantile(places, 0.5) for places in points.T])


def _says(what: str, size: float, other: str, reference: float, hint: str | None = None) -> str:
    ratio = size / reference
    unit = "mm" if max(ratio, 1 / ratio) > 200.0 else "cm"
    hint = hint or f"{unit} read as m?"
    return f"expected sizes that agree, got {what} {size:.4g} m and {other} {reference:.4g} m: {hint}"


def _extent(points: Array) -> float:
    """Diagonal of the box of the points; of a large cloud without the farthest 2 % on each side, which may be stray."""
    points = points[:: len(points) // MOST_POINTS + 1]
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return 0.0
    if len(points) < FEWEST_POINTS:
        low, high = points.min(axis=0), points.max(axis=0)
    else:
        low, high = np.percentile(points, [2.0, 98.0], axis=0)
    return float(np.linalg.norm(high - low))


def _depths_at(frame: Frame, centre: Array, diameter: float) -> tuple[float, float] | None:
    """Of the pixels about the object's centre: the depth (m) that a few are nearer than, and the median; None without
    enough of them.
    """
    if frame.depth is None or frame.camera is None or centre[2] <= 0:
        return None
    (u, v), reach = frame.camera.project(centre[None])[0][0], 0.5 * diameter * frame.camera.fx / centre[2]
    # an object that a wrong unit puts onto the lens would fill the image: look at what is there
    rows = slice(max(0, int(v - reach)), max(0, int(v + reach) + 1))
    columns = slice(max(0, int(u - reach)), max(0, int(u + reach) + 1))
    # a median needs no more than every so many of them
    step = int(np.sqrt(max(rows.stop - rows.start, 0) * max(columns.stop - columns.start, 0) / MOST_READINGS)) + 1
    patch = frame.depth[rows, columns][::step, ::step]
    patch = patch[np.isfinite(patch) & (patch > 0) & (patch < MILLIMETRES[1])]
    if len(patch) < FEWEST_POINTS:
        return None
    nearest, middle = _quantile(patch, SHOWN), _quantile(patch, 0.5)
    return float(nearest), float(middle)
