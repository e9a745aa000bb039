"""What is well formed in a frame and still useless, or doubtful though it may be right: found when a capture is
validated.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.files.formats.images import LARGEST_COUNT, read_counts
from scenes.files.problems import Problem
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Frame
from scenes.robot.hands import Hand

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
# Share of an image that the object may fill: one that is nearer than that hides its own hand.
LARGEST_MASK = 0.95
# No fingertip has a larger radius, and no place that was found empty (m).
LARGEST_RADIUS = 0.2
# Between these (m) is where a contact is known, and up to this (rad) how it faces.
SIGMAS = (1e-5, 0.05)
LARGEST_ANGLE = 1.0
# One hand's contacts are no farther (m) from each other.
FARTHEST_OTHER = 2.0
# What a frame lacks of a hand that is not known in it at all.
NOWHERE = "pose and joints"


def frame_problems(folder: Path, frame: Frame) -> list[Problem]:
    """Nothing sensed, a depth image without a reading, a hand that is nowhere, joints out of range, contacts far from
    their sensors or written again and again, wrenches of one sensor twice, a lens beside its image.
    folder: of the capture.
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
    again = len(frame.contacts) - len(frame.contacts.first_of_each)
    if again:
        message = f"expected contacts that were each felt once, got {again} of {len(frame.contacts)} rows repeated"
        found.append(problem("contacts.csv", message))
    names = [wrench.sensor for wrench in frame.wrenches]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        found.append(problem("wrenches.csv", f"expected each sensor once, got {twice} {names.count(twice)} times"))
    return found


def frame_doubts(folder: Path, frame: Frame) -> dict[str, Problem]:
    """What may be right and seldom is, by its kind: a mask of nothing or of everything, a principal point of another
    image than the frame's, holes that are written as the largest count, depths where no hand is, contacts of no sensor
    or far from all others, sizes that no fingertip and no noise has. folder: of the capture.
    """
    found = {}
    if frame.camera is not None and any(image is not None for image in (frame.depth, frame.rgb, frame.mask)):
        message = _centre_doubt(frame.camera)
        if message:
            found["centre"] = Problem(str(folder / "scene_camera.json"), frame.index, message)
    message = _mask_doubt(frame)
    if message:
        found["mask"] = Problem(str(folder / "mask_visib"), frame.index, message)
    for kind, (file, message) in _touch_doubts(frame).items():
        found[kind] = Problem(str(folder / file), frame.index, message)
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


def hand_doubts(hand: Hand, path: Path) -> list[Problem]:
    """Surfaces of sensors that no fingertip has; path: of their sensors.json."""
    return [
        Problem(str(path), None, _too_large(f"a radius of {sensor.name}'s surface", sensor.radius, LARGEST_RADIUS, "m"))
        for sensor in hand.sensors.values()
        if sensor.radius is not None and sensor.radius > LARGEST_RADIUS
    ]


def _touch_doubts(frame: Frame) -> dict[str, tuple[str, str]]:
    """Of contacts and of places without one, by the kind of doubt: the file, and what is doubtful in words."""
    found, felt = {}, frame.contacts
    if frame.hand is not None and frame.hand.sensors and felt.sensors:
        other = list(dict.fromkeys(name for name in felt.sensors if name not in frame.hand.sensors))
        if other:
            names = ", ".join(frame.hand.sensors)
            message = f"expected sensors of the hand ({names[:100]}), got {', '.join(map(repr, other))[:100]}"
            found["sensors"] = ("contacts.csv", message)
    points = felt.sigma_point[felt.sigma_told] if len(felt) else np.zeros(0)
    normals = felt.sigma_normal[np.isfinite(felt.sigma_normal)] if len(felt) else np.zeros(0)
    if (points > SIGMAS[1]).any():
        found["large"] = ("contacts.csv", _too_large("a sigma_point", points.max(), SIGMAS[1], "m"))
    if (points < SIGMAS[0]).any():
        message = f"expected a sigma_point from {SIGMAS[0]:g} m, got {points.min():g}: is it in metres?"
        found["small"] = ("contacts.csv", message)
    if (normals > LARGEST_ANGLE).any():
        found["normals"] = ("contacts.csv", _too_large("a sigma_normal", normals.max(), LARGEST_ANGLE, "rad"))
    if len(felt) > 1:
        from scipy.spatial import cKDTree  # estimates of one frame do without SciPy

        away = cKDTree(felt.points).query(felt.points, k=2)[0][:, 1]
        if (away > FARTHEST_OTHER).any():
            message = f"expected contacts within {FARTHEST_OTHER:g} m of others, got one {away.max():.3g} m from any"
            found["far"] = ("contacts.csv", message)
    radii = np.zeros(0) if frame.no_contact is None else np.asarray(frame.no_contact.radius)
    if (radii > LARGEST_RADIUS).any():
        found["regions"] = ("no_contact.csv", _too_large("a radius", radii.max(), LARGEST_RADIUS, "m"))
    return found


def _too_large(what: str, got: float, most: float, unit: str) -> str:
    asked = {"m": "is it in metres?", "rad": "is it in radians?"}[unit]
    return f"expected {what} up to {most:g} {unit}, got {got:.4g}: {asked}"


def _mask_doubt(frame: Frame) -> str:
    """In words, a mask that is no outline of anything, else ""."""
    if frame.mask is None or 0.0 < (share := float(frame.mask.mean())) <= LARGEST_MASK:
        return ""
    return f"expected a mask of the object's own pixels, got {'none' if not share else f'{share:.0%} of the image'}"


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
