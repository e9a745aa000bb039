"""What a frame does not need is not done: searches that may end early, and what their answers must explain first.

A search from many starts looks at a few of them first. When those agree on one minimum, and that minimum explains what
was seen and felt to within its noise, more starts can only find what explains it no better, and are not looked at.

Blur that opens a wide basin also levels what tells poses apart in it: a mug turns freely until its handle is sharp, and
all starts slide into one place of that valley. So the valleys of the blurred cost are walked from the best minimum, and
each step goes down without blur.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Alignment, AlignSettings, Prior, align, terms
from scenes.evidence.modes import Mode, ModeSettings, covariance_of, displaced, distinct_modes, weighed
from scenes.evidence.search import SETTLED, SearchStage, leaders, search, thin
from scenes.evidence.symmetry.near_symmetries import near_symmetries
from scenes.evidence.table import SIGMA, TOUCH, VISION, Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Refinement with all rows: a step of 0.1 mrad and 10 micrometres is a hundredth of what a frame tells.
REFINED = AlignSettings(iterations=30, tolerance_angle=1e-4, tolerance_distance=1e-5)


@dataclass(frozen=True)
class Care:
    """How much is spent on minima that may be new. Tuned on generated captures."""

    # Poses nearer to each other than this share of the distance at which modes are one go on as one.
    together: float
    # Of those that differ so many, the best first, are refined with all rows.
    refined: int
    # Rows that valleys are walked with: all steps, and those of them that stayed apart.
    valley_rows: tuple[int, int]


@dataclass(frozen=True)
class PlanSettings:
    """When a search may end early. Tuned on generated captures."""

    # Off: every stage looks at everything.
    skipping: bool = True
    # Starts looked at first. A minimum as wide as a tenth of the prior is missed by all of them with 3 %.
    first_starts: int = 32
    # Where each round of starts ends when the one before leaves a doubt; after the last, all that there are.
    rounds: tuple[int, ...] = (20, 96)
    # Share of these that must end in the best minimum: a search from a prior usually finds two or three others.
    agreeing: float = 0.3
    # Least share of the object's pixels, and of the contacts, within three sigmas of the surface.
    explained_pixels: float = 0.85
    explained_contacts: float = 0.75
    # Around a prior few minima compete; where nothing is known, many do, some of them alike.
    near: Care = Care(0.5, 4, (80, 160))
    wide: Care = Care(0.25, 6, (160, 160))
    # Of poses nearer to each other than this share of that distance the best goes on from pass to pass.
    passes_together: float = 0.25
    # Minima of a search that are refined with all rows, the best first: all that a search keeps; and fewer where a
    # tolerance is asked for and vision alone may do: three led to the answer in every easy frame of `bench skipping`.
    refined: int = 24
    tolerant: int = 3
    # Rows of vision with which minima are refined that the predicted picture is going to fit and judge.
    refining_rows: int = 200
    # Most that a pose may cost for what the camera saw past it and what must hide it (negative log likelihood, see
    # vision.sight): 12 are an object all hidden, 16 a half hidden one of which 6 % were seen past.
    past: float = 16.0
    # Pixels below which vision cannot speak for an answer alone.
    least_pixels: int = 60
    # Modes below this share of the posterior are not solved jointly with calibration and bias: they cannot win.
    negligible: float = 1e-3
    # Poses that are solved beside the modes where no picture judges, and the share of the distance at which modes are
    # one that they are apart. With contacts alone, refining from the truth ended lower in 26 of 272 answers of tuning
    # families without these, in 8 with 16, in 7 with 32; without a start more help (see ProposalSettings.wide).
    beside: int = 40
    beside_together: float = 0.25
    # The same where a picture judges and the best is in doubt: so many poses, and nats that they may cost more than the
    # best before calibration is solved for. Of 1804 answers to frames of tuning families (fused and vision, with start
    # and without) 1446 are right without, 1461 with 4 within 3 nats and with 6 within 6, 1465 with 12 within 4; means
    # of their time are 1 to 6 % more, 2 to 9 and 3 to 15.
    also: int = 4
    also_within: float = 3.0
    # How often very many pairs of pixels are drawn again where nobody says which are the object's, nothing is felt, and
    # the best is in doubt: of 29 cluttered desks of another generator's 24 are right without, 28 with 2, as many of 29
    # tables; the mean of their time is 16 % more. With 1, and a second search where that leaves a doubt, of 125 such
    # answers to frames of five tuning families 88 are right, with 2 alone 84, in as much time on average.
    drawn_again: int = 1
    # Confidence (no unit) below which an answer that is not `ok`, and to which something is seen, is searched for
    # once more, from other draws; 0: none is. Of 45 such answers of both senses to frames of two tuning families 22
    # were right and 28 are, 7 missed what refining from the truth finds and 3 do; of 67 of vision with a start 34 and
    # 35, 9 and 7. Of 100 that are surer 90 were right, and 91 would be: most of those show too little of the object
    # (`VerdictSettings.most_doubted`), which no search changes.
    anew: float = 0.8
    # Valleys: directions in which the blurred cost lets a point at the object's radius move by this share of it (one
    # standard deviation). Of these the widest are walked, both ways, by so many standard deviations.
    valley_share: float = 0.1
    valleys: int = 2
    valley_steps: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0)
    # Longest of these steps, radians and shares of the radius: farther is another basin, which the starts cover.
    longest_step: float = 1.2


@dataclass(frozen=True)
class Found:
    """Modes of a search after refinement with all rows; starts looked at; why no more were, or what was doubted. also:
    poses (4, 4) that are solved with them, however unlikely they seem before calibration is solved for. early: whether
    sources were not asked, where nothing is known, because the best was convincing. left: all that a search by the
    whole objective ended with, what was merged in `modes` as well; None of one by rows alone.
    """

    modes: tuple[Mode, ...]
    looked_at: int
    why: str
    also: tuple[Array, ...] = ()
    early: bool = False
    left: Alignment | None = None


def find_modes(
    model: ObjectModel,
    rows: Evidence,
    starts: Array,
    stages: tuple[SearchStage, ...],
    prior: Prior | None,
    rank: Callable[[Array, float], Array],
    settings: PlanSettings,
    mode_settings: ModeSettings,
    refining_rows: int | None = None,
) -> Found:
    """Search from a few starts, and from the rest only when those leave a doubt.

    starts (n, 4, 4), the likeliest first or in random order; rank(poses, blur) -> (n,) costs beyond the rows', in
    the same units. refining_rows: of vision, with which minima are refined; default all. Modes are camera_from_object.
    """
    few = settings.first_starts if settings.skipping and prior is not None else 0
    merged = mode_settings.merge_share * model.radius
    care = settings.wide if prior is None else settings.near
    doubt = ""
    fine = rows if refining_rows is None else thin(rows, refining_rows)
    if 0 < few < len(starts):
        poses, standing = starts[:few], np.ones(few, dtype=np.float64)
        for stage in stages:
            how = AlignSettings(blur=stage.blur, blur_normal=stage.blur_normal, iterations=stage.iterations)
            rough = align(model, thin(rows, stage.rows), poses, prior, how)
            order = np.argsort(rough.costs + rank(rough.poses, stage.blur), kind="stable")
            chosen, group = leaders(model, rough.poses[order], care.together * merged)
            poses, standing = rough.poses[order[chosen]], np.asarray(np.bincount(group, standing[order]))
        agreeing = float(standing[displaced(model, poses, poses[0]) < merged].sum()) / few
        first, past = _refined(model, fine, poses[: care.refined], prior, rank)
        doubt = doubt_of(model, rows, first, past, agreeing, settings)
        if not doubt:
            first = _with_valleys(model, fine, first, stages[0], prior, rank, settings, mode_settings)
            modes = distinct_modes(model, first, mode_settings)
            return Found(modes, few, "the first agree and explain what was sensed")
    found = search(
        model, rows, starts, stages, prior, rank=rank, apart=settings.passes_together * merged, settled=SETTLED
    )
    chosen, _ = leaders(model, found.poses, care.together * merged)
    refined, _ = _refined(model, fine, found.poses[chosen[: settings.refined]], prior, rank)
    refined = _with_valleys(model, fine, refined, stages[0], prior, rank, settings, mode_settings)
    modes = distinct_modes(model, refined, mode_settings)
    ends = refined.joined(found)
    also = _beside(model, ends, modes, settings, mode_settings) if refining_rows is None else ()
    return Found(modes, len(starts), doubt, also)


def _beside(
    model: ObjectModel,
    ends: Alignment,
    modes: tuple[Mode, ...],
    settings: PlanSettings,
    mode_settings: ModeSettings,
) -> tuple[Array, ...]:
    """Poses (4, 4) where a search ended that are as good as modes of their own, the best first, and were counted to
    another: when calibration is solved for, too, contacts that fell on one face may fall on another.
    """
    if not modes:
        return ()
    good = np.flatnonzero(ends.costs < modes[0].cost + mode_settings.cost_margin)
    order = good[np.argsort(ends.costs[good], kind="stable")]
    both = np.concatenate([np.array([mode.pose for mode in modes]), ends.poses[order]])
    chosen, _ = leaders(model, both, settings.beside_together * mode_settings.merge_share * model.radius)
    return tuple(both[chosen[chosen >= len(modes)][: settings.beside]])


def _with_valleys(
    model: ObjectModel,
    rows: Evidence,
    found: Alignment,
    stage: SearchStage,
    prior: Prior | None,
    rank: Callable[[Array, float], Array],
    settings: PlanSettings,
    mode_settings: ModeSettings,
) -> Alignment:
    """`found` and the minima along the valleys that `stage`'s blur makes through the best of them."""
    steps = valley_steps(model, rows, found.poses[int(np.argmin(found.costs))], stage, prior, settings, mode_settings)
    if not len(steps):
        return found
    care = settings.wide if prior is None else settings.near
    apart = care.together * mode_settings.merge_share * model.radius
    for few in care.valley_rows:
        rough = align(model, thin(rows, few), steps, prior, AlignSettings(iterations=8))
        likely = rough.costs + rank(rough.poses, 0.0)
        order = np.argsort(likely, kind="stable")
        chosen, _ = leaders(model, rough.poses[order], apart)
        steps, likely = rough.poses[order[chosen]], likely[order[chosen]]
    promising = steps[likely < likely[0] + mode_settings.cost_margin][: care.refined]
    # what led back to a minimum that is known has nothing more to say
    both = np.concatenate([found.poses, promising])
    chosen, _ = leaders(model, both, apart)
    new = chosen[chosen >= len(found.poses)]
    if not len(new):
        return found
    more, _ = _refined(model, rows, both[new], prior, rank)
    return found.joined(more)


def valley_steps(
    model: ObjectModel,
    rows: Evidence,
    pose: Array,
    stage: SearchStage,
    prior: Prior | None,
    settings: PlanSettings,
    mode_settings: ModeSettings,
) -> Array:
    """(n, 4, 4) poses along the directions in which a stage's blurred cost tells little about `pose` (4, 4), and those
    that leave most of the object where it is.
    """
    blurred = AlignSettings(blur=stage.blur, blur_normal=stage.blur_normal)
    hessian = terms(model, thin(rows, stage.rows), pose, prior, blurred)[2]
    unit = np.array([1.0] * 3 + [model.radius] * 3)
    values, vectors = np.linalg.eigh(covariance_of(model, hessian, mode_settings) / (unit * unit[:, None]))
    widths = np.sqrt(np.maximum(values, 0.0))
    free = np.flatnonzero(widths > settings.valley_share)[::-1][: settings.valleys]
    lengths = np.array([sign * k for k in settings.valley_steps for sign in (1.0, -1.0)])
    along = [np.clip(lengths * widths[i], -settings.longest_step, settings.longest_step) for i in free]
    delta = [length[:, None] * (vectors[:, i] * unit) for i, length in zip(free, along)]
    alike = pose @ near_symmetries(model)
    return np.concatenate([se3.perturb(pose, np.concatenate(delta), model.centroid), alike]) if delta else alike


def worth_solving(found: Found, settings: PlanSettings, most: int, told: ModeSettings) -> list[Array]:
    """Poses (4, 4) that the joint solution could still put first: modes, at most so many, best first, and `also`. told:
    what modes weigh after it; a narrow one may weigh little before, beside one that nothing shows.
    """
    modes, after = found.modes, weighed(found.modes, told)
    shares = [max(mode.weight, later.weight) for mode, later in zip(modes, after)]
    likely = [share >= settings.negligible or not settings.skipping for share in shares]
    worth = [mode.pose for mode, may in zip(modes, likely) if may or mode is modes[0]]
    return [*worth[:most], *found.also]


def not_solved(found: Found, worth: list[Array], solved: float) -> tuple[Mode, ...]:
    """The modes that are not among the poses that were solved: places of which no more is known than what the search
    made of them. They cost as much more than the first pose's solution (nats) as they did before it.
    """
    first = found.modes[0]
    rest = [mode for mode in found.modes if not any(mode.pose is pose for pose in worth)]
    return tuple(replace(mode, cost=solved + max(mode.cost - first.cost, 0.0)) for mode in rest)


def _refined(
    model: ObjectModel, rows: Evidence, poses: Array, prior: Prior | None, rank: Callable[[Array, float], Array]
) -> tuple[Alignment, Array]:
    refined = align(model, rows, poses, prior, REFINED)
    past = rank(refined.poses, 0.0)
    return replace(refined, costs=refined.costs + past), past


def doubt_of(
    model: ObjectModel,
    rows: Evidence,
    found: Alignment,
    past: Array,
    agreeing: float,
    settings: PlanSettings,
) -> str:
    """Why the best of a few aligned poses may not be the answer; empty when nothing speaks against it.

    past (n,): what each costs for what the camera saw past it; agreeing: share of the starts that ended near the best.
    """
    best = int(np.argmin(found.costs))
    pose = found.poses[best]
    if agreeing < settings.agreeing:
        return f"{agreeing:.0%} of the first agree"
    if past[best] > settings.past:
        return f"what the camera saw past the first costs {past[best]:.1f}"
    on = rows.on
    distance = np.abs(model.field.distance(se3.apply(se3.inverse(pose), rows.points)))
    near = distance < 3.0 * rows.rows[:, SIGMA]
    for sense, name, least in (
        (VISION, "pixels", settings.explained_pixels),
        (TOUCH, "contacts", settings.explained_contacts),
    ):
        of = on & (rows.sense == sense)
        share = float(near[of].mean()) if of.any() else 1.0
        if share < least:
            return f"{share:.0%} of the {name} explained"
    if int((on & (rows.sense == VISION)).sum()) < settings.least_pixels:
        return "few pixels of the object"
    return ""
