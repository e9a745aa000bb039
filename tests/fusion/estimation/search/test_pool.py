"""One pool of proposals: what touch and the table add, what convinces, and joint solutions that the picture refuses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fusion import estimate
from fusion.estimation.asked import Asked
from fusion.estimation.ranking import guarded
from fusion.estimation.search.modes import Found, PlanSettings
from fusion.estimation.search.pool import Pool
from fusion.estimation.search.pool_settings import PoolSettings
from fusion.estimation.search.proposals import ProposalSettings, search_stages
from fusion.estimation.search.sources import Competition, glance, modes_near
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.solve.joint import JointResult
from fusion.estimation.steps.sense import look_once, sense
from fusion.estimation.trace import Trace
from fusion.truth.errors import Judge
from scenes.evidence import table as tables
from scenes.evidence.align import Alignment, Prior, costs
from scenes.evidence.modes import Mode, ModeSettings
from scenes.evidence.search import starts_around
from scenes.evidence.symmetry.near_symmetries import quarter_turns
from scenes.geometry import poses
from scenes.synthesis import library
from scenes.synthesis.recording import synthesize_frames
from scenes.synthesis.settings import SynthesisSettings

SETTINGS = SynthesisSettings(rgb=False)


def add_s(model, answer, frame):
    return Judge(model).errors(answer.pose, frame.camera_from_object_truth, answer.covariance).add_s


@pytest.mark.parametrize("hidden", [0.6, 0.9])
def test_fused_is_as_good_as_touch_where_unknown_fingers_hide_the_object(hidden):
    """Loose fingers that nobody has a model of fill the image; what all contacts explain is proposed and wins."""
    model = library.make("bottle")
    frames = synthesize_frames(model, None, 2, hidden, noise="lab", seed=71, settings=SETTINGS)
    for frame in frames:
        both, touch = estimate(frame, model), estimate(frame, model, use=("touch",))
        assert add_s(model, both, frame) < max(0.005, 1.2 * add_s(model, touch, frame))


@pytest.mark.parametrize(("name", "seed"), [("mug", 3), ("drill", 4), ("box", 5)])
def test_fused_is_right_where_vision_or_touch_alone_is(name, seed):
    model = library.make(name)
    frame = synthesize_frames(model, None, 1, 0.8, noise="lab", seed=seed, settings=SETTINGS)[0]
    alone = [add_s(model, estimate(frame, model, use=(sense,)), frame) for sense in ("vision", "touch")]
    assert add_s(model, estimate(frame, model), frame) < max(0.005, min(alone))


def test_an_object_on_a_table_is_found_without_a_mask_and_without_a_start():
    model = library.make("mug")
    frame = synthesize_frames(
        model, None, 1, 0.0, touch=(), noise="lab", seed=5, occluders="none", settings=SETTINGS, scene="table"
    )[0]
    near = estimate(frame, model)
    anywhere = estimate(replace(frame, prior=None), model)
    assert add_s(model, near, frame) < 0.005
    assert add_s(model, anywhere, frame) < 0.005 or anywhere.verdict != "ok"


def test_few_starts_that_explain_what_is_seen_end_the_search(lab_frame, drill):
    near = replace(lab_frame, prior=lab_frame.camera_from_object_truth)
    settings = EstimateSettings()
    doubting = replace(settings, pool=replace(settings.pool, least_agree=1.01))
    quick, slow = estimate(near, drill), estimate(near, drill, settings=doubting)
    why = [next(stage.why for stage in answer.trace if stage.name == "search") for answer in (quick, slow)]
    assert why[0].startswith(f"{ProposalSettings().starts_glanced} of 320 starts")
    assert not why[1].startswith(f"{ProposalSettings().starts_glanced} of")
    assert all(add_s(drill, answer, near) < 0.003 for answer in (quick, slow))


def test_a_whole_search_knows_nothing_of_a_glance_that_left_a_doubt(sensed, lab_frame):
    pool = replace(sensed.pool, settings=replace(PoolSettings(), least_agree=1.01))
    pool = replace(pool, felt=tables.empty(), contacts=0, fingers=0, rng=np.random.default_rng(5))
    before = pool.rng.bit_generator.state
    starts = np.tile(lab_frame.camera_from_object_truth, (8, 1, 1))
    assert not glance(pool, sensed.seen, starts, trace := Trace()).why
    assert pool.rng.bit_generator.state == before
    assert [stage.name for stage in trace.stages] == ["propose: at a glance"]


@pytest.mark.parametrize(("told_apart", "enough"), [(True, True), (False, False)])
def test_without_touch_a_glance_that_convinces_is_enough_where_the_hand_is_known(
    sensed, lab_frame, monkeypatch, told_apart, enough
):
    pool = replace(
        sensed.pool, settings=replace(PoolSettings(), glance_shown=1.01), felt=tables.empty(), contacts=0, fingers=0
    )
    monkeypatch.setattr(type(pool.predictor), "told_apart", told_apart)
    starts = np.tile(lab_frame.camera_from_object_truth, (8, 1, 1))
    found = glance(pool, sensed.seen, starts, trace := Trace())
    assert bool(found.why) == enough
    asked = [stage.name for stage in trace.stages]
    assert asked[0] == "propose: at a glance"
    assert ("propose: around the best" in asked) == enough


@pytest.mark.parametrize(("least", "enough"), [(0.1, True), (1.01, False)])
def test_where_less_agrees_a_glance_is_enough_if_no_turn_is_likelier(sensed, lab_frame, monkeypatch, least, enough):
    settings = replace(PoolSettings(), glance_shown=1.01, glance_enough=least)
    pool = replace(sensed.pool, settings=settings, felt=tables.empty(), contacts=0, fingers=0)
    monkeypatch.setattr(type(pool), "shows_most", lambda own, pose, share=0.0: 0.0 < share < 1.0)
    starts = np.tile(lab_frame.camera_from_object_truth, (8, 1, 1))
    found = glance(pool, sensed.seen, starts, trace := Trace())
    assert bool(found.why) == enough
    ran = [stage.name for stage in trace.stages if stage.ran]
    assert ("propose: the best turned" in ran) == enough


@pytest.mark.parametrize(("costlier", "convinces"), [(9.0, True), (5.0, False)])
def test_a_wide_mode_is_a_doubt_only_where_it_does_not_cost_far_more(sensed, lab_frame, costlier, convinces):
    truth, wide = lab_frame.camera_from_object_truth, np.eye(6)
    first = Mode(truth, 0.2, -8.0, 1e-6 * wide)
    beside = Mode(poses.displaced(truth, 0.2, 0.01, np.zeros(3), np.random.default_rng(0)), 0.8, costlier - 8.0, wide)
    assert sensed.pool.convinces((replace(first, weight=1.0),))
    assert sensed.pool.convinces((first, beside)) == convinces


def test_a_glance_does_not_tell_apart_what_nearly_looks_the_same(sensed, lab_frame, monkeypatch):
    pool, truth = sensed.pool, lab_frame.camera_from_object_truth
    seen = replace(pool, settings=replace(PoolSettings(), glance_shown=0.0, glance_share=0.0, glance_share_felt=0.0))
    assert seen.explains_at_a_glance(truth)
    alike = poses.perturb(np.eye(4), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-4]), np.zeros(3))
    monkeypatch.setattr("fusion.estimation.search.pool.near_symmetries", lambda _: alike[None])
    assert not seen.explains_at_a_glance(truth)


def test_without_a_start_what_explains_the_image_at_a_glance_ends_the_search(drill):
    frame = synthesize_frames(drill, None, 1, 0.0, noise="clean", seed=3, occluders="none", settings=SETTINGS)[0]
    frame = replace(frame, prior=None)
    settings = EstimateSettings()
    everything = replace(settings, plan=replace(settings.plan, skipping=False))
    quick, slow = (estimate(frame, drill, settings=s) for s in (settings, everything))
    asked = [{stage.name: stage for stage in answer.trace} for answer in (quick, slow)]
    assert asked[0]["search"].why.startswith("pairs of pixels")
    skipped = {name for name, stage in asked[0].items() if name.startswith("propose: ") and not stage.ran}
    assert any(name.startswith("propose: many pairs of pixels") for name in skipped)
    assert "propose: each piece alone" in skipped
    assert any(name.startswith("propose: many pairs") and stage.ran for name, stage in asked[1].items())
    assert all(add_s(drill, answer, frame) < 0.003 for answer in (quick, slow))


@pytest.fixture(scope="module")
def sensed(lab_frame, drill):
    """What judges poses of one frame."""
    asked = Asked.of(lab_frame)
    return sense(lab_frame, drill, asked, Trace(), look_once(drill, asked, Trace()))


def test_what_was_fitted_is_not_fitted_again(sensed, lab_frame, monkeypatch):
    pool, truth = sensed.pool, lab_frame.camera_from_object_truth
    known = pool.fitted(truth[None])
    monkeypatch.setattr("fusion.estimation.search.pool.align_each", lambda *_: pytest.fail("nothing is to be fitted"))
    again = pool.fitted(known.poses, known=known)
    np.testing.assert_array_equal(again.poses, known.poses)
    np.testing.assert_array_equal(again.costs, known.costs)
    none = pool.fitted(np.zeros((0, 4, 4)), known=known)
    np.testing.assert_array_equal(none.hessians, known.hessians)


def test_what_takes_no_step_is_not_looked_at_more_closely(sensed, lab_frame, monkeypatch):
    """A fit that ends costlier stays where it was: the closer look of the next round is for those that moved."""
    pool, truth, looked = sensed.pool, lab_frame.camera_from_object_truth, []
    shown, off = Pool.evidence_of_each, poses.perturb(truth, np.full(6, 0.5), sensed.pool.model.centroid)

    def worse(model, own, shared, starts, prior, settings):
        return Alignment(np.array([off]), np.zeros(1), np.eye(6)[None], np.ones(1, dtype=np.int64))

    monkeypatch.setattr("fusion.estimation.search.pool.align_each", worse)
    monkeypatch.setattr(
        Pool, "evidence_of_each", lambda self, many, side, most: looked.append(side) or shown(self, many, side, most)
    )
    found = pool.fitted(truth[None])
    np.testing.assert_array_equal(found.poses, truth[None])
    assert looked == [pool.settings.sides[0]]


def test_draws_around_the_best_cast_doubt_where_one_is_likelier(sensed, lab_frame, drill):
    pool, truth = sensed.pool, lab_frame.camera_from_object_truth
    off = poses.perturb(truth, np.array([0.0, 0.0, 0.15, 0.012, 0.0, 0.0]), drill.centroid)
    asked = Competition(pool, Trace())
    asked.fitted = Alignment(off[None], pool.costs(off[None]), np.eye(6)[None], np.zeros(1, dtype=np.int64))
    asked.modes, asked.convinced = (Mode(off, 1.0, float(asked.fitted.costs[0]), np.eye(6)),), True
    asked.look_around()
    assert not asked.convinced
    assert asked.modes[0].cost < pool.costs(off[None])[0] - PoolSettings().bettered
    assert asked.trace.stages[-1].name == "propose: around the best"


def test_without_a_start_the_whole_objective_says_what_touch_proposes(sensed, lab_frame, drill, rng):
    """Of poses that explain the contacts, those that are seen come first; near a prior those that touch finds best."""
    anywhere = replace(sensed.pool, prior=None)
    around = starts_around(drill, lab_frame.camera_from_object_truth, 0.3, 0.02, 60, rng)
    stages = search_stages(0.01, ProposalSettings().near)
    ends = anywhere.by_touch(around, stages)
    assert 1 < len(ends) <= PoolSettings().by_touch
    assert (np.diff(anywhere.walking(ends)) >= 0.0).all()
    by_touch = costs(drill, anywhere.felt, sensed.pool.by_touch(around, stages), sensed.pool.prior)
    assert by_touch[0] == pytest.approx(by_touch.min(), abs=0.5)
    assert replace(anywhere, felt=tables.empty(), contacts=0, fingers=0).by_touch(around, stages).shape == (0, 4, 4)


def test_very_many_pairs_of_pixels_propose_the_truth(sensed, lab_frame, drill):
    pool, truth = replace(sensed.pool, prior=None), lab_frame.camera_from_object_truth
    proposed, again = (replace(pool, rng=np.random.default_rng(5)).paired() for _ in range(2))
    np.testing.assert_array_equal(proposed, again)
    assert 20 < len(proposed) <= ProposalSettings().paired.keep_pairs
    assert (np.diff(pool.walking(proposed)) >= 0.0).all()
    errors = [Judge(drill).errors(pose, truth).add_s for pose in proposed[:10]]
    assert min(errors) < 0.01
    blind = replace(pool, looked=replace(pool.looked, pixels=pool.looked.pixels.take(np.zeros(0, dtype=int))))
    assert blind.paired().shape == (0, 4, 4)


def test_turned_poses_lie_on_what_is_seen(sensed, lab_frame, drill):
    pool = sensed.pool
    best = pool.compete(lab_frame.camera_from_object_truth[None])[0]
    turned = pool.turned(best)
    assert len(turned) < 23
    assert (pool.walking(turned) < best.cost + PoolSettings().promising).all()
    flipped = best.pose @ quarter_turns(drill)[0]
    back = pool.turned(replace(best, pose=flipped, cost=best.cost))
    assert np.abs(back - best.pose).max(axis=(1, 2)).min() < 0.05  # and the right way round is among them


class Rounds:
    """A pool in which nothing happens but rounds: the ends of the searches, one a round, and whether they convince."""

    def __init__(self, model, ends, shown=0.0):
        self.model, self.ends, self.shown, self.looked_at = model, iter(ends), shown, []
        self.settings, self.modes, self.prior = PoolSettings(), ModeSettings(), SimpleNamespace(pose=np.eye(4))
        self.predictor, self.tied = SimpleNamespace(sees=True, told_apart=True), False
        self.turns_freely = True
        self.sight = SimpleNamespace(costs=None)
        self.felt, self.held, self.rng, self.walking = tables.empty(), None, None, None
        self.proposals = ProposalSettings()

    apart, is_same, held_starts, among = Pool.apart, Pool.is_same, Pool.held_starts, Pool.among

    def by_touch(self, starts, stages):
        self.looked_at.append(len(starts))
        return np.zeros((0, 4, 4))

    def descended(self, seen, start, starts, descents):
        return np.zeros((0, 4, 4))

    def fitted(self, candidates, most=None, known=None):
        return Alignment(candidates[:1], np.zeros(1), np.eye(6)[None], np.zeros(1, dtype=np.int64))

    def sifted(self, candidates):
        return candidates

    def glanced(self, rows):
        return np.zeros((0, 4, 4))

    def costs(self, candidates):
        return np.full(len(candidates), np.inf)

    def explains(self, pose):
        return False

    def convinces(self, modes, shown=None):
        return self.shown > (0.1 if shown is None else shown)

    def walk(self, model=None, starts=(), *_):
        if len(starts) == 1:  # around the best there is nothing else
            return starts
        return poses.make_pose(None, [next(self.ends), 0.0, 0.0])[None]

    def end(self, *_):
        return Found((Mode(self.walk()[0], 1.0, 0.0, np.eye(6)),), 0, "")


@pytest.mark.parametrize(
    ("ends", "shown", "looked_at", "why"),
    [
        ([0.0], 0.9, [], "convincing"),
        ([0.0], 0.2, [20], "convincing"),
        ([0.0, 0.0005], 0.0, [20], "in doubt"),
        ([0.0, 0.05, 0.0505], 0.0, [20, 76], "in doubt"),
        ([0.0, 0.05, 0.1, 0.15], 0.0, [20, 76, 224], "in doubt"),
    ],
)
def test_rounds_of_fresh_starts_end_where_nothing_new_comes(drill, monkeypatch, ends, shown, looked_at, why):
    pool = Rounds(drill, ends, shown)
    monkeypatch.setattr("fusion.estimation.search.sources.find_modes", pool.end)
    monkeypatch.setattr("fusion.estimation.search.sources.walk", pool.walk)
    monkeypatch.setattr("fusion.estimation.search.sources.glance", lambda *_: None)
    starts = np.tile(np.eye(4), (320, 1, 1))
    found = modes_near(pool, None, None, starts, search_stages(0.01, ()), PlanSettings(), Trace())
    assert pool.looked_at == looked_at
    assert found.looked_at == (sum(looked_at) or 20)
    assert why in found.why


def glance_elsewhere(pool, costlier, monkeypatch):
    """A glance that found another pose, which costs so many nats more: that pose, and the starts of a search."""
    glanced = Competition(pool, Trace())
    pose = poses.make_pose(None, [0.1, 0.0, 0.0])
    glanced.fitted = Alignment(pose[None], np.array([costlier]), np.eye(6)[None], np.zeros(1, dtype=np.int64))
    glanced.modes = (Mode(pose, 1.0, costlier, np.eye(6)),)
    monkeypatch.setattr("fusion.estimation.search.sources.find_modes", pool.end)
    monkeypatch.setattr("fusion.estimation.search.sources.walk", pool.walk)
    monkeypatch.setattr("fusion.estimation.search.sources.glance", lambda *_: glanced)
    return pose, np.tile(np.eye(4), (320, 1, 1))


@pytest.mark.parametrize(("costlier", "tied", "walks"), [(1.0, True, False), (-1.0, True, False), (9.0, True, True)])
def test_what_a_glance_and_a_round_find_as_likely_is_walked_for_no_more(drill, monkeypatch, costlier, tied, walks):
    pool = Rounds(drill, [0.0, 0.0005])
    pool.tied = tied
    pose, starts = glance_elsewhere(pool, costlier, monkeypatch)
    found = modes_near(pool, None, None, starts, search_stages(0.01, ()), PlanSettings(), trace := Trace())
    assert next(stage.ran for stage in trace.stages if stage.name == "propose: a walk") == walks
    # and what the glance found stays where it is likelier
    assert (np.abs(found.modes[0].pose - pose).max() < 1e-9) == (costlier < 0.0)


@pytest.mark.parametrize(("costlier", "tied", "walks"), [(-9.0, True, True), (-9.0, False, True), (9.0, True, False)])
def test_what_a_glance_found_likelier_is_a_doubt_of_what_convinces(drill, monkeypatch, costlier, tied, walks):
    pool = Rounds(drill, [0.0] + [0.0005] * 8, shown=0.3)
    pool.tied = tied
    _, starts = glance_elsewhere(pool, costlier, monkeypatch)
    modes_near(pool, None, None, starts, search_stages(0.01, ()), PlanSettings(), trace := Trace())
    assert next(stage.ran for stage in trace.stages if stage.name == "propose: a walk") == walks


def test_a_piece_without_a_pixel_stands_for_no_pixel(sensed):
    pool = sensed.pool
    assert len(pool.seen().points) == len(pool.looked.pixels) > 0
    assert len(pool.seen(pool.looked.pixels.take(np.zeros(0, dtype=np.int64))).points) == 0


def test_pairs_of_pixels_are_asked_where_a_prior_leaves_turns_that_are_not_drawn(sensed, lab_frame):
    pose, free = lab_frame.camera_from_object_truth, Prior.isotropic(np.eye(4), 0.2, 0.02).information.copy()
    assert replace(sensed.pool, prior=None).turns_freely
    assert not replace(sensed.pool, prior=Prior(pose, free)).turns_freely
    free[2, 2] = 0.1  # about one axis it may be turned anyhow
    assert replace(sensed.pool, prior=Prior(pose, free)).turns_freely


def test_a_search_that_draws_bettered_does_not_end_by_what_a_glance_found(drill):
    pool = Rounds(drill, [])
    asked, glanced = (Competition(pool, Trace()) for _ in range(2))
    for one in (asked, glanced):
        one.fitted = Alignment(np.eye(4)[None], np.zeros(1), np.eye(6)[None], np.zeros(1, dtype=np.int64))
        one.modes = (Mode(np.eye(4), 1.0, 0.0, np.eye(6)),)
    asked.gained = PoolSettings().hardly + 0.1
    assert not asked.joins(glanced)
    asked.gained = 0.0
    assert asked.joins(glanced)


def test_places_within_a_mode_in_doubt_are_solved_too(drill):
    asked, plan = Competition(Rounds(drill, []), Trace()), PlanSettings(also=2, also_within=5.0)
    assert asked.found(0, plan).also == ()
    within = np.array([poses.make_pose(None, [0.001 * k, 0.0, 0.0]) for k in range(5)])
    nats = np.array([0.0, 1.0, 2.0, 3.0, 9.0])
    asked.fitted = Alignment(within, nats, np.tile(np.eye(6), (5, 1, 1)), np.zeros(5, dtype=np.int64))
    asked.modes = (Mode(within[0], 1.0, 0.0, np.eye(6)),)
    np.testing.assert_array_equal(asked.found(0, plan).also, within[1:3])
    assert len(asked.found(0, replace(plan, also=9)).also) == 3  # one costs too much
    asked.convinced = True
    assert asked.found(0, plan).also == ()


def test_what_little_is_seen_need_not_show_more_where_contacts_hold_the_object(sensed, lab_frame, monkeypatch):
    pool, first = sensed.pool, Mode(lab_frame.camera_from_object_truth, 1.0, -8.0, 1e-6 * np.eye(6))
    near = Prior.isotropic(first.pose, 0.2, 0.03)
    pool = replace(pool, settings=replace(PoolSettings(), least_shown=1.01), prior=near)
    assert pool.tied
    assert pool.convinces((first,))
    assert not replace(pool, prior=None).convinces((first,))
    assert not replace(pool, felt=tables.empty(), contacts=0, fingers=0).convinces((first,))
    monkeypatch.setattr(type(pool.predictor), "told_apart", False)
    assert not pool.convinces((first,))


def result(pose, scale=0.0):
    return JointResult(pose, 1e-6 * np.eye(6), np.ones(6), np.zeros(3), scale, 0.0, 0.0, 1.0, as_seen=pose)


def test_a_joint_solution_that_the_picture_refuses_is_not_taken(drill):
    start = poses.make_pose(None, [0.0, 0.0, 0.5])
    moved = poses.make_pose(None, [0.02, 0.0, 0.0]) @ start
    judge = SimpleNamespace(sees=True, costs=lambda candidates: 1e4 * np.abs(candidates[:, 0, 3]))
    pool = SimpleNamespace(model=drill, predictor=judge)
    kept = guarded(pool, [result(moved)], [start], None, EstimateSettings())[0]
    np.testing.assert_array_equal(kept.pose, start)
    assert not kept.xi.any()
    assert np.sqrt(kept.covariance[3, 3]) > 0.019  # as wide as the two are apart
    near = poses.make_pose(None, [0.002, 0.0, 0.0]) @ start
    assert guarded(pool, [result(near)], [start], None, EstimateSettings())[0].pose is near
