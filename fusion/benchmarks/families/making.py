"""Frames of a family, each its own draw of everything; what the estimator is told of the object beside them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.camera.frames import ROOT
from fusion.benchmarks.camera.frames import objects as known_objects
from fusion.benchmarks.families.table import RECORDED, Family
from fusion.benchmarks.printing.tables import own_seed
from fusion.truth.errors import Judge
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.captures import read_capture
from scenes.recordings.frames import Frame
from scenes.robot.hands import Hand
from scenes.synthesis.hands import FingerShape, HandShape
from scenes.synthesis.settings import SynthesisSettings

Array = NDArray[np.float64]

# Draws of one frame before it is left out: not every grasp can hide so much.
MOST_REFUSED = 3
# A recorded pose is the truth when the mask's pixels lie this near to the surface there (m, median): what a depth
# camera is good to on a table; poses that other estimators left are farther off.
TRUE_WITHIN = 0.0015
# Start of every frame (rad, m), as synthesis has it (T1 section 4.3).
START = (float(np.deg2rad(16.0)), 0.033)
# The hand of report families: shorter and thicker fingers, wider apart, another coupling of their last joints.
STOUT = HandShape(
    fingers=(
        FingerShape((0.041, 0.025, 0.016), (0.090, -0.034, 0.0), float(np.deg2rad(-7.0))),
        FingerShape((0.046, 0.028, 0.0165), (0.094, -0.0095, 0.0), float(np.deg2rad(-2.0))),
        FingerShape((0.0425, 0.0265, 0.017), (0.089, 0.0165, 0.0), float(np.deg2rad(5.0))),
        FingerShape((0.034, 0.0205, 0.015), (0.080, 0.0405, 0.0), float(np.deg2rad(11.0))),
    ),
    thumb=(0.045, 0.031, 0.020),
    thumb_base=(0.022, -0.028, 0.003),
    thumb_spread=float(np.deg2rad(60.0)),
    finger_radii=(0.0112, 0.0102, 0.0096, 0.0090),
    thumb_radii=(0.0145, 0.0122, 0.0108, 0.0092),
    dip_coupling=0.75,
)


@dataclass(frozen=True)
class Made:
    """frame with truth and start; model that the estimator is given; name of the object; number of the trial."""

    name: str
    frame: Frame
    model: ObjectModel
    trial: int = 0

    @property
    def key(self) -> str:
        """Tells it from the other frames of its family and hidden share."""
        return f"{self.name}/{self.trial}"


def why_not(family: Family) -> str:
    """Why this installation cannot make the family's frames; "" when it can."""
    if family.name == RECORDED:
        return "" if recordings() else f"no recorded frames with a true pose in {_data() / 'real'}"
    try:
        family.preset()
    except InputError:
        return f"no camera {family.camera!r} in this version"
    return "" if objects_of(family) else f"no scanned objects in {_data() / 'ycb'}"


def objects_of(family: Family, asked: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """Names of the family's objects that are here, or of the asked ones among them."""
    if family.name == RECORDED:
        names = tuple(path.name for path in recordings())
    else:
        scanned = set(known_objects()) if any(":" in name for name in family.objects) else set()
        names = tuple(name for name in family.objects if ":" not in name or name in scanned)
    return names if asked is None else tuple(name for name in names if name in asked)


def _data() -> Path:
    return Path(os.environ.get("PALPATE_DATA") or ROOT.parent / "shared" / "data")


@lru_cache(maxsize=64)
def true_model(name: str) -> ObjectModel:
    """A generated, a held-out or a scanned object."""
    from scenes.synthesis import library

    return known_objects((name,))[name]() if ":" in name else library.make(name)


@lru_cache(maxsize=64)
def judge_of(name: str, mesh_error: str | None) -> Judge:
    """The judge of what the estimator is given: poses are compared on its own mesh."""
    from scenes.synthesis.staging.mesh_errors import believed

    return Judge(believed(true_model(name), mesh_error))


def hand_of(family: Family) -> Hand | None:
    """The hand in its scenes."""
    from scenes.synthesis.gripper import parallel_gripper
    from scenes.synthesis.hands import five_finger_hand

    if family.hand == "gripper":
        return parallel_gripper()
    if family.hand == "stout":
        return five_finger_hand(STOUT)
    return five_finger_hand() if family.hand else None


def frames_of(
    family: Family, occlusion: float, trials: int, seed: int, objects: tuple[str, ...] | None = None, first: int = 0
) -> Iterator[Made]:
    """Frames of each object, from number `first` up to `trials`, `occlusion` of it hidden; fewer where that cannot be
    reached.

    A frame depends on family, object, occlusion, its number and the seed. Raises InputError when the family cannot be
    made here (see `why_not`).
    """
    reason = why_not(family)
    if reason:
        raise InputError(f"family {family.name!r}: expected what it is made of, got {reason}")
    for name in objects_of(family, objects):
        for trial in range(first, trials):
            made = _recorded(name, family, trial, seed) if family.name == RECORDED else None
            if family.name != RECORDED:
                made = _made(family, name, occlusion, trial, seed)
            if made is not None:
                yield made


def _seed(family: Family, seed: int, *what: str | float) -> int:
    drawn = own_seed(seed, family.name, *what)
    return family.seeds[drawn % len(family.seeds)]


def settings_of(family: Family) -> SynthesisSettings:
    """Camera, distances and start of its frames."""
    usual = SynthesisSettings(camera=family.lens, mask=family.mask, prior_angle=START[0], prior_distance=START[1])
    usual = replace(usual, contacts_a_finger=family.contacts_a_finger, skin_reach=family.skin_reach)
    return replace(usual, views=replace(usual.views, nearest=family.distance[0], farthest=family.distance[1]))


def _made(family: Family, name: str, occlusion: float, trial: int, seed: int) -> Made | None:
    from scenes.synthesis.recording import synthesize_frames

    model = true_model(name)
    for attempt in range(MOST_REFUSED):
        try:
            (frame,) = synthesize_frames(
                model,
                hand_of(family),
                1,
                occlusion,
                family.touch,
                family.preset(),
                _seed(family, seed, name, occlusion, trial, attempt),
                family.occluders,
                settings_of(family),
                scene=family.scene,
            )
        except InputError:  # a grasp or view that cannot hide so much is drawn anew
            continue
        return Made(name, frame, judge_of(name, family.mesh_error).model, trial)
    return None


@lru_cache(maxsize=1)
def recordings() -> tuple[Path, ...]:
    """Captures of the data folder's `real` whose first frame has a pose that its mask's pixels agree with."""
    folder = _data() / "real"
    found = sorted(path.parent for path in folder.glob("*/capture.json")) if folder.is_dir() else []
    return tuple(path for path in found if _is_true(path))


def _is_true(path: Path) -> bool:
    capture = read_capture(path)
    frame = capture[0]
    truth, camera = frame.camera_from_object_truth, frame.camera
    if truth is None or frame.mask is None or frame.depth is None or camera is None:
        return False
    points = poses.apply(poses.inverse(truth), camera.back_project(frame.depth, frame.mask))
    return len(points) > 100 and float(np.median(np.abs(capture.model.field.distance(points)))) < TRUE_WITHIN


@lru_cache(maxsize=16)
def _recording(name: str) -> tuple[Frame, Judge]:
    capture = read_capture(_data() / "real" / name)
    return capture[0], Judge(capture.model)


def _recorded(name: str, family: Family, trial: int, seed: int) -> Made:
    frame, judge = _recording(name)
    assert frame.camera_from_object_truth is not None
    rng = np.random.default_rng(_seed(family, seed, name, trial))
    start = poses.displaced(frame.camera_from_object_truth, *START, judge.model.centroid, rng)
    mask = frame.mask if family.mask else None
    return Made(name, replace(frame, mask=mask, prior=start), judge.model, trial)


def judge_for(family: Family, made: Made) -> Judge:
    """Measures poses of a frame's object."""
    return _recording(made.name)[1] if family.name == RECORDED else judge_of(made.name, family.mesh_error)
