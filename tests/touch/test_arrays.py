"""Tactile arrays: descriptor, published costs against their plain twins, the forward model, searches, rows and slip."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from fusion.benchmarks.arrays import grasps
from scenes.errors import InputError
from scenes.evidence import table as evidence
from scenes.evidence.table import GATE_ABOVE, NORMAL
from scenes.geometry import poses as se3
from scenes.robot.tactile import SoftLayer, press, pressures_at
from scenes.synthesis import library
from touch.arrays.cloud import CloudSettings, SurfaceCloud, surface_cloud
from touch.arrays.costs import ArrayProblem, ForwardSettings, MatchingSettings
from touch.arrays.descriptor import describe, eigenbasis, tangent_frame
from touch.arrays.readings import Reading, alpha_of
from touch.arrays.rows import ArrayRowSettings, array_contacts, array_rows
from touch.arrays.searches import SEARCHES, Box, finish, localize_arrays, minimise
from touch.arrays.slip import slip_between, slipped

LAYER = SoftLayer(thickness=0.002, modulus=0.05e6)
FLAT = grasps.pad(8, 3, 0.0032, None)
MATCHING = MatchingSettings(cloud=CloudSettings(area=2e-5))


def reading(pressure, taxels=FLAT, layer=LAYER, name="pad"):
    return Reading(name, taxels, np.asarray(pressure, dtype=float), layer, np.eye(4))


def plane(slope=0.0, depth=0.0005):
    """A flat surface that rises by `slope` along x, as an unblurred layer would feel it."""
    return np.maximum(LAYER.stiffness * (depth - slope * FLAT[:, 0]), 0.0)


@cache
def problem(name="a", seed=3):
    truth, readings = grasps.recordings(name, 1, [seed])[0]
    return truth, ArrayProblem(grasps.hold(name).model, readings, MATCHING)


def around(truth, model, count, angle=0.2, distance=0.006, seed=0):
    rng = np.random.default_rng(seed)
    return se3.perturb(truth, rng.normal(size=(count, 6)) * ([angle] * 3 + [distance] * 3), model.centroid)


# descriptor


@pytest.mark.parametrize("degrees", [0.0, 2.0, 5.0, -4.0])
def test_the_third_axis_is_the_normal_of_what_is_touched(degrees):
    slope = np.tan(np.deg2rad(degrees))
    found = describe(reading(plane(slope, depth=0.0015)))
    e3 = found.basis[:, 2]
    # the surface is place - depth z: it goes down where the pad is pressed deeper
    np.testing.assert_allclose(np.degrees(np.arctan2(e3[0], e3[2])), -degrees, atol=0.01)
    assert found.active == 24
    assert found.eigenvalues[2] == pytest.approx(0.0, abs=1e-12)


def test_covariance_is_that_of_the_thesis_on_a_flat_pad():
    rng = np.random.default_rng(0)
    pressure = np.where(rng.random(24) < 0.3, 0.0, rng.uniform(5e3, 5e4, 24))
    found = describe(reading(pressure))
    on = pressure > 0
    matrix = np.stack([FLAT[on, 0], FLAT[on, 1], alpha_of(LAYER) * pressure[on]])
    np.testing.assert_allclose(found.covariance, np.cov(matrix), atol=1e-15)
    np.testing.assert_allclose(found.basis @ np.diag(found.eigenvalues) @ found.basis.T, found.covariance, atol=1e-15)
    assert np.linalg.det(found.basis) == pytest.approx(1.0)


def test_a_curved_pad_feels_a_flat_surface_as_flat():
    """The tangent frame takes the pad's own bend into account: what is flat has no variance across."""
    bent = grasps.pad(8, 3, 0.0032, 0.025)
    depth = 0.001 + bent[:, 2]  # a plane 1 mm into the pad's highest line
    pressure = LAYER.stiffness * depth / bent[:, 5]
    found = describe(reading(pressure, bent))
    assert found.eigenvalues[2] < 1e-12
    np.testing.assert_allclose(np.abs(found.basis[:, 2]), [0, 0, 1], atol=1e-6)


@given(st.integers(0, 2**31), st.floats(0.0, 3.0))
@settings(max_examples=40, deadline=None)
def test_the_descriptor_moves_with_the_pad(seed, size):
    rng = np.random.default_rng(seed)
    one = reading(np.where(rng.random(24) < 0.4, 0.0, rng.uniform(2e3, 5e4, 24)))
    pose = se3.make_pose(se3.exp_rotation(size * se3.random_unit_vectors(1, rng)[0]), rng.normal(size=3))
    here, there = describe(one), describe(one.moved(pose))
    np.testing.assert_allclose(there.covariance, here.covariance, atol=1e-13)
    np.testing.assert_allclose(there.frame_from_tangent, pose @ here.frame_from_tangent, atol=1e-9)


def test_degenerate_readings_have_a_basis_and_no_jump():
    single = np.zeros(24)
    single[10] = 3e4
    for pressure in (np.zeros(24), single, np.where(FLAT[:, 1] == 0, 3e4, 0.0)):
        found = describe(reading(pressure))
        assert np.isfinite(found.basis).all()
        np.testing.assert_allclose(found.basis.T @ found.basis, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(found.basis[:, 2], [0, 0, 1], atol=1e-9)
    assert np.linalg.norm(describe(reading(np.zeros(24))).heading) == 0.0


@given(st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_equal_eigenvalues_break_towards_the_axes(seed):
    rng = np.random.default_rng(seed)
    turn = se3.random_rotations(1, rng)[0]
    for values in ([2.0, 2.0, 1.0], [2.0, 1.0, 1.0], [1.0, 1.0, 1.0]):
        covariance = turn @ np.diag(values) @ turn.T * 1e-5
        found, basis = eigenbasis(covariance)
        np.testing.assert_allclose(found, np.array(values) * 1e-5, atol=1e-12)
        np.testing.assert_allclose(basis @ np.diag(found) @ basis.T, covariance, atol=1e-10)
        # noise below the tie turns nothing
        noise = 1e-13 * rng.normal(size=(3, 3))
        np.testing.assert_allclose(eigenbasis(covariance + noise + noise.T)[1], basis, atol=1e-5)


def test_bad_readings_are_refused():
    with pytest.raises(InputError, match="expected k pressures"):
        reading(np.zeros(3))
    with pytest.raises(InputError, match="finite"):
        reading(np.full(24, np.nan))
    with pytest.raises(InputError, match="at least one"):
        ArrayProblem(library.make("box"), [])


# published costs against plain twins


def covariance_twin(task, pose):
    """T1 algorithm 5.2 with eigenbasis, k-d tree and eq. 5.8 as it is written."""
    s, cloud, total = task.matching, surface_cloud(task.model, task.matching.cloud).points, 0.0
    boxes, skins = task._matching_arguments[10:12]
    for _one, d, box, skin in zip(task.touching, task.descriptors, boxes, skins):
        tangent_from_object = se3.inverse(d.frame_from_tangent) @ pose
        centre = se3.apply(se3.inverse(tangent_from_object), d.centroid[None])[0]
        away = abs(task.model.field.distance(centre[None])[0])
        missed = s.h1 * away + s.h3 * np.linalg.norm(np.diag(d.eigenvalues))
        if away > s.epsilon:
            total += missed
            continue
        near = cloud[cKDTree(cloud).query_ball_point(centre, 0.1)]
        x, y, z = local = se3.apply(tangent_from_object, near).T
        floor = skin[0] + skin[1] * x + skin[2] * y + skin[3] * x * x + skin[4] * x * y + skin[5] * y * y
        inside = (x >= box[0]) & (x <= box[1]) & (y >= box[2]) & (y <= box[3]) & (np.abs(z - floor) <= skin[6])
        if inside.sum() <= 3:
            total += missed
            continue
        rebased = d.basis.T @ (local[:, inside] - d.centroid[:, None])
        difference = np.cov(rebased) - np.diag(d.eigenvalues)
        behind = np.maximum(-rebased[2], 0.0).sum()
        total += s.h3 * np.linalg.norm(difference) + np.linalg.norm(rebased.mean(axis=1)) + s.h2 * behind
    return total


@pytest.mark.parametrize("name", ["a", "c", "f"])
def test_covariance_cost_is_algorithm_5_2(name):
    truth, task = problem(name)
    candidates = np.concatenate([truth[None], around(truth, task.model, 12), around(truth, task.model, 8, 1.5, 0.05)])
    np.testing.assert_allclose(task.covariance(candidates), [covariance_twin(task, p) for p in candidates], rtol=1e-9)


def test_distance_cost_is_algorithm_5_3():
    truth, task = problem()
    candidates = around(truth, task.model, 20)
    expected = []
    for pose in candidates:
        sums = [
            np.mean(task.model.field.distance(se3.apply(se3.inverse(pose), r.surface_points[r.active])) ** 2)
            for r in task.touching
        ]
        expected.append(sum(sums))
    np.testing.assert_allclose(task.distance(candidates), expected, rtol=1e-6)


def test_the_numerical_example_of_the_thesis():
    """Eqs. 5.9 and 5.10: q = 0.878e-6 (the thesis rounds its entries to two digits)."""
    matched = np.array([[34.15, -0.01, 0.26], [-0.01, 7.55, 0.0], [0.26, 0.0, 0.15]])
    assert np.linalg.norm(matched - np.diag([34.56, 7.86, 0.76])) == pytest.approx(0.87846, abs=0.01)


@given(st.integers(0, 2**31))
@settings(max_examples=25, deadline=None)
def test_costs_do_not_depend_on_the_frame(seed):
    truth, task = problem()
    rng = np.random.default_rng(seed)
    world = se3.make_pose(se3.random_rotations(1, rng)[0], rng.normal(size=3))
    other = ArrayProblem(task.model, [r.moved(world) for r in task.readings], MATCHING)
    candidates = around(truth, task.model, 3, seed=seed)
    # round-off moves single points of the cloud over a box's border
    for name, tolerance in (("covariance", 0.03), ("distance", 1e-5), ("forward", 1e-3)):
        here, there = task.cost(name)(candidates), other.cost(name)(world @ candidates)
        np.testing.assert_allclose(there, here, rtol=tolerance)


def test_single_evaluations_are_the_batch():
    truth, task = problem()
    for name in ("covariance", "distance", "forward"):
        one = task.scalar(name)(truth[None, :3, :3].copy(), truth[None, :3, 3].copy())
        assert one == task.cost(name)(truth[None])[0]


def test_the_voxel_list_holds_every_point_once():
    points = np.random.default_rng(1).normal(size=(500, 3)) * 0.03
    cloud = SurfaceCloud.of_points(points, 0.005)
    assert cloud.first[-1] == len(points)
    np.testing.assert_allclose(np.sort(cloud.points, axis=0), np.sort(points, axis=0))
    made = surface_cloud(library.make("box"), MATCHING.cloud).points
    gaps = cKDTree(made).query(made, k=2)[0][:, 1]
    assert gaps.min() > 0.5 * np.median(gaps)


# the likelihood of pressures


def test_predicted_pressures_are_those_of_the_layer():
    held = grasps.hold("a")
    truth, readings = se3.make_pose(), []
    for sensor, pose, approach in zip(held.sensors, held.pads, held.approach):
        felt, depth = press(held.model, pose, sensor, -approach, 4.0)
        pressed = pose.copy()
        pressed[:3, 3] += depth * approach
        np.testing.assert_allclose(felt, pressures_at(held.model, pressed, sensor))
        readings.append(Reading(sensor.name, sensor.taxels, felt, LAYER, np.eye(4)).moved(pressed))
    task = ArrayProblem(held.model, readings)
    for one, predicted in zip(readings, task.predicted(truth)):
        strong = one.pressure > 0.3 * one.pressure.max()
        error = np.abs(predicted - one.pressure)[strong] / one.pressure.max()
        assert np.median(error) < 0.2  # seven columns against a sharp edge
        assert np.corrcoef(predicted, one.pressure)[0, 1] > 0.95 or np.ptp(one.pressure) < 0.3 * one.pressure.max()


def test_derivatives_of_the_likelihood():
    """Gradient against central differences where the likelihood is smooth: a smooth object, few kinks."""
    truth, task = problem("c")
    # errors of arrays held small: then the linear model of them is exact
    task = ArrayProblem(task.model, task.readings, MATCHING, ForwardSettings(turn=1e-5, move=1e-6, model=1e-3))
    for pose in around(truth, task.model, 4, 0.01, 3e-4):
        _, gradient, hessian = (x[0] for x in task.forward_terms(pose[None]))
        steps = np.eye(6) * ([1e-5] * 3 + [1e-6] * 3)
        there = task.forward(np.concatenate([se3.perturb(pose, s, task.model.centroid) for s in (steps, -steps)]))
        numeric = (there[:6] - there[6:]) / (2 * steps.sum(axis=1))
        scale = np.sqrt(np.diag(hessian))
        assert np.linalg.norm((gradient - numeric) / scale) < 0.15 * np.linalg.norm(numeric / scale) + 0.5
        assert np.linalg.eigvalsh(hessian / scale / scale[:, None])[0] > -1e-9


def test_finishing_never_raises_the_cost():
    truth, task = problem("b")
    starts = around(truth, task.model, 12, 0.1, 0.003)
    before = task.forward(starts)
    result = finish(task, starts)
    assert (result.costs <= before + 1e-9).all()
    np.testing.assert_allclose(task.forward(result.poses), result.costs, rtol=1e-4, atol=1e-3)


# searches


@pytest.mark.parametrize("search", SEARCHES)
def test_every_search_finds_less_than_its_start(search):
    truth, task = problem()
    start = around(truth, task.model, 1, 0.15, 0.004)[0]
    box = Box.around(start, np.deg2rad(20), 0.01)
    for cost in ("covariance", "distance"):
        found = minimise(task, box, cost, search, 600, seed=1)
        again = minimise(task, box, cost, search, 600, seed=1)
        assert found.cost < task.cost(cost)(start[None])[0]
        np.testing.assert_array_equal(found.pose, again.pose)
        assert found.cost == pytest.approx(task.cost(cost)(found.pose[None])[0])
    with pytest.raises(InputError, match="expected a cost"):
        minimise(task, box, "volume")


@pytest.mark.parametrize("name", ["a", "b", "f"])
def test_arrays_alone_find_the_object(name):
    from fusion.benchmarks.contacts.trials import errors
    from scenes.evidence.align import Prior

    truth, task = problem(name, 11)
    start = around(truth, task.model, 1, 0.15, 0.005)[0]
    found = localize_arrays(task, 0, Prior.isotropic(start, 0.2, 0.006))
    rotation, position = errors(task.model, found.pose, truth)
    assert np.degrees(rotation) < 4.0
    assert position < 0.004
    again = localize_arrays(task, 0, Prior.isotropic(start, 0.2, 0.006))
    np.testing.assert_array_equal(found.pose, again.pose)


# rows


def test_rows_of_a_reading():
    pressure = plane()
    pressure[:5] = 0.0
    one, blank = reading(pressure), reading(np.zeros(24), name="none")
    rows = array_rows([one, blank])
    settings = ArrayRowSettings()
    contacts = array_contacts([one, blank])
    assert contacts.sensors == ["pad"]
    np.testing.assert_allclose(contacts.normals[0], [0, 0, -1])
    np.testing.assert_allclose(rows.points[0], contacts.points[0])
    np.testing.assert_allclose(rows.rows[0, NORMAL], [0, 0, -1])
    silent = rows.rows[:, GATE_ABOVE] == 0.0
    assert silent.sum() == 5 + 24
    on = rows.rows[1:20]
    np.testing.assert_allclose(on[:, 2], -0.0005, atol=1e-12)
    assert on[:, evidence.WEIGHT].sum() == pytest.approx(settings.shared)
    assert len(array_rows([blank])) == 24
    assert not len(array_contacts([blank]))


# slip


def test_slip_is_told_from_more_force():
    base = np.exp(-((FLAT[:, 0] / 0.006) ** 2) - (FLAT[:, 1] / 0.004) ** 2) * 4e4
    before = reading(base)
    assert slip_between(before, reading(1.6 * base)).state == "held"
    assert slip_between(before, reading(1.6 * base)).force == pytest.approx(1.6, rel=0.05)
    moved = np.exp(-(((FLAT[:, 0] - 0.003) / 0.006) ** 2) - (FLAT[:, 1] / 0.004) ** 2) * 4e4
    change = slip_between(before, reading(moved))
    assert change.state == "slipped"
    assert change.displacement[0] == pytest.approx(0.003, rel=0.35)
    assert slip_between(before, reading(np.zeros(24))).state == "broken"
    assert slip_between(reading(np.zeros(24)), before).state == "made"
    assert slip_between(reading(np.zeros(24)), reading(np.zeros(24))).state == "none"
    with pytest.raises(InputError, match="one array"):
        slip_between(before, reading(np.zeros(3), FLAT[:3]))


def test_slip_of_a_hand_and_a_turn():
    line = np.exp(-((FLAT[:, 1] / 0.002) ** 2)) * 4e4
    angle = np.deg2rad(20)
    across = -np.sin(angle) * FLAT[:, 0] + np.cos(angle) * FLAT[:, 1]
    turned = np.exp(-((across / 0.002) ** 2)) * 4e4
    change = slip_between(reading(line), reading(turned))
    assert abs(np.degrees(change.turn)) > 5
    # the hand moved with the object in it: nothing slipped
    pose = se3.make_pose(se3.exp_rotation([0.3, 0.2, 1.0]), [0.1, 0.2, 0.3])
    moved, changes = slipped([reading(line)], [reading(line).moved(pose)])
    assert not moved
    assert changes["pad"].state == "held"
    assert slipped([reading(line)], [])[1] == {}


def test_the_tangent_frame_of_a_silent_pad_is_the_pad_s():
    np.testing.assert_allclose(tangent_frame(reading(np.zeros(24)))[:3, :3], np.eye(3), atol=1e-12)
