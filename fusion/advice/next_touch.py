"""Where one more contact would tell most about the pose, and which finger is nearest to that place.

The gain of a contact is the information it is expected to give about the pose, in nats. Within a mode it is that of a
linear measurement of a Gaussian, 1/2 log det(1 + H P), H the Fisher information of a contact there (MacKay, Neural
Computation 4, 1992). Between modes it is what the contact would say about which of them is true, bounded from below by
the Bhattacharyya distances of what each predicts (Kolchinsky and Tracey, Entropy 19, 2017, eq. 10). Camera frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate, Mode
from scenes.evidence.align import terms_of_each
from scenes.evidence.table import TOUCH, make
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import DEFAULT_SIGMA_NORMAL, DEFAULT_SIGMA_POINT, Frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NextTouchSettings:
    """What a contact would be, and where it is looked for. Values by judgement where no source is named."""

    # Noise of the contact (m, rad): T1's.
    sigma_point: float = DEFAULT_SIGMA_POINT
    sigma_normal: float = float(DEFAULT_SIGMA_NORMAL)
    # Places on the surface that are tried, evenly.
    places: int = 150
    # Nearer to the hand's surface than this (m) there is no room for another fingertip.
    room: float = 0.008
    # Best places are this far apart, as a share of the object's radius.
    apart: float = 0.2
    # Predictions farther apart than this (m) differ as much as can be: the finger meets nothing there.
    farthest: float = 0.01


@dataclass(frozen=True)
class NextTouch:
    """A place to touch: point and outward normal (3,) in the object's frame and the point in the camera's, metres.

    gain: nats, of which between_modes tells the modes apart. finger: the free sensor nearest to it and how far it is
    (m); None without a hand. sigma_position, sigma_rotation: worst standard deviations (m, rad) that would be left of
    the first mode's covariance by a contact that shares no error (calibration, joints) with those before it.
    """

    point: Array
    normal: Array
    camera_point: Array
    gain: float
    between_modes: float
    sigma_position: float
    sigma_rotation: float
    finger: str | None = None
    finger_distance: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Its entry of result.json."""
        return {
            "object_point": [float(x) for x in self.point],
            "object_normal": [float(x) for x in self.normal],
            "camera_point": [float(x) for x in self.camera_point],
            "gain_nats": self.gain,
            "between_modes_nats": self.between_modes,
            "sigma_position_mm": 1e3 * self.sigma_position,
            "sigma_rotation_deg": float(np.rad2deg(self.sigma_rotation)),
            "finger": self.finger,
            "finger_distance_mm": None if self.finger_distance is None else 1e3 * self.finger_distance,
        }


def next_touches(
    model: ObjectModel,
    answer: Estimate,
    frame: Frame | None = None,
    count: int = 3,
    settings: NextTouchSettings | None = None,
) -> tuple[NextTouch, ...]:
    """The `count` best places, the best first and each apart from those before it.

    frame: leaves out places that its hand leaves no room at, and names the free finger nearest to each.
    """
    settings = settings or NextTouchSettings()
    places, normals = model.sample_surface(settings.places, seed=0)
    seen = se3.apply(answer.pose, places)
    tips, hand = hand_around(frame, answer)
    open_ = np.ones(len(places), dtype=bool)
    if len(hand):  # of which most is farther from the object than any place on it
        middle = seen.mean(axis=0)
        hand = hand[np.abs(hand - middle).max(axis=1) < np.ptp(seen, axis=0).max() + settings.room]
    if len(hand):
        # |a - b|^2 about their middle, where its three terms are of one size: a matrix product instead of n m offsets
        a, b = seen - middle, hand - middle
        gap = np.square(a).sum(axis=1)[:, None] + np.square(b).sum(axis=1) - 2.0 * a @ b.T
        open_ = gap.min(axis=1) > settings.room**2
    gain, between, within = gains(model, answer, places, normals, settings)
    return tuple(
        NextTouch(
            places[i].copy(),
            normals[i].copy(),
            seen[i].copy(),
            float(gain[i]),
            float(between[i]),
            *within[i][1:],
            *nearest_finger(tips, seen[i]),
        )
        for i in best_apart(places, np.where(open_, gain, -np.inf), count, settings.apart * model.radius)
    )


def best_apart(places: Array, gain: Array, count: int, apart: float) -> list[int]:
    """Indices of the `count` places (n, 3) of most gain (n,), the best first, each farther than `apart` (m) from those
    before it; places whose gain is -inf do not count.
    """
    chosen: list[int] = []
    for i in np.argsort(-gain, kind="stable").tolist():
        if len(chosen) == count or gain[i] == -np.inf:
            break
        if all(np.linalg.norm(places[i] - places[j]) > apart for j in chosen):
            chosen.append(i)
    return chosen


def nearest_finger(tips: Mapping[str, Array], point: Array) -> tuple[str | None, float | None]:
    """The name of the tip (3,) nearest to a point (3,), one frame, and how far it is (m); None without tips."""
    if not tips:
        return None, None
    away = {name: float(np.linalg.norm(tip - point)) for name, tip in tips.items()}
    name = min(away, key=away.__getitem__)
    return name, away[name]


def gains(
    model: ObjectModel, answer: Estimate, places: Array, normals: Array, settings: NextTouchSettings | None = None
) -> tuple[Array, Array, list[tuple[float, float, float]]]:
    """What a contact at each place (n, 3), outward normals (n, 3), object frame, is expected to tell.

    Returns nats in all (n,), nats between modes (n,), and per place nats within the first mode and the worst sigmas
    (m, rad) that it would leave.
    """
    settings = settings or NextTouchSettings()
    seen, outward = se3.apply(answer.pose, places), normals @ answer.pose[:3, :3].T
    within = _within(model, answer, seen, outward, settings)
    between = _between(model, answer.modes, seen, outward, settings)
    return np.array([w[0] for w in within]).reshape(-1) + between, between, within


def hand_around(frame: Frame | None, answer: Estimate) -> tuple[dict[str, Array], Array]:
    """Sensors of links that touch nothing, with their places (3,), and points (n, 3) of the hand's surface, in the
    camera's frame.

    The hand is placed as the answer has it in the object's frame, where its correction of the calibration is in.
    """
    if frame is None or frame.hand is None or frame.joints is None or answer.hand_from_object is None:
        return {}, np.zeros((0, 3))
    camera_from_hand = answer.pose @ se3.inverse(answer.hand_from_object)
    sensors = frame.hand.sensors
    # a finger that one of its sensors reports touches, whatever the others of its link say
    busy = {sensors[contact.sensor].link for contact in answer.contacts if contact.sensor in sensors}
    tips = {
        name: se3.apply(camera_from_hand, pose[None, :3, 3])[0]
        for name, pose in frame.hand.hand_from_sensor(frame.joints).items()
        if sensors[name].link not in busy
    }
    return tips, se3.apply(camera_from_hand, frame.hand.points_on_surface(frame.joints))


def _within(
    model: ObjectModel, answer: Estimate, points: Array, normals: Array, settings: NextTouchSettings
) -> list[tuple[float, float, float]]:
    """Nats that a contact at each point with its outward normal (n, 3) gives about the first mode; worst sigmas (m,
    rad) left by it.
    """
    if not len(points):
        return []
    rows = make(
        points,
        settings.sigma_point,
        TOUCH,
        normals=normals,
        sigma_normal=settings.sigma_normal,
        from_outside=True,
    )
    information = terms_of_each(model, rows, answer.pose)
    here = answer.modes[0].covariance
    scale = np.sqrt(np.maximum(np.diag(here), 1e-30))
    before = here / scale / scale[:, None]
    told = information * scale * scale[:, None]
    # I + L' H L is symmetric and at least the identity, whatever the covariance is
    lower = np.linalg.cholesky(before + 1e-9 * np.eye(6))
    system = np.eye(6) + lower.T @ told @ lower
    after = lower @ np.linalg.solve(system, np.broadcast_to(lower.T, system.shape)) * scale * scale[:, None]
    left = [np.sqrt(np.maximum(np.linalg.eigvalsh(after[:, k : k + 3, k : k + 3])[:, -1], 0.0)) for k in (3, 0)]
    nats = 0.5 * np.linalg.slogdet(system)[1]
    return list(zip(nats.tolist(), left[0].tolist(), left[1].tolist()))


def _between(
    model: ObjectModel, modes: Sequence[Mode], points: Array, normals: Array, settings: NextTouchSettings
) -> Array:
    """(n,) nats that contacts looked for at points (n, 3) along normals (n, 3) tell about which mode is true."""
    if len(modes) < 2:
        return np.zeros(len(points))
    distances, felt = [], []
    for mode in modes:
        local = se3.apply(se3.inverse(mode.pose), points)
        distances.append(np.clip(model.field.distance(local), -settings.farthest, settings.farthest))
        felt.append(model.field.normals(local) @ mode.pose[:3, :3].T)
    weights = np.array([mode.weight for mode in modes])
    total = np.zeros(len(points))
    for k in range(len(modes)):
        overlap = np.zeros(len(points))
        for j in range(len(modes)):
            moved = (distances[k] - distances[j]) / settings.sigma_point
            cosine = np.clip(np.sum(felt[k] * felt[j], axis=1), -1.0, 1.0)
            turned = np.arccos(cosine) / settings.sigma_normal
            overlap += weights[j] * np.exp(-0.125 * (moved**2 + turned**2))
        total -= weights[k] * np.log(np.maximum(overlap, 1e-300))
    return np.maximum(total, 0.0)
