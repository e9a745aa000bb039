"""Motion between two colour images: marks on a textured plate that is moved exactly."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Frame
from vision.tracking.by_image import MarkSettings, is_coloured, marked, motion_between, rigid_motion

LENS = Camera(570.0, 560.0, 158.0, 121.0, 320, 240)
USUAL = MarkSettings()
PLACE = poses.make_pose(poses.exp_rotation(np.array([0.25, -0.2, 0.1])), [0.01, -0.005, 0.55])


def ink(x, y, seed):
    """(..., 3) colours of a plate at x, y (m): waves of 6 to 20 mm."""
    rng = np.random.default_rng(seed)
    out = np.zeros((*x.shape, 3))
    for _ in range(12):
        along, wave = rng.uniform(0, 2 * np.pi), rng.uniform(0.006, 0.02)
        phase, colour = rng.uniform(0, 2 * np.pi), rng.normal(size=3)
        out += np.sin(2 * np.pi * (x * np.cos(along) + y * np.sin(along)) / wave + phase)[..., None] * colour
    return 0.5 + 0.12 * out


def seen(place, index=0, half=(0.06, 0.045), before=None):
    """A frame of a plate at place (4, 4) before nothing, and which pixels are its own; before: another plate's."""
    rays = LENS.rays()
    depth, rgb = np.zeros(rays.shape[:2]), np.full(rays.shape, 0.1)
    own = np.zeros(depth.shape, dtype=bool)
    for number, (pose, size) in enumerate([(place, half), *([] if before is None else [before])]):
        normal = pose[:3, 2]
        z = (normal @ pose[:3, 3]) / (rays @ normal)
        local = poses.apply(poses.inverse(pose), (rays * z[..., None]).reshape(-1, 3)).reshape(rays.shape)
        on = (np.abs(local[..., 0]) < size[0]) & (np.abs(local[..., 1]) < size[1])
        depth, rgb = np.where(on, z, depth), np.where(on[..., None], ink(local[..., 0], local[..., 1], number), rgb)
        own = own | on if number == 0 else own & ~on
    levels = np.clip(np.rint(255 * rgb), 0, 255).astype(np.uint8)
    return Frame(index, camera=LENS, depth=depth.astype(np.float32), rgb=levels), own


def pixels(own):
    v, u = np.nonzero(own)
    return np.stack([u, v], axis=1)


def step(size=1.0):
    return poses.perturb(PLACE, size * np.array([0.03, -0.02, 0.04, 0.006, -0.004, 0.005]), np.zeros(3))


def test_marks_tell_how_a_plate_has_moved():
    first, own = seen(PLACE)
    marks = marked(first, pixels(own), 1.0, None, USUAL)
    assert 20 <= len(marks.uv) <= USUAL.most
    second, own = seen(step(), 1)
    found = motion_between(marks, second, np.eye(4), PLACE[:3, 3], USUAL)
    off = poses.difference(found.motion @ PLACE, step(), np.zeros(3))
    assert np.linalg.norm(off[3:]) < 4e-4
    assert np.linalg.norm(off[:3]) < np.deg2rad(0.3)
    assert off @ np.linalg.solve(found.covariance, off) < 16.0
    # those that are on it still go on, where they have moved to, with new ones beside them
    again = marked(second, pixels(own), 1.0, found.marks, USUAL)
    kept = (again.uv[:, None] == found.marks.uv[None]).all(axis=2).any(axis=1)
    assert kept.sum() >= 0.8 * len(found.marks.uv)
    third, _ = seen(step(2.0), 2)
    further = motion_between(again, third, found.motion, step()[:3, 3], USUAL)
    apart = poses.difference(further.motion @ found.motion @ PLACE, step(2.0), np.zeros(3))
    assert np.linalg.norm(apart[3:]) < 6e-4


def test_what_comes_before_it_does_not_take_it_along():
    """Another plate, 30 mm before it, moves the other way over a third of it."""
    cover = poses.make_pose(PLACE[:3, :3], PLACE[:3, 3] + [-0.045, 0.0, -0.03])
    first, own = seen(PLACE, before=(cover, (0.03, 0.06)))
    shifted = cover.copy()
    shifted[:3, 3] += [0.008, 0.0, 0.0]
    second, _ = seen(step(), 1, before=(shifted, (0.03, 0.06)))
    found = motion_between(marked(first, pixels(own), 1.0, None, USUAL), second, np.eye(4), PLACE[:3, 3], USUAL)
    off = poses.difference(found.motion @ PLACE, step(), np.zeros(3))
    assert np.linalg.norm(off[3:]) < 6e-4


def test_grey_images_and_bare_things_have_no_marks():
    first, own = seen(PLACE)
    grey = np.repeat(first.rgb[..., :1], 3, axis=2)
    assert is_coloured(first.rgb, USUAL)
    assert not is_coloured(grey, USUAL)
    assert not is_coloured(None, USUAL)
    assert marked(replace(first, rgb=grey), pixels(own), 1.0, None, USUAL) is None
    assert marked(first, np.zeros((0, 2), dtype=np.int64), 1.0, None, USUAL) is None
    plain = first.rgb.copy()
    plain[own] = (90, 60, 40)
    bare = marked(replace(first, rgb=plain), pixels(own), 1.0, None, USUAL)
    assert motion_between(bare, seen(step(), 1)[0], np.eye(4), PLACE[:3, 3], USUAL) is None


@pytest.mark.parametrize("lost", ["colour", "depth", "camera", "size", "infra-red", "elsewhere"])
def test_a_frame_without_what_it_takes_tells_no_motion(lost):
    first, own = seen(PLACE)
    marks = marked(first, pixels(own), 1.0, None, USUAL)
    second, _ = seen(step(), 1)
    gone = poses.make_pose(np.eye(3), [0.0, 0.0, -2.0])
    tiny = replace(LENS, width=20, height=20)
    changed = {
        "size": {"camera": tiny, "rgb": second.rgb[:20, :20], "depth": second.depth[:20, :20]},
        "infra-red": {"rgb": np.repeat(second.rgb[..., :1], 3, axis=2)},
        "colour": {"rgb": None},
        "depth": {"depth": None},
        "camera": {"camera": None, "depth": None},
    }.get(lost, {})
    expected = gone if lost == "elsewhere" else np.eye(4)
    assert motion_between(marks, replace(second, **changed), expected, PLACE[:3, 3], USUAL) is None


def test_the_fit_is_that_of_opencv(rng):
    """Exact points and pixels: the same motion as by Perspective-n-Point."""
    import cv2

    points = np.stack([*rng.uniform(-0.05, 0.05, (2, 40)), rng.uniform(0.5, 0.6, 40)], axis=1)
    truth = poses.perturb(np.eye(4), np.array([0.05, -0.03, 0.02, 0.004, 0.003, -0.006]), points.mean(axis=0))
    uv, z = LENS.project(poses.apply(truth, points))
    found, information, kept = rigid_motion(points, uv, z, LENS, np.eye(4), points.mean(axis=0), USUAL)
    assert kept.all()
    assert np.linalg.eigvalsh(information)[0] > 0.0
    matrix = np.array([[LENS.fx, 0, LENS.cx], [0, LENS.fy, LENS.cy], [0, 0, 1.0]])
    _, turn, move = cv2.solvePnP(points, uv, matrix, None)
    theirs = poses.make_pose(poses.exp_rotation(turn[:, 0]), move[:, 0])
    assert np.allclose(found, truth, atol=1e-6)
    assert np.allclose(found, theirs, atol=1e-4)
    # a few that are elsewhere, or nowhere, change nothing
    uv[:8] += 12.0
    z[8:12] = 0.0
    robust, _, kept = rigid_motion(points, uv, z, LENS, np.eye(4), points.mean(axis=0), USUAL)
    assert np.allclose(robust, truth, atol=1e-5)
    assert not kept[:8].any()
    assert kept[8:].all()
