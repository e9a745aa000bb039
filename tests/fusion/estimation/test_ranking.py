"""From joint solutions to modes: nothing is believed twice."""

import numpy as np
import pytest

from fusion.estimation.ranking import rejudged
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.solve.joint import JointResult, solve
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import JointSettings
from scenes.evidence import table as evidence
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
    problem = JointProblem(drill, evidence.empty(), felt, None, None, Beliefs(), None, settings=JointSettings())
    solved = solve(problem, np.eye(4), 1.0)
    (mode,) = rejudged(drill, [solved], np.zeros(1), EstimateSettings(), True)
    weak = np.repeat([1.0, drill.radius], 3)
    widest = np.linalg.eigvalsh(mode.covariance / weak / weak[:, None])[-1]
    assert np.sqrt(widest) == pytest.approx(1.0, abs=0.01)
