"""A tracked frame searched by itself near its answer: what else might it be, and is it quite there?

Where nothing tells what hides the object, no frame decides by its picture alone. Searches that begin at the track find
what searches without a start miss among walls and forearms, and estimates around an answer find what rows beside
unknown fingers have pulled it away from. Camera frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from numpy import float64
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate, Mode
from fusion.tracking import hypotheses as several
from fusion.tracking.answer import TrackedEstimate, TrackSettings
from fusion.tracking.hypotheses import Hypothesis
from fusion.tracking.state import TrackState
from fusion.tracking.steps.refining import prefers
from fusion.tracking.steps.sensing import Sensed
from scenes.errors import CaptureError
from scenes.evidence.align import Prior
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

# A frame by itself, with a prior or without.
Estimated = Callable[[Frame, Prior | None], Estimate]
# Believe an estimate of a frame that was tracked to a pose (4, 4).
Anchor = Callable[[Estimate, NDArray[float64]], None]


def leader_at(answer: TrackedEstimate, state: TrackState) -> Hypothesis:
    """The leading hypothesis where the answer has it."""
    return replace(state.hypotheses[0], pose=answer.pose, covariance=answer.modes[0].covariance)


def look_closer(
    model: ObjectModel,
    frame: Frame,
    answer: TrackedEstimate,
    sensed: Sensed | None,
    state: TrackState,
    estimated: Estimated,
    anchor: Anchor,
    settings: TrackSettings,
) -> TrackedEstimate:
    """Estimate a frame that was looked at in full around its answer, where nothing tells what hides the object and it
    is due; where that is surer and the picture better, the track goes on from there.
    """
    s, renewal = settings, state.renewal
    every = s.renewal.closer if answer.verdict != "ok" else s.renewal.closer_sure
    if sensed is None or sensed.viewed.index != frame.index or sensed.told_apart or not len(sensed.looked.pixels):
        return answer
    if frame.index - renewal.closest < every:
        return answer
    renewal.closest = frame.index
    prior = Prior.isotropic(answer.pose, s.loose_angle, s.loose_distance)
    looked = _looked_around(model, frame, answer, prior, estimated)
    if looked is None:
        return answer
    found, mode = looked
    sure, better = several.sure_of(found), -prefers(answer, mode, sensed, s)
    why = f"{sure:.0%} sure, {state.right:.0%} before; {better:.0f} nats better"
    if found.verdict != "lost" and sure > state.right and better > 0.0:
        anchor(replace(found, pose=mode.pose), answer.pose)
        why += "; it goes on from there"
    stage = replace(found.trace[-1], name="look closer", ms=found.time_ms, why=why)
    return replace(answer, trace=(*answer.trace, stage))


def search_around(
    model: ObjectModel,
    frame: Frame,
    answer: TrackedEstimate,
    sensed: Sensed | None,
    state: TrackState,
    estimated: Estimated,
    settings: TrackSettings,
) -> str:
    """Search a frame around a track that nothing has spoken for, or that is not `ok` where nothing tells what hides the
    object; what came of it, in words. Only what is surely elsewhere has a vote, and less of one than what is believed
    needs: the search began at the track, and what is near it is gladly found.
    """
    s = settings
    prior = Prior.isotropic(answer.pose, s.renewal.around_angle, s.renewal.around_distance)
    looked = _looked_around(model, frame, answer, prior, estimated)
    if looked is None:
        return ""
    found, mode = looked
    better, sure = prefers(answer, mode, sensed, s), several.sure_of(found)
    vote = several.vote_of(found.verdict, sure, s.hypotheses)
    vote = min(vote, s.hypotheses.most_repeated) if better <= 0.0 else 0.0
    leader = leader_at(answer, state)
    if not (vote or sure > state.right) or several.alike(model, leader, mode, s.hypotheses):
        return f"; nothing surer around it ({sure:.0%})"
    carried, odds = (leader, *state.hypotheses[1:]), several.log_odds(sure, s.hypotheses)
    state.hypotheses, _ = several.voted(model, carried, (mode,), vote, True, s.hypotheses, odds)
    return f"; around it another, {sure:.0%} sure, {-better:.0f} nats better"


def _looked_around(
    model: ObjectModel, frame: Frame, answer: TrackedEstimate, prior: Prior, estimated: Estimated
) -> tuple[Estimate, Mode] | None:
    """What the frame says by itself around the track, and its first mode the way round that the track has it; None for
    a frame that no estimate should be made of, which the track itself has got on without.
    """
    try:
        found = estimated(replace(frame, prior=None), prior)
    except CaptureError:
        return None
    return found, replace(found.modes[0], pose=model.symmetries.nearest(found.pose, answer.pose))
