"""Whether another thing in the image shows the object as well: the second of two cans on a table.

A search without a start ends in one of them, and all that is asked of the answer says yes: it explains what is seen
there, and all around it is worse. Which of the two is meant nothing tells. So where nobody says what hides the object,
and nothing is felt of it, the pixels that the answer leaves over are searched at a glance, each piece of the image by
itself, and what is found there and costs hardly more, or is as clear as an answer is, is a hypothesis of its own. A
hand that is known tells which is meant, the one that it holds, but a search may end in what stands beside, of which
more is seen: it is asked the same where it is clear of the answer, or much of what is at it is left over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.posterior.confidence import ConfidenceSettings, chances
from fusion.estimation.search.pool import Pool
from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from vision.look.looked import surface_rows

Array = NDArray[np.float64]
Others = tuple[tuple[Mode, float], ...]


@dataclass(frozen=True)
class AnotherSettings:
    """What else is like the answer. By judgement, but for `as_likely` and `clear`."""

    # Pixels this near to the answer's surface are its own: a share of the object's radius, and metres at least.
    own_share: float = 0.1
    own: float = 0.005
    # Poses that are fitted, the best of what each piece proposes.
    fitted: int = 3
    # Places beside them at which the likeliest pose is fitted, too: of a row of copies each may be meant, and ways
    # round of the nearest would take the room of all.
    places: int = 4
    # Poses that are tried where a hand is known, by it and by many pairs of pixels.
    of_hand: int = 20
    # Nats that it may cost more than the answer, which was searched with care: of 13 copies beside an object in packed
    # scenes of another generator the farthest cost 6.8 more, of other things beside answers that were right and `ok`
    # there the nearest 7.8; no right answer of the tuning families, which have no copies, has another by this.
    as_likely: float = 7.5
    # Or nats that it costs itself, at most: what is half hidden earns less than what is not. Copies in another
    # generator's scenes of two cost -22.9 at most, other things beside 58 answers of the tuning families -17.4 at
    # least; half of these answers themselves less than -25.
    clear: float = -20.0
    # Chance of being right (no unit) that it would be given, were it the answer: from here on.
    least: float = 0.5
    # A hand holds what is this near to its surface (m), as masks have it, and not what is as much farther off; what it
    # holds is so many times as likely meant as what it does not: most that is asked about with a hand is held by it.
    held: float = 0.015
    as_held: float = 100.0
    # Weight of one beside an answer from which on it is looked for without what is at the answer.
    meant: float = 0.95


def why_no_other(pool: Pool, doubted: bool, masked: bool) -> str:
    """Why no other thing like the answer need be looked for; "" where it must, or, beside a hand that is known, may.
    doubted: the answer is not sure by itself; masked: a mask says which pixels are the object's.
    """
    if doubted:
        return "the answer is in doubt"
    if pool.prior is not None:
        return "a start says which is meant"
    if pool.contacts:
        return "it is felt where it is"
    return "a mask says which is meant" if masked and pool.predictor.told_apart else ""


def another_meant(modes: Sequence[Mode], settings: AnotherSettings | None = None) -> bool:
    """Whether a mode beside an answer's first is surely the object that is meant, and not the first."""
    s = settings or AnotherSettings()
    return len(modes) > 1 and modes[1].weight >= s.meant and modes[0].weight < 1.0 - s.meant


def by_hand(pool: Pool, pose: Array, other: Array, settings: AnotherSettings | None = None) -> float:
    """How many times as likely the object is at another pose (4, 4) than at its own because a hand that is known holds
    it there and not here, or here and not there; 1 where that does not part them.
    """
    s = settings or AnotherSettings()
    if pool.held is None or not pool.predictor.told_apart:
        return 1.0
    here, there = (pool.held.gap(pool.model, one) for one in (pose, other))
    if there < s.held and here - there > s.held:
        return s.as_held
    return 1.0 / s.as_held if here < s.held and there - here > s.held else 1.0


def is_clear(pool: Pool, pose: Array, settings: AnotherSettings | None = None) -> bool:
    """Whether a hand that is known is clear of the object at pose (4, 4)."""
    if pool.held is None or not pool.predictor.told_apart:
        return False
    return pool.held.gap(pool.model, pose) > (settings or AnotherSettings()).held


def others(
    pool: Pool, modes: tuple[Mode, ...], confident: ConfidenceSettings, settings: AnotherSettings | None = None
) -> Others:
    """What is elsewhere, by the answer's other modes or by what the first leaves over in the image, and might be the
    answer: modes at different places with a weight of 1 and a cost beside the answer's, each with the chance of being
    right that it would be given by what is seen, were it the answer, the largest first. Empty where nothing is about as
    likely, by what is seen and by what a hand holds.
    """
    s, model, first = settings or AnotherSettings(), pool.model, modes[0]
    own = max(s.own, s.own_share * model.radius)
    poses = np.concatenate([np.array([mode.pose for mode in modes]), _glanced(pool, first.pose, own)])
    if pool.predictor.told_apart:
        poses = np.concatenate([poses, _at_hand(pool, first.pose, own, s)])
    poses = poses[_elsewhere(pool, poses, first.pose)]
    ends = pool.compete(poses, s.fitted) if len(poses) else ()
    if ends:  # ways round of one of them may be all that was fitted
        left = _places(pool, poses, [end.pose for end in ends], s.places)
        ends = (*ends, *(pool.compete(left, s.places) if len(left) else ()))
    here = float(pool.costs(first.pose[None])[0])
    found: list[tuple[Mode, float]] = []
    for end in ends:
        more = end.cost - here
        odds = by_hand(pool, first.pose, end.pose, s)
        less = max(0.0, float(np.log(odds)))  # what a hand holds may earn so much less, most of it being hidden
        unlikely = more > s.as_likely + less and end.cost > s.clear + less
        if unlikely or not _elsewhere(pool, end.pose[None], first.pose)[0]:
            continue
        one, picture = (replace(end, weight=1.0, cost=first.cost + more),), pool.predictor.predict(end.pose[None])
        chance = chances(model, one, picture, (), 0.0, confident, pool.prior is None)[0]
        if chance * odds >= s.least * (1.0 - chance + chance * odds):
            found.append((one[0], chance))
    kept: list[tuple[Mode, float]] = []
    for mode, chance in sorted(found, key=lambda each: -each[1]):
        if all(_elsewhere(pool, mode.pose[None], other.pose)[0] for other, _ in kept):
            kept.append((mode, chance))
    return tuple(kept)


def with_others(
    model: ObjectModel, modes: tuple[Mode, ...], right: float, there: Others, printed: Sequence[float] | Array = ()
) -> tuple[tuple[Mode, ...], float]:
    """Modes with others after the first, in place of those where they are, and the chance that the first is right: it
    had `right` by itself, each of them its own, and one of all at most is the object that is meant. printed: how many
    times as likely each is than the first by what is printed on it, or by who holds it.
    """
    odds = right / max(1.0 - right, 1e-6)
    against = np.array([chance / max(1.0 - chance, 1e-6) for _, chance in there])
    against *= np.array(printed) if len(printed) else 1.0
    all_of_them = float(against.sum())
    shares = against / max(odds + all_of_them, 1e-12)
    places = [other.pose for other, _ in there]
    away = [all(_apart(model, mode.pose[None], at)[0] > model.radius for at in places) for mode in modes[1:]]
    kept = [modes[0], *(mode for mode, is_away in zip(modes[1:], away) if is_away)]
    whole = max(sum(mode.weight for mode in kept), 1e-12)
    rest = tuple(replace(mode, weight=(1.0 - float(shares.sum())) * mode.weight / whole) for mode in kept)
    likelier = np.argsort(-shares, kind="stable")
    beside = tuple(replace(there[k][0], weight=float(shares[k])) for k in likelier)
    return (rest[0], *beside, *rest[1:]), odds / (1.0 + odds + all_of_them)


def _places(pool: Pool, poses: Array, known: list[Array], most: int) -> Array:
    """(n, 4, 4) the likeliest of poses (k, 4, 4) at each of at most so many places where none of `known` is."""
    left, best = poses, np.zeros((0, 4, 4))
    for pose in known:
        left = left[_elsewhere(pool, left, pose)]
    at = pool.costs(left) if len(left) else np.zeros(0)
    while len(left) and len(best) < most:
        first = left[int(np.argmin(at))]
        best = np.concatenate([best, first[None]])
        away = _elsewhere(pool, left, first)
        left, at = left[away], at[away]
    return best


def _glanced(pool: Pool, pose: Array, own: float) -> Array:
    """(n, 4, 4) poses that a few pairs of pixels propose, of the image and of each piece of it by itself, without the
    pixels within `own` (m) of the surface at pose (4, 4).
    """
    found = [np.zeros((0, 4, 4))]
    for pixels in (pool.looked.pixels, *pool.looked.pieces):
        off = np.abs(pool.model.field.distance(se3.apply(se3.inverse(pose), pixels.points)))
        left = replace(pool.looked, pixels=pixels.take(np.flatnonzero(off > own)))
        rest = replace(pool, looked=left, rng=pool.rng.spawn(1)[0])
        found.append(rest.glanced(surface_rows(left, pool.depth, pool.rows)))
    return np.concatenate(found)


def _at_hand(pool: Pool, pose: Array, own: float, settings: AnotherSettings) -> Array:
    """(n, 4, 4) the most promising poses by a hand that is known, and by many pairs of the pixels that are not within
    `own` (m) of the surface at pose (4, 4): fingers hide most of what they hold.
    """
    off = np.abs(pool.model.field.distance(se3.apply(se3.inverse(pose), pool.looked.pixels.points)))
    left = replace(pool.looked, pixels=pool.looked.pixels.take(np.flatnonzero(off > own)))
    rest = replace(pool, looked=left, rng=pool.rng.spawn(1)[0])
    both = np.concatenate([pool.held_starts(), rest.paired()])
    both = both[_elsewhere(pool, both, pose)]
    return pool.sifted(both)[: settings.of_hand] if len(both) else both


def _elsewhere(pool: Pool, poses: Array, pose: Array) -> NDArray[np.bool_]:
    """Which of poses (n, 4, 4) have the object's middle at least its radius beside where pose (4, 4) has it."""
    return _apart(pool.model, poses, pose) > pool.model.radius


def _apart(model: ObjectModel, poses: Array, pose: Array) -> Array:
    """(n,) metres from the object's middle at poses (n, 4, 4) to where pose (4, 4) has it."""
    away = poses[:, :3, :3] @ model.centroid + poses[:, :3, 3] - se3.apply(pose, model.centroid[None])
    return np.asarray(np.linalg.norm(away, axis=1))
