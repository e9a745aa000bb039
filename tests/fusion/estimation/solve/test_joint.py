"""The joint solution: its derivatives, its loss, and shared errors found again from exact data."""

from dataclasses import replace

import joint_twin
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joint_twin import CAMERA, made_problem

from fusion.estimation.solve import rigs
from fusion.estimation.solve.joint import expected, marginalised, rigs_beside, settle, solve, strained
from fusion.estimation.solve.kernels import mark_near
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.rigs import _averaged, solve_modes
from fusion.estimation.solve.settings import Level
from fusion.estimation.solve.system import FIXED, POSE, SCALE, XI, System, exceeding
from scenes.evidence import table as evidence
from scenes.evidence.row_kernels import loss_floor
from scenes.evidence.row_kernels import robust as compiled_robust
from scenes.evidence.table import NO_GATE
from scenes.geometry import poses
from scenes.recordings.beliefs import Beliefs, DepthModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.contacts import feel
from vision.look.look import look
from vision.look.looked import RowSettings


def test_inducing_pixels_are_near_some_pixel(rng):
    grid, pixels = rng.uniform(0, 100, (50, 2)), rng.uniform(0, 60, (40, 2))
    near = np.zeros(50, dtype=bool)
    mark_near(grid, pixels, 12.0, near)
    assert np.array_equal(near, np.linalg.norm(grid[:, None] - pixels, axis=2).min(axis=1) < 12.0)
    assert 0 < near.sum() < 50


@given(st.floats(0, 1e5), st.sampled_from([0.0, 0.5, 1.5, 2.5, 5.0, 8.9, 20.0, NO_GATE]))
def test_the_loss_is_the_kernels(square, gate):
    loss, belongs = joint_twin.robust(np.array([square]), np.array([gate]))
    if gate == 0.0:  # the kernel leaves such rows out
        assert loss[0] == belongs[0] == 0.0
        return
    theirs = compiled_robust(square, gate, loss_floor(gate), 0.0)
    assert loss[0] == pytest.approx(theirs[0], rel=1e-9, abs=1e-9)
    assert belongs[0] == pytest.approx(theirs[1], rel=1e-9, abs=1e-12)


def numeric_gradient(system, pose, unknown, steps):
    out = np.zeros(len(unknown))
    for i in range(len(unknown)):
        pair = []
        for sign in (1, -1):
            shifted = unknown + sign * steps[i] * np.eye(len(unknown))[i]
            delta, shifted[POSE] = shifted[POSE].copy(), 0.0
            pair.append(system.terms(poses.perturb(pose, delta, system.problem.model.centroid), shifted)[0])
        out[i] = (pair[0] - pair[1]) / (2 * steps[i])
    return out


def steps_of(problem, unknown):
    steps = np.full(len(unknown), 1e-4)
    steps[:3], steps[3:6] = 1e-6, 1e-7
    return steps


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("camera", [CAMERA, None])
def test_the_gradient_is_that_of_the_cost(drill, seed, camera):
    rng = np.random.default_rng(seed)
    problem, pose = made_problem(drill, rng, camera)
    system = System(problem, pose, Level())
    unknown = np.zeros(FIXED + len(problem.bias))
    _, gradient, normal = system.terms(pose, unknown)
    numeric = numeric_gradient(system, pose, unknown, steps_of(problem, unknown))
    scale = np.sqrt(np.diag(normal)) + 1e-6
    assert np.abs((gradient - numeric) / scale).max() < 2e-3 * np.abs(gradient / scale).max()
    assert np.allclose(normal, normal.T, rtol=1e-9, atol=1e-9 * np.abs(normal).max())
    assert np.linalg.eigvalsh(normal / scale / scale[:, None]).min() > -1e-9


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("camera", "pixels_tell"), [(CAMERA, True), (CAMERA, False), (None, True)])
def test_the_kernels_agree_with_their_twins(drill, seed, camera, pixels_tell):
    rng = np.random.default_rng(seed)
    problem, pose = made_problem(drill, rng, camera, pixels_tell=pixels_tell)
    system = System(problem, pose, Level())
    unknown = np.zeros(FIXED + len(problem.bias))
    unknown[SCALE], unknown[FIXED:], unknown[XI] = 0.01, 0.3 * rng.normal(size=len(unknown) - FIXED), 0.2
    pose = poses.perturb(pose, 0.02 * rng.normal(size=6), drill.centroid)
    for mine, twin in zip(system.terms(pose, unknown), joint_twin.terms(system, pose, unknown)):
        np.testing.assert_allclose(mine, twin, rtol=1e-6, atol=1e-9 * np.abs(twin).max())


@pytest.mark.parametrize("seed", range(3))
def test_the_gradient_holds_away_from_zero_corrections(drill, seed):
    rng = np.random.default_rng(seed)
    problem, pose = made_problem(drill, rng)
    system = System(problem, pose, Level())
    unknown = np.zeros(FIXED + len(problem.bias))
    unknown[SCALE], unknown[FIXED:], unknown[XI] = 0.01, 0.008 * rng.normal(size=len(unknown) - FIXED), 0.012
    _, gradient, normal = system.terms(pose, unknown)
    numeric = numeric_gradient(system, pose, unknown, steps_of(problem, unknown))
    scale = np.sqrt(np.diag(normal)) + 1e-6
    assert np.abs((gradient - numeric) / scale).max() < 2e-2 * np.abs(gradient / scale).max()


def test_the_hands_block_is_that_of_its_pixels(exact_frame, drill):
    """Quadratic in the corrections: gradient and value against the residuals written out."""
    problem, _ = frame_problem(exact_frame, drill)
    system = System(problem, exact_frame.camera_from_object_truth, Level())
    rng = np.random.default_rng(0)
    unknown = 0.3 * rng.normal(size=FIXED + len(problem.bias))
    cost, gradient, normal = joint_twin.hand(system, unknown)
    view = problem.hand
    xi = system.white_xi @ unknown[XI]
    ray = view.points / view.points[:, 2:]
    moved = (
        -system.white[SCALE] * unknown[SCALE] * view.points
        - (problem.bias.basis(view.points) @ (system.white[FIXED:] * unknown[FIXED:]))[:, None] * ray
    )
    turn = (xi - view.xi)[:3]
    shift = np.cross(turn, view.points - view.centre) + (xi - view.xi)[3:]
    residual = view.residual + np.sum(view.directions * (moved - shift), axis=1)
    assert cost == pytest.approx(0.5 * float(problem.hand_weight @ residual**2), rel=1e-9)
    assert np.allclose(normal, normal.T)
    step = 1e-5
    for i in rng.choice(len(gradient), 6, replace=False):
        shifted = unknown.copy()
        shifted[6 + i] += step
        up = joint_twin.hand(system, shifted)[0]
        shifted[6 + i] -= 2 * step
        assert gradient[i] == pytest.approx((up - joint_twin.hand(system, shifted)[0]) / (2 * step), rel=1e-5, abs=1e-5)


def frame_problem(frame, model):
    looked = look(frame, model, start=frame.prior)
    seen = looked.rows(DepthModel(), RowSettings(most=400))
    felt = feel(frame, np.eye(4), region=looked.region)
    problem = JointProblem(model, seen, felt.rows, len(felt.contacts), None, looked.hand, Beliefs(), frame.camera)
    return problem, felt


@pytest.mark.parametrize("seed", range(3))
def test_known_shared_errors_are_found_from_exact_data(exact_frame, drill, seed):
    """2 mm, 0.3 degrees at the camera and half a percent of depth, put into an exact frame."""
    rng = np.random.default_rng(seed)
    error = poses.exp(np.concatenate([np.deg2rad(0.3) * rng.normal(size=3), 0.002 * rng.normal(size=3)]))
    scale = 0.005 * rng.choice([-1.0, 1.0])
    frame = replace(
        exact_frame,
        world_from_hand=error @ exact_frame.world_from_hand,
        contacts=exact_frame.contacts.moved(error),
        depth=(exact_frame.depth * (1 + scale)).astype(np.float32),
    )
    problem, _ = frame_problem(frame, drill)
    truth = frame.camera_from_object_truth
    start = poses.perturb(truth, [0.01, -0.01, 0.01, 0.001, 0.001, -0.001], drill.centroid)
    # at the believed size of the shared errors, which is the size they were drawn with
    result = solve(problem, solve(problem, start, Level()).pose, Level())
    unknown = np.zeros(FIXED + len(problem.bias))
    system = System(problem, result.pose, Level())
    unknown[XI] = np.linalg.solve(system.white_xi, result.xi)
    unknown[SCALE] = result.scale / system.white[SCALE]
    normal = system.terms(result.pose, unknown)[2]
    covariance = np.linalg.inv(normal + 1e-9 * np.diag(np.diag(normal)))
    xi_covariance = system.white_xi @ covariance[XI, XI] @ system.white_xi.T
    wanted = poses.difference(poses.inverse(error), np.eye(4), result.centre)
    off = result.xi - wanted
    assert off @ np.linalg.solve(xi_covariance, off) < 25.0  # six degrees of freedom: beyond 99.9 %
    assert abs(result.scale - scale) < 4 * system.white[SCALE] * np.sqrt(covariance[SCALE, SCALE])
    delta = poses.difference(result.pose, truth, drill.centroid)
    assert delta @ np.linalg.solve(result.covariance, delta) < 25.0
    assert np.linalg.norm(delta[3:]) < 0.004
    # what is left of the error at the hand is small, however large it was
    assert np.linalg.norm(off[3:]) < 0.0015


def test_solving_lowers_the_cost_and_keeps_the_pose_rigid(drill, rng):
    problem, pose = made_problem(drill, rng)
    start = poses.perturb(pose, [0.05, -0.03, 0.02, 0.004, 0.003, -0.004], drill.centroid)
    result = solve(problem, start, Level())
    unknown = np.zeros(FIXED + len(problem.bias))
    system = System(problem, start, Level())
    assert result.cost < system.terms(start, unknown)[0]
    poses.check_pose(result.pose)
    assert np.linalg.norm(poses.difference(result.pose, pose, drill.centroid)[3:]) < 0.003
    assert np.linalg.eigvalsh(result.covariance).min() > 0
    assert np.isfinite(result.log_evidence)
    again = solve(problem, start, Level())
    assert np.array_equal(again.pose, result.pose)


@pytest.mark.parametrize("kind", ["no touch", "no vision", "one pixel"])
def test_little_evidence_is_solved_too(drill, rng, kind):
    problem, pose = made_problem(drill, rng, prior=False)
    seen, felt = problem.seen, problem.felt
    if kind == "no touch":
        felt = evidence.empty()
    elif kind == "no vision":
        seen = evidence.empty()
    else:
        seen, felt = seen.take([0]), evidence.empty()
    sparse = JointProblem(drill, seen, felt, int(felt.on.sum()), None, None, Beliefs(), CAMERA)
    result = solve_modes([sparse], [pose])[0]
    assert np.isfinite(result.pose).all()
    assert np.isfinite(result.covariance).all()
    assert np.linalg.eigvalsh(result.covariance).min() > 0


def test_the_level_of_shared_errors_follows_the_data(drill):
    """Pixels that agree with the contacts need no shared error; pixels 6 mm off need much of it."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=False, noise=1e-5)
    # these pixels share nothing
    own = replace(problem.settings, pixel_weight=1.0)
    told = {"settings": own, "pixels_tell": True}
    seen, felt = problem.seen, problem.felt
    together = JointProblem(drill, seen, felt, int(felt.on.sum()), None, None, Beliefs(), CAMERA, **told)
    agree = solve_modes([together], [pose])[0]
    off = problem.seen.moved(poses.make_pose(None, [0.0, 0.0, 0.006]))
    apart = JointProblem(drill, off, felt, int(felt.on.sum()), None, None, Beliefs(), CAMERA, **told)
    disagree = solve_modes([apart], [pose])[0]
    usual = [np.dot(one.shares, [rig.level for rig in own.rigs]) for one in (agree, disagree)]
    assert usual[0] < usual[1]
    for result in (agree, disagree):
        assert sum(result.shares) == pytest.approx(1.0)
        assert sum(result.bias_shares) == pytest.approx(1.0)
        assert result.level.rig in {rig.level for rig in own.rigs}
        assert result.level.bias in {bias.level for bias in own.biases}
        # shared errors that were moved, beside how many of them the frame tells
        unknowns = 7 + len(together.bias)
        assert 0.0 < result.told < unknowns
        # what a track carries on is all of the covariance, and the bias's part is a part
        assert np.linalg.eigvalsh(result.shared - result.biased).min() > -1e-9 * np.trace(result.shared)
        assert np.linalg.eigvalsh(result.unsolved).min() > 0.0


def test_how_far_shared_errors_were_moved_is_told_beside_how_many_are_known(drill):
    """Of a scale that nothing tells as much is left as was believed; of one that is told exactly nothing is."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=False, noise=1e-5)
    settled = settle(problem, pose, Level())
    strain, told = strained(settled)
    covariance = np.linalg.inv(settled.normal + np.diag(settled.system.width))
    assert strain == pytest.approx(float(np.square(settled.unknown[6:]).sum()))
    assert told == pytest.approx(len(settled.unknown) - 6 - float(np.trace(covariance[6:, 6:])))
    off = replace(problem, seen=problem.seen.moved(poses.make_pose(None, [0.0, 0.0, 0.006])))
    assert strained(settle(off, pose, Level()))[0] > strain
    nothing = replace(problem, felt=evidence.empty(), fingers=0)
    assert strained(settle(nothing, pose, Level())) == (0.0, 0.0)  # nothing of known shape ties them


def test_a_rig_beside_one_that_was_solved_ends_where_its_matrix_says(drill):
    """Pose and log evidence of other levels from one solution's Gauss-Newton matrix, held against solving for them."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=False, noise=1e-4)
    solved = settle(problem, pose, Level())
    same = expected(solved, Level())
    np.testing.assert_allclose(same.pose, solved.pose, atol=1e-9)
    assert same.log_evidence == pytest.approx(solved.log_evidence, abs=1e-3)
    for level in (Level(0.7, 0.7), Level(2.0, 2.0), Level(1.0, 0.5), Level(2.0, 1.0)):
        guess, there = expected(solved, level), settle(problem, solved.pose, level, solved)
        moved = np.linalg.norm(poses.difference(there.pose, solved.pose, drill.centroid)[3:])
        off = np.linalg.norm(poses.difference(guess.pose, there.pose, drill.centroid)[3:])
        assert off < max(0.5 * moved, 5e-5)
        assert guess.log_evidence == pytest.approx(there.log_evidence, abs=0.5)


def test_rigs_beside_one_that_was_solved_are_told_with_its_bias_marginalised_once(drill):
    """The same as with all unknowns: how far the pose moves, and what the log evidence gains."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=False, noise=1e-4)
    solved = settle(problem, pose, Level(1.0, 0.5))
    levels = [0.25, 1.0, 3.0]
    for level, step, gained in zip(levels, *rigs_beside(solved, levels)):
        whole = expected(solved, Level(level, 0.5))
        np.testing.assert_allclose(poses.perturb(solved.pose, step, drill.centroid), whole.pose, atol=1e-8)
        assert solved.log_evidence + gained == pytest.approx(whole.log_evidence, abs=1e-3)


def test_the_likeliest_of_all_sizes_is_solved_whichever_bias_it_is_of(drill, monkeypatch):
    """Also where it is of a bias that seemed not to count: with that, and a rig far from the usual one."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=True, noise=1e-5)
    weights = np.zeros((4, 4))
    weights[3, 2] = 1.0
    monkeypatch.setattr(rigs, "_weights", lambda tried, settings: weights)
    found = solve_modes([replace(problem, settings=replace(problem.settings, counting=2.0))], [pose])[0]
    assert found.level == Level(problem.settings.rigs[2].level, problem.settings.biases[3].level)
    assert np.linalg.eigvalsh(found.covariance).min() > 0


@pytest.mark.parametrize("prior", [True, False])
def test_a_bias_that_counts_is_solved(drill, monkeypatch, prior):
    """The answer is the same where all biases are solved and where those are that count; all are without a prior."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=prior, noise=1e-5)
    off = replace(problem, seen=problem.seen.moved(poses.make_pose(None, [0.0, 0.0, 0.006])))
    few, levels = [], [Level(1.0, bias.level) for bias in off.settings.biases]
    answers = []
    for solved in (1, 4):
        monkeypatch.setattr(rigs, "settle", lambda *given: few.append(given[2]) or settle(*given))
        settings = replace(off.settings, solved=solved, counting=0.02)
        answers.append(solve_modes([replace(off, settings=settings)], [pose])[0])
    assert few[-4:] == levels
    assert (len(few) == 8) == (not prior)
    assert answers[0].level == answers[1].level
    apart = np.linalg.norm(poses.difference(answers[0].pose, answers[1].pose, drill.centroid)[3:])
    assert apart < 0.3 * np.sqrt(np.trace(answers[1].covariance[3:, 3:]))


def test_a_rig_that_is_not_known_widens_the_answer(drill):
    """The covariance is the likeliest rig's, and as far as the rigs that may be the case end apart."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=False, noise=1e-5)
    calm = solve_modes([problem], [pose])[0]
    alone = solve(problem, pose, calm.level)
    beyond = np.linalg.eigvalsh(calm.covariance - alone.covariance)
    assert beyond.min() > -0.02 * np.linalg.eigvalsh(alone.covariance).max()
    assert np.trace(calm.covariance[3:, 3:]) < np.trace(solve(problem, pose, Level(4.0, 4.0)).covariance[3:, 3:])


def test_the_evidence_of_rigs_counts_by_its_temperature(drill):
    """The hotter, the less a frame says of its rig, up to nothing beyond how usual each is."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=False, noise=1e-5)
    found = [
        solve_modes([replace(problem, settings=replace(problem.settings, evidence_temperature=hot))], [pose])[0]
        for hot in (1.0, 4.0, 1e9)
    ]
    calmest = [one.shares[0] for one in found]
    assert calmest == sorted(calmest, reverse=True)
    assert calmest[0] > 0.6 > calmest[1] > 0.2
    usual = np.array([rig.share for rig in problem.settings.rigs])
    np.testing.assert_allclose(found[2].shares, usual / usual.sum(), atol=1e-6)


def test_rigs_that_end_apart_widen_the_answer_and_move_it_only_near_by(drill):
    """Not knowing which of two poses it is, is part of the uncertainty, however far apart; their mean is no answer."""
    problem, pose = made_problem(drill, np.random.default_rng(0), prior=False, noise=1e-5)
    best = solve(problem, pose, Level())
    share, weights = 0.5 * drill.radius, np.array([0.75, 0.25])

    def averaged(model, step):
        other = poses.perturb(best.pose, step, model.centroid)
        return _averaged(model, [best.pose, other], weights, best)

    near = averaged(drill, np.array([0, 0, 0, 0.1 * share, 0, 0]))
    assert near.pose[0, 3] == pytest.approx(best.pose[0, 3] + 0.025 * share)
    assert near.covariance[3, 3] == pytest.approx(best.covariance[3, 3] + 0.1875 * (0.1 * share) ** 2)
    apart = averaged(drill, np.array([0, 0, 0, share, 0, 0]))
    np.testing.assert_allclose(apart.pose, best.pose, atol=1e-12)
    assert apart.covariance[3, 3] == pytest.approx(best.covariance[3, 3] + 0.25 * share**2)
    # another side of the object is another mode, which the search has
    turned = averaged(drill, np.array([0, np.pi, 0, 0, 0, 0]))
    np.testing.assert_allclose(turned.covariance, best.covariance)
    # a turn about its own axis leaves a round thing where it was
    can = library.make("cylinder")
    axis = best.pose[:3, :3] @ can.symmetries.axes[0].direction
    spun = averaged(can, np.concatenate([1.2 * axis, 0.1 * share * np.eye(3)[0]]))
    across = np.cross(axis, np.eye(3)[0])
    assert abs(across @ (spun.pose[:3, 3] - best.pose[:3, 3])) < 0.01 * share
    np.testing.assert_allclose(spun.pose[:3, :3], best.pose[:3, :3], atol=1e-9)
    assert np.linalg.norm(spun.pose[:3, 3] - best.pose[:3, 3]) == pytest.approx(0.025 * share, rel=0.01)


def waved(problem, pose):
    """The problem where the surface is four millimetres up and down along the object's longest side."""
    local = poses.apply(poses.inverse(pose), problem.seen.points)
    wave = 0.004 * np.sin(local[:, np.argmax(np.ptp(local, axis=0))] / 0.02)
    rows = problem.seen.rows.copy()
    rows[:, :3] *= 1.0 + (wave / np.linalg.norm(problem.seen.points, axis=1))[:, None]
    return replace(problem, seen=replace(problem.seen, rows=rows))


def test_a_surface_that_is_off_smoothly_speaks_of_the_mesh(drill, rng):
    problem, pose = made_problem(drill, rng, prior=False, noise=0.0002)
    found = []
    for one in (problem, waved(problem, pose)):
        system = System(one, pose, Level())
        system.terms(pose, np.zeros(system.size))
        found.append(system.mesh_variance())
    believed = problem.beliefs.mesh_sigma**2
    assert found[0] < believed < found[1]
    # what is believed stays where nothing is seen
    unseen = replace(problem, seen=evidence.empty())
    blind = System(unseen, pose, Level())
    assert blind.mesh_variance() == pytest.approx(believed)
    # and is no sign of the mesh
    assert solve(unseen, pose, Level()).mesh_variance == 0.0
    assert solve(problem, pose, Level()).mesh_variance > 0.0


def test_what_a_smooth_bias_explains_may_be_the_mesh(drill, rng):
    """The bias takes up a wave of the surface; half of its variance is the mesh's, and widens the pose alone."""
    problem, pose = made_problem(drill, rng, prior=False, noise=0.0002)
    off = waved(problem, pose)
    settled = settle(off, pose, Level())
    found, left = marginalised(settled), settled.system.mesh_variance()
    either = settled.system.mesh_or_bias(settled.pose, settled.unknown)
    assert either > 2.0 * left
    share, parts = off.settings.mesh_share, off.settings.mesh_parts
    alone = marginalised(settle(replace(off, settings=replace(off.settings, mesh_share=0.0)), pose, Level()))
    assert found.mesh_variance == pytest.approx(left)
    assert np.array_equal(found.pose, alone.pose)
    more = np.diag(found.unsolved - alone.unsolved)
    assert more[3:] == pytest.approx(np.full(3, share * (either - left) / parts))
    assert more[:3] == pytest.approx(more[3:] / drill.radius**2)


def test_what_exceeds_is_what_another_covariance_lacks(rng):
    axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    said = (axes * [1.0, 4.0, 9.0, 1.0, 1.0, 1.0]) @ axes.T
    more = (axes * [3.0, 0.0, 9.0, 1.0, 2.0, 0.5]) @ axes.T
    expected = (axes * [2.0, 0.0, 0.0, 0.0, 1.0, 0.0]) @ axes.T
    np.testing.assert_allclose(exceeding(more, said), expected, atol=1e-9)
    # a direction of which nothing is left but rounding, on either side of zero
    for rest in (1e-9, 0.0, -1e-5):
        worn = (axes * [1.0, 4.0, 9.0, 1.0, 1.0, rest]) @ axes.T
        found = exceeding(more, worn)
        assert np.isfinite(found).all()
        assert axes[:, 5] @ found @ axes[:, 5] == pytest.approx(0.5, rel=1e-3)
    assert np.isfinite(exceeding(np.zeros((6, 6)), np.zeros((6, 6)))).all()


def test_depth_is_tied_by_contacts_and_not_by_rows_of_one(drill):
    felt = evidence.from_contacts(Contacts(drill.sample_surface(12, seed=0)[0]), 4.0)
    for fingers, tied in ((1, False), (2, False), (3, True)):
        problem = JointProblem(drill, evidence.empty(), felt, fingers, None, None, Beliefs(), CAMERA)
        assert problem.ties_depth is tied
