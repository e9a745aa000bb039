"""What fits between the fingers: poses that a hand's geometry and joints propose, contacts or none.

A grip is two fingertips that face each other across a gap. Of the object, places are drawn where it is as thick as the
gap between faces that look apart (antipodal points; Nguyen, IJRR 1988), and laid between the tips at every turn about
the line that joins them. Hand frame in, any frame out; metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.robot.hands import Hand
from scenes.robot.tips import tip_of

Array = NDArray[np.float64]

GAP_POINTS = 2000  # of the hand, a few millimetres apart: what is held is asked for to a centimetre


@dataclass(frozen=True)
class HeldSettings:
    """How many poses a hand proposes, and what fits. By judgement, on the tuning families `d435` and `lab`."""

    # Poses in all, and surface points among which thicknesses are looked for.
    count: int = 480
    points: int = 1200
    # Thickness and gap may differ by so much (m): joints are off, soft tips give way; one standard deviation.
    fits: float = 0.006
    # Cosine between the faces' normals below which they look apart: 45 degrees off is more than friction holds.
    apart: float = -0.7
    # Tips nearer to each other than this (m) hold nothing between them.
    narrowest: float = 0.003
    # Where along the gap and across it the middle of the held part is, standard deviation (m): tips bend around things.
    slack: float = 0.008


@dataclass(frozen=True)
class Held:
    """A hand at its joints: camera_from_hand (4, 4), or of any other frame."""

    hand: Hand
    joints: dict[str, float]
    camera_from_hand: Array

    def starts(self, model: ObjectModel, rng: np.random.Generator, settings: HeldSettings | None = None) -> Array:
        """(n, 4, 4) camera_from_object of the object between two fingertips; none when nothing of it fits there."""
        s = settings or HeldSettings()
        middles, axes, gaps = grips(self.hand, self.joints, s.narrowest)
        places, lines, thick = thicknesses(model, s)
        if not len(gaps) or not len(thick):
            return np.zeros((0, 4, 4))
        grip = np.arange(s.count) % len(gaps)
        odds = np.exp(-0.5 * np.square((gaps[:, None] - thick) / s.fits))
        fits = odds.sum(axis=1) > 1e-3
        grip = grip[fits[grip]]
        if not len(grip):
            return np.zeros((0, 4, 4))
        chances = np.cumsum(odds, axis=1)
        drawn = rng.random(len(grip)) * chances[grip, -1]
        place = np.zeros(len(grip), dtype=np.int64)
        for g in np.unique(grip):
            place[grip == g] = np.searchsorted(chances[g], drawn[grip == g])
        place = np.minimum(place, len(thick) - 1)
        spun = se3.exp_rotation(axes[grip] * rng.uniform(0.0, 2.0 * np.pi, size=(len(grip), 1)))
        rotations = spun @ upright(axes[grip]) @ np.swapaxes(upright(lines[place]), 1, 2)
        where = middles[grip] + rng.normal(size=(len(grip), 3)) * s.slack
        out = se3.make_poses(rotations, where - np.einsum("nij,nj->ni", rotations, places[place]))
        return np.asarray(self.camera_from_hand @ out)

    def gap(self, model: ObjectModel, pose: Array) -> float:
        """Metres between the hand's surface and the object's at pose (4, 4), where they are nearest; 0: they meet."""
        points = self.hand.points_on_surface(self.joints, most=GAP_POINTS)
        local = se3.apply(se3.inverse(pose) @ self.camera_from_hand, points)
        return max(0.0, float(model.field.distance(local).min(initial=np.inf)))


def grips(hand: Hand, joints: dict[str, float], narrowest: float) -> tuple[Array, Array, Array]:
    """Every two fingertips: middle (k, 3) and direction (k, 3) of the gap between them, hand frame, and its width (k,).

    Tips are the touch sensors with a surface, one a link; a hand without such has the links at its ends.
    """
    frames = hand.forward_kinematics(joints)
    tips: dict[str, tuple[Array, float]] = {}
    for sensor in hand.sensors.values():
        tip = tip_of(sensor)
        if tip is not None and sensor.link not in tips:
            at = se3.apply(frames[sensor.link] @ sensor.link_from_sensor, tip.centre[None])[0]
            tips[sensor.link] = at, tip.radius
    if len(tips) < 2:
        parents = {joint.parent for joint in hand.robot.joints}
        for name, shapes in hand.robot.links.items():
            if name not in parents and shapes:
                points = np.concatenate([shape.vertices for shape in shapes])
                at = se3.apply(frames[name], points.mean(axis=0)[None])[0]
                tips[name] = at, float(0.5 * np.ptp(points, axis=0).min())
    places = np.array([place for place, _ in tips.values()]).reshape(-1, 3)
    radii = np.array([radius for _, radius in tips.values()])
    first, second = np.triu_indices(len(places), 1)
    line = places[second] - places[first]
    length = np.linalg.norm(line, axis=1)
    gap = length - radii[first] - radii[second]
    use = (gap > narrowest) & (length > 1e-6)
    axes = line[use] / np.maximum(length[use, None], 1e-12)
    # the middle of the gap, not of the tips: one may be the thicker
    middles = places[first][use] + axes * (radii[first] + 0.5 * gap)[use, None]
    return middles, axes, gap[use]


_FOUND: WeakKeyDictionary[ObjectModel, dict[HeldSettings, tuple[Array, Array, Array]]] = WeakKeyDictionary()


def thicknesses(model: ObjectModel, settings: HeldSettings) -> tuple[Array, Array, Array]:
    """Middles (n, 3) of the lines on which the object is held between two faces that look apart, their directions
    (n, 3) and lengths (n,), object frame; found at the first call for an object, and not to be written to.
    """
    kept = _FOUND.setdefault(model, {})
    if settings not in kept:
        points, normals = model.sample_surface(settings.points)
        length = model.surface.cast(points - 1e-5 * normals, -normals)
        good = np.isfinite(length)
        points, normals, length = points[good], normals[good], length[good] + 1e-5
        ends = points - normals * length[:, None]
        apart = np.sum(model.field.normals(ends) * normals, axis=1) < settings.apart
        points, normals, length = points[apart], normals[apart], length[apart]
        kept[settings] = points - 0.5 * normals * length[:, None], normals, length
    return kept[settings]


def upright(directions: Array) -> Array:
    """(n, 3, 3) rotations whose third columns are unit directions (n, 3)."""
    other = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    first = np.cross(other, directions)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    return np.stack([first, np.cross(directions, first), directions], axis=2)
