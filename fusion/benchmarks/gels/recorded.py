"""Recorded grasps of three DIGITs (the layout of scenes.formats.gels.digit_grasps), from raw images and no start.

Read from a folder that is named, else from PALPATE_DATA/digit, else from ../shared/data/digit beside the project; never
part of it. Every grasp there has its object, unturned, at one place.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Report, Table
from fusion.truth.metrics import pose_error
from scenes.errors import CaptureError
from scenes.evidence.symmetry.symmetry_detection import DetectionSettings, detect_symmetries
from scenes.formats.gels import digit_grasps
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.captures import read_capture
from touch.gels.localize import localize_gels
from touch.gels.patches import patches_of

ROOT = Path(__file__).resolve().parents[3]
# world_from_object of all grasps (m), as the recordings' authors fixed it.
TRUTH = poses.make_pose(None, (0.1, 0.0, 0.2))
# Turns that move the surface by less than this (m) are the object's own symmetries to a gel whose place is as unsure.
ALIKE, ALIKE_SHARE = 0.002, 0.95
# A mode is the truth when it is closer than this (m, rad).
NEAR = 0.010, float(np.deg2rad(10.0))


def add_recorded(report: Report, settings: BenchSettings) -> None:
    """A row a grasp; nothing where the recordings are not. Raises CaptureError when a named folder has none."""
    usual = Path(os.environ.get("PALPATE_DATA") or ROOT.parent / "shared" / "data")
    root = (settings.data or usual) / "digit"
    if settings.data is not None and not root.is_dir():
        root = settings.data
    found = digit_grasps.grasps_in(root) if root.is_dir() else []
    if not found:
        if settings.data is not None:
            what = f"{digit_grasps.POSES} and {digit_grasps.IMAGE.format(0)}"
            raise CaptureError(f"{settings.data}: expected folders of grasps ({what}), there or in digit, found none")
        return
    table = Table(
        "Recorded grasps: three DIGITs, raw images, no start",
        [
            Column("grasp"),
            Column("verdict"),
            Column("modes", 0),
            Column("first mode: °", 1),
            Column("mm", 1),
            Column("weight"),
            Column("nearest mode: °", 1),
            Column("mm", 1),
            Column("images s", 3),
            Column("search s", 2),
        ],
    )
    models: dict[Path, ObjectModel] = {}
    among, first_near = 0, 0
    with tempfile.TemporaryDirectory() as folder:
        for number, path in enumerate(settings.progress(found, len(found), "recorded grasps")):
            capture = read_capture(digit_grasps.convert(path, Path(folder) / str(number)).written[0])
            model = models.setdefault(path.parent, _round(capture.model))
            row, near_first, near_any = _grasp(model, capture, settings.seed)
            among, first_near = among + near_any, first_near + near_first
            table.add("/".join(path.parts[-2:]), *row)
    table.note = (
        f"Modulo turns that move the surface by less than {1e3 * ALIKE:g} mm. A cylinder between three gels turns and"
        " slides: its verdict should be ambiguous."
    )
    report.tables.append(table)
    settings.show(table)
    report.claims.append(Claim("recorded grasps with the truth among the modes", among / len(found), 1.0, True))
    report.claims.append(Claim("recorded grasps, first mode within 10 mm and 10°", first_near / len(found), 0.75, True))


def _round(model: ObjectModel) -> ObjectModel:
    limits = DetectionSettings(tolerance=ALIKE, share=ALIKE_SHARE)
    return model.with_symmetries(detect_symmetries(model, limits))


def _grasp(model: ObjectModel, capture, seed: int):  # type: ignore[no-untyped-def]  # a capture and a row of cells
    import time

    frame = capture[0]
    patches_of(frame)  # what is built once a sensor is no image's time
    begin = time.process_time()
    patches = patches_of(frame)
    seconds = time.process_time() - begin
    answer = localize_gels(model, patches, seed)
    begin = time.process_time()
    answer = localize_gels(model, patches, seed)
    search = time.process_time() - begin
    errors = [pose_error(mode.pose, TRUTH, model.centroid, model.symmetries) for mode in answer.modes]
    turned = np.array([np.linalg.norm(error[:3]) for error in errors])
    moved = np.array([np.linalg.norm(error[3:]) for error in errors])
    near = (moved < NEAR[0]) & (turned < NEAR[1])
    best = int(np.argmin(moved / NEAR[0] + turned / NEAR[1]))
    row = (
        answer.verdict,
        len(answer.modes),
        float(np.rad2deg(turned[0])),
        1e3 * float(moved[0]),
        answer.modes[0].weight,
        float(np.rad2deg(turned[best])),
        1e3 * float(moved[best]),
        seconds,
        search,
    )
    return row, bool(near[0]), bool(near.any())
