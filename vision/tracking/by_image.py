"""How a thing has moved between two colour images: marks on its surface, found again by what they look like.

Where nothing tells how what holds an object moves, its last velocity says little of the next frame, and depth often
tells nothing of slides along a smooth surface. Corners of its texture say both: they are followed by pyramidal
Lucas-Kanade flow (Lucas & Kanade 1981; Bouguet 2001), there and back, and one rigid motion is fitted to all, which puts
each where it is seen, and as far away as depth has it there. A mark keeps its place on the surface from the first frame
on that it is seen in, so that slow drift is bounded by how long marks live. Camera frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MarkSettings:
    """Marks and what they are worth. By judgement, of usual values, where nothing else is said."""

    # Marks at most, fewest that tell a motion, and the least share of those that were looked for (no unit).
    most: int = 80
    fewest: int = 10
    found: float = 0.4
    # Quality of a corner against the best one's (no unit, of cv2.goodFeaturesToTrack), and pixels between two.
    quality: float = 0.01
    apart: float = 4.0
    # Side of the window (px) and levels of the pyramid by which a mark is found, and how far off the way back may end.
    window: int = 15
    levels: int = 3
    back: float = 0.7
    # Pixels around the marks that are kept of an image: how far they may move from where the velocity has them.
    margin: int = 40
    # Distance (m) of a mark from the surface of the believed pose, by depth.
    near: float = 0.004
    # Standard deviation of where a mark is found (px) and of depth there (m); both can be false (Geman & McClure 1987).
    # Depth's errors, and those of marks along an edge, are shared by many: so many (no unit) know what one does.
    pixel: float = 0.4
    depth: float = 0.004
    sharing: float = 3.0
    # What no mark tells of a motion in one frame, per axis (rad, m): blur, lasting errors of depth. Tuned by sequences
    # of `studio` whose hand nobody tells of.
    angle: float = float(np.deg2rad(0.25))
    distance: float = 0.0004
    # Steps of the fit.
    steps: int = 10
    # An image whose channels differ by less (of 255) everywhere is infra-red or grey: a projector's dots do not move
    # with what they fall on.
    colourful: int = 8


@dataclass(frozen=True)
class Marks:
    """Marks in one frame. index: of the frame; grey (h, w) uint8: the part of its image around them, whose first pixel
    is at corner (2,) (u, v); uv (n, 2) px in the whole image; points (n, 3) where they are.
    """

    index: int
    grey: NDArray[np.uint8]
    corner: tuple[int, int]
    uv: Array
    points: Array


@dataclass(frozen=True)
class Motion:
    """motion (4, 4) camera_from_camera from the frame of the marks to this one, its covariance (6, 6) about centre
    (3,), where that has moved to, and the marks that were found.
    """

    motion: Array
    covariance: Array
    marks: Marks


def is_coloured(rgb: NDArray[np.uint8] | None, settings: MarkSettings) -> bool:
    """Whether an image (h, w, 3) has colours."""
    if rgb is None:
        return False
    few = rgb[::8, ::8].astype(np.int16)
    return bool((few.max(axis=2) - few.min(axis=2)).max() > settings.colourful)


def motion_between(marks: Marks, frame: Frame, expected: Array, centre: Array, settings: MarkSettings) -> Motion | None:
    """How what the marks are on has moved by this frame; None where too few are found again, or its image is another
    kind's. expected (4, 4) camera_from_camera: where to look for them. centre (3,): of the thing, in the marks' frame.
    """
    s, camera, rgb, depth = settings, frame.camera, frame.rgb, frame.depth
    if camera is None or depth is None or rgb is None or len(marks.uv) < s.fewest or not is_coloured(rgb, s):
        return None
    height, width = marks.grey.shape
    u, v = marks.corner
    part = rgb[v : v + height, u : u + width]
    if part.shape[:2] != marks.grey.shape:  # of an image of another size
        return None
    ahead, z = camera.project(se3.apply(expected, marks.points))
    if not (np.isfinite(ahead).all() and (z > 0).all()):
        return None
    now = _grey(part)
    found, good = _followed(marks.grey, now, marks.uv - marks.corner, ahead - marks.corner, s)
    if good.sum() < max(s.fewest, s.found * len(good)):
        return None
    uv, points = found[good] + marks.corner, marks.points[good]
    at = np.rint(uv).astype(np.int64)
    inside = (at >= 0).all(axis=1) & (at[:, 0] < depth.shape[1]) & (at[:, 1] < depth.shape[0])
    at, uv, points = at[inside], uv[inside], points[inside]
    read = depth[at[:, 1], at[:, 0]].astype(np.float64)
    motion, information, kept = rigid_motion(points, uv, read, camera, expected, centre, s)
    if kept.sum() < s.fewest:
        return None
    steps = max(1, abs(frame.index - marks.index))
    lasting = np.diag(np.repeat([s.angle, s.distance], 3) ** 2) * steps
    values, vectors = np.linalg.eigh(information)
    wide = vectors @ np.diag(s.sharing / np.maximum(values, 1e-6)) @ vectors.T
    left = Marks(frame.index, now, marks.corner, uv[kept], se3.apply(motion, points[kept]))
    return Motion(motion, wide + lasting, left)


def _followed(
    before: NDArray[np.uint8], now: NDArray[np.uint8], uv: Array, ahead: Array, settings: MarkSettings
) -> tuple[Array, NDArray[np.bool_]]:
    """Where marks at uv (n, 2) px of one image are in the next, looked for at `ahead` (n, 2), and which are found."""
    import cv2

    side, levels, flags = (settings.window, settings.window), settings.levels, cv2.OPTFLOW_USE_INITIAL_FLOW
    first, guess = uv.astype(np.float32), ahead.astype(np.float32)
    there, seen, _ = cv2.calcOpticalFlowPyrLK(before, now, first, guess, winSize=side, maxLevel=levels, flags=flags)
    back, again, _ = cv2.calcOpticalFlowPyrLK(
        now, before, there, first.copy(), winSize=side, maxLevel=levels, flags=flags
    )
    there, back, seen, again = (np.asarray(one) for one in (there, back, seen, again))
    off = np.linalg.norm(back - first, axis=1)
    good = (seen[:, 0] > 0) & (again[:, 0] > 0) & (off < settings.back) & np.isfinite(there).all(axis=1)
    return there.astype(np.float64), good


def rigid_motion(
    points: Array, uv: Array, read: Array, camera: Camera, start: Array, centre: Array, settings: MarkSettings
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(4, 4) motion that puts points (n, 3) at pixels uv (n, 2) and as far away as read (n,) m there (0: no reading),
    the information (6, 6) about where it moves centre (3,) to, and which points it explains. start (4, 4): its guess.

    Gauss-Newton with Geman and McClure's weights, one for a point's pixel and depth together: what lies before a mark
    takes it along. Turns and displacements that no point tells stay at the guess.
    """
    s, motion, n = settings, start, len(points)
    sigma = np.array([s.pixel, s.pixel, s.depth])
    weight, information = np.ones(n), np.zeros((6, 6))
    for step in range(s.steps):
        p = se3.apply(motion, points)
        middle = se3.apply(motion, centre[None])[0]
        z = np.maximum(p[:, 2], 1e-6)
        jacobian = np.zeros((n, 3, 3))
        jacobian[:, 0, 0], jacobian[:, 0, 2] = camera.fx / z, -camera.fx * p[:, 0] / z**2
        jacobian[:, 1, 1], jacobian[:, 1, 2] = camera.fy / z, -camera.fy * p[:, 1] / z**2
        jacobian[:, 2, 2] = 1.0
        off = np.zeros((n, 3))
        off[:, 0] = camera.fx * p[:, 0] / z + camera.cx - uv[:, 0]
        off[:, 1] = camera.fy * p[:, 1] / z + camera.cy - uv[:, 1]
        off[:, 2] = np.where(read > 0.0, p[:, 2] - read, 0.0)
        r = off / sigma
        square = np.sum(r[:, :2] ** 2, axis=1)
        # the first steps reach farther, for half of the points may be others'
        wide = max(1.0, float(np.median(square))) if step < s.steps // 2 else 1.0
        weight = 1.0 / (1.0 + square / (9.0 * wide)) ** 2 / (1.0 + r[:, 2] ** 2 / (9.0 * wide)) ** 2
        moves = np.concatenate([-jacobian @ se3.skew(p - middle), jacobian], axis=2) / sigma[:, None]
        moves[read <= 0.0, 2] = 0.0
        information = np.einsum("n,nki,nkj->ij", weight, moves, moves)
        gradient = np.einsum("n,nki,nk->i", weight, moves, r)
        damped = information + np.diag(np.repeat([1.0, 1e3], 3) ** 2)  # a radian, a millimetre: of nothing else told
        x = -np.linalg.solve(damped, gradient)
        turn = se3.exp_rotation(x[:3])
        update = se3.make_pose(turn, middle - turn @ middle + x[3:])
        motion = update @ motion
    return motion, information, weight > 0.25


def marked(
    frame: Frame, uv: NDArray[np.int64], area: float, kept: Marks | None, settings: MarkSettings
) -> Marks | None:
    """Marks on a thing in this frame: those of `kept` that are on it still, and corners beside them. uv (n, 2): pixels
    with a reading that are its own, each standing for `area` of them; None where there is no colour image.
    """
    import cv2

    s, camera, rgb, depth = settings, frame.camera, frame.rgb, frame.depth
    if camera is None or depth is None or rgb is None or not len(uv) or not is_coloured(rgb, s):
        return None
    height, width = depth.shape
    low = np.maximum(uv.min(axis=0) - s.margin, 0)
    high = np.minimum(uv.max(axis=0) + s.margin + 1, (width, height))
    grey = _grey(rgb[low[1] : high[1], low[0] : high[0]])
    own = np.zeros(grey.shape, dtype=np.uint8)
    own[uv[:, 1] - low[1], uv[:, 0] - low[0]] = 1
    reach = int(np.ceil(np.sqrt(area)))
    own = np.asarray(cv2.dilate(own, np.ones((reach + 1, reach + 1), np.uint8)))
    # a window that reaches over the edge follows what is beside it
    own = np.asarray(cv2.erode(own, np.ones((reach + 5, reach + 5), np.uint8)))
    old = np.zeros((0, 2)), np.zeros((0, 3))
    if kept is not None and kept.index == frame.index and len(kept.uv):
        at = np.rint(kept.uv).astype(np.int64) - low
        inside = (at >= 0).all(axis=1) & (at[:, 0] < grey.shape[1]) & (at[:, 1] < grey.shape[0])
        at = np.where(inside[:, None], at, 0)
        on = inside & (own[at[:, 1], at[:, 0]] > 0)
        old = kept.uv[on], kept.points[on]
        for u, v in at[on]:
            cv2.circle(own, (int(u), int(v)), int(s.apart), 0, -1)
    new = None
    if len(old[0]) < s.most:
        new = cv2.goodFeaturesToTrack(grey, s.most - len(old[0]), s.quality, s.apart, mask=own)
    pixels, points = old
    if new is not None:
        corners = new[:, 0].astype(np.float64) + low
        at = np.rint(corners).astype(np.int64)
        z = depth[at[:, 1], at[:, 0]].astype(np.float64)
        corners, z = corners[z > 0], z[z > 0]
        rays = np.stack([(corners[:, 0] - camera.cx) / camera.fx, (corners[:, 1] - camera.cy) / camera.fy], axis=1)
        there = np.concatenate([rays * z[:, None], z[:, None]], axis=1)
        pixels, points = np.concatenate([pixels, corners]), np.concatenate([points, there])
    return Marks(frame.index, grey, (int(low[0]), int(low[1])), pixels, points)


def _grey(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    return np.ascontiguousarray(cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY), dtype=np.uint8)
