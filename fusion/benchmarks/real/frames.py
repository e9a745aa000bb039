"""Recorded frames of known objects, and what each can be judged by. Camera frame, metres.

A frame needs a depth image and the object's mask. Its given pose is taken for the truth when the mask's own pixels lie
on the surface there; else, as with a pose that some other estimator left, they are what answers are judged by. The
reference pose is where point-to-plane ICP on the mask's pixels goes from the given pose: the floor of these data.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fusion.truth.errors import Judge
from scenes.errors import InputError
from scenes.formats import handover
from scenes.formats.bop import scene as bop_scene
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.objects import ObjectModel
from scenes.recordings.captures import read_capture
from scenes.recordings.frames import Frame
from vision.published.icp import CloudIcpSettings, icp

Array = NDArray[np.float64]
T = TypeVar("T")

ROOT = Path(__file__).resolve().parents[3]
CAPTURES, GRASPS = "real", "icub-handover"
# ICPs whose better end is the reference: the usual one, and a narrow one for a pose some millimetres off.
REFERENCE_ICP = (CloudIcpSettings(), CloudIcpSettings((0.010, 0.005, 0.003)))


@dataclass(frozen=True)
class RealSettings:
    """When a given pose is the truth, and when an answer is wrong. By judgement, from the frames that have a truth."""

    # Median distance (m) of the mask's pixels from the surface at a pose that is the truth: depth cameras of a table's
    # distance are good to about a millimetre; poses left by an estimator lie 2 to 6 mm off.
    true_within: float = 0.0015
    # With the truth: ADD-S (m) of a wrong answer. Without: the mask's median distance (m), and the overlap of outline
    # and mask, beyond which nobody would take the answer for right; ragged masks leave 0.84 to 0.92 at the best pose.
    wrong_add_s: float = 0.005
    wrong_residual: float = 0.005
    wrong_overlap: float = 0.6
    # Pixels of a mask that are measured, evenly picked: a median of so many is known to a percent of its spread.
    pixels: int = 4000
    # What stands this much (m) before the rendered surface hides it (BOP's tolerance of visibility, 15 mm).
    hidden: float = 0.015
    # Fewest pixels of a mask with depth: fewer show no object.
    fewest: int = 100


@dataclass(frozen=True)
class Recorded:
    """One object in one frame.

    name; frame, with mask and, where it is true, the truth; judge of its object; points (n, 3): the mask's pixels;
    given (4, 4) camera_from_object or None, and the median distance of the points there (m); reference (4, 4), around
    which starts are drawn: the truth, else where ICP settles; floor (m) and floor_overlap: of where ICP settles.
    """

    name: str
    frame: Frame
    judge: Judge
    points: Array
    renderer: Renderer
    settings: RealSettings
    given: Array | None = None
    given_residual: float = float("nan")
    reference: Array | None = None
    floor: float = float("nan")
    floor_overlap: float = float("nan")

    @property
    def model(self) -> ObjectModel:
        """The object."""
        return self.judge.model

    @property
    def truth(self) -> Array | None:
        """(4, 4) camera_from_object, None where the given pose is not true."""
        return self.frame.camera_from_object_truth

    def residual(self, pose: Array) -> float:
        """Median distance (m) of the mask's pixels from the surface at `pose`."""
        return residual(self.model, self.points, pose)

    def overlap(self, pose: Array) -> float:
        """Share (0 to 1) that the seen part of the object's outline at `pose` has in common with the mask, of both."""
        return overlap(self.renderer, self.frame, pose, self.settings.hidden)

    def wrong(self, add_s: float, residual: float, overlap: float) -> bool:
        """By ADD-S (m) where the truth is known, else by residual (m) and overlap; what cannot be measured is wrong."""
        s = self.settings
        if self.truth is not None:
            return not add_s <= s.wrong_add_s
        return not (residual <= s.wrong_residual and overlap >= s.wrong_overlap)


def residual(model: ObjectModel, points: Array, pose: Array) -> float:
    """Median |distance| (m) of camera-frame points (n, 3) from the surface at camera_from_object `pose`."""
    if not len(points):
        return float("nan")
    return float(np.median(np.abs(model.field.distance(poses.apply(poses.inverse(pose), points)))))


def overlap(renderer: Renderer, frame: Frame, pose: Array, hidden: float) -> float:
    """Intersection over union of the frame's mask and the pixels where the object at `pose` is seen: its outline but
    for what is more than `hidden` (m) behind the depth image, as in BOP's visibility test.
    """
    if frame.mask is None or frame.camera is None or frame.depth is None:
        return float("nan")
    rendered = renderer.render(frame.camera, {"object": pose}).depth
    covered = (frame.depth > 0) & (frame.depth < rendered - hidden)
    seen = (rendered > 0) & ~covered
    union = int((seen | frame.mask).sum())
    return float((seen & frame.mask).sum()) / union if union else float("nan")


def recorded(
    name: str, frame: Frame, model: ObjectModel, vouched: bool = False, settings: RealSettings | None = None
) -> Recorded | str:
    """The frame with what it is judged by, or, in words, why it cannot be judged.

    vouched: the data set says that its pose is the truth.
    """
    s = settings or RealSettings()
    if frame.depth is None or frame.camera is None:
        return f"{name}: no depth image with a camera"
    if frame.mask is None:
        return f"{name}: no mask of the object to judge by"
    points = frame.camera.back_project(frame.depth, frame.mask)
    if len(points) < s.fewest:
        return f"{name}: {len(points)} pixels of the mask have depth, expected {s.fewest} or more"
    step = max(1.0, len(points) / s.pixels)
    points = points[(np.arange(int(len(points) / step)) * step).astype(int)]
    judge, renderer = Judge(model), Renderer({"object": (model.vertices, model.faces)})
    given = frame.camera_from_object_truth
    one = Recorded(name, replace(frame, camera_from_object_truth=None), judge, points, renderer, s)
    if given is None:
        return one
    settled = [icp(points, model, given, levels).pose for levels in REFERENCE_ICP]
    reference = min(settled, key=one.residual)
    at_given = one.residual(given)
    true = vouched or at_given <= s.true_within
    return replace(
        one,
        frame=replace(frame, prior=None) if true else replace(one.frame, prior=None),
        given=given,
        given_residual=at_given,
        reference=given if true else reference,
        floor=one.residual(reference),
        floor_overlap=one.overlap(reference),
    )


def folder(data: Path | None) -> Path:
    """The given folder, else PALPATE_DATA, else ../shared/data beside the project. Raises InputError for none."""
    root = data or Path(os.environ.get("PALPATE_DATA") or ROOT.parent / "shared" / "data")
    if not root.is_dir():
        raise InputError(f"bench real: expected recorded captures in {root}, found no folder (say --data DIR)")
    return root


def bop_frames(root: Path, images: int, most: int | None = None) -> Iterator[Recorded | str]:
    """Every object of every scene of a BOP data set, a split of it or one scene: up to `images` images of each. most:
    pairs of scene and object, evenly picked; None for all.

    Raises InputError for a folder without a scene.
    """
    # the scene itself, those of a split, those of all splits
    places = [path for depth in ("", "*/", "*/*/") for path in sorted(root.glob(f"{depth}scene_camera.json"))]
    scenes = [path.parent for path in places if bop_scene.is_scene(path.parent)]
    if not scenes:
        raise InputError(f"bench real: expected a BOP scene (scene_camera.json) in {root}, found none")
    pairs = [(scene, object_id) for scene in scenes for object_id in bop_scene.objects(scene)]
    for scene, object_id in pairs if most is None else even(pairs, most):
        model, found = bop_scene.read(scene, bop_scene.Choice(object_id), images)
        for frame in found:
            yield recorded(f"{scene.name}/{frame.index:06d} object {object_id}", frame, model, vouched=True)


def _below(root: Path, usual: str) -> list[Path]:
    """Subfolders of the folder, and of its usual part."""
    places = [root, root / usual] if (root / usual).is_dir() else [root]
    return sorted({path for place in places for path in place.iterdir() if path.is_dir()})


def captures(root: Path, images: int, most: int | None = None) -> Iterator[Recorded | str]:
    """Captures in the folder or its part `real`: up to `images` frames of each, or why one is left out. most: captures,
    evenly picked; None for all.
    """
    paths = [path for path in _below(root, CAPTURES) if (path / "capture.json").is_file()]
    for path in paths if most is None else even(paths, most):
        capture = read_capture(path)
        for number in even(capture.frame_ids, images):
            name = capture.name if len(capture) == 1 else f"{capture.name} {number}"
            yield recorded(name, capture.frame(number), capture.model)


def grasps(root: Path) -> list[Path]:
    """Folders of recorded vision and touch: the folder's own, or those in its part `icub-handover`."""
    return [path for path in _below(root, GRASPS) if handover.is_grasp(path)]


def even(items: Sequence[T], most: int) -> list[T]:
    """At most `most` of the items, evenly picked, the first and the last among them."""
    return [items[i] for i in sorted(set(np.linspace(0, len(items) - 1, min(most, len(items))).astype(int)))]
