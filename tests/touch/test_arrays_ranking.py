"""Modes told apart by the patterns of arrays: eq. 5.8 against its plain sum, weights, and whole estimates."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.benchmarks.arrays import grasps
from fusion.benchmarks.arrays.modes import random_hold
from fusion.estimation.ranking import beyond_rows
from fusion.estimation.settings import EstimateSettings
from scenes.evidence import align as alignment
from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.recordings.frames import Frame
from scenes.synthesis import library
from touch.arrays.cloud import CloudSettings, surface_cloud
from touch.arrays.costs import ArrayProblem, MatchingSettings
from touch.arrays.ranking import RankingSettings, mismatch, pattern_costs, reweighted
from touch.arrays.rows import taxel_rows

MATCHING = MatchingSettings(height=0.004, cloud=CloudSettings(area=2e-5))
RANKING = RankingSettings(matching=MATCHING)


@pytest.fixture(scope="module")
def held():
    truth, readings = grasps.recordings("a", 1, [3])[0]
    return grasps.hold("a").model, truth, readings


def around(truth, model, count=8):
    rng = np.random.default_rng(0)
    return se3.perturb(truth, rng.normal(size=(count, 6)) * ([0.1] * 3 + [0.003] * 3), model.centroid)


def test_the_mismatch_is_eq_5_8_summed_over_contacts(held):
    model, truth, readings = held
    problem = ArrayProblem(model, readings, MATCHING)
    cloud = surface_cloud(model, MATCHING.cloud).points
    boxes, skins = problem._matching_arguments[10:12]
    for pose in around(truth, model):
        total = 0.0
        for d, box, skin in zip(problem.descriptors, boxes, skins):
            x, y, z = local = se3.apply(se3.inverse(d.frame_from_tangent) @ pose, cloud).T
            floor = skin[0] + skin[1] * x + skin[2] * y + skin[3] * x * x + skin[4] * x * y + skin[5] * y * y
            inside = (x >= box[0]) & (x <= box[1]) & (y >= box[2]) & (y <= box[3]) & (np.abs(z - floor) <= skin[6])
            enough = inside.sum() > 3
            total += np.linalg.norm((np.cov(local[:, inside]) if enough else 0.0) - d.covariance)
        assert mismatch(model, readings, pose[None], MATCHING)[0] == pytest.approx(total, rel=1e-6)


def test_patterns_prefer_the_truth_to_what_they_do_not_fit(held):
    model, truth, readings = held
    # a quarter turn about the middle of a box of unequal sides: other edges under the same pads
    turned = se3.perturb(truth, [0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0], model.centroid)
    both = np.stack([truth, turned])
    for settings in (RANKING, replace(RANKING, pressures=False), replace(RANKING, covariance=False)):
        costs = pattern_costs(model, readings, both, settings)
        assert costs[0] < costs[1] - 1.0
    whole = pattern_costs(model, readings, both, RANKING)
    parts = [pattern_costs(model, readings, both, replace(RANKING, **{k: False})) for k in ("pressures", "covariance")]
    np.testing.assert_allclose(whole, parts[0] + parts[1])
    silent = [replace(r, pressure=np.zeros(len(r.pressure))) for r in readings]
    np.testing.assert_array_equal(pattern_costs(model, silent, both, RANKING), 0.0)


def test_costs_reorder_modes_and_share_their_weights():
    modes = tuple(Mode(np.eye(4), w, c, np.eye(6)) for w, c in ((0.7, 1.0), (0.2, 2.0), (0.1, 3.0)))
    found = reweighted(modes, np.array([4.0, 0.0, 0.0]))
    assert [m.cost for m in found] == [2.0, 3.0, 5.0]
    assert sum(m.weight for m in found) == pytest.approx(1.0)
    assert found[0].weight / found[2].weight == pytest.approx(0.2 / 0.7 * np.exp(4.0))
    assert reweighted(modes[:1], np.array([7.0])) == modes[:1]
    assert reweighted((), np.zeros(0)) == ()
    hopeless = reweighted(modes, np.full(3, 1e6))
    assert sum(m.weight for m in hopeless) == pytest.approx(1.0)


class Solution:
    """What is asked of a joint solution."""

    def __init__(self, pose, correction):
        self.pose, self.correction = pose, correction

    def correct(self):
        return self.correction


def test_an_estimate_adds_patterns_in_place_of_their_rows(held, monkeypatch):
    model, truth, readings = held
    frame = Frame(0, "frame 0", None)
    off = se3.perturb(truth, [0.1, 0.0, 0.0, 0.001, 0.0, 0.002], model.centroid)
    correction = se3.make_pose(se3.exp_rotation([0.0, 0.01, 0.0]), [0.001, 0.0, 0.0])
    solved = [Solution(correction @ pose, correction) for pose in (truth, off)]
    settings = EstimateSettings(patterns=RANKING)
    # no arrays, a single solution, or no patterns wanted: nothing to add
    np.testing.assert_array_equal(beyond_rows(frame, model, solved, settings), 0.0)
    monkeypatch.setattr("fusion.estimation.ranking.readings_of", lambda frame: readings)
    np.testing.assert_array_equal(beyond_rows(frame, model, solved[:1], settings), 0.0)
    np.testing.assert_array_equal(beyond_rows(frame, model, solved, EstimateSettings(patterns=None)), 0.0)
    found = beyond_rows(frame, model, solved, settings)
    for k, pose in enumerate((truth, off)):
        rows = alignment.costs(model, taxel_rows(readings), pose[None])[0]
        expected = pattern_costs(model, readings, pose[None], RANKING)[0] - rows
        # the correction moves object and arrays alike; round-off moves points of the cloud over a box's border
        assert found[k] == pytest.approx(expected, rel=0.05, abs=0.5)


def test_random_holds_touch_the_object():
    model = library.make("cylinder")
    held = random_hold(model, np.random.default_rng(2))
    assert len(held.sensors) == 4
    for pose in held.pads:
        assert abs(model.field.distance(pose[None, :3, 3])[0]) < 0.012
    readings = grasps.record(held, np.eye(4), np.random.default_rng(0))
    assert sum(r.active.any() for r in readings) >= 3


def test_many_taxels_of_one_array_are_no_more_witnesses_and_one_array_may_be_wrong(held):
    model, truth, readings = held
    both, pressures = around(truth, model, 2), replace(RANKING, covariance=False)
    problem = ArrayProblem(model, readings)
    np.testing.assert_allclose(problem.forward_each(both).sum(axis=1), problem.forward(both), rtol=1e-12)
    often = [
        replace(r, taxels=np.tile(r.taxels, (10, 1)), pressure=np.tile(r.pressure, 10), unknown=[]) for r in readings
    ]
    few, many = (pattern_costs(model, told, both, pressures) for told in (readings, often))
    assert (many < 1.5 * few).all()
    # pressed by something else: all that it can cost any pose is what it takes to call it broken
    first = readings[0]
    hot = replace(often[0], pressure=np.full(len(often[0].pressure), 0.9 * first.layer.saturation))
    wrong = pattern_costs(model, [hot, *readings[1:]], both, pressures)
    assert (wrong < few + pressures.broken).all()
