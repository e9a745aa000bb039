"""One picture of what was answered, a tile a frame and case: a person sees in a minute what the numbers mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.real.frames import Recorded
from fusion.benchmarks.real.trials import Trial
from fusion.results.report.outline import silhouette
from fusion.results.report.pictures import choose_crop
from scenes.geometry import poses

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# A tile's picture and the lines of text below it, pixels.
WIDE, HIGH, TEXT = 300, 225, 34
# RGB: mask, reference, an answer that is right, one that is wrong.
MASK, REFERENCE, RIGHT, WRONG = (255, 255, 255), (90, 170, 255), (70, 230, 90), (255, 60, 60)
INK, PAPER = (235, 235, 235), (24, 26, 30)
# Room around the object in a tile, as a share of its extent: an answer a few centimetres off is still in the picture.
MARGIN = 0.8


def contact_sheet(rows: Sequence[tuple[Recorded, Sequence[tuple[str, Trial]]]], title: str) -> Image:
    """A row of tiles a frame: its answers (a heading and the trial), outlined over the colour or depth image.

    White: the mask; blue: the reference pose; green: an answer that counts as right; red: as wrong.
    """
    across = max((len(answers) for _, answers in rows), default=1)
    sheet = np.full((TEXT + len(rows) * (HIGH + TEXT), across * WIDE, 3), PAPER, dtype=np.uint8)
    words = f"{title}; white: mask, blue: reference, green: answer that is right, red: wrong"
    _write(sheet, words, 4, 21, 0.45)
    for i, (one, answers) in enumerate(rows):
        for k, (heading, trial) in enumerate(answers):
            top, left = TEXT + i * (HIGH + TEXT), k * WIDE
            sheet[top : top + HIGH + TEXT, left : left + WIDE] = tile(one, heading, trial)
    return sheet


def tile(one: Recorded, heading: str, trial: Trial) -> Image:
    """(HIGH + TEXT, WIDE, 3): the picture around the mask, and heading, verdict and numbers below."""
    import cv2

    camera, frame = one.frame.camera, one.frame
    out = np.full((HIGH + TEXT, WIDE, 3), PAPER, dtype=np.uint8)
    if camera is None or frame.mask is None or frame.depth is None:
        return out
    v, u = np.nonzero(frame.mask)
    crop = choose_crop(np.stack([u, v], 1).astype(np.float64), (camera.width, camera.height), MARGIN, WIDE)
    window = slice(crop.top, crop.top + crop.height), slice(crop.left, crop.left + crop.width)
    part = frame.rgb[window] if frame.rgb is not None else _grey(frame.depth[window])
    # dimmed, so that lines stand out
    dim = np.ascontiguousarray((0.75 * part).astype(np.uint8))
    picture: Image = np.asarray(cv2.resize(dim, (WIDE, HIGH), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    scale = np.array([WIDE / crop.width, HIGH / crop.height])

    def draw(polygons: Sequence[Array], colour: tuple[int, int, int], width: int) -> None:
        moved = [np.rint((p - (crop.left, crop.top)) * scale).astype(np.int32) for p in polygons]
        cv2.polylines(picture, moved, True, colour, width, cv2.LINE_AA)

    contours, _ = cv2.findContours(frame.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    draw([c.reshape(-1, 2).astype(np.float64) for c in contours], MASK, 1)
    if one.reference is not None:
        draw(silhouette(one.renderer, "object", camera, one.reference), REFERENCE, 1)
    outline = silhouette(one.renderer, "object", camera, trial.pose)
    draw(outline, WRONG if trial.wrong else RIGHT, 2)
    if not any(_inside(p, crop.left, crop.top, crop.width, crop.height) for p in outline):
        middle = poses.apply(trial.pose, one.model.centroid[None])[0]
        _write(picture, f"answer not here: {1e3 * middle[2]:.0f} mm deep", 4, HIGH - 6, 0.4, WRONG)
    out[:HIGH] = picture
    _write(out, f"{one.name}: {heading}", 3, HIGH + 13, 0.35)
    error = f"ADD-S {1e3 * trial.add_s:.1f}, " if trial.true else ""
    numbers = f"{trial.verdict}  {error}mask {1e3 * trial.residual:.1f} mm, overlap {trial.overlap:.2f}"
    _write(out, numbers, 3, HIGH + 28, 0.35, WRONG if trial.wrong else RIGHT)
    return out


def _inside(polygon: Array, left: int, top: int, width: int, height: int) -> bool:
    local = polygon - (left, top)
    return bool(((local >= 0) & (local < (width, height))).all(axis=1).any())


def _grey(depth: NDArray[np.floating]) -> Image:
    """Near is light; no reading is black."""
    valid = depth > 0
    if not valid.any():
        return np.zeros((*depth.shape, 3), dtype=np.uint8)
    near, far = np.percentile(depth[valid], [2, 98])
    share = np.clip((far - depth) / max(float(far - near), 1e-6), 0.0, 1.0)
    grey = np.where(valid, 60 + 190 * share, 0).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _write(image: Image, text: str, x: int, y: int, size: float, colour: tuple[int, int, int] = INK) -> None:
    import cv2

    plain = text.replace("°", " deg")  # OpenCV's fonts end at ASCII
    cv2.putText(image, plain, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
