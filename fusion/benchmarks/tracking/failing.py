"""Sensors fail amid a track: an image hangs, is late or missing, contacts hang, the camera is bumped, a board passes.

Sequences of families with a hand as `tracking` has them, each followed as it is and with one sensor that fails from a
third of it on, for a while or for good. Is the track still right, and does it stay honest?
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.families.making import judge_of, objects_of, why_not
from fusion.benchmarks.families.table import FAMILIES, chosen
from fusion.benchmarks.printing.one_thread import one_thread
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table, own_seed
from fusion.benchmarks.strata import parallel
from fusion.benchmarks.tracking.bench import MOTIONS, OBJECTS
from fusion.benchmarks.tracking.cells import Cell, sequence_of
from fusion.benchmarks.tracking.sequences import USUAL
from fusion.benchmarks.tracking.tally import WRONG
from scenes.errors import unknown
from scenes.geometry import poses as se3
from scenes.recordings.frames import Contacts, Frame

Array = NDArray[np.float64]
Fails = Callable[[list[Frame], int, np.random.Generator], list[Frame]]

# Motions that are asked for where none are named, frames of a sequence, and frames in a hurry.
USUAL_MOTIONS = ("carry", "slip", "turn", "shake")
LONG, QUICK = 24, 9
# Frames for which what fails for a while does.
WHILE = 8
# A camera that is bumped (m, rad), joints that are off (rad), noise that a lamp makes (m), depth that drifts (share).
BUMP, TILT = 0.015, float(np.deg2rad(2.0))
BENT = float(np.deg2rad(5.0))
NOISE = 0.01
DRIFT = 0.015
# A board is this far before the object (m), hides these columns beside it (px), and goes by so many a frame.
BOARD, BESIDE, PASSING = 0.12, (-60, 20), 15


def _for_a_while(change: Callable[[Frame, Frame], Frame]) -> Fails:
    """A change to the frames of a while, by each of them and the last one before."""

    def fails(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
        before = frames[at - 1]
        return [change(one, before) if at <= n < at + WHILE else one for n, one in enumerate(frames)]

    return fails


def _late(by: int) -> Fails:
    """Every image is that of so many frames before; the first comes again until there is another."""

    def fails(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
        seen = [frames[max(0, n - by)] for n in range(len(frames))]
        return [replace(one, depth=old.depth, rgb=old.rgb) for one, old in zip(frames, seen)]

    return fails


def _bumped(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
    turn, move = se3.random_unit_vectors(2, rng)
    off = se3.make_pose(se3.exp_rotation(TILT * turn), BUMP * move)
    later = [replace(one, camera_from_world=off @ one.camera_from_world) for one in frames[at:]]
    return [*frames[:at], *later]


def _no_touch(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
    return [*frames[:at], *(replace(one, contacts=Contacts.none()) for one in frames[at:])]


def _touch_hangs(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
    return [*frames[:at], *(replace(one, contacts=frames[at - 1].contacts) for one in frames[at:])]


def _bent(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
    def off(one: Frame) -> Frame:
        return one if one.joints is None else replace(one, joints={k: v + BENT for k, v in one.joints.items()})

    return [*frames[:at], *map(off, frames[at:])]


def _drifts(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
    factors = np.linspace(1.0, 1.0 + DRIFT, len(frames))
    return [_with_depth(one, _depth_of(one) * factor) for one, factor in zip(frames, factors)]


def _noisy(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
    def spoiled(one: Frame) -> Frame:
        depth = _depth_of(one)
        return _with_depth(one, np.where(depth > 0.0, depth + NOISE * rng.normal(size=depth.shape), 0.0))

    return [spoiled(one) if at <= n < at + WHILE else one for n, one in enumerate(frames)]


def _hidden(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
    def passed(one: Frame, gone: int) -> Frame:
        place = one.camera_from_object_truth
        assert one.camera is not None
        assert place is not None
        depth, middle = _depth_of(one).copy(), one.camera.fx * place[0, 3] / place[2, 3] + one.camera.cx
        low, high = (int(middle + side + PASSING * gone) for side in BESIDE)
        depth[:, max(low, 0) : max(high, 0)] = place[2, 3] - BOARD
        return _with_depth(one, depth)

    return [passed(one, n - at) if at <= n < at + WHILE else one for n, one in enumerate(frames)]


def _missing(frames: list[Frame], at: int, rng: np.random.Generator) -> list[Frame]:
    return [*frames[:at], *frames[at + WHILE :]]


def _depth_of(frame: Frame) -> Array:
    assert frame.depth is not None
    return np.asarray(frame.depth, dtype=np.float64)


def _with_depth(frame: Frame, depth: Array) -> Frame:
    return replace(frame, depth=depth.astype(np.float32))


JOINTS_OFF = f"joints are off by {np.rad2deg(BENT):.0f} degrees"
# What fails, by name: frames of a sequence, the number of the first that it fails in, and what is drawn.
FAILURES: dict[str, Fails] = {
    "nothing fails": lambda frames, at, rng: frames,
    f"the image hangs for {WHILE} frames": _for_a_while(lambda one, old: replace(one, depth=old.depth, rgb=old.rgb)),
    f"no image for {WHILE} frames": _for_a_while(lambda one, old: one.without_vision()),
    f"{WHILE} frames are missing": _missing,
    "the contacts hang": _touch_hangs,
    "no contacts": _no_touch,
    f"a board passes, {WHILE} frames": _hidden,
    f"noise of {1e3 * NOISE:.0f} mm for {WHILE} frames": _noisy,
    f"depth drifts by {DRIFT:.1%}": _drifts,
    JOINTS_OFF: _bent,
    f"the camera is bumped, {1e3 * BUMP:.0f} mm and {np.rad2deg(TILT):.0f} degrees": _bumped,
    "images are one frame late": _late(1),
    "images are two frames late": _late(2),
}


@dataclass
class Failed:
    """Of one failure: ADD-S (m), whether it was ok, and whether the 95 % region holds, of each answer."""

    add_s: list[float] = field(default_factory=list)
    ok: list[bool] = field(default_factory=list)
    held: list[bool] = field(default_factory=list)


def follow(cell: Cell) -> list[tuple[str, Failed]]:
    """The cell's first motion, followed with each failure, by their names; none where no grasp hides the object by as
    much as asked.
    """
    from scipy.stats import chi2

    from fusion.tracking.tracker import track

    motion = cell.motions[0]
    made = sequence_of(cell, motion)
    if made is None:
        return []
    model, frames, _ = made
    judge, inside = judge_of(cell.name, FAMILIES[cell.family].mesh_error), float(chi2.ppf(0.95, 6))
    out = []
    with one_thread():
        for name, fails in FAILURES.items():
            if name == JOINTS_OFF and FAMILIES[cell.family].hand == "gripper":
                continue  # its joints are lengths
            rng = np.random.default_rng(own_seed(cell.seed, *cell.key, motion, name))
            said, told = Failed(), fails(list(frames), len(frames) // 3, rng)
            for frame, answer in zip(told, track(told, model, seed=cell.seed)):
                if frame.camera_from_object_truth is None:
                    continue
                errors = judge.errors(answer.pose, frame.camera_from_object_truth, answer.covariance)
                said.add_s.append(errors.add_s)
                said.ok.append(answer.verdict == "ok")
                said.held.append(bool(errors.nees <= inside))
            out.append((name, said))
    return out


def run(settings: BenchSettings) -> Report:
    """One table, a row a failure: all sequences of all families together."""
    frames = settings.frames or (QUICK if settings.quick else LONG)
    trials, motions = settings.count(1, 1), settings.motions or USUAL_MOTIONS
    for name in motions:
        if name not in MOTIONS:
            raise unknown("motion", name, MOTIONS)
    families = [one for one in chosen(settings.family or USUAL) if one.hand]
    report = Report(
        "failing",
        "Sensors fail amid a track",
        f"{', '.join(family.name for family in families)}; {trials} sequences of {frames} frames an object and motion"
        f" ({', '.join(motions)}), 30 frames a second",
        settings.seed,
    )
    missing = [f"{family.name}: {why}" for family in families if (why := why_not(family))]
    cells = [
        Cell(family.name, name, trial, (motion,), frames, (), settings.seed, settings.folder)
        for family in families
        if not why_not(family)
        for name in settings.some(settings.objects or objects_of(family, OBJECTS) or objects_of(family), 1)
        for motion in (motions[:1] if settings.quick else motions)
        for trial in range(trials)
    ]
    found: dict[str, Failed] = {name: Failed() for name in FAILURES}
    for one in settings.progress(parallel(follow, cells), len(cells), "sequences"):
        for name, said in one:
            for part in ("add_s", "ok", "held"):
                getattr(found[name], part).extend(getattr(said, part))
    table = _table(found, missing)
    report.tables.append(table)
    settings.show(table)
    for name, said in found.items():
        if said.ok:
            report.claims.append(
                Claim(f"wrong but ok, % of frames: {name}", 100.0 * _wrong(said).mean(), 1.0, False, 1)
            )
    return report


def _wrong(said: Failed) -> NDArray[np.bool_]:
    """(n,) whether each answer is wrong but ok."""
    return np.array(said.ok) & (np.array(said.add_s) > WRONG)


def _table(found: dict[str, Failed], missing: list[str]) -> Table:
    columns = [Column("what fails"), Column("frames", 0), Column("median ADD-S mm"), Column("< 5 mm"), Column("ok")]
    columns += [Column("wrong but ok"), Column("95 % regions hold")]
    note = (
        "What fails does from a third of a sequence on, late images from the first. wrong: ADD-S above 5 mm, of the"
        " frame's own time." + "".join(f" Left out: {reason}." for reason in missing)
    )
    table = Table("Sensors that fail amid a track", columns, note=note)
    for name, said in found.items():
        if not said.ok:
            continue
        errors = np.array(said.add_s)
        rates = Rate.of(errors <= WRONG), Rate.of(said.ok), Rate.of(_wrong(said)), Rate.of(said.held)
        table.add(name, len(errors), Quantile.of(errors, 1e3), *rates)
    return table
