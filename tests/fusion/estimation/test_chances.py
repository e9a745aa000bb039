"""How sure an answer is: it falls with spread and contradictions, and its covariance holds what else may be."""

import numpy as np
import pytest
from predicted_twin import picture

from fusion import estimate
from fusion.estimation.posterior.confidence import ConfidenceSettings, chances, within
from fusion.estimation.posterior.spread import spread_of
from fusion.estimation.posterior.whole import told_covariance, whole_covariance
from scenes.evidence.align import Prior
from scenes.evidence.modes import Mode
from scenes.geometry import poses
from scenes.synthesis import library


def confidence(*answer):
    """The probability that an estimate states: that it is the right mode, and that near."""
    right, near = chances(*answer)
    return right * near


def sure(model, sigma, **shares):
    covariance = np.diag(np.repeat([(sigma / model.radius) ** 2, sigma**2], 3))
    modes = (Mode(np.eye(4), 1.0, 0.0, covariance),)
    return confidence(model, modes, picture(**shares), (), 0.0)


def test_confidence_falls_with_spread_and_contradictions(drill):
    good = sure(drill, 0.0005)
    assert good > ConfidenceSettings().sure
    # what is within the tolerance is no less than what is seen at the depth predicted
    worse = [
        [sure(drill, spread) for spread in (0.0005, 0.002, 0.005, 0.01)],
        [sure(drill, 0.0005, agree=0.95 - past, seen=0.9 - past, past=past) for past in (0.0, 0.05, 0.1, 0.2, 0.3)],
        [sure(drill, 0.0005, agree=0.6, seen=0.5, past=0.1, outline=outline) for outline in (0.0, 0.05, 0.1, 0.15)],
    ]
    for falling in worse:
        assert np.all(np.diff(falling) <= 0)
        assert falling[-1] < falling[0]
    # from a quarter on the verdict is lost, whatever this says
    assert sure(drill, 0.0005, past=0.5, agree=0.4, seen=0.35) < 0.9 * good
    assert sure(drill, 0.0005, past=0.2, agree=0.3, seen=0.25, outline=0.5) < 0.4 * good
    assert sure(drill, 0.0005, agree=0.3, seen=0.25, outline=0.5) < 0.9 * good
    # an outline that is seen to end where it should tells of the shape
    told = [sure(drill, 0.0005, agree=0.4, seen=0.35, past=0.1, ends=ends) for ends in (0.0, 0.1, 0.2, 0.4)]
    assert np.all(np.diff(told) > 0.0)
    # hidden is not contradicted
    assert sure(drill, 0.0005, agree=0.3, seen=0.28, hidden=0.7) > 0.5 * good
    for extreme in (0.0, 1e-9, 1e3):
        assert 0.0 <= sure(drill, extreme) <= 1.0


def test_without_a_picture_the_posterior_speaks(drill):
    def alone(weight, spread):
        return confidence(drill, (Mode(np.eye(4), weight, 0.0, spread * np.eye(6)),), None, (), 0.0)

    assert 0.9 < alone(1.0, 1e-12) <= 1.0
    assert alone(0.5, 1e-12) < alone(0.8, 1e-12) < alone(1.0, 1e-12)
    assert alone(1.0, 1.0) < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_the_chance_of_being_near_is_that_of_sampled_errors(drill, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) * np.repeat([0.02, 0.002], 3)[:, None]
    points, normals = drill.sample_surface(400, seed=1)
    steps = rng.normal(size=(1500, 6)) @ root.T
    moved = [poses.apply(poses.perturb(np.eye(4), step, drill.centroid), points) - points for step in steps]
    off = np.sqrt(np.mean(np.square(np.sum(moved * normals, axis=2)), axis=1))
    for limit in np.quantile(off, [0.2, 0.5, 0.9]):
        assert within(drill, np.eye(4), root @ root.T, limit, 1.0) == pytest.approx(np.mean(off < limit), abs=0.12)


def test_the_whole_covariance_holds_other_modes_and_none(drill):
    narrow = 1e-6 * np.eye(6)
    aside = poses.perturb(np.eye(4), np.array([0, 0, 0, 0.03, 0, 0]), drill.centroid)
    modes = (Mode(np.eye(4), 0.7, 0.0, narrow), Mode(aside, 0.3, 1.0, narrow))
    both = whole_covariance(drill, modes, 0.0, None)
    assert both[3, 3] == pytest.approx(1e-6 + 0.3 * 0.03**2)
    assert both[4, 4] == pytest.approx(1e-6)
    believed = Prior.isotropic(np.eye(4), 0.2, 0.02)
    none = whole_covariance(drill, modes[:1], 1.0, believed)
    assert 0.01 < np.sqrt(none[4, 4]) < 0.021
    assert np.linalg.eigvalsh(whole_covariance(drill, modes, 0.5, None)).min() > 0
    assert np.allclose(whole_covariance(drill, modes[:1], 0.0, None), narrow)


def test_a_mode_written_as_its_twin_is_no_farther_away():
    box = library.make("box")
    half = next(turn for turn in box.symmetries.discrete if poses.rotation_angle(turn[:3, :3]) > 1.0)
    aside = poses.perturb(np.eye(4), np.array([0.0, 0.2, 0.0, 0.01, 0.0, 0.0]), box.centroid)
    narrow, told = 1e-6 * np.eye(6), []
    for other in (aside, aside @ half):
        modes = Mode(np.eye(4), 0.7, 0.0, narrow), Mode(other, 0.3, 1.0, narrow)
        told.append(whole_covariance(box, modes, 0.5, Prior.isotropic(other, 0.2, 0.02)))
    np.testing.assert_allclose(told[1], told[0], rtol=1e-9, atol=1e-15)
    assert told[1][1, 1] < 0.2**2 + 0.2**2


def test_only_an_answer_that_is_as_right_as_can_be_is_its_first_mode_unless_it_is_ok(drill):
    how, narrow = ConfidenceSettings(), 1e-6 * np.eye(6)
    modes = (Mode(np.eye(4), 1.0, 0.0, narrow),)
    believed = Prior.isotropic(np.eye(4), 0.2, 0.02)
    assert np.allclose(told_covariance(drill, modes, "ambiguous", how.surest, believed), narrow)
    assert np.allclose(told_covariance(drill, modes, "ok", 0.96, believed), narrow)
    told = told_covariance(drill, modes, "ambiguous", 0.96, believed)
    # four in a hundred are as wide as the prior
    assert told[3, 3] == pytest.approx(1e-6 + 0.04 * 0.02**2, rel=0.1)
    assert how.none_of(0.96) == 0.0
    assert how.none_of(0.5) == pytest.approx(0.45)


def test_turns_about_an_objects_own_axis_are_no_spread():
    can = library.make("cylinder")
    axis = can.symmetries.axes[0].direction
    free = np.zeros((6, 6))
    free[:3, :3] = np.outer(axis, axis)
    assert spread_of(can, np.eye(4), free) < 1e-9
    assert spread_of(library.make("drill"), np.eye(4), free) > 0.01


def test_the_answer_says_how_sure_it_is(lab_frame, drill):
    answer = estimate(lab_frame, drill)
    assert 0.0 <= answer.confidence <= 1.0
    assert answer.to_json()["confidence"] == pytest.approx(answer.confidence)


def test_no_mode_is_much_surer_than_the_share_it_holds(drill):
    """Another place of the surface has a quarter of the posterior, whose odds count twice, however good the first."""
    turned = poses.make_pose(poses.exp_rotation([0.0, np.pi, 0.0]), [0.0, 0.0, 0.02])
    modes = tuple(Mode(pose, weight, 0.0, 1e-8 * np.eye(6)) for pose, weight in ((np.eye(4), 0.75), (turned, 0.25)))
    assert 0.5 < confidence(drill, modes, picture(agree=0.95, seen=0.95), (), 0.0) <= 0.9 + 1e-9
    assert confidence(drill, modes[:1], picture(agree=0.95, seen=0.95), (), 0.0) <= 0.9 + 1e-9
