"""Cameras and robots of the families: errors that no preset has that a user may choose.

Report families share none of them with those that may be tuned on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenes.synthesis.noise.colour_camera import ColourCamera
from scenes.synthesis.noise.depth import DepthNoise
from scenes.synthesis.noise.presets import PRESETS, NoisePreset, RobotNoise, TouchNoise
from scenes.synthesis.noise.recorder import Recorder
from scenes.synthesis.optics.settings import Imager, Matcher, Pattern, PatternCamera, StereoCamera

# Errors that no tuned preset has: between the lab's and the harsh ones, each of another size and the bias of another
# length; a robot whose calibration is better and whose fingertips are worse than the lab's.
_HELD_TOUCH = TouchNoise(
    point=0.0012,
    normal=float(np.deg2rad(7.0)),
    offset=0.0003,
    wrench=0.015,
    shape=0.0006,
    force_offset=0.03,
    torque_offset=1.6e-4,
    force_drift=0.0026,
    torque_drift=1.7e-5,
    taxel=900.0,
    dead=0.04,
)
_HELD_ROBOT = RobotNoise(float(np.deg2rad(0.38)), 0.0028, float(np.deg2rad(0.22)))
_HARSH = PRESETS["harsh"].depth
assert isinstance(_HARSH, DepthNoise)
WORKSHOP = NoisePreset(
    "workshop",
    DepthNoise(
        axial=1.4,
        lateral=0.7,
        disparity_step=1 / 16,
        baseline=0.06,
        grazing_start=float(np.deg2rad(65.0)),
        grazing_end=float(np.deg2rad(82.0)),
        dropout=0.01,
        shadow=True,
        flying=0.35,
        bias=0.0014,
        bias_length=95.0,
        scale=0.0028,
    ),
    _HELD_TOUCH,
    _HELD_ROBOT,
)
# The harsh preset with another camera's baseline and steps, and a bias of another length.
WORN = replace(
    PRESETS["harsh"],
    name="worn",
    depth=replace(_HARSH, baseline=0.09, disparity_step=0.1, bias_length=27.0),
)
# A camera and a robot as bad as those, of other sizes, that may be tuned on.
_ROUGH = DepthNoise(
    axial=1.7,
    lateral=1.1,
    disparity_step=1 / 11,
    baseline=0.07,
    grazing_start=float(np.deg2rad(62.0)),
    grazing_end=float(np.deg2rad(81.0)),
    dropout=0.03,
    shadow=True,
    flying=0.6,
    bias=0.0031,
    bias_length=55.0,
    scale=0.0074,
    thin=3,
)
ROUGH = NoisePreset(
    "rough",
    _ROUGH,
    TouchNoise(
        point=0.0016,
        normal=float(np.deg2rad(9.0)),
        offset=0.0006,
        wrench=0.016,
        shape=0.00045,
        force_offset=0.04,
        torque_offset=2.5e-4,
        force_drift=0.004,
        torque_drift=2.4e-5,
        taxel=1200.0,
        dead=0.06,
    ),
    RobotNoise(float(np.deg2rad(0.5)), 0.0034, float(np.deg2rad(0.5))),
)
# Errors of half as much again as what is believed of a camera and a robot: what a track must learn of its recording.
CRUDE = replace(
    ROUGH,
    name="crude",
    depth=replace(
        _ROUGH,
        axial=2.3,
        lateral=1.3,
        dropout=0.04,
        flying=0.7,
        bias=0.0046,
        bias_length=33.0,
        scale=0.0115,
        thin=4,
        multipath=0.35,
    ),
    touch=replace(ROUGH.touch, point=0.0022, normal=float(np.deg2rad(11.0)), offset=0.0007, shape=0.00065),
    robot=RobotNoise(float(np.deg2rad(0.66)), 0.0045, float(np.deg2rad(0.66))),
)
# A structured-light camera that nobody sells, whose image is as full of its pattern's dots as theirs, every number of
# it another than theirs: to be tuned on.
_DOTS = PatternCamera(
    "dots",
    baseline=0.064,
    pattern=Pattern(density=27000.0, radius=0.0011, spread=0.4, haze=0.08, haze_grain=0.4, power=0.4),
    imager=Imager(
        blur=0.7, ambient=0.08, speckle=0.16, bits=9, read_noise=16.0, exposure=(0.03, 1.4), overexposed=0.025
    ),
    matcher=Matcher(method="block", window=11, disparities=112, step=1 / 10, median=0, uniqueness=10),
    nearest=0.35,
    farthest=4.0,
)
DOTS = NoisePreset("dots", _DOTS, PRESETS["lab"].touch, PRESETS["lab"].robot)
# Active stereo with a colour camera beside it whose calibration is off, as in most recordings that are published.
STUDIO = NoisePreset("studio", PRESETS["d435"].depth, PRESETS["lab"].touch, PRESETS["lab"].robot, colour=ColourCamera())
# Stereo of what things look like by themselves, with OpenCV's matcher as it is: a surface of little texture is not
# read, or wrongly, and as its texture goes with a thing, so do its errors. One of a short baseline to be tuned on, and
# one of a long one, with other windows and steps, whose image is sharper and darker.
_DARK = Pattern(density=2500.0, radius=0.0012, power=0.0)
PASSIVE = NoisePreset(
    "passive",
    StereoCamera(
        "passive",
        baseline=0.07,
        projector=0.035,
        pattern=_DARK,
        imager=Imager(blur=0.7, ambient=0.6, lamp=0.6, speckle=0.0, exposure=(0.02, 4.0)),
        matcher=Matcher(window=9, disparities=112, refinements=0, step=1 / 16, median=3, uniqueness=5),
        farthest=5.0,
    ),
    PRESETS["lab"].touch,
    PRESETS["lab"].robot,
)
DAYLIGHT = NoisePreset(
    "daylight",
    StereoCamera(
        "daylight",
        baseline=0.11,
        projector=0.055,
        pattern=_DARK,
        imager=Imager(blur=0.5, aim=0.22, ambient=0.9, lamp=0.75, speckle=0.0, exposure=(0.01, 3.0)),
        matcher=Matcher(window=5, disparities=160, refinements=1, step=1 / 32, median=5, uniqueness=12),
        farthest=8.0,
    ),
    WORKSHOP.touch,
    WORKSHOP.robot,
)
# Depth as recorders leave it: smoothed as a maker's viewer does by default, holes filled, registered to a larger image.
SMOOTHED = replace(PRESETS["d435"], name="smoothed", touch=PRESETS["lab"].touch, robot=PRESETS["lab"].robot)
SMOOTHED = replace(SMOOTHED, recorder=Recorder(weight=0.5, rounds=2, step=20 / 32))
FILLED = replace(DOTS, name="filled", recorder=Recorder(median=5, fill="farthest"))
REGISTERED = replace(PRESETS["lab"], name="registered", recorder=Recorder(registered=1.6))
RETOUCHED = replace(PRESETS["d455"], name="retouched", recorder=Recorder(median=3, weight=0.35, rounds=1, step=0.9))
RETOUCHED = replace(RETOUCHED, touch=WORKSHOP.touch, robot=WORKSHOP.robot)
PATCHED = replace(PRESETS["xtion"], name="patched", recorder=Recorder(weight=0.7, rounds=3, step=0.3, fill="left"))
PATCHED = replace(PATCHED, touch=WORKSHOP.touch, robot=WORKSHOP.robot)
ALIGNED = replace(WORKSHOP, name="aligned")
ALIGNED = replace(ALIGNED, recorder=Recorder(registered=2.1, beside=-0.032, turned=(-0.006, 0.002, -0.001)))
OWN_PRESETS = {
    one.name: one
    for one in (
        *(WORKSHOP, WORN, ROUGH, CRUDE, DOTS, STUDIO, PASSIVE, DAYLIGHT),
        *(SMOOTHED, FILLED, REGISTERED, RETOUCHED, PATCHED, ALIGNED),
    )
}
