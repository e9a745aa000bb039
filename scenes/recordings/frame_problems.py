"""What is well formed in a frame and still useless, or doubtful though it may be right: found when a capture is
validated.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.files.images import LARGEST_COUNT, read_counts
from scenes.files.problems import Problem
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# No sensor reaches farther (m) from its own origin; one that does is elsewhere than the hand's pose says.
FARTHEST_CONTACT = 0.2
# An image cut out of a larger one may have its principal point outside; not so many of its own sides away.
FARTHEST_CENTRE = 1.0
# Of an image's side, how near to its corner a principal point is one that was never measured.
CORNER = 0.02
# Depths (m) between which cameras see hands; most readings of an image are there.
DEPTHS = (0.05, 20.0)
# Share of the pixels that may have the largest count of 16 bits by themselves.
MOST_LARGEST = 0.01
# What a frame lacks of a hand that is not known in it at all.
NOWHERE = "pose and joints"


def frame_problems(folder: Path, frame: Frame) -> list[Problem]:
    """Nothing sensed, a depth image without a reading, a hand that is nowhere, joints out of range, contacts far from
    their sensors or written again and again, a lens beside its image. folder: of the capture.
    """

    def problem(file: str, message: str) -> Problem:
        return Problem(str(folder / file) if file else str(folder), frame.index, message)

    found = []
    if frame.depth is not None and not (frame.depth > 0).any():
        found.append(problem(f"depth/{frame.index:06d}.png", "expected depth readings, got an image of zeros"))
    sensed = (frame.depth is not None, frame.cloud is not None, len(frame.contacts) > 0, len(frame.wrenches) > 0)
    if not any(sensed) and not frame.tactile and not frame.gels:
        expected = "expected a depth image, a cloud, contacts, wrenches, tactile arrays or gels' images, found none"
        found.append(problem("", expected))
    if frame.camera is not None:
        found += [problem("scene_camera.json", message) for message in centre_problems(frame.camera)]
    if frame.hand is not None and frame.joints is not None:
        for joint, excess in frame.hand.limit_excess(frame.joints).items():
            found.append(problem("joints.csv", f"expected {joint} within its limits, got {excess:.3g} beyond"))
    found += [problem(f"tactile/{name}/{frame.index:06d}.csv", said) for name, said in _no_arrays(frame)]
    missing = frame.hand_lacks
    if missing and missing != NOWHERE:  # of single frames of a sequence the hand may not be known
        file = "hand_poses.csv" if missing == "pose" else "joints.csv"
        found.append(problem(file, f"expected the hand's {missing}, found none: the hand is left out"))
    away = _from_sensors(frame)
    if len(away) and np.median(away) > FARTHEST_CONTACT:
        message = f"expected contacts at the hand's sensors, got {np.median(away):.2g} m off: is its pose inverted?"
        found.append(problem("hand_poses.csv", message))
    again = _repeated(frame)
    if again:
        message = f"expected contacts that were each felt once, got {again} of {len(frame.contacts)} rows repeated"
        found.append(problem("contacts.csv", message))
    return found


def frame_doubts(folder: Path, frame: Frame) -> dict[str, Problem]:
    """What may be right and seldom is, by its kind: a principal point of another image than the frame's, holes that are
    written as the largest count, depths where no hand is. folder: of the capture.
    """
    found = {}
    if frame.camera is not None and any(image is not None for image in (frame.depth, frame.rgb, frame.mask)):
        message = _centre_doubt(frame.camera)
        if message:
            found["centre"] = Problem(str(folder / "scene_camera.json"), frame.index, message)
    path = folder / f"depth/{frame.index:06d}.png"
    if frame.depth is None or not path.is_file():
        return found
    largest = read_counts(path) == LARGEST_COUNT
    if largest.mean() > MOST_LARGEST:
        message = f"expected 0 where there is no reading, got {LARGEST_COUNT} in {largest.mean():.0%} of the pixels"
        found["largest"] = Problem(str(path), frame.index, message)
    readings = frame.depth[(frame.depth > 0) & ~largest]
    median = float(np.median(readings)) if len(readings) else DEPTHS[0]
    if not DEPTHS[0] <= median <= DEPTHS[1]:
        low, high = DEPTHS
        expected = f"expected depths from {low:g} to {high:g} m, got a median of {median:.3g}"
        message = f"{expected}: is depth_scale millimetres per count?"
        found["depths"] = Problem(str(path), frame.index, message)
    return found


def _centre_doubt(camera: Camera) -> str:
    """In words, a principal point in a corner of its image or beside it, else "". Far away it is a problem."""
    shares = camera.cx / camera.width, camera.cy / camera.height
    beside = any(not 0.0 <= share <= 1.0 for share in shares)
    if centre_problems(camera) or not (beside or all(min(share, 1.0 - share) < CORNER for share in shares)):
        return ""
    size, expected = f"{camera.width}x{camera.height}", "expected a principal point about the middle"
    return f"{expected}, got {camera.cx:g}, {camera.cy:g} for {size} pixels: was the image cut out of a larger one?"


def _no_arrays(frame: Frame) -> list[tuple[str, str]]:
    """Sensors with pressures that no array of the hand has reported, and what is wrong with each, in words: they
    are left out where nothing places them, and refused where the hand has no such array.
    """
    if frame.tactile and frame.hand is None:
        return [(name, "expected a hand with this array, found no hand") for name in frame.tactile]
    sensors = frame.hand.sensors if frame.hand is not None else {}
    arrays = ", ".join(sensor.name for sensor in sensors.values() if sensor.taxels is not None) or "none"
    return [
        (name, f"expected an array of the hand ({arrays}), got {name}, of kind {sensors[name].kind}")
        for name in frame.tactile
        if name in sensors and sensors[name].taxels is None
    ]


def centre_problems(camera: Camera) -> list[str]:
    """In words, a principal point that no cut-out of a camera's image has."""
    places = (("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height))
    return [
        f"expected a principal point near the image, got {name} {at:g} for {size} pixels"
        for name, at, size in places
        if not -FARTHEST_CENTRE * size <= at <= (1 + FARTHEST_CENTRE) * size
    ]


def _from_sensors(frame: Frame) -> Array:
    """(k,) distances (m) of the contacts from the sensors they are named after, of those that the hand has."""
    if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
        return np.zeros(0)
    contacts, places = frame.contacts, frame.hand.hand_from_sensor(frame.joints)
    known = [(point, places[name]) for point, name in zip(contacts.points, contacts.sensors) if name in places]
    return np.array([np.linalg.norm(point - (frame.world_from_hand @ pose)[:3, 3]) for point, pose in known])


def _repeated(frame: Frame) -> int:
    """How many contacts are another one over again, in every field: a row that was written twice is no second touch."""
    felt = frame.contacts
    if len(felt) < 2:
        return 0
    sigmas = felt.sigma_point[:, None], felt.sigma_normal[:, None]
    numbers = np.nan_to_num(np.concatenate([felt.points, felt.normals, felt.forces, *sigmas], axis=1), nan=np.inf)
    rows = {(name, row.tobytes()) for name, row in zip(felt.sensors, numbers)}
    return len(felt) - len(rows)
