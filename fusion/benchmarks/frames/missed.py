"""A missed minimum, kept for a look: the frame as a capture, both poses and what they cost, and a picture."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.steps.judge import Judgement
from fusion.results.report.outline import silhouette
from fusion.results.report.pictures import choose_crop
from fusion.truth.errors import json_number
from scenes.files.formats.images import write_rgb
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from scenes.recordings.writing import write_capture

Image = NDArray[np.uint8]

# RGB of the answer's outline and of that of what the truth refines to; width of the picture (px), room around both.
ANSWER, TRUTH = (255, 60, 60), (70, 230, 90)
WIDE, MARGIN = 640, 0.4
# Poses that are judged: the answer's, the true one, and where the search ended.
NAMES = "answer", "truth", "searched"


def keep_miss(
    folder: Path,
    frame: Frame,
    model: ObjectModel,
    words: Mapping[str, Any],
    answer: Estimate,
    costs: Judgement,
) -> Path:
    """Write `folder`/search_missed/NAME: `capture`, `miss.json`, and `miss.png` of a frame with depth; returns it.

    words: how the frame is made again, and what is known of the miss; NAME is made of them. costs: of the answer first,
    then of what the truth refines to, then of where the search ended.
    """
    keys = ("family", "hidden", "object", "trial", "sense", "told")
    name = re.sub(r"[^\w.]+", "-", "_".join(str(words[key]) for key in keys))
    home = folder / "search_missed" / name
    home.mkdir(parents=True, exist_ok=True)
    world = "camera" if np.allclose(frame.camera_from_world, np.eye(4)) else "robot base"
    whole = replace(frame, index=0)
    with_mask = frame.mask is not None
    write_capture(home / "capture", [whole], model, frame.hand, world, with_mask=with_mask, notes=dict(words))
    poses = {"answer": answer.pose, "truth": frame.camera_from_object_truth}
    data = {
        **words,
        "verdict": answer.verdict,
        "poses": poses,
        "refined": dict(zip(NAMES, costs.poses)),
        "costs": dict(zip(NAMES, costs.costs)),
        "before_joint_solution": dict(zip(NAMES, costs.fitted_costs)),
        "modes": [{"pose": m.pose, "weight": m.weight, "cost": m.cost} for m in answer.modes],
        "trace": [f"{s.name}: {s.why}" for s in answer.trace],
    }
    text = json.dumps(json_number(data), indent=1, allow_nan=False)
    (home / "miss.json").write_text(text + "\n", encoding="utf-8")
    if frame.depth is not None and frame.camera is not None:
        write_rgb(home / "miss.png", picture(frame, model, [(answer.pose, ANSWER), (costs.poses[1], TRUTH)]))
    return home


def picture(frame: Frame, model: ObjectModel, drawn: list[tuple[NDArray[np.float64], tuple[int, int, int]]]) -> Image:
    """(h, w, 3) the depth image around the outlines of poses (4, 4) in their colours; near is light."""
    import cv2

    assert frame.depth is not None
    assert frame.camera is not None
    camera = frame.camera
    renderer = Renderer({"object": (model.vertices, model.faces)})
    outlines = [(silhouette(renderer, "object", camera, pose), colour) for pose, colour in drawn]
    corners = [p for polygons, _ in outlines for p in polygons]
    whole = np.array([[0.0, 0.0], [camera.width - 1.0, camera.height - 1.0]])
    uv = np.clip(np.concatenate(corners) if corners else whole, whole[0], whole[1])
    crop = choose_crop(uv, (camera.width, camera.height), MARGIN, WIDE)
    depth = frame.depth[crop.top : crop.top + crop.height, crop.left : crop.left + crop.width]
    valid = depth > 0
    near, far = np.percentile(depth[valid], [2, 98]) if valid.any() else (0.0, 1.0)
    grey = np.where(valid, 60 + 160 * np.clip((far - depth) / max(float(far - near), 1e-6), 0.0, 1.0), 0)
    scale = WIDE / crop.width
    size = (WIDE, max(1, round(crop.height * scale)))
    out: Image = np.asarray(
        cv2.resize(np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2), size, interpolation=cv2.INTER_NEAREST),
        dtype=np.uint8,
    )
    for polygons, colour in outlines:
        moved = [np.rint((p - (crop.left, crop.top)) * scale).astype(np.int32) for p in polygons]
        cv2.polylines(out, moved, True, colour, 2, cv2.LINE_AA)
    return out
