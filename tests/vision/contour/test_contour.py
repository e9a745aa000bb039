"""The outline in the image: drawn, read across, and what it says of a pose."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import coloured, plain_view

from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import DepthModel, ImageModel
from scenes.synthesis import library
from vision.contour import kernels
from vision.contour.evidence import ContourEvidence, ContourSettings
from vision.contour.lines import LineSettings, lines_across
from vision.contour.outline import outline_near, outline_of
from vision.picture.predictor import Predictor

MESH = 1e-4
COLOURED = ImageModel().colour_sigma


def evidence_at(frame, model, pose, settings=None):
    settings = settings or ContourSettings(shift=COLOURED, learned=True)
    return ContourEvidence(frame, model, Predictor(frame, model, DepthModel()), pose, MESH, settings)


def test_the_outline_of_a_ball_is_where_its_tangents_are():
    model, away = library.make("sphere"), 0.5
    radius = float(np.linalg.norm(model.vertices - model.centroid, axis=1).max())
    camera = Camera(600.0, 600.0, 160.0, 120.0, 320, 240)
    outline = outline_of(model, camera, poses.make_pose(None, [0.0, 0.0, away] - model.centroid))
    from_middle = outline.places - [160.0, 120.0]
    size = np.linalg.norm(from_middle, axis=1)
    expected = 600.0 * radius / np.sqrt(away**2 - radius**2)
    assert len(outline) > 60
    np.testing.assert_allclose(size, expected, atol=0.4)
    np.testing.assert_allclose(np.einsum("ij,ij->i", outline.normals, from_middle / size[:, None]), 1.0, atol=0.02)
    projected, _ = camera.project(outline.points)
    np.testing.assert_allclose(projected, outline.places, atol=1e-6)


@pytest.mark.parametrize("name", ["sphere", "mug", "drill"])
def test_an_outline_follows_a_pose_nearby_and_is_drawn_anew_from_far(name):
    frame, model = plain_view(name), library.make(name)
    truth, camera = frame.camera_from_object_truth, frame.camera
    drawn = outline_of(model, camera, truth)
    near = poses.perturb(truth, np.array([0.01, -0.02, 0.015, 0.002, -0.001, 0.003]), model.centroid)
    whole, followed = outline_of(model, camera, near), outline_near(model, camera, near, (drawn, truth))
    assert 0.9 * len(drawn) <= len(followed) <= len(drawn)
    off = followed.places[:, None] - whole.places[None]
    beside = np.argmin(np.linalg.norm(off, axis=2), axis=1)
    across = np.einsum("ni,ni->n", off[np.arange(len(off)), beside], whole.normals[beside])
    assert np.median(np.abs(across)) < 0.1
    projected, _ = camera.project(followed.points)
    np.testing.assert_allclose(projected, followed.places, atol=1e-6)
    aside = poses.make_pose(None, [0.03, 0.0, 0.0]) @ poses.perturb(
        truth, np.array([1.0, 0, 0, 0, 0, 0]), model.centroid
    )
    anew = outline_near(model, camera, aside, (drawn, truth))
    if name != "sphere":
        np.testing.assert_array_equal(anew.places, outline_of(model, camera, aside).places)


def test_an_object_beside_the_image_has_no_outline():
    model, camera = library.make("box"), Camera(600.0, 600.0, 160.0, 120.0, 320, 240)
    assert len(outline_of(model, camera, poses.make_pose(None, [3.0, 0.0, 0.5]))) == 0
    assert len(outline_of(model, camera, poses.make_pose(None, [0.0, 0.0, -0.5]))) == 0


def plain_tables(bins, ratios, group, temper, first, near, count):
    """NumPy twin of `kernels.offset_tables`."""
    each = np.take_along_axis(ratios[group], bins, axis=1)
    total = np.concatenate([np.zeros((len(bins), 1)), np.cumsum(each, axis=1)], axis=1)[:, first : first + count]
    log_p = temper * total - np.log(np.exp(temper * total).sum(axis=1, keepdims=True))
    middle, steps = bins.shape[1] // 2, np.arange(near[0], near[1] + 1)
    return log_p, np.stack([each[:, middle - steps].mean(axis=1), each[:, middle + steps].mean(axis=1)], axis=1)


def test_tables_agree_with_their_twin(rng):
    bins, ratios = rng.integers(0, 9, (7, 35)), rng.normal(size=(3, 9))
    group, near = rng.integers(0, 3, 7), np.array([2, 9])
    log_p, sides = np.zeros((7, 26)), np.zeros((7, 2))
    kernels.offset_tables(bins, ratios, group, 1.5, 5, near, log_p, sides)
    expected = plain_tables(bins, ratios, group, 1.5, 5, near, 26)
    np.testing.assert_allclose(log_p, expected[0], atol=1e-9)
    np.testing.assert_allclose(sides, expected[1], atol=1e-12)


def plain_sites(log_p, lowest, expected, window):
    """NumPy twin of `kernels.sites`."""
    off = lowest + np.arange(log_p.shape[1]) - expected[:, None]
    p = np.exp(log_p - 0.5 * (off / window) ** 2)
    p /= p.sum(axis=1, keepdims=True)
    middle = (p * off).sum(axis=1)
    variance = (p * off**2).sum(axis=1) - middle**2 + 1.0 / 12.0
    left = 1.0 / variance - window**-2.0
    told = left > 0.0
    safe = np.where(told, left, 1.0)
    return np.where(told, expected + middle / variance / safe, expected), np.where(told, left, 0.0)


def test_sites_agree_with_their_twin_and_find_a_gaussian(rng):
    log_p, expected = np.log(rng.dirichlet(np.ones(26), size=9)), rng.normal(0.0, 2.0, 9)
    mean, precision = np.zeros(9), np.zeros(9)
    kernels.sites(log_p, -12.5, expected, 2.5, mean, precision)
    twin = plain_sites(log_p, -12.5, expected, 2.5)
    np.testing.assert_allclose(mean, twin[0], atol=1e-9)
    np.testing.assert_allclose(precision, twin[1], atol=1e-9)
    offsets = -12.5 + np.arange(26)
    sharp = -0.5 * ((offsets - 1.3) / 1.5) ** 2
    kernels.sites(sharp[None], -12.5, np.zeros(1), 4.0, mean[:1], precision[:1])
    assert abs(mean[0] - 1.3) < 0.02
    # a pixel's width is added to what a table of whole pixels tells
    assert 1.5 < precision[0] ** -0.5 < 1.7


def plain_shifts(log_p, lowest, normals, most, unknown):
    """NumPy twin of `kernels.shift_scores`."""
    out = np.zeros((2 * most + 1, 2 * most + 1))
    for a in range(-most, most + 1):
        for b in range(-most, most + 1):
            j = np.floor(normals @ [b, a] - lowest + 0.5).astype(int)
            good = (j >= 0) & (j < log_p.shape[1])
            told = log_p[np.arange(len(j)), np.clip(j, 0, log_p.shape[1] - 1)]
            out[a + most, b + most] = np.where(good, told, unknown).mean()
    return out


def test_shifts_agree_with_their_twin(rng):
    log_p, turn = np.log(rng.dirichlet(np.ones(26), size=9)), rng.uniform(0, 6, 9)
    normals, scores = np.stack([np.cos(turn), np.sin(turn)], axis=1), np.zeros((25, 25))
    kernels.shift_scores(log_p, -12.5, normals, 12, -5.0, scores)
    np.testing.assert_allclose(scores, plain_shifts(log_p, -12.5, normals, 12, -5.0), atol=1e-12)


# a round thing darkens towards its rim: in grey that is an edge of its own
@pytest.mark.parametrize(("name", "grey", "most"), [("box", False, 0.1), ("box", True, 0.7), ("mug", False, 0.4)])
def test_lines_find_the_outline_to_a_fraction_of_a_pixel(name, grey, most):
    frame, model = coloured(name)
    image = np.repeat(frame.rgb[..., :1], 3, axis=2) if grey else frame.rgb
    outline = outline_of(model, frame.camera, frame.camera_from_object_truth)
    lines = lines_across(image, outline)
    assert lines.grey == grey
    mean, precision = np.zeros(len(lines)), np.zeros(len(lines))
    kernels.sites(lines.log_p, lines.lowest, mean.copy(), 2.5, mean, precision)
    told = precision > 0.2
    assert told.mean() > 0.5
    assert np.median(np.abs(mean[told])) < most


def test_the_matrix_and_the_gradient_are_those_of_the_outline():
    frame, model = coloured("box")
    truth = frame.camera_from_object_truth
    off = np.array([0.004, -0.006, 0.003, 0.0008, -0.0006, 0.0004])
    evidence = evidence_at(frame, model, poses.perturb(truth, off, model.centroid))
    outline = evidence.lines.outline
    # a place moves along its normal as its point of the surface does
    for k in range(6):
        delta = np.zeros(6)
        delta[k] = 1e-6
        at = poses.perturb(truth, off, model.centroid)
        shift = poses.perturb(at, delta, model.centroid) @ poses.inverse(at)
        uv, _ = frame.camera.project(poses.apply(shift, outline.points))
        moved = np.einsum("ij,ij->i", uv - outline.places, outline.normals) / 1e-6
        np.testing.assert_allclose(evidence.jacobian[:, k], moved, rtol=1e-3, atol=0.5)
    gradient, hessian = evidence.terms(np.zeros(6))
    assert np.linalg.eigvalsh(hessian).min() > -1e-9 * np.linalg.eigvalsh(hessian).max()
    # downhill is towards the truth
    back = poses.difference(truth, poses.perturb(truth, off, model.centroid), model.centroid)
    assert gradient @ back < 0.0


@pytest.mark.parametrize("name", ["box", "drill"])
def test_descent_leads_back_across_the_ray(name):
    frame, model = coloured(name)
    truth = frame.camera_from_object_truth
    off = np.array([0.0, 0.0, 0.01, 0.0015, -0.001, 0.0])
    at = poses.perturb(truth, off, model.centroid)
    weak = np.diag(np.repeat([(1.0 / 0.05) ** 2, (1.0 / 0.003) ** 2], 3))
    for _ in range(3):
        evidence, delta = evidence_at(frame, model, at, ContourSettings(shift=0.1, learned=True)), np.zeros(6)
        for _ in range(4):
            gradient, hessian = evidence.terms(delta)
            delta = delta - np.linalg.solve(hessian + weak, gradient + weak @ delta)
        at = poses.perturb(at, delta, model.centroid)
    left = poses.difference(at, truth, model.centroid)
    assert np.linalg.norm(left[3:5]) < 0.0007
    assert abs(left[2]) < 0.006


def test_what_is_behind_something_says_nothing():
    frame, model = coloured("box")
    pose = frame.camera_from_object_truth
    middle = frame.camera.project(poses.apply(pose, model.centroid[None]))[0][0]
    open_lines = evidence_at(frame, model, pose).count
    depth = frame.depth.copy()
    depth[:, : int(middle[0])] = pose[2, 3] - 0.1
    covered = evidence_at(replace(frame, depth=depth), model, pose)
    assert 0.2 * open_lines < covered.count < 0.8 * open_lines
    assert covered.lines.outline.places[:, 0].min() > middle[0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rgb: np.zeros_like(rgb), "dark"),
        (lambda rgb: np.full_like(rgb, 255), "overexposed"),
        (lambda rgb: np.full_like(rgb, 127), "no contrast"),
    ],
)
def test_an_image_that_tells_nothing_is_said(change, said):
    frame, model = coloured("box")
    evidence = evidence_at(replace(frame, rgb=change(frame.rgb)), model, frame.camera_from_object_truth)
    assert said in evidence.why_not


def test_no_image_is_said():
    frame, model = coloured("box")
    assert "no colour" in evidence_at(replace(frame, rgb=None), model, frame.camera_from_object_truth).why_not


def test_a_shifted_image_is_noticed():
    frame, model = coloured("mug")
    truth = frame.camera_from_object_truth
    covariance = np.diag(np.repeat([0.01**2, 0.001**2], 3))
    assert not evidence_at(frame, model, truth).beside_depth(covariance).any()
    beside = replace(frame, rgb=np.roll(frame.rgb, 10, axis=1))
    np.testing.assert_allclose(evidence_at(beside, model, truth).beside_depth(covariance), [10.0, 0.0], atol=1.0)
    # a pose that may be that far off is no reason to doubt the image
    assert not evidence_at(beside, model, truth).beside_depth(400.0 * covariance).any()


def test_an_object_of_the_colour_of_its_ground_says_little():
    frame, model = coloured("box")
    rng = np.random.default_rng(0)
    plain = np.clip(rng.normal(120.0, 12.0, frame.rgb.shape), 0, 255).astype(np.uint8)
    evidence = evidence_at(replace(frame, rgb=plain), model, frame.camera_from_object_truth)
    telling = evidence_at(frame, model, frame.camera_from_object_truth)
    assert np.trace(evidence.terms(np.zeros(6))[1]) < 0.1 * np.trace(telling.terms(np.zeros(6))[1])


def test_an_image_of_noise_says_nothing():
    frame, model = coloured("drill")
    noise = np.random.default_rng(1).integers(0, 256, frame.rgb.shape).astype(np.uint8)
    evidence = evidence_at(replace(frame, rgb=noise), model, frame.camera_from_object_truth)
    assert "lines only" in evidence.why_not
    told = evidence_at(frame, model, frame.camera_from_object_truth)
    assert told.lines.clear > 50
    assert told.unclear == 1.0 - told.lines.clear / told.count
    assert evidence.unclear > 0.8 > told.unclear
    assert evidence_at(replace(frame, rgb=None), model, np.eye(4)).unclear == 0.0


def test_settings_have_room_for_what_they_read():
    s = LineSettings()
    assert s.near[1] <= s.reach
    assert s.gap < s.reach + s.beyond


def test_lines_that_scatter_by_whole_blocks_count_less():
    frame, model = coloured("box")
    evidence = evidence_at(frame, model, frame.camera_from_object_truth)
    evidence.terms(np.zeros(6))
    assert evidence.beside == 0.0
    evidence.terms(np.zeros(6), (np.zeros(6), np.eye(6)))
    before, little = evidence.share.copy(), evidence.beside
    # no block is surer than a mesh is believed to be right
    assert (before < evidence.alone).all()
    # whole pieces of the outline, each seen elsewhere
    pieces = np.random.default_rng(1).integers(-2, 3, int(evidence._block.max()) + 1)[evidence._block]
    evidence.lines = replace(
        evidence.lines, log_p=np.array([np.roll(row, step) for row, step in zip(evidence.lines.log_p, pieces)])
    )
    evidence.terms(np.zeros(6), (np.zeros(6), np.eye(6)))
    assert evidence.share.max() < 0.7 * before.max()
    # and are off by about as much as they were moved, in metres
    pixel = float(np.median(evidence.lines.outline.points[:, 2])) / frame.camera.fx
    assert little < 0.3 * pixel < 0.7 * pixel < evidence.beside < 3.0 * pixel
    assert evidence_at(replace(frame, rgb=None), model, np.eye(4)).beside == 0.0


def test_a_pose_that_may_be_anywhere_is_not_read():
    frame, model = coloured("box")
    evidence = evidence_at(frame, model, frame.camera_from_object_truth)
    known, unknown = (np.diag([0.01] * 3 + [sigma] * 3) ** 2 for sigma in (0.001, 0.05))
    assert evidence.uncertain(known) == ""
    assert "looked for within 12 px" in evidence.uncertain(unknown)


def test_lines_are_read_farther_away_where_the_pose_is_less_known():
    """A border that each line has eight pixels outside: within 2.5 px it is none, within 8 px it is there."""
    frame, model = coloured("box")
    evidence = evidence_at(frame, model, frame.camera_from_object_truth)
    offsets = evidence.lines.lowest + np.arange(evidence.lines.log_p.shape[1])
    table = np.log(0.02 + np.exp(-0.5 * np.square(offsets - 8.0)))
    evidence.lines = replace(evidence.lines, log_p=np.tile(table, (len(evidence.lines), 1)))
    near, far = (evidence._weighted(np.zeros(6), window) for window in (0.0, 8.0))
    assert np.median(near[1]) < 0.2 * np.median(far[1])
    assert np.median(far[0]) == pytest.approx(-8.0, abs=1.5)
    known = 1e-6 * np.eye(6)
    assert evidence.spread_of(4.0 * known) == pytest.approx(2.0 * evidence.spread_of(known))


def test_what_a_colour_image_is_shifted_by_is_learned_from_the_frame():
    """Four pixels beside depth that is sure of the place: the lines' shared shift is believed, not the object's."""
    frame, model = coloured("box")
    pose, sure = frame.camera_from_object_truth, np.diag([1e-3] * 3 + [3e-4] * 3) ** 2
    moved = []
    for shift in (0, 4):
        evidence = evidence_at(replace(frame, rgb=np.roll(frame.rgb, shift, axis=1)), model, pose)
        believed = evidence.common_information[0, 0] ** -0.5
        for _ in range(3):  # lines are read where the shift that is found so far has them
            evidence.terms(np.zeros(6), (np.zeros(6), np.linalg.inv(sure)))
        moved.append(evidence.common_information[0, 0] ** -0.5)
        assert believed == COLOURED
    assert moved[0] == COLOURED
    assert 2.0 < moved[1] < 4.0


def test_lines_that_scatter_more_than_they_say_count_less():
    frame, model = coloured("box")
    evidence = evidence_at(frame, model, frame.camera_from_object_truth)
    assert evidence.lines is not None
    evidence.terms(np.zeros(6), (np.zeros(6), np.eye(6)))
    calm = evidence.share.mean()
    rng = np.random.default_rng(1)
    rolled = [np.roll(row, int(by)) for row, by in zip(evidence.lines.log_p, rng.choice([-2, 2], len(evidence.lines)))]
    evidence.lines = replace(evidence.lines, log_p=np.array(rolled))
    evidence.terms(np.zeros(6), (np.zeros(6), np.eye(6)))
    assert evidence.share.mean() < 0.7 * calm


def test_boxes_agree_with_the_cameras_own_projection(rng):
    camera, pose = Camera(600.0, 590.0, 160.0, 120.0, 320, 240), poses.exp(np.array([0.3, -0.2, 0.5, 0.02, 0.01, 0.6]))
    points, bounds = rng.normal(0.0, 0.05, (40, 3)), np.zeros(5)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    kernels.box(points, np.ascontiguousarray(pose[:3, :3]), pose[:3, 3].copy(), lens, bounds)
    seen = poses.apply(pose, points)
    uv, _ = camera.project(seen)
    expected = [uv[:, 0].min(), uv[:, 0].max(), uv[:, 1].min(), uv[:, 1].max(), seen[:, 2].min()]
    np.testing.assert_allclose(bounds, expected, atol=1e-9)
    rays = np.zeros((40, 6), dtype=np.float32)
    kernels.rays_through(uv, lens, np.ascontiguousarray(pose[:3, :3].T), np.zeros(3), rays)
    np.testing.assert_allclose(rays[:, 3:], (seen / seen[:, 2:]) @ pose[:3, :3], atol=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
def test_contrasts_agree_with_their_twin(rng, channels):
    colours = rng.integers(0, 256, (6, 35, channels), dtype=np.uint8)
    brightest, height, slope, change = np.zeros(256, dtype=np.int64), np.zeros(6), np.zeros(6), np.zeros((6, 25))
    levels = np.zeros((channels, 256), dtype=np.int64)
    kernels.contrasts(colours, 3, levels, brightest, height, slope, change)
    np.testing.assert_array_equal(
        levels, [np.bincount(own.ravel(), minlength=256) for own in colours.transpose(2, 0, 1)]
    )
    values = colours.astype(float)
    np.testing.assert_array_equal(brightest, np.bincount(colours.max(axis=2).ravel(), minlength=256))
    extent = values.max(axis=1) - values.min(axis=1)
    own = extent.argmax(axis=1)
    np.testing.assert_allclose(height, extent.max(axis=1))
    steps = 0.5 * np.abs(values[:, 2:] - values[:, :-2]).max(axis=1)
    np.testing.assert_allclose(slope, steps[np.arange(6), own])
    pairs = values[:, 1:] + values[:, :-1]
    np.testing.assert_allclose(change, np.abs(pairs[:, 3:] - pairs[:, :-3]).max(axis=2)[:, 3:28] / 2.0)


def test_counts_agree_with_their_twins(rng):
    bins, weight, sides = rng.integers(0, 9, (7, 35)), rng.uniform(size=(3, 7)), np.zeros((2, 9, 3))
    kernels.tally(bins, np.ascontiguousarray(weight.T), 16, 19, sides)
    for side, own in enumerate((bins[:, :16], bins[:, 19:])):
        each = np.array([np.bincount(row, minlength=9) for row in own])
        np.testing.assert_allclose(sides[side].T, weight @ each)
    places = rng.uniform(0.0, 20.0, (30, 2))
    count, found = np.zeros(30), np.zeros((30, 4))
    kernels.neighbours(places, 6.0, count)
    kernels.spreads(places, 6.0, found)
    off = places[:, None] - places[None]
    np.testing.assert_array_equal(count, (np.linalg.norm(off, axis=2) < 6.0).sum(axis=1))
    for i in range(30):
        near = places[(np.abs(off[i]) < 6.0).all(axis=1)]
        cov = np.cov(near.T, bias=True) if len(near) > 1 else np.zeros((2, 2))
        np.testing.assert_allclose(found[i], [len(near), cov[0, 0], cov[1, 1], cov[0, 1]], atol=1e-9)


@pytest.mark.parametrize("channels", [1, 3])
def test_counts_are_smoothed_along_every_axis_of_colour(rng, channels):
    levels, counts = 4, rng.uniform(size=(2, 4**channels, 5))
    grid = counts.reshape(2, *[levels] * channels, 5)
    for axis in range(1, channels + 1):
        padded = np.concatenate([np.take(grid, [0], axis), grid, np.take(grid, [-1], axis)], axis=axis)
        lower, upper = np.take(padded, range(levels), axis), np.take(padded, range(2, levels + 2), axis)
        grid = (lower + 2.0 * grid + upper) / 4.0
    kernels.smooth(counts, levels, np.zeros_like(counts))
    assert np.array_equal(counts, grid.reshape(counts.shape))


def test_a_border_is_bracketed_and_halved(rng):
    hit, u, v = rng.random((6, 9)) < 0.5, np.arange(9) * 2.0 + 1.0, np.arange(6) * 3.0
    grid = np.stack(np.meshgrid(u, v), axis=-1)
    pairs = []
    for first, second, here, there in (
        (hit[:-1], hit[1:], grid[:-1], grid[1:]),
        (hit[:, :-1], hit[:, 1:], grid[:, :-1], grid[:, 1:]),
    ):
        out, back = first & ~second, second & ~first
        pairs += [(here[out], there[out]), (there[back], here[back])]
    seen = np.where(hit, u + 10.0 * v[:, None], np.inf)
    inner, outer, depth = kernels.brackets(seen, u, v)
    assert np.array_equal(depth, inner @ [1.0, 10.0])
    assert np.array_equal(inner, np.concatenate([a for a, _ in pairs]))
    assert np.array_equal(outer, np.concatenate([b for _, b in pairs]))
    z = np.where(rng.random(len(inner)) < 0.5, np.inf, rng.random(len(inner)))
    depth, inside, middle = rng.random(len(inner)), np.isfinite(z), 0.5 * (inner + outer)
    expected = np.where(inside, z, depth)
    ends = np.where(inside[:, None], middle, inner), np.where(inside[:, None], outer, middle)
    kernels.narrow(inner, outer, middle, z, depth)
    assert np.array_equal(depth, expected)
    assert np.array_equal(inner, ends[0])
    assert np.array_equal(outer, ends[1])
