"""One frame, one answer: look, feel, search, solve together, judge.

Readable as the method: each step is one named stage of the trace, run or skipped with its reason.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation import verdict as posterior
from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked, check_kinds, check_limits, sure_to_be_within
from fusion.estimation.confidence import as_shown, observations, within
from fusion.estimation.moments import moments
from fusion.estimation.ranking import led, rejudged
from fusion.estimation.search.modes import find_modes, not_solved, worth_solving
from fusion.estimation.search.proposals import search_stages, starts_of
from fusion.estimation.search.sources import modes_anywhere, modes_near
from fusion.estimation.settings import EstimateSettings, usual_settings
from fusion.estimation.solve.joint import parted
from fusion.estimation.solve.outlined import asks_for, outlined
from fusion.estimation.steps.another import another, why_no_other, with_other
from fusion.estimation.steps.drawn import drawn_by_touch, why_not_drawn
from fusion.estimation.steps.facing import (
    Facing,
    as_printed,
    by_facing,
    by_print,
    check_print,
    faced,
    turned_as_printed,
    unread,
    why_no_print,
)
from fusion.estimation.steps.picture import asked_picture, why_not_asked
from fusion.estimation.steps.sense import look_once, sense, solve_together
from fusion.estimation.steps.twins import with_twins
from fusion.estimation.tolerance import good_enough, is_within, with_shared_errors, with_shift
from fusion.estimation.trace import Trace
from fusion.estimation.whole import room_about, told_covariance
from scenes.evidence import table as tables
from scenes.evidence.align import Prior
from scenes.evidence.alike import alike
from scenes.evidence.near_symmetries import near_symmetries
from scenes.evidence.point_pairs import built_pair_table
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from scenes.recordings.validation import check_scale
from scenes.threads import one_blas_thread
from scenes.words import counted
from touch.gels.localize import build_tables
from vision.look.looked import Looked
from vision.picture.aspects import aspects_of
from vision.plausibility import doubts
from vision.visibility import visibility

Array = NDArray[np.float64]


def estimate(
    frame: Frame,
    model: ObjectModel,
    prior: Array | Prior | None = None,
    use: Iterable[str] = ("vision", "touch"),
    tolerance: tuple[float, float] | None = None,
    budget_ms: float | None = None,
    seed: int = 0,
    settings: EstimateSettings | None = None,
    beliefs: Beliefs | None = None,
    sure_within: float | None = None,
) -> Estimate:
    """Where is the object in this frame?

    prior: a coarse camera_from_object (4, 4), or a Gaussian on it; default the frame's own prior. use: the senses
    allowed. tolerance (m, rad): standard deviations that are good enough; when vision alone is sure and that good,
    touch is skipped, and when the rows are that good before shared errors are solved for, that is
    skipped. budget_ms: once it is spent, the joint solution (calibration, depth scale, bias) is skipped, and an
    answer that took longer says so in its notes. beliefs: what
    the sensors are worth; default what the frame says of its own. sure_within (m): the answer's confidence is the
    probability that its ADD-S is below that, and only a sure answer is `ok`; default 5 mm.
    Returns an Estimate; data that tell nothing give the verdict "lost" and a covariance that says so, not an error.
    Raises CaptureError when the sizes in the frame and the model's tell of a wrong unit.
    """
    check_scale(frame, model)
    check_kinds(model, seed, settings, beliefs)
    settings = sure_to_be_within(settings or usual_settings(), sure_within)
    check_limits(tolerance, budget_ms)
    check_print(model, settings.texture)
    asked = Asked.of(frame, prior, use, tolerance, seed, settings, beliefs)
    # built or read once per object, not part of a frame's time
    model.field, model.outer_vertices  # noqa: B018
    near_symmetries(model)
    if frame.depth is not None and "vision" in asked.senses:
        aspects_of(model)
    if model.texture is not None:
        model.texture.levels  # noqa: B018
    if asked.prior is None:
        built_pair_table(model)
    if asked.prior is None and frame.gels:
        build_tables(model)
    trace = Trace(budget_ms)
    with one_blas_thread():
        looked = look_once(model, asked, trace)
        if tolerance is not None and asked.senses == {"vision", "touch"} and frame.depth is not None:
            light = replace(settings, plan=replace(settings.plan, refined=settings.plan.tolerant))
            by_vision = replace(asked, senses=frozenset({"vision"}), settings=light, or_none=True)
            alone = _estimate(frame, model, by_vision, trace, looked)
            if alone is not None and good_enough(model, alone, tolerance, settings):
                return trace.noting_budget(trace.skipping(alone, "feel", "vision alone is within the tolerance"))
        answer = _estimate(frame, model, asked, trace, looked)
    assert answer is not None
    return trace.noting_budget(answer)


def _estimate(frame: Frame, model: ObjectModel, asked: Asked, trace: Trace, looked: Looked) -> Estimate | None:
    settings, beliefs = asked.settings, asked.beliefs
    start = believed = asked.prior
    sensed = sense(frame, model, asked, trace, looked)
    viewed, felt, seen, rows = sensed.viewed, sensed.felt, sensed.seen, sensed.rows
    pool, sight, predictor, contacts = sensed.pool, sensed.sight, sensed.pool.predictor, sensed.contacts
    if sensed.nothing:
        nothing = posterior.no_answer(frame, model, believed, trace.stages, settings.modes, settings.verdict)
        first, how_sure = nothing.modes[0], settings.confidence
        near = within(model, first.pose, first.covariance, how_sure.tolerance, how_sure.felt.nearest)
        unlikely = doubts(viewed, looked.hand, beliefs.calibration, settings.plausibility, len(looked.pixels))
        unused = *felt.left_out, *_of_the_hand(frame)
        notes = *nothing.notes, *unlikely, *unused, *model.filled, *asked.filled
        return replace(nothing, confidence=first.weight * near, sure_within=how_sure.tolerance, notes=notes)

    how, blur, might_be = settings.proposals, settings.proposals.blur(model), looked.pixels.points
    with trace.stage("search", True, "") as stage:
        starts: list[Array] = []

        def begun() -> Array:
            pixels, contacts = pool.seen(), felt.contacts
            starts.append(starts_of(model, believed, pixels, contacts, rows, sight.costs, how, pool.rng, felt.patches))
            return starts[0]

        wide = search_stages(blur, how.wide if contacts else how.sifted)
        if believed is not None:
            found = modes_near(pool, rows, seen, begun(), search_stages(blur, how.near), settings.plan, trace)
        elif predictor.sees:
            found = modes_anywhere(pool, rows, begun, wide, settings.plan, trace)
        else:
            found = find_modes(model, rows, begun(), wide, None, sight.costs, settings.plan, settings.modes)
        gels = f", by {counted(len(felt.patches), 'gel')} too" if felt.patches and believed is None else ""
        tried = f"{found.looked_at} of {len(starts[0])} starts{gels}" if starts else "pairs of pixels"
        stage.note(len(rows), f"{tried}, blur {1e3 * blur:.1f} mm; {found.why}")
    why_not = why_no_print(sensed, settings.texture)
    facing, gains = Facing(why=why_not), np.zeros(0)
    with trace.stage("print", not why_not, why_not) as stage:
        if not why_not:
            shown = faced(sensed, found, asked)
            found, gains, asked, sensed, facing = shown.found, shown.gains, shown.asked, shown.sensed, shown.facing
            pool, believed = sensed.pool, asked.prior
            stage.note(facing.pixels, facing.why)
    modes = found.modes
    spent, rough = trace.over_budget, modes
    if spent or asked.tolerance is not None:
        rough = with_shared_errors(model, modes, viewed, beliefs.depth)
    settled = is_within(model, rough, asked.tolerance, settings)
    if asked.or_none and not settled:
        return None  # before anything is solved for that touch will change
    why_not = "the time budget is spent" if spent else "the rows alone are within the tolerance"
    finish = not (spent or settled)
    modes = modes if finish else rough
    searched = modes[0].pose
    # takes a pose to where the depth image, as it is, shows the object
    seen_from = np.eye(4)
    with trace.stage("solve together", finish, why_not) as stage:
        if finish:
            worth = worth_solving(found, settings.plan, settings.joint.modes)
            solved = solve_together(sensed, worth, asked)
            in_all = solved.costs - by_print(gains, len(worth))
            # where a print was read, the modes were asked about it
            rest = () if facing.pixels else not_solved(found, worth, float(in_all[0]))
            modes = rejudged(model, solved.results, in_all, settings, predictor.sees, rest)
            modes, first_of = led(modes, solved.results)
            searched = worth[first_of]
            best, seen = parted(solved.results[first_of]), solved.shown[first_of]
            seen_from = best.as_seen @ se3.inverse(best.pose)
            rows = tables.stack(seen, felt.rows)
            felt = felt.corrected(best.correct())
            off = f"calibration off by {best.millimetres:.1f} mm, depth scale by {100 * best.scale:+.2f} %"
            stage.note(len(rows), off)
    with trace.stage("sample", finish, why_not) as stage:
        if finish:
            first, how_wide = modes[0], settings.moments
            spread = moments(model, rows, first.pose, first.covariance, asked.seed, believed, settings=how_wide)
            modes = (replace(first, pose=spread.pose, covariance=spread.covariance), *modes[1:])
            stage.note(len(rows), f"{spread.effective:.0f} effective samples, directions widened: {spread.widened}")
    unasked = why_not_asked(model, modes[0], predictor, settings.picture_mean)
    with trace.stage("picture", finish and not unasked, why_not if not finish else unasked) as stage:
        if finish and not unasked:
            first, why = asked_picture(model, modes[0], seen_from, predictor, asked.seed, settings.picture_mean)
            modes = (first, *modes[1:])
            stage.note(len(rows), why)
    coloured = viewed.rgb is not None and predictor.sees and asks_for(viewed.rgb, settings.contour)
    no_image = "no image beside depth" if viewed.rgb is None else "a colour camera's image is not asked for"
    useless: tuple[str, ...] = ()
    beside = 0.0
    with trace.stage("outline", finish and coloured, why_not if coloured else no_image) as stage:
        if finish and coloured:
            told = outlined(viewed, pool, best, modes[0], beliefs.mesh_sigma, settings)
            modes, felt = (told.mode, *modes[1:]), felt.corrected(told.solved.correct())
            beside = told.beside
            useless = () if told.lines else (f"colours are not used: {told.why}",)
            stage.note(told.lines, told.why)
    first, facing = turned_as_printed(sensed, modes[0], facing, settings.texture)
    modes = (first, *modes[1:])
    if finish and not facing.pixels:
        # where a print is read, it has asked about every way round
        by_picture = (predictor.costs, predictor.rough_costs) if predictor.sees else (None, None)
        modes = with_twins(model, modes, rows, believed, settings, *by_picture)
    useless = *useless, *unread(facing)
    with trace.stage("judge", True, "") as stage:
        pose = modes[0].pose
        residuals = posterior.contact_residuals(model, felt.contacts, pose, settings.verdict)
        share, rms = posterior.pixel_agreement(model, seen, pose)
        seeing = visibility(viewed, model, seen_from @ pose, beliefs.depth)
        picture = predictor.predict(pose[None]) if predictor.sees else None
        first = as_shown(modes[0], picture, believed, settings.confidence, beside)
        modes = (with_shift(model, first, viewed, beliefs.depth), *modes[1:])
        same = alike(model, modes, settings.confidence.tolerance)
        nats = posterior.nats_of_contacts(model, felt.rows, contacts, pose)
        agreed = residuals, nats, share, seeing, picture
        rules = settings.verdict, settings.confidence
        against = posterior.contradiction(model, felt.rows, contacts, pose, settings.verdict)
        anywhere = believed is None
        observed = observations(model, modes, picture, residuals, nats, settings.confidence, anywhere, same)
        judged = posterior.judged(model, modes, *agreed, *rules, anywhere, same, against, observed)
        right, sure, word, why = judged
        stage.note(len(rows), why)
    slack, allowed = sensed.felt.slack, np.zeros((6, 6))
    why_not = why_not_drawn(felt, slack, len(sensed.seen), word, trace.over_budget)
    with trace.stage("draw", not why_not, why_not) as stage:
        if not why_not:
            drawn, moved = drawn_by_touch(
                model, felt, slack, modes, believed, asked.seed, settings.confidence.tolerance
            )
            allowed, sure = allowed if slack else moved, min(sure, drawn)
            if word == "ok" and sure < settings.confidence.sure:
                word, why = "ambiguous", f"only {drawn:.0%} of what the contacts allow is within the tolerance"
            stage.note(len(felt.rows), f"{drawn:.0%} of what the contacts allow is within the tolerance")
    doubted = sure < settings.confidence.sure
    why_not = why_no_other(pool, doubted) if predictor.sees else "nothing is seen"
    with trace.stage("another in view", not why_not, why_not) as stage:
        other = None if why_not else another(pool, modes, settings.confidence, settings.another)
        if other is not None:
            near = sure / max(right, 1e-9)
            modes, right = with_other(model, modes, right, *other)
            sure = right * near
            if word == "ok" and sure < settings.confidence.sure:
                word, why = "ambiguous", f"only {sure:.0%} sure which is meant: another like it is in view"
        stage.note(len(modes), "none is like it" if other is None else f"one is, {other[1]:.0%} sure by itself")
    room = room_about(se3.apply(pose, model.centroid[None])[0], might_be)
    covariance = told_covariance(model, modes, word, right, believed, settings.confidence, room, same)
    covariance = max(covariance, allowed, key=lambda one: float(np.linalg.slogdet(one)[1]))
    word, why = by_facing(model, facing, word, why, settings.texture)

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
        notes=(
            why,
            *posterior.way_round(same, word, settings.confidence.tolerance, settings.verdict),
            *doubts(viewed, looked.hand, beliefs.calibration, settings.plausibility, len(looked.pixels)),
            *useless,
            *felt.untold,
            *felt.left_out,
            *_of_the_hand(frame),
            *model.filled,
            *asked.filled,
        ),
        dropped=looked.dropped,
        start=start.pose if start is not None else None,
        contributions=posterior.contributions(model, rows, pose, covariance, believed),
        confidence=sure,
        sure_within=settings.confidence.tolerance,
        observed=observed,
        print_share=facing.share,
        searched=searched,
        as_seen=seen_from @ pose,
    )


def _of_the_hand(frame: Frame) -> tuple[str, ...]:
    """Why a hand that the frame has is not used, in words."""
    return (f"the hand is left out: no {frame.hand_lacks} known",) if frame.hand_lacks else ()
