"""Depth's own errors where contacts alone tie them: considered in what pixels say, and moved by what is felt."""

from dataclasses import replace

import numpy as np
import pytest
from joint_twin import CAMERA, made_problem

from fusion.estimation.solve.considered_kernels import add_of_pose, confounded, field_spread
from fusion.estimation.solve.joint import settle, solve
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import Level
from fusion.estimation.solve.system import System
from scenes.evidence import table as evidence
from scenes.geometry import poses
from scenes.recordings.beliefs import Beliefs


@pytest.mark.parametrize(("count", "size"), [(0, 9), (3, 7), (30, 12), (41, 40)])
def test_what_a_pose_explains_is_a_projection(rng, count, size):
    design, information = rng.normal(size=(max(count, 1), size)), rng.uniform(0.1, 2.0, max(count, 1))
    design[:, 5] = 0.0  # a move that no row tells of
    residuals = rng.normal(size=max(count, 1))
    part, pull = np.zeros((size, size)), np.zeros(size)
    add_of_pose(design, information, residuals, count, part[:6], pull[:6])
    confounded(part, pull)
    root = np.sqrt(information[:count])
    rows, off = design[:count] * root[:, None], residuals[:count] * root
    onto = rows[:, :6] @ np.linalg.pinv(rows[:, :6], rcond=1e-12)
    np.testing.assert_allclose(np.tril(part)[6:, :6], rows[:, 6:].T @ rows[:, :6], atol=1e-9)
    np.testing.assert_allclose(np.tril(part)[6:, 6:], np.tril(rows[:, 6:].T @ onto @ rows[:, 6:]), atol=1e-6)
    np.testing.assert_allclose(pull[6:], rows[:, 6:].T @ onto @ off, atol=1e-6)


@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_a_smooth_error_moves_by_its_correlations(rng, count):
    points, gain, length, out = rng.normal(size=(count, 3)), rng.normal(size=(count, 6)), 0.7, np.zeros((6, 6))
    field_spread(points, gain, length, out)
    apart = np.square(points[:, None] - points).sum(axis=2)
    np.testing.assert_allclose(out, gain.T @ np.exp(-0.5 * apart / length**2) @ gain, atol=1e-12)


@pytest.mark.parametrize(("length", "like"), [(1e-6, "noise"), (1e3, "shift")])
def test_a_smooth_error_of_no_reach_is_noise_and_of_any_reach_a_shift(drill, rng, length, like):
    """Of pixels that are off alike a pose takes the mean along its ray, of those that are not their noise."""
    problem, pose = made_problem(drill, rng, prior=False, noise=1e-4)
    system = System(problem, pose, Level())
    normal = system.terms(pose, np.zeros(system.size))[2]
    whole = normal[:6, :6] + np.diag(system.width[:6])
    found = system.field_spread(whole, length)
    index, _, _, _, information, design = (part[: system._used] for part in problem.room)
    own = problem.on[index]
    gain = np.linalg.solve(whole, (design[own, :6] * information[own, None]).T)
    expected = gain @ gain.T if like == "noise" else np.outer(gain.sum(axis=1), gain.sum(axis=1))
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_contacts_say_how_wrong_depth_is_and_its_own_pixels_do_not(drill, seed):
    """Depth that is 1 % off is found by contacts; a bias that no pose explains is left where only pixels ask for it."""
    problem, pose = made_problem(drill, np.random.default_rng(seed), prior=False, noise=1e-4, pixels_tell=False)
    along = pose[:3, :3] @ drill.centroid + pose[:3, 3]
    along /= np.linalg.norm(along)

    def off_by(seen, **changed):
        found = solve(replace(problem, seen=seen, **changed), pose, Level())
        off = poses.difference(found.pose, pose, drill.centroid)[3:]
        return abs(float(off @ along)), float(np.sqrt(along @ found.covariance[3:, 3:] @ along))

    rows = problem.seen.rows.copy()
    rows[:, :3] *= 1.01
    farther = replace(problem.seen, rows=rows)
    found, untied, by_pixels = off_by(farther), off_by(farther, fingers=1), off_by(farther, pixels_tell=True)
    assert found[0] < 0.6 * untied[0]
    assert found[0] < 2.0 * found[1]
    # what is not asked is not known
    assert by_pixels[1] < found[1] < untied[1]
    system = System(problem, pose, Level())
    bias = system.seen_white @ np.random.default_rng(seed).normal(size=len(problem.bias))
    rows = problem.seen.rows.copy()
    rows[:, :3] += bias[:, None] * rows[:, :3] / np.linalg.norm(rows[:, :3], axis=1, keepdims=True)
    bent = replace(problem, seen=replace(problem.seen, rows=rows))
    sizes = [np.linalg.norm(settle(replace(bent, pixels_tell=t), pose, Level()).unknown[12:]) for t in (False, True)]
    assert sizes[0] < 0.7 * sizes[1]


def test_pixels_tell_of_depth_where_a_hand_is_in_view_or_they_are_a_cloud(drill, rng):
    seen, nothing = made_problem(drill, rng)[0].seen, evidence.empty()
    for rows, camera, tell in ((seen, CAMERA, False), (seen, None, True), (nothing, CAMERA, True)):
        assert JointProblem(drill, rows, nothing, 3, None, None, Beliefs(), camera).pixels_tell is tell
