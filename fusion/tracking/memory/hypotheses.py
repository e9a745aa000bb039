"""Several poses carried through time until the data decide: delayed decision, as in multiple-hypothesis tracking.

Each hypothesis is refined in every frame and pays what the whole frame says of it (Reid, IEEE TAC 24(6), 1979: the
score of a track is its log likelihood). Frames share most of their errors, so their costs are not simply added: a score
forgets, and a frame counts by a part. New ones come from single frames (fusion.tracking.memory.state); each time that a
frame, searched by itself, surely finds a hypothesis, that is a vote for it, which is not forgotten. Camera frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate, Mode
from fusion.tracking.filter import Belief, block
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Points that stand for the surface when two poses of it are compared.
SURFACE_POINTS = 200


@dataclass(frozen=True)
class HypothesisSettings:
    """How long hypotheses live and what a frame is worth to them. Tuned on sequences of the tuning families (`lab` and
    the same without a hand's model; docs/evaluation.md).
    """

    # Hypotheses carried at most (no unit): each costs about a millisecond a frame.
    most: int = 5
    # Share of a score that the next frame inherits, and the share of a frame's nats that it adds: neighbours in time
    # repeat one another, in the end all frames amount to worth / (1 - memory) = 2.7 independent ones.
    memory: float = 0.85
    worth: float = 0.4
    # Nats of a vote, the most votes that one hypothesis keeps, and the nats that a newcomer begins below the leader.
    vote: float = 3.0
    most_votes: float = 2.0
    birth: float = 1.0
    # Log odds (nats) that a hypothesis keeps from the search, or the start, that it was thought of in, at least and at
    # most. Without, a wall on which a mug of which a third is seen fits as well as where it is led a right track of
    # `stranger` 200 mm away, found there by searches that were 3 to 11 % sure.
    least_odds: float = -6.0
    most_odds: float = 3.0
    # Votes (no unit) without which a leader is not believed, however well it explains every frame: a track that has
    # begun wrong explains itself. An `ok` search gives 0.9 and more; ones that are likely and no more must be three, or
    # two and repeated: with one and repeated (0.55) a track of `stranger` that begins wrong was `ok` 14 mm off.
    believed: float = 0.7
    # And votes (no unit) of another that suffice for it to lead where nothing tells what hides the object, however many
    # more the leader has.
    enough: float = 0.5
    # Probability (no unit) at most that such a leader is right: of four sequences of `lab` that stayed so, two were.
    unvoted: float = 0.6
    # And the confidence (a probability, no unit) that its answers state at most: of 544 such answers in 29 sequences of
    # `stranger`, `visitor` and `borrowed` (seeds 9 to 11) 67, 78, 85 and 98 % are right of those that would state 0.3,
    # 0.6, 0.8 and 0.9 and more, and a track that begins wrong explains itself: none states what `ok` needs.
    unvoted_told: float = 0.85
    # A search that is not sure, but this likely (a probability, no unit), gives this part of a vote to what it finds,
    # and takes none from the others: where each frame leaves several poses open, the same one again is worth something.
    likely: float = 0.75
    # And one this likely (a probability, no unit) a whole one, as an `ok` one has: the limit of that.
    sure: float = 0.95
    part: float = 0.3
    # A search that is not even that gives this share of a vote to a hypothesis that was there before, up to so many in
    # all: searches that are wrong seldom agree with one another, but what makes one wrong may make the next wrong, too,
    # so that they never suffice to be believed, nor do they with one that is likely. Nor does a search around the
    # track, which brings nothing to more than that, whatever it had: what it finds 15 mm off was, in one sequence of
    # `lab`, near what the track had, 15 mm off, too; and one after a repeated one had a drill of `stranger` `ok` 18 mm
    # off.
    repeated: float = 0.25
    most_repeated: float = 0.39
    # A search speaks for every hypothesis that puts the surface where it does, within this (m, on average: half of what
    # an answer may be off), whichever way a handle out of sight points.
    surface: float = 0.0025
    # and against those alone that put it this far elsewhere (m, on average), which is what it is sure of: a hammer's
    # head turned over is 2 mm off, and a search that has it the wrong way round is as sure as another.
    elsewhere: float = 0.005
    # Nats of a frame in which something may hide the object that neither a mask nor a hand's model tells of: this share
    # of what its predicted picture and its contacts cost, and this many for a unit of log odds that the pose is right
    # (`chances`). Unknown fingers are covered gladly by a wrong pose, and tell on it by running on
    # beyond its outline: of six pairs of the right pose and the search's wrong one the former cost less in three and
    # had better odds in all.
    of_cost: float = 0.25
    of_odds: float = 3.0
    # Share of the nats between two that put the surface in one place, whichever way round: what tells them apart is
    # smaller than what the mesh is off, or the camera's bias, which all frames have. So that all frames together (2.7)
    # count for the half that a single one has of it (EstimateSettings.told).
    of_ways: float = 0.19
    # Share of the weight of what a search found first that the track's own way round must have in it, for others of the
    # same surface to be no news: the track has known until now which it is, and things do not turn over unseen. By
    # judgement.
    open_way: float = 0.05
    # Nats by which a frame must prefer what the track has to what it itself has found when searched, so that its search
    # has only missed it, and does not speak against it. Where it does not, and is elsewhere, the leader loses this part
    # of a vote, 1.4 nats: in 26 sequences of the tuning families 17 of 31 searches of tracks that were wrong came out
    # so, and 8 of 80 of tracks that were right.
    missed: float = 8.0
    doubted: float = 0.45
    # A hypothesis of less than this share of the weight is dropped once it is so many frames old.
    least: float = 0.002
    trial: int = 4
    # Nats by which another must be ahead before it leads: noise alone does not turn the answer to and fro.
    ahead: float = 1.0
    # Two poses nearer to each other than this share of the object's radius (largest displacement of its surface), or
    # than so many standard deviations of theirs, are one.
    together: float = 0.12
    sigmas: float = 3.0


@dataclass(frozen=True)
class Hypothesis:
    """pose (4, 4) camera_from_object; covariance (6, 6) about the centroid; score: accumulated nats, higher is
    likelier, up to a constant that all share; votes: frames that surely found it by themselves; age: frames; odds: nats
    for how likely it was when it was thought of, which are not forgotten; felt: as score, of frames without an image
    that come between images, of which many say the same: they take no part of what images have said.
    """

    pose: Array
    covariance: Array
    score: float
    votes: float = 0.0
    age: int = 0
    odds: float = 0.0
    felt: float = 0.0


Hypotheses = tuple[Hypothesis, ...]


def of_modes(
    model: ObjectModel, modes: Sequence[Mode], votes: float, settings: HypothesisSettings, odds: float = 0.0
) -> Hypotheses:
    """Hypotheses of an estimate's modes, first one first; it has the votes, and so has every other that puts the
    surface where it does: a frame is sure of that, and says by the modes' weights which way round it is.
    """
    kept = modes[: settings.most]
    near = [k == 0 or surface_apart(model, m.pose, kept[0].pose) < settings.surface for k, m in enumerate(kept)]
    return tuple(
        Hypothesis(m.pose, m.covariance, float(np.log(max(m.weight, 1e-9))), votes if same else 0.0, odds=odds)
        for m, same in zip(kept, near)
    )


def sure_of(answer: Estimate) -> float:
    """Confidence of an answer; of one that does not say, its first mode's weight."""
    return answer.confidence if np.isfinite(answer.confidence) else answer.modes[0].weight


def vote_of(verdict: str, sure: float, settings: HypothesisSettings) -> float:
    """What a frame searched by itself is worth to what it has found, by its verdict and confidence: one that is as sure
    as an `ok` one of the surface, and not which way round it is, speaks for what has the surface there.
    """
    if verdict == "ok" or (verdict == "ambiguous" and sure >= settings.sure):
        return max(0.0, 2.0 * sure - 1.0)
    return settings.part if verdict == "ambiguous" and sure >= settings.likely else 0.0


def log_odds(sure: float, settings: HypothesisSettings) -> float:
    """Nats of a confidence (a probability)."""
    sure = float(np.clip(sure, 1e-3, 1.0 - 1e-3))
    return float(np.clip(np.log(sure / (1.0 - sure)), settings.least_odds, settings.most_odds))


def moved(hypotheses: Hypotheses, motion: Array) -> Hypotheses:
    """The same after a rigid motion (4, 4) of the object, whichever of them it is."""
    turn = block(motion[:3, :3])
    return tuple(replace(h, pose=motion @ h.pose, covariance=turn @ h.covariance @ turn.T) for h in hypotheses)


def strengths(hypotheses: Hypotheses, settings: HypothesisSettings) -> Array:
    """(n,) nats of scores, votes and odds, the greatest 0."""
    nats = np.array([h.score + h.felt + settings.vote * h.votes + h.odds for h in hypotheses])
    return np.asarray(nats - nats.max(initial=-np.inf))


def weights(hypotheses: Hypotheses, settings: HypothesisSettings) -> Array:
    """(n,) shares of the posterior."""
    share = np.exp(strengths(hypotheses, settings))
    return np.asarray(share / share.sum())


def weighed(
    hypotheses: Hypotheses,
    found: Sequence[Array],
    costs: Array,
    settings: HypothesisSettings,
    told_apart: bool = True,
    between: bool = False,
) -> Hypotheses:
    """After a frame: refined poses found, n of (4, 4), and their costs (n,) in nats of the whole frame. The leader is
    first; it stays the leader until another is clearly ahead, and, where nothing tells what hides the object
    (told_apart), until searches speak for another as much as for it. between: a frame without an image that comes
    between images; fingers alone take the lead from none that was seen.
    """
    scores = np.array([settings.memory * (h.felt if between else h.score) for h in hypotheses]) - settings.worth * costs
    scores -= scores.max()
    aged = [replace(h, pose=pose, age=h.age + 1) for h, pose in zip(hypotheses, found)]
    told = zip(aged, scores.tolist())
    after = tuple(replace(h, felt=score) if between else replace(h, score=score) for h, score in told)
    ahead = strengths(after, settings)
    may = [told_apart or h.votes >= min(settings.enough, hypotheses[0].votes) for h in hypotheses]
    best = int(np.argmax(np.where(may, ahead, -np.inf)))
    if between or ahead[best] - ahead[0] < settings.ahead:
        best = 0
    order = [best, *(int(i) for i in np.argsort(-ahead, kind="stable") if i != best)]
    return tuple(after[i] for i in order)


def ways_of(model: ObjectModel, hypotheses: Hypotheses, settings: HypothesisSettings) -> list[int]:
    """Which hypotheses, but the first, put the surface where the first does, another way round."""
    first = hypotheses[0].pose
    return [k for k, h in enumerate(hypotheses) if k and surface_apart(model, h.pose, first) < settings.surface]


def as_ways(model: ObjectModel, found: Sequence[Array], nats: Array, settings: HypothesisSettings) -> Array:
    """Costs (n,) of a frame as they count of poses found, n of (4, 4): of those that put the surface where the first
    has it, another way round, by a part of what they differ from it.
    """
    near = [k > 0 and surface_apart(model, pose, found[0]) < settings.surface for k, pose in enumerate(found)]
    return np.where(near, nats[0] + settings.of_ways * (nats - nats[0]), nats)


def without_news(
    model: ObjectModel, modes: tuple[Mode, ...], hypotheses: Hypotheses, settings: HypothesisSettings
) -> tuple[Mode, ...]:
    """Modes of a frame searched by itself without ways round that nobody has thought of, where it leaves open that the
    object is as the leader has it: that is first of those with its surface, and what a track has known stays known.
    """
    leader, s = hypotheses[0], settings
    near = [surface_apart(model, m.pose, leader.pose) < s.surface for m in modes]
    own = [at_it and alike(model, leader, m, s) for m, at_it in zip(modes, near)]
    most = max((m.weight for m, at_it in zip(modes, near) if at_it), default=0.0)
    if not near[0] or not any(its and m.weight >= s.open_way * most for m, its in zip(modes, own)):
        return modes
    thought_of = [its or any(alike(model, h, m, s) for h in hypotheses[1:]) for m, its in zip(modes, own)]
    kept = [k for k in range(len(modes)) if not near[k] or thought_of[k]]
    return tuple(modes[k] for k in sorted(kept, key=lambda k: not own[k]))


def with_ways(
    model: ObjectModel, begun: Hypotheses, before: Hypotheses, expected: Array, settings: HypothesisSettings
) -> Hypotheses:
    """Hypotheses `begun` anew where a track was lost, with the ways round that it had left open `before`: of those that
    put the surface where the leader did, moved as the one that is turned most like the newly found; expected (4, 4):
    where the leader would be now.
    """
    if not before:
        return begun
    first, back = begun[0], se3.inverse(before[0].pose)
    ways = [0, *ways_of(model, before, settings)]
    turned = [expected @ back @ before[k].pose for k in ways]
    by = [np.linalg.norm(se3.difference(first.pose, pose, model.centroid)[:3]) for pose in turned]
    same = int(np.argmin(by))
    moved_by, out = first.pose @ se3.inverse(turned[same]), list(begun)
    for k, pose in zip(ways, turned):
        beside = replace(before[k], pose=moved_by @ pose, covariance=first.covariance)
        if not any(alike(model, beside, one, settings) for one in out):
            less = before[k].score - before[ways[same]].score
            out.append(replace(beside, score=first.score + less, votes=first.votes, odds=first.odds, age=0))
    return tuple(out[: settings.most])


def leading(hypotheses: Hypotheses, belief: Belief) -> Hypotheses:
    """Hypotheses, at least one, the first of them as it is believed."""
    return replace(hypotheses[0], pose=belief.pose, covariance=belief.covariance), *hypotheses[1:]


def sifted(model: ObjectModel, hypotheses: Hypotheses, settings: HypothesisSettings) -> Hypotheses:
    """Without those that have become one with a better one, and those that the data have refused."""
    share = weights(hypotheses, settings)
    kept: list[Hypothesis] = []
    for h, part in zip(hypotheses, share):
        twin = next((k for k, other in enumerate(kept) if alike(model, h, other, settings)), None)
        if twin is not None:
            one = kept[twin]
            kept[twin] = replace(one, votes=max(one.votes, h.votes), odds=max(one.odds, h.odds))
        elif not kept or part >= settings.least or h.age < settings.trial:
            kept.append(h)
    return tuple(kept[: settings.most])


def alike(model: ObjectModel, one: Hypothesis | Mode, other: Hypothesis | Mode, settings: HypothesisSettings) -> bool:
    """Whether two poses are one, modulo the object's symmetries: near each other, or as near as they are known, and the
    surface not elsewhere, however little either knows. Else a search that finds the object far from a track which
    leaves that open would speak for where the track has it.
    """
    delta = se3.difference(model.symmetries.nearest(one.pose, other.pose), other.pose, model.centroid)
    apart = float(np.linalg.norm(delta[:3]) * model.radius + np.linalg.norm(delta[3:]))
    if apart >= settings.together * model.radius:
        square = float(delta @ np.linalg.solve(one.covariance + other.covariance, delta))
        if square >= settings.sigmas**2:
            return False
    return surface_apart(model, one.pose, other.pose) < settings.elsewhere


def doubted(hypotheses: Hypotheses, settings: HypothesisSettings, sure: float = 1.0) -> Hypotheses:
    """The same after a frame that has what its search found elsewhere, this sure, as gladly as the leader."""
    leader = hypotheses[0]
    less = min(settings.doubted, -float(np.log(max(1.0 - sure, 1e-9))) / settings.vote)
    return replace(leader, votes=max(0.0, leader.votes - less)), *hypotheses[1:]


def surface_apart(model: ObjectModel, one: Array, other: Array) -> float:
    """Mean distance (m) of the surface at pose `one` (4, 4) from the surface at `other`: ADD-S, by the lattice."""
    points = se3.apply(se3.inverse(other) @ one, model.sample_surface(SURFACE_POINTS)[0])
    return float(np.abs(model.field.distance(points)).mean())


def may_both_be(model: ObjectModel, one: Array, other: Array) -> bool:
    """Whether an object at pose `one` (4, 4) and another like it at `other` leave each other room: what the image shows
    there it may show of both. Poses that overlap exclude each other.
    """
    points = se3.apply(se3.inverse(other) @ one, model.sample_surface(SURFACE_POINTS)[0])
    return bool(model.field.distance(points).min() > 0.0)


def voted(
    model: ObjectModel,
    hypotheses: Hypotheses,
    modes: Sequence[Mode],
    vote: float,
    against: bool,
    settings: HypothesisSettings,
    odds: float = 0.0,
    most: float | None = None,
) -> tuple[Hypotheses, bool]:
    """Hypotheses, at least one, after a frame searched by itself has found modes; whether it agrees with the leader.

    vote: of this search, 0 when it tells nothing by itself; against: whether it also speaks against the others. Modes
    that nobody had thought of begin a little below the leader, and by odds (nats) above it, which they keep: from there
    what is sensed decides. most: votes up to which this search may bring one in all, default what one keeps.
    """
    s, out = settings, list(hypotheses)
    most = s.most_votes if most is None else most
    base, first = out[0].score, 0
    for rank, mode in enumerate(modes):
        at = next((k for k, h in enumerate(out) if alike(model, mode, h, settings)), None)
        if at is None:
            below = settings.birth - float(np.log(max(mode.weight, 1e-9)))
            out.append(Hypothesis(mode.pose, mode.covariance, base - below, odds=odds, felt=out[0].felt))
            at = len(out) - 1
        elif rank == 0 and at > 0:
            out[at] = replace(out[at], odds=max(out[at].odds, odds))
        if rank == 0:
            first = at
    off = [0.0 if k == first else surface_apart(model, h.pose, modes[0].pose) for k, h in enumerate(out)]
    near = [apart < s.surface for apart in off]
    if vote > 0.0:
        for k, h in enumerate(out):
            change = vote if near[k] else -vote * (against and off[k] >= s.elsewhere)
            out[k] = replace(h, votes=float(np.clip(h.votes + change, 0.0, max(h.votes, most))))
    elif first < len(hypotheses) and out[first].age > 0:
        more = max(out[first].votes, min(out[first].votes + s.repeated, s.most_repeated))
        out[first] = replace(out[first], votes=more)
    # the newest is not dropped for want of room: the weakest of the older ones is
    while len(out) > settings.most:
        nats = strengths(tuple(out), settings)
        weakest = min((k for k in range(1, len(out)) if k != first), key=lambda k: float(nats[k]), default=first)
        out.pop(weakest)
        first -= int(weakest < first)
    return tuple(out), near[0]
