"""How wide an answer is where contacts alone are felt, under a calibration that nothing seen tells of."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.estimation.solve.joint import solve
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.rigs import solve_modes
from fusion.estimation.solve.settings import JointSettings, Level, Rig
from scenes.evidence import table as evidence
from scenes.geometry import poses
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Contacts, Frame
from touch.contacts import feel


def felt_all_over(drill, settings, *, has_robot=True):
    """Contacts without error all over the drill, 0.6 m before the camera, and where it is."""
    pose = poses.make_pose(poses.exp_rotation([0.3, 0.2, -0.4]), [0.02, 0.01, 0.6])
    points, normals = drill.sample_surface(60, seed=4)
    contacts = Contacts(poses.apply(pose, points), normals @ pose[:3, :3].T, 1e-4)
    felt, nothing = feel(Frame(0, contacts=contacts)).rows, evidence.empty()
    return JointProblem(
        drill, nothing, felt, 60, None, None, Beliefs(), None, has_robot=has_robot, settings=settings
    ), pose


@pytest.mark.parametrize("levels", [[(1.0, 1.0)], [(1.0, 0.8), (4.0, 0.2)], [(0.25, 0.3), (1.0, 0.6), (3.0, 0.1)]])
def test_a_calibration_that_nothing_tells_of_is_as_wide_as_rigs_are_usual(drill, levels):
    """The reference is the mean of what each rig alone makes of the covariance."""
    settings = replace(JointSettings(), rigs=tuple(Rig(*one) for one in levels))
    problem, pose = felt_all_over(drill, settings)
    both = solve_modes([problem, problem], [pose, pose])
    alone = [solve(problem, pose, Level(level)) for level, _ in levels]
    expected = sum(share * one.covariance for (_, share), one in zip(levels, alone, strict=True))
    for found in both:
        np.testing.assert_allclose(found.covariance, expected, rtol=0.02, atol=1e-3 * np.abs(expected).max())


def test_contacts_in_their_own_frame_have_no_calibration_between(drill):
    problem, pose = felt_all_over(drill, JointSettings(), has_robot=False)
    found = solve_modes([problem], [pose])[0]
    assert np.sqrt(np.diag(found.covariance)[3:]).max() < 4e-4
