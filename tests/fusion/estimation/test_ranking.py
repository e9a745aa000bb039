"""From joint solutions to modes: nothing is believed twice."""

import numpy as np
import pytest

from fusion.estimation.ranking import led, rejudged
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.solve.joint import JointResult, solve
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import JointSettings, Level
from scenes.evidence import table as evidence
from scenes.evidence.modes import Mode
from scenes.evidence.table import TOUCH
from scenes.recordings.beliefs import Beliefs


def result(covariance, pose=None):
    return JointResult(np.eye(4) if pose is None else pose, covariance, np.zeros(6), np.zeros(3), 0.0, 0.0, 0.0, 1.0)


def test_a_mode_is_as_wide_as_its_solution(drill, rng):
    """Any covariance no wider than the widest prior comes through as it is, free directions and all."""
    weak = np.repeat([1.0, drill.radius], 3)
    for _ in range(20):
        basis, _ = np.linalg.qr(rng.normal(size=(6, 6)))
        shares = np.concatenate([[1.0, 0.5], 10.0 ** rng.uniform(-6, -1, size=4)])
        covariance = (basis * shares) @ basis.T * weak * weak[:, None]
        (mode,) = rejudged(drill, [result(covariance)], np.zeros(1), EstimateSettings(), True)
        assert np.allclose(mode.covariance / weak / weak[:, None], covariance / weak / weak[:, None], atol=1e-7)


def test_a_direction_that_nothing_tells_is_as_wide_as_the_object(drill):
    """One contact with a normal: the ways to slide along it and to turn about it have the widest prior, once."""
    points, normals = drill.sample_surface(1, seed=0)
    felt = evidence.make(points, 1e-3, TOUCH, normals=normals, sigma_normal=0.09)
    problem = JointProblem(
        drill, evidence.empty(), felt, int(felt.on.sum()), None, None, Beliefs(), None, settings=JointSettings()
    )
    solved = solve(problem, np.eye(4), Level())
    (mode,) = rejudged(drill, [solved], np.zeros(1), EstimateSettings(), True)
    weak = np.repeat([1.0, drill.radius], 3)
    widest = np.linalg.eigvalsh(mode.covariance / weak / weak[:, None])[-1]
    assert np.sqrt(widest) == pytest.approx(1.0, abs=0.01)


def at(x):
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def test_the_likeliest_of_those_that_were_solved_leads():
    """A narrow minimum may cost a little more than a wide one, and is the answer; one that was not solved never is."""
    solved = [result(1e-6 * np.eye(6), at(x)) for x in (0.0, 0.1, 0.2)]
    told = ((0.1, 0.15), (0.3, 0.5), (0.0, 0.3), (0.2, 0.05))  # by cost: the second was not solved
    modes = tuple(Mode(at(x), weight, float(k), 1e-6 * np.eye(6)) for k, (x, weight) in enumerate(told))
    found, first_of = led(modes, solved)
    assert first_of == 0
    assert [float(mode.pose[0, 3]) for mode in found] == [0.0, 0.1, 0.3, 0.2]
    assert led(modes[1:2], solved) == (modes[1:2], 0)
