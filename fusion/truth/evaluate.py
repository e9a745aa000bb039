"""Estimated poses against a capture's ground truth: the metrics of BOP and YCB-Video, and calibration.

Metres and radians inside; the results are millimetres, degrees and pixels, by the names that tables use.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.truth import metrics
from fusion.truth.errors import Judge, JudgeSettings
from scenes.errors import CaptureError, InputError
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.objects import ObjectModel
from scenes.recordings.bop import PoseRow
from scenes.recordings.captures import Capture
from scenes.recordings.frames import Frame
from scenes.recordings.pose_rows import best_rows, rows_of

Array = NDArray[np.float64]

# VSD's tolerances as shares of the object's diameter, and the visibility tolerance (BOP Challenge 2020).
VSD_TAUS = tuple(np.arange(0.05, 0.51, 0.05))
VSD_DELTA = 0.015
# Poses nearer to the camera than the truth by this factor are in metres (a factor of 1000), not wrong.
METRES_FOR_MILLIMETRES = 200.0
# Poses nearer to the camera than this (m) have no unit: a frame that is lost without a start is at the origin.
NOWHERE = 1e-6


def evaluate(
    rows: Sequence[PoseRow],
    capture: Capture,
    covariances: Mapping[int, Array] | None = None,
    settings: JudgeSettings | None = None,
    model: ObjectModel | None = None,
) -> dict[str, Any]:
    """{"frames": one dict of errors a frame, "summary": means, medians, areas and recall}.

    Rows of another object or scene than the capture's are passed over. Of several rows of one frame the best score
    counts; a frame with truth and no row is a miss (infinite error). covariances: by frame, (6, 6) about the centroid,
    for the NEES. Raises CaptureError when the capture has no ground truth, InputError when no row is the capture's, one
    is of a frame that it does not have, or translations tell of metres.
    """
    rows = rows_of(rows, capture)
    _check_unit(rows, capture)
    best = best_rows(rows, capture)
    judge = Judge(model or capture.model, settings)
    renderer = Renderer({"object": (judge.model.vertices, judge.model.faces)})
    frames = []
    for frame in capture:
        if frame.camera_from_object_truth is None:
            continue
        row = best.get(frame.index)
        covariance = (covariances or {}).get(frame.index)
        frames.append({"frame": frame.index, **_frame_errors(frame, row, covariance, judge, renderer)})
    if not frames:
        raise CaptureError(f"{capture.path}: expected ground truth (scene_gt.json) to evaluate against, found none")
    return {"frames": frames, "summary": summary(frames, judge)}


def _check_unit(rows: Sequence[PoseRow], capture: Capture) -> None:
    """Raise InputError for translations that were written in metres, where a poses.csv has millimetres."""
    truths = {number: capture.frame(number).camera_from_object_truth for number in {row.im_id for row in rows}}
    pairs = [(row.pose[:3, 3], truth[:3, 3]) for row in rows if (truth := truths[row.im_id]) is not None]
    pairs = [(said, true) for said, true in pairs if np.linalg.norm(said) > NOWHERE and np.any(true)]
    ratios = [np.linalg.norm(said) / np.linalg.norm(true) for said, true in pairs]
    if ratios and np.median(ratios) < 1.0 / METRES_FOR_MILLIMETRES:
        raise InputError(
            f"poses: expected t in millimetres, got {1e3 * np.linalg.norm(pairs[0][0]):.3g} from the camera where the"
            f" truth is {1e3 * np.linalg.norm(pairs[0][1]):.3g}: m read as mm?"
        )


def _frame_errors(
    frame: Frame, row: PoseRow | None, covariance: Array | None, judge: Judge, renderer: Renderer
) -> dict[str, float]:
    truth = frame.camera_from_object_truth
    names = ("add_mm", "add_s_mm", "mssd_mm", "mspd_px", "rotation_deg", "translation_mm")
    if row is None or truth is None:
        return {**dict.fromkeys(names, float("inf")), "vsd": 1.0, "nees": float("nan"), "time_s": float("nan")}
    model = judge.model
    errors = judge.errors(row.pose, truth, covariance)
    hull = _extreme_vertices(model)
    # BOP's own turns, so that the numbers compare with published ones; BOP has no sphere
    symmetries = model.symmetries if model.symmetries.is_spherical else metrics.bop_symmetries(model.symmetries)
    mspd = vsd = float("nan")
    if frame.camera is not None:
        mspd = metrics.mspd(row.pose, truth, model.vertices, frame.camera, symmetries)
    if frame.camera is not None and frame.depth is not None:
        seen = [renderer.render(frame.camera, {"object": pose}).depth for pose in (row.pose, truth)]
        taus = [share * model.diameter for share in VSD_TAUS]
        vsd = metrics.vsd(seen[0], seen[1], frame.depth, frame.camera, taus, VSD_DELTA)
    return {
        "add_mm": 1e3 * errors.add,
        "add_s_mm": 1e3 * errors.add_s,
        "mssd_mm": 1e3 * metrics.mssd(row.pose, truth, hull, symmetries),
        "mspd_px": mspd,
        "vsd": vsd,
        "rotation_deg": float(np.rad2deg(errors.rotation)),
        "translation_mm": 1e3 * errors.translation,
        "nees": errors.nees,
        "time_s": row.time if row.time >= 0 else float("nan"),
    }


def _extreme_vertices(model: ObjectModel) -> Array:
    """Vertices of the convex hull: the displacement between two poses is convex, so its maximum is at one of them."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return model.vertices[ConvexHull(model.vertices).vertices]
    except QhullError:
        return model.vertices


def summary(frames: Sequence[Mapping[str, float]], judge: Judge) -> dict[str, float]:
    """Medians, areas under curve (to 10 cm), recall at the success threshold and at a tenth of the diameter, NEES."""
    table = {name: np.array([frame[name] for frame in frames]) for name in frames[0]}

    def middle(values: Array) -> float:
        known = values[~np.isnan(values)]
        return float(np.median(known)) if len(known) else float("nan")

    # infinite where nothing was left open and it was wrong
    calibrated = table["nees"][~np.isnan(table["nees"])]
    success = 1e3 * judge.settings.success
    return {
        "frames": float(len(frames)),
        "answered": float(np.isfinite(table["add_mm"]).sum()),
        **{f"median_{name}": middle(table[name]) for name in frames[0] if name not in ("frame", "nees")},
        "auc_add": metrics.auc(1e-3 * table["add_mm"]),
        "auc_add_s": metrics.auc(1e-3 * table["add_s_mm"]),
        "recall_add_s_5mm": metrics.recall(table["add_s_mm"], success),
        "recall_add_s_tenth": metrics.recall(table["add_s_mm"], 100.0 * judge.model.diameter),
        "nees_over_6": float(calibrated.mean()) / 6.0 if len(calibrated) else float("nan"),
    }
