"""Every sense proposes, all judge: one pool of poses, ranked by what the whole frame says of each. Camera frame,
metres.

A search over all rows at once is pulled onto whatever fills the image; the pose that every contact explains may never
be tried. So touch alone, and a plain descent from the start, propose beside it. What ranks them is not how many pixels
a pose covers but what must be seen of it (vision.predicted), with what is felt and what was believed before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.proposals import ProposalSettings
from scenes.evidence import table as tables
from scenes.evidence.align import Alignment, AlignSettings, Prior, align, costs
from scenes.evidence.modes import Mode, ModeSettings, distinct_modes
from scenes.evidence.search import SearchStage, leaders, search, thin
from scenes.evidence.table import GATE_ABOVE, Evidence
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from touch.held import Held
from vision.look.looked import Looked, RowSettings, free_space_rows, surface_rows
from vision.predicted import Predictor
from vision.sight import Sight
from vision.starts import seen_starts

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoolSettings:
    """How many poses compete, and how they are fitted to what is seen of them. Tuned on generated captures."""

    # Poses that touch alone proposes.
    by_touch: int = 8
    # Starts near a prior from which pixels alone are descended to, the prior's own pose first: at first, and when that
    # does not convince; blurs (m) of the passes, as ICP's shrinking gates; steps of each, and rows.
    first_descents: int = 12
    descents: int = 48
    descent: tuple[float, ...] = (0.02, 0.01, 0.005, 0.002)
    descent_steps: int = 6
    descent_rows: int = 160
    # Poses, the best first, that are fitted to the pixels inside their own outlines, at first and when what competed
    # does not convince; how often, by how many rays along each side; the fewest such pixels.
    fitted: int = 6
    fitted_in_doubt: int = 12
    rounds: int = 2
    side: int = 40
    least_pixels: int = 25
    # An answer convinces, and no more is searched, when the shares of its predicted pixels that are seen past, and of
    # its outline that runs on, are at most these, what is seen agrees with at least this share of what is not hidden
    # and of the whole, the
    # first mode holds this share, and touch costs at most so many nats a contact.
    most_past: float = 0.05
    most_runs_on: float = 0.3
    least_agree: float = 0.8
    least_shown: float = 0.12
    sure_share: float = 0.9
    contact_nats: float = 2.5
    # Contacts that hold an object in place: three points. A picture that so many agree with is no other thing's.
    tying_contacts: int = 3
    # Poses nearer to each other than this share of the distance at which modes are one go on as one.
    together: float = 0.5


@dataclass(frozen=True)
class Pool:
    """What is known of the frame beyond poses: rows of touch as they are believed now, and a prior; `predictor` says
    what must be seen, `sight` quickly what is seen past. looked and depth: what pixels are worth as rows. held: the
    robot's own hand, where it is known.
    """

    model: ObjectModel
    felt: Evidence
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

    def costs(self, candidates: Array) -> Array:
        """(n,) nats of poses (n, 4, 4), up to a constant: touch, prior, and the predicted image."""
        return costs(self.model, self.felt, candidates, self.prior) + self.predictor.costs(candidates)

    def proposed(
        self, starts: Array, stages: tuple[SearchStage, ...], seen: Evidence, start: Array | None, descents: int
    ) -> Array:
        """(n, 4, 4) poses that touch alone, and descents from near the start, propose beside a search over all rows."""
        s, parts = self.settings, []
        if (self.felt.rows[:, GATE_ABOVE] > 0).any():
            felt = search(self.model, self.felt, starts, stages, self.prior)
            best, _ = leaders(self.model, felt.poses, s.together * self.modes.merge_share * self.model.radius)
            parts.append(felt.poses[best[: s.by_touch]])
        on = seen.take(seen.rows[:, GATE_ABOVE] > 0)
        if start is not None and len(on):
            few, poses = thin(on, s.descent_rows), np.concatenate([start[None], starts[: descents - 1]])
            for blur in s.descent:
                how = AlignSettings(blur=blur, iterations=s.descent_steps)
                poses = align(self.model, few, poses, None, how).poses
            parts.append(poses)
        return np.concatenate(parts) if parts else np.zeros((0, 4, 4))

    def piece_starts(self) -> Array:
        """(n, 4, 4) starts that each connected piece of the image proposes by itself, those that differ."""
        found = [np.zeros((0, 4, 4))]
        for piece in self.looked.pieces:
            rows = surface_rows(replace(self.looked, pixels=piece, told_apart=True), self.depth, self.rows)
            found.append(
                seen_starts(self.model, piece.points, rows, self.sight.costs, self.rng, self.proposals.of_piece)
            )
        return np.concatenate(found)

    def held_starts(self) -> Array:
        """(n, 4, 4) starts between the fingers; none without a hand whose place and joints are known."""
        return np.zeros((0, 4, 4)) if self.held is None else self.held.starts(self.model, self.rng, self.proposals.held)

    def evidence(self, pose: Array, side: int | None = None) -> Evidence:
        """Vision's rows if the object is at pose (4, 4): pixels inside its outline, and what was seen to be free.

        side: rays along each side of the outline's box.
        """
        pixels = self.predictor.seen_pixels(pose, side)
        free = tables.stack(free_space_rows(self.looked, self.rows), self.predictor.empty_rows(pose))
        if len(pixels) < self.settings.least_pixels:
            return free
        mine = replace(self.looked, pixels=pixels, told_apart=True)
        return tables.stack(surface_rows(mine, self.depth, self.rows), free)

    def compete(self, candidates: Array, most: int | None = None) -> tuple[Mode, ...]:
        """The best of poses (n, 4, 4), n at least 1, each fitted to what is seen inside its own outline, as modes.

        most: so many are fitted; default settings.fitted.
        """
        s = self.settings
        order = np.argsort(self.costs(candidates), kind="stable")
        apart = s.together * self.modes.merge_share * self.model.radius
        best, _ = leaders(self.model, candidates[order], apart)
        fitted = [self._fitted(pose) for pose in candidates[order[best[: most or s.fitted]]]]
        poses = np.array([pose for pose, _ in fitted])
        hessians = np.array([hessian for _, hessian in fitted])
        ranked = Alignment(poses, self.costs(poses), hessians, np.zeros(len(poses), dtype=np.int64))
        return distinct_modes(self.model, ranked, self.modes)

    def convinces(self, modes: tuple[Mode, ...]) -> bool:
        """Whether the first mode explains what is seen and felt, and no other comes near."""
        s = self.settings
        if modes[0].weight < s.sure_share:
            return False
        pose = modes[0].pose[None]
        p = self.predictor.predict(pose)
        open_share = max(float(1.0 - p.hidden[0] - p.behind_hand[0]), 1e-3)
        seen = p.agree[0] >= s.least_agree * open_share and p.agree[0] >= s.least_shown
        picture = seen and p.past[0] <= s.most_past and p.outline[0] <= s.most_runs_on
        contacts = int((self.felt.rows[:, GATE_ABOVE] > 0).sum())
        felt = float(costs(self.model, self.felt, pose)[0])
        return bool(picture and felt <= s.contact_nats * max(contacts, 1))

    def _fitted(self, pose: Array) -> tuple[Array, Array]:
        """A pose after a few fits to the pixels that it predicts, and its Hessian; where it was if that is likelier."""
        tried, hessian = pose, np.zeros((6, 6))
        found: list[tuple[Array, Array]] = []
        for _ in range(self.settings.rounds):
            rows = tables.stack(self.evidence(tried, self.settings.side), self.felt)
            if not len(rows):
                break
            result = align(self.model, rows, tried[None], self.prior)
            tried, hessian = result.poses[0], result.hessians[0]
            found.append((tried, hessian))
        if not found:
            return pose, hessian
        at = self.costs(np.array([pose, *(one for one, _ in found)]))
        best = int(np.argmin(at[1:]))
        return (pose, found[0][1]) if at[0] < at[1 + best] else found[best]
