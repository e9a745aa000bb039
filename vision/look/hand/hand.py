"""The robot's own hand in the depth image: where it is seen, and where it really is.

A hand that hides the object is itself in plain view. Its pixels tell how far the camera-to-robot calibration is off:
the hand's mesh at its joints is aligned to them, so that contacts and depth meet in one frame. The correction is a
left perturbation of camera_from_hand about the hand's seen centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import Beliefs, CalibrationModel
from scenes.recordings.frames import Frame
from scenes.robot.posed import PosedHand
from vision.look.hand.hand_kernels import pulls
from vision.look.hand.hand_search import HandSearchSettings, elsewhere, here_alone, shares
from vision.look.pixels import Pixels

Array = NDArray[np.float64]


# One pixel of so many is looked at in the first passes of the hand's alignment.
COARSE = 6


@dataclass(frozen=True)
class HandViewSettings:
    """Alignment of the hand to its pixels. By judgement, on generated captures."""

    # Pixels used. With a third of them answers at 90 % hidden were worse by a tenth.
    most: int = 1200
    # A pixel farther than this from the hand's surface is something else, metres, pass after pass.
    gates: tuple[float, ...] = (0.015, 0.010, 0.007, 0.005, 0.005)
    # Pixels nearer than this to the aligned hand are the hand: depth noise and smooth bias at two sigmas, metres.
    margin: float = 0.005
    # Below this many pixels the hand is not seen.
    fewest: int = 60
    # Where else it is looked for.
    search: HandSearchSettings = field(default_factory=HandSearchSettings)


@dataclass(frozen=True)
class HandTold:
    """What a look at the hand tells: its correction (4, 4) camera_from_camera, and what the pixels alone say of that as
    xi (6,) about centre (3,), camera frame: -xi'information xi / 2 + pull'xi nats, information (6, 6) and pull (6,).
    """

    correction: Array
    centre: Array
    information: Array
    pull: Array

    def is_same(self, other: HandTold) -> bool:
        """Whether it is of the same look: also of one that was saved since."""
        return np.array_equal(self.pull, other.pull) and np.array_equal(self.correction, other.correction)

    def about(self, point: Array) -> tuple[Array, Array]:
        """Information (6, 6) and pull (6,) about another point (3,)."""
        lever = np.eye(6)
        lever[3:, :3] = -se3.skew(self.centre - point)
        return lever.T @ self.information @ lever, lever.T @ self.pull


@dataclass(frozen=True)
class HandView:
    """The hand as the robot reports it and as the camera sees it: camera_from_hand (4, 4) measured and aligned.

    xi (6,): the correction found, poses.perturb of the identity about centre (3,) camera frame. points (n, 3): pixels
    that agree, camera frame; residual (n,) m: their distances to the aligned hand; directions (n, 3): the gradients of
    those. surface: the hand's at its joints, hand frame. information (6, 6) and pull (6,): what the pixels alone say of
    the correction, -xi'information xi / 2 + pull'xi nats.
    """

    measured: Array
    aligned: Array
    centre: Array
    xi: Array
    points: Array
    residual: Array
    directions: Array
    surface: PosedHand
    information: Array = field(default_factory=lambda: np.zeros((6, 6)))
    pull: Array = field(default_factory=lambda: np.zeros(6))

    def nearer(self, points: Array, distance: float) -> NDArray[np.bool_]:
        """(n,) whether camera-frame points (n, 3) are nearer than `distance` (m) to the aligned hand, or inside it
        that deep.
        """
        return self.surface.is_within(se3.apply(se3.inverse(self.aligned), points), distance)

    def gap(self, points: Array) -> float:
        """Least distance (m) between camera-frame points (n, 3), n at least 1, and the aligned hand."""
        return self.surface.gap(se3.apply(se3.inverse(self.aligned), points))

    def depth(self, camera: Camera, box: tuple[int, int, int, int]) -> Array:
        """(h, w) depth (m) of the aligned hand through the pixels of a box (u0, v0, u1, v1); inf where it is not."""
        return self.surface.depth(camera, self.aligned, box)

    def box_within(self, camera: Camera, box: tuple[int, int, int, int]) -> tuple[int, int, int, int] | None:
        """The part of a box (u0, v0, u1, v1) of pixels in which the aligned hand may be drawn; None for none."""
        return self.surface.box_within(camera, self.aligned, box)

    def correct(self) -> Array:
        """camera_from_camera transform that moves what the robot reports to where the camera sees it."""
        return self.aligned @ se3.inverse(self.measured)


def camera_from_hand(frame: Frame) -> Array | None:
    """(4, 4) as the robot reports it; None when the frame has no hand pose."""
    if frame.world_from_hand is None:
        return None
    return frame.camera_from_world @ frame.world_from_hand


def prior_information(calibration: CalibrationModel, centre: Array) -> Array:
    """(6, 6) information about a correction at `centre` (camera frame) from errors made at the camera."""
    # (L D L^T)^-1 of the lever L below; it turns back by changing its sign
    turn, move = calibration.rotation_sigma**-2.0, calibration.translation_sigma**-2.0
    lever = se3.skew(centre)
    out = np.zeros((6, 6))
    out[:3, :3] = turn * np.eye(3) + move * (lever.T @ lever)
    out[3:, :3] = move * lever
    out[:3, 3:] = move * lever.T
    out[3:, 3:] = move * np.eye(3)
    return out


def prior_spread(calibration: CalibrationModel, centre: Array) -> Array:
    """(6, 6) lower triangular: turns a vector of unit normal numbers into a correction at `centre` (camera frame) from
    errors made at the camera; times its transpose it is the inverse of `prior_information`.
    """
    out = np.zeros((6, 6))
    out[:3, :3] = calibration.rotation_sigma * np.eye(3)
    # a turn about the camera moves the centre by turn x centre
    out[3:, :3] = -calibration.rotation_sigma * se3.skew(centre)
    out[3:, 3:] = calibration.translation_sigma * np.eye(3)
    return out


def view_hand(
    frame: Frame,
    pixels: Pixels,
    beliefs: Beliefs,
    settings: HandViewSettings | None = None,
) -> HandView | None:
    """Align the frame's hand to the pixels (camera frame) that may show it, and look for it where it is seen better;
    None without a hand, joints or pose.
    """
    settings = settings or HandViewSettings()
    measured = camera_from_hand(frame)
    if frame.hand is None or frame.joints is None or measured is None:
        return None
    surface = PosedHand(frame.hand, frame.joints)
    view = _aligned(surface, measured, np.eye(4), pixels, beliefs, settings)
    again = partial(_aligned, surface, measured, pixels=pixels, beliefs=beliefs, settings=settings)
    return where_seen_better(frame, view, again, settings.search)


def where_seen_better(
    frame: Frame, view: HandView, aligned: Callable[[Array], HandView], settings: HandSearchSettings
) -> HandView:
    """An aligned hand, or where it is seen better far from there: `aligned` from that correction (4, 4)."""
    if frame.depth is None or frame.camera is None or frame.hand is None or frame.joints is None:
        return view
    points = frame.hand.points_on_surface(frame.joints, most=settings.points)
    shift = elsewhere(frame, points, view.aligned, settings)
    if shift is None:
        return view
    other = aligned(se3.make_pose(None, shift) @ view.correct())
    told = [
        float(shares(frame, points, one.aligned, here_alone(), settings.close, settings.beyond).max())
        for one in (view, other)
    ]
    return other if told[1] > told[0] + settings.better else view


def _aligned(
    surface: PosedHand, measured: Array, correction: Array, pixels: Pixels, beliefs: Beliefs, settings: HandViewSettings
) -> HandView:
    """The hand aligned to the pixels that may show it where a correction (4, 4) camera_from_camera has it."""
    begun = correction @ measured
    local, gate = se3.apply(se3.inverse(begun), pixels.points), 2 * settings.gates[0]
    may_be = np.flatnonzero(surface.may_be_within(local, gate))
    step = max(1, len(may_be) // settings.most)
    few = may_be[::step]
    points = pixels.points[few[surface.is_within(local[few], gate)]]
    if len(points) < settings.fewest:
        xi = se3.difference(correction, np.eye(4), begun[:3, 3])
        return HandView(measured, begun, begun[:3, 3], xi, points[:0], np.zeros(0), points[:0], surface)
    centre = points.mean(axis=0)
    xi = se3.difference(correction, np.eye(4), centre)
    return fit_hand(surface, measured, xi, centre, points, pixels.area * step, beliefs, settings.gates)


def fit_hand(
    surface: PosedHand,
    measured: Array,
    xi: Array,
    centre: Array,
    points: Array,
    pixel: float,
    beliefs: Beliefs,
    gates: tuple[float, ...],
) -> HandView:
    """Gauss-Newton on the hand's pixels from the correction xi (6,) about centre (3,), a step for each gate (m).

    points (n, 3) camera frame; pixel: what each stands for, in pixels of the image: neighbours share their bias.
    """
    depth = beliefs.depth
    prior = prior_information(beliefs.calibration, centre)
    patch = max(1.0, depth.sharing_length**2 / pixel)
    weight = 1.0 / (depth.independent_sigma(points[:, 2]) ** 2 + patch * depth.bias_sigma**2)
    for i, gate in enumerate(gates):
        aligned = se3.perturb(np.eye(4), xi, centre) @ measured
        # the first passes only bring the hand near: some of its pixels, each with the weight of those left out
        step = COARSE if i < len(gates) - 1 else 1
        some = points[::step]
        distance, gradient = surface.closest(se3.apply(se3.inverse(aligned), some), gate)
        off, hessian, pull = xi, prior.copy(), prior @ xi
        direction, jac, robust = np.zeros((len(some), 3)), np.zeros((len(some), 6)), np.zeros(len(some))
        turn, each = np.ascontiguousarray(aligned[:3, :3]), step * weight[::step]
        pulls(some, distance, gradient, turn, centre, gate, each, direction, jac, robust, hessian, pull)
        xi = off - np.linalg.solve(hessian, pull)
    aligned = se3.perturb(np.eye(4), xi, centre) @ measured
    # the last step is a fraction of a millimetre: what it changes is linear
    distance, agree = distance + jac @ (xi - off), robust > 0
    seen = points[agree], distance[agree], direction[agree]
    return HandView(measured, aligned, centre, xi, *seen, surface, hessian - prior, hessian @ xi)
