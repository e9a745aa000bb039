"""A model of an object that has none, from captures of it: poses of the views, fusion, and how good it is. Metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.files.formats.ply import ply_content
from scenes.files.whole import replace_file
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.geometry.surface import Surface
from scenes.reconstruction.superquadrics import fit_superquadric
from scenes.reconstruction.volume import DepthView, Reconstruction, ReconstructionSettings, reconstruct
from scenes.recordings.bop import read_poses
from scenes.recordings.captures import Capture
from scenes.recordings.frames import Frame
from scenes.recordings.pose_rows import best_rows
from vision.modelling import ModelViewSettings, hand_poses, still_poses, views_of

Array = NDArray[np.float64]

SHAPES = ("mesh", "superquadric")
SOURCES = ("auto", "hand", "truth", "world")
# Colours of a written mesh: seen, and filled.
SEEN, FILLED = (60, 150, 142), (190, 186, 180)


@dataclass(frozen=True)
class ModelSettings:
    """What is made, and how. Values by judgement."""

    # One of SHAPES.
    shape: str = "mesh"
    # Share of a superquadric's fit that the contacts have, however few they are: they are on the sides no camera sees.
    contact_share: float = 0.25
    # A superquadric's vertex is observed within this many voxels of a place that was seen.
    observed_voxels: float = 3.0
    views: ModelViewSettings = field(default_factory=ModelViewSettings)
    reconstruction: ReconstructionSettings = field(default_factory=ReconstructionSettings)

    def __post_init__(self) -> None:
        """Refuse a shape that there is not."""
        if self.shape not in SHAPES:
            raise InputError(f"shape: expected one of {', '.join(SHAPES)}, got {self.shape!r}")


@dataclass(frozen=True)
class Made:
    """result: in the frame of the poses it was made from; source: where those are from; views: how many;
    true_from_model (4, 4): to the frame of the captures' own model, None where the truth is not known.
    """

    result: Reconstruction
    source: str
    views: int
    true_from_model: Array | None


def make_model(
    captures: Sequence[Capture],
    source: str = "auto",
    files: Sequence[str | Path] = (),
    settings: ModelSettings | None = None,
) -> Made:
    """A closed mesh from one capture or several.

    source: "hand" (the object is held still in the hand), "truth", "world" (it stands still), or "auto": the hand's
    where there is a hand, else the truth, else the world. files: a poses.csv of each capture instead. Raises InputError
    for sources that a capture lacks, and for several captures by their hands: each holds the object otherwise.
    """
    settings = settings or ModelSettings()
    if files and len(files) != len(captures):
        raise InputError(f"poses: expected one file for each of {len(captures)} captures, got {len(files)}")
    views: list[DepthView] = []
    touched, hands = [], []
    true_from_model: Array | None = None
    kind = "file" if files else source
    for position, capture in enumerate(captures):
        frames = list(capture)
        kind, camera_from_object = _poses(capture, frames, kind, files[position] if files else None, settings)
        if kind == "hand" and len(captures) > 1:
            raise InputError(
                "poses: every grasp holds the object otherwise: several captures need truth, world or files"
            )
        views += views_of(frames, camera_from_object, settings.views)
        for frame in frames:
            if frame.index in camera_from_object:
                model_from_camera = se3.inverse(camera_from_object[frame.index])
                felt = frame.contacts.moved(model_from_camera @ frame.camera_from_world)
                touched.append(felt.points)
                if frame.camera_from_object_truth is not None and true_from_model is None:
                    true_from_model = se3.inverse(frame.camera_from_object_truth)
                    true_from_model = true_from_model @ camera_from_object[frame.index]
        hands.append(_hand(frames, camera_from_object))
    contacts = np.concatenate(touched) if touched else np.zeros((0, 3))
    # a hand is a bound only while it is the same one everywhere
    hand = hands[0] if len(captures) == 1 else None
    result = reconstruct(views, contacts, hand, settings.reconstruction)
    if settings.shape == "superquadric":
        result = _superquadric(result, contacts, settings)
    return Made(result, kind, len(views), true_from_model)


def _poses(
    capture: Capture, frames: list[Frame], source: str, file: str | Path | None, settings: ModelSettings
) -> tuple[str, dict[int, Array]]:
    """Where the poses are from, and camera_from_object by frame."""
    if file is not None:
        return "file", {n: row.pose for n, row in best_rows(read_poses(file), capture, str(file)).items()}
    if source not in SOURCES:
        raise InputError(f"poses: expected {', '.join(SOURCES)} or a poses.csv, got {source!r}")
    if source in ("auto", "hand"):
        found = hand_poses(frames, settings.views)
        if found or source == "hand":
            if not found:
                raise InputError(f"{capture.path}: expected a hand with joints and poses for --poses hand, found none")
            return "hand", found
    truths = {f.index: f.camera_from_object_truth for f in frames if f.camera_from_object_truth is not None}
    if source == "truth" and not truths:
        raise InputError(f"{capture.path}: expected ground truth (scene_gt.json) for --poses truth, found none")
    if truths and source != "world":
        return "truth", truths
    return "world", still_poses(frames)


def _hand(frames: list[Frame], camera_from_object: dict[int, Array]) -> tuple[Array, NDArray[np.int64]] | None:
    """The hand at the first frame that knows it, in the object's frame."""
    for frame in frames:
        if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
            continue
        if frame.index in camera_from_object:
            vertices, faces, _ = frame.hand.mesh(frame.joints)
            camera_from_hand = frame.camera_from_world @ frame.world_from_hand
            return se3.apply(se3.inverse(camera_from_object[frame.index]) @ camera_from_hand, vertices), faces
    return None


def _superquadric(result: Reconstruction, contacts: Array, settings: ModelSettings) -> Reconstruction:
    from scipy.spatial import cKDTree

    seen = result.vertices[result.observed]
    points = np.concatenate([seen, contacts])
    weights = np.ones(len(points))
    if len(contacts):
        share = settings.contact_share
        weights[len(seen) :] = share / (1.0 - share) * len(seen) / len(contacts)
    vertices, faces = fit_superquadric(points, weights).mesh()
    away, nearest = cKDTree(seen).query(vertices)
    known = result.confidence[result.observed][nearest]
    confidence = np.where(away < settings.observed_voxels * result.voxel, known, 0.0)
    return Reconstruction(vertices, faces, confidence, result.voxel)


def write_model(path: str | Path, result: Reconstruction, moved: Array | None = None) -> None:
    """Write the mesh (m) with a confidence for each vertex and colours that show what was seen, moved (4, 4) first;
    whole or not at all.
    """
    vertices = result.vertices if moved is None else se3.apply(moved, result.vertices)
    colours = np.where(result.observed[:, None], SEEN, FILLED).astype(np.uint8)
    target = Path(path)
    replace_file(target, ply_content(target, vertices, result.faces, colours, {"confidence": result.confidence}))


@dataclass(frozen=True)
class ShapeError:
    """Distances (m) of two surfaces: mean and 95 % quantile, and the share of the surface they are over."""

    mean: float
    p95: float
    share: float

    @staticmethod
    def of(distances: Array, chosen: NDArray[np.bool_]) -> ShapeError:
        """Of the chosen distances; NaN for none."""
        if not chosen.any():
            return ShapeError(float("nan"), float("nan"), 0.0)
        own = np.abs(distances[chosen])
        return ShapeError(float(own.mean()), float(np.quantile(own, 0.95)), float(chosen.mean()))

    def to_json(self) -> dict[str, float]:
        """Millimetres."""
        return {"mean_mm": 1e3 * self.mean, "p95_mm": 1e3 * self.p95, "share": self.share}


def compare_shapes(made: Made, truth: ObjectModel, count: int = 8000) -> tuple[dict[str, ShapeError], Array]:
    """How far the model's surface is from the true one and the other way, where it was observed and where filled; and
    true_from_model, refined: what is compared is the shape, not the poses it was made from.

    Raises InputError when no capture knew the true pose.
    """
    if made.true_from_model is None:
        raise InputError("model: expected ground truth to compare with, got none")
    result = made.result
    model = ObjectModel("reconstruction", result.vertices, result.faces)
    points, _ = model.sample_surface(count, seed=0)
    observed = _near_observed(result, points)
    pose = _settled(truth.surface, points[observed] if observed.any() else points, made.true_from_model)
    out = truth.surface.closest(se3.apply(pose, points))[0]
    targets, _ = truth.sample_surface(count, seed=1)
    local = se3.apply(se3.inverse(pose), targets)
    back, _, feet = Surface(result.vertices, result.faces).closest(local)
    beside = _near_observed(result, feet)
    return {
        "model_to_true_observed": ShapeError.of(out, observed),
        "model_to_true_filled": ShapeError.of(out, ~observed),
        "true_to_model_observed": ShapeError.of(back, beside),
        "true_to_model_filled": ShapeError.of(back, ~beside),
    }, pose


def _near_observed(result: Reconstruction, points: Array) -> NDArray[np.bool_]:
    """(n,) whether the vertex nearest to each point was observed."""
    from scipy.spatial import cKDTree

    return np.asarray(result.observed[cKDTree(result.vertices).query(points)[1]])


def _settled(surface: Surface, points: Array, pose: Array, steps: int = 20, gate: float = 0.01) -> Array:
    """The pose near `pose` that lays points (n, 3) on the surface best: point to plane, Tukey's weights."""
    used = points[:: max(1, len(points) // 3000)]
    for _ in range(steps):
        moved = se3.apply(pose, used)
        distance, direction, _ = surface.closest(moved)
        weight = np.square(np.maximum(0.0, 1.0 - (distance / gate) ** 2))
        centre = moved.mean(axis=0)
        rows = np.concatenate([np.cross(moved - centre, direction), direction], axis=1)
        system = (rows * weight[:, None]).T @ rows + np.diag([1e-6] * 3 + [1e-3] * 3)
        step = -np.linalg.solve(system, rows.T @ (weight * distance))
        pose = se3.perturb(np.eye(4), step, centre) @ pose
    return pose


def model_json(made: Made, errors: dict[str, ShapeError], settings: ModelSettings) -> dict[str, Any]:
    """The result of `palpate model`."""
    result = made.result
    model = ObjectModel("reconstruction", result.vertices, result.faces)
    return {
        "version": 1,
        "shape": settings.shape,
        "poses": made.source,
        "views": made.views,
        "voxel_mm": 1e3 * result.voxel,
        "vertices": len(result.vertices),
        "faces": len(result.faces),
        "observed_share": float(result.observed.mean()),
        "volume_cm3": 1e6 * model.volume,
        "diameter_mm": 1e3 * model.diameter,
        "true_from_model": None if made.true_from_model is None else made.true_from_model.tolist(),
        "errors": {name: error.to_json() for name, error in errors.items()},
    }
