"""An answer in doubt is searched for once more, from other draws, and what both searches left competes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fusion import estimate
from fusion.benchmarks.families import making
from fusion.benchmarks.families.table import FAMILIES
from fusion.estimation.search.modes import Found, PlanSettings
from fusion.estimation.search.pool import Pool
from fusion.estimation.search.pool_settings import PoolSettings
from fusion.estimation.search.sources import of_both
from fusion.estimation.settings import EstimateSettings
from fusion.tracking.answer import TrackSettings
from scenes.evidence.align import Alignment
from scenes.evidence.modes import ModeSettings, distinct_modes
from scenes.geometry import poses

ONCE = EstimateSettings(plan=PlanSettings(anew=0.0))


def stage_of(answer):
    return next(stage for stage in answer.trace if stage.name == "search twice")


@pytest.mark.parametrize(
    ("level", "name", "use", "start"),
    [(0.0, "hammer", ("vision",), True), (0.9, "mug", ("vision", "touch"), False)],
)
def test_what_one_search_missed_another_finds(level, name, use, start):
    """Nobody tells of the hand: a hammer of which all is seen 14 mm off, and a mug of which a tenth is 6 mm off."""
    family = FAMILIES["lab"]
    made = next(iter(making.frames_of(replace(family, mask=True), level, 1, 31, (name,))))
    frame = replace(made.frame, mask=None, hand=None, joints=None, world_from_hand=None)
    frame = frame if start else replace(frame, prior=None)
    judge, truth = making.judge_for(family, made), frame.camera_from_object_truth
    once = estimate(frame, made.model, use=use, seed=31, settings=ONCE)
    assert stage_of(once).why == "it is not asked for"
    assert once.verdict != "ok"
    assert judge.errors(once.pose, truth).add_s > 0.005
    answer = estimate(frame, made.model, use=use, seed=31)
    assert stage_of(answer).ran
    assert "elsewhere" in stage_of(answer).why
    assert answer.verdict == "ok"
    assert judge.errors(answer.pose, truth).add_s < 0.002
    np.testing.assert_array_equal(estimate(frame, made.model, use=use, seed=31).pose, answer.pose)
    # where there is no time for it the answer is what one search makes of it
    hurried = estimate(frame, made.model, use=use, seed=31, budget_ms=1.0)
    assert stage_of(hurried).why == "the time budget is spent"


def test_a_sure_answer_and_one_of_touch_alone_are_left_as_they_are(lab_frame, drill):
    sure = estimate(lab_frame, drill)
    assert (sure.verdict, stage_of(sure).why) == ("ok", "the answer is ok")
    felt = estimate(lab_frame, drill, use=("touch",))
    assert not stage_of(felt).ran
    assert felt.verdict == "ok" or stage_of(felt).why == "nothing is seen" or felt.confidence >= PlanSettings().anew


def test_a_track_searches_its_next_frame_instead():
    assert TrackSettings().first.plan.anew == 0.0


def left(model, places, nats):
    """What a search ended in: poses moved by so many metres, and what they cost."""
    ends = np.array([poses.make_pose(None, [x, 0.0, 0.5]) for x in places])
    information = np.diag([1e4] * 3 + [1e6] * 3)
    fitted = Alignment(ends, np.array(nats), np.tile(information, (len(ends), 1, 1)), np.zeros(len(ends), int))
    return Found(distinct_modes(model, fitted), 20, "", left=fitted)


class Merged:
    """A pool that merges what it is given."""

    def __init__(self, model):
        self.model, self.modes, self.settings = model, ModeSettings(), PoolSettings()

    apart, among = Pool.apart, Pool.among
    predictor, fingers = SimpleNamespace(told_apart=True), 0

    def convinces(self, modes, shown=None):
        return False


@pytest.mark.parametrize(
    ("places", "nats", "known"),
    [
        ([0.0], [0.2], True),  # where the first ended
        ([0.0], [-2.0], False),  # there, and likelier
        ([0.2], [5.0], False),  # another place that may win
        ([0.2], [14.0], True),  # one that cannot
        ([0.0, 0.2], [0.5, -3.0], False),
    ],
)
def test_only_what_is_new_and_may_win_is_solved(drill, places, nats, known):
    pool, first, second = Merged(drill), left(drill, [0.0, 0.1], [0.0, 3.0]), left(drill, places, nats)
    both = of_both(pool, first, second, PlanSettings())
    assert (both is first) == known
    if not known:
        costs = [mode.cost for mode in both.modes]
        assert min(nats) in costs
        assert costs == sorted(costs)
        assert both.looked_at == 40


def test_what_rows_alone_left_is_not_merged(drill):
    first = replace(left(drill, [0.0], [0.0]), left=None)
    assert of_both(Merged(drill), first, left(drill, [0.2], [-9.0]), PlanSettings()) is first
