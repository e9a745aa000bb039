"""Gels that press a mesh: how deep the skin goes in, and what its camera sees of it under three coloured lights.

The object pushes the skin along the pixels' lines; beside it the skin, a membrane, bridges to where it is untouched. A
matt skin shows ambient light and three near lamps of different colour (Lambert). What no estimator is told: the lamps'
places, colours and brightness, the skin's reflectance, the exposure's drift, the grain, and how far the skin bulges
beyond its drawing. Sensor frame (z out of the finger), metres; colours in counts of 0 to 255, red first.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.robot.digit import digit_gel
from scenes.robot.fingers import find_fingers
from scenes.robot.gels import MICROMETRE, Gel
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.tactile import palmar_side

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GelNoise:
    """How gels differ from their drawing, and images from one another."""

    # Lamps: standard deviation of their places (m), of their brightness (share), and how much of another colour they
    # mix in (share, at most).
    lamp_place: float = 0.002
    lamp_brightness: float = 0.12
    lamp_mix: float = 0.15
    # Reflectance: standard deviation of its slow changes over the skin (share), and their width (share of the image).
    reflectance: float = 0.12
    reflectance_width: float = 0.12
    # Exposure from image to image (share), and grain of each pixel (counts).
    exposure: float = 0.01
    grain: float = 3.0
    # The skin's bulge beyond its drawing, standard deviation (m).
    bulge: float = 0.00008
    # Width over which the skin bridges from what presses it to where it is untouched, as a share of the gel's
    # thickness: rubber that is pressed moves about as far beside as below.
    bridge: float = 0.25


@dataclass(frozen=True)
class Lamps:
    """places (3, 3) m sensor frame; colours (3, 3), a row a lamp: counts at a white skin that faces it; ambient (3,)
    counts; reflectance (h, w).
    """

    places: Array
    colours: Array
    ambient: Array
    reflectance: Array


@dataclass(frozen=True, eq=False)
class LitGel(Gel):
    """A gel with what lights it and how far its skin really bulges; files keep neither."""

    lamps: Lamps | None = None
    bulge: float = 0.0
    noise: GelNoise = field(default_factory=GelNoise)


def draw_lamps(gel: Gel, rng: np.random.Generator, noise: GelNoise | None = None) -> Lamps:
    """Three lamps around the skin at 30, 150 and 270 degrees, red, green and blue, as DIGITs have them, with the errors
    of the noise.
    """
    import cv2

    noise = noise or GelNoise()
    points = gel.points()
    reach = 0.75 * float(np.linalg.norm(points[..., :2].reshape(-1, 2), axis=1).max())
    below = float(gel.surface.min()) - 0.018
    angles = np.deg2rad([30.0, 150.0, 270.0])
    places = np.stack([reach * 1.3 * np.cos(angles), reach * 1.3 * np.sin(angles), np.full(3, below)], axis=1)
    places += noise.lamp_place * rng.normal(size=(3, 3))
    mix = noise.lamp_mix * rng.random((3, 3))
    colours = (np.eye(3) + mix) * 90.0 * np.maximum(1.0 + noise.lamp_brightness * rng.normal(size=(3, 1)), 0.3)
    ambient = 35.0 * np.maximum(1.0 + noise.lamp_brightness * rng.normal(size=3), 0.3)
    rough = rng.normal(size=(gel.height, gel.width))
    width = max(1.0, noise.reflectance_width * min(gel.width, gel.height))
    slow = cv2.GaussianBlur(rough, (0, 0), width, borderType=cv2.BORDER_REFLECT)
    slow = np.asarray(slow / max(float(slow.std()), 1e-12), dtype=np.float64)
    return Lamps(places, colours, ambient, np.clip(1.0 + noise.reflectance * slow, 0.3, 1.6))


def shine(gel: Gel, lamps: Lamps, depth: Array | float = 0.0) -> Array:
    """(h, w, 3) counts, without grain, of the skin pressed in by depth (h, w) m."""
    points, normals = gel.points(depth), gel.normals(depth)
    out = np.broadcast_to(lamps.ambient, (*points.shape[:2], 3)).copy()
    middle = gel.points()[gel.height // 2, gel.width // 2]
    for place, colour in zip(lamps.places, lamps.colours):
        # lamps and camera are inside the finger: what faces them is the skin's inner side
        towards = place - points
        distance = np.linalg.norm(towards, axis=2)
        facing = np.maximum(-(normals * towards).sum(axis=2) / distance, 0.0)
        fall = np.minimum((np.linalg.norm(place - middle) / distance) ** 2, 2.0)
        out += (facing * fall)[..., None] * colour
    return out * lamps.reflectance[..., None]


def lit(gel: Gel, rng: np.random.Generator, noise: GelNoise | None = None) -> LitGel:
    """The gel with lamps of its own, the image of its untouched skin, and no calibration."""
    noise = noise or GelNoise()
    lamps = draw_lamps(gel, rng, noise)
    bulge = noise.bulge * float(rng.normal())
    made = LitGel(
        gel.width,
        gel.height,
        gel.surface,
        gel.pitch,
        gel.matrix,
        gel.distance,
        gel.thickness,
        lamps=lamps,
        bulge=bulge,
        noise=noise,
    )
    # a background is the mean of several images: a third of the grain
    image = shine(made, lamps) + noise.grain / 3.0 * rng.normal(size=(gel.height, gel.width, 3))
    return replace(made, background=np.clip(np.rint(image), 0, 255).astype(np.uint8))


def photograph_gel(gel: LitGel, depth: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """(h, w, 3) uint8: the skin pressed in by depth (h, w) m, with exposure and grain."""
    assert gel.lamps is not None
    exposure = 1.0 + gel.noise.exposure * rng.normal()
    image = exposure * shine(gel, gel.lamps, depth) + gel.noise.grain * rng.normal(size=(gel.height, gel.width, 3))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def pressed_by(model: ObjectModel, object_from_sensor: Array, gel: Gel) -> Array:
    """(h, w) m that the object's mesh reaches into the skin along the pixels' lines; at most the gel's thickness."""
    rays = gel.rays.reshape(-1, 2)
    below = float(gel.surface.min()) - gel.thickness
    if gel.distance is None:
        origins = np.concatenate([rays, np.full((len(rays), 1), below)], axis=1)
        directions = np.tile([0.0, 0.0, 1.0], (len(rays), 1))
    else:
        directions = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
        origins = directions * (gel.distance + below) - np.array([0.0, 0.0, gel.distance])
    met = model.surface.cast(poses.apply(object_from_sensor, origins), directions @ object_from_sensor[:3, :3].T)
    z = (below + met).reshape(gel.height, gel.width)
    return np.clip(gel.surface + _bulge_of(gel) - z, 0.0, gel.thickness)


def bridged(depth: Array, gel: Gel, noise: GelNoise | None = None) -> Array:
    """(h, w) m the skin's indentation where the object reaches in by depth (h, w): beside it the skin bridges to where
    it is untouched; nowhere is it less than the object's own.
    """
    import cv2

    width = (noise or GelNoise()).bridge * gel.thickness

    skin = depth
    touched = depth > 0
    if not touched.any():
        return depth
    for share in (1.0, 0.5, 0.25, 0.12):
        sigma = max(share * width / gel.spacing, 0.5)
        skin = np.where(touched, depth, cv2.GaussianBlur(skin, (0, 0), sigma))
    return np.asarray(cv2.GaussianBlur(skin, (0, 0), max(0.05 * width / gel.spacing, 0.4)))


def with_gels(
    hand: Hand, seed: int = 0, protrusion: float = 0.001, half: float = 0.0062, pitch: float = 0.0001
) -> Hand:
    """The hand with a gel NAME_gel over each spherical fingertip NAME: a cap that stands out `protrusion` (m) from the
    ball's distal and palmar side, seen over a square of half width `half` (m), `pitch` metres a pixel.

    Raises InputError for a hand without spherical fingertips.
    """
    fingers = find_fingers(hand)
    if not fingers:
        raise InputError(f"touch: expected a hand with spherical fingertips for gels, got {hand.name!r}")
    sensors = dict(hand.sensors)
    rng = np.random.default_rng([seed, 71])
    for finger in fingers:
        tip = hand.sensors[finger.sensor]
        palmar = palmar_side(hand, finger)
        out = np.array([0.6, 0.0, 0.0]) + palmar
        out /= np.linalg.norm(out)
        side = np.cross(palmar, [1.0, 0.0, 0.0])
        rotation = np.stack([side, np.cross(out, side), out], axis=1)
        gel = cap(finger.radius + protrusion, min(half, 0.75 * finger.radius), pitch)
        name = f"{tip.name}_gel"
        pose = tip.link_from_sensor @ poses.make_pose(rotation, (finger.radius + protrusion) * out)
        sensors[name] = Sensor(name, tip.link, "gel", pose, gel=lit(gel, rng))
    return Hand(hand.robot, sensors)


def cap(radius: float, half: float, pitch: float) -> Gel:
    """A gel bulged as a ball of `radius` (m), seen over a square of half width `half` (m), `pitch` (m) a pixel; its
    highest point is the sensor frame's origin.
    """
    side = 2 * max(8, int(half / pitch))
    flat = Gel(side, side, np.zeros((side, side)), pitch)
    square = (flat.rays**2).sum(axis=2)
    surface = np.sqrt(np.maximum(radius**2 - square, (0.3 * radius) ** 2)) - radius
    return Gel(side, side, surface, pitch, thickness=0.003)


def feel_gels(
    hand: Hand, model: ObjectModel, hand_from_object: Array, joints: dict[str, float], rng: np.random.Generator
) -> dict[str, NDArray[np.uint16] | NDArray[np.uint8]]:
    """What every gel of the hand sees of an object: colours of lit gels, micrometres of others."""
    frames = hand.hand_from_sensor(joints)
    object_from_hand = poses.inverse(hand_from_object)
    out: dict[str, NDArray[np.uint16] | NDArray[np.uint8]] = {}
    for name, sensor in hand.sensors.items():
        if sensor.gel is not None:
            out[name] = see(sensor.gel, pressed_by(model, object_from_hand @ frames[name], sensor.gel), rng)
    return out


def see(gel: Gel, depth: Array, rng: np.random.Generator) -> NDArray[np.uint16] | NDArray[np.uint8]:
    """The gel's image where the object reaches in by depth (h, w) m: colours when it is lit, else micrometres."""
    if isinstance(gel, LitGel):
        return photograph_gel(gel, bridged(depth, gel, gel.noise), rng)
    skin = bridged(depth, gel)
    return np.rint(np.clip(skin, 0.0, gel.thickness) / MICROMETRE).astype(np.uint16)


def ball_presses(
    gel: LitGel, radius: float, depth: float, count: int, rng: np.random.Generator
) -> list[NDArray[np.uint8]]:
    """Images of a ball of `radius` (m) pressed `depth` (m) deep into the skin, `count` of them spread over it."""
    skin, out = gel.points(_bulge_of(gel) * -1.0), gel.normals()
    images = []
    # the whole outline, with what bridges to it, has to be in the image
    margin = (np.sqrt(max(2.0 * radius * depth - depth**2, 0.0)) + 0.0012) / gel.spacing
    low_u, low_v = (min(margin / side, 0.4) for side in (gel.width, gel.height))
    rows = max(1, round(np.sqrt(count * gel.height / gel.width)))
    columns = -(-count // rows)
    for number in range(count):
        # one in each field of a grid
        a, b = (number % columns + rng.random()) / columns, (number // columns + rng.random()) / rows
        u = int(gel.width * (low_u + (1.0 - 2.0 * low_u) * a))
        v = int(gel.height * (low_v + (1.0 - 2.0 * low_v) * min(b, 0.999)))
        centre = skin[v, u] + (radius - depth) * out[v, u]
        images.append(photograph_gel(gel, bridged(_ball_depth(gel, centre, radius), gel, gel.noise), rng))
    return images


def _ball_depth(gel: Gel, centre: Array, radius: float) -> Array:
    rays = gel.rays
    if gel.distance is None:
        foot, direction = np.concatenate([rays, np.zeros((*rays.shape[:2], 1))], axis=2), np.array([0.0, 0.0, 1.0])
    else:
        foot = np.array([0.0, 0.0, -gel.distance])
        direction = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2)
    square = (direction**2).sum(axis=-1)
    along = ((centre - foot) * direction).sum(axis=-1) / square
    aside = ((foot + along[..., None] * direction - centre) ** 2).sum(axis=-1)
    z = (foot + (along - np.sqrt(np.maximum(radius**2 - aside, 0.0) / square))[..., None] * direction)[..., 2]
    return np.where(aside < radius**2, np.clip(gel.surface + _bulge_of(gel) - z, 0.0, gel.thickness), 0.0)


def _bulge_of(gel: Gel) -> float:
    return gel.bulge if isinstance(gel, LitGel) else 0.0


def lit_digit(rng: np.random.Generator, noise: GelNoise | None = None) -> LitGel:
    """A DIGIT with lamps of its own."""
    return lit(digit_gel(), rng, noise)
