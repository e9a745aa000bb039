"""What somebody would tell of a family who had measured its camera, its robot and its mesh: `Beliefs` of its sizes.

A frame does not tell how well its robot is calibrated or how good its mesh is; where nobody says, a covariance can only
be right on average over what robots and meshes there are. Told the sizes, it has to be right in each family: what is
off then is off in the model. No error itself is told, only its standard deviation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.benchmarks.families.table import RECORDED, Family
from scenes.recordings.beliefs import Beliefs, CalibrationModel, DepthModel, ImageModel, TouchModel
from scenes.recordings.depth_cameras import DEPTH_CAMERAS
from scenes.synthesis.noise.depth import DepthNoise
from scenes.synthesis.staging.mesh_errors import BENT_SIGMA, DENTED_SIGMA, FAT, SCALE, SCAN_SIGMA

# What the lattice leaves out of a mesh without an error, and the smallest of all other sizes (m, rad, share): none may
# be zero.
LATTICE, LEAST = 0.0003, 1e-4
# Depth that is simulated lies where the camera's model has it (px).
NO_SHIFT = 0.0
# From joints to a fingertip's place: three joints in a row at these distances (m, root of the sum of squares).
LEVER = 0.16
# Half an object (m), for an error that is a share of it.
HALF = 0.06
MESHES = {"bent": BENT_SIGMA, "dented": DENTED_SIGMA, "scan": SCAN_SIGMA, "fat": FAT, "scaled": (SCALE - 1.0) * HALF}


def beliefs_of(family: Family) -> Beliefs:
    """Sizes of the family's errors. A camera imitated from its optics has those of its data sheet, where it is on sale,
    and else the usual ones; recordings have the usual ones.
    """
    if family.name == RECORDED:
        return Beliefs()
    preset = family.preset()
    robot, touch = preset.robot, preset.touch
    tips = float(np.linalg.norm([LEVER * robot.joint, touch.shape, touch.offset]))
    return Beliefs(
        _depth(preset.depth),
        CalibrationModel(max(robot.camera_translation, LEAST), max(robot.camera_rotation, LEAST)),
        replace(TouchModel(), fingertip_sigma=max(tips, LEAST)),
        float(np.hypot(LATTICE, MESHES.get(family.mesh_error or "", 0.0))),
        # colours that the depth camera itself sees lie where its depth does, as grey does
        ImageModel() if preset.colour is not None else replace(ImageModel(), colour_sigma=ImageModel().grey_sigma),
    )


def _depth(noise: object) -> DepthModel:
    if not isinstance(noise, DepthNoise):
        return replace(DEPTH_CAMERAS.get(getattr(noise, "name", ""), DepthModel()), shift_sigma=NO_SHIFT)
    bias, scale = max(noise.bias, LEAST), max(noise.scale, LEAST)
    return replace(
        DepthModel(), bias_length=noise.bias_length, bias_sigma=bias, scale_sigma=scale, shift_sigma=NO_SHIFT
    )
