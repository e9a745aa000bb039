"""What an array reports, with where it is: the input of everything in this folder. SI units.

A taxel's place lies on the undeformed skin. Pressing an object indents the soft layer by p / K (elastic foundation,
scenes.robot.tactile), so the object's surface runs through place + alpha p normal with alpha = -1 / K: the third
column of T1 eq. 5.1, for flat and curved layouts alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError
from scenes.recordings.frames import Frame
from scenes.robot.tactile import SoftLayer

Array = NDArray[np.float64]

# Noise of a pressure (Pa), and the sigmas of it at which one of some hundred taxels is not noise. By judgement.
NOISE, CERTAIN = 1000.0, 4.0
# Neighbours are no farther than so many pitches: the eight around one on a square grid.
AROUND = 1.5


@dataclass(frozen=True)
class Reading:
    """One frame of one array.

    sensor: its name. taxels (k, 6): places (m) and outward unit normals of the undeformed skin, in any frame that all
    readings of a grasp share. pressure (k,) Pa. layer: the material over the taxels. radius (m): of a spherical
    fingertip with a cylinder behind it, centred on `frame_from_sensor`; None for any other skin. unknown (k,): taxels
    that say nothing, neither that something is there nor that nothing is; their pressure is 0.
    """

    sensor: str
    taxels: Array
    pressure: Array
    layer: SoftLayer
    frame_from_sensor: Array
    radius: float | None = None
    unknown: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        """Raises InputError for shapes that do not fit or numbers that are not finite."""
        taxels, pressure = np.shape(self.taxels), np.shape(self.pressure)
        if len(taxels) != 2 or taxels[1] != 6 or pressure != taxels[:1] or not taxels[0]:
            raise InputError(
                f"array {self.sensor!r}: expected k pressures of k taxels (k, 6), got {pressure}, {taxels}"
            )
        if not (np.isfinite(self.taxels).all() and np.isfinite(self.pressure).all()):
            raise InputError(f"array {self.sensor!r}: expected finite taxels and pressures")
        if len(self.unknown) not in (0, len(self.pressure)):
            raise InputError(f"array {self.sensor!r}: expected {pressure[0]} of `unknown`, got {len(self.unknown)}")
        if not len(self.unknown):
            object.__setattr__(self, "unknown", np.zeros(len(self.pressure), dtype=np.bool_))

    @property
    def silent(self) -> NDArray[np.bool_]:
        """(k,) taxels that feel that nothing is there."""
        return ~self.active & ~self.unknown

    @property
    def active(self) -> NDArray[np.bool_]:
        """(k,) taxels that feel something: at or above the electronics' threshold, and above nothing."""
        return self.pressure >= max(self.layer.threshold, 1e-9)

    @property
    def indentation(self) -> Array:
        """(k,) metres by which the layer is pressed in at each taxel."""
        return -alpha_of(self.layer) * np.maximum(self.pressure, 0.0)

    @property
    def surface_points(self) -> Array:
        """(k, 3) where the object's surface runs, if the taxel is active: place + alpha p normal."""
        return self.taxels[:, :3] - self.indentation[:, None] * self.taxels[:, 3:]

    @property
    def pitch(self) -> float:
        """Distance of neighbouring taxels (m), the median over the array; 4 mm for a single one."""
        return pitch_of(self.taxels)

    def moved(self, target_from_source: Array) -> Reading:
        """The same reading in another frame."""
        rotation, translation = target_from_source[:3, :3], target_from_source[:3, 3]
        taxels = np.concatenate(
            [self.taxels[:, :3] @ rotation.T + translation, self.taxels[:, 3:] @ rotation.T], axis=1
        )
        pose = target_from_source @ self.frame_from_sensor
        return Reading(self.sensor, taxels, self.pressure, self.layer, pose, self.radius, self.unknown)


def flickers(taxels: Array, pressure: Array, threshold: float) -> NDArray[np.bool_]:
    """(k,) which of taxels (k, 6) feel something as weak as noise (Pa) while none beside them does.

    Of some hundred taxels some always read above a threshold that is near their noise; each would be a finger's
    contact. What touches a skin lightly presses on its neighbours, too, or on a single one by more than that.
    Electronics of a lower threshold (Pa) have less noise.
    """
    noise = min(NOISE, threshold) if threshold > 0.0 else NOISE
    out = np.zeros(len(pressure), dtype=np.bool_)
    active = np.flatnonzero(pressure >= max(threshold, 1e-9))
    weak = pressure[active] < CERTAIN * noise
    if len(pressure) < 2 or not weak.any():
        return out
    apart = np.linalg.norm(taxels[active[weak], None, :3] - taxels[None, :, :3], axis=2)
    apart[np.arange(len(apart)), active[weak]] = np.inf
    near = AROUND * max(float(np.median(apart.min(axis=1))), 1e-5)
    out[active[weak]] = ~(apart[:, active] <= near).any(axis=1)
    return out


def pitch_of(taxels: Array) -> float:
    """Median distance (m) of each of taxels (k, 6) to its neighbour; 4 mm for a single one."""
    if len(taxels) < 2:
        return 0.004
    gaps = np.linalg.norm(taxels[:, None, :3] - taxels[None, :, :3], axis=2) + 1e9 * np.eye(len(taxels))
    return max(float(np.median(gaps.min(axis=1))), 1e-5)


def alpha_of(layer: SoftLayer) -> float:
    """T1's scale of pressure (m / Pa), negative: the indentation that one pascal speaks of."""
    return -1.0 / layer.stiffness


def readings_of(frame: Frame) -> list[Reading]:
    """All arrays of a frame, camera frame, in the frame's order.

    Raises CaptureError when the frame has pressures but no hand, joints or hand pose, for a sensor that the hand does
    not have, and for pressures that do not fit its layout.
    """
    if not frame.tactile:
        return []
    if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
        raise CaptureError(f"{frame.where}: tactile arrays need a hand, its joints and its pose")
    hand_from_sensor = frame.hand.hand_from_sensor(frame.joints)
    camera_from_hand = frame.camera_from_world @ frame.world_from_hand
    out = []
    for name, pressure in frame.tactile.items():
        sensor = frame.hand.sensors.get(name)
        if sensor is None or sensor.taxels is None:
            known = ", ".join(s.name for s in frame.hand.sensors.values() if s.taxels is not None) or "none"
            raise CaptureError(f"{frame.where}: expected an array of the hand ({known}), got {name}")
        if np.shape(pressure) != (len(sensor.taxels),):
            count = np.size(pressure)
            raise CaptureError(f"{frame.where}: array {name}: expected {len(sensor.taxels)} pressures, got {count}")
        layer = SoftLayer.from_json(sensor.soft_layer, f"sensor {name!r}")
        told = np.isfinite(pressure)
        pressure = np.where(told, pressure, 0.0)
        unknown = ~told | flickers(sensor.taxels, pressure, layer.threshold)
        pressure = np.where(unknown, 0.0, pressure)
        here = Reading(name, sensor.taxels, pressure, layer, np.eye(4), sensor.radius, unknown)
        out.append(here.moved(camera_from_hand @ hand_from_sensor[name]))
    return out
