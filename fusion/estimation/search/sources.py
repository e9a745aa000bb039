"""The search as a whole: one source of proposals after the other, until the best of all that competed convinces.

Cheap sources come first, and the trace has a line for each: run, or skipped and why. Camera frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.search.modes import Found, PlanSettings, find_modes
from fusion.estimation.search.pool import Pool
from fusion.estimation.search.walk import walk
from fusion.estimation.trace import Trace
from scenes.evidence.align import Alignment
from scenes.evidence.modes import Mode, distinct_modes
from scenes.evidence.search import SETTLED, SearchStage, leaders, search
from scenes.evidence.table import Evidence
from scenes.words import counted

Array = NDArray[np.float64]

CONVINCED = "what was proposed convinces"
AGREED = "a glance found nothing likelier"
ONE_PLACE = "all that was tried ended in one place"
ALIKE = "two sources ended in one place"


class Competition:
    """Poses of several sources, of which the likeliest stay. trace: has a line for each source."""

    def __init__(self, pool: Pool, trace: Trace) -> None:
        """Nothing has been proposed yet."""
        self.pool, self.trace = pool, trace
        self.modes: tuple[Mode, ...] = ()
        self.fitted: Alignment | None = None
        self.convinced = False
        self.proposed = 0
        # nats by which the last draws around the best were likelier
        self.gained = 0.0
        # why nothing more need be asked, where somebody found that out
        self.why = ""
        # what was proposed last, (n, 4, 4)
        self.latest: Array = np.zeros((0, 4, 4))
        self._felt: Array | None = None

    def enter(self, source: str, propose: Callable[[], Array], why_not: str = "", most: int | None = None) -> None:
        """Let a source propose (n, 4, 4), and all that were left compete with its poses; skipped for a reason.

        most: so many are fitted; default more than at first when what competed before left a doubt.
        """
        with self.trace.stage(f"propose: {source}", not why_not, why_not) as stage:
            if why_not:
                return
            poses = self.latest = propose()
            self._compete(poses, most or (self.pool.settings.fitted_in_doubt if self.modes else None))
            stage.note(len(poses), self._words)

    def look_around(self, why_not: str = "") -> None:
        """Let draws around the best compete with it: what explains what was sensed is not bettered nearby. Skipped for
        a reason.
        """
        pool = self.pool
        if not self.modes:
            why_not = "nothing was proposed"
        elif not why_not and self.explained:
            why_not = "the best explains what is seen"
        with self.trace.stage("propose: around the best", not why_not, why_not) as stage:
            if why_not:
                return
            before, convinced = self.modes[0], self.convinced
            drawn = walk(pool.model, before.pose[None], pool.walking, pool.rng, pool.proposals.around)
            drawn = drawn[pool.costs(drawn) < before.cost + pool.settings.promising]
            self._compete(drawn, None)
            self.gained = before.cost - self.modes[0].cost
            self.convinced = self.convinced and convinced and self.gained < pool.settings.bettered
            stage.note(len(drawn), f"likelier by {self.gained:.1f} nats; {self._words}")

    def look_beside(self) -> None:
        """Let what the best looks like when it is turned, and draws around it, compete with it where it convinces."""
        turned = partial(self.pool.turned, self.modes[0]) if self.convinced else None
        before, alone = self.modes, self.pool.tied and self.proposed == 1
        self.enter("the best turned", turned or (lambda: np.zeros((0, 4, 4))), "" if turned else "nothing convinces")
        if self.convinced:
            alone = alone and len(self.modes) == 1 and self.modes[0].cost == before[0].cost
            self.look_around(ONE_PLACE if alone else "")

    def joins(self, other: Competition) -> bool:
        """Whether another competition, which knew nothing of this one, found what is about as likely, and draws around
        the best hardly more, so that a third would find no more; then what is left of it is left of this one, too.
        """
        if other.fitted is None or self.fitted is None or self.gained > self.pool.settings.hardly:
            return False
        if abs(other.modes[0].cost - self.modes[0].cost) > self.pool.settings.as_likely:
            return False
        self.take(self.fitted.joined(other.fitted))
        return True

    def learns_of(self, other: Competition) -> bool:
        """Whether another competition, which knew nothing of this one, found what is likelier than all of this; then
        what is left of it competes here, too, and what convinces of both is not sure: this one had missed it.
        """
        if other.fitted is None or self.fitted is None:
            return False
        if other.modes[0].cost > self.modes[0].cost - self.pool.settings.bettered:
            return False
        self.take(self.fitted.joined(other.fitted))
        return True

    def take(self, fitted: Alignment) -> None:
        """Let what others were left with compete, and nothing else."""
        self._leave(self.pool.among(fitted))

    def _compete(self, poses: Array, most: int | None) -> None:
        """Let poses (n, 4, 4) compete with what was left."""
        self.proposed += len(poses)
        if len(poses):
            self._leave(self.pool.fitted(poses, most, self.fitted))

    def _leave(self, fitted: Alignment) -> None:
        """These are left, and what they say."""
        self.fitted = fitted
        self.modes = distinct_modes(self.pool.model, fitted, self.pool.modes)
        self.convinced = self.pool.convinces(self.modes)

    @property
    def met(self) -> bool:
        """Whether one of what was proposed last and the best, of which some is seen, are one mode."""
        if not self.modes:
            return False
        model, best, within = self.pool.model, self.modes[0].pose[None], self.pool.modes.merge_share
        group = leaders(model, np.concatenate([best, self.latest]), within * model.radius)[1]
        shown = self.pool.predictor.predict(best).agree[0] >= self.pool.settings.least_shown_felt
        return bool(shown and (group[1:] == 0).any())

    @property
    def settled(self) -> str:
        """Why nothing more need be asked where nothing is known; "" while there is doubt. Where nobody says what hides
        the object, a picture that convinces may be another thing's; one that touch agrees with is not.
        """
        if self.explained:
            return "the best explains what is seen"
        return CONVINCED if self.convinced and self.trusted else ""

    @property
    def trusted(self) -> bool:
        """Whether what convinces is to be believed: it is known what hides the object, or it is felt where it is."""
        return self.pool.predictor.told_apart or self.pool.fingers >= self.pool.settings.tying_fingers

    @property
    def explained(self) -> bool:
        """Whether the best convinces, and leaves nothing that another could explain."""
        return self.convinced and self.pool.explains(self.modes[0].pose)

    @property
    def _words(self) -> str:
        return f"{counted(len(self.modes), 'mode')} left, {'convincing' if self.convinced else 'in doubt'}"

    def by_touch(self, poses: Array) -> Array:
        """The same poses (n, 4, 4), the best first that touch alone proposes: that one is solved with what is left
        while there is doubt, because a calibration that is off makes right contacts look wrong until it is solved for.
        """
        if len(poses) and self.pool.fingers >= self.pool.settings.tying_fingers:
            self._felt = poses[0]
        return poses

    @property
    def contacts(self) -> int:
        """How many are felt."""
        return self.pool.contacts

    @property
    def enough(self) -> str:
        """Why no more need be asked; "" while there is doubt."""
        return CONVINCED if self.convinced else ""

    def found(self, looked_at: int, plan: PlanSettings) -> Found:
        """What is left. looked_at: starts."""
        words = "convincing" if self.convinced else "the best in doubt"
        also: tuple[Array, ...] = ()
        if not self.convinced and self._felt is not None:
            also = (self.pool.compete(self._felt[None])[0].pose,)
        if not self.convinced:
            also = (*also, *self._within_modes(plan))
        said = f"{len(self.modes)} of {counted(self.proposed, 'proposal')} left, {words}"
        return Found(self.modes, looked_at, said, also, left=self.fitted)

    def _within_modes(self, plan: PlanSettings) -> list[Array]:
        """Poses (4, 4) that were merged with likelier ones and cost little more: from each of them the joint solution
        may end elsewhere, and only there is it told which is the likeliest.
        """
        if self.fitted is None or not len(self.fitted.poses):
            return []
        near = self.fitted.poses[self.fitted.costs <= self.fitted.costs[0] + plan.also_within]
        return [pose for pose in near if not any(np.array_equal(pose, mode.pose) for mode in self.modes)][: plan.also]


def of_both(pool: Pool, first: Found, second: Found, plan: PlanSettings) -> Found:
    """What is left of two searches of one frame that knew nothing of each other; `first` itself where all that the
    second ended in was known, or is too costly to be told as a mode.
    """
    if first.left is None or second.left is None:
        return first
    known, fresh = first.left, second.left
    best, differ = known.costs.min(), leaders(pool.model, np.concatenate([known.poses, fresh.poses]), pool.apart)[0]
    new = fresh.costs[differ[differ >= len(known.poses)] - len(known.poses)]
    better = fresh.costs.min() < best - pool.settings.hardly
    if not better and not (new <= best + pool.modes.cost_margin).any():
        return first
    both = Competition(pool, Trace())
    both.take(known.joined(fresh))
    found = both.found(first.looked_at + second.looked_at, plan)
    worth = [*found.also, *first.also, *second.also]
    also: list[Array] = []
    for pose in () if both.convinced else worth:
        if not any(np.array_equal(pose, one) for one in (*poses_of(found.modes), *also)):
            also.append(pose)
    return replace(found, also=tuple(also[: 2 * plan.also]))


def glance(pool: Pool, rows: Evidence, starts: Array, trace: Trace) -> Competition:
    """What few of the starts (n, 4, 4) near a prior end in. It is enough where it explains what is seen, or convinces
    and is felt where it is; where that leaves a doubt, a whole search begins without it.
    """
    asked, s = Competition(replace(pool, rng=pool.rng.spawn(1)[0]), trace), pool.settings
    asked.enter("at a glance", lambda: pool.glanced_near(rows, starts), most=s.always_fitted)
    why = ""
    if asked.convinced and pool.explains_at_a_glance(asked.modes[0].pose):
        why = "what a glance tells explains what is seen"
    elif asked.convinced and pool.fingers >= s.tying_fingers:
        asked.look_beside()
        # where nobody knows the hand, no draw around it may be likelier
        why = asked.enough if pool.predictor.told_apart or asked.gained < s.hardly else ""
    elif asked.convinced and pool.predictor.told_apart and pool.shows_most(asked.modes[0].pose):
        alone = asked.proposed == 1 and len(asked.modes) == 1
        asked.look_around(ONE_PLACE if alone else "")
        why = asked.enough
    elif asked.convinced and pool.predictor.told_apart and pool.shows_most(asked.modes[0].pose, s.glance_enough):
        # less of it agrees: neither what it looks like when it is turned nor any draw may be likelier
        asked.look_beside()
        why = asked.enough if asked.gained < s.hardly else ""
    for source in ("rows", "touch and descents", walk_of(pool)) if why else ():
        asked.enter(source, lambda: np.zeros((0, 4, 4)), why)
    asked.why = why
    return asked


def walk_of(pool: Pool) -> str:
    """What a walk near a prior begins at, as the trace has it."""
    return "a walk and the hand" if pool.held is not None else "a walk"


def poses_of(modes: tuple[Mode, ...]) -> Array:
    """(n, 4, 4)."""
    return np.array([mode.pose for mode in modes]).reshape(-1, 4, 4)


def modes_near(
    pool: Pool,
    rows: Evidence,
    seen: Evidence,
    starts: Array,
    stages: tuple[SearchStage, ...],
    plan: PlanSettings,
    trace: Trace,
) -> Found:
    """Modes of a frame with a prior: what a glance tells, where it leaves no doubt. Else rows and touch propose from a
    few of the starts (n, 4, 4), and where the best of that does not convince, the whole objective walks from all of
    them and from between the fingers; then rows and touch again, in rounds of fresh starts, until the best convinces or
    a round ends where the one before did.
    rows: all evidence, seen: vision's.
    """
    prior, settings = pool.prior, pool.settings
    assert prior is not None
    if not pool.predictor.sees:
        return find_modes(pool.model, rows, starts, stages, prior, pool.sight.costs, plan, pool.modes)
    glanced = glance(pool, rows, starts, trace) if plan.skipping else None
    if glanced is not None and glanced.why:
        return glanced.found(pool.proposals.starts_glanced, plan)
    whole, asked = replace(plan, skipping=False), Competition(pool, trace)
    ends = [k for k in plan.rounds if k < len(starts)] if plan.skipping else []
    begin, agreed = 0, False

    def searched(fresh: Array) -> Array:
        rank, few = pool.sight.costs, plan.refining_rows
        found = find_modes(pool.model, rows, fresh, stages, prior, rank, whole, pool.modes, few)
        return poses_of(found.modes)

    def felt(fresh: Array, descending: int) -> Array:
        felt_alone = asked.by_touch(pool.by_touch(fresh, stages))
        return np.concatenate([felt_alone, pool.descended(seen, prior.pose, fresh, descending)])

    def walked() -> Array:
        # pairs of pixels tell of turns that draws from the prior do not reach, and of other places in clutter
        far = pool.turns_freely or not pool.predictor.told_apart
        pairs = pool.glanced(rows) if far else np.zeros((0, 4, 4))
        everywhere = np.concatenate([pairs, poses_of(asked.modes), starts, pool.held_starts()])
        return walk(pool.model, pool.sifted(everywhere), pool.walking, pool.rng, pool.proposals.walk)

    for end, descending in zip([*ends, len(starts)], [*settings.descents[: len(ends)], settings.descents[-1]]):
        fresh, before = starts[begin:end], asked.modes
        asked.enter(f"rows, {counted(len(fresh), 'start')}", partial(searched, fresh))
        clear = plan.skipping and not begin and pool.convinces(asked.modes, settings.clearly_shown)
        asked.enter(
            "touch and descents", partial(felt, fresh, descending), "what all rows say is clearly seen" if clear else ""
        )
        if not begin:
            # what convinces where nobody says what hides the object is only believed as it is felt
            if asked.trusted:
                asked.look_around()
            # asked first: what was taken over from a glance agrees with it
            agreed = glanced is not None and pool.tied and asked.joins(glanced)
            learnt = not agreed and glanced is not None and asked.learns_of(glanced)
            before, known = asked.modes, plan.skipping and (asked.trusted or asked.explained) and not learnt
            asked.enter(walk_of(pool), walked, AGREED if agreed else asked.enough if known else "")
            if agreed:
                begin = end
                break
        begin = end
        # a walk from everywhere is a round, too
        if asked.convinced or (before and pool.is_same(asked.modes, before)):
            break
    if not asked.convinced and not agreed:
        asked.look_around()
    return asked.found(begin, plan)


def modes_anywhere(
    pool: Pool,
    rows: Evidence,
    starts_of: Callable[[], Array],
    passes: tuple[SearchStage, ...],
    plan: PlanSettings,
    trace: Trace,
    before: tuple[Mode, ...] = (),
) -> Found:
    """Modes of a frame of which nothing is known. A few pairs of pixels propose first, and what looks like the best of
    them when it is turned; where that leaves a doubt, touch and rows from many starts, or, where nobody says what hides
    the object, very many pairs of pixels. Unless two of these agree, the whole objective walks from these, from each
    piece of the image and from between the fingers.

    rows: all evidence. starts_of: makes those many starts (n, 4, 4); passes: over them. before: what a search left that
    ended early; it competes here, too.
    """
    asked, s = Competition(pool, trace), pool.settings
    if before:
        asked.enter("the search before", lambda: poses_of(before))
    few = len(pool.looked.pixels) < s.glanced_pixels
    asked.enter("pairs of pixels", lambda: pool.glanced(rows), "few pixels may be the object's" if few else "")
    asked.look_beside()
    enough = asked.settled if plan.skipping else ""
    told = pool.predictor.told_apart
    # rows lay each start onto whatever hides the object, too: where nobody says what that is, they are not asked
    starts = starts_of() if not enough and (told or asked.contacts) else np.zeros((0, 4, 4))
    # where a walk begins; touch alone says more than the starts that it comes from
    begun = [] if asked.contacts else [starts]

    def searched() -> Array:
        rank, apart = pool.sight.costs, s.passes_apart * pool.apart
        begun.append(search(pool.model, rows, starts, passes, rank=rank, apart=apart, settled=SETTLED).poses)
        return begun[-1]

    def paired() -> Array:
        begun.append(walk(pool.model, pool.paired(), pool.walking, pool.rng, pool.proposals.walk_paired))
        return begun[-1]

    def felt_alone() -> Array:
        begun.append(asked.by_touch(pool.by_touch(starts, passes)))
        return begun[-1]

    def agrees(others: tuple[Mode, ...]) -> str:
        """Why no more need be asked, where contacts hold the object and a source that knows nothing of those before it
        ended where they did, and draws around there are hardly likelier.
        """
        alike = others and pool.is_same(asked.modes, others) and asked.met
        if enough or not (plan.skipping and pool.holds and alike):
            return ""
        asked.look_around()
        return ALIKE if asked.gained < s.hardly else ""

    pieces = pool.looked.pieces
    by_vision = f"rows, {counted(len(starts), 'start')}", searched
    if not told:
        of = [counted(len(pieces), "piece")] * bool(pieces) + [f"{len(pool.coloured)} by colour"] * bool(pool.coloured)
        by_vision = ", ".join(["many pairs of pixels", *of]), paired
    agreed = ""
    for source, proposed, why_not in (
        ("touch", felt_alone, "" if asked.contacts else "nothing is felt"),
        (*by_vision, ""),
    ):
        others = asked.modes
        asked.enter(source, proposed, enough or why_not)
        if not enough and not why_not:
            asked.look_beside()
            enough = asked.settled if plan.skipping else ""
            enough = agreed = enough or agrees(others)
    of_pieces: list[tuple[Evidence, Array]] = []

    def walked() -> Array:
        of_pieces.extend(pool.piece_starts(pieces))
        own = [starts for _, starts in of_pieces]
        everywhere = np.concatenate([poses_of(asked.modes), *begun, *own, pool.held_starts()])
        return walk(pool.model, pool.sifted(everywhere), pool.walking, pool.rng, pool.proposals.walk_far)

    sources = ["a walk", *[counted(len(pieces), "piece")] * bool(pieces), *["the hand"] * (pool.held is not None)]
    asked.enter(", ".join(sources), walked, enough)
    why_not = enough
    if not why_not and not told:
        why_not = "pairs of its pixels were tried"
    elif not why_not and not of_pieces:
        why_not = "no piece stands alone"
    elif not why_not and asked.modes and pool.convinces(asked.modes, s.clearly_shown):
        why_not = "the best is clearly seen"
    asked.enter("each piece alone", lambda: pool.of_pieces(tuple(of_pieces)), why_not)
    # few of the pixels that pairs are drawn from may be the object's, so that one draw of them may miss it
    for _ in range(plan.drawn_again if not told and not asked.contacts else 0):
        if asked.convinced or agreed:
            break
        asked.enter(by_vision[0], paired)
        asked.look_beside()
    if not asked.convinced and not agreed:
        asked.look_around()
    return replace(asked.found(len(starts), plan), early=bool(enough))
