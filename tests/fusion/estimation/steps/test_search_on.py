"""A search that ended early is taken up again where the answer made of it is in doubt."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import estimate
from fusion.benchmarks.families import making
from fusion.benchmarks.families.table import FAMILIES


@pytest.fixture(scope="module")
def doubtful():
    """A drill of which four fifths are hidden, and what convinces at first lies 18 mm off; its model and its judge."""
    family = FAMILIES["lab"]
    made = next(iter(making.frames_of(family, 0.8, 1, 201, ("drill",))))
    return replace(made.frame, prior=None), made.model, making.judge_for(family, made)


def searched_on(answer):
    return next(stage for stage in answer.trace if stage.name == "search on")


def test_what_convinced_and_is_not_ok_competes_with_all_sources(doubtful):
    frame, model, judge = doubtful
    answer = estimate(frame, model, use=("vision",))
    stage = searched_on(answer)
    assert stage.ran, stage.why
    assert judge.errors(answer.pose, frame.camera_from_object_truth).add_s < 0.005
    assert np.array_equal(estimate(frame, model, use=("vision",)).pose, answer.pose)
    # not where there is no time for it: that answer is wrong
    hurried = estimate(frame, model, use=("vision",), budget_ms=1.0)
    assert not searched_on(hurried).ran
    assert judge.errors(hurried.pose, frame.camera_from_object_truth).add_s > 0.005


def test_a_start_and_a_sure_answer_are_left_alone(lab_frame, drill):
    started = estimate(lab_frame, drill)
    assert searched_on(started).why == "the search began at a start"
    sure = estimate(replace(lab_frame, prior=None), drill)
    assert sure.verdict == "ok"
    assert not searched_on(sure).ran
