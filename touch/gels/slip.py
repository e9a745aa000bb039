"""Slip: the shape that presses a gel moves over the skin otherwise than an object that the hand holds.

From one image to the next the indentation is moved, turned, scaled and lifted until it fits best (least squares on its
gradients; Lucas and Kanade 1981, with gain and offset as by Hager and Belhumeur, PAMI 1998): a deeper press is a gain
or an offset, no motion. The equations tell their own uncertainty, so that a plane or a cylinder, whose shape does not
change along itself, says nothing in that direction. An object that goes along with the finger keeps its place on the
skin; one that keeps its place in the palm moves over the skin as the finger's joints say; what is held by several
fingers is somewhere between. Only what is far from all of these is a slip. Sensor frame, metres, radians.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.recordings.frames import Frame
from touch.gels.patches import Patch
from touch.gels.skin.heights import Indentation

Array = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class PatchSlipSettings:
    """How a patch's motion is measured, and when it is a slip. Values by judgement, limits tuned on other seeds."""

    # Pixels of the shorter side that are compared: heights are smooth over a tenth of that.
    side: int = 60
    # Smoothing (those pixels) of coarse and fine fits, and steps of each.
    blurs: tuple[float, ...] = (2.0, 0.8)
    steps: int = 6
    # Longest motion (share of the image's shorter side) and turn (rad) that a fit may find.
    farthest: float = 0.25
    most_turn: float = float(np.deg2rad(30.0))
    # Share of what the nearest fit leaves, below which one that begins where the phases agree is believed.
    clearly: float = 0.8
    # Least share of both touched areas together that both have: of less, another thing is touched.
    overlap: float = 0.35
    # Error (m) of a height that images of one sensor do not share.
    noise: float = 0.00002
    # How far a held object may creep (m) and turn (rad) on soft skin without slipping, standard deviations.
    creep: float = 0.00008
    twist: float = float(np.deg2rad(1.5))
    # The same (m, rad) of heights that an outline and its own colours tell: they flicker from image to image.
    outline_creep: float = 0.0004
    outline_twist: float = float(np.deg2rad(6.0))
    # A press that is deeper or lighter rolls and spreads over the skin by so many times the difference, and turns by
    # that over half a patch's width (m).
    spread: float = 1.0
    half: float = 0.004
    # Sigmas of noise and creep together, from which one patch has slipped, and two have. Held still, 800 frames of
    # other seeds never had two in a row beyond 1.8.
    alone: float = 2.8
    together: float = 2.4
    # Share of those limits for heights that both images measure: held still, 300 frames of another seed never had two
    # in a row beyond 1.4 sigmas, and slides of shapes that say little have 2.2 to 3.
    measured: float = 0.8
    # A gel's own past, of so many frames before those that are compared, tells how it flickers: this quantile of its
    # sigmas (no unit) is the usual one, and limits go with it, down to `quiet` for what outlines tell (measured heights
    # have theirs above) and up to `restless`: a patch at a gel's rim that comes and goes has 3 sigmas each third
    # frame. `fresh`: until there are `few` frames of it.
    past: int = 16
    quantile: float = 0.9
    usual: float = 1.5
    quiet: float = 0.7
    restless: float = 2.0
    fresh: float = 1.3
    few: int = 3
    # Frames ago that a patch is compared with: a slip lasts a tenth of a second and more, soft skin creeps in minutes.
    memory: int = 4


@dataclass(frozen=True)
class PatchMotion:
    """shift (3,): x and y (m) in the sensor's plane and turn (rad) about its z of what presses, from one image to the
    next; covariance (3, 3); left: RMS (m) of the heights that it leaves; deeper: how much deeper (m) it presses;
    measured: by heights that both images tell; explained: share of the change, in the mean square, that is this motion.
    """

    shift: Array
    covariance: Array
    left: float
    deeper: float
    measured: bool = True
    explained: float = 1.0


@dataclass(frozen=True)
class PatchChange:
    """What the gels say of one frame: slipped; statistic, above 1 is a slip, the lesser of two frames; sigmas: how far
    each patch is from what a held object's may do, by sensor.
    """

    slipped: bool
    statistic: float
    sigmas: dict[str, float] = field(default_factory=dict)


class PatchWatch:
    """Compares each gel's patch with what it was a moment ago, frame after frame."""

    def __init__(self, settings: PatchSlipSettings | None = None) -> None:
        """Cheap."""
        self.settings = settings or PatchSlipSettings()
        self._before: dict[str, deque[Patch]] = {}
        self._history: dict[str, deque[float]] = {}
        self._last = 0.0

    def restart(self) -> None:
        """Forget what the patches were."""
        self._before, self._history, self._last = {}, {}, 0.0

    def step(self, patches: Sequence[Patch]) -> PatchChange:
        """The patches of the next frame, in a frame that goes with the palm."""
        s = self.settings
        kept: dict[str, deque[Patch]] = {}
        sigmas: dict[str, float] = {}
        limits: dict[str, float] = {}
        for patch in patches:
            if patch.pressed is None or not len(patch):
                continue  # a contact that ends, or begins, is no slip
            past = self._before.get(patch.sensor, deque(maxlen=s.memory))
            motion = patch_motion(past[0].pressed, patch.pressed, s) if past and past[0].pressed is not None else None
            if past and motion is None:
                past = deque(maxlen=s.memory)  # another grip
            elif motion is not None:
                sigmas[patch.sensor] = sigmas_off(motion, carried(past[0], patch), s)
                limits[patch.sensor] = self._limit(patch.sensor, motion.measured)
            past.append(patch)
            kept[patch.sensor] = past
        self._history = {name: self._history.get(name, deque(maxlen=s.past)) for name in kept}
        for name, off in sigmas.items():
            if name in kept:
                self._history[name].append(off)
        second, first = sorted([0.0, 0.0, *(off / limits[name] for name, off in sigmas.items())])[-2:]
        now = max(first / s.alone, second / s.together)
        # one image that is odd is no slip: two in a row must say so
        statistic, self._last = min(now, self._last), now
        if statistic > 1.0:  # what comes next is compared with where the object has come to
            kept = {name: deque([past[-1]], maxlen=s.memory) for name, past in kept.items()}
        self._before = kept
        return PatchChange(statistic > 1.0, statistic, sigmas)

    def _limit(self, sensor: str, measured: bool) -> float:
        """The share of the settings' limits that counts for one gel: by how its heights are known, and its own past."""
        s = self.settings
        before = list(self._history.get(sensor, ()))[: -s.memory]
        known, least = (s.measured, 1.0) if measured else (1.0, s.quiet)
        if len(before) < s.few:
            return known * s.fresh
        return known * float(np.clip(np.quantile(before, s.quantile) / s.usual, least, s.restless))


def in_palm(frame: Frame, patches: Sequence[Patch]) -> list[Patch]:
    """A frame's patches, camera frame, in its hand's."""
    assert frame.world_from_hand is not None
    hand_from_camera = se3.inverse(frame.camera_from_world @ frame.world_from_hand)
    return [patch.moved(hand_from_camera) for patch in patches]


def carried(before: Patch, after: Patch) -> Array:
    """(3,) how an object that stays in the palm moves over the skin (x, y, turn); patches in the palm's frame."""
    now_from_before = se3.inverse(after.frame_from_sensor) @ before.frame_from_sensor
    middle = se3.apply(se3.inverse(before.frame_from_sensor), before.middle[None])
    moved = se3.apply(now_from_before, middle)[0] - middle[0]
    return np.array([moved[0], moved[1], se3.log_rotation(now_from_before[:3, :3])[2]])


def sigmas_off(motion: PatchMotion, palm: Array, settings: PatchSlipSettings) -> float:
    """How many sigmas a motion is from the nearest of what a held object's may be: 0 to `palm` (3,); a change that is
    mostly none of this motion counts as little of one.
    """
    spread = settings.spread * motion.deeper
    creep, twist = settings.creep, settings.twist
    if not motion.measured:
        creep, twist = settings.outline_creep, settings.outline_twist
    held = [np.hypot(creep, spread)] * 2 + [np.hypot(twist, spread / settings.half)]
    wide = motion.covariance + np.diag(np.square(held))
    half = np.linalg.inv(np.linalg.cholesky(wide))
    off, way = half @ motion.shift, half @ palm
    length = float(way @ way)
    share = float(np.clip(off @ way / length, 0.0, 1.0)) if length > 1e-12 else 0.0
    return motion.explained * float(np.linalg.norm(off - share * way))


def patch_motion(
    before: Indentation, after: Indentation, settings: PatchSlipSettings | None = None
) -> PatchMotion | None:
    """How what presses has moved over the skin; None when nothing or another thing does. Images of one sensor."""
    import cv2

    s = settings or PatchSlipSettings()
    if before.depth.shape != after.depth.shape or not (before.touched.any() and after.touched.any()):
        return None
    pixel = max(1.0, min(before.depth.shape) / s.side)
    (old, was_touched, had_moved), (new, is_touched, has_moved) = (_shrunk(p, pixel) for p in (before, after))
    if not ((was_touched > 0.5).any() and (is_touched > 0.5).any()):
        return None
    side = min(old.shape)
    v, u = np.nonzero(was_touched > 0.5)
    middle = np.array([u.mean(), v.mean()])
    window = cv2.createHanningWindow((old.shape[1], old.shape[0]), cv2.CV_32F)
    guess = np.array(cv2.phaseCorrelate(old.astype(np.float64), new.astype(np.float64), window.astype(np.float64))[0])
    starts = [np.zeros(3)]
    if 1.0 < np.linalg.norm(guess) < s.farthest * side:
        starts.append(np.array([*guess, 0.0]))
    best = None
    for start in starts:
        found, left, hessian = start, np.inf, np.zeros((3, 3))
        for blur in s.blurs:
            a, b = (np.asarray(cv2.GaussianBlur(z, (0, 0), blur), dtype=np.float32) for z in (old, new))
            found, left, hessian = _fit(a, b, had_moved, has_moved > 0.5, middle, found, s)
        if best is None or left < s.clearly * best[1]:
            best = found, left, hessian
    assert best is not None
    found, left, hessian = best
    if not np.isfinite(left) or np.linalg.norm(found[:2]) > s.farthest * side or abs(found[2]) > s.most_turn:
        return None
    carried_on, touched = _warped(was_touched, found, middle) > 0.5, is_touched > 0.5
    if (carried_on & touched).sum() < s.overlap * max((carried_on | touched).sum(), 1):
        return None
    # smoothed pixels are not independent: one of so many counts
    together = (2.0 * np.sqrt(np.pi) * s.blurs[-1]) ** 2
    # turns in units of half the image, so that nothing is badly scaled; a direction without gradients stays unknown
    scale = np.array([1.0, 1.0, 2.0 / side])
    weak = np.diag(np.repeat((s.farthest * side) ** -2, 3))
    information = hessian * scale * scale[:, None] / (together * (left**2 + s.noise**2)) + weak
    covariance = np.linalg.inv(information) * scale * scale[:, None]
    metres = np.array([pixel * before.gel.spacing, pixel * before.gel.spacing, 1.0])
    was, now = (float(np.percentile(p.depth[p.touched], 90.0)) for p in (before, after))
    both = before.measured and after.measured
    a, b = (np.asarray(cv2.GaussianBlur(z, (0, 0), s.blurs[-1]), dtype=np.float32) for z in (old, new))
    unmoved = _fit(a, b, had_moved, has_moved > 0.5, middle, np.zeros(3), replace(s, steps=1))[1]
    explained = float(np.clip(1.0 - (left / max(unmoved, 1e-12)) ** 2, 0.0, 1.0))
    return PatchMotion(
        found * metres, covariance * metres * metres[:, None], float(left), abs(now - was), both, explained
    )


def _shrunk(pressed: Indentation, pixel: float) -> tuple[Image, Image, Image]:
    """Depth (m), and what share was touched and moved, in pixels that are `pixel` times as wide."""
    import cv2

    height, width = pressed.depth.shape
    size = max(2, round(width / pixel)), max(2, round(height / pixel))
    maps = (np.asarray(m, dtype=np.float32) for m in (pressed.depth, pressed.touched, pressed.moved))
    depth, touched, moved = (cv2.resize(m, size, interpolation=cv2.INTER_AREA) for m in maps)
    return np.asarray(depth), np.asarray(touched), np.asarray(moved)


def _places(shape: tuple[int, ...], motion: Array, middle: Array) -> tuple[Array, Array]:
    """Where (h, w) each pixel was before it moved by (x, y, turn) about the middle (2,)."""
    y, x = np.indices(shape, dtype=np.float64)
    x, y = x - middle[0] - motion[0], y - middle[1] - motion[1]
    c, sine = np.cos(motion[2]), np.sin(motion[2])
    return c * x + sine * y + middle[0], -sine * x + c * y + middle[1]


def _warped(image: Image, motion: Array, middle: Array) -> Image:
    import cv2

    u, v = _places(image.shape, motion, middle)
    out = cv2.remap(image, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderValue=0.0)
    return np.asarray(out, dtype=np.float32)


def _fit(
    old: Image,
    new: Image,
    had_moved: Image,
    has_moved: NDArray[np.bool_],
    middle: Array,
    start: Array,
    settings: PatchSlipSettings,
) -> tuple[Array, float, Array]:
    """Motion (3,) in pixels and radians, RMS (m) left, and the motion's own information (3, 3) times the variance, gain
    and offset taken out. Gauss-Newton from `start`.
    """
    found, kept = start.copy(), (start.copy(), np.inf, np.zeros((3, 3)))
    for _ in range(settings.steps):
        moved = _warped(old, found, middle)
        asked = (_warped(had_moved, found, middle) > 0.5) | has_moved
        v, u = np.nonzero(asked)
        if len(u) < 20:
            break
        down, across = np.gradient(moved, axis=0), np.gradient(moved, axis=1)
        gx, gy, here = across[v, u].astype(np.float64), down[v, u].astype(np.float64), moved[v, u].astype(np.float64)
        x, y = u - middle[0] - found[0], v - middle[1] - found[1]
        # what is moved by +1 pixel is lower by its gradient
        jac = np.stack([-gx, -gy, gx * y - gy * x, here, np.ones_like(here)], axis=1)
        size = np.maximum(np.sqrt((jac**2).mean(axis=0)), 1e-12)
        jac = jac / size
        residual = new[v, u] - here
        gram = jac.T @ jac + 1e-6 * len(u) * np.eye(5)
        step = np.linalg.solve(gram, jac.T @ residual)
        left = float(np.sqrt(np.mean((residual - jac[:, 3:] @ _own(jac[:, 3:], residual)) ** 2)))
        if left < kept[1]:
            motion, rest = gram[:3, :3], gram[:3, 3:]
            own = motion - rest @ np.linalg.solve(gram[3:, 3:], rest.T)
            kept = found.copy(), left, own * size[:3] * size[:3, None]
        found = found + step[:3] / size[:3]
        if np.abs(step[:2] / size[:2]).max() < 1e-3 and abs(step[2] / size[2]) < 1e-4:
            break
        limit = settings.farthest * min(old.shape)
        if np.linalg.norm(found[:2]) > 2.0 * limit or abs(found[2]) > 2.0 * settings.most_turn:
            break
    return kept


def _own(columns: Array, residual: Array) -> Array:
    """Gain and offset (2,) that fit the residual alone."""
    gram = columns.T @ columns + 1e-6 * len(residual) * np.eye(columns.shape[1])
    return np.asarray(np.linalg.solve(gram, columns.T @ residual))
