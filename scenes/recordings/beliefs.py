"""What the parts of a recording are worth: a camera, a calibration, fingertips, a mesh.

Beliefs are data, apart from the settings of methods: they say how wrong a thing may be, not what is done about it.
Metres, radians, pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError

Array = NDArray[np.float64]

# Beyond these (m, rad, px, shares) a number is in another unit than the field's; those named below them may be 0.
LARGEST = {
    **{"axial_floor": 0.1, "axial_growth": 1.0, "axial_from": 10.0, "axial_steep": 0.1},
    **{"lateral_sigma": 50.0, "lateral_growth": 10.0, "bias_sigma": 0.1, "bias_length": 5000.0},
    **{"sharing_length": 5000.0, "sharing_length_unknown": 5000.0, "cloud_sigma": 0.1, "cloud_patches": 1e6},
    **{"scale_sigma": 0.2, "shift_sigma": 50.0, "edge_pixels": 50, "window": 100.0},
    **{"translation_sigma": 0.5, "rotation_sigma": 0.8, "unknown_sigma": 0.1, "fingertip_sigma": 0.1},
    **{"grey_sigma": 50.0, "colour_sigma": 50.0},
    "mesh_sigma": 0.05,
}
# Sizes that are pixels of the image. Their defaults are of a camera whose focal length (px) is this, as those that
# they were read off and tuned on have 570 to 620; for longer lenses they grow up to so many times, beyond which it is
# no lens but a mistake.
IN_PIXELS = ("lateral_sigma", "edge_pixels", "window", "bias_length", "sharing_length", "sharing_length_unknown")
USUAL_FOCAL = 600.0
MOST_TIMES = 8.0
# What a usual window is wide to either side in the scene (m): 7 px of a lens of 600 px, 0.78 m away.
USUAL_WINDOW = 0.0091
MAY_BE_ZERO = "axial_growth", "axial_from", "axial_steep", "lateral_growth", "shift_sigma", "edge_pixels", "window"


def check_sizes(believed: Any) -> None:
    """Raise InputError, naming the field, for a number of a belief that is none, or cannot be in the field's unit."""
    for one in fields(believed):
        value = getattr(believed, one.name)
        if not isinstance(value, int | float):
            continue
        low, high = one.name in MAY_BE_ZERO, LARGEST[one.name]
        if not (math.isfinite(value) and (value >= 0 if low else value > 0) and value <= high):
            least = "from 0" if low else "above 0"
            raise InputError(f"{one.name}: expected a number {least} and up to {high:g}, got {value:g}")


@dataclass(frozen=True)
class DepthModel:
    """What is believed of a depth camera; cameras one can buy are in `scenes.recordings.depth_cameras`.

    By default structured light or stereo at arm's length. Independent noise follows Nguyen, Izadi & Lovell (3DIMPVT
    2012); the rest is what calibration reports of such cameras agree on (Basso, Menegatti & Pretto, IEEE T-RO 2018:
    smooth local distortion and a global depth error).
    """

    # Axial noise where it is least, metres; that depth, metres; and its growth with the square of what is beyond or
    # before, 1/metres. From 0 it is a constant and a quadratic term, as of stereo and of time of flight.
    axial_floor: float = 0.0012
    axial_from: float = 0.4
    axial_growth: float = 0.0019
    # Where the surface slopes there is more: a pixel reads the depth of a place beside its own (pixels; Nguyen et al.,
    # eq. 2), and beyond 60 degrees of incidence the axial noise grows (metres^1.5; eq. 4).
    lateral_sigma: float = 0.8
    lateral_growth: float = 0.035
    axial_steep: float = 0.0001
    # Within so many pixels of the edge of something near, a reading may be of what is behind it: windows of stereo,
    # mixed light of time of flight.
    edge_pixels: int = 4
    # How far (pixels, to either side) a reading averages over what is beside its place, at most: windows of stereo,
    # smoothing. A frame whose neighbours do not err together shows that it is less. Of cameras of seven tuning families
    # at 2 and 3.5 mm a pixel 6 makes the true errors of 749 answers likeliest; with 7, less likely by 0.01 nats each,
    # regions of both senses hold 93 and 94 % of them, with 6 they hold 93 and 91.
    window: float = 7.0
    # Smooth bias of the surface, metres, and the correlation length of that bias in pixels: exp(-d^2 / (2 length^2)).
    bias_sigma: float = 0.0025
    bias_length: float = 40.0
    # In the search rows are weighed down instead: rows within this many pixels count as one. A bias so smooth moves and
    # tilts what is seen but leaves its shape, hence less than its length; but where neither mask nor hand model tells
    # what is in front, whole fingers and not single pixels are taken for the object, and they outvote the contacts.
    sharing_length: float = 12.0
    sharing_length_unknown: float = 40.0
    # A cloud without its camera says nothing of its noise: error of a filtered stereo cloud in a hand's frame, metres,
    # and how many independent patches its points amount to.
    cloud_sigma: float = 0.0035
    cloud_patches: float = 30.0
    # Relative error of the depth scale.
    scale_sigma: float = 0.006
    # How far the whole image may lie beside where its camera model has it, pixels an axis: the principal point of a
    # usual calibration is good to some tenths, depth that was registered to another image was seen one and more off.
    shift_sigma: float = 0.5

    def __post_init__(self) -> None:
        """Refuse what is no size."""
        check_sizes(self)

    def through(self, focal: float) -> DepthModel:
        """The same camera with a focal length of so many pixels: sizes in pixels that nobody told (those that are the
        defaults) are as large in the scene as in the usual camera's image.

        Windows, smoothing and lenses smear over angles, and depth that was registered to a larger colour image, or
        enlarged, has no more independent readings for it. Images with fewer pixels keep the usual sizes: a window has
        as many pixels there.
        """
        times = min(focal / USUAL_FOCAL, MOST_TIMES)
        if not times > 1.0:
            return self
        usual = usual_beliefs().depth
        untold = [name for name in IN_PIXELS if getattr(self, name) == getattr(usual, name)]
        larger = {name: times * getattr(self, name) for name in untold}
        if "edge_pixels" in larger:
            larger["edge_pixels"] = round(larger["edge_pixels"])
        return replace(self, **larger)

    def blunting(self, depth: float, focal: float, radius: float) -> float:
        """Standard deviation (m) of the surface of an object of this radius (m) at this depth (m), as its readings
        show it with a focal length of so many pixels, beyond what is usual: averaged over w to either side, what is
        bent by 1 / radius moves by some w^2 / radius, and no more than half of w. Nothing where w is what everything
        was tuned with.
        """
        across = self.window * depth / focal
        return min(max(across**2 - USUAL_WINDOW**2, 0.0) / max(radius, 1e-9), 0.5 * across)

    def independent_sigma(self, depth: Array) -> Array:
        """Standard deviation (m) of one pixel's independent noise at depth (m)."""
        return self.axial_floor + self.axial_growth * np.square(depth - self.axial_from)

    def sloping_sigma(self, depth: Array, cosine: Array, focal: float) -> Array:
        """Standard deviation (m) along its ray of a pixel whose ray meets the surface at an incidence of this cosine.

        depth (m), cosine (above 0), focal length in pixels.
        """
        theta = np.arccos(np.clip(cosine, 0.0, 1.0))
        past = np.maximum(0.5 * np.pi - theta, 1e-2)
        steep = self.axial_steep / np.sqrt(np.maximum(depth, 0.05)) * np.square(theta / past)
        axial = self.independent_sigma(depth) + np.where(theta > np.deg2rad(60.0), steep, 0.0)
        lateral = (self.lateral_sigma + self.lateral_growth * theta / past) * depth / focal
        return np.asarray(np.hypot(axial, lateral * np.tan(theta)), dtype=np.float64)


@dataclass(frozen=True)
class CalibrationModel:
    """How far the robot may be from where it says it is, seen from the camera. By judgement."""

    # camera_from_robot after a usual hand-eye calibration: metres and radians per axis, at the camera.
    translation_sigma: float = 0.0028
    rotation_sigma: float = float(np.deg2rad(0.42))

    def __post_init__(self) -> None:
        """Refuse what is no size."""
        check_sizes(self)


@dataclass(frozen=True)
class TouchModel:
    """What is believed of touch beyond the contacts' own sigmas. By judgement."""

    # What a contact is worth beside another sense when its recording does not say, metres: kinematics, calibration and
    # fingertip shape together (iCub's fingertips are some millimetres off its stereo cloud).
    unknown_sigma: float = 0.004
    # Error of the finger joints between palm and fingertip, metres (0.4 degrees at three joints).
    fingertip_sigma: float = 0.0011

    def __post_init__(self) -> None:
        """Refuse what is no size."""
        check_sizes(self)


@dataclass(frozen=True)
class ImageModel:
    """How far the image beside depth may lie beside where depth has things, pixels of the image per axis.

    A camera whose colours and depth are of one sensor, or registered to a fraction of a pixel, is worth a small
    `colour_sigma`; a grey image of another camera than depth's, the `grey_sigma` that colour cameras have.
    """

    # Of an image without colours: it is taken for the infra-red image that depth was computed from.
    grey_sigma: float = 0.25
    # Of a colour camera's image, brought to depth by a calibration that leaves 1 to 3 px (by judgement; a frame that
    # shows more is believed).
    colour_sigma: float = 1.5

    def __post_init__(self) -> None:
        """Refuse what is no size."""
        check_sizes(self)

    def sigma(self, grey: bool) -> float:
        """Of an image that has no colours, or that has."""
        return self.grey_sigma if grey else self.colour_sigma

    def of_another_camera(self) -> ImageModel:
        """The same where depth is another camera's, whatever the colours: grey is then worth no more than they are."""
        return replace(self, grey_sigma=max(self.grey_sigma, self.colour_sigma))


@dataclass(frozen=True)
class Beliefs:
    """Everything that is believed of a recording before it is looked at. The mesh by judgement."""

    depth: DepthModel = field(default_factory=DepthModel)
    calibration: CalibrationModel = field(default_factory=CalibrationModel)
    touch: TouchModel = field(default_factory=TouchModel)
    # What a mesh and its lattice leave out of a real object, metres: scans of products agree to half a millimetre.
    mesh_sigma: float = 0.0006
    image: ImageModel = field(default_factory=ImageModel)

    def __post_init__(self) -> None:
        """Refuse what is no size."""
        check_sizes(self)


@cache
def usual_beliefs() -> Beliefs:
    """What is believed where nothing is said: made and checked once."""
    return Beliefs()
