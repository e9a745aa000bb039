"""One frame's own answer: every hypothesis a few steps from its prediction, the leader solved with all shared errors.

Camera frame, metres, radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate, Mode
from fusion.estimation.posterior.confidence import as_shown, chances
from fusion.estimation.posterior.moments import moments
from fusion.estimation.posterior.turns import by_turns
from fusion.estimation.posterior.verdict import contact_residuals, nats_of_contacts
from fusion.estimation.solve.joint import JointResult
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.rigs import solve_modes
from fusion.estimation.solve.settings import JointSettings, Level, Rig
from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import Measurement
from fusion.tracking.memory.hypotheses import Hypotheses, as_ways, ways_of, weighed
from fusion.tracking.memory.state import TrackState
from fusion.tracking.memory.untold import Untold
from fusion.tracking.steps.by_picture import meant, walked
from fusion.tracking.steps.sensing import Sensed
from scenes.evidence import table as tables
from scenes.evidence.align import AlignSettings, Prior, align
from scenes.evidence.modes import covariance_of
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Refined:
    """Hypotheses after a frame, the leader first; seen: vision's rows at it; switched: another leads than before."""

    hypotheses: Hypotheses
    seen: Evidence
    switched: bool


def loose(pose: Array, covariance: Array, settings: TrackSettings) -> Prior:
    """A prior of a frame's own answer: the prediction, so wide that a slip is not held back. covariance (6, 6): of what
    may be otherwise in this frame than in the last; an error that both share moves nothing from one to the other.
    """
    wide = covariance + np.diag(np.repeat([settings.loose_angle, settings.loose_distance], 3) ** 2)
    return Prior(pose, np.asarray(np.linalg.inv(wide), dtype=np.float64))


def refine(
    model: ObjectModel, hypotheses: Hypotheses, leading: Prior, sensed: Sensed, imaged: bool, settings: TrackSettings
) -> Refined:
    """The hypotheses, the leader first and with its own prior, fitted to the frame and weighed by it. imaged: whether
    an image has shown them before.
    """
    priors = [leading, *(loose(h.pose, h.covariance, settings) for h in hypotheses[1:])]
    found, shown, widths, by_rows = [], [], [], []
    for k, prior in enumerate(priors):
        pose, rows, hessian, cost = _fitted(model, prior, sensed, k == 0, settings)
        width = covariance_of(model, hessian)
        likelier = walked(model, prior, pose, sensed, settings) if k == 0 else None
        if likelier is not None:
            pose, width = likelier.pose, likelier.covariance
            rows = sensed.rows_at(pose, settings.side)
        found.append(pose)
        shown.append(rows)
        widths.append(width)
        by_rows.append(cost)
    poses = np.array(found)
    nats = np.zeros(len(poses))
    if len(poses) > 1:
        nats = np.array(by_rows) if sensed.pool is None else frame_nats(poses, widths, sensed, settings)
    if len(poses) > 1 and sensed.pool is not None:
        for k, pose in _led(model, hypotheses, found[0], settings).items():
            likelier = frame_nats(pose[None], [widths[k]], sensed, settings)[0]
            if likelier < nats[k]:
                found[k], nats[k], shown[k] = pose, likelier, sensed.rows_at(pose, settings.side)
    if len(poses) > 1:
        nats = as_ways(model, found, nats, settings.hypotheses)
    wide = tuple(h if k == 0 else replace(h, covariance=widths[k]) for k, h in enumerate(hypotheses))
    between = imaged and not len(sensed.looked.pixels)
    after = weighed(wide, found, nats, settings.hypotheses, sensed.told_apart, between)
    first = next(k for k, pose in enumerate(found) if pose is after[0].pose)
    return Refined(after, shown[first], first != 0)


def _led(model: ObjectModel, hypotheses: Hypotheses, leader: Array, settings: TrackSettings) -> dict[int, Array]:
    """Poses (4, 4) by the numbers of hypotheses that have the surface where the first has it, another way round: moved
    as that has moved, whose new pose is `leader` (4, 4). What of a frame does not tell them apart moves both alike; the
    leader alone is looked for with care, which is no reason to have it likelier.
    """
    moved = leader @ se3.inverse(hypotheses[0].pose)
    return {k: moved @ hypotheses[k].pose for k in ways_of(model, hypotheses, settings.hypotheses)}


def frame_nats(poses: Array, widths: Sequence[Array], sensed: Sensed, settings: TrackSettings) -> Array:
    """(n,) nats of poses (n, 4, 4) with covariances widths, n of (6, 6), up to a constant: by what must be seen and is
    felt. A pose of which little is seen contradicts nothing, but is not known either.
    """
    pool, first, s = sensed.pool, settings.first, settings.hypotheses
    assert pool is not None
    if sensed.told_apart:
        return pool.costs(poses)
    out = s.of_cost * pool.costs(poses)
    contacts = sensed.felt.contacts
    for k, pose in enumerate(poses):
        picture = pool.predictor.predict(pose[None], settings.side)
        residuals = contact_residuals(pool.model, contacts, pose, first.verdict, sensed.felt.of_finger)
        nats = nats_of_contacts(pool.model, sensed.felt.rows, len(contacts), pose)
        mode = (Mode(pose, 1.0, 0.0, widths[k]),)
        right, _ = chances(pool.model, mode, picture, residuals, nats, settings=first.confidence)
        out[k] -= s.of_odds * float(np.log(max(right, 1e-9) / max(1.0 - right, 1e-9)))
    return out


def prefers(answer: Estimate, found: Estimate, sensed: Sensed | None, settings: TrackSettings) -> float:
    """Nats by which a frame prefers a track's answer to what it has itself found when searched; 0 without an image. An
    image whose scale is off shows neither where it is: they are compared where it shows them.
    """
    if sensed is None or sensed.pool is None:
        return 0.0
    widths = answer.modes[0].covariance, found.modes[0].covariance
    there = found.pose if found.as_seen is None else found.as_seen
    mine, its = frame_nats(np.array([sensed.seen_from @ answer.pose, there]), widths, sensed, settings)
    return float(its - mine)


def _fitted(
    model: ObjectModel, prior: Prior, sensed: Sensed, leads: bool, settings: TrackSettings
) -> tuple[Array, Evidence, Array, float]:
    """Pose, vision's rows there, Hessian and cost of the rows after a coarse and a fine pass from the prior's pose."""
    near = sensed.seen if leads and sensed.told_apart else sensed.rows_at(prior.pose, settings.side)
    rows = tables.stack(near, sensed.felt.rows)
    coarse = align(model, rows, prior.pose[None], prior, AlignSettings(blur=settings.blur, iterations=6))
    if leads and not sensed.told_apart:
        near = sensed.rows_at(coarse.poses[0], settings.side)
        rows = tables.stack(near, sensed.felt.rows)
    fine = align(model, rows, coarse.poses, prior, AlignSettings(iterations=12))
    return fine.poses[0], near, fine.hessians[0], float(fine.costs[0])


def solve_leader(
    model: ObjectModel,
    frame: Frame,
    start: Array,
    prior: Prior,
    found: Refined,
    sensed: Sensed,
    levels: list[Level],
    beliefs: Beliefs,
    settings: TrackSettings,
) -> JointResult:
    """The leader's joint solution from `start` (4, 4) with all shared errors. How large these are does not change from
    frame to frame, so that no number of frames tells it better than a few do: the level is the mean of what the first
    that see it were taken for, which go into `levels` (see `level_of`).
    """
    s, seen, joint = settings, found.seen, settings.joint
    if len(levels) < s.level_frames:
        tried = _solved(model, frame, start, prior, seen, sensed, joint, beliefs, s)
        if not tried.shares or not len(seen):
            return tried
        levels.append(level_of(tried, joint))
    mean = mean_level(levels)
    known = replace(joint, rigs=(Rig(mean.rig, 1.0),), biases=(Rig(mean.bias, 1.0),))
    return _solved(model, frame, start, prior, seen, sensed, known, beliefs, s)


def _solved(
    model: ObjectModel,
    frame: Frame,
    start: Array,
    prior: Prior,
    seen: Evidence,
    sensed: Sensed,
    joint: JointSettings,
    beliefs: Beliefs,
    settings: TrackSettings,
) -> JointResult:
    """The joint solution from `start` (4, 4); where the picture speaks against it by more nats than
    are allowed, the start, as wide as the two are apart.
    """
    hand = sensed.looked.hand
    felt = sensed.felt.rows if sensed.placed else sensed.felt.reported_rows
    most_worse = settings.first.most_worse
    problem = JointProblem.of(model, frame, seen, felt, sensed.felt.fingers, prior, hand, beliefs, joint)
    solved = solve_modes([problem], [start])[0]
    if sensed.pool is None:
        return solved
    after, before = sensed.pool.predictor.costs(np.array([solved.as_seen, start]))
    if after - before <= most_worse:
        return meant(model, solved, sensed, settings)
    apart = se3.difference(solved.pose, start, model.centroid)
    scatter = np.outer(apart, apart)
    xi = se3.difference(sensed.felt.correction, np.eye(4), solved.centre) if hand is None else hand.xi
    return replace(
        solved, pose=start, as_seen=start, xi=xi, scale=0.0,
        covariance=solved.covariance + scatter, independent=solved.independent + scatter,
    )  # fmt: skip


def level_of(solved: JointResult, settings: JointSettings) -> Level:
    """How large shared errors are in a mixture of rigs and of biases, root mean squares.

    Covariances go with squares, so that one rig that has it is as wide as the mixture (the law of total variance).
    """
    of_each = (solved.shares, settings.rigs), (solved.bias_shares, settings.biases)
    rig, bias = (sum(share * one.level**2 for share, one in zip(shares, kinds)) for shares, kinds in of_each)
    return Level(float(np.sqrt(rig)), float(np.sqrt(bias)))


def mean_level(found: Sequence[Level]) -> Level:
    """Of several frames, at least one: as wide as their mixtures (see `level_of`) are on average."""
    squares = np.mean([(one.rig**2, one.bias**2) for one in found], axis=0)
    return Level(*np.sqrt(squares).tolist())


def measurement_of(
    model: ObjectModel,
    solved: JointResult,
    index: int,
    nearest: Array,
    sensed: Sensed,
    blind: bool,
    corrected: bool,
    state: TrackState,
    beliefs: Beliefs,
    settings: TrackSettings,
) -> tuple[Measurement, Untold]:
    """The frame's own answer, the symmetric twin near `nearest` (4, 4), as wide as an estimate's: all of it stays from
    frame to frame but most of the independent noise. Where little is seen of an object that nothing tells from what
    hides it, the next frame's is no better. blind: told by the robot alone, whose error it has, as every frame between
    images has it; corrected: a camera has once said what that is. Beside it what frames do not tell after this one (of
    that index): where evidence is no Gaussian about it (a handle out of sight may turn as far as it would show).
    """
    s, calibration = settings, beliefs.calibration
    by_robot = blind or (state.imaged and sensed.viewed.cloud is None and not len(sensed.looked.pixels))
    gaussian = solved.independent + solved.shared + solved.unsolved
    rows, how = tables.stack(sensed.seen, sensed.felt.rows), s.first.moments
    spread = moments(model, rows, solved.pose, gaussian, 0, None, how)
    told = not blind and (not spread.effective or spread.effective >= how.effective)
    around, at = None, solved.pose
    if sensed.pool is not None and len(sensed.looked.pixels):
        known = spread.covariance if told else gaussian, s.first.told.temper, s.side, s.first.turns
        told_by = by_turns(sensed.pool, solved.pose, solved.as_seen, *known)
        around, at = told_by.left, told_by.pose
    untold = state.untold.learned(model, solved.pose, spread.covariance - gaussian if told else None, around)
    if sensed.pool is not None and not sensed.told_apart:
        picture = sensed.pool.predictor.predict(solved.as_seen[None], s.side)
        # no narrower than its own solution has it: what is counted too little of a frame its neighbours share
        mode = Mode(solved.pose, 1.0, 0.0, gaussian)
        gaussian = as_shown(mode, picture, None, s.first.confidence, least=1.0).covariance
    shared = gaussian - solved.independent
    pose = model.symmetries.nearest(at, nearest)
    if by_robot:
        angle = s.left_angle if corrected else calibration.rotation_sigma
        lever = float(np.linalg.norm(se3.apply(pose, model.centroid[None])[0]))
        distance = float(np.hypot(calibration.translation_sigma, calibration.rotation_sigma * lever))
        distance = s.left_distance if corrected else distance
        shared = shared + np.diag(np.repeat([angle, distance], 3) ** 2)
    measured = Measurement.of(pose, solved.independent, shared, solved.biased, s.noise)
    measured = measured.smeared(state.smear(model, index, pose, s.velocity))
    return replace(measured, hidden=untold.at(model, solved.pose)), untold


def shift(correction: Array, point: Array) -> float:
    """How far a correction (4, 4) moves a point (3,), metres."""
    return float(np.linalg.norm(se3.apply(correction, point[None])[0] - point))


def pixel_of(frame: Frame, point: Array) -> Array | None:
    """(2,) where the image of a frame has a point (3,); None without a camera, and behind it."""
    if frame.camera is None:
        return None
    pixel = frame.camera.project(point[None])[0][0]
    return pixel if np.isfinite(pixel).all() else None


def middle_of(model: ObjectModel, pose: Array) -> Array:
    """(3,) where the centroid of the object at pose (4, 4) is."""
    return np.asarray(se3.apply(pose, model.centroid[None])[0])
