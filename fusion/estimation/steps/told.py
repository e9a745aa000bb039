"""What is told of an answer: its verdict, its confidence, how wide it is, and why.

The last step of an estimate. Camera frame, metres, radians.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked
from fusion.estimation.posterior import verdict as posterior
from fusion.estimation.posterior.confidence import as_shown, observations, within
from fusion.estimation.posterior.tolerance import with_shift
from fusion.estimation.posterior.whole import room_about, told_covariance
from fusion.estimation.steps.another import by_hand, is_clear, others, why_no_other, with_others
from fusion.estimation.steps.drawn import drawn_by_touch, why_not_drawn
from fusion.estimation.steps.facing import Faced, as_printed, by_facing, other_printed
from fusion.estimation.steps.finished import Finished
from fusion.estimation.steps.sense import Sensed, unexplained
from fusion.estimation.trace import Trace
from scenes.evidence.align import Prior
from scenes.evidence.symmetry.alike import alike
from scenes.geometry import poses as se3
from vision.plausibility import doubts
from vision.visibility import visibility


def nothing_told(sensed: Sensed, asked: Asked, trace: Trace) -> Estimate:
    """The answer where nothing tells where the object is: lost, and as likely near as the prior has it."""
    settings, model = asked.settings, sensed.pool.model
    answer = posterior.no_answer(sensed.frame, model, asked.prior, trace.stages, settings.modes, settings.verdict)
    first, how_sure = answer.modes[0], settings.confidence
    near = within(model, first.pose, first.covariance, how_sure.tolerance, how_sure.felt.nearest)
    notes = *answer.notes, *_notes(sensed, asked, ())
    return replace(answer, confidence=first.weight * near, sure_within=how_sure.tolerance, notes=notes)


def told(found: Faced, end: Finished, start: Prior | None, trace: Trace) -> Estimate:
    """The answer in full. start: what the search began with, before a print turned it."""
    asked, sensed, facing = found.asked, found.sensed, end.facing
    settings, beliefs, believed = asked.settings, asked.beliefs, asked.prior
    frame, viewed, pool = sensed.frame, sensed.viewed, sensed.pool
    model, predictor, modes, felt = pool.model, pool.predictor, end.modes, end.felt
    with trace.stage("judge", True, "") as stage:
        pose = modes[0].pose
        residuals = posterior.contact_residuals(model, felt.contacts, pose, settings.verdict, felt.of_finger)
        share, rms = posterior.pixel_agreement(model, end.seen, pose)
        seeing = visibility(viewed, model, end.seen_from @ pose, beliefs.depth)
        picture = predictor.predict(pose[None]) if predictor.sees else None
        first = as_shown(modes[0], picture, believed, settings.confidence, end.beside)
        modes = (with_shift(model, first, viewed, beliefs.depth), *modes[1:])
        same = alike(model, modes, settings.confidence.tolerance)
        nats = posterior.nats_of_contacts(model, felt.rows, sensed.contacts, pose)
        agreed = residuals, nats, share, seeing, picture
        rules = settings.verdict, settings.confidence
        against = posterior.contradiction(model, felt.rows, sensed.contacts, pose, settings.verdict)
        anywhere = believed is None
        observed = observations(model, modes, picture, residuals, nats, settings.confidence, anywhere, same)
        judged = posterior.judged(model, modes, *agreed, *rules, anywhere, same, against, observed)
        right, sure, word, why = judged
        stage.note(len(end.rows), why)
    slack, allowed = sensed.felt.slack, np.zeros((6, 6))
    why_not = why_not_drawn(felt, slack, len(sensed.seen), word, trace.over_budget)
    with trace.stage("draw", not why_not, why_not) as stage:
        if not why_not:
            drawn, moved = drawn_by_touch(
                model, felt, slack, modes, believed, asked.seed, settings.confidence.tolerance
            )
            allowed, sure = allowed if slack else moved, min(sure, drawn)
            if word == "ok" and sure < settings.confidence.sure:
                word, why = "ambiguous", f"only {sure:.0%} of what the contacts allow is within the tolerance"
            stage.note(len(felt.rows), f"{drawn:.0%} of what the contacts allow is within the tolerance")
    doubted = sure < settings.confidence.sure
    why_not = why_no_other(pool, doubted, viewed.mask is not None) if predictor.sees else "nothing is seen"
    clear = crowded = False
    if not why_not and predictor.told_apart:
        left = unexplained(model, sensed.looked, end.seen_from @ pose, settings.look)
        clear, crowded = is_clear(pool, pose, settings.another), left >= settings.look.other_share
        why_not = "" if clear or crowded else "the hand holds it, and nothing else is there"
    with trace.stage("another in view", not why_not, why_not) as stage:
        there = () if why_not else others(pool, modes, settings.confidence, settings.another)
        by_print = [other_printed(sensed, facing, pose, one.pose, settings.texture) for one, _ in there]
        if there:
            near = sure / max(right, 1e-9)
            of_hand = [by_hand(pool, pose, one.pose, settings.another) for one, _ in there]
            modes, right = with_others(model, modes, right, there, np.multiply(by_print, of_hand))
            sure = right * near
            if word == "ok" and sure < settings.confidence.sure:
                word, why = "ambiguous", f"only {sure:.0%} sure which is meant: another like it is in view"
        elif not why_not and clear and crowded:
            sure = min(sure, settings.verdict.most_doubted)
            word, why = ("ambiguous", "the hand holds something else") if word == "ok" else (word, why)
        printed = ", not as printed" if by_print and max(by_print) < 0.1 else ""
        likely = f", {there[0][1]:.0%} sure by itself" if there else ""
        stage.note(len(modes), f"{_counted(len(there))}{likely}{printed}")
    room = room_about(se3.apply(pose, model.centroid[None])[0], sensed.looked.pixels.points)
    covariance = told_covariance(model, modes, word, right, believed, settings.confidence, room, same)
    covariance = max(covariance, allowed, key=lambda one: float(np.linalg.slogdet(one)[1]))
    word, why = by_facing(model, facing, word, why, settings.texture)
    round_it = posterior.way_round(same, word, settings.confidence.tolerance, settings.verdict)
    return Estimate(
        frame=frame.index,
        pose=pose,
        covariance=covariance,
        modes=modes,
        verdict=word,
        unobservable=posterior.unobservable(
            as_printed(model, facing, settings.texture), pose, modes[0].covariance, settings.verdict
        ),
        hand_from_object=frame.hand_from_object(pose, felt.correction),
        visible_fraction=seeing.visible,
        trace=trace.stages,
        contacts=residuals,
        pixel_rms_mm=1e3 * rms,
        notes=(why, *round_it, *_notes(sensed, asked, (*end.useless, *felt.untold))),
        dropped=sensed.looked.dropped,
        start=start.pose if start is not None else None,
        contributions=posterior.contributions(model, end.rows, pose, covariance, believed),
        confidence=sure,
        sure_within=settings.confidence.tolerance,
        observed=observed,
        print_share=facing.share,
        searched=end.searched,
        as_seen=end.seen_from @ pose,
    )


def _counted(there: int) -> str:
    return "none is like it" if not there else "one is" if there == 1 else f"{there} are"


def _notes(sensed: Sensed, asked: Asked, unused: Iterable[str]) -> tuple[str, ...]:
    """What speaks against the data as a whole, and what of them is not used, in words."""
    frame, looked = sensed.frame, sensed.looked
    calibration, rules = asked.beliefs.calibration, asked.settings.plausibility
    lacking = (f"the hand is left out: no {frame.hand_lacks} known",) if frame.hand_lacks else ()
    return (
        *doubts(sensed.viewed, looked.hand, calibration, rules, len(looked.pixels)),
        *unused,
        *sensed.felt.left_out,
        *lacking,
        *sensed.pool.model.filled,
        *asked.filled,
    )
