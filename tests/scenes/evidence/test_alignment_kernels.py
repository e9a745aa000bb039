"""The compiled cost against a plain NumPy twin, its derivatives against differences, its descent against itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.evidence import solver_kernels
from scenes.evidence import table as evidence
from scenes.evidence.align import COARSE, AlignSettings, Prior, align, costs, terms
from scenes.evidence.kernels import SHORTEST_GRADIENT
from scenes.evidence.row_kernels import loss_floor, robust
from scenes.evidence.table import NO_GATE, OFFSET, TOUCH, VISION
from scenes.geometry import poses
from scenes.geometry.rotation_kernels import exp_times, log_rotation
from scenes.synthesis import library

seeds = st.integers(0, 2**32 - 1)


# ---- the twin: no loops that share code with the kernel; values by SciPy's interpolation ----


class Twin:
    """The cost of scenes.evidence.table in plain NumPy, one pose at a time."""

    def __init__(self, model, field=None):
        self.model, self.field = model, field or model.field

    def _value(self, points):
        """Trilinear interpolation inside the box; the way to the box added outside."""
        shape = np.array(self.field.values.shape)
        cell = (points - self.field.origin) / self.field.spacing
        inside = np.clip(cell, 0, shape - 1 - 1e-4)
        low = inside.astype(int)
        share = inside - low
        total = np.zeros(len(points))
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, share, 1 - share), axis=1)
            index = low + corner
            total += weight * self.field.values[index[:, 0], index[:, 1], index[:, 2]].astype(float)
        away = np.linalg.norm(cell - inside, axis=1)
        return total + np.where(away > 2e-4, away * self.field.spacing, 0.0)

    def _direction(self, points):
        """Gradient of the value by central differences that are exact inside a cell."""
        h = 5e-5 * self.field.spacing
        return np.stack([(self._value(points + h * e) - self._value(points - h * e)) / (2 * h) for e in np.eye(3)], 1)

    def _seen(self, points, rays, facing):
        """Values, and where points were led back from a far side the feet of their tangent planes."""
        value, gradient = self._value(points), self._direction(points)
        feet = points.copy()
        for n in np.flatnonzero(facing):
            if gradient[n] @ rays[n] <= 0:
                continue
            for k in range(4):
                step = self.field.step * 2**k
                back = points[n : n + 1] - step * rays[n]
                along = float(self._direction(back)[0] @ rays[n])
                if along < 0:
                    value[n] = self._value(back)[0] + step * along
                    feet[n] = points[n] - value[n] * self._direction(back)[0]
                    break
            else:
                value[n] = -0.5 * self.field.step * 2**4
                feet[n] = points[n] + value[n] * rays[n]
        return value, feet

    def _slope(self, points):
        """Central differences of the nodes, interpolated."""
        values = self.field.values.astype(float)
        padded = np.pad(values, 1, mode="edge")
        nodes = [
            (np.roll(padded, -1, axis=i) - np.roll(padded, 1, axis=i))[1:-1, 1:-1, 1:-1] / (2 * self.field.spacing)
            for i in range(3)
        ]
        shape = np.array(values.shape)
        inside = np.clip((points - self.field.origin) / self.field.spacing, 0, shape - 1 - 1e-4)
        low = inside.astype(int)
        share = inside - low
        out = np.zeros((len(points), 3))
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, share, 1 - share), axis=1)
            index = low + corner
            out += weight[:, None] * np.stack([n[index[:, 0], index[:, 1], index[:, 2]] for n in nodes], axis=1)
        return out

    def _normals(self, points):
        slope = self._slope(points)
        return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), SHORTEST_GRADIENT)

    def _bend(self, points):
        """Mean square turn (rad^2 / m^2) of the normal over the directions along the surface."""
        h = 5e-5 * self.field.spacing
        hessian = np.stack(
            [(self._slope(points + h * e) - self._slope(points - h * e)) / (2 * h) for e in np.eye(3)], 2
        )
        length = np.maximum(np.linalg.norm(self._slope(points), axis=1), SHORTEST_GRADIENT)
        along = np.einsum("ni,nij->nj", self._normals(points), hessian)
        return 0.5 * (np.sum(hessian**2, axis=(1, 2)) - np.sum(along**2, axis=1)) / length**2

    def cost(self, table, pose, prior=None, blur=0.0, blur_normal=0.0, huber=0.0):
        rows = table.rows
        local = poses.apply(poses.inverse(pose), rows[:, :3])
        turned = rows[:, 3:6] @ pose[:3, :3]
        felt = rows[:, 7] > 0
        # a pixel brings its ray, a contact its outward normal
        rays = np.where(felt[:, None], -turned, turned)
        distance, feet = self._seen(local, rays, rows[:, 12] > 0)
        distance = distance - rows[:, 11]
        gate = np.where(distance > 0, rows[:, 9], rows[:, 10])
        square = distance**2 / (rows[:, 6] ** 2 + blur**2)
        off = np.sum((turned - self._normals(feet)) ** 2, axis=1)
        narrow = rows[:, 7] ** 2 + blur_normal**2
        wide = narrow + rows[:, 6] ** 2 * np.maximum(self._bend(feet), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            square = square + np.where(felt, off / wide + 2 * np.log(wide / narrow), 0.0)
        if huber > 0:
            loss = np.where(square <= huber**2, square, 2 * huber * np.sqrt(square) - huber**2)
        else:
            # minus twice the log of (Gaussian + flat density met at the gate), zero at zero
            loss = -2 * np.logaddexp(-0.5 * square, -0.5 * gate**2) + 2 * np.log1p(np.exp(-0.5 * gate**2))
        total = 0.5 * float(np.sum(rows[:, 8] * np.where(gate == 0, 0.0, loss)))
        if prior is not None:
            delta = poses.difference(pose, prior.pose, self.model.centroid)
            total += 0.5 * float(delta @ prior.information @ delta)
        return total


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


@pytest.fixture(scope="module")
def twin(mug):
    return Twin(mug)


def draw_pose(rng):
    return poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)) * 0.3)[0]


def draw_table(model, pose, rng, kinds="nofsrat", count=12, spread=0.004):
    """Rows of the asked kinds around the object at pose: n normal, o on, f far, s seen, r outside, a gated, t touched
    from outside.
    """
    parts = []
    for kind in kinds:
        points, normals = model.sample_surface(count, seed=int(rng.integers(2**31)))
        points = points + rng.normal(size=points.shape) * (0.3 if kind == "f" else spread)
        points, normals = poses.apply(pose, points), normals @ pose[:3, :3].T
        normals = normals + 0.2 * rng.normal(size=normals.shape)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        sigma, weight = rng.uniform(1e-3, 4e-3, size=count), rng.uniform(0.2, 1.5, size=count)
        if kind in "nt":
            felt = {"normals": normals, "sigma_normal": 0.1, "from_outside": kind == "t"}
            parts.append(evidence.make(points, sigma, TOUCH, weight=weight, **felt))
        elif kind == "s":
            parts.append(evidence.make(points, sigma, VISION, rays=-normals, weight=weight, gate_above=2.5))
        elif kind == "r":
            parts.append(evidence.outside(points, sigma, TOUCH, radius=rng.uniform(0, 0.01, size=count), gate=4.0))
        elif kind == "a":
            parts.append(evidence.make(points, sigma, VISION, weight=weight, gate_above=1.5, gate_below=3.0))
        else:
            parts.append(evidence.make(points, sigma, VISION, weight=weight))
    return evidence.stack(*parts)


def clear_of_cell_faces(model, table, pose, share=2e-3):
    """Rows whose look-ups (backed-off ones included) stay inside one cell under small motions."""
    field = model.field
    local = poses.apply(poses.inverse(pose), table.points)
    rays, facing = rays_of(table, pose), table.rows[:, 12] > 0
    distance, gradient = field.seen_distance_and_gradient(local, rays, facing)
    looked_up = [local - distance[:, None] * gradient * facing[:, None]]
    looked_up += [local - step * field.spacing * rays * facing[:, None] for step in (0.0, 1.5, 3.0, 6.0, 12.0)]
    good = np.ones(len(table), dtype=bool)
    for points in looked_up:
        cell = (points - field.origin) / field.spacing
        good &= (np.abs(cell - np.round(cell)) > share).all(axis=1)
    return table.take(good)


def rays_of(table, pose):
    """(n, 3) directions from which rows were reached, object frame: a pixel's ray, against a contact's normal."""
    turned = table.rows[:, 3:6] @ pose[:3, :3]
    return np.where(table.rows[:, 7:8] > 0, -turned, turned)


def not_led_back(model, table, pose):
    """Without the seen rows behind the far side: their value is continued in a straight line, so is their gradient."""
    local = poses.apply(poses.inverse(pose), table.points)
    _, gradient = model.field.distance_and_gradient(local)
    return table.take((table.rows[:, 12] == 0) | (np.sum(gradient * rays_of(table, pose), axis=1) < -1e-3))


def draw_prior(pose, centre, rng):
    root = rng.normal(size=(6, 6)) * ([3.0] * 3 + [60.0] * 3)
    away = poses.perturb(pose, rng.normal(size=6) * ([0.5] * 3 + [0.02] * 3), centre)
    return Prior(away, root.T @ root)


@pytest.mark.parametrize(
    ("blur", "blur_normal", "huber"), [(0.0, 0.0, 0.0), (0.01, 0.3, 0.0), (0.0, 0.0, 0.5), (0.004, 0.1, 2.0)]
)
@settings(max_examples=10)
@given(seed=seeds)
def test_the_cost_is_that_of_the_twin(mug, twin, blur, blur_normal, huber, seed):
    rng = np.random.default_rng(seed)
    pose = draw_pose(rng)
    # the twin's own direction comes from differences: rows beside a cell's face would see both sides
    table = clear_of_cell_faces(mug, draw_table(mug, pose, rng), pose, share=1e-4)
    prior = draw_prior(pose, mug.centroid, rng)
    used = AlignSettings(blur=blur, blur_normal=blur_normal, huber=huber)
    ours = terms(mug, table, pose, prior, used)[0]
    # what is blurred widely is looked up in the coarser lattice
    twin = twin if blur < COARSE * mug.field.coarser.spacing else Twin(mug, mug.field.coarser)
    assert ours == pytest.approx(twin.cost(table, pose, prior, blur, blur_normal, huber), rel=1e-9)
    assert costs(mug, table, pose[None], prior, used)[0] == pytest.approx(ours, rel=1e-12)


@settings(max_examples=10)
@given(seed=seeds)
def test_a_coarser_lattice_tells_blurred_costs_apart_as_well(mug, twin, seed):
    rng = np.random.default_rng(seed)
    pose = draw_pose(rng)
    table, blur = draw_table(mug, pose, rng), COARSE * mug.field.coarser.spacing
    candidates = poses.perturb(pose, rng.normal(size=(30, 6)) * np.repeat([0.3, 0.01], 3), mug.centroid)
    coarse = costs(mug, table, candidates, None, AlignSettings(blur=1.001 * blur, blur_normal=0.3))
    fine = costs(mug, table, candidates, None, AlignSettings(blur=0.999 * blur, blur_normal=0.3))
    assert np.corrcoef(coarse, fine)[0, 1] > 0.995
    np.testing.assert_allclose(coarse, fine, rtol=0.01)


@pytest.mark.parametrize("kind", "nofsrat")
@settings(max_examples=5)
@given(seed=seeds)
def test_every_kind_of_row_alone(mug, twin, kind, seed):
    rng = np.random.default_rng(seed)
    pose = draw_pose(rng)
    table = clear_of_cell_faces(mug, draw_table(mug, pose, rng, kinds=kind), pose, share=1e-4)
    assert terms(mug, table, pose)[0] == pytest.approx(twin.cost(table, pose), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", ["n", "o", "f", "s", "r", "a", "t", "nofsrat", "prior"])
@pytest.mark.parametrize("huber", [0.0, 0.7])
@settings(max_examples=6)
@given(seed=seeds)
def test_the_gradient_is_that_of_the_cost(mug, kind, huber, seed):
    rng = np.random.default_rng(seed)
    pose = draw_pose(rng)
    prior = draw_prior(pose, mug.centroid, rng) if kind == "prior" else None
    kinds = "" if kind == "prior" else kind
    table = evidence.empty() if not kinds else draw_table(mug, pose, rng, kinds=kinds)
    table = not_led_back(mug, clear_of_cell_faces(mug, table, pose, share=5e-3), pose)
    used = AlignSettings(huber=huber, bend=0.0)  # the widening of bent places is a weight, not differentiated
    _, gradient, _ = terms(mug, table, pose, prior, used)
    step = np.array([1e-6] * 3 + [1e-7] * 3)
    numeric = np.zeros(6)
    for i in range(6):
        delta = np.eye(6)[i] * step[i]
        up, down = (poses.perturb(pose, s * delta, mug.centroid) for s in (1, -1))
        both = costs(mug, table, np.array([up, down]), prior, used)
        numeric[i] = (both[0] - both[1]) / (2 * step[i])
    scale = np.array([1.0] * 3 + [1 / mug.radius] * 3)
    size = max(1.0, float(np.abs(gradient / scale).max()))
    assert np.allclose(gradient / scale, numeric / scale, atol=3e-5 * size)


@settings(max_examples=10)
@given(seed=seeds)
def test_the_gradient_of_rows_led_back_points_the_same_way(mug, seed):
    rng = np.random.default_rng(seed)
    points, normals = mug.sample_surface(60, seed=seed)
    rays = normals + 0.3 * rng.normal(size=normals.shape)  # looked at from behind: the wall's other side is seen
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    facing = np.ones(60, dtype=bool)
    _, gradient = mug.field.seen_distance_and_gradient(points, rays, facing)
    step = 1e-6
    numeric = np.stack(
        [
            mug.field.seen_distance_and_gradient(points + step * e, rays, facing)[0]
            - mug.field.seen_distance_and_gradient(points - step * e, rays, facing)[0]
            for e in np.eye(3)
        ],
        axis=1,
    ) / (2 * step)
    length = np.linalg.norm(numeric, axis=1)
    moved = length > 0.1  # deeper than the search along the ray goes, the value is a constant
    assert moved.mean() > 0.5
    cosine = (np.sum(gradient * numeric, axis=1) / np.linalg.norm(gradient, axis=1))[moved] / length[moved]
    assert np.median(cosine) > 0.99


@settings(max_examples=15)
@given(seed=seeds)
def test_the_hessian_is_symmetric_and_never_negative(mug, seed):
    rng = np.random.default_rng(seed)
    pose = draw_pose(rng)
    table = draw_table(mug, pose, rng, spread=0.02)
    _, _, hessian = terms(mug, table, pose, draw_prior(pose, mug.centroid, rng))
    assert np.array_equal(hessian, hessian.T)
    values = np.linalg.eigvalsh(hessian)
    assert values.min() > -1e-9 * values.max()


def test_the_hessian_is_the_true_one_where_residuals_vanish(mug):
    rng = np.random.default_rng(0)
    pose = draw_pose(rng)
    points, _ = mug.sample_surface(400, seed=1)
    local = points - mug.field.distance(points)[:, None] * mug.field.normals(points)
    table = evidence.make(poses.apply(pose, local), 2e-3, VISION)
    _, _, hessian = terms(mug, table, pose)
    step = np.array([2e-4] * 3 + [2e-5] * 3)
    numeric = np.zeros(6)
    for i in range(6):
        delta = np.eye(6)[i] * step[i]
        pair = costs(mug, table, np.array([poses.perturb(pose, s * delta, mug.centroid) for s in (1, -1)]))
        numeric[i] = (pair[0] + pair[1] - 2 * terms(mug, table, pose)[0]) / step[i] ** 2
    assert np.allclose(np.diag(hessian), numeric, rtol=0.1)


@given(st.floats(0, 1e4), st.floats(0.1, 50.0), st.sampled_from([0.0, 0.3, 2.0]))
def test_the_derivative_of_the_loss_is_the_probability(square, gate, huber):
    floor = loss_floor(gate)
    loss, belongs = robust(square, gate, floor, huber)
    assert 0 <= belongs <= 1
    assert 0 <= loss <= square + 1e-9
    step = 1e-6 * max(square, 1e-2)
    if abs(square - huber**2) > 2 * step and square > step:
        numeric = (robust(square + step, gate, floor, huber)[0] - robust(square - step, gate, floor, huber)[0]) / (
            2 * step
        )
        assert numeric == pytest.approx(belongs, abs=1e-5)


@pytest.mark.parametrize("gate", [3.0, 9.0, NO_GATE])
def test_the_loss_has_no_seams(gate):
    square = np.linspace(0, 400, 200_001)
    loss = np.array([robust(s, gate, loss_floor(gate), 0.0) for s in square])
    assert np.isfinite(loss).all()
    assert np.abs(np.diff(loss[:, 0])).max() < 0.0021
    assert (np.diff(loss[:, 0]) >= -1e-12).all()
    assert np.abs(np.diff(loss[:, 1])).max() < 0.002


@given(seeds, st.sampled_from([1.0, 1e-3, 1e-7, 1e-12]), st.booleans())
def test_the_kernels_rotation_vectors_are_those_of_poses(seed, size, half_turn):
    rng = np.random.default_rng(seed)
    axis = poses.random_unit_vectors(1, rng)[0]
    angle = np.pi - size if half_turn else size * rng.uniform(0, 3)
    out = np.zeros(3)
    log_rotation(poses.exp_rotation(angle * axis), out)
    assert np.allclose(out, poses.log_rotation(poses.exp_rotation(angle * axis)), atol=1e-12)
    turned = np.zeros((3, 3))
    start = poses.random_rotations(1, rng)[0]
    exp_times(angle * axis, start, turned)
    assert np.allclose(turned, poses.exp_rotation(angle * axis) @ start, atol=1e-14)


@settings(max_examples=20)
@given(seed=seeds)
def test_descending_never_raises_the_cost(mug, seed):
    rng = np.random.default_rng(seed)
    pose = draw_pose(rng)
    table = draw_table(mug, pose, rng)
    prior = draw_prior(pose, mug.centroid, rng) if seed % 2 else None
    starts = np.array(
        [poses.perturb(pose, d, mug.centroid) for d in rng.normal(size=(8, 6)) * ([0.5] * 3 + [0.03] * 3)]
    )
    before = costs(mug, table, starts, prior)
    previous = before
    for iterations in (1, 3, 10, 40):
        result = align(mug, table, starts, prior, AlignSettings(iterations=iterations))
        assert (result.costs <= previous * (1 + 1e-12)).all()
        # what is reported is the cost of what is returned
        assert np.allclose(costs(mug, table, result.poses, prior), result.costs, rtol=1e-7)
        previous = result.costs


def test_one_sided_rows_cost_nothing_outside_wherever_they_stand_in_the_table(mug, rng):
    points = rng.uniform(-3.0, 3.0, size=(400, 3)) * mug.radius
    inside = mug.sample_surface(40, seed=2)[0] * 0.98
    rows = evidence.outside(
        np.concatenate([points, inside]), 0.003, TOUCH, radius=rng.uniform(0.0, 0.03, 440), gate=3.0
    )
    # some only speak where they are deep inside
    rows.rows[::3, OFFSET] = -0.002
    order = rng.permutation(len(rows))
    pose = poses.perturb(np.eye(4), 0.1 * rng.normal(size=6), mug.centroid)
    local = poses.apply(poses.inverse(pose), rows.points)
    silent = mug.field.distance(local) > rows.rows[:, OFFSET]
    assert 0 < silent.sum() < len(rows)
    all_of_them = costs(mug, rows.take(order), pose[None])[0]
    assert all_of_them == pytest.approx(costs(mug, rows.take(~silent), pose[None])[0], rel=1e-12)
    assert all_of_them == pytest.approx(terms(mug, rows, pose)[0], rel=1e-12)


@pytest.mark.parametrize("size", [1, 6, 13])
def test_elimination_solves_what_numpy_solves(rng, size):
    matrix, vector = rng.normal(size=(size, size)), rng.normal(size=size)
    matrix[0, 0] = 0.0 if size > 1 else 2.0  # no pivot where it is
    expected = np.linalg.solve(matrix, vector)
    solver_kernels.eliminate(matrix, vector)
    np.testing.assert_allclose(vector, expected, rtol=1e-9)
