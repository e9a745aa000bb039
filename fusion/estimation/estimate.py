"""One frame, one answer: look, feel, search, solve together, judge; look again where the answer says that it must.

Readable as the method: each step of `_estimate` is a module of `steps`, and each stage within it is named in the
trace, run or skipped with its reason.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked, check_kinds, check_limits, check_start, sure_to_be_within
from fusion.estimation.posterior.tolerance import good_enough
from fusion.estimation.settings import EstimateSettings, usual_settings
from fusion.estimation.steps.doubts.doubted import Question, doubted, on_the_hand
from fusion.estimation.steps.facing import check_print
from fusion.estimation.steps.proposed import finished_with_outline
from fusion.estimation.steps.searched import search_on, searched, searched_twice
from fusion.estimation.steps.sense import Sensed, look_again, look_once, sense, without_copy
from fusion.estimation.steps.told import nothing_told, told
from fusion.estimation.trace import Trace
from scenes.evidence.align import Prior
from scenes.evidence.point_pairs import built_pair_table
from scenes.evidence.symmetry.near_symmetries import near_symmetries
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.checking.validation import check_scale
from scenes.recordings.frames import Frame
from scenes.threads import one_blas_thread
from touch.gels.localize import build_tables
from vision.look.looked import Looked
from vision.picture.aspects import aspects_of

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
    settings = sure_to_be_within(settings or usual_settings(), sure_within, model)
    check_limits(tolerance, budget_ms, model)
    check_start(frame, prior)
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
            alone = _estimate(sense(frame, model, by_vision, trace, looked), by_vision, trace)
            if alone is not None and good_enough(model, alone, tolerance, settings):
                return trace.noting_budget(trace.skipping(alone, "feel", "vision alone is within the tolerance"))
        question, astray = on_the_hand(Question(frame, asked), looked)
        if astray:
            looked = look_once(model, question.asked, trace)
        answered = _answer(model, question, trace, looked)

        def ask(other: Question) -> tuple[Estimate, Sensed]:
            return _answer(model, other, trace, look_once(model, other.asked, trace))

        answer = doubted(model, question, looked, answered, ask, trace)
        answer = replace(answer, trace=trace.stages, notes=(*answer.notes, *astray))
    return trace.noting_budget(answer)


def _answer(model: ObjectModel, question: Question, trace: Trace, looked: Looked) -> tuple[Estimate, Sensed]:
    """One question's answer, looked for again where it leaves much of what was looked at unexplained; and what was
    sensed at first.
    """
    frame, asked = question.frame, question.asked
    sensed = sense(frame, model, asked, trace, looked)
    answer = _estimate(sensed, asked, trace)
    assert answer is not None
    left = without_copy(model, asked, looked, answer, trace)
    if left is not None:
        rest = look_once(model, left, trace)
        other = _estimate(sense(frame, model, left, trace, rest), left, trace)
        assert other is not None
        apart = se3.apply(other.pose, model.centroid[None]) - se3.apply(answer.pose, model.centroid[None])
        if other.verdict != "lost" and np.linalg.norm(apart) > model.radius:
            asked, looked, answer = left, rest, other
    again = look_again(model, asked, trace, looked, answer)
    if again is None:
        return answer, sensed
    other = _estimate(sense(frame, model, asked, trace, again), asked, trace)
    assert other is not None
    # where what is felt contradicts every pose, a look at more of the image has to be sure of one
    doubtful = looked.at_touch and answer.verdict == "lost"
    doubtful |= looked.empty and other.confidence < asked.settings.look.elsewhere
    if other.verdict == "ok" or not doubtful:
        answer = max(answer, other, key=lambda one: (one.verdict == "ok", one.confidence))
    return answer, sensed


def _estimate(sensed: Sensed, asked: Asked, trace: Trace) -> Estimate | None:
    if sensed.nothing:
        return nothing_told(sensed, asked, trace)
    found, end = finished_with_outline(searched(sensed, asked, trace), trace)
    if end is None:
        return None
    answer = told(found, end, asked.prior, trace)
    whole = search_on(found.found, asked, answer, trace)
    if whole is not None:
        found, end = finished_with_outline(searched(sensed, whole, trace, found.found.modes), trace)
        answer = answer if end is None else told(found, end, asked.prior, trace)
    other = searched_twice(sensed, found.found, asked, answer, trace, whole is not None)
    if other is not None:
        found, end = finished_with_outline(other, trace)
        answer = answer if end is None else told(found, end, asked.prior, trace)
    return answer
