"""Pieces of the image by depth and colour: what touches is parted, bad images are said."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fusion import estimate
from fusion.estimation.settings import EstimateSettings
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from vision.look.colours import parted_by_colour
from vision.picture.predictor import Predictor

VIEW = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
RED, GREEN, GREY = (180, 60, 50), (70, 150, 60), (128, 128, 128)
STEP = 3
USUAL = EstimateSettings()
PLAIN = replace(USUAL, look=replace(USUAL.look, colour=replace(USUAL.look.colour, used=False)))


@pytest.fixture(scope="module")
def box():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [0.05, 0.03, 0.02]
    import trimesh

    hull = trimesh.convex.convex_hull(corners)
    return ObjectModel("box", np.asarray(hull.vertices), np.asarray(hull.faces))


@pytest.fixture(scope="module")
def beside(box):
    """The box, and another of its depth that touches it: one smooth surface but for the colours."""
    pose = poses.make_pose(poses.exp(np.array([0.3, 0.2, 0.1, 0, 0, 0]))[:3, :3], [-0.04, 0.0, 0.45])
    other = pose @ poses.make_pose(None, [0.11, 0.0, 0.0])
    larger = box.vertices * [1.2, 1.6, 1.0]
    renderer = Renderer({"box": (box.vertices, box.faces), "other": (larger, box.faces)})
    seen = renderer.render(VIEW, {"box": pose, "other": other})
    rng = np.random.default_rng(5)
    rgb = np.array([GREY, RED, GREEN], dtype=np.int64)[seen.ids + 1] + rng.integers(-6, 7, (240, 320, 3))
    there = np.where(seen.ids >= 0, seen.depth, 0.8)  # a wall behind
    depth = (there + rng.normal(scale=0.0008, size=there.shape)).astype(np.float32)
    return Frame(0, camera=VIEW, depth=depth, rgb=rgb.astype(np.uint8), camera_from_object_truth=pose), seen.ids


def surfaces(frame):
    """Points, and one piece of all that is before the wall."""
    z = frame.depth[::STEP, ::STEP].astype(np.float64)
    v, u = np.mgrid[0 : VIEW.height : STEP, 0 : VIEW.width : STEP]
    points = np.stack([(u - VIEW.cx) / VIEW.fx * z, (v - VIEW.cy) / VIEW.fy * z, z], axis=2)
    return points, np.where(z < 0.7, 0, -1)


def test_what_touches_is_parted_where_colour_changes(beside):
    frame, ids = beside
    found = parted_by_colour(frame.rgb, *surfaces(frame))
    assert not found.why_not
    assert found.count == 2
    few = ids[::STEP, ::STEP]
    for one in range(2):
        mine = few[found.numbers == one]
        assert np.bincount(mine + 1).max() > 0.97 * len(mine)
    assert (found.numbers[few < 0] == -1).all()
    # what is too small for a part is left over of its piece
    assert found.numbers.max() <= found.count


def test_one_thing_seen_through_bars_is_one_group():
    z = np.full((80, 107), 0.5)
    v, u = np.mgrid[0:80, 0:107]
    points = np.stack([(u * STEP - VIEW.cx) / VIEW.fx * z, (v * STEP - VIEW.cy) / VIEW.fy * z, z], axis=2)
    bars = (u // 4) % 3 == 1  # 21 mm wide
    thing = (np.abs(v - 40) < 20) & (np.abs(u - 53) < 40)
    pieces = np.where(thing | bars, 0, -1)
    few = np.array([GREY, RED, GREEN])[np.where(bars, 2, thing.astype(int))].astype(np.uint8)
    rgb = np.repeat(np.repeat(few, STEP, axis=0), STEP, axis=1)[:240, :320]
    found = parted_by_colour(rgb, points, pieces)
    seen = thing & ~bars
    (group,) = [one for one in found.groups if np.isin(found.numbers[seen], one).mean() > 0.5]
    assert len(group) > 2
    assert np.isin(found.numbers[seen], group).mean() > 0.9
    assert np.isin(found.numbers[bars], group).mean() < 0.1
    # without being asked nothing is put together
    assert parted_by_colour(rgb, points, pieces, grouped=False).groups == ()


BAD = [
    (lambda rgb: np.repeat(rgb[..., :1], 3, axis=2), "no colours"),
    (np.zeros_like, "no colours"),
    (lambda rgb: (0.1 * rgb).astype(np.uint8), "dark"),
    (lambda rgb: np.where(rgb > 255, rgb, [[[255, 255, 255]]]).astype(np.uint8), "no colours"),
    (lambda rgb: np.clip(rgb.astype(int) + np.where(rgb > 200, 0, 205), 0, 255).astype(np.uint8), "overexposed"),
    (lambda rgb: np.full_like(rgb, 1) * np.array([150, 90, 80], np.uint8), "one colour"),
    (lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 9.0), "blurred"),
    (lambda rgb: np.roll(rgb, 10, axis=1), "registered"),
    (lambda rgb: np.roll(rgb, (-8, 8), axis=(0, 1)), "registered"),
]


@pytest.mark.parametrize(("change", "said"), BAD)
def test_an_image_that_tells_nothing_is_said_and_parts_nothing(beside, change, said):
    frame, _ = beside
    points, pieces = surfaces(frame)
    found = parted_by_colour(change(frame.rgb), points, pieces)
    assert said in found.why_not
    assert found.numbers is pieces
    assert found.groups == ()


@pytest.mark.parametrize("change", [lambda rgb: rgb[..., ::-1], lambda rgb: np.roll(rgb, (2, -2), axis=(0, 1))])
def test_swapped_channels_and_a_small_shift_part_the_same(beside, change):
    frame, ids = beside
    found, few = parted_by_colour(change(frame.rgb), *surfaces(frame)), ids[::STEP, ::STEP]
    # the larger of the groups that hold either box is of hardly anything else
    for one, other in ((0, 1), (1, 0)):
        held = max(((few[np.isin(found.numbers, group)] == one).sum(), k) for k, group in enumerate(found.groups))
        assert held[0] > 0.85 * (few == one).sum()
        assert (few[np.isin(found.numbers, found.groups[held[1]])] == other).sum() < 0.1 * held[0]


def test_nothing_to_part_is_no_matter(beside):
    frame, _ = beside
    points, pieces = surfaces(frame)
    assert "stands out" in parted_by_colour(frame.rgb, points, np.full_like(pieces, -1)).why_not
    assert "asked" in parted_by_colour(frame.rgb, points, pieces, PLAIN.look.colour).why_not
    # parted only where it is asked
    near = parted_by_colour(frame.rgb, points, pieces, box=(0, 0, 150, 240))
    assert (near.numbers[:, 50:] == -1).all()


def test_a_piece_that_goes_on_beyond_the_outline_earns_nothing(beside, box):
    frame, _ = beside
    truth = frame.camera_from_object_truth
    candidates = np.array([truth, truth @ poses.make_pose(None, [0.06, 0.0, 0.0])])
    points, pieces = surfaces(frame)
    found = parted_by_colour(frame.rgb, points, pieces)
    depth, without = DepthModel(), np.zeros((0, 6))
    plain = Predictor(frame, box, depth, None, None, without, pieces)
    coloured = Predictor(frame, box, depth, None, None, without, found.numbers, found.count)
    assert np.array_equal(plain.predict(candidates).beyond, np.zeros(2))
    here, there = coloured.predict(candidates).beyond
    assert here < 0.01
    assert there > 0.1
    before, after = np.diff(plain.costs(candidates))[0], np.diff(coloured.costs(candidates))[0]
    assert after > before + 10.0
    # no more is lost than was earned
    assert (coloured.predict(candidates).beyond <= coloured.predict(candidates).seen + 1e-12).all()


def line(answer, name):
    return next(stage for stage in answer.trace if name in stage.name)


def off(answer, frame):
    return float(np.linalg.norm(answer.pose[:3, 3] - frame.camera_from_object_truth[:3, 3]))


def test_pieces_by_colour_propose_without_a_start_and_the_trace_says_so(beside, box):
    frame, _ = beside
    answer = estimate(frame, box)
    assert line(answer, "colours").rows == 2
    assert (
        line(answer, "by colour").ran
        or "convinces" in line(answer, "by colour").why
        or "explains" in line(answer, "by colour").why
    )
    assert off(answer, frame) < 0.004
    assert np.array_equal(answer.pose, estimate(frame, box).pose)


@pytest.mark.parametrize(("change", "said"), [BAD[0], BAD[2], BAD[6], BAD[7]])
def test_where_colour_tells_nothing_the_answer_is_that_without_it(beside, box, change, said):
    frame = replace(beside[0], rgb=change(beside[0].rgb))
    answer, plain = estimate(frame, box), estimate(frame, box, settings=PLAIN)
    assert said in line(answer, "colours").why
    assert not [stage.name for stage in answer.trace if "by colour" in stage.name]
    assert np.array_equal(answer.pose, plain.pose)
    assert np.array_equal(answer.covariance, plain.covariance)


def test_with_a_mask_or_a_hand_nothing_is_parted(beside, box):
    frame, ids = beside
    answer = estimate(replace(frame, mask=ids == 0), box)
    assert not line(answer, "colours").ran
    assert "told apart" in line(answer, "colours").why
