"""How well a method followed: errors, verdicts, slips and times, frame by frame. Metres, radians, milliseconds."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.tracking.methods import END, WRONG_STARTS, Said, stepper

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# An answer farther off than this is of no use to a hand (m): twice the success threshold of the other tables, which is
# also where an answer that says ok is wrong.
LOST, WRONG = 0.010, 0.005
# Slips are counted when a sensor could know of them: motion beyond the object's symmetry above this (rad, m).
SLIP_ANGLE, SLIP_DISTANCE = float(np.deg2rad(1.5)), 0.001
# Frames after a slip in which saying so still counts.
SLIP_DELAY = 3


@dataclass
class Tally:
    """One method on one kind of motion.

    frame, ADD-S (m), rotation (rad), NEES per degree of freedom, and whether it was ok, of each answer; means: of each
    sequence's NEES; held: answers whose 95 % region holds the truth; wall and processor ms of all but the first;
    rotations and ADD-S (m) at the ends of sequences; runs: frames from a loss until the object is found again; doubted,
    righted: frames from a wrong beginning until no longer ok, until right; never: wrong beginnings that were not
    righted; still_wrong_ok: answers after such a beginning that are wrong and ok; new starts; slips, those said in time
    and false alarms, as a slip and as a motion in the hand; frames without a slip.
    """

    frame: list[int] = field(default_factory=list)
    add_s: list[float] = field(default_factory=list)
    rotation: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    means: list[float] = field(default_factory=list)
    ok: list[bool] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    ends: list[float] = field(default_factory=list)
    end_errors: list[float] = field(default_factory=list)
    runs: list[int] = field(default_factory=list)
    doubted: list[int] = field(default_factory=list)
    righted: list[int] = field(default_factory=list)
    held: int = 0
    never: int = 0
    still_wrong_ok: int = 0
    again: int = 0
    slips: int = 0
    hits: int = 0
    alarms: int = 0
    moved_hits: int = 0
    moved_alarms: int = 0
    steady: int = 0

    @property
    def wrong_ok(self) -> int:
        """Answers that said ok and were wrong."""
        return sum(ok and error > WRONG for ok, error in zip(self.ok, self.add_s))

    def pooled(self, other: Tally) -> None:
        """Add what another counted."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)


def follow(
    tally: Tally, method: str, model: ObjectModel, frames: list[Frame], notes: dict[str, Any], seed: int
) -> None:
    """Give a method the frames and count what it says."""
    from scipy.stats import chi2

    from fusion.benchmarks.strata import REGION, freedom
    from fusion.truth.errors import Judge

    judge = Judge(model)
    step = stepper(method, model, seed, frames[-1].index)
    said, errors, known = [], [], []
    count = freedom(model.symmetries)
    most = float(chi2.ppf(REGION, count))
    for frame in frames:
        wall, cpu = time.perf_counter(), time.process_time()
        answer = step(frame)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        if answer is None:
            continue
        said.append(answer)
        truth = frame.camera_from_object_truth
        assert truth is not None
        error = judge.errors(answer.pose, truth, answer.covariance)
        errors.append(error.add_s)
        tally.frame.append(frame.index)
        tally.add_s.append(error.add_s)
        tally.rotation.append(error.rotation)
        tally.nees.append(error.nees / count)
        known += [tally.nees[-1]] if np.isfinite(tally.nees[-1]) else []
        tally.held += int(error.nees <= most)
        tally.ok.append(answer.ok)
        if frame is not frames[0]:  # the first is a search, and compiles
            tally.wall.append(1e3 * wall)
            tally.cpu.append(1e3 * cpu)
        tally.again += int(answer.again)
    tally.means += [float(np.mean(known))] if known else []
    tally.ends += tally.rotation[-min(END, len(said)) :]
    tally.end_errors += errors[-min(END, len(said)) :]
    if method in WRONG_STARTS:
        _count_recovery(tally, said, errors)
    elif len(said) == len(frames):
        tally.runs += losses(errors)
        if frames[0].world_from_hand is not None:
            count_slips(tally, model, frames, said, notes)


def losses(errors: list[float]) -> list[int]:
    """Frames of every stretch in which the object was lost (m) and then found."""
    out, begun = [], None
    for i, error in enumerate(errors):
        if error > LOST and begun is None:
            begun = i
        elif error <= LOST and begun is not None:
            out.append(i - begun)
            begun = None
    return out


def _count_recovery(tally: Tally, said: list[Said], errors: list[float]) -> None:
    """Frames until a wrong beginning is no longer ok, and until it is right and stays so for five frames."""
    wrong = [answer.ok and error > WRONG for answer, error in zip(said, errors)]
    tally.still_wrong_ok += sum(wrong[1:])
    tally.doubted.append(next((i for i, bad in enumerate(wrong) if not bad), len(said)))
    good = [error <= WRONG for error in errors]
    righted = next((i for i in range(len(good)) if all(good[i : i + 5])), None)
    if righted is None:
        tally.never += 1
    else:
        tally.righted.append(righted)


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
    for first, last in [notes["loose"]] if notes.get("loose") else []:
        slipping[first : last + 1 + SLIP_DELAY] = True  # fingers that let go hold nothing that could slip
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
