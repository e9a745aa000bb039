"""The same frames through several methods: errors against the truth, agreement with the data, time, verdict.

Methods: `icp` on the usual crop around the start, `icp_segmented` on the points that our segmentation leaves to the
object, `icp_touch` on these and the contacts, weighed up as in weighted ICP for vision and touch, `vision` and `touch`
alone, `fused`. Times of ICP include finding its points; building a distance lattice and compiling are done once before
anything is timed.
"""

from __future__ import annotations

import math
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.estimate import estimate
from fusion.estimation.settings import EstimateSettings
from fusion.truth.errors import Agreement, Errors, Judge, json_number
from scenes.errors import CaptureError, InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.captures import Capture
from scenes.recordings.checking.validation import usable
from scenes.recordings.frames import Frame
from touch.contacts import places_touched
from vision.look.look import object_points
from vision.look.points import all_points, crop_points
from vision.published.icp import icp

Array = NDArray[np.float64]

METHODS = ("icp", "icp_segmented", "icp_touch", "vision", "touch", "fused")
# Share of the contacts in the points of `icp_touch`: the best of 10, 30 and 50 % on other captures.
CONTACT_SHARE = 0.1
SENSES = {"vision": ("vision",), "touch": ("touch",), "fused": ("vision", "touch")}


@dataclass(frozen=True)
class Row:
    """One method on one frame. pose (4, 4) camera_from_object; errors None without ground truth; estimate None for ICP;
    verdict "ok", "ambiguous" or "lost", "" of a method that does not judge itself; time_ms.
    """

    capture: str
    group: str
    frame: int
    method: str
    pose: Array
    verdict: str
    time_ms: float
    errors: Errors | None
    agreement: Agreement
    estimate: Estimate | None = None

    def to_json(self) -> dict[str, Any]:
        """Millimetres, degrees, milliseconds."""
        named = {
            "capture": self.capture,
            "group": self.group,
            "frame": self.frame,
            "method": self.method,
            "verdict": self.verdict,
            "time_ms": self.time_ms,
            "pose": self.pose,
            **(self.errors.to_json() if self.errors else {}),
            **self.agreement.to_json(),
        }
        return json_number(named)


@dataclass(frozen=True)
class Summary:
    """All rows of one method in one group: medians in mm, degrees, ms (NaN without truth), success as a share."""

    group: str
    method: str
    frames: int
    add_s_mm: float
    success: float
    rotation_deg: float
    translation_mm: float
    cloud_mm: float
    contacts_mm: float
    time_ms: float
    verdicts: dict[str, int]

    def to_json(self) -> dict[str, Any]:
        """As named."""
        return json_number(vars(self))


def check_methods(methods: Iterable[str]) -> tuple[str, ...]:
    """The methods in the asked order, each once; raises InputError listing those there are."""
    chosen = tuple(dict.fromkeys(methods))
    unknown = [name for name in chosen if name not in METHODS]
    if unknown or not chosen:
        raise InputError(f"methods: expected some of {', '.join(METHODS)}, got {', '.join(unknown) or 'none'}")
    return chosen


def compare_frame(
    frame: Frame,
    judge: Judge,
    methods: Sequence[str],
    seed: int = 0,
    capture: str = "",
    group: str = "",
    settings: EstimateSettings | None = None,
    beliefs: Beliefs | None = None,
    agree: bool = True,
) -> list[Row]:
    """Every method on one frame, from the frame's prior when it has one. agree: how poses agree with the data is asked,
    too, which takes a tenth of the time; else it is NaN.
    """
    rows = []
    for method in methods:
        pose, verdict, spent, answer = _run(method, frame, judge.model, seed, settings, beliefs)
        errors = None
        if frame.camera_from_object_truth is not None:
            covariance = None if answer is None else answer.covariance
            errors = judge.errors(pose, frame.camera_from_object_truth, covariance)
        agreement = judge.agreement(frame, pose) if agree else Agreement(math.nan, math.nan, math.nan)
        rows.append(Row(capture, group, frame.index, method, pose, verdict, spent, errors, agreement, answer))
    return rows


def compare(
    captures: Iterable[Capture],
    methods: Sequence[str] = METHODS,
    seed: int = 0,
    model: ObjectModel | None = None,
    prepare: Callable[[Frame, ObjectModel], Frame] | None = None,
    settings: EstimateSettings | None = None,
    beliefs: Beliefs | None = None,
    leave_out: Callable[[str], None] | None = None,
) -> Iterator[Row]:
    """Rows of every frame of every capture, as they are done.

    model: instead of each capture's own. prepare: changes a frame before it is used (another prior). settings, beliefs:
    of our own methods. leave_out: is told why a frame cannot be used, and the others are compared. Raises InputError
    for an unknown method and a capture that is given twice, CaptureError for a frame that cannot be used: for the
    first without leave_out, and where no frame can be.
    """
    methods = check_methods(methods)
    warm, refused = False, None
    captures = list(captures)
    places = [capture.path.resolve() for capture in captures]
    again = next((place for place in places if places.count(place) > 1), None)
    if again is not None:
        raise InputError(f"{again}: expected each capture once, got it {places.count(again)} times")
    names = [capture.name for capture in captures]
    for capture in captures:
        # frames of two folders of one name are not the same ones
        name = capture.name if names.count(capture.name) == 1 else str(capture.path)
        judge = Judge(model or capture.model)
        judge.model.field  # noqa: B018  (built or read from the cache before anything is timed)
        for number in capture.frame_ids:
            try:
                frame = usable(capture, number, judge.model, prepare)
            except CaptureError as error:
                if leave_out is None:
                    raise
                leave_out(str(error))
                refused = refused or error
                continue
            if not warm:
                # compiles; its times would tell of the compiler
                compare_frame(frame, judge, methods, seed, settings=settings, beliefs=beliefs)
                warm = True
            yield from compare_frame(frame, judge, methods, seed, name, group_of(capture), settings, beliefs)
    if refused is not None and not warm:
        raise refused


def group_of(capture: Capture) -> str:
    """Captures made alike share a group: how they were made when they say it, else their name without its number."""
    notes = capture.manifest.notes
    noise, hidden = notes.get("noise"), notes.get("occlusion")
    # other notes are somebody's own, and say nothing of a group
    if isinstance(noise, str) and isinstance(hidden, int | float) and 0.0 <= hidden <= 1.0:
        return f"{noise}, {100 * float(hidden):.0f} % hidden"
    return re.sub(r"[\W_]*\d+$", "", capture.name) or capture.name


def summarise(rows: Iterable[Row], success: float = 0.005) -> list[Summary]:
    """Per group and method, in order of appearance. success: ADD-S threshold, m; a frame that is lost can still
    succeed by its pose, and a lost one without truth counts in the verdicts only.
    """
    buckets: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        buckets.setdefault((row.group, row.method), []).append(row)
    return [_summary(group, method, bucket, success) for (group, method), bucket in buckets.items()]


def _summary(group: str, method: str, rows: list[Row], success: float) -> Summary:
    known = [row.errors for row in rows if row.errors is not None]

    def median(values: Iterable[float]) -> float:
        finite = [value for value in values if np.isfinite(value)]
        return float(np.median(finite)) if finite else float("nan")

    return Summary(
        group,
        method,
        len(rows),
        median(1e3 * e.add_s for e in known),
        float(np.mean([e.add_s < success for e in known])) if known else float("nan"),
        median(np.rad2deg(e.rotation) for e in known),
        median(1e3 * e.translation for e in known),
        median(1e3 * row.agreement.cloud for row in rows),
        median(1e3 * row.agreement.contacts for row in rows),
        median(row.time_ms for row in rows),
        dict(Counter(row.verdict for row in rows if row.verdict)),
    )


def _run(
    method: str,
    frame: Frame,
    model: ObjectModel,
    seed: int,
    settings: EstimateSettings | None,
    beliefs: Beliefs | None,
) -> tuple[Array, str, float, Estimate | None]:
    if method in SENSES:
        answer = estimate(frame, model, use=SENSES[method], seed=seed, settings=settings, beliefs=beliefs)
        return answer.pose, answer.verdict, answer.time_ms, answer
    began = time.perf_counter()
    start = frame.prior if frame.prior is not None else _centred(frame, model)
    points = crop_points(frame, model, start) if method == "icp" else object_points(frame, model, start)
    if method == "icp_touch":
        points = with_contacts(points, frame)
    spent = 1e3 * (time.perf_counter() - began)
    result = icp(points, model, start)
    # ICP cannot judge itself; only a degenerate cloud gives it away
    return result.pose, "lost" if result.degenerate else "", spent + result.ms, None


def with_contacts(points: Array, frame: Frame) -> Array:
    """(m, 3) points of the camera and, repeated until they are CONTACT_SHARE of all, the contacts; camera frame.

    Weighted ICP for vision and touch in its plainest form: both are points on the surface, and the few of touch count
    for many. Their order is mixed, so that a subset has the same share.
    """
    felt = places_touched(frame)
    if not len(felt):
        return points
    times = max(1, round(CONTACT_SHARE / (1.0 - CONTACT_SHARE) * len(points) / len(felt)))
    both = np.concatenate([points, np.tile(felt, (times, 1))])
    return both[np.random.default_rng(0).permutation(len(both))]


def _centred(frame: Frame, model: ObjectModel) -> Array:
    """Without a prior ICP starts where the points are, turned as the model happens to be."""
    points = all_points(frame)
    if not len(points):
        points = places_touched(frame)
    middle = np.median(points, axis=0) if len(points) else np.zeros(3)
    return poses.make_pose(translation=middle - model.centroid)
