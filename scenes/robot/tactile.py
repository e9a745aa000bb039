"""Taxel arrays under a soft layer: where taxels sit on a fingertip, and what they read when it presses an object.

The layer is an elastic foundation (Johnson, "Contact Mechanics", 1985, section 4.3): pressure is proportional to
indentation, K = E (1 - nu) / ((1 + nu) (1 - 2 nu)) / thickness, with no shear between neighbours; what lies under the
layer feels pressure blurred by the layer's thickness. Sensor frame: origin in the centre of the fingertip's ball, x
along the finger. Metres, newtons, pascals.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.robot.fingers import Finger, find_fingers
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor, check_soft_layer

Array = NDArray[np.float64]

LAYOUTS = {"fingertip": 12, "pad": 24}
# Points of the skin over which pressure is summed: 0.5 mm apart on a fingertip.
SKIN_POINTS = 2500
# To how much of the layer's thickness the depth is found to which a finger presses.
DEPTH_STEP = 1e-5
# A layer is squeezed to a tenth of its thickness at most.
DEEPEST = 0.9


@dataclass(frozen=True)
class SoftLayer:
    """The rubber over the taxels and their electronics. Values by judgement, of the kind that silicone has."""

    # Thickness (m), Young's modulus (Pa) and Poisson's ratio of a silicone skin (Shore A 10).
    thickness: float = 0.002
    modulus: float = 0.3e6
    poisson: float = 0.45
    # Blur of pressure on its way down: standard deviation as a share of the thickness.
    spread: float = 0.5
    # Pressures above the first are read as that, below the second as 0 (Pa).
    saturation: float = 250e3
    threshold: float = 1.5e3

    @property
    def stiffness(self) -> float:
        """Pressure by indentation (Pa / m)."""
        nu = self.poisson
        return self.modulus * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / self.thickness

    @property
    def blur(self) -> float:
        """Standard deviation (m) of the layer's blur; even thin layers spread pressure over the electronics' cells."""
        return max(self.spread * self.thickness, 3e-4)

    def to_json(self) -> dict[str, float]:
        """The sensors file's soft_layer."""
        return {key: float(value) for key, value in asdict(self).items()}

    @staticmethod
    def from_json(entry: dict[str, object] | None, where: str = "soft_layer") -> SoftLayer:
        """From a sensors file; what it does not say is as above. Raises InputError for impossible values."""
        values: dict[str, Any] = dict(entry or {})
        check_soft_layer(values, where)
        known = {f.name for f in fields(SoftLayer)}
        layer = SoftLayer(**{key: float(value) for key, value in values.items() if key in known})
        if layer.threshold >= layer.saturation:
            raise InputError(f"{where}: expected a threshold below the saturation, got {layer}")
        return layer


def fingertip_taxels(radius: float, palmar: Array) -> Array:
    """(12, 6) positions and outward normals over the half of a ball that touches: distal and palmar side.

    One taxel in the middle, four and seven in rings around it, as on the rounded tips of humanoid hands.
    """
    axis = np.array([1.0, 0.0, 0.0]) + palmar
    axis /= np.linalg.norm(axis)
    side = np.cross(palmar, [1.0, 0.0, 0.0])
    up = np.cross(axis, side)
    normals = [axis]
    for count, tilt in ((4, np.deg2rad(30.0)), (7, np.deg2rad(62.0))):
        turns = 2 * np.pi * (np.arange(count) + 0.5) / count
        normals += [np.cos(tilt) * axis + np.sin(tilt) * (np.cos(t) * side + np.sin(t) * up) for t in turns]
    directions = np.array(normals)
    places = radius * directions
    # what would be behind the ball's middle lies on the cylinder there
    behind = directions[:, 0] < 0
    directions[behind, 0] = 0.0
    directions[behind] /= np.linalg.norm(directions[behind], axis=1, keepdims=True)
    places[behind, 1:] = radius * directions[behind, 1:]
    return np.concatenate([places, directions], axis=1)


def pad_taxels(
    radius: float, palmar: Array, rows: int = 8, columns: int = 3, pitch: float = 0.0032, first: float = 0.003
) -> Array:
    """(rows * columns, 6): a pad laid around the tip, from `first` metres behind its foremost point along the palmar
    side; row by row from the tip, columns across; pitch in metres along the skin.
    """
    return np.array(
        [
            _on_skin(first + row * pitch, (column - (columns - 1) / 2) * pitch, radius, palmar)
            for row in range(rows)
            for column in range(columns)
        ]
    )


def _on_skin(along: float, across: float, radius: float, palmar: Array) -> Array:
    """(6,) the place `along` metres from the foremost point and `across` beside the palmar line, and its normal."""
    forward, side = np.array([1.0, 0.0, 0.0]), np.cross(palmar, [1.0, 0.0, 0.0])
    angle, turn = min(along / radius, np.pi / 2), across / radius
    # on the ball the lines across are great circles; behind it the finger is a cylinder
    meridian = np.cos(angle) * forward + np.sin(angle) * palmar
    normal = np.cos(turn) * meridian + np.sin(turn) * side
    behind = max(along - radius * np.pi / 2, 0.0)
    return np.concatenate([radius * normal - behind * forward, normal])


def with_arrays(hand: Hand, layout: str | Array = "fingertip", layer: SoftLayer | None = None) -> Hand:
    """The hand with a taxel array NAME_array around each spherical fingertip sensor NAME.

    layout: "fingertip" (12 taxels), "pad" (3 x 8 = 24) or taxels (k, 6) of one's own in the fingertip's frame. Raises
    InputError for another layout or a hand without spherical fingertips.
    """
    layer = layer or SoftLayer()
    if isinstance(layout, str) and layout not in LAYOUTS:
        raise InputError(f"taxels: expected a layout of {', '.join(LAYOUTS)} or rows of 6 numbers, got {layout!r}")
    sensors = dict(hand.sensors)
    for finger in find_fingers(hand):
        tip = hand.sensors[finger.sensor]
        if isinstance(layout, str):
            make = fingertip_taxels if layout == "fingertip" else pad_taxels
            taxels = make(finger.radius, palmar_side(hand, finger))
        else:
            taxels = np.asarray(layout, dtype=np.float64)
            if taxels.ndim != 2 or taxels.shape[1] != 6 or not np.isfinite(taxels).all():
                raise InputError(f"taxels: expected rows of x, y, z, nx, ny, nz, got shape {taxels.shape}")
        name = f"{tip.name}_array"
        sensors[name] = Sensor(name, tip.link, "array", tip.link_from_sensor, tip.surface, taxels, layer.to_json())
    return Hand(hand.robot, sensors)


def palmar_side(hand: Hand, finger: Finger) -> Array:
    """(3,) unit direction across the finger, sensor frame, in which its tip moves when the finger closes."""
    q = np.clip(np.zeros(len(hand.joint_names)), hand.limits[:, 0], hand.limits[:, 1])
    step = np.zeros(len(q))
    step[list(finger.closing)] = 1e-4 * np.array(finger.ways)
    here, there = hand.link_poses(np.stack([q, q + step]))[:, finger.tip_link]
    moved = poses.apply(there, finger.centre[None])[0] - poses.apply(here, finger.centre[None])[0]
    sensor = hand.sensors[finger.sensor]
    local = (here[:3, :3] @ sensor.link_from_sensor[:3, :3]).T @ moved
    local[0] = 0.0
    length = float(np.linalg.norm(local))
    return local / length if length > 1e-12 else np.array([0.0, 0.0, 1.0])


def skin(sensor: Sensor) -> tuple[Array, Array, Array]:
    """Points (n, 3), outward normals (n, 3) and areas (n,) m^2 of the soft surface over the taxels, sensor frame.

    A spherical fingertip is a ball with a cylinder of the same radius behind it, as far back as there are taxels; any
    other sensor is made of flat discs around its taxels.
    """
    assert sensor.taxels is not None
    places, normals = sensor.taxels[:, :3], sensor.taxels[:, 3:]
    if sensor.radius is None:
        return _discs(places, normals)
    radius = sensor.radius
    back = max(0.0, -float(places[:, 0].min())) + 0.003
    golden = np.pi * (1 + np.sqrt(5.0)) * (np.arange(SKIN_POINTS) + 0.5)
    # by Archimedes a ball's zones and its cylinder's have areas in proportion to their heights
    x = radius - (radius + back) * (np.arange(SKIN_POINTS) + 0.5) / SKIN_POINTS
    ring = np.sqrt(np.maximum(radius**2 - np.maximum(x, 0.0) ** 2, 0.0))
    points = np.stack([x, ring * np.cos(golden), ring * np.sin(golden)], axis=1)
    out = np.stack([np.maximum(x, 0.0), points[:, 1], points[:, 2]], axis=1) / radius
    return points, out, np.full(SKIN_POINTS, 2 * np.pi * radius * (radius + back) / SKIN_POINTS)


def _discs(places: Array, normals: Array, count: int = 60) -> tuple[Array, Array, Array]:
    from scipy.spatial import cKDTree

    gap = cKDTree(places).query(places, k=2)[0][:, 1] if len(places) > 1 else np.array([0.004])
    size = 0.5 * float(np.median(gap))
    share = (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + np.sqrt(5.0)) * np.arange(count)
    points = []
    for place, normal in zip(places, normals):
        side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        side /= np.linalg.norm(side)
        up = np.cross(normal, side)
        flat = size * np.sqrt(share)[:, None] * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up)
        points.append(place + flat)
    return (
        np.concatenate(points),
        np.repeat(normals, count, axis=0),
        np.full(len(places) * count, np.pi * size**2 / count),
    )


def press(
    model: ObjectModel, object_from_sensor: Array, sensor: Sensor, contact_normal: Array, force: float
) -> tuple[Array, float]:
    """Pressures (k,) Pa under the layer of an array that presses the object with `force` (N), and how deep (m).

    object_from_sensor (4, 4): where the undeformed fingertip just touches; contact_normal (3,) out of the object, in
    its frame. The finger goes on along the normal until the layer carries the force, or is squeezed to a tenth.
    """
    from scipy.optimize import brentq

    layer = SoftLayer.from_json(sensor.soft_layer, f"sensor {sensor.name!r}")
    points, normals, areas = skin(sensor)
    facing = np.maximum(-(normals @ object_from_sensor[:3, :3].T) @ contact_normal, 0.0)
    moved = object_from_sensor.copy()

    def load(depth: float) -> float:
        moved[:3, 3] = object_from_sensor[:3, 3] - depth * contact_normal
        pressure = layer.stiffness * indentation(model, moved, points, normals, DEEPEST * layer.thickness)
        return float((pressure * areas) @ facing)

    deepest = DEEPEST * layer.thickness
    if load(0.0) >= force:
        depth = 0.0
    elif load(deepest) <= force:
        depth = deepest
    else:
        depth = float(brentq(lambda depth: load(depth) - force, 0.0, deepest, xtol=DEPTH_STEP * layer.thickness))
    moved[:3, 3] = object_from_sensor[:3, 3] - depth * contact_normal
    return pressures_at(model, moved, sensor), depth


def pressures_at(model: ObjectModel, object_from_sensor: Array, sensor: Sensor) -> Array:
    """Pressures (k,) Pa under the layer of an array whose undeformed skin is where object_from_sensor (4, 4) puts it:
    what of the object is in the layer has indented it.
    """
    assert sensor.taxels is not None
    layer = SoftLayer.from_json(sensor.soft_layer, f"sensor {sensor.name!r}")
    points, normals, areas = skin(sensor)
    depth = indentation(model, object_from_sensor, points, normals, DEEPEST * layer.thickness)
    return _under(layer, sensor.taxels[:, :3], points, areas, layer.stiffness * depth)


def indentation(model: ObjectModel, object_from_sensor: Array, points: Array, normals: Array, deepest: float) -> Array:
    """How deep (n,) m the object's mesh reaches into the skin at points (n, 3) against the outward normals (n, 3),
    sensor frame; at most `deepest` (m).

    The foundation's columns are squeezed along the skin's normal: a thin rib indents by its height, however narrow.
    """
    rotation = object_from_sensor[:3, :3]
    foot, up = poses.apply(object_from_sensor, points - deepest * normals), normals @ rotation.T
    # only columns that the object can reach are followed
    room = model.field.distance(foot)
    near = np.flatnonzero(room < deepest + model.field.spacing)
    out = np.zeros(len(points))
    if not len(near):
        return out
    height = model.surface.cast(foot[near], up[near])
    # from inside the object the first surface met is where the ray leaves it; the lattice knows the side beyond edges
    out[near] = np.where(room[near] < 0, deepest, np.clip(deepest - height, 0.0, deepest))
    return out


def _under(layer: SoftLayer, places: Array, points: Array, areas: Array, pressure: Array) -> Array:
    """Pressure at the taxels (k, 3): that on the skin, blurred by the layer; along the skin where it is flat enough."""
    from scipy.spatial.distance import cdist

    square = cdist(places, points, "sqeuclidean")
    weight = areas * np.exp(-0.5 * square / layer.blur**2)
    return (weight @ pressure) / np.maximum(weight.sum(axis=1), 1e-300)


def read_out(
    pressure: Array, layer: SoftLayer, noise: float, dead: NDArray[np.bool_] | None, rng: np.random.Generator
) -> Array:
    """What the electronics report of pressures (k,) Pa: noise (Pa), threshold, saturation; dead taxels read 0."""
    read = pressure + noise * rng.normal(size=len(pressure))
    read = np.where(read < layer.threshold, 0.0, np.minimum(read, layer.saturation))
    return read if dead is None else np.where(dead, 0.0, read)
