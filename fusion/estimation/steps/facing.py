"""Which way round: what is printed on the object turns each pose to the way that the image shows. Camera frame, metres.

Poses are found and solved modulo the symmetries of the shape; ways round that the shape nearly has (a box scanned with
its dents) are minima of their own, and a start at the wrong one keeps a search there. So before anything is solved the
print is asked about each pose, turned by every symmetry and near symmetry. A start of another face turns with the pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.asked import Asked
from fusion.estimation.search.modes import Found
from fusion.estimation.steps.sense import Sensed
from scenes.errors import InputError
from scenes.evidence import table as tables
from scenes.evidence.align import Prior, costs
from scenes.evidence.modes import Mode
from scenes.evidence.symmetry.near_symmetries import near_symmetries
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.geometry.symmetries import Symmetries
from scenes.recordings.frames import Frame
from vision.picture.predictor import Predictor
from vision.texture import PrintSettings, SeenPrint, see_print

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Facing:
    """What the print says of a pose. share: posterior share of its way round among all that the shape allows, NaN where
    the print says nothing; turn (rad): how sure the turn about the object's own axis is, NaN for an object without one;
    why: in words.
    """

    share: float = float("nan")
    turn: float = float("nan")
    pixels: int = 0
    why: str = ""

    def decides(self, settings: PrintSettings) -> bool:
        """Whether this way round is as good as sure."""
        return bool(self.share >= settings.decides)


@dataclass(frozen=True)
class Faced:
    """The search's modes each turned to its likeliest way round, likeliest first; their gains (k,) in nats; what was
    asked, and the frame's evidence, with a start that has turned with the first.
    """

    found: Found
    gains: Array
    asked: Asked
    sensed: Sensed
    facing: Facing


def why_no_print(sensed: Sensed, settings: PrintSettings) -> str:
    """Why no print is looked at; "" where one is."""
    model, frame = sensed.pool.model, sensed.viewed
    if model.texture is None or not settings.used:
        return "nothing is printed on the mesh"
    if frame.rgb is None or not sensed.pool.predictor.sees:
        return "no colours beside depth"
    return "a ball turns every way" if model.symmetries.is_spherical else ""


def faced(sensed: Sensed, found: Found, asked: Asked) -> Faced:
    """The modes as the print has them; as they were, with the reason, where it says nothing."""
    s, model, pool = asked.settings.texture, sensed.pool.model, sensed.pool
    modes = [mode for mode in found.modes if mode.weight >= asked.settings.plan.negligible] or [found.modes[0]]
    unchanged = np.zeros(len(modes))
    first = see_print(sensed.viewed, model, pool.predictor, modes[0].pose, s)
    if isinstance(first, str):
        return Faced(found, unchanged, asked, sensed, Facing(why=first))
    near = near_symmetries(model)
    shown = [first, *(see_print(sensed.viewed, model, pool.predictor, mode.pose, s) for mode in modes[1:])]
    told = [
        _Ways.silent(mode.pose) if isinstance(seen, str) else _ways(seen, mode.pose, asked.prior, near)
        for seen, mode in zip(shown, modes)
    ]
    # another place may be the object's, which is there another way round
    asked_of = max(range(len(modes)), key=lambda k: told[k].near)
    there = shown[asked_of]
    assert not isinstance(there, str)
    other, doubt = _near(sensed, there, modes[asked_of], told[asked_of], asked), -s.most
    if other is not None and other.more < s.prefers:
        doubt = other.more
        other = None
    if other is not None:
        modes, told = [*modes, other.mode], [*told, other.ways]
    best = max(range(len(modes)), key=lambda k: told[k].best)
    why_not = told[best].why_not
    if why_not:
        return Faced(found, unchanged, asked, sensed, Facing(pixels=len(first.points), why=why_not))
    gains = np.maximum(np.array([one.best for one in told]) - told[best].best, -s.most)
    # another's print tells poses no more apart; a start does
    if_other = np.zeros(len(told))
    if other is not None and asked.prior is not None:
        if_other[-1] = -s.most_start
    gains = np.log(told[best].own * np.exp(gains) + (1.0 - told[best].own) * np.exp(if_other))
    logs = np.log([max(mode.weight, 1e-12) for mode in modes]) + gains
    weights = np.exp(logs - logs.max())
    order = np.argsort(-weights, kind="stable")
    turned = [replace(modes[k], pose=told[k].pose, weight=float(weights[k] / weights.sum())) for k in order]
    lead = told[order[0]]
    if order[0] == asked_of:
        doubt -= 0.0 if asked.prior is None else s.most_start
        lead = replace(lead, share=float(lead.share / (1.0 + np.exp(doubt))))
    before = modes[order[0]].pose if other is None or order[0] < len(modes) - 1 else modes[asked_of].pose
    asked = replace(asked, prior=_turned(asked.prior, before, lead.pose))
    sensed = replace(sensed, pool=replace(pool, prior=asked.prior))
    moved = float(np.rad2deg(se3.rotation_angle(before[:3, :3].T @ lead.pose[:3, :3])))
    way = f"turned by {moved:.0f} degrees" if moved > 1.0 else "the way round that it was"
    why = f"{way}, {lead.share:.0%} of {lead.count} ways; the print explains {lead.explained:.0%} of the image"
    facing = Facing(lead.share, lead.turn, len(first.points), why)
    return Faced(replace(found, modes=tuple(turned)), gains[order], asked, sensed, facing)


def by_print(gains: Array, count: int) -> Array:
    """(count,) nats by which the print speaks for the poses that are solved, of which the first are the modes that it
    was asked about; the others as for the least of these.
    """
    out = np.full(count, float(gains.min(initial=0.0)))
    out[: min(count, len(gains))] = gains[:count]
    return out


def check_print(model: ObjectModel, settings: PrintSettings) -> None:
    """Raises InputError when a print is to count and the mesh has none."""
    if settings.counts and model.texture is None:
        raise InputError(f"print: expected a mesh with colours (of vertices, faces or an image), {model.name} has none")


def by_facing(model: ObjectModel, facing: Facing, word: str, why: str, settings: PrintSettings) -> tuple[str, str]:
    """Verdict and reason, where the way round counts: no `ok` without knowing it."""
    if not settings.counts or word != "ok" or facing.decides(settings):
        return word, why
    if model.symmetries.is_trivial and not len(near_symmetries(model)):
        return word, why
    return "ambiguous", f"the way round is unknown: {facing.why}"


def as_printed(model: ObjectModel, facing: Facing, settings: PrintSettings) -> ObjectModel:
    """The object without the symmetries that its print breaks."""
    return model.with_symmetries(Symmetries.none()) if facing.decides(settings) else model


def unread(facing: Facing) -> tuple[str, ...]:
    """A note on why a print that could have been seen was not."""
    return (facing.why,) if facing.pixels and np.isnan(facing.share) else ()


def turned_as_printed(sensed: Sensed, mode: Mode, facing: Facing, settings: PrintSettings) -> tuple[Mode, Facing]:
    """The answer turned about the object's own axis to where the print has it, and sure of that as far as it is.

    A print that was not found before anything was solved is looked for once more, where the object is now.
    """
    model, missed = sensed.pool.model, bool(unread(facing))
    if not (missed or (model.symmetries.axes and facing.decides(settings))):
        return mode, facing
    seen = see_print(sensed.viewed, model, sensed.pool.predictor, mode.pose, settings)
    if isinstance(seen, str):
        return mode, facing
    if missed:
        ways = _ways(seen, mode.pose, sensed.pool.prior, near_symmetries(model))
        if ways.why_not:
            return mode, facing
        facing = Facing(ways.share, ways.turn, len(seen.points), f"{ways.share:.0%} of {ways.count} ways")
        mode = replace(mode, pose=ways.pose)
        if not (model.symmetries.axes and facing.decides(settings)):
            return mode, facing
    pose, turn = _finest(seen, mode.pose, settings.same)
    axis, rotation = model.symmetries.axes[0], pose[:3, :3]
    along = rotation @ axis.direction
    moves = np.concatenate([along, np.cross(along, rotation @ (model.centroid - axis.point))])
    known = model.symmetries.quotient(rotation, model.centroid)
    covariance = known @ mode.covariance @ known.T + turn**2 * np.outer(moves, moves)
    return replace(mode, pose=pose, covariance=0.5 * (covariance + covariance.T)), replace(facing, turn=turn)


def other_printed(sensed: Sensed, facing: Facing, pose: Array, other: Array, settings: PrintSettings) -> float:
    """How many times as likely the object is at another pose (4, 4) than at its own by what is printed there, whichever
    way round; 1 where no print was read.
    """
    if not facing.pixels or np.isnan(facing.share):
        return 1.0
    model, near = sensed.pool.model, near_symmetries(sensed.pool.model)
    both = [see_print(sensed.viewed, model, sensed.pool.predictor, one, settings) for one in (pose, other)]
    here, there = (None if isinstance(one, str) else _ways(one, at, None, near) for one, at in zip(both, (pose, other)))
    if here is None or there is None:
        return 1.0
    gains = np.array([here.best, there.best])
    own = (here, there)[int(np.argmax(gains))].own
    likely = own * np.exp(np.maximum(gains - gains.max(), -settings.most)) + 1.0 - own
    return float(likely[1] / likely[0])


def as_seen_printed(
    frame: Frame, model: ObjectModel, predictor: Predictor, pose: Array, settings: PrintSettings
) -> tuple[Array, Facing]:
    """A pose (4, 4) turned to the way round that the frame's image shows, and what it shows; as it was where that does
    not decide.
    """
    seen = see_print(frame, model, predictor, pose, settings)
    if isinstance(seen, str):
        return pose, Facing(why=seen)
    ways = _ways(seen, pose, None, near_symmetries(model))
    if ways.why_not:
        return pose, Facing(pixels=len(seen.points), why=ways.why_not)
    why = f"{ways.share:.0%} of {ways.count} ways; the print explains {ways.explained:.0%} of the image"
    facing = Facing(ways.share, ways.turn, len(seen.points), why)
    return (ways.pose if facing.decides(settings) else pose), facing


@dataclass(frozen=True)
class _Ways:
    """The ways round of one pose: the likeliest as a pose, its gain and what else may be (nats), its share among
    `count`, how sure its turn is (rad), how much of the image it explains, and how likely it is the object's own; near:
    the gain (nats) of the likeliest that the shape nearly has, -inf for none.
    """

    pose: Array
    best: float
    share: float
    turn: float
    count: int
    explained: float
    own: float
    why_not: str = ""
    near: float = -np.inf

    @staticmethod
    def silent(pose: Array) -> _Ways:
        """Of a pose whose print is not seen."""
        return _Ways(pose, 0.0, float("nan"), float("nan"), 1, 0.0, 0.0, "its print is not seen")


def _ways(seen: SeenPrint, pose: Array, prior: Prior | None, near: Array) -> _Ways:
    """What a print says of the ways round of a pose (4, 4). near (k, 4, 4): motions that the shape nearly has; such
    ways are none to turn to unless they are fitted, and may be the right ones all the same.
    """
    s, model = seen.settings, seen.model
    exact = pose @ model.symmetry_poses(s.turns)
    at = np.concatenate([exact, pose @ near]) if len(near) else exact
    prints = seen.predicted(at)
    left = seen.left(prints)
    gains = seen.nats(left)
    beside, left_beside = seen.shifted(prints)
    unregistered = bool(beside.max() > s.shift_gain * gains.max() + s.prefers)
    if unregistered and not model.symmetries.axes:
        # no shift makes one face another, as it does one turn: faces are told wherever the print is
        gains, left = beside, left_beside
    known = np.zeros(len(at)) if prior is None else _known(costs(model, tables.empty(), at, prior), s.most_start)
    logs = np.maximum(gains - gains[: len(exact)].max(), -s.most) + known
    lead = int(np.argmax(logs[: len(exact)]))
    best, turn, gain, explained = at[lead], float("nan"), float(gains[lead]), seen.explained(left[lead])
    apart = se3.rotation_angle(np.swapaxes(at[:, :3, :3], -1, -2) @ at[lead, :3, :3])
    another = max((seen.explained(left[k]) for k in np.flatnonzero(apart > s.same)), default=0.0)
    if model.symmetries.axes:
        best, turn = _finest(seen, best, 2.0 * np.pi / s.turns)
        finer = seen.left(seen.predicted(best[None]))
        gain, explained = float(seen.nats(finer)[0]), seen.explained(finer[0])
    why_not = ""
    if explained < s.explained:
        why_not = f"the print is not seen: it explains {explained:.0%} of the image"
    if seen.colours.shape[1] == 3 and explained < s.sure_of_channels:
        swapped = seen.left(prints, swapped=True)
        if seen.nats(swapped, swapped=True).max() - gains.max() > s.prefers:
            why_not = "red and blue of the image seem swapped: the print is not used"
    if unregistered and model.symmetries.axes:
        why_not = "the print is seen beside where depth has it: image and depth may not be registered"
    # where it is another's print, no way round is likelier than the start has it
    own = seen.own(explained, another)
    shares = [np.exp(one - one.max()) for one in (logs, known)]
    by_print, by_start = (float(one[apart <= s.same].sum() / one.sum()) for one in shares)
    share = own * by_print + (1.0 - own) * by_start
    count = len(model.symmetries.discrete) + len(near)
    nearly = float(gains[len(exact) :].max(initial=-np.inf))
    return _Ways(best, gain, share, turn, count, explained, own, why_not, nearly)


def _known(start: Array, most: float) -> Array:
    """(k,) log probability of ways round that cost a start's Gaussian (k,) nats, where that is of another face than the
    object's by odds of `most` nats against it, and of any then.
    """
    likely = np.exp(start.min() - start)
    wrong = 1.0 / (1.0 + np.exp(most))
    return np.asarray(np.log((1.0 - wrong) * likely / likely.sum() + wrong / len(start)))


def _finest(seen: SeenPrint, pose: Array, step: float) -> tuple[Array, float]:
    """The pose (4, 4) turned about the object's own axis to the likeliest place within two steps (rad), and the
    standard deviation (rad) of that.
    """
    s, angle, turn = seen.settings, 0.0, step
    for _ in range(s.halvings):
        tried = angle + step * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
        gains = seen.gains(pose @ _turns(seen.model, tried))
        k = int(np.clip(np.argmax(gains), 1, 3))
        bend = float(2.0 * gains[k] - gains[k - 1] - gains[k + 1])
        angle = float(tried[int(np.argmax(gains))])
        turn = float(np.hypot(step / np.sqrt(max(bend, 1e-3)), 0.25 * step))
        step = 0.5 * step
    return pose @ _turns(seen.model, np.array([angle]))[0], turn


def _turns(model: ObjectModel, angles: Array) -> Array:
    """(k, 4, 4) turns about the object's own axis by angles (k,) rad, object frame."""
    axis = model.symmetries.axes[0]
    out = np.tile(np.eye(4), (len(angles), 1, 1))
    out[:, :3, :3] = se3.exp_rotation(angles[:, None] * axis.direction)
    out[:, :3, 3] = axis.point - out[:, :3, :3] @ axis.point
    return out


@dataclass(frozen=True)
class _Near:
    """A way round that the shape nearly has, fitted to what is seen, its own ways, and by how much the print prefers it
    (nats).
    """

    mode: Mode
    ways: _Ways
    more: float


def _near(sensed: Sensed, seen: SeenPrint, mode: Mode, ways: _Ways, asked: Asked) -> _Near | None:
    """The way round that the shape nearly has and that the print explains best; None where it speaks clearly against
    all of these, or all else does.
    """
    s, pool, model = asked.settings.texture, sensed.pool, sensed.pool.model
    motions = near_symmetries(model)
    if not len(motions):
        return None
    tried = mode.pose @ motions
    gains = seen.gains(tried)
    lead = int(np.argmax(gains))
    if gains[lead] - ways.best < -s.unfitted:
        return None
    free = replace(pool, prior=None)
    fitted = free.compete(tried[lead : lead + 1])[0]
    worse = free.costs(np.array([fitted.pose, mode.pose]))
    if worse[0] - worse[1] > s.most_worse:
        return None
    again = see_print(sensed.viewed, model, pool.predictor, fitted.pose, s)
    if isinstance(again, str):
        return None
    prior = _turned(asked.prior, mode.pose, fitted.pose)
    found = _ways(again, fitted.pose, prior, motions)
    if found.why_not:
        return None
    # gains compare where they are of the same pixels: those of the one pose, and those of the other
    back = float(again.gains(mode.pose @ model.symmetry_poses(s.turns)).max())
    more = 0.5 * (float(gains[lead]) - ways.best + found.best - back)
    weight = mode.weight * float(np.exp(np.clip(worse[1] - worse[0], -20.0, 20.0)))
    fitted = replace(fitted, weight=weight, cost=mode.cost + float(worse[0] - worse[1]))
    return _Near(fitted, replace(found, best=ways.best + more), more)


def _turned(prior: Prior | None, before: Array, after: Array) -> Prior | None:
    """The start of another face, carried along as a pose (4, 4) turns from one face to another."""
    if prior is None:
        return None
    return replace(prior, pose=prior.pose @ se3.inverse(before) @ after)
