"""How far a covariance has a surface off: by the surface itself, turned and moved at random."""

import numpy as np
import pytest

from fusion.estimation.posterior.confidence import within
from fusion.estimation.posterior.spread import mean_square, spread_of
from fusion.estimation.posterior.verdict import open_directions
from fusion.tracking.memory.hypotheses import surface_apart
from scenes.evidence.symmetry.near_symmetries import turns_about
from scenes.geometry import poses
from scenes.synthesis import library

REST = 1e-8 * np.eye(6)


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def _about_axis(mug, angle):
    """Covariance (6, 6) of turns about the mug's own axis by an angle (rad, a standard deviation)."""
    turns = turns_about(mug)[0]
    step = poses.difference(np.array([turns[0], turns[-1]]), np.eye(4), mug.centroid)
    step = (step[0] - step[1]) / np.linalg.norm(step[0, :3] - step[1, :3])
    return angle**2 * np.outer(step, step) + REST


@pytest.mark.parametrize("degrees", [5.0, 30.0, 60.0, 104.0])
def test_a_turn_about_an_axis_of_roundness_is_as_far_off_as_it_moves_the_surface(mug, degrees):
    rng = np.random.default_rng(2)
    turns = turns_about(mug)[0]
    axis = poses.log_rotation(turns[0][:3, :3])
    axis = axis / np.linalg.norm(axis)
    centre = np.linalg.lstsq(np.eye(3) - turns[5][:3, :3], turns[5][:3, 3], rcond=None)[0]
    angles = np.deg2rad(degrees) * rng.normal(size=60)
    rotations = poses.exp_rotation(angles[:, None] * axis)
    turned = poses.make_poses(rotations, centre - rotations @ centre)
    off = np.array([surface_apart(mug, pose, np.eye(4)) for pose in turned])
    told = np.sqrt(mean_square(mug, np.eye(4), _about_axis(mug, np.deg2rad(degrees)))[0])
    assert 0.5 * np.sqrt(np.mean(off**2)) < told < 3.0 * np.sqrt(np.mean(off**2)) + 0.0005


def test_wider_turns_move_it_no_less_and_never_farther_than_any(mug):
    told = [spread_of(mug, np.eye(4), _about_axis(mug, np.deg2rad(angle))) for angle in range(1, 400, 7)]
    assert (np.diff(told) > -1e-6).all()
    assert told[-1] < 0.003
    assert within(mug, np.eye(4), _about_axis(mug, 1.8), 0.005, 0.7) > 0.99


def test_other_axes_and_objects_are_as_before(mug):
    over = np.diag([0.3**2, 0.0, 0.0, 0.0, 0.0, 0.0])
    drill = library.make("drill")
    for model in (mug, drill):
        slippage = np.trace(model.slippage @ over)
        assert mean_square(model, np.eye(4), over)[0] == pytest.approx(slippage, rel=1e-4)
    about = np.diag([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert mean_square(drill, np.eye(4), about)[0] == pytest.approx(np.trace(drill.slippage @ about), rel=1e-9)


def test_a_direction_is_open_unless_all_around_it_the_surface_stays_on_average(mug):
    wide = _about_axis(mug, 1.8)
    pose = poses.make_pose(poses.exp_rotation([0.3, 0.2, -0.5]), [0.0, 0.0, 0.5])
    block = np.kron(np.eye(2), pose[:3, :3])
    there = block @ wide @ block.T
    assert open_directions(mug, pose, there) == ("rotation about z",)
    assert open_directions(mug, pose, there, None, 0.005) == ("rotation about z",)
    assert open_directions(mug, pose, there, None, 0.005, True) == ()
    assert open_directions(mug, pose, there, None, 0.0005, True) == ("rotation about z",)
