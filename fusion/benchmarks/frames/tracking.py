"""Sequences of an object in a hand: carried, turned, slipping, leaving the view. Who follows it, how well, how fast?

Captures of scenes.synthesis.motion by family, no mask: every motion in the lab, one in every other family with a hand.
Methods that need a start get the capture's own, 16 degrees and 33 mm off (T1 section 4.3), in the first frame only;
"estimate" has no memory and gets such a start in every frame. The particle filter begins from what vision found in the
first frame. A frame is lost when its ADD-S is above 10 mm.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.families.making import hand_of, judge_of, objects_of, settings_of, true_model, why_not
from fusion.benchmarks.families.table import FAMILIES, Family, chosen
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.frames import Frame
    from scenes.synthesis.recording import SynthesisSettings

Array = NDArray[np.float64]

OBJECTS = ("drill", "mug", "bottle", "hammer")
MOTIONS = ("slip", "carry", "leave", "turn")
# The family whose every motion is followed, and what is followed of the others.
USUAL, OTHER_OBJECTS, OTHER_MOTIONS = "lab", 2, ("carry",)
# Families that are followed in a hurry when none are asked for.
QUICK_FAMILIES = (USUAL, "workshop", "human-hand")
METHODS = ("icp", "particle filter", "vision", "estimate", "track")
OCCLUSION = 0.6
# An answer farther off than this is of no use to a hand (m): twice the success threshold of the other tables.
LOST = 0.010
# Slips are counted when a sensor could know of them: motion beyond the object's symmetry above this (rad, m).
SLIP_ANGLE, SLIP_DISTANCE = float(np.deg2rad(1.5)), 0.001
# Frames after a slip in which saying so still counts.
SLIP_DELAY = 3


@dataclass
class Tally:
    """One method on one kind of motion: ADD-S (m), rotation (rad), NEES / 6, wall and processor ms of each frame;
    answers called ok although lost; new starts; slips, those said in time and false alarms, as a slip and as a
    motion in the hand; frames without a slip.
    """

    add_s: list[float] = field(default_factory=list)
    rotation: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    wrong_ok: int = 0
    again: int = 0
    slips: int = 0
    hits: int = 0
    alarms: int = 0
    moved_hits: int = 0
    moved_alarms: int = 0
    steady: int = 0


@dataclass(frozen=True)
class Said:
    """What a method said of one frame."""

    pose: Array
    covariance: Array | None = None
    ok: bool = True
    slip: bool = False
    moved: bool = False
    again: bool = False


Step = Callable[["Frame"], Said]


def run(settings: BenchSettings) -> Report:
    """Tables by motion and method: error, lost frames, new starts, slips, time."""
    trials = settings.count(2, 1)
    frames = 12 if settings.quick else 45
    families = [family for family in chosen(settings.family) if family.hand]
    if settings.quick and settings.family is None:
        families = [family for family in families if family.name in QUICK_FAMILIES]
    report = Report(
        "tracking",
        f"An object in a hand, up to {OCCLUSION:.0%} hidden in the first frame, 30 frames a second",
        f"{trials} sequences of {frames} frames an object and motion of {USUAL}; of every other family {OTHER_OBJECTS}"
        f" objects, one sequence",
        settings.seed,
    )
    tracked = {}
    for family in families:
        if why_not(family):
            report.tables.append(Table(f"{family.name}: left out, {why_not(family)}", _COLUMNS))
            continue
        usual = family.name == USUAL
        names = settings.objects or (OBJECTS if usual else objects_of(family)[:OTHER_OBJECTS])
        names = tuple(settings.some(names, 1))
        for motion in settings.some(MOTIONS, 2) if usual else OTHER_MOTIONS:
            tallies = _sequences(family, motion, names, trials if usual else 1, frames, settings)
            report.tables.append(_errors(f"{family.name}, {motion}", *tallies))
            settings.show(report.tables[-1])
            if usual:
                tracked[motion] = tallies[0]["track"]
            if family.hand_known:
                report.tables.append(_slips(f"{family.name}, {motion}", tallies[0]["track"]))
                settings.show(report.tables[-1])
    cpu = [x for tally in tracked.values() for x in tally.cpu]
    wall = [x for tally in tracked.values() for x in tally.wall]
    if wall:
        report.claims.append(Claim("a fused tracked frame, median processor ms", float(np.median(cpu)), 30.0, False, 1))
        report.claims.append(Claim("a fused tracked frame, median wall ms", float(np.median(wall)), 30.0, False, 1))
    return report


def _sequences(
    family: Family, motion: str, names: tuple[str, ...], trials: int, frames: int, settings: BenchSettings
) -> tuple[dict[str, Tally], int]:
    """Every method on every sequence of a motion; how many sequences could not be made."""
    tallies = {method: Tally() for method in METHODS}
    cells = [(name, trial) for name in names for trial in range(trials)]
    refused = 0
    for name, trial in settings.progress(cells, len(cells), f"{family.name}, {motion}"):
        folder = settings.folder / "tracking" if settings.folder is not None else None
        hidden = min(OCCLUSION, max(family.levels))
        made = recorded(name, motion, frames, settings.seed + 101 * trial, folder, hidden, family=family)
        if made is None:
            refused += 1
            continue
        for method, tally in tallies.items():
            _follow(tally, method, *made, settings.seed)
    return tallies, refused


def recorded(
    name: str,
    motion: str,
    frames: int,
    seed: int,
    folder: Path | None,
    occlusion: float = OCCLUSION,
    settings: SynthesisSettings | None = None,
    family: Family = FAMILIES[USUAL],
    **how: Any,
) -> tuple[ObjectModel, list[Frame], dict[str, Any]] | None:
    """A sequence and its notes; None when no grasp of three seeds hides the object by as much as asked.

    folder: where the capture (with the true mesh) is kept for the next run, None keeps none. how: more arguments of
    scenes.synthesize.
    """
    from scenes.errors import InputError
    from scenes.recordings.captures import read_capture
    from scenes.synthesis.recording import synthesize

    settings = settings or replace(settings_of(family), rgb=False)
    model = judge_of(name, family.mesh_error).model
    for attempt in range(3):
        with tempfile.TemporaryDirectory() as scratch:
            label = f"{family.name}-{name.replace(':', '-')}-{motion}-{frames}-{seed}-{attempt}"
            kept = Path(scratch if folder is None else folder) / label
            try:
                if not (kept / "capture.json").is_file():
                    drawn = family.seeds[seed + 1000 * attempt]
                    arguments = {"touch": family.touch, "scene": family.scene, **how}
                    synthesize(
                        kept, true_model(name), hand_of(family), frames, occlusion, noise=family.preset(), seed=drawn,
                        motion=motion, settings=settings, **arguments,
                    )  # fmt: skip
            except InputError:
                continue
            capture = read_capture(kept)
            return model, list(capture), capture.manifest.notes["motion"]
    return None


def _follow(
    tally: Tally, method: str, model: ObjectModel, frames: list[Frame], notes: dict[str, Any], seed: int
) -> None:
    from fusion.truth.errors import Judge

    judge = Judge(model)
    step = _stepper(method, model, seed)
    said = []
    for frame in frames:
        wall, cpu = time.perf_counter(), time.process_time()
        answer = step(frame)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        said.append(answer)
        truth = frame.camera_from_object_truth
        assert truth is not None
        error = judge.errors(answer.pose, truth, answer.covariance)
        tally.add_s.append(error.add_s)
        tally.rotation.append(error.rotation)
        tally.nees.append(error.nees / 6)
        if frame is not frames[0]:  # the first is a search, and compiles
            tally.wall.append(1e3 * wall)
            tally.cpu.append(1e3 * cpu)
        tally.wrong_ok += int(answer.ok and error.add_s > LOST)
        tally.again += int(answer.again)
    if frames[0].world_from_hand is not None:
        count_slips(tally, model, frames, said, notes)


def count_slips(tally: Tally, model: ObjectModel, frames: list[Frame], said: list[Said], notes: dict[str, Any]) -> None:
    """Slips whose motion the object's symmetry does not hide, and alarms in frames in which nothing slips."""
    from scenes.geometry import poses

    slipping = np.zeros(len(frames), dtype=bool)
    slip_said, moved_said = np.array([answer.slip for answer in said]), np.array([answer.moved for answer in said])
    for slip in notes["slips"]:
        first, last = int(slip["first"]), min(int(slip["last"]), len(frames) - 1)
        until = min(last + 1 + SLIP_DELAY, len(frames))
        slipping[first:until] = True
        before, after = (_hold(frames[i]) for i in (first - 1, last))
        delta = poses.difference(model.symmetries.nearest(after, before), before, model.centroid)
        if np.linalg.norm(delta[:3]) > SLIP_ANGLE or np.linalg.norm(delta[3:]) > SLIP_DISTANCE:
            tally.slips += 1
            tally.hits += int(slip_said[first:until].any())
            tally.moved_hits += int(moved_said[first:until].any())
    tally.alarms += _false_alarms(slip_said, slipping)
    tally.moved_alarms += _false_alarms(moved_said, slipping)
    tally.steady += int((~slipping).sum())


def _false_alarms(said: NDArray[np.bool_], slipping: NDArray[np.bool_]) -> int:
    """Alarms that begin in a frame without a slip; one of several frames is one."""
    begins = said & ~np.concatenate([[False], said[:-1]])
    return int((begins & ~slipping).sum())


def _hold(frame: Frame) -> Array:
    from scenes.geometry import poses

    assert frame.world_from_hand is not None
    assert frame.camera_from_object_truth is not None
    return np.asarray(poses.inverse(frame.world_from_hand) @ frame.camera_from_object_truth)


def _stepper(method: str, model: ObjectModel, seed: int) -> Step:
    """What a method does with one frame after another."""
    makers = {"icp": _icp, "particle filter": _particles, "vision": _vision, "estimate": _estimate, "track": _track}
    return makers[method](model, seed)


def _icp(model: ObjectModel, seed: int) -> Step:
    """Point-to-plane ICP from the last pose, on our segmentation; no velocity, no loss detection."""
    from vision.look.look import object_points
    from vision.published.icp import icp

    pose: Array | None = None

    def step(frame: Frame) -> Said:
        nonlocal pose
        start = pose if pose is not None else frame.prior
        assert start is not None
        pose = icp(object_points(frame, model, start), model, start).pose
        return Said(pose)

    return step


def _particles(model: ObjectModel, seed: int) -> Step:
    from vision.tracking.by_vision import VisionTracker
    from vision.tracking.particles import ParticleTracker

    tracker: ParticleTracker | None = None

    def step(frame: Frame) -> Said:
        nonlocal tracker
        if tracker is None:
            tracker = ParticleTracker(model, VisionTracker(model, seed=seed).step(frame).pose, seed=seed)
        return Said(tracker.step(frame))

    return step


def _vision(model: ObjectModel, seed: int) -> Step:
    from vision.tracking.by_vision import VisionTracker

    tracker = VisionTracker(model, seed=seed)

    def step(frame: Frame) -> Said:
        found = tracker.step(frame)
        return Said(found.pose, found.covariance, not found.lost, again=found.how == "re-initialised")

    return step


def _estimate(model: ObjectModel, seed: int) -> Step:
    """Each frame by itself, from a start as far off as the first frame's."""
    from fusion.estimation.estimate import estimate
    from scenes.geometry import poses
    from scenes.synthesis.recording import SynthesisSettings

    start = SynthesisSettings()

    def step(frame: Frame) -> Said:
        truth = frame.camera_from_object_truth
        assert truth is not None
        rng = np.random.default_rng([seed, frame.index])
        prior = poses.displaced(truth, start.prior_angle, start.prior_distance, model.centroid, rng)
        answer = estimate(frame, model, prior, seed=seed)
        return Said(answer.pose, answer.covariance, answer.verdict == "ok")

    return step


def _track(model: ObjectModel, seed: int) -> Step:
    from fusion.tracking.tracker import Tracker

    tracker = Tracker(model, seed=seed)

    def step(frame: Frame) -> Said:
        answer = tracker.step(frame)
        again = answer.how == "re-initialised"
        ok = answer.verdict == "ok"
        return Said(answer.pose, answer.covariance, ok, answer.slip, answer.moved_in_hand, again)

    return step


_COLUMNS = (
    Column("method"),
    Column("frames", 0),
    Column("median ADD-S mm"),
    Column("95 % mm"),
    Column("rotation deg"),
    Column("lost (> 10 mm)"),
    Column("lost but ok", 0),
    Column("new starts", 0),
    Column("NEES / 6"),
    Column("processor ms", 1),
    Column("wall ms", 1),
    Column("wall 95 %", 1),
)


def _errors(motion: str, tallies: dict[str, Tally], refused: int) -> Table:
    table = Table(
        f"{motion}: error, lost frames and time",
        _COLUMNS,
        note="NEES / 6: median over frames, 0.9 is right. Times of all but the first frame, segmentation included."
        + (f" {refused} sequences could not be made: no grasp hides the object by as much." if refused else ""),
    )
    for method, tally in tallies.items():
        if not tally.add_s:
            continue
        add_s = 1e3 * np.array(tally.add_s)
        known = [x for x in tally.nees if np.isfinite(x)]
        table.add(
            method,
            len(add_s),
            float(np.median(add_s)),
            float(np.quantile(add_s, 0.95)),
            float(np.rad2deg(np.median(tally.rotation))),
            Rate(int((add_s > 1e3 * LOST).sum()), len(add_s)),
            tally.wrong_ok,
            tally.again,
            float(np.median(known)) if known else None,
            float(np.median(tally.cpu)),
            float(np.median(tally.wall)),
            float(np.quantile(tally.wall, 0.95)),
        )
    return table


def _slips(motion: str, tally: Tally) -> Table:
    slips = Table(
        f"{motion}: slips in the hand, said by the track",
        [
            Column("slips", 0),
            Column("said in time as moved_in_hand"),
            Column("false alarms", 0),
            Column("said in time as slip"),
            Column("of slip: false alarms", 0),
            Column("steady frames", 0),
        ],
        note=f"In time: up to {SLIP_DELAY} frames after its end. Slips about an axis of symmetry are not counted. The"
        " fingers of these captures close anew on an object that moves, so that their own motion often predicts it:"
        " it has moved in the hand, and only what they do not predict is a slip.",
    )
    moved, said = Rate(tally.moved_hits, tally.slips), Rate(tally.hits, tally.slips)
    slips.add(tally.slips, moved, tally.moved_alarms, said, tally.alarms, tally.steady)
    return slips
