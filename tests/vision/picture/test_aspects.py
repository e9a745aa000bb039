"""What an object shows to each side: its points are seen, costs by them are nearly those by rays, and what plain arrays
say.
"""

from dataclasses import replace

import numpy as np
import predicted_twin
import pytest
from made_frames import plain_view

from scenes.geometry import poses
from scenes.recordings.beliefs import DepthModel
from scenes.synthesis import library
from vision.look.look import look
from vision.picture import aspects as making
from vision.picture import columns
from vision.picture.aspect_kernels import aspect_at
from vision.picture.aspects import aspects_of, directions, make_aspects
from vision.picture.predictor import Predictor


def which_of(model, pose, cells):
    """The aspect that a camera sees of the object at pose."""
    return aspect_at(cells, *(poses.inverse(pose)[:3, 3] - model.centroid))


def test_a_direction_is_in_its_own_cell_and_any_other_is_near_one(rng):
    cells = making.CELLS
    known = directions(cells)
    assert [aspect_at(cells, *(0.3 * one)) for one in known] == list(range(len(known)))
    some = rng.normal(size=(2000, 3))
    some /= np.linalg.norm(some, axis=1, keepdims=True)
    nearest = np.array([known[aspect_at(cells, *one)] for one in some])
    assert np.rad2deg(np.arccos(np.einsum("ni,ni->n", some, nearest))).max() < 0.75 * 90.0 / cells
    # where faces meet
    for corner in ([1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [0.0, -1.0, 1.0], [0.0, 0.0, -1.0], [1.0, -1.0, 0.0]):
        found = known[aspect_at(cells, *corner)]
        assert found @ corner / np.linalg.norm(corner) > np.cos(np.deg2rad(0.75 * 90.0 / cells))


def test_a_camera_at_the_centroid_sees_any_aspect():
    assert aspect_at(making.CELLS, 0.0, 0.0, 0.0) == 0
    assert aspect_at(making.CELLS, np.nan, np.nan, np.nan) == 0


def test_points_are_on_the_surface_and_neighbours_beside_each_other():
    model = library.make("mug")
    made = make_aspects(model, 3, 10)
    assert aspects_of(model) is aspects_of(model)
    assert len(made.count) == 6 * 9
    for which, towards in enumerate(directions(3)):
        count = made.count[which]
        points, near = made.points[which, :count].astype(np.float64), made.near[which, :count]
        assert np.abs(model.surface.closest(points)[0]).max() < 1e-6
        # nothing is in front of them
        from_there = model.centroid + making.AWAY * model.radius * towards
        shortest = model.surface.cast(np.broadcast_to(from_there, points.shape), points - from_there)
        np.testing.assert_allclose(shortest, 1.0, atol=1e-5)
        for way in range(4):
            has = near[:, way] >= 0
            np.testing.assert_array_equal(near[near[has, way], (way + 2) % 4], np.flatnonzero(has))
        # the cells add up to the outline: some hundredths of what the object is wide
        area = count * made.cell[which]
        assert 0.3 * model.mean_outline < area < 2.0 * model.mean_outline


@pytest.mark.parametrize("known", ["nothing", "hand", "mask", "plane", "pieces", "parts"])
def test_the_kernel_says_what_plain_arrays_say(lab_frame, drill, rng, known):
    truth, bare = lab_frame.camera_from_object_truth, replace(lab_frame, mask=None)
    normal = np.array([0.1, 0.2, -1.0]) / np.linalg.norm([0.1, 0.2, -1.0])
    wall = np.array([[*normal, -float(normal @ truth[:3, 3]) - 0.03, 1.0, np.inf]])
    pieces = rng.integers(-1, 4, size=[-(-size // 3) for size in bare.depth.shape]).repeat(8, 0).repeat(8, 1)
    pieces = np.ascontiguousarray(pieces[: -(-bare.depth.shape[0] // 3), : -(-bare.depth.shape[1] // 3)])
    given = {
        "hand": {"hand": look(bare, drill, start=truth).seen_hand},
        "plane": {"planes": wall},
        "pieces": {"pieces": pieces},
        "parts": {"pieces": pieces, "parts": 3},
    }.get(known, {})
    found = Predictor(lab_frame if known == "mask" else bare, drill, DepthModel(), **given)
    around = [poses.displaced(truth, 0.3, 0.03, drill.centroid, rng) for _ in range(12)]
    far = [poses.make_pose(None, place) for place in ([0.0, 0.0, -0.5], [0.3, 0.0, 0.5], [0.0, 0.0, 0.02], [9, 0, 1.0])]
    candidates, of_it = np.array([truth, *around, *far]), aspects_of(drill)
    got = found.sketch(candidates)
    shares = got.seen, got.agree, got.past, got.hidden, got.behind_hand, got.outline, got.within
    columns = *shares, got.ends, got.dark, got.scatter, got.count
    for n, pose in enumerate(candidates):
        twin = predicted_twin.by_aspect(found, pose, of_it, which_of(drill, pose, making.CELLS))
        np.testing.assert_allclose([column[n] for column in columns], twin[0], atol=1e-9)
        np.testing.assert_allclose([got.area[n], got.beyond[n]], twin[1:], atol=1e-6)
    np.testing.assert_allclose(found.rough_costs(candidates), predicted_twin.cost(found, candidates, got), atol=1e-9)
    glimpsed = [predicted_twin.glimpse(found, pose, of_it, which_of(drill, pose, making.CELLS)) for pose in candidates]
    np.testing.assert_allclose(found.glimpse(candidates), glimpsed, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("name", ["box", "mug", "drill"])
def test_rough_costs_are_nearly_those_by_rays(name, rng):
    frame, model = plain_view(name), library.make(name)
    truth = frame.camera_from_object_truth
    found = Predictor(frame, model, DepthModel())
    some = np.array([truth, *(poses.displaced(truth, 0.2, 0.02, model.centroid, rng) for _ in range(200))])
    rough, fine = found.rough_costs(some), found.costs(some, 40)
    assert np.corrcoef(rough, fine)[0, 1] > 0.97
    assert np.abs(rough - fine).mean() < 8.0
    assert rough[0] < np.quantile(rough, 0.02)


@pytest.mark.parametrize("name", ["box", "mug", "drill"])
def test_a_glimpse_tells_what_is_hopeless(name, rng):
    frame, model = plain_view(name), library.make(name)
    truth = frame.camera_from_object_truth
    found = Predictor(frame, model, DepthModel())
    some = np.array([truth, *(poses.displaced(truth, 1.0, 0.05, model.centroid, rng) for _ in range(400))])
    passed = np.argsort(found.glimpse(some), kind="stable")[:100]
    best = np.argsort(found.rough_costs(some), kind="stable")[:5]
    assert 0 in passed
    assert np.isin(best, passed).all()


def test_a_glimpse_has_points_of_the_aspects_and_all_of_few(drill):
    known, few = aspects_of(drill), making.glimpses_of(drill, 24)
    assert few is making.glimpses_of(drill, 24)
    assert (few.count == np.minimum(known.count, 24)).all()
    for which in (0, 100, 700):
        mine, of_it = few.points[which, : few.count[which]], known.points[which, : known.count[which]]
        assert len(np.unique(mine, axis=0)) == len(mine)
        assert (mine[:, None] == of_it[None]).all(axis=2).any(axis=1).all()
    every = making.glimpses_of(drill, 1000)
    which = int(np.argmax(known.count))
    assert sorted(map(tuple, every.points[which, : every.count[which]])) == sorted(map(tuple, known.points[which]))


def test_costs_are_the_same_on_any_number_of_threads(monkeypatch, rng):
    monkeypatch.setattr(making, "ENOUGH", 5)
    monkeypatch.setattr(making, "ENOUGH_GLIMPSED", 5)
    frame, model = plain_view("mug"), library.make("mug")
    truth = frame.camera_from_object_truth
    found = Predictor(frame, model, DepthModel())
    some = np.array([truth, *(poses.displaced(truth, 0.3, 0.03, model.centroid, rng) for _ in range(60))])
    costs = []
    for threads in ("1", "3"):
        monkeypatch.setenv("PALPATE_THREADS", threads)
        costs.append((found.rough_costs(some), found.glimpse(some)))
    np.testing.assert_array_equal(costs[0], costs[1])


def test_without_an_image_nothing_is_told(drill):
    from scenes.recordings.frames import Frame

    blind = Predictor(Frame(0), drill, DepthModel())
    assert (blind.rough_costs(np.eye(4)[None]) == 0.0).all()
    assert (blind.glimpse(np.eye(4)[None]) == 0.0).all()


def test_an_object_that_is_nowhere_is_hidden():
    frame, model = plain_view("box"), library.make("box")
    found = Predictor(frame, model, DepthModel())
    nowhere = np.array(
        [poses.make_pose(None, place) for place in ([5.0, 0.0, 0.5], [0.0, 0.0, -0.5], [0.0, 0.0, 0.02])]
    )
    assert found.sketch(nowhere).shares[:, columns.HITS].max() == 0.0
    np.testing.assert_allclose(found.rough_costs(nowhere), found.score.hidden)
