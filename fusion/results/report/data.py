"""Everything the report's page shows, as one dictionary of plain JSON values.

Geometry travels as base64 of little-endian int16 in tenths of a millimetre, relative to the object's centroid at the
estimate (camera axes), or to the centroid itself for the model: a frame costs tens of kilobytes, not megabytes.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.advice.grasp import GraspAnswer
from fusion.advice.next_touch import NextTouch, next_touches
from fusion.estimation.answer import Estimate
from fusion.results.report import pictures, words
from fusion.results.report.grasps import add_grasps
from fusion.results.report.outline import silhouette
from fusion.results.report.rows import comparison_rows, rounded, summary_rows
from fusion.results.report.shapes import shown_hand, shown_object
from fusion.truth import metrics
from fusion.truth.errors import Judge
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]
Json = dict[str, Any]

TENTHS_OF_MM = 1e4  # per metre

# A page of thirty frames stays below 2 MB, one of a hundred below 5; the model comes once a page.
MODEL_FACES = 5000
HAND_FACES = 2200
CLOUD_POINTS = 2600
PICTURE_WIDTH = 640
SMALLEST_SHARE = 0.5  # of the pictures' width, however many frames there are
FEW_FRAMES = 12  # beyond this many frames, each is given less

# Cloud points farther from the object than this many of its radii are not shown.
CLOUD_REACH = 2.2

# Points nearer to the estimate than this (tenths of a millimetre) are its own: they are the first to be shown.
AGREEING = 60.0


def report_data(
    capture_name: str,
    frames: Sequence[Frame],
    model: ObjectModel,
    estimates: Sequence[Estimate],
    comparison: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
    errors: Mapping[str, Any] | None = None,
    grasps: Sequence[GraspAnswer] | None = None,
    touches: Sequence[Sequence[NextTouch]] | None = None,
) -> Json:
    """The page's data. Frames without an estimate are left out; an estimate without its frame is refused."""
    by_index = {frame.index: frame for frame in frames}
    stray = [estimate.frame for estimate in estimates if estimate.frame not in by_index]
    if stray:
        raise InputError(f"report: expected estimates of the frames given, got one of frame {stray[0]}")
    builder = _FrameBuilder(model, len(estimates))
    told: Sequence[Sequence[NextTouch] | None] = touches or [None] * len(estimates)
    made = [builder.build(by_index[estimate.frame], estimate, near) for estimate, near in zip(estimates, told)]
    mesh = builder.model_mesh()
    add_grasps(made, model, estimates, grasps or (), builder.shown_vertices)
    symmetries = model.symmetries
    return {
        "capture": capture_name,
        "object": {
            "name": model.name,
            "diameter_mm": round(1e3 * model.diameter, 1),
            "symmetry": words.symmetry(len(symmetries.axes), len(symmetries.discrete), symmetries.is_spherical),
        },
        "mesh": mesh,
        "handFaces": builder.hand_faces,
        "frames": made,
        "comparison": comparison_rows(comparison),
        "summary": summary_rows(errors),
    }


class _FrameBuilder:
    """Builds frames, keeping what all of them share: renderer, judge, the hand's triangles."""

    def __init__(self, model: ObjectModel, count: int) -> None:
        self.model = model
        self.share = min(1.0, FEW_FRAMES / max(1, count)) ** 0.5
        self.renderer = Renderer({"object": (model.vertices, model.faces)})
        self.judge = Judge.of(model)
        self.shown_vertices = np.zeros((0, 3))
        self.hand_faces: str | None = None

    def model_mesh(self) -> Json:
        """The model with at most MODEL_FACES triangles, relative to its centroid."""
        vertices, faces = shown_object(self.model, MODEL_FACES)
        self.shown_vertices = vertices + self.model.centroid
        return {"v": _shorts(vertices), "f": _base64(faces.astype("<u2"))}

    def build(self, frame: Frame, estimate: Estimate, touches: Sequence[NextTouch] | None) -> Json:
        pose = np.asarray(estimate.pose, dtype=np.float64)
        usable = bool(np.isfinite(pose).all())
        before = estimate.start if estimate.start is not None else frame.prior
        truth = frame.camera_from_object_truth
        named = {"after": pose if usable else None, "before": before, "truth": truth}
        shown = {name: value for name, value in named.items() if value is not None and np.isfinite(value).all()}
        anchor = next(iter(shown.values()), np.eye(4))
        centre = poses.apply(anchor, self.model.centroid[None])[0]
        contacts = frame.contacts.moved(frame.camera_from_world)
        return {
            "index": frame.index,
            "where": frame.where,
            "verdict": estimate.verdict,
            "headline": words.headline(estimate),
            "sentence": words.sentence(estimate),
            "numbers": self._numbers(frame, estimate, usable),
            "image": self._image(frame, shown, contacts.points),
            "poses": {name: self._placed(value, centre) for name, value in shown.items()},
            "cloud": self._cloud(frame, shown.get("after"), centre),
            "hand": self._hand(frame, centre),
            "contacts": self._contacts(contacts, estimate, centre),
            "camera": [round(-1e3 * float(x), 2) for x in centre],
            "trace": [
                {"stage": s.name, "ran": s.ran, "why": s.why, "ms": rounded(s.ms, 2), "rows": s.rows}
                for s in estimate.trace
            ],
            "modes": [self._mode(mode, estimate) for mode in estimate.modes],
            "contributions": words.contribution_rows(estimate),
            "next": self._next(frame, estimate, touches, centre) if usable else [],
            "unobservable": list(estimate.unobservable),
            "notes": [*estimate.notes, *(f"{n} {name} dropped" for name, n in estimate.dropped.items() if n)],
            "ms": rounded(estimate.time_ms, 2),
        }

    def _numbers(self, frame: Frame, estimate: Estimate, usable: bool) -> list[Json]:
        """The figures under the verdict: {label, value, unit, hint}."""
        out: list[Json] = []

        def figure(label: str, value: float, unit: str, hint: str) -> None:
            if np.isfinite(value):
                out.append({"label": label, "value": _significant(value), "unit": unit, "hint": hint})

        truth = frame.camera_from_object_truth
        if truth is not None and usable:
            errors = self.judge.errors(estimate.pose, truth)
            surface = "ADD-S against the known pose: mean distance of the two surfaces"
            figure("Surface error", 1e3 * errors.add_s, "mm", surface)
            figure("Position error", 1e3 * errors.translation, "mm", "distance of the centroid from its true place")
            turn = float(np.rad2deg(errors.rotation))
            figure("Rotation error", turn, "°", "angle to the true orientation, modulo the object's symmetry")
        rotation, translation = words.worst_sigmas(np.asarray(estimate.covariance, dtype=np.float64))
        figure("σ position", 1e3 * translation, "mm", "standard deviation in the worst direction")
        if rotation <= words.FREE_ROTATION:
            figure("σ rotation", float(np.rad2deg(rotation)), "°", "standard deviation about the worst axis")
        within = f"probability that the surface error is below {1e3 * estimate.sure_within:.3g} mm"
        figure("Sure", 100 * estimate.confidence, "%", within)
        figure("Visible", 100 * estimate.visible_fraction, "%", "share of the object that the camera sees")
        figure("Time", estimate.time_ms, "ms", "all stages that ran")
        return out

    def _placed(self, pose: Array, centre: Array) -> list[float]:
        """Row-major 3x4 that takes centroid-relative millimetres to centre-relative millimetres."""
        moved = 1e3 * (poses.apply(pose, self.model.centroid[None])[0] - centre)
        return [round(float(x), 6) for row, t in zip(pose[:3, :3], moved) for x in (*row, t)]

    def _image(self, frame: Frame, shown: dict[str, Array], contacts: Array) -> Json | None:
        camera = frame.camera
        if camera is None or (frame.depth is None and frame.rgb is None):
            return None
        outlines = {name: silhouette(self.renderer, "object", camera, pose) for name, pose in shown.items()}
        marks = camera.project(contacts)[0] if len(contacts) else np.zeros((0, 2))
        around = [polygon for polygons in outlines.values() for polygon in polygons]
        wide = round(PICTURE_WIDTH * max(SMALLEST_SHARE, self.share))
        crop = pictures.choose_crop(np.concatenate([*around, marks]), (camera.width, camera.height), wide=wide)
        origin = np.array([crop.left, crop.top]) - 0.5
        out: Json = {
            "width": crop.width,
            "height": crop.height,
            "outlines": {
                name: [[round(float(x), 1) for x in (polygon - origin).ravel()] for polygon in polygons]
                for name, polygons in outlines.items()
            },
            "marks": [
                [round(float(x), 1) for x in mark] if np.isfinite(mark).all() else None for mark in marks - origin
            ],
        }
        if frame.depth is not None:
            anchor = next(iter(shown.values()), None)
            window = frame.depth[crop.top : crop.top + crop.height, crop.left : crop.left + crop.width]
            middle = None if anchor is None else float(poses.apply(anchor, self.model.centroid[None])[0, 2])
            near, far = pictures.depth_range(window, middle, self.model.radius)
            out["depth"] = pictures.data_uri(pictures.depth_image(frame.depth, crop, near, far))
            out["range_m"] = [round(near, 3), round(far, 3)]
        if frame.rgb is not None:
            out["colour"] = pictures.data_uri(pictures.colour_image(frame.rgb, crop))
        return out

    def _cloud(self, frame: Frame, pose: Array | None, centre: Array) -> Json | None:
        """Points near the object and, per point, its distance to the model at the estimate (tenths of mm, a byte)."""
        parts = []
        if frame.camera is not None and frame.depth is not None:
            parts.append(frame.camera.back_project(frame.depth))
        if frame.cloud is not None:
            parts.append(poses.apply(frame.camera_from_world, np.asarray(frame.cloud, dtype=np.float64)))
        points = np.concatenate(parts) if parts else np.zeros((0, 3))
        points = points[np.isfinite(points).all(axis=1)]
        points = points[np.linalg.norm(points - centre, axis=1) < CLOUD_REACH * self.model.radius]
        if not len(points):
            return None
        away = np.full(len(points), 255.0)
        if pose is not None:
            away = TENTHS_OF_MM * np.abs(self.model.field.distance(poses.apply(poses.inverse(pose), points)))
        chosen = _chosen(away < AGREEING, round(CLOUD_POINTS * self.share))
        points, away = points[chosen], away[chosen]
        return {"p": _shorts(points - centre), "d": _base64(np.clip(np.rint(away), 0, 255).astype(np.uint8))}

    def _hand(self, frame: Frame, centre: Array) -> Json | None:
        if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
            return None
        # hundreds: pages of nearly as many frames share what is kept of a hand
        local, faces, links = shown_hand(frame.hand, 100 * math.ceil(HAND_FACES * self.share / 100))
        hand_from_link = np.array(list(frame.hand.forward_kinematics(frame.joints).values()))
        camera_from_link = (frame.camera_from_world @ frame.world_from_hand @ hand_from_link)[links]
        vertices = np.einsum("nij,nj->ni", camera_from_link[:, :3, :3], local) + camera_from_link[:, :3, 3] - centre
        packed = _base64(faces.astype("<u2"))
        if self.hand_faces is None:
            self.hand_faces = packed
        return {"v": _shorts(vertices), **({} if packed == self.hand_faces else {"f": packed})}

    def _contacts(self, contacts: Any, estimate: Estimate, centre: Array) -> list[Json]:
        """One entry a contact of the frame, then the residuals that no recorded contact belongs to (from wrenches)."""
        out: list[Json] = []
        # an estimate lists the recorded contacts first, then those of other sensors
        told = tuple(residual.sensor for residual in estimate.contacts[: len(contacts)])
        paired = told == tuple(contacts.sensors)
        for row in range(len(contacts)):
            normal = contacts.normals[row]
            residual = estimate.contacts[row] if paired else None
            out.append(
                {
                    "sensor": contacts.sensors[row],
                    "p": [round(float(x), 2) for x in 1e3 * (contacts.points[row] - centre)],
                    "n": [round(float(x), 3) for x in normal] if np.isfinite(normal).all() else None,
                    "mm": rounded(residual.residual_mm, 2) if residual else None,
                    "deg": rounded(residual.normal_deg, 1) if residual else None,
                    "outlier": bool(residual.outlier) if residual else False,
                }
            )
        return out + [
            {
                "sensor": residual.sensor,
                "p": None,
                "n": None,
                "mm": rounded(residual.residual_mm, 2),
                "deg": rounded(residual.normal_deg, 1),
                "outlier": bool(residual.outlier),
            }
            for residual in estimate.contacts[len(contacts) if paired else 0 :]
        ]

    def _next(self, frame: Frame, estimate: Estimate, touches: Sequence[NextTouch] | None, centre: Array) -> list[Json]:
        """Where one more contact would tell most: place and normal in the picture's frame, and the same in words."""
        return [
            {
                "p": [round(float(x), 2) for x in 1e3 * (touch.camera_point - centre)],
                "n": [round(float(x), 3) for x in estimate.pose[:3, :3] @ touch.normal],
                "text": words.next_touch(touch, estimate),
            }
            for touch in (next_touches(self.model, estimate, frame) if touches is None else touches)
        ]

    def _mode(self, mode: Any, estimate: Estimate) -> Json:
        """Weight, cost and how far the mode is from the pose that was given."""
        symmetries, centre = self.model.symmetries, self.model.centroid
        finite = bool(np.isfinite(mode.pose).all() and np.isfinite(estimate.pose).all())
        turn = np.rad2deg(metrics.rotation_error(mode.pose, estimate.pose, symmetries)) if finite else math.nan
        away = metrics.translation_error(mode.pose, estimate.pose, symmetries, centre) if finite else math.nan
        return {
            "weight": rounded(mode.weight, 4),
            "cost": rounded(mode.cost, 2),
            "deg": rounded(float(turn), 1),
            "mm": rounded(1e3 * away, 1),
        }


def _chosen(matters: NDArray[np.bool_], most: int) -> NDArray[np.int64]:
    """At most `most` rows, up to two thirds of them from those that matter; always the same ones."""
    rng = np.random.default_rng(0)
    inside, outside = np.nonzero(matters)[0], np.nonzero(~matters)[0]
    kept = min(len(inside), max(2 * most // 3, most - len(outside)))
    rest = min(len(outside), most - kept)
    parts = [rng.choice(inside, kept, replace=False), rng.choice(outside, rest, replace=False)]
    return np.sort(np.concatenate(parts)).astype(np.int64)


def _shorts(points: ArrayLike) -> str:
    tenths = np.clip(np.rint(np.asarray(points) * TENTHS_OF_MM), -32767, 32767)
    return _base64(tenths.astype("<i2"))


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _significant(value: float) -> str:
    """Three figures at most, never an exponent."""
    magnitude = abs(value)
    digits = 0 if magnitude >= 100 else 1 if magnitude >= 10 else 2
    return f"{value:.{digits}f}"
