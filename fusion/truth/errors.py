"""Judge poses: against the truth when there is one, against the recorded points always. Metres, radians."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.truth import metrics
from scenes.geometry import poses
from scenes.geometry.nearest import Nearest
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from touch.contacts import places_touched
from vision.look.points import all_points

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JudgeSettings:
    """What counts as a success, and how finely errors are measured. Values by judgement where no source is named."""

    # ADD-S (m) below this is a success: a parallel gripper closes on it (the threshold of the tables).
    success: float = 0.005
    # Observed points within this (m) of the surface are the object's, not its neighbours' (T2 chapter 6 uses 1 cm).
    inlier: float = 0.010
    # Points of the truth, and points of the surface among which their nearest is sought: 0.7 mm apart on a hand tool,
    # so that a symmetric object at its truth has an ADD-S of 0.3 mm at most. The first are the head of the second, so
    # an asymmetric one has exactly 0.
    queries: int = 2_000
    targets: int = 100_000


@dataclass(frozen=True)
class Errors:
    """Errors of one pose: add, add_s, translation (m), rotation (rad) modulo symmetry; nees, NaN without covariance."""

    add: float
    add_s: float
    rotation: float
    translation: float
    nees: float = float("nan")

    def to_json(self) -> dict[str, float | None]:
        """Millimetres and degrees, as in result.json."""
        named = {
            "add_mm": 1e3 * self.add,
            "add_s_mm": 1e3 * self.add_s,
            "rotation_deg": float(np.rad2deg(self.rotation)),
            "translation_mm": 1e3 * self.translation,
            "nees": self.nees,
        }
        return {name: value if np.isfinite(value) else None for name, value in named.items()}


@dataclass(frozen=True)
class Agreement:
    """How a pose agrees with what was recorded, m: mean |distance| to the surface of the cloud's inliers and of all
    contacts (NaN for none); inliers: share of the points near the object that are inliers.
    """

    cloud: float
    contacts: float
    inliers: float

    def to_json(self) -> dict[str, float | None]:
        """Millimetres."""
        named = {"cloud_mm": 1e3 * self.cloud, "contacts_mm": 1e3 * self.contacts, "inlier_share": self.inliers}
        return {name: value if np.isfinite(value) else None for name, value in named.items()}


class Judge:
    """Measures poses of one object; keeps the object's samples between calls."""

    def __init__(self, model: ObjectModel, settings: JudgeSettings | None = None) -> None:
        """Cheap; samples are drawn at the first use."""
        self.model = model
        self.settings = settings or JudgeSettings()

    @staticmethod
    @lru_cache(maxsize=4)
    def of(model: ObjectModel) -> Judge:
        """The judge of this object by the usual settings: with its samples, when they were drawn before."""
        return Judge(model)

    @cached_property
    def _targets(self) -> Array:
        return metrics.model_points(self.model, self.settings.targets)

    @cached_property
    def _nearest(self) -> Nearest:
        return Nearest(self._targets)

    def errors(self, pose: Array, truth: Array, covariance: Array | None = None) -> Errors:
        """Errors of a pose (4, 4) against the truth; covariance (6, 6) about the centroid gives the NEES."""
        points, model = self._targets[: self.settings.queries], self.model
        nees = float("nan")
        if covariance is not None:
            error = metrics.pose_error(pose, truth, model.centroid, model.symmetries)
            nees = metrics.nees(error, covariance)
        return Errors(
            metrics.add(pose, truth, points),
            metrics.add_s(pose, truth, points, self._nearest),
            metrics.rotation_error(pose, truth, model.symmetries),
            metrics.translation_error(pose, truth, model.symmetries, model.centroid),
            nees,
        )

    def agreement(self, frame: Frame, pose: Array) -> Agreement:
        """Distances of the frame's points and contacts to the surface of the object at `pose` (camera frame)."""
        model, nan = self.model, float("nan")
        object_from_camera = poses.inverse(pose)
        felt = nan
        touched = places_touched(frame)
        if len(touched):
            felt = float(np.abs(model.field.distance(poses.apply(object_from_camera, touched))).mean())
        points = poses.apply(object_from_camera, all_points(frame))
        near = points[np.linalg.norm(points - model.centroid, axis=1) < model.radius + self.settings.inlier]
        if not len(near):
            return Agreement(nan, felt, 0.0 if len(points) else nan)
        distance = np.abs(model.field.distance(near))
        inside = distance < self.settings.inlier
        # of a cloud every point was meant to be the object's; a depth image holds the whole room
        total = len(points) if frame.cloud is not None and frame.depth is None else len(near)
        return Agreement(float(distance[inside].mean()) if inside.any() else nan, felt, float(inside.sum()) / total)


def json_number(value: Any) -> Any:
    """Numbers as JSON can hold them: NaN and infinity become null, NumPy's become Python's; containers are walked."""
    if isinstance(value, dict):
        return {str(key): json_number(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_number(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return json_number(value.tolist())
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
