"""One frame, one answer: look, feel, search, solve together, judge.

Readable as the method: each step is one named stage of the trace, run or skipped with its reason.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation import verdict as posterior
from fusion.estimation.answer import Estimate
from fusion.estimation.asked import as_prior, check_limits, check_senses, sure_to_be_within
from fusion.estimation.confidence import whole_covariance, within
from fusion.estimation.moments import moments
from fusion.estimation.pool import Pool
from fusion.estimation.proposals import search_stages, starts_of
from fusion.estimation.propose import modes_anywhere, modes_near
from fusion.estimation.ranking import guarded, ranked
from fusion.estimation.search import find_modes, worth_solving
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.rigs import solve_modes
from fusion.estimation.tolerance import good_enough, is_within, with_shared_errors
from fusion.estimation.trace import Trace
from scenes.evidence import table as tables
from scenes.evidence.align import Prior, costs
from scenes.evidence.near_symmetries import near_symmetries
from scenes.evidence.point_pairs import pair_table
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from scenes.recordings.validation import check_scale
from scenes.threads import one_blas_thread
from touch.contacts import feel
from vision.look.look import look, look_closer, surfaces
from vision.look.looked import Looked
from vision.plausibility import doubts
from vision.predicted import Predictor
from vision.sight import Sight
from vision.visibility import visibility

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Asked:
    """One question: senses allowed, prior, tolerance (m, rad), seed; and how it is answered. or_none: only when the
    rows alone are within the tolerance.
    """

    senses: frozenset[str]
    prior: Prior | None
    tolerance: tuple[float, float] | None
    seed: int
    beliefs: Beliefs
    settings: EstimateSettings
    or_none: bool = False


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
    skipped. budget_ms: once it is spent, the joint solution (calibration, depth scale, bias) is skipped. beliefs: what
    the sensors are worth; default what the frame says of its own. sure_within (m): the answer's confidence is the
    probability that its ADD-S is below that, and only a sure answer is `ok`; default 5 mm.
    Returns an Estimate; data that tell nothing give the verdict "lost" and a covariance that says so, not an error.
    Raises CaptureError when the sizes in the frame and the model's tell of a wrong unit.
    """
    settings, senses = sure_to_be_within(settings or EstimateSettings(), sure_within), check_senses(use)
    check_limits(tolerance, budget_ms)
    check_scale(frame, model)
    believed = as_prior(prior if prior is not None else frame.prior, settings)
    asked = _Asked(senses, believed, tolerance, seed, beliefs or frame.beliefs or Beliefs(), settings)
    # built or read once per object, not part of a frame's time
    model.field  # noqa: B018
    near_symmetries(model)
    if believed is None:
        pair_table(model)
    trace = Trace(budget_ms)
    with one_blas_thread():
        looked = _look(frame, model, asked, trace)
        if tolerance is not None and senses == {"vision", "touch"} and frame.depth is not None:
            light = replace(settings, plan=replace(settings.plan, refined=settings.plan.tolerant))
            by_vision = replace(asked, senses=frozenset({"vision"}), settings=light, or_none=True)
            alone = _estimate(frame, model, by_vision, trace, looked)
            if alone is not None and good_enough(model, alone, tolerance, settings):
                return trace.skipping(alone, "feel", "vision alone is within the tolerance")
        answer = _estimate(frame, model, asked, trace, looked)
    assert answer is not None
    return answer


def _look(frame: Frame, model: ObjectModel, asked: _Asked, trace: Trace) -> Looked:
    """What the camera saw, once for all that is asked about it."""
    settings, start = asked.settings.look, asked.prior.pose if asked.prior is not None else None
    viewed = frame if "vision" in asked.senses else frame.without_vision()
    with trace.stage("look", "vision" in asked.senses, "vision not asked for") as stage:
        looked = look(viewed, model, asked.beliefs, start, settings)
        count = len(looked.rows(asked.beliefs.depth, settings.rows))
        stage.note(count, f"{len(looked.pixels)} object pixels, {len(looked.of_hand)} of the hand{looked.how}")
    return looked


def _estimate(frame: Frame, model: ObjectModel, asked: _Asked, trace: Trace, looked: Looked) -> Estimate | None:
    settings, beliefs, believed = asked.settings, asked.beliefs, asked.prior
    viewed = frame if "vision" in asked.senses else frame.without_vision()
    touched = frame if "touch" in asked.senses else frame.without_touch()
    start = believed.pose if believed is not None else None

    seen = looked.rows(beliefs.depth, settings.look.rows)
    with trace.stage("feel", "touch" in asked.senses, "touch not asked for") as stage:
        hand = looked.seen_hand
        felt = feel(touched, hand.correct() if hand is not None else None, beliefs, looked.region, settings.touch)
        contacts = len(felt.reported_contacts)
        stage.note(len(felt.reported_rows), f"{contacts} contacts, {len(felt.reported_rows) - contacts} empty points")
    rows = tables.stack(seen, felt.rows)
    # emptiness alone tells where the object is not
    if len(rows) == 0 or (believed is None and not len(looked.pixels) and not contacts):
        nothing = posterior.no_answer(frame, model, believed, trace.stages, settings.modes, settings.verdict)
        first, how_sure = nothing.modes[0], settings.confidence
        near = within(model, first.pose, first.covariance, how_sure.tolerance, how_sure.felt.nearest)
        return replace(nothing, confidence=first.weight * near, sure_within=how_sure.tolerance)

    sight = Sight(viewed, model, beliefs.depth, settings.sight)
    # something that nobody has a model of touches the object, and may be what is seen
    unknown = contacts > 0 and not looked.told_apart and viewed.depth is not None
    pieces = surfaces(viewed, looked.plane, beliefs, settings.look)[1] if unknown else None
    predictor = Predictor(viewed, model, beliefs.depth, hand, settings.prediction, looked.plane, pieces)
    asks = settings.look.rows, settings.proposals, settings.modes, settings.pool
    rng = np.random.default_rng(asked.seed)
    pool = Pool(model, felt.rows, believed, predictor, sight, looked, beliefs.depth, rng, *asks)
    how, blur = settings.proposals, settings.proposals.blur(model)
    with trace.stage("search", True, "") as stage:
        starts = starts_of(model, believed, looked.pixels.points, felt.contacts, rows, sight.costs, how, rng)
        if believed is not None:
            found = modes_near(pool, rows, seen, starts, search_stages(blur, how.near), settings.plan)
        else:
            stages = search_stages(blur, how.wide if contacts else how.sifted)
            found = find_modes(model, rows, starts, stages, None, sight.costs, settings.plan, settings.modes)
        stage.note(len(rows), f"{found.looked_at} of {len(starts)} starts, blur {1e3 * blur:.1f} mm; {found.why}")
    wide = believed is None and predictor.sees
    with trace.stage("look again", wide, "the region was narrow") as stage:
        if wide:
            likely = np.array([m.pose for m in found.modes if m.weight > settings.plan.negligible])
            if looked.region is not None:
                looked = look_closer(viewed, model, looked, likely, beliefs, settings.look)
                seen = looked.rows(beliefs.depth, settings.look.rows)
                rows = tables.stack(seen, felt.rows)
                last = search_stages(blur, how.near)[-1:]
                again = find_modes(model, rows, likely, last, None, sight.costs, settings.plan, settings.modes)
                likely = np.array([m.pose for m in again.modes])
            found = modes_anywhere(replace(pool, looked=looked), likely, seen, starts, stages)
            stage.note(len(rows), f"{len(looked.pixels)} object pixels around {len(likely)} poses; {found.why}")
    modes = found.modes
    rough = with_shared_errors(model, modes, viewed, beliefs.depth)
    spent, settled = trace.over_budget, is_within(model, rough, asked.tolerance, settings)
    if asked.or_none and not settled:
        return None  # before anything is solved for that touch will change
    why_not = "the time budget is spent" if spent else "the rows alone are within the tolerance"
    finish = not (spent or settled)
    modes = modes if finish else rough
    with trace.stage("solve together", finish, why_not) as stage:
        if finish:
            worth = worth_solving(modes, settings.plan)[: settings.joint.modes]
            shown = [pool.evidence(pose) if predictor.sees else seen for pose in worth]
            known_of = felt.reported_rows, believed, hand, beliefs, settings.joint
            solved = solve_modes([JointProblem.of(model, frame, rows, *known_of) for rows in shown], worth)
            solved = guarded(pool, solved, worth, hand, settings)
            first_of, modes = ranked(touched, pool, solved, sight, settings)
            best, seen = solved[first_of], shown[first_of]
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
    with trace.stage("judge", True, "") as stage:
        pose = modes[0].pose
        residuals = posterior.contact_residuals(model, felt.contacts, pose, settings.verdict)
        share, rms = posterior.pixel_agreement(model, seen, pose)
        seeing = visibility(viewed, model, pose, beliefs.depth)
        picture = predictor.predict(pose[None]) if predictor.sees else None
        nats = float(costs(model, felt.rows, pose[None])[0]) if contacts else 0.0
        agreed = residuals, nats, share, seeing, picture
        right, sure, word, why = posterior.judged(model, modes, *agreed, settings.verdict, settings.confidence)
        covariance = modes[0].covariance
        if word != "ok":
            covariance = whole_covariance(model, modes, right, believed, settings.confidence)
        stage.note(len(rows), why)

    return Estimate(
        frame=frame.index,
        pose=pose,
        covariance=covariance,
        modes=modes,
        verdict=word,
        unobservable=posterior.unobservable(model, pose, modes[0].covariance, settings.verdict),
        hand_from_object=frame.hand_from_object(pose, felt.correction),
        visible_fraction=seeing.visible,
        trace=trace.stages,
        contacts=residuals,
        pixel_rms_mm=1e3 * rms,
        notes=(why, *doubts(viewed, looked.hand, beliefs.calibration, settings.plausibility)),
        dropped=looked.dropped,
        start=start,
        contributions=posterior.contributions(model, rows, pose, covariance, believed),
        confidence=sure,
        sure_within=settings.confidence.tolerance,
    )
