"""Walks by the whole objective, the judging of given poses, and what the trace says of every source."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import estimate
from fusion.estimation.search.walk import WalkSettings, walk
from fusion.estimation.steps.judge import judge
from scenes.errors import InputError
from scenes.evidence.search import starts_around
from scenes.geometry import poses
from scenes.recordings.frames import Contacts


def test_a_walk_ends_where_the_cost_is_least_and_the_same_every_time(drill):
    truth = poses.make_pose(None, [0.0, 0.0, 0.5])

    def costs(candidates):
        delta = poses.difference(candidates, truth, drill.centroid)
        return np.square(delta / np.repeat([0.05, 0.005], 3)).sum(axis=1)

    starts = starts_around(drill, truth, 0.3, 0.03, 100, np.random.default_rng(0))[1:]
    first, again = (walk(drill, starts, costs, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert 1 <= len(first) <= WalkSettings().rounds[-1][0]
    assert costs(first[:1])[0] < 0.5 * costs(starts).min()
    assert (np.diff(costs(first)) >= 0).all()
    assert not len(walk(drill, np.zeros((0, 4, 4)), costs, np.random.default_rng(0)))


def test_a_place_where_few_begin_is_not_lost_to_one_where_many_do(drill):
    """A wide basin draws all that goes on; the deeper one beside it is narrow, and few begin there, less well."""
    wide, deep = poses.make_pose(None, [0.0, 0.0, 0.5]), poses.make_pose(None, [0.4, 0.0, 0.5])

    def costs(candidates):
        to_wide, to_deep = (poses.difference(candidates, place, drill.centroid) for place in (wide, deep))
        in_wide = 0.1 * np.square(to_wide / np.repeat([0.3, 0.03], 3)).sum(axis=1)
        in_deep = np.square(to_deep / np.repeat([0.1, 0.01], 3)).sum(axis=1) - 3.0
        return np.minimum(in_wide, in_deep)

    rng = np.random.default_rng(0)
    many = starts_around(drill, wide, 0.3, 0.03, 200, rng)[1:]
    few = starts_around(drill, deep, 0.3, 0.02, 12, rng)[1:]
    starts = np.concatenate([many, few])
    assert costs(few).min() > np.sort(costs(many))[30]
    lost, found = (
        walk(drill, starts, costs, np.random.default_rng(3), WalkSettings(of_places=share)) for share in (0.0, 0.5)
    )
    assert costs(lost)[0] > -1.0
    assert costs(found)[0] < -1.0
    assert len(found) <= WalkSettings().rounds[-1][0]


def test_poses_are_judged_in_their_order_and_the_true_one_is_likelier(lab_frame, drill):
    truth = lab_frame.camera_from_object_truth
    wrong = poses.perturb(truth, [0.9, 0.0, 0.0, 0.03, 0.0, 0.0], drill.centroid)
    both = judge(lab_frame, drill, np.array([wrong, truth]))
    turned = judge(lab_frame, drill, np.array([truth, wrong]))
    assert both.costs[1] < both.costs[0]
    assert both.fitted_costs[1] < both.fitted_costs[0]
    np.testing.assert_allclose(both.costs, turned.costs[::-1])
    np.testing.assert_allclose(both.poses, turned.poses[::-1])
    near = poses.difference(both.poses[1], truth, drill.centroid)
    assert np.linalg.norm(near[3:]) < 0.005


@pytest.mark.parametrize("count", [0, 9])
def test_so_many_poses_are_not_judged(lab_frame, drill, count):
    with pytest.raises(InputError, match="judge: expected 1 to"):
        judge(lab_frame, drill, np.tile(np.eye(4), (count, 1, 1)))


def test_a_frame_that_tells_nothing_has_no_costs(lab_frame, drill):
    bare = replace(lab_frame.without_vision(), contacts=Contacts(np.zeros((0, 3))), hand=None, joints=None, prior=None)
    with pytest.raises(InputError, match="expected some evidence"):
        judge(bare, drill, np.eye(4)[None])


def test_every_source_of_proposals_has_its_line_in_the_trace(lab_frame, drill):
    near = estimate(replace(lab_frame, prior=lab_frame.camera_from_object_truth), drill)
    lines = {stage.name: stage for stage in near.trace if stage.name.startswith("propose")}
    assert lines["propose: at a glance"].ran
    assert not lines["propose: rows"].ran
    walked = next(stage for name, stage in lines.items() if "walk" in name)
    assert not walked.ran
    assert "explains what is seen" in walked.why
    assert "hand" in walked.name
    assert all(stage.ms >= 0.0 for stage in near.trace)
