"""Searches beside the frames that come, so that a live tracker's frames do not wait for them.

A frame searched by itself takes as long as fifty that are glanced at. A recording waits; a camera does not. So a live
tracker lets a thread of its own search, one frame at a time, and goes on. What was found is then carried to now: as the
track has moved since, where it was found where the track was then, else as the hand has; and what is not where the
track is now is looked for there once more, because it has had time to move by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.tracking.filter import block, moved_modes
from fusion.tracking.memory.hypotheses import Hypothesis, HypothesisSettings, alike, sure_of
from fusion.tracking.memory.state import TrackState
from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]
Search = Callable[[Frame, Prior | None], Estimate]
Near = Callable[[Array], Estimate]

# What a search is for: the frame as if nothing were known, or around a doubted track.
ANEW, AROUND = "anew", "around"


@dataclass(frozen=True)
class _Asked:
    """A search: what for; where the track had the object in its frame, and the robot its hand, camera_from_hand (4, 4);
    leads: how often another hypothesis had taken the lead; found: what comes of it.
    """

    what: str
    leader: Hypothesis
    hand: Array | None
    leads: int
    found: Future[Estimate]


class Aside:
    """One search at a time on a thread of its own. Its methods belong to the tracker's thread."""

    def __init__(self, worker: Executor | None = None) -> None:
        """worker: who searches; default a thread that begins with the first search."""
        self._worker = worker or ThreadPoolExecutor(1, thread_name_prefix="palpate-search")
        self._asked: _Asked | None = None

    def __reduce__(self) -> tuple[type, tuple]:
        """None where a tracker is copied or pickled, which makes its own when it needs one: no thread can be."""
        return type(None), ()

    @property
    def ready(self) -> str:
        """What the search was for that has ended and was not asked about since; "" where there is none."""
        return self._asked.what if self._asked is not None and self._asked.found.done() else ""

    @property
    def searching(self) -> str:
        """What is being searched for; "" while nothing is."""
        return self._asked.what if self._asked is not None and not self._asked.found.done() else ""

    def heard(self, what: str) -> None:
        """What was searched for this could be asked for in this frame: nobody wants it any more."""
        if what and self.ready == what:
            self._asked = None

    def forget(self) -> None:
        """The track has begun anew: what is being searched is of no use to it."""
        if self._asked is not None:
            self._asked.found.cancel()
        self._asked = None

    def result(
        self, model: ObjectModel, leader: Hypothesis, state: TrackState, near: Near, settings: HypothesisSettings
    ) -> Estimate | None:
        """What was found, brought to now, when the track has the object where `leader` is; None where nobody knows how
        that has moved since. near: estimates this frame around a pose (4, 4). Raises what the search raised.
        """
        asked, self._asked = self._asked, None
        assert asked is not None
        found = asked.found.result()
        same_place = alike(model, asked.leader, found.modes[0], settings)
        if asked.leads == state.leads and (state.hand is None or same_place):
            found = _moved(found, leader.pose @ se3.inverse(asked.leader.pose))
        elif asked.hand is not None and state.hand is not None:
            found = _moved(found, state.hand.camera_from_hand @ se3.inverse(asked.hand))
        else:
            return None
        if alike(model, leader, found.modes[0], settings):
            return found
        again = near(found.pose)
        # it is no surer than the search that told where to look
        verdict = found.verdict if again.verdict == "ok" else again.verdict
        return replace(again, confidence=float(np.fmin(again.confidence, found.confidence)), verdict=verdict)

    def place(self, state: TrackState, likely: float) -> Array | None:
        """Where it was found (4, 4), for a track that has lost it, moved as the hand has where there is one; None where
        it was not, or is less sure than `likely`. Raises what the search raised.
        """
        asked, self._asked = self._asked, None
        assert asked is not None
        found = asked.found.result()
        if found.verdict == "lost" or sure_of(found) < likely:
            return None
        if asked.hand is not None and state.hand is not None:
            return state.hand.camera_from_hand @ se3.inverse(asked.hand) @ found.pose
        return found.pose

    def ask(
        self, what: str, search: Search, frame: Frame, prior: Prior | None, leader: Hypothesis, state: TrackState
    ) -> None:
        """Search this frame, in which the track has the object where `leader` is, unless another search is not done
        with.
        """
        if self._asked is None:
            hand = None if state.hand is None else state.hand.camera_from_hand
            found = self._worker.submit(search, frame, prior)
            self._asked = _Asked(what, leader, hand, state.leads, found)


def _moved(found: Estimate, motion: Array) -> Estimate:
    """An estimate after a rigid motion (4, 4) of the object; where a hand has it is of its own frame and left out."""
    turn = block(motion[:3, :3])
    return replace(
        found, pose=motion @ found.pose, covariance=turn @ found.covariance @ turn.T,
        modes=moved_modes(found.modes, motion), hand_from_object=None,
        as_seen=None if found.as_seen is None else motion @ found.as_seen,
    )  # fmt: skip
