"""Still pictures of a frame and its answer: what a batch's page and the gallery show. Image pixels, metres."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.results.report import pictures
from fusion.results.report.outline import silhouette
from scenes.files.whole import replace_file
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# As in the report: the estimate, other poses that fit, the truth, contacts and their rim.
AFTER, OTHER, TRUTH = (67, 224, 210), (255, 178, 122), (157, 182, 255)
TOUCH, RIM = (255, 95, 185), (255, 255, 255)
# Fixed-point digits of OpenCV's drawing: an eighth of a pixel.
SHIFT = 3
# A still is made at the least so wide (pixels) before it is made small: lines of one width on every size.
NATURAL = 640
# Twice what a batch's page shows, for sharp screens.
THUMBNAIL_WIDTH = 192
VERDICTS = ("lost", "ambiguous", "ok")


def still(
    frame: Frame,
    model: ObjectModel,
    estimate: Estimate | None,
    wide: int,
    kind: str = "depth",
    truth: bool = False,
    modes: int = 0,
    outlines: bool = True,
) -> Image | None:
    """A 4:3 picture of `wide` pixels around the object: depth or colour with the estimate's outline and the contacts.

    kind: "depth" or "colour", the other where the frame has it alone. truth: also the known pose's outline. modes: as
    many of the other poses that fit, at most. outlines: without them the picture is of the same place. None for a frame
    without an image.
    """
    import cv2

    camera = frame.camera
    if camera is None or (frame.depth is None and frame.rgb is None):
        return None
    shown: list[tuple[Array, tuple[int, int, int], int]] = []
    if truth and frame.camera_from_object_truth is not None:
        shown.append((frame.camera_from_object_truth, TRUTH, 2))
    if estimate is not None:
        others = [mode.pose for mode in estimate.modes[1 : 1 + modes] if np.isfinite(mode.pose).all()]
        shown += [(pose, OTHER, 2) for pose in reversed(others)]
    if estimate is not None and np.isfinite(estimate.pose).all():
        shown.append((estimate.pose, AFTER, 3))
    renderer = Renderer({"object": (model.vertices, model.faces)})
    traced = [silhouette(renderer, "object", camera, pose) for pose, _, _ in shown]
    contacts = frame.contacts.moved(frame.camera_from_world).points
    marks = camera.project(contacts)[0] if len(contacts) else np.zeros((0, 2))
    around = [polygon for polygons in traced for polygon in polygons]
    crop = pictures.choose_crop(np.concatenate([*around, marks]), (camera.width, camera.height), wide=NATURAL)
    if frame.depth is not None and (kind == "depth" or frame.rgb is None):
        window = frame.depth[crop.top : crop.top + crop.height, crop.left : crop.left + crop.width]
        middle = float(poses.apply(shown[-1][0], model.centroid[None])[0, 2]) if shown else None
        image = pictures.depth_image(frame.depth, crop, *pictures.depth_range(window, middle, model.radius))
    else:
        assert frame.rgb is not None
        image = pictures.colour_image(frame.rgb, crop)
    image = np.ascontiguousarray(image)

    def at(pixels: Array) -> NDArray[np.int32]:
        inside = (pixels - (crop.left, crop.top) + 0.5) * crop.scale - 0.5
        return np.rint(np.clip(inside, -1e4, 1e4) * 2**SHIFT).astype(np.int32)

    larger = float(np.clip(0.6 * NATURAL / wide, 1.0, 3.0))  # on what is made small
    for (_, colour, width), polygons in zip(shown, traced if outlines else ()):
        lines, thick = [at(polygon) for polygon in polygons], round(larger * width)
        cv2.polylines(image, lines, True, (0, 0, 0), thick + 3, cv2.LINE_AA, SHIFT)
        cv2.polylines(image, lines, True, colour, thick, cv2.LINE_AA, SHIFT)
    for mark in marks[np.isfinite(marks).all(axis=1)]:
        u, v = (int(x) for x in at(mark))
        cv2.circle(image, (u, v), round(larger * 8) << SHIFT, RIM, -1, cv2.LINE_AA, SHIFT)
        cv2.circle(image, (u, v), round(larger * 6) << SHIFT, TOUCH, -1, cv2.LINE_AA, SHIFT)
    return np.asarray(cv2.resize(image, (wide, round(wide * 3 / 4)), interpolation=cv2.INTER_AREA))


def write_thumbnail(path: Path, frames: Sequence[Frame], model: ObjectModel, answers: Sequence[Estimate]) -> None:
    """A small picture of the answer that needs to be looked at most: one that is lost, else ambiguous, else the first.
    Nothing is written without an image.
    """
    worst = min(range(len(answers)), key=lambda k: VERDICTS.index(answers[k].verdict), default=None)
    image = None if worst is None else still(frames[worst], model, answers[worst], THUMBNAIL_WIDTH)
    if image is not None:
        replace_file(path, pictures.jpeg(image, 75))
