"""Active stereo and structured light: depth from disparity. Camera frame, metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.synthesis.optics.light.infrared import Counts, as_grey, bent, blurred, expose, exposure, project, read_out
from scenes.synthesis.optics.light.views import Scene, see
from scenes.synthesis.optics.matching import disparity
from scenes.synthesis.optics.settings import Build, PatternCamera, StereoCamera
from scenes.synthesis.optics.shots import Shot
from scenes.synthesis.optics.units import CameraUnit

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# Left edge: what a projector or second eye aside of the camera lights and sees beyond the frame (share of the largest
# disparity): things at the nearest reading.
REACH = 1.0


def stereo_shot(scene: Scene, camera: Camera, built: StereoCamera, unit: CameraUnit, rng: np.random.Generator) -> Shot:
    """The depth of the left of two infra-red cameras, and its image."""
    reach = built.matcher.disparities / camera.fx
    projector = project(scene, camera, built.pattern, built.projector, reach, unit.seed)
    lamp, setting, seen = np.array(unit.lamp), None, []
    distortion = built.build.distortion * unit.flaws[5]
    for eye, cubic in ((np.eye(4), 0.0), (_right_from_left(built.baseline, built.build, unit), distortion)):
        view = see(scene, camera, built.samples, eye)
        light = expose(view, scene, projector, eye, lamp, built.imager)
        laser, room = (bent(image, camera, cubic) for image in light)
        setting = setting or exposure(laser + room, built.imager)
        seen.append(read_out(laser, room, built.imager, setting, rng))
    values = disparity(seen[0], seen[1], built.matcher)
    return Shot(_depth(values, camera.fx * built.baseline, 0.0, built.farthest), as_grey(seen[0].image))


def pattern_shot(
    scene: Scene, camera: Camera, built: PatternCamera, unit: CameraUnit, rng: np.random.Generator
) -> Shot:
    """The depth of a camera that finds each piece of a projector's pattern in what it knows of the pattern."""
    import cv2

    reach = built.matcher.disparities / camera.fx
    projector = project(scene, camera, built.pattern, built.baseline, reach, unit.seed)
    eye = _right_from_left(0.0, built.build, unit)
    view = see(scene, camera, built.samples, eye)
    light = expose(view, scene, projector, eye, np.array(unit.lamp), built.imager)
    laser, room = (bent(image, camera, built.build.distortion * unit.flaws[5]) for image in light)
    counts = read_out(laser, room, built.imager, exposure(laser + room, built.imager), rng)
    # the pattern as a camera at the projector's place would see it on a wall far away
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    scale, cx, cy = projector.light_lens
    u = (scale * (columns - camera.cx) / camera.fx + cx).astype(np.float32)
    v = (scale * (rows - camera.cy) / camera.fy + cy).astype(np.float32)
    seen = np.asarray(cv2.remap(projector.light.light, u, v, cv2.INTER_LINEAR), dtype=np.float32)
    known = blurred(seen, built.imager.blur)
    known = known / np.float32(max(float(known.mean()), 1e-9)) * np.float32(built.imager.aim)
    reference = Counts(known, np.full(known.shape, 1.0 / 255.0, dtype=np.float32))
    values = disparity(counts, reference, built.matcher)
    focal_baseline = camera.fx * built.baseline * (1.0 + built.build.baseline * unit.flaws[3])
    return Shot(_depth(values, focal_baseline, built.nearest, built.farthest), as_grey(counts.image))


def _right_from_left(baseline: float, build: Build, unit: CameraUnit) -> Array:
    """The pose that the second eye has and that its calibration does not know of."""
    flaws = np.array(unit.flaws)
    turn = poses.exp_rotation(np.array([build.turned, build.verged, build.turned]) * flaws[:3])
    place = np.array([-baseline * (1.0 + build.baseline * flaws[3]), 0.0, 0.0])
    return poses.make_pose(turn, turn @ place)


def _depth(values: Image, focal_baseline: float, nearest: float, farthest: float) -> Image:
    depth = np.divide(focal_baseline, values, out=np.zeros(values.shape), where=values > 0)
    return np.where((depth >= nearest) & (depth <= farthest), depth, 0.0).astype(np.float32)
