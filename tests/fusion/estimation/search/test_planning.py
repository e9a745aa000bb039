"""Searches that end early: when a few starts may speak for all, and what makes them doubt."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.estimation.estimate import estimate
from fusion.estimation.search.modes import Found, PlanSettings, find_modes, valley_steps, worth_solving
from fusion.estimation.search.proposals import ProposalSettings, search_stages
from fusion.estimation.settings import EstimateSettings
from scenes.evidence import table as evidence
from scenes.evidence.align import Prior
from scenes.evidence.modes import Mode, ModeSettings
from scenes.evidence.search import leaders, starts_around
from scenes.evidence.symmetry.near_symmetries import near_symmetries
from scenes.evidence.table import SIGMA, SIGMA_NORMAL, TOUCH, VISION
from scenes.geometry import poses
from scenes.synthesis import library

STAGES = search_stages(0.01, ProposalSettings().near)


def scene(model, noise=0.001, seed=0, pixels=300):
    """Pixels all over an object, contacts, and starts within 10 degrees and 2 cm of it."""
    rng = np.random.default_rng(seed)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.0, 0.5])
    points, normals = model.sample_surface(pixels + 5, seed=seed)
    points = poses.apply(truth, points + noise * rng.normal(size=points.shape))
    seen = evidence.make(points[:pixels], 0.002, VISION, gate_above=2.5, gate_below=5.0)
    felt = evidence.make(points[pixels:], 0.001, TOUCH, normals=normals[pixels:] @ truth[:3, :3].T, sigma_normal=0.09)
    start = poses.displaced(truth, np.deg2rad(10.0), 0.02, model.centroid, rng)
    starts = starts_around(model, start, np.deg2rad(10.0), 0.02, 320, rng)
    return truth, evidence.stack(seen, felt), starts, Prior.isotropic(start, np.deg2rad(10.0), 0.02)


def nothing_past(candidates, blur):
    return np.zeros(len(candidates))


def find(model, rows, starts, prior, rank=nothing_past, settings=None):
    return find_modes(model, rows, starts, STAGES, prior, rank, settings or PlanSettings(), ModeSettings())


def test_an_easy_scene_needs_few_starts_and_loses_nothing(drill):
    truth, rows, starts, prior = scene(drill)
    quick = find(drill, rows, starts, prior)
    whole = find(drill, rows, starts, prior, settings=PlanSettings(skipping=False))
    assert quick.looked_at == PlanSettings().first_starts
    assert whole.looked_at == len(starts)
    difference = poses.difference(quick.modes[0].pose, whole.modes[0].pose, drill.centroid)
    assert np.linalg.norm(difference[:3]) < 1e-3
    assert np.linalg.norm(difference[3:]) < 1e-4
    assert np.linalg.norm(poses.difference(quick.modes[0].pose, truth, drill.centroid)[3:]) < 1e-3


@pytest.mark.parametrize(
    ("spoil", "word"),
    [("pixels", "pixels"), ("contacts", "contacts"), ("past", "past"), ("few", "few pixels")],
)
def test_what_is_not_explained_is_looked_at_in_full(drill, spoil, word):
    _, rows, starts, prior = scene(drill, pixels=30 if spoil == "few" else 300)
    rank = nothing_past
    if spoil == "pixels":  # a third of the pixels are a finger's, 3 cm nearer
        rows.rows[:100, 2] -= 0.03
    elif spoil == "contacts":
        rows.rows[-3:, 2] -= 0.03
        rows.rows[-3:, 9:11] = 3.0
    elif spoil == "past":
        rank = lambda candidates, blur: np.full(len(candidates), 50.0)  # noqa: E731
    found = find(drill, rows, starts, prior, rank)
    assert found.looked_at == len(starts)
    assert word in found.why


def test_without_a_prior_nothing_is_skipped(drill):
    _, rows, starts, _ = scene(drill)
    assert find(drill, rows, starts, None).looked_at == len(starts)


def test_modes_that_cannot_win_are_not_solved():
    shares, told = (0.0005, 0.9, 0.0995, 1e-5), ModeSettings(width=0.0)
    modes = tuple(Mode(np.eye(4) * k, w, -np.log(w), np.eye(6)) for k, w in enumerate(shares))
    found = Found(modes, 1, "")
    assert len(worth_solving(found, PlanSettings(), 5, told)) == 3  # the first is the answer so far, whatever it weighs
    assert len(worth_solving(found, PlanSettings(skipping=False), 5, told)) == 4
    felt = 9.0 * np.eye(4)
    worth = worth_solving(replace(found, also=(felt,)), PlanSettings(skipping=False), 2, told)
    assert [pose[0, 0] for pose in worth] == [0.0, 1.0, 9.0]  # what touch says is solved, however unlikely it seems
    # one that is narrow beside what nothing ties weighs little until both are solved
    narrow = Mode(4.0 * np.eye(4), 1e-6, 4.0, 1e-6 * np.eye(6))
    both = replace(found, modes=(Mode(np.eye(4), 1.0, 0.0, np.eye(6)), narrow))
    assert len(worth_solving(both, PlanSettings(), 5, ModeSettings(temper=0.5, width=-0.5))) == 2
    assert len(worth_solving(both, PlanSettings(), 5, ModeSettings())) == 1


def test_with_contacts_alone_places_beside_a_mode_are_solved_too():
    """They are one mode while calibration is believed; each is another end of the search, as likely, and apart."""
    block, settings, modes = library.make("l_block"), PlanSettings(), ModeSettings()
    _, rows, starts, prior = scene(block, noise=0.003)
    contacts = rows.rows[rows.sense == TOUCH][:4]
    contacts[:, [SIGMA, SIGMA_NORMAL]] = 0.003, 0.2
    felt = evidence.Evidence(contacts, np.full(4, TOUCH))
    found = find(block, felt, starts, prior)
    assert 3 <= len(found.also) <= settings.beside
    apart = settings.beside_together * modes.merge_share * block.radius
    all_of_them = np.array([*(mode.pose for mode in found.modes), *found.also])
    assert len(leaders(block, all_of_them, apart)[0]) == len(all_of_them)
    # where a picture judges, it is not needed
    assert find_modes(block, felt, starts, STAGES, prior, nothing_past, settings, modes, 200).also == ()


@pytest.mark.parametrize("seed", range(3))
def test_valleys_lead_to_the_minimum_that_blur_hides(seed):
    """A mug whose start is turned by 80 degrees: blurred, the handle does not pull; the valley ends at the truth."""
    mug, rng = library.make("mug"), np.random.default_rng(seed)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.0, 0.5])
    points, _ = mug.sample_surface(400, seed=seed)
    moved = poses.apply(truth, points + 0.0005 * rng.normal(size=points.shape))
    rows = evidence.make(moved, 0.002, VISION, gate_above=2.5, gate_below=5.0)
    turned = truth @ poses.make_pose(poses.exp_rotation([0.0, 0.0, np.deg2rad(80.0)]), [0.0, 0.0, 0.0])
    prior = Prior.isotropic(turned, np.deg2rad(40.0), 0.02)
    found = find(mug, rows, turned[None], prior)
    error = poses.difference(found.modes[0].pose, truth, mug.centroid)
    assert np.degrees(np.linalg.norm(error[:3])) < 2.0


def test_no_valley_through_a_pose_that_is_sure_when_blurred(drill):
    _, rows, _, prior = scene(drill)
    sure = Prior(prior.pose, 1e12 * np.eye(6))
    steps = valley_steps(drill, rows, prior.pose, STAGES[0], sure, PlanSettings(), ModeSettings())
    assert len(steps) == len(near_symmetries(drill))


def test_what_vision_alone_does_not_know_well_enough_is_asked_of_both_and_looked_at_once(lab_frame, drill):
    usual = estimate(lab_frame, drill)
    strict = estimate(lab_frame, drill, tolerance=(1e-6, 1e-6))
    names = [stage.name for stage in strict.trace]
    assert names.count("look") == names.count("solve together") == names.count("judge") == 1
    assert [stage.ran for stage in strict.trace if stage.name == "feel"] == [False, True]
    assert (strict.pose == usual.pose).all()
    assert (strict.covariance == usual.covariance).all()


@pytest.mark.parametrize("again", [0, 2])
def test_pairs_are_drawn_again_where_nobody_says_which_pixels_are_the_objects(lab_frame, again):
    """A mug is looked for where none is: the best stays in doubt, and every draw says so in the trace."""
    bare = replace(lab_frame, mask=None, prior=None, hand=None, joints=None, world_from_hand=None).without_touch()
    usual = EstimateSettings()
    settings = replace(usual, plan=replace(usual.plan, drawn_again=again, anew=0.0))
    answer = estimate(bare, library.make("mug"), use=("vision",), settings=settings)
    assert answer.verdict != "ok"
    drawn = [stage for stage in answer.trace if stage.name.startswith("propose: many pairs") and stage.ran]
    assert len(drawn) == 1 + again
    assert answer.pose.tolist() == estimate(bare, library.make("mug"), use=("vision",), settings=settings).pose.tolist()
