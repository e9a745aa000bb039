"""What sensors do to the truth: contacts, wrenches, joints, the calibration between camera and robot; presets of all.

Depth images are in `depth`. Metres, radians, newtons.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError, unknown
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Rendering
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import DEFAULT_SIGMA_NORMAL, DEFAULT_SIGMA_POINT, Contacts
from scenes.synthesis.noise.colour_camera import ColourCamera, ColourErrors, draw_lasting
from scenes.synthesis.noise.depth import (
    DepthErrors,
    DepthNoise,
    axial_sigma,
    depth_steps,
    draw_depth_errors,
    incidence_angles,
    lateral_sigma,
    observed,
    projector_shadow,
    quantised,
    smooth_field,
)
from scenes.synthesis.noise.recorder import Recorder
from scenes.synthesis.optics.known_cameras import KNOWN_CAMERAS
from scenes.synthesis.optics.settings import OpticalCamera
from scenes.synthesis.optics.units import CameraUnit, draw_unit

__all__ = [
    "PRESETS",
    "DepthErrors",
    "DepthNoise",
    "LastingErrors",
    "NoisePreset",
    "Recorder",
    "RobotNoise",
    "TouchNoise",
    "axial_sigma",
    "camera_from_robot_error",
    "depth_steps",
    "draw_lasting_errors",
    "incidence_angles",
    "lateral_sigma",
    "observe_contacts",
    "observe_depth",
    "observe_joints",
    "observe_wrench",
    "preset",
    "projector_shadow",
    "quantised",
    "smooth_field",
]

Array = NDArray[np.float64]
Depth = NDArray[np.float32]

# Sigmas written beside perfect contacts: a sigma of 0 would be infinite trust (m, rad).
SMALLEST_SIGMA_POINT = 1e-4
SMALLEST_SIGMA_NORMAL = np.deg2rad(0.5)


@dataclass(frozen=True)
class TouchNoise:
    """Errors of contacts and wrenches."""

    # Standard deviation of a contact point per axis (m): 0.9 mm, T1 section 4.3.
    point: float = DEFAULT_SIGMA_POINT
    # Standard deviation of a contact normal per tangential axis (rad): 5 degrees, T1 section 4.3.
    normal: float = float(DEFAULT_SIGMA_NORMAL)
    # Standard deviation of an offset along the normal that all contacts of a frame share (m): a fingertip worn or
    # measured wrong.
    offset: float = 0.0
    # Standard deviation of force and torque, share of the largest component of each.
    wrench: float = 0.01
    # Standard deviation of an offset along the normal that each fingertip has of its own (m): its shape is not the
    # one in the sensors file.
    shape: float = 0.0
    # What each wrench sensor reads when nothing touches it, standard deviation per axis (N, N m), and how far that
    # moves from frame to frame (N, N m; a random walk).
    force_offset: float = 0.0
    torque_offset: float = 0.0
    force_drift: float = 0.0
    torque_drift: float = 0.0
    # Taxels: noise of a reading, standard deviation (Pa), and the share of taxels that are broken.
    taxel: float = 0.0
    dead: float = 0.0


@dataclass(frozen=True)
class RobotNoise:
    """Errors of the robot's knowledge of itself. 0 is off; the presets have values by judgement."""

    # camera_from_robot calibration: standard deviation per axis, rotation (rad) and translation (m).
    camera_rotation: float = 0.0
    camera_translation: float = 0.0
    # Joint angles: standard deviation (rad); the same number in metres for a sliding joint is meaningless, those
    # are left alone.
    joint: float = 0.0


@dataclass(frozen=True)
class NoisePreset:
    """All errors of a recording."""

    # As `--noise` has it; the errors of depth, of touch, and of the robot's knowledge of itself.
    name: str
    # Errors by formulas, or a camera imitated from its optics.
    depth: DepthNoise | OpticalCamera = field(default_factory=DepthNoise)
    touch: TouchNoise = field(default_factory=TouchNoise)
    robot: RobotNoise = field(default_factory=RobotNoise)
    # A colour camera beside depth; None where the image is in perfect registration, as a depth camera's own is.
    colour: ColourCamera | None = None
    # What is done to depth before it is stored; None where it stays as the camera had it.
    recorder: Recorder | None = None


# A fingertip force/torque sensor of 12 mm after taring: offsets of 20 mN and 0.1 N mm, drifting by a tenth of that.
_LAB_TOUCH = TouchNoise(force_offset=0.02, torque_offset=1e-4, force_drift=0.002, torque_drift=1e-5, taxel=400.0)
_LAB_ROBOT = RobotNoise(float(np.deg2rad(0.3)), 0.002, float(np.deg2rad(0.3)))
# Robots and fingertips beside the cameras imitated from their optics: other sizes than the lab's, so that nothing tuned
# on the lab knows them. Fingertips are worn or crudely made, robots calibrated well or badly; chosen, not measured.
_WORN_TOUCH = TouchNoise(
    point=0.0007,
    normal=float(np.deg2rad(8.0)),
    offset=0.0008,
    wrench=0.03,
    shape=0.0004,
    force_offset=0.035,
    torque_offset=2.2e-4,
    force_drift=0.003,
    torque_drift=4e-5,
    taxel=700.0,
    dead=0.03,
)
_WELL_CALIBRATED = RobotNoise(float(np.deg2rad(0.17)), 0.0012, float(np.deg2rad(0.45)))
_CRUDE_TOUCH = TouchNoise(
    point=0.0013,
    normal=float(np.deg2rad(3.5)),
    offset=0.0002,
    wrench=0.006,
    shape=0.0007,
    force_offset=0.012,
    torque_offset=0.6e-4,
    force_drift=0.001,
    torque_drift=2e-5,
    taxel=250.0,
)
_BADLY_CALIBRATED = RobotNoise(float(np.deg2rad(0.42)), 0.0031, float(np.deg2rad(0.12)))
_RIGS = {
    "d435": (_WORN_TOUCH, _WELL_CALIBRATED),
    "d455": (_CRUDE_TOUCH, _BADLY_CALIBRATED),
    "xtion": (_WORN_TOUCH, _BADLY_CALIBRATED),
    "azure-kinect": (_CRUDE_TOUCH, _WELL_CALIBRATED),
    "l515": (_WORN_TOUCH, _BADLY_CALIBRATED),
}

_NO_DEPTH_NOISE = DepthNoise(axial=0, lateral=0, disparity_step=0, grazing_start=np.pi / 2, grazing_end=np.pi / 2)

PRESETS: dict[str, NoisePreset] = {
    preset.name: preset
    for preset in (
        NoisePreset("none", _NO_DEPTH_NOISE, TouchNoise(0.0, 0.0, 0.0, 0.0)),
        NoisePreset("clean"),
        NoisePreset(
            "lab",
            DepthNoise(flying=0.5, bias=0.002, scale=0.005),
            _LAB_TOUCH,
            _LAB_ROBOT,
        ),
        NoisePreset(
            "harsh",
            DepthNoise(
                axial=2.0,
                lateral=1.5,
                grazing_start=float(np.deg2rad(60.0)),
                grazing_end=float(np.deg2rad(80.0)),
                dropout=0.05,
                shadow=True,
                flying=0.8,
                bias=0.004,
                scale=0.01,
                thin=5,
                multipath=0.3,
            ),
            TouchNoise(
                2 * DEFAULT_SIGMA_POINT,
                2 * float(DEFAULT_SIGMA_NORMAL),
                offset=0.0005,
                wrench=0.02,
                shape=0.0005,
                force_offset=0.05,
                torque_offset=3e-4,
                force_drift=5e-3,
                torque_drift=3e-5,
                taxel=1500.0,
                dead=0.08,
            ),
            RobotNoise(float(np.deg2rad(0.6)), 0.004, float(np.deg2rad(0.6))),
        ),
        # The lab with other cameras. Time of flight reads no disparity and throws no shadow, but light takes detours;
        # stereo has a baseline of 50 mm and windows of some pixels, in which thin parts vanish.
        NoisePreset(
            "lab-time-of-flight",
            DepthNoise("time of flight", disparity_step=0, multipath=0.4, flying=0.8, bias=0.002, scale=0.003),
            _LAB_TOUCH,
            _LAB_ROBOT,
        ),
        NoisePreset(
            "lab-stereo",
            DepthNoise(
                "stereo",
                match_length=3.0,
                lateral=0.5,
                disparity_step=1 / 32,
                baseline=0.05,
                thin=7,
                shadow=True,
                flying=0.3,
                bias=0.002,
                scale=0.005,
            ),
            _LAB_TOUCH,
            _LAB_ROBOT,
        ),
        *(NoisePreset(name, camera, *_RIGS[name]) for name, camera in KNOWN_CAMERAS.items()),
    )
}


def preset(noise: str | NoisePreset) -> NoisePreset:
    """The named preset, or the one given. Raises InputError, listing the names, for an unknown name."""
    if isinstance(noise, NoisePreset):
        return noise
    if noise not in PRESETS:
        raise unknown("noise", noise, PRESETS)
    return PRESETS[noise]


def observe_depth(
    rendering: Rendering,
    camera: Camera,
    noise: DepthNoise | NoisePreset | str,
    rng: np.random.Generator,
    errors: DepthErrors | None = None,
) -> Depth:
    """As `depth.observed`, for the settings of a preset too.

    Raises InputError for a camera imitated from its optics: that one photographs a scene
    (`scenes.synthesis.optics.take`), as what its second eye and its projector see is not in the rendering.
    """
    settings = noise if isinstance(noise, DepthNoise) else preset(noise).depth
    if not isinstance(settings, DepthNoise):
        raise InputError(f"depth noise: expected formulas, got the camera {settings.name!r}, which photographs a scene")
    return observed(rendering, camera, settings, rng, errors)


@dataclass(frozen=True)
class LastingErrors:
    """What is wrong in the same way in every frame of a recording: one camera, one calibration, the same fingers.

    depth: see DepthErrors, CameraUnit. camera_from_robot (4, 4), see camera_from_robot_error. joints: name -> rad. tip:
    offset of all contacts (m), tips: of each sensor's (m). wrenches: sensor -> (6,) offset of force, torque (N, N m).
    colour: of a colour camera beside depth.
    """

    depth: DepthErrors | CameraUnit
    camera_from_robot: Array
    joints: dict[str, float]
    tip: float
    tips: dict[str, float]
    wrenches: dict[str, Array]
    colour: ColourErrors | None = None

    def drifted(self, noise: TouchNoise, rng: np.random.Generator) -> LastingErrors:
        """The same one frame later: wrench sensors have drifted."""
        step = np.repeat([noise.force_drift, noise.torque_drift], 3)
        wrenches = {name: offset + step * rng.normal(size=6) for name, offset in self.wrenches.items()}
        return replace(self, wrenches=wrenches)


def draw_lasting_errors(
    noise: NoisePreset, camera: Camera, joints: list[str], sensors: list[str], rng: np.random.Generator
) -> LastingErrors:
    """One recording's draw, for these joints and touch sensors."""
    step = np.repeat([noise.touch.force_offset, noise.touch.torque_offset], 3)
    depth = noise.depth
    return LastingErrors(
        draw_depth_errors(camera, depth, rng) if isinstance(depth, DepthNoise) else draw_unit(rng),
        camera_from_robot_error(noise.robot, rng),
        observe_joints(dict.fromkeys(joints, 0.0), noise.robot, rng),
        noise.touch.offset * rng.normal(),
        {name: noise.touch.shape * rng.normal() for name in sensors},
        {name: step * rng.normal(size=6) for name in sensors},
        None if noise.colour is None else draw_lasting(noise.colour, rng),
    )


def observe_contacts(
    contacts: Contacts, noise: TouchNoise, rng: np.random.Generator, errors: LastingErrors | None = None
) -> Contacts:
    """The contacts with the sensors' independent errors, each sensor's own offset and the common one.

    errors: the recording's lasting ones; without them the offsets are drawn anew. The sigmas written are those of the
    independent errors: nobody tells an estimator of the rest.
    """
    n = len(contacts)
    offset = np.full(n, noise.offset * rng.normal() if errors is None else errors.tip)
    points = contacts.points + noise.point * rng.normal(size=(n, 3))
    if errors is not None:
        offset += [errors.tips.get(name, 0.0) for name in contacts.sensors]
    elif noise.shape > 0:
        own = {name: noise.shape * rng.normal() for name in dict.fromkeys(contacts.sensors)}
        offset += [own[name] for name in contacts.sensors]
    points = points + offset[:, None] * np.nan_to_num(contacts.normals)
    normals = contacts.normals.copy()
    known = contacts.has_normal
    tilt = noise.normal * rng.normal(size=(n, 3))
    tilt -= np.nan_to_num(normals) * np.sum(tilt * np.nan_to_num(normals), axis=1, keepdims=True)
    normals[known] = np.einsum("nij,nj->ni", poses.exp_rotation(tilt[known]), normals[known])
    return Contacts(
        points,
        normals,
        max(noise.point, SMALLEST_SIGMA_POINT),
        max(noise.normal, SMALLEST_SIGMA_NORMAL),
        contacts.sensors,
        contacts.forces,
    )


def observe_wrench(
    sensor: str, wrench: Array, noise: TouchNoise, rng: np.random.Generator, errors: LastingErrors | None = None
) -> Array:
    """A wrench (6,) (N, N m) as its sensor tells it: noise in proportion, an offset, and what has drifted."""
    sigma = noise.wrench * np.repeat([np.abs(wrench[:3]).max(), np.abs(wrench[3:]).max()], 3)
    measured = wrench + sigma * rng.normal(size=6)
    if errors is not None:
        return np.asarray(measured + errors.wrenches.get(sensor, 0.0))
    if noise.force_offset > 0 or noise.torque_offset > 0:
        measured = measured + np.repeat([noise.force_offset, noise.torque_offset], 3) * rng.normal(size=6)
    return np.asarray(measured)


def observe_joints(joints: dict[str, float], noise: RobotNoise, rng: np.random.Generator) -> dict[str, float]:
    """Joint angles (rad) as the encoders tell them; draws in the order of the dictionary."""
    return {name: float(value + noise.joint * rng.normal()) for name, value in joints.items()}


def camera_from_robot_error(noise: RobotNoise, rng: np.random.Generator) -> Array:
    """(4, 4) motion exp(xi) that the calibration puts before everything the robot reports, in the camera frame.

    measured camera_from_robot = error @ true camera_from_robot; the rotation is about the camera's centre.
    """
    sigma = np.repeat([noise.camera_rotation, noise.camera_translation], 3)
    return poses.exp(sigma * rng.normal(size=6))
