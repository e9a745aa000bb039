"""Modes that are one answer: the same place of the surface, whichever way round the object lies.

A can stands on its head, a box is turned by half a turn, and nothing but a rim of a millimetre or the print tells: the
pose is one of several, and where the surface is, is known all the same. Such modes are found by the shape itself, since
meshes of real things declare no symmetry: no part of the surface, of a hundredth of it or more, may move by more than
the tolerance that was asked for. That is stricter than the same ADD-S, which a mug's handle hardly changes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.modes import Mode
from scenes.evidence.symmetry.near_symmetries import SAME_AXIS, turns_about
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Points of the surface that are compared, and the share of them that may be farther off: a dent at a scan's edge is no
# part of the object. Of scanned boxes, cans and bottles turned over that leaves 1 to 8 mm, of a banana 10 mm and more,
# of a mug turned away from its handle 17 mm and more.
POINTS, BESIDE = 500, 0.01
# Each way round settles on what was sensed by itself, a little beside the others: so much more than the tolerance is
# still the same.
SETTLED = 1.3
# Steps of a turn that is looked at on its way (rad).
STEP = float(np.deg2rad(15.0))


@dataclass(frozen=True)
class Alike:
    """The first of some modes and those that look like it: modes, and how far (m, mean) the surface of each is from the
    first's; weight: of all of them. near: these, and those of which most of the surface is where the first has it, as a
    mug's is whose handle is out of sight: the mean distance, near_means (m), is within the tolerance.
    """

    modes: tuple[Mode, ...]
    means: Array
    near: tuple[Mode, ...] = ()
    near_means: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def near_weight(self) -> float:
        """The share of the posterior of those that are near."""
        return float(sum(mode.weight for mode in self.near))

    @property
    def weight(self) -> float:
        """Their share of the posterior."""
        return float(sum(mode.weight for mode in self.modes))


def alike(model: ObjectModel, modes: tuple[Mode, ...], tolerance: float) -> Alike:
    """The modes (one at least) between which and the first no part of the surface moves by more than tolerance (m), and
    what they settled apart.
    """
    if len(modes) == 1:
        return Alike(modes, np.zeros(1), modes, np.zeros(1))
    largest, means = moved(model, modes[0].pose, np.array([mode.pose for mode in modes[1:]]))
    same = [k for k in range(len(modes)) if not k or largest[k - 1] <= SETTLED * tolerance]
    near = [k for k in range(len(modes)) if k in same or means[k - 1] <= tolerance]
    off, near_off = (np.array([means[k - 1] if k else 0.0 for k in some]) for some in (same, near))
    return Alike(tuple(modes[k] for k in same), off, tuple(modes[k] for k in near), near_off)


def moved(model: ObjectModel, pose: Array, others: Array) -> tuple[Array, Array]:
    """Largest and mean distance (k,), (k,) (m) between the surface at a pose (4, 4) and at others (k, 4, 4): of points
    of either from the other, the farthest hundredth (`BESIDE`) left out of the largest.
    """
    points, _ = model.sample_surface(POINTS)
    there = se3.inverse(pose) @ others
    both = np.concatenate([there, se3.inverse(there)])
    off = np.abs(
        model.field.distance((points @ np.swapaxes(both[:, :3, :3], -1, -2) + both[:, None, :3, 3]).reshape(-1, 3))
    )
    off = off.reshape(2, len(others), -1)
    last = off.shape[2] - 1 - int(BESIDE * off.shape[2])
    return np.partition(off, last, axis=2)[:, :, last].max(axis=0), off.mean(axis=(0, 2))


def hardly_moves(
    model: ObjectModel, pose: Array, direction: Array, angle: float, tolerance: float, on_average: bool = False
) -> bool:
    """Whether a turn about a direction (3,) in the object's axes through its centroid, by up to an angle (rad) either
    way, moves no part of the surface by more than tolerance (m), and what it settled beside the object's own axis; on
    average: the mean of the surface by more than tolerance; a turn all around is then about the axis of roundness
    that it has there.
    """
    if on_average and angle >= np.pi:
        for turns in turns_about(model):
            log = se3.log_rotation(turns[0, :3, :3])
            if abs(float(log @ direction)) > SAME_AXIS * float(np.linalg.norm(log)):
                return bool(moved(model, pose, pose @ turns)[1].max() <= tolerance)
    count = max(int(np.ceil(min(angle, np.pi) / STEP)), 1)
    angles = np.linspace(0.0, min(angle, np.pi), count + 1)[1:]
    turns = se3.exp_rotation(np.concatenate([angles, -angles])[:, None] * direction)
    poses = pose @ se3.make_poses(turns, model.centroid - turns @ model.centroid)
    largest, means = moved(model, pose, poses)
    return bool(means.max() <= tolerance if on_average else largest.max() <= SETTLED * tolerance)
