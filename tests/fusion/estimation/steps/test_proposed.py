"""Where the image shows the outline elsewhere than depth does, its pose competes; one beside depth adds none."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import estimate
from fusion.benchmarks.families import making
from fusion.benchmarks.families.table import FAMILIES
from fusion.estimation.asked import Asked
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.steps.finished import finished
from fusion.estimation.steps.proposed import by_outline
from fusion.estimation.steps.searched import searched
from fusion.estimation.steps.sense import look_once, sense
from fusion.estimation.trace import Trace
from scenes.geometry import poses

NAME = "outline proposes"
PLAIN = EstimateSettings()
PLAIN = replace(PLAIN, contour=replace(PLAIN.contour, used=False, own=False))


def stages_of(trace):
    return [stage for stage in trace if stage.name == NAME]


@pytest.fixture(scope="module")
def searched_frame(lab_frame, drill):
    """What a search of a frame left, and what was made of it."""
    trace = Trace(None)
    asked = Asked.of(lab_frame, None, ("vision", "touch"), None, 0, EstimateSettings(), None)
    found = searched(sense(lab_frame, drill, asked, trace, look_once(drill, asked, trace)), asked, trace)
    return found, finished(found, trace)


def aside(pose, model, metres):
    return poses.perturb(pose, np.array([0.0, 0.0, 0.0, metres, 0.0, 0.0]), model.centroid)


def test_what_the_image_shows_elsewhere_competes(searched_frame, lab_frame, drill):
    """A search that ended 15 mm beside the truth, where the image has it."""
    found, end = searched_frame
    truth = lab_frame.camera_from_object_truth
    missed = replace(end, here=aside(truth, drill, 0.015), elsewhere=truth)
    trace = Trace(None)
    more = by_outline(found, missed, trace)
    fitted, shown = more.found.also[-2:]
    assert np.array_equal(shown, truth)
    assert np.linalg.norm(poses.difference(fitted, truth, drill.centroid)[3:]) < 0.004
    assert more.found.also[:-2] == found.found.also
    (stage,) = stages_of(trace.stages)
    assert stage.ran
    assert "nats where the image led" in stage.why
    assert float(stage.why.split()[0]) < 0.0


@pytest.mark.parametrize(
    ("metres", "said"),
    [
        (0.0, "which is where it was"),
        (0.003, "where the image"),  # a fit leads back, or what is fitted is less likely
        (0.2, "nats where the image has it"),  # far from all that is seen
    ],
)
def test_an_image_that_is_beside_depth_adds_nothing(searched_frame, drill, metres, said):
    found, end = searched_frame
    trace = Trace(None)
    assert by_outline(found, replace(end, elsewhere=aside(end.here, drill, metres)), trace) is None
    (stage,) = stages_of(trace.stages)
    assert said in stage.why


def test_nothing_is_proposed_where_image_and_depth_agree_or_there_is_no_time(searched_frame):
    found, end = searched_frame
    trace = Trace(None)
    assert by_outline(found, replace(end, elsewhere=None), trace) is None
    assert not trace.stages[-1].ran
    late = Trace(1e-6)
    assert by_outline(found, replace(end, elsewhere=end.here), late) is None
    assert late.stages[-1].why == "the time budget is spent"


@pytest.mark.parametrize(
    ("family", "level", "name", "use"),
    [("d435", 0.6, "bust", ("vision", "touch")), ("lab", 0.0, "l_block", ("vision",))],
)
def test_a_search_by_depth_that_missed_is_set_right(family, level, name, use):
    """3 and 4 mm off by depth and touch, which like it no better than where the image has the object."""
    family = FAMILIES[family]
    made = next(iter(making.frames_of(family, level, 1, 0, (name,))))
    judge, truth = making.judge_for(family, made), made.frame.camera_from_object_truth
    before = judge.errors(estimate(made.frame, made.model, use=use, settings=PLAIN).pose, truth).add_s
    answer = estimate(made.frame, made.model, use=use)
    assert stages_of(answer.trace)[0].ran
    assert judge.errors(answer.pose, truth).add_s < min(0.5 * before, 0.0015)
    assert answer.verdict == "ok"
    assert not any("registered" in note for note in answer.notes)
