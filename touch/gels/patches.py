"""One press of a gel is a patch of the object's surface: points with normals, and untouched skin around it. SI units.

Of the tens of thousands of pixels a few dozen say all that a pose can learn: half of the kept points are spread evenly,
the other half are those that tell the most of the pose, chosen one by one so that the determinant of its information
grows most (D-optimal design; Fedorov 1972).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError
from scenes.geometry import poses as se3
from scenes.recordings.frames import Frame
from scenes.robot.gels import Gel
from touch.gels.skin.heights import HeightSettings, Indentation, indentation_of
from touch.gels.skin.kernels import most_telling

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PatchSettings:
    """How images become points."""

    heights: HeightSettings = field(default_factory=HeightSettings)
    # Points kept of a patch, and of the untouched skin around it.
    points: int = 48
    silent: int = 32
    # Points of an even grid that the kept ones are chosen from.
    candidates: int = 400
    # Normals are taken over this far (m) to each side: finer, they are the image's grain.
    reach: float = 0.0004
    # Error (rad) of a measured normal and of one of an outline's cap.
    normal_measured: float = float(np.deg2rad(4.0))
    normal_outline: float = float(np.deg2rad(9.0))
    # A cap's slope is as wrong as its depth, as a share, but no more than this: at the outline the depth is 0.
    rim_most: float = 1.0
    # Fewer touched pixels than this share of the image are no contact.
    smallest: float = 0.0015


@dataclass(frozen=True)
class Patch:
    """points (n, 3) m of the object's surface and its outward normals (n, 3); sigma (n,) m and sigma_normal (n,) rad of
    the gel's own error; silent (m, 3) m places of skin that felt nothing; measured: heights are measured, not an
    outline's; pressed: the whole indentation it is from, in the sensor's own pixels. frame_from_sensor (4, 4). All in
    one frame.
    """

    sensor: str
    points: Array
    normals: Array
    sigma: Array
    sigma_normal: Array
    silent: Array
    frame_from_sensor: Array
    measured: bool = True
    pressed: Indentation | None = None

    def __len__(self) -> int:
        return len(self.points)

    @property
    def middle(self) -> Array:
        """(3,) mean of the points, put onto the point nearest to it."""
        return np.asarray(self.points[int(np.argmin(((self.points - self.points.mean(axis=0)) ** 2).sum(axis=1)))])

    @property
    def normal(self) -> Array:
        """(3,) mean outward normal of the object."""
        total = self.normals.sum(axis=0)
        length = float(np.linalg.norm(total))
        return total / length if length > 1e-9 * len(self.normals) else -self.frame_from_sensor[:3, 2]

    def moved(self, target_from_source: Array) -> Patch:
        """The same patch in another frame."""
        turn = target_from_source[:3, :3].T
        return Patch(
            self.sensor,
            se3.apply(target_from_source, self.points),
            self.normals @ turn,
            self.sigma,
            self.sigma_normal,
            se3.apply(target_from_source, self.silent),
            target_from_source @ self.frame_from_sensor,
            self.measured,
            self.pressed,
        )


def patch_of(sensor: str, pressed: Indentation, settings: PatchSettings | None = None) -> Patch:
    """The patch of one indentation, sensor frame; without points when nothing is touched."""
    settings = settings or PatchSettings()
    gel, touched, silent = pressed.gel, pressed.touched, ~pressed.moved
    if touched.mean() < settings.smallest:
        touched = np.zeros_like(touched)
        silent = ~pressed.moved
    u, v = _grid(touched, settings.candidates)
    reach = max(1, round(settings.reach / gel.spacing))
    points, normals, good = _oriented(gel, pressed.depth, touched, u, v, reach)
    u, v, points, normals = u[good], v[good], points[good], normals[good]
    chosen = _thinned(points, normals, settings.points)
    u, v, points, normals = u[chosen], v[chosen], points[chosen], normals[chosen]
    slack = np.full(len(points), settings.normal_measured)
    if not pressed.measured and len(points):
        # a cap of another depth is as much steeper or flatter: nothing in its middle, the most at its rim
        relative = pressed.sigma[v, u] / np.maximum(pressed.depth[v, u], 1e-9)
        cosine = np.clip(-(normals * gel.untouched_normals[v, u]).sum(axis=1), -1.0, 1.0)
        slack = np.hypot(settings.normal_outline, np.minimum(relative, settings.rim_most) * np.arccos(cosine))
    su, sv = _grid(silent, settings.silent)
    return Patch(
        sensor,
        points,
        normals,
        pressed.sigma[v, u],
        slack,
        _places(gel, np.zeros_like(pressed.depth), su, sv),
        np.eye(4),
        pressed.measured,
        pressed,
    )


def patches_of(frame: Frame, settings: PatchSettings | None = None) -> list[Patch]:
    """All gels of a frame, camera frame, in the frame's order.

    Raises CaptureError when the frame has gels' images but no hand, joints or hand pose, for a sensor that the hand
    does not have, InputError for images that do not fit it.
    """
    settings = settings or PatchSettings()
    if not frame.gels:
        return []
    if frame.hand is None or frame.world_from_hand is None or (frame.joints is None and frame.hand.joint_names):
        raise CaptureError(f"{frame.where}: gels' images need a hand, its joints and its pose")
    hand_from_sensor = frame.hand.hand_from_sensor(frame.joints or {})
    camera_from_hand = frame.camera_from_world @ frame.world_from_hand
    out = []
    for name, image in frame.gels.items():
        sensor = frame.hand.sensors.get(name)
        if sensor is None or sensor.gel is None:
            known = ", ".join(s.name for s in frame.hand.sensors.values() if s.gel is not None) or "none"
            raise CaptureError(f"{frame.where}: expected a gel of the hand ({known}), got {name}")
        where = f"{frame.where}: gel {name}"
        known_depth = _known_depth(frame, name, frame.world_from_hand @ hand_from_sensor[name], sensor.gel)
        pressed = indentation_of(image, sensor.gel, where, known_depth, settings.heights)
        patch = patch_of(name, pressed, settings)
        out.append(patch.moved(camera_from_hand @ hand_from_sensor[name]))
    return out


def _known_depth(frame: Frame, name: str, world_from_sensor: Array, gel: Gel) -> tuple[int, int, float] | None:
    """Pixel (u, v) and indentation (m) of a contact that the gel's own name reports."""
    rows = [row for row, other in enumerate(frame.contacts.sensors) if other == name]
    if not rows:
        return None
    x, y, z = se3.apply(se3.inverse(world_from_sensor), frame.contacts.points[rows[:1]])[0]
    if gel.matrix is None:
        assert gel.pitch is not None
        u, v = x / gel.pitch + 0.5 * (gel.width - 1), y / gel.pitch + 0.5 * (gel.height - 1)
    else:
        assert gel.distance is not None
        if not z > -0.9 * gel.distance:
            return None
        u, v, _ = gel.matrix @ np.array([x, y, z + gel.distance]) / (z + gel.distance)
    if not (-0.5 <= u < gel.width - 0.5 and -0.5 <= v < gel.height - 0.5):
        return None
    column, row = round(float(u)), round(float(v))
    return column, row, float(gel.surface[row, column] - z)


def _grid(mask: NDArray[np.bool_], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of about `count` pixels of the mask, on an even grid."""
    total = int(mask.sum())
    if not total:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    step = max(1, int(np.sqrt(total / count)))
    v, u = np.nonzero(mask[step // 2 :: step, step // 2 :: step])
    if not len(u):
        v, u = (values[:: max(1, total // count)] for values in np.nonzero(mask))
        return u, v
    return u * step + step // 2, v * step + step // 2


def _places(gel: Gel, depth: Array, u: NDArray[np.int64], v: NDArray[np.int64]) -> Array:
    """(n, 3) the skin at pixels, pressed in by depth (h, w)."""
    z = gel.surface[v, u] - depth[v, u]
    across = gel.rays[v, u] if gel.distance is None else gel.rays[v, u] * (gel.distance + z)[:, None]
    return np.concatenate([across, z[:, None]], axis=1)


def _oriented(
    gel: Gel, depth: Array, touched: NDArray[np.bool_], u: NDArray[np.int64], v: NDArray[np.int64], reach: int
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points (n, 3), the object's outward normals (n, 3), and which (n,) have neighbours to take a normal from.

    Differences reach to both sides where those are touched, else from the point itself.
    """
    points = _places(gel, depth, u, v)

    def neighbour(du: int, dv: int) -> Array:
        x, y = np.clip(u + du, 0, gel.width - 1), np.clip(v + dv, 0, gel.height - 1)
        there = touched[y, x]
        return np.where(there[:, None], _places(gel, depth, x, y), points)

    across = neighbour(reach, 0) - neighbour(-reach, 0)
    down = neighbour(0, reach) - neighbour(0, -reach)
    normal = -np.cross(across, down)  # columns x rows look out of the finger; the object's normal looks back
    length = np.linalg.norm(normal, axis=1)
    good = length > 0.02 * (gel.spacing * reach) ** 2
    return points, normal / np.maximum(length, 1e-300)[:, None], good


def _thinned(points: Array, normals: Array, count: int) -> NDArray[np.int64]:
    """Indices of at most `count` points: every k-th, and those with the most to say of the pose."""
    total = len(points)
    if total <= count:
        return np.arange(total)
    even = np.linspace(0, total - 1, count // 2).astype(np.int64)
    middle = points.mean(axis=0)
    scale = max(float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean())), 1e-9)
    # a point on the surface constrains the pose along its normal (T1 eq. 3.3's Jacobian), lengths in patch sizes
    jac = np.concatenate([np.cross((points - middle) / scale, normals), normals], axis=1)
    inverse = np.linalg.inv(jac[even].T @ jac[even] + 1e-3 * np.eye(6))
    chosen = np.zeros(count, dtype=np.int64)
    chosen[: len(even)] = even
    most_telling(jac, inverse, chosen, len(even))
    return np.sort(chosen)
