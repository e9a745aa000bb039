"""One frame, one answer: look, feel, search, refine, solve together, judge.

Readable as the method: each step is one named stage of the trace, run or skipped with its reason. What a step needs
beyond a line is in `fusion.estimation.stages`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation import verdict as posterior
from fusion.estimation.answer import Estimate
from fusion.estimation.moments import moments
from fusion.estimation.search import find_modes, worth_solving
from fusion.estimation.solve import joint
from fusion.estimation.solve.rigs import solve_modes
from fusion.estimation.stages import (
    EstimateSettings,
    as_prior,
    beyond_rows,
    blind,
    check_limits,
    check_senses,
    comparable,
    good_enough,
    hand_from_object,
    is_within,
    look,
    no_answer,
    numb,
    rejudged,
    search_stages,
    starts_of,
    vision_rows,
    with_shared_errors,
)
from fusion.estimation.trace import Trace
from scenes.evidence import table as tables
from scenes.evidence.align import Prior
from scenes.evidence.near_symmetries import near_symmetries
from scenes.evidence.point_pairs import pair_table
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from scenes.recordings.validation import check_scale
from scenes.threads import one_blas_thread
from touch.contacts import feel
from vision.look.segments import region_around, segment
from vision.plausibility import doubts
from vision.sight import Sight
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
) -> Estimate:
    """Where is the object in this frame?

    prior: a coarse camera_from_object (4, 4), or a Gaussian on it; default the frame's own prior. use: the senses
    allowed. tolerance (m, rad): standard deviations that are good enough; when vision alone is sure and that good,
    touch is skipped, and when the rows are that good before shared errors are solved for, that is
    skipped. budget_ms: once it is spent, the joint solution (calibration, depth scale, bias) is skipped.
    Returns an Estimate; data that tell nothing give the verdict "lost" and a covariance that says so, not an error.
    Raises CaptureError when the sizes in the frame and the model's tell of a wrong unit.
    """
    settings, senses = settings or EstimateSettings(), check_senses(use)
    check_limits(tolerance, budget_ms)
    check_scale(frame, model)
    believed = as_prior(prior if prior is not None else frame.prior, settings)
    # built or read once per object, not part of a frame's time
    model.field  # noqa: B018
    near_symmetries(model)
    if believed is None:
        pair_table(model)
    trace = Trace(budget_ms)
    with one_blas_thread():
        if tolerance is not None and senses == {"vision", "touch"} and frame.depth is not None:
            alone = _estimate(frame, model, believed, frozenset({"vision"}), trace, seed, settings, tolerance)
            if good_enough(alone, tolerance, settings):
                return trace.skipping(alone, "feel", "vision alone is within the tolerance")
        return _estimate(frame, model, believed, senses, trace, seed, settings, tolerance)


def _estimate(
    frame: Frame,
    model: ObjectModel,
    believed: Prior | None,
    senses: frozenset[str],
    trace: Trace,
    seed: int,
    settings: EstimateSettings,
    tolerance: tuple[float, float] | None,
) -> Estimate:
    rng = np.random.default_rng(seed)
    viewed = frame if "vision" in senses else blind(frame)
    start = believed.pose if believed is not None else None

    with trace.stage("look", "vision" in senses, "vision not asked for") as stage:
        looked, how = look(viewed, model, start, settings)
        seen = vision_rows(looked, settings)
        stage.note(len(seen), f"{len(looked.pixels)} object pixels, {len(looked.hand)} of the hand{how}")
    with trace.stage("feel", "touch" in senses, "touch not asked for") as stage:
        felt = feel(frame if "touch" in senses else numb(frame), settings.contact_gate, looked.region)
        stage.note(len(felt.rows), f"{len(felt.contacts)} contacts, {len(felt.rows) - len(felt.contacts)} empty points")

    hand = looked.hand_view if looked.hand_view is not None and len(looked.hand_view.points) else None
    correction = hand.correct() if hand is not None else np.eye(4)
    uncorrected = hand is None and frame.camera is not None
    touch_rows = felt.slackened(settings.calibration, uncorrected).moved(correction)
    rows = tables.stack(seen, touch_rows)
    # emptiness alone tells where the object is not
    if len(rows) == 0 or (believed is None and not len(looked.pixels) and not len(felt.contacts)):
        return no_answer(frame, model, believed, trace, settings)

    sight = Sight(viewed, model, settings.depth)
    with trace.stage("search", True, "") as stage:
        touched = felt.contacts.moved(correction)
        starts = starts_of(model, believed, looked.pixels.points, touched, rows, sight.costs, settings, rng)
        blur = float(np.clip(settings.blur_share * model.radius, *settings.blur_limits))
        found = find_modes(
            model,
            rows,
            starts,
            search_stages(blur, believed is not None, sifted=not len(touched)),
            believed,
            sight.costs,
            settings.plan,
            settings.modes,
        )
        modes = found.modes
        stage.note(len(rows), f"{found.looked_at} of {len(starts)} starts, blur {1e3 * blur:.1f} mm; {found.why}")
    wide = believed is None and "vision" in senses and looked.region is not None and not looked.is_cloud
    with trace.stage("look again", wide, "the region was narrow") as stage:
        if wide:
            likely = np.array([m.pose for m in modes if m.weight > settings.plan.negligible or m is modes[0]])
            region = region_around(model, likely, settings.segmentation)
            beliefs = settings.segmentation, settings.depth, settings.calibration
            looked = segment(viewed, model, None, *beliefs, again=(region, looked.hand_view))
            seen = vision_rows(looked, settings)
            rows = tables.stack(seen, touch_rows)
            last = search_stages(blur, near=True)[-1:]
            modes = find_modes(model, rows, likely, last, None, sight.costs, settings.plan, settings.modes).modes
            stage.note(len(rows), f"{len(looked.pixels)} object pixels around {len(likely)} poses")
    rough = with_shared_errors(modes, viewed, settings)
    spent, settled = trace.over_budget, is_within(rough, tolerance, settings)
    why_not = "the time budget is spent" if spent else "the rows alone are within the tolerance"
    finish = not (spent or settled)
    modes = modes if finish else rough
    with trace.stage("solve together", finish, why_not) as stage:
        if finish:
            problem = joint.JointProblem.of(model, frame, looked, seen, felt.rows, believed, hand, settings)
            solved = solve_modes(problem, worth_solving(modes, settings.plan))
            costs = comparable(solved, settings) + sight.costs(np.array([s.pose for s in solved]))
            costs += beyond_rows(frame if "touch" in senses else numb(frame), model, solved, settings)
            modes = rejudged(model, solved, costs, settings)
            best = solved[int(np.argmin(costs))]
            correction = best.correct()
            stage.note(
                len(rows), f"calibration off by {best.millimetres:.1f} mm, depth scale by {100 * best.scale:+.2f} %"
            )
    with trace.stage("sample", finish, why_not) as stage:
        if finish:
            spread = moments(model, rows, modes[0].pose, modes[0].covariance, seed, believed, settings=settings.moments)
            modes = (replace(modes[0], pose=spread.pose, covariance=spread.covariance), *modes[1:])
            stage.note(len(rows), f"{spread.effective:.0f} effective samples, directions widened: {spread.widened}")
    with trace.stage("judge", True, "") as stage:
        pose = modes[0].pose
        residuals = posterior.contact_residuals(model, felt.contacts.moved(correction), pose, settings.verdict)
        share, rms = posterior.pixel_agreement(model, seen, pose)
        seeing = visibility(viewed, model, pose, settings.depth)
        word, why = posterior.verdict(model, modes, residuals, share, seeing, settings.verdict)
        stage.note(len(rows), why)

    return Estimate(
        frame=frame.index,
        pose=pose,
        covariance=modes[0].covariance,
        modes=modes,
        verdict=word,
        unobservable=posterior.unobservable(model, pose, modes[0].covariance, settings.verdict),
        hand_from_object=hand_from_object(frame, pose, correction),
        visible_fraction=seeing.visible,
        trace=trace.stages,
        contacts=residuals,
        pixel_rms_mm=1e3 * rms,
        notes=(why, *doubts(viewed, looked.hand_view, settings.calibration)),
        dropped=looked.dropped,
        start=start,
        contributions=posterior.contributions(model, rows, pose, believed),
    )
