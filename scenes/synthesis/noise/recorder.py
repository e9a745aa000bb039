"""What recorders do to depth after the camera has measured it: smoothing, filling of holes, registration to colour.

Published recordings are seldom as their camera had them. Camera makers' viewers smooth along edges and fill holes
("Depth post-processing for Intel RealSense depth camera D400 series", Grunnet-Jepsen & Tong, Intel 2018: a recursive
mean over disparity that starts anew across steps, after Gastal & Oliveira, SIGGRAPH 2011), and data sets deliver depth
in the pixels of a larger colour image. Metres, radians, pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError, unknown
from scenes.geometry import poses
from scenes.geometry.cameras import is_reading
from scenes.recordings.frames import Frame
from scenes.synthesis.noise import recorder_kernels as kernels

Array = NDArray[np.float64]

FILLS = ("", "left", "farthest")
# Distance between the imagers of a camera whose disparities are smoothed (m): what the steps below are told of.
BASELINE = 0.05


@dataclass(frozen=True)
class Recorder:
    """What is done to depth, in this order; each part is off at its default."""

    # Side of a median's window (px, odd); 0 is off. Missing readings stay missing, and are not counted.
    median: int = 0
    # Weight (share) of a reading against the mean of those before it in its row or column; 1 is off. How often rows and
    # columns are gone through, there and back, and the step of disparity (px, at BASELINE) across which nothing is
    # mixed. The maker's defaults are 0.5, 2 and 20 / 32 px.
    weight: float = 1.0
    rounds: int = 2
    step: float = 20.0 / 32.0
    # What missing readings take: "" nothing, one of FILLS: the reading to their left, or the farthest beside them.
    fill: str = ""
    # Pixels a side of the colour image that depth is registered to, times depth's own; 0 is off.
    registered: float = 0.0
    # That image's camera from depth's: distance to the right (m) and turn about each axis (rad).
    beside: float = 0.015
    turned: tuple[float, float, float] = (0.002, -0.003, 0.004)

    def __post_init__(self) -> None:
        """Refuse what no recorder does."""
        if self.median < 0 or (self.median and self.median % 2 == 0):
            raise InputError(f"recorder: expected an odd number of pixels for median, or 0, got {self.median}")
        if not (0.0 < self.weight <= 1.0 and self.rounds >= 0 and self.step > 0.0 and self.registered >= 0.0):
            raise InputError(f"recorder: expected a weight above 0 and up to 1, and no negative size, got {self}")
        if self.fill not in FILLS:
            raise unknown("fill", self.fill, FILLS)

    def recorded(self, frame: Frame) -> Frame:
        """The frame as it is delivered. A colour image that depth is registered to has no picture: none is drawn from
        where it stands.
        """
        if frame.depth is None or frame.camera is None:
            return frame
        depth = np.where(is_reading(frame.depth), frame.depth, 0.0).astype(np.float64)
        if self.median > 1:
            depth = median_of_readings(depth, self.median)
        if self.weight < 1.0:
            depth = smoothed(depth, frame.camera.fx * BASELINE, self)
        if self.fill == "left":
            kernels.fill_from_left(depth)
        elif self.fill == "farthest":
            kernels.fill_from_farthest(depth)
        frame = replace(frame, depth=depth.astype(np.float32))
        return self._registered(frame) if self.registered > 0 else frame

    def _registered(self, frame: Frame) -> Frame:
        assert frame.depth is not None
        assert frame.camera is not None
        camera, moved = frame.camera.scaled(self.registered), self.colour_from_depth
        shape = (camera.height, camera.width)
        depth, source = np.zeros(shape), np.zeros(shape, dtype=np.int64)
        lens, other = ((one.fx, one.fy, one.cx, one.cy) for one in (frame.camera, camera))
        before = np.asarray(frame.depth, dtype=np.float64)
        kernels.register(before, lens, other, moved[:3, :3].copy(), moved[:3, 3].copy(), depth, source)
        mask = None if frame.mask is None else frame.mask.ravel()[source] & (depth > 0)
        truth, start = frame.camera_from_object_truth, frame.prior
        return replace(
            frame,
            depth=depth.astype(np.float32),
            camera=camera,
            rgb=None,
            mask=mask,
            camera_from_world=moved @ frame.camera_from_world,
            camera_from_object_truth=None if truth is None else moved @ truth,
            prior=None if start is None else moved @ start,
        )

    @property
    def colour_from_depth(self) -> Array:
        """(4, 4) pose of the depth camera in the colour camera's frame."""
        return poses.make_pose(poses.exp_rotation(np.array(self.turned)), np.array([-self.beside, 0.0, 0.0]))


def median_of_readings(depth: Array, width: int) -> Array:
    """Median (h, w) over the readings of each window of `width` pixels; 0 where there was none."""
    half = width // 2
    padded = np.pad(np.where(depth > 0, depth, np.nan), half, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (width, width)).reshape(*depth.shape, -1)
    out = np.zeros(depth.shape)
    seen = depth > 0
    out[seen] = np.nanmedian(windows[seen], axis=1)
    return out


def smoothed(depth: Array, focal_baseline: float, settings: Recorder) -> Array:
    """Depth (h, w) m whose disparities focal_baseline / depth (px) went through the recursive mean of `settings`."""
    seen = depth > 0
    disparity = np.where(seen, focal_baseline / np.where(seen, depth, 1.0), 0.0)
    for _ in range(settings.rounds):
        kernels.smooth_rows(disparity, settings.weight, settings.step)
        columns = np.ascontiguousarray(disparity.T)
        kernels.smooth_rows(columns, settings.weight, settings.step)
        disparity = np.ascontiguousarray(columns.T)
    return np.where(seen, focal_baseline / np.where(seen, disparity, 1.0), 0.0)
