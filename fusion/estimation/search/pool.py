"""Every sense proposes, all judge: one pool of poses, ranked by what the whole frame says of each. Camera frame,
metres.

A search over all rows at once is pulled onto whatever fills the image; the pose that every contact explains may never
be tried. So touch alone, and a plain descent from the start, propose beside it. What ranks them is not how many pixels
a pose covers but what must be seen of it (vision.picture.predictor), with what is felt and what was believed before.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.posterior.verdict import nats_of_contacts
from fusion.estimation.search.pool_settings import PoolSettings
from fusion.estimation.search.proposals import ProposalSettings, search_stages
from scenes.evidence import table as tables
from scenes.evidence.align import Alignment, AlignSettings, Prior, align, align_each, costs
from scenes.evidence.modes import Mode, ModeSettings, distinct_modes, weighed
from scenes.evidence.search import SETTLED, SearchStage, leaders, least_of, search, thin
from scenes.evidence.symmetry.near_symmetries import near_symmetries, quarter_turns
from scenes.evidence.table import Evidence
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from touch.held import Held
from vision.look.looked import Looked, RowSettings, surface_rows
from vision.look.pixels import Pixels
from vision.picture.predictor import Predictor
from vision.picture.shown import shown_rows
from vision.sight import Sight
from vision.starts import Seen, different, pair_starts, pixel_starts, seen_starts

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pool:
    """What is known of the frame beyond poses: rows of touch as they are believed now, and a prior; `predictor` says
    what must be seen, `sight` quickly what is seen past. looked and depth: what pixels are worth as rows. held: the
    robot's own hand, where it is known. coloured: pieces of the image by depth and colour. told: what modes weigh in
    what is told of an answer. contacts: how many are felt; an array or a gel is one, however many rows it has; fingers:
    by how many. each: rows of touch by which it proposes alone, every contact in full; default those of `felt`.
    """

    model: ObjectModel
    felt: Evidence
    contacts: int
    fingers: int
    prior: Prior | None
    predictor: Predictor
    sight: Sight
    looked: Looked
    depth: DepthModel
    rng: np.random.Generator
    rows: RowSettings
    proposals: ProposalSettings
    modes: ModeSettings
    settings: PoolSettings
    held: Held | None = None
    coloured: tuple[Pixels, ...] = ()
    told: ModeSettings = field(default_factory=ModeSettings)
    each: Evidence | None = None

    @property
    def apart(self) -> float:
        """Metres by which a point at the object's radius moves between two poses that go on as two."""
        return self.settings.together * self.modes.merge_share * self.model.radius

    def costs(self, candidates: Array, side: int | None = None) -> Array:
        """(n,) nats of poses (n, 4, 4), up to a constant: touch, prior, and the predicted image, by `side` rays along
        each side of an outline; default as many as tell two answers apart.
        """
        return costs(self.model, self.felt, candidates, self.prior) + self.predictor.costs(candidates, side)

    def walking(self, candidates: Array) -> Array:
        """Costs (n,) by the object's aspects, without a ray, as a walk over hundreds of poses (n, 4, 4) needs them."""
        return costs(self.model, self.felt, candidates, self.prior) + self.predictor.rough_costs(candidates)

    def by_touch(self, starts: Array, stages: tuple[SearchStage, ...]) -> Array:
        """(n, 4, 4) poses that touch alone proposes from starts (k, 4, 4), best first; none where nothing is felt.

        Without a prior many explain all of few contacts: the whole objective says which are best. Else touch does.
        """
        s, anywhere = self.settings, self.prior is None
        if not self.contacts:
            return np.zeros((0, 4, 4))
        if anywhere:
            stages = tuple(replace(stage, keep=max(stage.keep, s.felt_kept)) for stage in stages)
        rows = self.felt if self.each is None else self.each
        ends = search(self.model, rows, starts, stages, self.prior, apart=0.5 * self.apart, settled=SETTLED).poses
        if anywhere:
            ends = ends[np.argsort(self.walking(ends), kind="stable")]
        best, _ = leaders(self.model, ends, self.apart)
        return ends[best[: s.by_touch]]

    def descended(self, seen: Evidence, start: Array, starts: Array, descents: int) -> Array:
        """(n, 4, 4) where plain descents by vision's rows end, from a start (4, 4) and some of starts (k, 4, 4): in all
        so many; none where nothing is seen.
        """
        s, on = self.settings, seen.take(seen.on)
        if not len(on):
            return np.zeros((0, 4, 4))
        few, poses = thin(on, s.descent_rows), np.concatenate([start[None], starts[: descents - 1]])
        for blur in s.descent:
            how = AlignSettings(blur=blur, iterations=s.descent_steps)
            moved = align(self.model, few, poses, None, how)
            order = np.argsort(moved.costs, kind="stable")
            poses = moved.poses[order[leaders(self.model, moved.poses[order], 0.5 * self.apart)[0]]]
        return poses

    def seen(self, pixels: Pixels | None = None) -> Seen:
        """Pixels that may be the object, those of a piece or all, with the image that tells their normals."""
        pixels, image = self.looked.pixels if pixels is None else pixels, self.predictor.image
        return Seen(pixels.points) if self.looked.is_cloud or image is None else Seen(pixels.points, pixels.uv, *image)

    def piece_starts(self, pieces: tuple[Pixels, ...]) -> tuple[tuple[Evidence, Array], ...]:
        """Of each piece of the image its rows, and starts (n, 4, 4) that it proposes by itself."""
        found = []
        for piece in pieces:
            rows = surface_rows(replace(self.looked, pixels=piece, told_apart=True), self.depth, self.rows)
            settings = self.proposals.of_piece
            found.append((rows, seen_starts(self.model, self.seen(piece), rows, self.sight.costs, self.rng, settings)))
        return tuple(found)

    def of_pieces(self, pieces: tuple[tuple[Evidence, Array], ...]) -> Array:
        """(n, 4, 4) where a search of each piece by its own rows ends, from `piece_starts`."""
        passes = search_stages(self.proposals.blur(self.model), self.proposals.sifted)
        found = [np.zeros((0, 4, 4))]
        for rows, starts in pieces:
            if len(starts):
                found.append(
                    search(self.model, rows, starts, passes, self.prior, rank=self.sight.costs, settled=SETTLED).poses
                )
        return np.concatenate(found)

    def glanced(self, rows: Evidence) -> Array:
        """(n, 4, 4) poses that a few pairs of pixels propose, after few passes over few of the rows."""
        how, points = self.proposals, self.looked.pixels.points
        if len(points) < self.settings.glanced_pixels:
            return np.zeros((0, 4, 4))

        def rank(candidates: Array, blur: float) -> Array:
            far = costs(self.model, tables.empty(), candidates, self.prior) if self.prior is not None else 0.0
            return self.sight.costs(candidates, blur) + far

        starts = seen_starts(self.model, self.seen(), rows, rank, self.rng, how.glance)
        if not len(starts):
            return starts
        passes, apart = search_stages(how.blur(self.model), how.glanced), self.settings.passes_apart * self.apart
        # the search adds the prior of its own accord
        return search(
            self.model, rows, starts, passes, self.prior, rank=self.sight.costs, apart=apart, settled=SETTLED
        ).poses

    def paired(self) -> Array:
        """(n, 4, 4) the best of very many poses that lay pairs of the object onto pairs of pixels, of the whole image
        and of each of its pieces, or that are turned evenly behind single ones: those that differ, best first.

        Most of so many are told to be hopeless by a few points each, then the object's aspects rank.
        """
        how, points = self.proposals.paired, self.looked.pixels.points
        if not len(points):
            return np.zeros((0, 4, 4))
        parts = [pair_starts(self.model, self.seen(), self.rng, how)]
        parts.append(pixel_starts(self.model, points, how.even, self.rng))
        pieces = (*self.looked.pieces, *self.coloured)
        few = self.proposals.paired_pieces // max(len(pieces), 1)
        of_piece = self.proposals.paired_piece
        of_piece = replace(of_piece, pairs=min(of_piece.pairs, few))
        parts += [pair_starts(self.model, self.seen(piece), self.rng, of_piece) for piece in pieces]
        candidates = np.concatenate(parts)
        candidates = candidates[least_of(self.predictor.glimpse(candidates), self.settings.glimpsed)]
        best = different(self.model, candidates, self.walking(candidates), how)
        return candidates[best[: how.keep_pairs]]

    def glanced_near(self, rows: Evidence, starts: Array) -> Array:
        """(n, 4, 4) where the first of starts (k, 4, 4) near a prior end after few passes over few of the rows; those
        that may compete.
        """
        how, apart = self.proposals, self.settings.passes_apart * self.apart
        passes, few = search_stages(how.blur(self.model), how.glanced_near), starts[: how.starts_glanced]
        rank = self.sight.costs
        ends = search(self.model, rows, few, passes, self.prior, rank=rank, apart=apart, settled=SETTLED).poses
        at = self.costs(ends)
        return ends[at < at.min() + self.settings.promising]

    def turned(self, best: Mode, most: int | None = None) -> Array:
        """(n, 4, 4) poses that turn the object from the best mode's by quarters about its principal axes, or by what
        leaves most of it where it is, each laid onto what is seen and felt there; those that may compete.

        What is seen of an object often fits another side of it. most: so many are laid, those that fit best before.
        """
        s, model = self.settings, self.model
        rows = thin(tables.stack(self.evidence(best.pose, s.sides[0]), self.felt), s.turned_rows)
        alike = np.concatenate([quarter_turns(model), near_symmetries(model)])
        turned = self._believable(best.pose, best.pose @ alike)
        how = AlignSettings(blur=0.5 * self.proposals.blur(model), iterations=s.turned_steps)
        if most is not None and len(turned) > most:
            turned = turned[np.argsort(costs(model, rows, turned, self.prior), kind="stable")[:most]]
        if len(rows) and len(turned):
            turned = align(model, rows, turned, self.prior, how).poses
        return turned[self.walking(turned) < best.cost + s.promising]

    def _believable(self, pose: Array, turned: Array) -> Array:
        """Those of turned (n, 4, 4) that a prior does not rule out beside pose (4, 4); a step or two may move one by
        some of that.
        """
        if self.prior is None or not len(turned):
            return turned
        far = costs(self.model, tables.empty(), np.concatenate([pose[None], turned]), self.prior)
        return turned[far[1:] < far[0] + self.settings.hopeless]

    def held_starts(self) -> Array:
        """(n, 4, 4) starts between the fingers; none without a hand whose place and joints are known."""
        return np.zeros((0, 4, 4)) if self.held is None else self.held.starts(self.model, self.rng, self.proposals.held)

    def evidence(self, pose: Array, side: int | None = None) -> Evidence:
        """Vision's rows if the object is at pose (4, 4): pixels inside its outline, and what was seen to be free.

        side: rays along each side of the outline's box.
        """
        return self.evidence_of_each(pose[None], side)[0]

    def evidence_of_each(self, poses: Array, side: int | None = None, most: int = 0) -> list[Evidence]:
        """`evidence` of each of poses (n, 4, 4). most: at most so many pixels and half as much of what is free,
        carrying the weight of all; 0: all.
        """
        if not self.predictor.sees:
            return [tables.empty()] * len(poses)
        free, least = self.looked.free(self.rows), self.settings.least_pixels
        shown = shown_rows(self.predictor, poses, free, self.rows, least, side, most)
        if self.prior is not None:
            # near a start the outline is about right: there a mask's errors would draw it further than it is off
            return shown
        bare = self.predictor.covering(poses)
        return [tables.stack(mine, more) if len(more) else mine for mine, more in zip(shown, bare)]

    def sifted(self, candidates: Array) -> Array:
        """The most promising of poses (n, 4, 4) by the object's aspects, best first."""
        s = self.settings
        order = np.argsort(self.walking(candidates), kind="stable")
        wide = self.prior is None and not self.predictor.told_apart
        return candidates[order[: s.sifted if wide else s.sifted_near]]

    def compete(self, candidates: Array, most: int | None = None) -> tuple[Mode, ...]:
        """The best of poses (n, 4, 4), n at least 1, each fitted to what is seen inside its own outline, as modes.

        most: so many are fitted; default settings.fitted.
        """
        return distinct_modes(self.model, self.fitted(candidates, most), self.modes)

    def fitted(self, candidates: Array, most: int | None = None, known: Alignment | None = None) -> Alignment:
        """The best of poses (n, 4, 4), each fitted to what is seen inside its own outline, and of those `known`, which
        were fitted before, best first. There is at least one of either.

        most: so many are fitted; default settings.fitted.
        """
        s, fresh = self.settings, np.argsort(at := self.costs(candidates), kind="stable")
        candidates, at = candidates[fresh], at[fresh]
        if known is not None and len(known.poses):
            # what is likelier where it is than a fit that it is near to may go on from there
            both = np.concatenate([known.poses, candidates])
            order = np.argsort(np.concatenate([known.costs, at]), kind="stable")
            best = order[leaders(self.model, both[order], self.apart)[0]]
            best = best[best >= len(known.poses)] - len(known.poses)
        else:
            best = leaders(self.model, candidates, self.apart)[0]
        least = min(at.min(initial=np.inf), np.inf if known is None else known.costs.min(initial=np.inf))
        best = best[(at[best] <= least + s.hopeless) | (np.arange(len(best)) < s.always_fitted)]
        best = best[: most or s.fitted]
        tried = Alignment(candidates[best], at[best], np.zeros((len(best), 6, 6)), np.zeros(len(best), int))
        for turn, side in enumerate(s.sides):
            # what took no step in the round before stays where it is
            if len(tried.poses) and (turn == 0 or tried.iterations.any()):
                tried = self.among(self._fitted(tried, side, turn == 0))
        return tried if known is None else self.among(known.joined(tried))

    def among(self, tried: Alignment) -> Alignment:
        """Those that differ, best first, without those that are hopeless."""
        order = np.argsort(tried.costs, kind="stable")
        order = order[leaders(self.model, tried.poses[order], self.apart)[0]]
        return tried.take(order[tried.costs[order] <= tried.costs[order[0]] + self.settings.hopeless])

    def is_same(self, modes: tuple[Mode, ...], before: tuple[Mode, ...]) -> bool:
        """Whether the first mode is where the first of those before was, and about as likely."""
        near = len(leaders(self.model, np.array([modes[0].pose, before[0].pose]), self.apart)[0]) == 1
        return near and before[0].cost - modes[0].cost < self.settings.as_likely

    def convinces(self, modes: tuple[Mode, ...], shown: float | None = None) -> bool:
        """Whether the first mode explains what is seen and felt, at least the share `shown` of it all, and no other
        comes near.
        """
        s = self.settings
        if shown is None:
            shown = s.least_shown_felt if self.tied else s.least_shown
        if not self.predictor.told_apart:
            # a cost that another thing may earn is worth less
            modes = weighed(modes, self.told)
        first = modes[0]
        rivals = sum(mode.weight for mode in modes[1:] if mode.cost < first.cost + s.surely_apart)
        if first.weight < s.sure_share * (first.weight + rivals):
            return False
        pose = first.pose[None]
        p = self.predictor.predict(pose)
        # what gives no reading neither agrees nor contradicts
        seen = p.agree[0] >= s.least_agree * (p.agree[0] + p.past[0]) and p.agree[0] >= shown
        runs_on = s.most_runs_on if self.predictor.told_apart else s.most_runs_on_unknown
        picture = seen and p.past[0] <= s.most_past and p.running[0] <= runs_on and p.within[0] <= s.most_within
        felt = nats_of_contacts(self.model, self.felt, self.contacts, first.pose)
        return bool(picture and felt <= s.contact_nats * max(self.contacts, 1))

    def explains(self, pose: Array) -> bool:
        """Whether pose (4, 4) explains so much of what is seen, and so little speaks against it, that none around it
        is worth a try.
        """
        s = self.settings
        return self._shows(pose, s.explained, s.explained_share, s.explained_past, s.explained_runs_on)

    def explains_at_a_glance(self, pose: Array) -> bool:
        """Whether pose (4, 4), where few starts near a prior ended, explains what is seen, and nothing that nearly
        looks the same does.
        """
        s = self.settings
        share = s.glance_share_felt if self.fingers >= s.tying_fingers else s.glance_share
        if not self._shows(pose, s.glance_shown, share, s.glance_past, s.glance_runs_on):
            return False
        turned = self._believable(pose, pose @ near_symmetries(self.model))
        at = self.walking(np.concatenate([pose[None], turned]))
        return bool((at[1:] > at[0] + s.glance_apart).all())

    def shows_most(self, pose: Array, least: float = 0.0) -> bool:
        """Whether most of what nothing hides at pose (4, 4), which convinces, agrees with what is seen; or, where
        `least` is given, that share of the whole.
        """
        s, clear = self.settings, (self.settings.most_past, self.settings.most_runs_on_unknown)
        return self._shows(pose, least or s.least_shown, 0.0 if least else s.least_agree, *clear)

    @property
    def turns_freely(self) -> bool:
        """Whether a prior leaves turns about some axis so wide that starts are drawn as if it were narrower."""
        if self.prior is None:
            return True
        return bool(np.linalg.eigvalsh(self.prior.information[:3, :3])[0] < self.proposals.widest_angle**-2.0)

    @property
    def tied(self) -> bool:
        """Whether a pose near the prior is tied by contacts, and it is known what hides the object."""
        return self.prior is not None and self.holds

    @property
    def holds(self) -> bool:
        """Whether contacts hold the object in place, and it is known what hides it."""
        return self.predictor.told_apart and self.fingers >= self.settings.tying_fingers

    def _shows(self, pose: Array, least: float, share: float, past: float, runs_on: float) -> bool:
        """Whether at pose (4, 4) at least the share `least` of the whole agrees with what is seen and `share` of what
        nothing hides, and no more than these shares are seen past and run on over the outline; and whether, where
        nobody says what hides the object, the picture as a whole speaks for it.
        """
        p = self.predictor.predict(pose[None])
        clear = p.past[0] <= past and p.running[0] <= runs_on
        if not self.predictor.told_apart and self.predictor.costs(pose[None])[0] > self.settings.most_against:
            return False
        return bool(clear and p.agree[0] >= max(least, share * (1.0 - p.hidden[0] - p.behind_hand[0])))

    def _fitted(self, tried: Alignment, side: int, fresh: bool) -> Alignment:
        """Each pose fitted to the pixels that it predicts, its steps counted; where it was if that is likelier. What
        took no step in the round before is not fitted again. Costs: the pool's. side: rays along each side of an
        outline; fresh: none of them was ever fitted.
        """
        poses, hessians, steps = tried.poses.copy(), tried.hessians.copy(), np.zeros_like(tried.iterations)
        open_ones = np.flatnonzero(fresh | (tried.iterations > 0))
        shown = self.evidence_of_each(tried.poses[open_ones], side, self.settings.first_rows if fresh else 0)
        kept = [n for n, mine in enumerate(shown) if len(mine) or len(self.felt)]
        # what stays where it was has its costs
        moved, after = open_ones[kept], tried.costs.copy()
        if kept:
            own = [shown[n] for n in kept]
            found = align_each(self.model, own, self.felt, tried.poses[moved], self.prior, self.settings.fit)
            poses[moved], hessians[moved], steps[moved] = found.poses, found.hessians, found.iterations
            after[moved] = self.costs(poses[moved])
        worse = after > tried.costs
        poses[worse], steps[worse] = tried.poses[worse], 0
        # one that was never fitted has no Hessian of its own
        if not fresh:
            hessians[worse] = tried.hessians[worse]
        return Alignment(poses, np.minimum(after, tried.costs), hessians, steps)
