"""A tracked frame searched by itself near its answer: what else might it be, and is it quite there?

Where nothing tells what hides the object, no frame decides by its picture alone. Searches that begin at the track find
what searches without a start miss among walls and forearms, and estimates around an answer find what rows beside
unknown fingers have pulled it away from. Camera frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from numpy import float64
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate, Mode
from fusion.estimation.posterior.confidence import near_enough
from fusion.estimation.posterior.whole import told_covariance
from fusion.estimation.settings import EstimateSettings
from fusion.tracking.answer import TrackedEstimate, TrackSettings
from fusion.tracking.memory import hypotheses as several
from fusion.tracking.memory.hypotheses import Hypothesis
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.aside import ANEW, AROUND, Aside
from fusion.tracking.steps.doubts.contradicting import may_be_strangers
from fusion.tracking.steps.refining import prefers
from fusion.tracking.steps.sensing import Sensed
from scenes.errors import CaptureError
from scenes.evidence.align import Prior
from scenes.evidence.modes import covariance_of, information_of
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[float64]

_AROUND = "no surer than the place that it was looked for around"

# A frame by itself, with a prior or without. Searched: by what it is for, and None while it is not known.
Estimated = Callable[[Frame, Prior | None], Estimate]
Searched = Callable[[str, Frame, Prior | None], Estimate | None]
# Believe an estimate of a frame that was tracked to a pose (4, 4).
Anchor = Callable[[Estimate, Array], None]


def by_itself(model: ObjectModel, found: Estimate, around: Prior | None, settings: EstimateSettings) -> Estimate:
    """What a frame says that was searched around a place which the track had thought of: its modes without what that
    prior says of them, and as sure as they then are; the estimate itself where there was none (None).

    A place to look at is no evidence. Counted as some, a track that data leave open by centimetres would be told by
    each such search that it is where it is, and would tell the next one.
    """
    if around is None:
        return found
    how, first = settings.confidence, found.modes[0]
    modes = tuple(
        replace(m, covariance=covariance_of(model, information_of(m.covariance) - around.information, settings.modes))
        for m in found.modes
    )
    near, less = (near_enough(model, one, how) for one in (first, modes[0]))
    sure, word, notes = found.confidence * less / max(near, less, 1e-300), found.verdict, found.notes
    if word == "ok" and sure < how.sure:
        word, notes = "ambiguous", (_AROUND, *notes)
    wide = told_covariance(model, modes, word, sure, None, how)
    return replace(found, modes=modes, verdict=word, confidence=sure, covariance=wide, notes=notes)


def near(estimated: Estimated, frame: Frame, settings: TrackSettings, pose: Array) -> Estimate:
    """The frame by itself, looked for around a pose (4, 4) that it was found at."""
    return estimated(replace(frame, prior=None), Prior.isotropic(pose, settings.near_angle, settings.near_distance))


def leader_at(answer: TrackedEstimate, state: TrackState) -> Hypothesis:
    """The leading hypothesis where the answer has it."""
    return replace(state.hypotheses[0], pose=answer.pose, covariance=answer.modes[0].covariance)


def recover(
    model: ObjectModel,
    frame: Frame,
    lost: TrackedEstimate,
    sensed: Sensed | None,
    state: TrackState,
    estimated: Estimated,
    aside: Aside | None,
    heard: str,
    settings: TrackSettings,
) -> Estimate | None:
    """Look for a lost object around the prediction, where it was last and where the likeliest hypothesis has it, if
    anything is seen there, and now and then everywhere: a live tracker meanwhile (aside; heard: what that has
    searched for), and then in this frame around where that has found it. Everywhere comes first where a mask tells
    what is the object's and no hand how it moves. What is found farther from there than was thought is estimated
    once more around itself: a place to look at is no evidence, and would pull the answer towards it. Where contacts
    may be strangers to what is seen the image alone is asked first (sensed: of this frame). Near a track that was
    more likely wrong than right, or that no search has spoken for, it is no surer than that.
    """
    s, frame = settings, replace(frame, prior=None)
    tries: list[Prior | None] = []
    due = state.lost_for <= 1 or frame.index >= state.renewal.alone
    shown = due and frame.mask is not None and state.hand is None
    if lost.how == "lost" or shown:
        ahead = Prior.isotropic(lost.pose, s.near_angle, s.near_distance)
        tries.append(ahead)
        if state.belief is not None and _is_away(model, state.belief.pose, ahead):  # it stands where it was let go
            tries.append(Prior.isotropic(state.belief.pose, s.near_angle, s.near_distance))
        likeliest = max(lost.modes, key=lambda mode: mode.weight).pose
        if _is_away(model, likeliest, ahead):  # it waits until searches speak for it, and would have led
            tries.append(Prior.isotropic(likeliest, s.near_angle, s.near_distance))
    ours = tuple(tries)
    if shown and aside is None:
        tries.insert(0, None)
    if aside is not None and heard:
        place = aside.place(state, s.found_again)
        if place is not None:
            tries.append(Prior.isotropic(place, s.near_angle, s.near_distance))
    # where nothing is near the prediction, at once: there is nothing to look around
    at_once = state.lost_for == 1 and lost.how == "carried"
    if at_once or state.lost_for == 2 or state.lost_for % s.global_every == 0:
        if aside is not None:
            aside.ask(ANEW, estimated, frame, None, leader_at(lost, state), state)
        elif not shown:
            tries.append(None)
    if ours and may_be_strangers(frame, sensed, state, s):
        by_image = estimated(frame.without_touch(), tries[0])
        if by_image.verdict == "ok":
            return by_image if tries[0] is None else _no_surer(by_image, state, s)
    for prior in tries:
        found = estimated(frame, prior)
        if _is_found(found, s.found_again if prior is None else s.found_near):
            if prior is not None and _is_away(model, found.pose, prior):
                again = estimated(frame, Prior.isotropic(found.pose, s.near_angle, s.near_distance))
                found = found if again.verdict == "lost" else again
            return _no_surer(found, state, s) if any(prior is one for one in ours) else found
    if shown:
        state.renewal.in_vain(frame.index, s.renewal)
    return None


def _is_found(found: Estimate, likely: float) -> bool:
    """Whether a frame's own answer may be followed: it is `ok`, or ambiguous and as likely as that."""
    return found.verdict == "ok" or (found.verdict == "ambiguous" and several.sure_of(found) >= likely)


def _no_surer(found: Estimate, state: TrackState, settings: TrackSettings) -> Estimate:
    """An estimate around a track that was more likely wrong than right, or that no search has spoken for."""
    how, right = settings.hypotheses, state.right
    if not state.hypotheses or state.hypotheses[0].votes < how.believed:
        right = min(right, how.unvoted)
    elif right >= settings.found_again:
        return found
    if several.sure_of(found) <= right:
        return found
    found = replace(found, confidence=right)
    if found.verdict != "ok":
        return found
    why = f"looked for around a track that is {right:.0%} sure"
    return replace(found, verdict="ambiguous", notes=(why, *found.notes))


def _is_away(model: ObjectModel, pose: Array, prior: Prior) -> bool:
    """Whether a pose (4, 4) is more than a standard deviation from where a prior looks for it."""
    off = se3.difference(model.symmetries.nearest(pose, prior.pose), prior.pose, model.centroid)
    return float(off @ prior.information @ off) > 1.0


def lets_go(
    model: ObjectModel, pose: Array, answer: TrackedEstimate, sensed: Sensed | None, state: TrackState, s: TrackSettings
) -> bool:
    """Whether an object at `pose` (4, 4) would not be what the fingers hold, as the track's answer is."""
    if state.touched is None or state.hand is None or sensed is None:
        return False
    at = sensed.felt.correction @ state.hand.camera_from_hand
    return state.touched.is_let_go(model, pose, answer.pose, at, s.first.verdict)


def renew(
    model: ObjectModel,
    frame: Frame,
    answer: TrackedEstimate,
    sensed: Sensed | None,
    state: TrackState,
    searched: Searched,
    anchor: Anchor,
    settings: TrackSettings,
) -> TrackedEstimate:
    """Search the frame as if nothing were known; what it finds votes for a hypothesis, or is a new one."""
    s = settings
    try:
        alone = searched(ANEW, replace(frame, prior=None), None)
    except CaptureError:
        state.renewal.found(frame.index, None, s.renewal)
        return answer
    if alone is None:
        return answer
    vote, against = several.vote_of(alone.verdict, several.sure_of(alone), s.hypotheses), alone.verdict == "ok"
    modes = tuple(replace(m, pose=model.symmetries.nearest(m.pose, answer.pose)) for m in alone.modes)
    leader = leader_at(answer, state)
    # what speaks for it is its vote
    odds = several.log_odds(several.sure_of(alone), s.hypotheses)
    if vote and not against:  # which way round it does not know, and is no reason to turn the track
        there = [several.surface_apart(model, m.pose, modes[0].pose) < s.hypotheses.surface for m in modes]
        turned = [near and several.alike(model, leader, m, s.hypotheses) for m, near in zip(modes, there)]
        modes = tuple(modes[k] for k in sorted(range(len(modes)), key=lambda k: not turned[k]))
        odds = min(odds, leader.odds)
    modes = several.without_news(model, modes, (leader, *state.hypotheses[1:]), s.hypotheses)
    same = several.alike(model, leader, modes[0], s.hypotheses)
    better = prefers(answer, alone, sensed, s)
    if better > s.hypotheses.missed:  # it has not even found the best that is near it
        vote = 0.0
    told_apart = sensed is None or sensed.told_apart
    as_clear = answer.verdict == "ok" and better >= -s.hypotheses.missed and not told_apart and state.touched is None
    if as_clear and several.may_both_be(model, leader.pose, modes[0].pose):
        # one that looks like it, elsewhere in the image: nothing says that it is the one that was followed until now
        state.renewal.found(frame.index, None, s.renewal)
        why = f"another beside it, {several.sure_of(alone):.0%} sure; {better:+.0f} nats for the track"
        stage = replace(alone.trace[-1], ran=True, name="search anew", ms=alone.time_ms, why=why)
        return replace(answer, trace=(*answer.trace, stage))
    carried = (leader, *state.hypotheses[1:])
    # what a frame is not sure of undoes nothing that fingers have felt before it
    sure_of_first = alone.verdict == "ok"
    held = tuple(
        mode
        for rank, mode in enumerate(modes)
        if (rank == 0 and sure_of_first) or not lets_go(model, mode.pose, answer, sensed, state, s)
    )
    agrees = False
    if held and held[0] is modes[0]:
        state.hypotheses, agrees = several.voted(model, carried, held, vote, against, s.hypotheses, odds)
    else:
        state.hypotheses, vote = carried, 0.0
    as_gladly = better <= (s.hypotheses.missed if not vote else -s.hypotheses.missed)
    doubtful = not agrees and as_gladly  # of two that look alike the one that is not found is none the worse for it
    if doubtful:
        sure = 1.0 if told_apart else several.sure_of(alone)
        state.hypotheses = several.doubted(state.hypotheses, s.hypotheses, sure)
    believed = state.hypotheses[0].votes >= s.hypotheses.believed and (agrees or better > 0.0)
    told = (vote and against) or (doubtful and leader.votes >= s.hypotheses.believed)
    state.renewal.found(frame.index, agrees if told else None, s.renewal, believed)
    where = "agrees" if agrees else "finds it elsewhere"
    why = f"{where}, {several.sure_of(alone):.0%} sure; {better:+.0f} nats for the track; {vote:.1f} votes"
    if same and vote and against and better < -s.anchor:
        anchor(replace(alone, pose=modes[0].pose), answer.pose)
        why += "; it goes on from there"
    if not believed or not (told_apart or answer.verdict == "ok"):
        why += search_around(model, frame, answer, sensed, state, searched, s)
    stage = replace(alone.trace[-1], ran=True, name="search anew", ms=alone.time_ms, why=why)
    return replace(answer, trace=(*answer.trace, stage))


def surer_alone(
    model: ObjectModel,
    frame: Frame,
    answer: TrackedEstimate,
    sensed: Sensed | None,
    state: TrackState,
    estimated: Estimated,
    settings: TrackSettings,
) -> tuple[TrackedEstimate, Estimate | None]:
    """The answer, and what its frame says by itself as if nothing were known, where its mask tells what is the
    object's, no hand how it moves, and the answer is not `ok`; None where that is not either, no surer, no better by
    its picture, or not due yet. Less than `ok` would be a frame's own doubt in place of what those before it have told.
    """
    s, renewal = settings, state.renewal
    if answer.verdict == "ok" or frame.mask is None or state.hand is not None or sensed is None:
        return answer, None
    if sensed.viewed.index != frame.index or frame.index < renewal.alone:
        return answer, None
    try:
        found = estimated(replace(frame, prior=None), None)
    except CaptureError:
        renewal.in_vain(frame.index, s.renewal)
        return answer, None
    sure, before = several.sure_of(found), _own_sure(model, answer, sensed, state, s)
    if found.verdict == "ok" and sure > before and prefers(answer, found, sensed, s) < 0.0:
        return answer, found
    renewal.in_vain(frame.index, s.renewal)
    why = f"{sure:.0%} sure, {before:.0%} before: nothing surer"
    stage = replace(found.trace[-1], ran=True, name="search alone", ms=found.time_ms, why=why)
    return replace(answer, trace=(*answer.trace, stage)), None


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
    sure, before = several.sure_of(found), _own_sure(model, answer, sensed, state, s)
    better = -prefers(answer, found, sensed, s)
    why = f"{sure:.0%} sure, {before:.0%} before; {better:.0f} nats better"
    if found.verdict != "lost" and sure > before and better > 0.0:
        anchor(replace(found, pose=mode.pose), answer.pose)
        why += "; it goes on from there"
    stage = replace(found.trace[-1], ran=True, name="look closer", ms=found.time_ms, why=why)
    return replace(answer, trace=(*answer.trace, stage))


def search_around(
    model: ObjectModel,
    frame: Frame,
    answer: TrackedEstimate,
    sensed: Sensed | None,
    state: TrackState,
    searched: Searched,
    settings: TrackSettings,
) -> str:
    """Search a frame around a track that nothing has spoken for, or that is not `ok` where nothing tells what hides the
    object; what came of it, in words. Only what is surely elsewhere has a vote, and less of one than what is believed
    needs: the search began at the track, and what is near it is gladly found.
    """
    s = settings
    prior = Prior.isotropic(answer.pose, s.renewal.around_angle, s.renewal.around_distance)
    looked = _looked_around(model, frame, answer, prior, partial(searched, AROUND))
    if looked is None:
        return ""
    found, mode = looked
    better, sure = prefers(answer, found, sensed, s), several.sure_of(found)
    vote = several.vote_of(found.verdict, sure, s.hypotheses) if better <= 0.0 else 0.0
    leader = leader_at(answer, state)
    if found.verdict != "ok" and lets_go(model, mode.pose, answer, sensed, state, s):
        return "; around it what fingers do not hold"
    surer = sure > _own_sure(model, answer, sensed, state, s)
    if not (vote or surer) or several.alike(model, leader, mode, s.hypotheses):
        return f"; nothing surer around it ({sure:.0%})"
    carried, odds = (leader, *state.hypotheses[1:]), several.log_odds(sure, s.hypotheses)
    how = s.hypotheses
    state.hypotheses, _ = several.voted(model, carried, (mode,), vote, True, how, odds, how.most_repeated)
    return f"; around it another, {sure:.0%} sure, {-better:.0f} nats better"


def _own_sure(
    model: ObjectModel, answer: TrackedEstimate, sensed: Sensed | None, state: TrackState, s: TrackSettings
) -> float:
    """How sure a track is of its answer by itself, whether searches speak for it or not: that it is the right one, and
    near enough by its own covariance, as the confidence of a single frame has it that is held against it.
    """
    how = s.confident if sensed is not None and sensed.told_apart else s.first.confidence
    return state.right * near_enough(model, answer.modes[0], how)


def _looked_around(
    model: ObjectModel,
    frame: Frame,
    answer: TrackedEstimate,
    prior: Prior,
    searched: Callable[[Frame, Prior | None], Estimate | None],
) -> tuple[Estimate, Mode] | None:
    """What the frame says by itself around the track, and its first mode the way round that the track has it; None for
    a frame that no estimate should be made of, which the track itself has got on without, and while it is searched.
    """
    try:
        found = searched(replace(frame, prior=None), prior)
    except CaptureError:
        return None
    if found is None:
        return None
    return found, replace(found.modes[0], pose=model.symmetries.nearest(found.pose, answer.pose))
