"""The object's pixels in a full scene: against the truth, and frames that hold nothing."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import DepthModel, usual_beliefs
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames
from vision.look.look import LookSettings, among_others, large_planes, look
from vision.look.mask.mask import connected_pieces, exceeds, object_mask
from vision.look.mask.piece_kernels import sizes_of
from vision.look.mask.planes import find_plane, find_planes, on_planes
from vision.look.mask.settings import MaskSettings
from vision.look.pixels import read_pixels
from vision.look.regions import find_region

NOTHING = Contacts(np.zeros((0, 3)))


def overlap(found, frame):
    read = frame.depth > 0
    return (found & frame.mask & read).sum() / ((found | frame.mask) & read).sum()


@pytest.fixture(scope="module")
def cylinder():
    return library.make("cylinder")


@pytest.fixture(scope="module")
def scene(cylinder):
    """Half hidden by the hand, before a near table with clutter on it."""
    settings = SynthesisSettings(mask=True, background_distance=(0.02, 0.15))
    return synthesize_frames(
        cylinder, five_finger_hand(), 1, 0.4, noise="lab", seed=11, occluders="hand+clutter", settings=settings
    )[0]


@pytest.mark.parametrize(("start", "touch", "colour"), [(1, 1, 1), (1, 1, 0), (0, 1, 1), (0, 0, 1)])
def test_the_mask_is_nearly_the_true_one(scene, cylinder, start, touch, colour):
    seen = replace(scene, mask=None, contacts=scene.contacts if touch else NOTHING)
    found = object_mask(seen, cylinder, start=scene.prior if start else None, colour=bool(colour))
    assert overlap(found, scene) > 0.75
    again = object_mask(seen, cylinder, start=scene.prior if start else None, colour=bool(colour))
    np.testing.assert_array_equal(found, again)


def test_what_the_hand_holds_from_behind_is_found():
    """Of a hammer before the hand the nearest piece that is seen may be a hand's breadth from it."""
    hammer = library.make("hammer")
    settings = SynthesisSettings(mask=True)
    frames = synthesize_frames(hammer, five_finger_hand(), 4, 0.0, noise="lab", seed=4, settings=settings)
    near = MaskSettings(fair_share=0.0)
    seen = [replace(frame, mask=None, contacts=NOTHING) for frame in frames]
    assert min(overlap(object_mask(one, hammer), frame) for one, frame in zip(seen, frames)) > 0.85
    assert min(overlap(object_mask(one, hammer, settings=near), frame) for one, frame in zip(seen, frames)) < 0.2


def wide_frame(length):
    """A board of that length (m) and its frame, 0.6 m before the camera, with a pixel that flies far beside it."""
    camera = Camera(500.0, 500.0, 199.5, 99.5, 400, 200)
    depth = np.zeros((200, 400), np.float32)
    half = int(0.5 * length * 500.0 / 0.6)
    depth[90:110, 200 - half : 200 + half] = 0.6
    mask = depth > 0
    depth[100, 390], mask[100, 390] = 0.6, True
    return Frame(0, camera=camera, depth=depth), mask


def test_a_piece_longer_than_the_object_is_not_it(cylinder):
    """What flies between two edges makes nothing longer, and no reading is no length."""
    for share, longer in ((0.9, False), (1.1, False), (1.4, True)):
        frame, mask = wide_frame(share * cylinder.diameter)
        assert exceeds(mask, frame, cylinder, MaskSettings()) == longer
        # wherever it is in the image
        moved = replace(frame, depth=np.roll(frame.depth, (70, -5), axis=(0, 1)))
        assert exceeds(np.roll(mask, (70, -5), axis=(0, 1)), moved, cylinder, MaskSettings()) == longer
    assert not exceeds(np.zeros_like(mask), frame, cylinder, MaskSettings())


def test_among_other_things_at_the_hand_nobody_says_which_is_the_object(scene, cylinder):
    """The hand's own pixels are its own all the same, and pieces of what is left propose."""
    seen = replace(scene, mask=None, contacts=NOTHING, prior=None)
    usual = look(seen, cylinder)
    assert usual.told_apart
    assert usual.at_hand
    found = among_others(seen, cylinder, usual.hand)
    assert not found.told_apart
    assert not found.at_hand
    assert found.pieces
    for pixels in (found.pixels, *found.pieces):
        assert not usual.hand.nearer(pixels.points, LookSettings().hand.margin).any()
    middles = [np.median(piece.points, axis=0) for piece in found.pieces]
    there = poses.apply(scene.camera_from_object_truth, cylinder.centroid[None])[0]
    assert min(np.linalg.norm(middle - there) for middle in middles) < cylinder.radius
    # touch says which it is
    assert not look(replace(seen, contacts=scene.contacts), cylinder).at_hand


def test_a_colour_image_without_colour_changes_nothing(scene, cylinder):
    grey = replace(scene, rgb=np.full_like(scene.rgb, 128))
    plain = object_mask(scene, cylinder, start=scene.prior, colour=False)
    np.testing.assert_array_equal(object_mask(grey, cylinder, start=scene.prior), plain)


def wall_frame(tilt, noise, seed=0):
    rng = np.random.default_rng(seed)
    camera = Camera(570.0, 570.0, 319.5, 239.5, 640, 480)
    pose = poses.make_pose(poses.exp_rotation((tilt, 0.3 * tilt, 0.0)), (0.0, 0.0, 1.0))
    wall = ([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    model = library.make("sphere")
    place = poses.make_pose(None, (0.05, 0.0, 0.7))
    seen = Renderer({"wall": wall, "ball": (model.vertices, model.faces)}).render(camera, {"wall": pose, "ball": place})
    depth = seen.depth + np.where(seen.depth > 0, noise * rng.normal(size=seen.depth.shape), 0.0)
    return Frame(0, camera=camera, depth=depth.astype(np.float32), mask=seen.mask("ball")), pose, model, place


def plane_of(frame):
    box = (0, 0, frame.camera.width, frame.camera.height)
    return find_plane(read_pixels(frame.depth, frame.camera, box, 3000).points, MaskSettings(), DepthModel())


@pytest.mark.parametrize("tilt", [0.0, 0.4, -0.6])
def test_the_wall_is_found_and_taken_away(tilt):
    frame, pose, model, place = wall_frame(tilt, 0.002)
    plane = plane_of(frame)
    assert abs(plane[:3] @ pose[:3, 2]) > np.cos(np.deg2rad(0.5))
    assert plane[:3] @ pose[:3, 3] + plane[3] == pytest.approx(0.0, abs=1e-3)
    assert plane[3] > 0  # the camera is above it
    assert overlap(object_mask(frame, model), frame) > 0.95
    assert overlap(object_mask(frame, model, start=place), frame) > 0.95


@pytest.mark.parametrize(("worse", "least", "most"), [(0.5, 1.0, 1.2), (3.0, 2.0, 4.0)])
def test_a_plane_says_how_far_its_readings_scatter(worse, least, most):
    """A camera that is worse than is believed of it: what it draws before a wall is the wall's all the same."""
    noise = worse * float(DepthModel().independent_sigma(np.array(1.4)))
    frame, *_ = wall_frame(0.0, noise)
    plane = plane_of(frame)
    assert least <= plane[4] <= most
    box = (0, 0, frame.camera.width, frame.camera.height)
    points = read_pixels(frame.depth, frame.camera, box, 3000).points
    wall = np.abs(points @ plane[:3] + plane[3]) < 0.05
    assert on_planes(points[wall], plane[None], DepthModel(), MaskSettings()).mean() > 0.98


def test_table_and_wall_are_both_found():
    camera = Camera(300.0, 300.0, 159.5, 119.5, 320, 240)
    v = (np.arange(240)[:, None] - camera.cy) / camera.fy
    # a table 30 cm under the camera and a wall 1.6 m away
    down = np.full(320, 0.3)
    table = np.where(v > 0.05, down / np.maximum(v, 1e-6), np.inf)
    depth = np.minimum(table, 1.6).astype(np.float32)
    frame = Frame(0, camera=camera, depth=depth)
    found = find_planes(frame, MaskSettings(), DepthModel(), 0.3)
    floor = find_planes(frame, MaskSettings(), DepthModel(), 0.3, floor_only=True)
    assert np.array_equal(floor, found[:1])
    assert len(found) == 2
    faces = np.abs(found[:, :3])
    assert sorted(int(row.argmax()) for row in faces) == [1, 2]
    assert (found[:, 3] > 0).all()
    assert found[0, 5] == np.inf
    assert found[1, 5] == 0.0
    points = read_pixels(depth, camera, (0, 0, 320, 240), 2000).points
    assert on_planes(points, found, DepthModel(), MaskSettings()).mean() > 0.99
    assert not len(find_planes(frame, MaskSettings(), DepthModel(), 9.0))


def test_a_box_seen_beyond_is_no_wall():
    """A surface behind which much else is seen is not what everything stands before."""
    frame, *_ = wall_frame(0.0, 0.0)
    depth = np.where(np.arange(640) < 300, frame.depth, 1.6).astype(np.float32)
    far = plane_of(replace(frame, depth=depth))
    assert far is None or far[3] > 1.5


def test_frames_that_hold_nothing(scene, cylinder):
    empty = replace(scene, depth=np.zeros_like(scene.depth))
    assert not object_mask(empty, cylinder, start=scene.prior).any()
    assert object_mask(empty, cylinder).shape == scene.depth.shape
    assert object_mask(replace(scene, depth=None), cylinder).size == 0
    away = scene.prior.copy()
    away[:3, 3] = (3.0, 0.0, 0.5)
    assert not object_mask(scene, cylinder, start=away).any()
    broken = scene.depth.copy()
    broken[::3] = np.nan
    assert object_mask(replace(scene, depth=broken), cylinder, start=scene.prior).any()
    nowhere = replace(scene, contacts=NOTHING, hand=None, joints=None, world_from_hand=None)
    assert find_region(nowhere, cylinder, None, 0.035) is None


def test_pieces_are_those_of_a_graph_of_neighbours(rng):
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    settings = MaskSettings()
    for _ in range(5):
        z = 0.6 + 0.004 * rng.normal(size=(30, 40)).cumsum(axis=1) + 0.1 * (np.arange(40) > 20)
        candidates = rng.random((30, 40)) < 0.8
        index = np.arange(z.size).reshape(z.shape)
        links = []
        for later, earlier in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
            near = np.abs(z[later] - z[earlier]) < settings.step + settings.step_share * z[later]
            near &= candidates[later] & candidates[earlier]
            links.append(np.stack([index[later][near], index[earlier][near]]))
        rows, columns = np.concatenate(links, axis=1)
        graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(z.size, z.size))
        labels = connected_components(graph, directed=False)[1].reshape(z.shape)
        _, first = np.unique(labels[candidates], return_index=True)
        order = np.argsort(np.argsort(first))
        expected = np.full(z.shape, -1)
        expected[candidates] = order[np.searchsorted(np.unique(labels[candidates]), labels[candidates])]
        np.testing.assert_array_equal(connected_pieces(z, candidates, settings), expected)
        np.testing.assert_array_equal(sizes_of(expected), np.unique(expected[candidates], return_counts=True)[1])
    none = connected_pieces(z, np.zeros(z.shape, dtype=bool), settings)
    assert (none == -1).all()
    assert len(sizes_of(none)) == 0


def test_points_on_planes_are_those_of_plain_arrays(rng):
    model, settings = DepthModel(), MaskSettings()
    points = rng.uniform([-0.3, -0.3, 0.3], [0.3, 0.3, 1.2], size=(40, 50, 3))
    planes = np.concatenate([poses_of_planes(rng), [[0.004, 0.02], [0.002, np.inf]]], axis=1)
    own, on = model.independent_sigma(points[..., 2]), np.zeros((40, 50), dtype=bool)
    for plane in planes:
        height = points @ plane[:3] + plane[3]
        noise = plane[4] * np.hypot(own, settings.plane_margin / settings.plane_sigmas)
        room = np.maximum(settings.plane_margin + settings.plane_sigmas * own, settings.plane_sigmas * noise)
        on |= (height <= room) & (height >= -np.maximum(room, plane[5]))
    assert 0 < on.sum() < on.size
    assert (on_planes(points, planes, model, settings) == on).all()


def poses_of_planes(rng):
    normals = poses.random_unit_vectors(2, rng)
    return np.concatenate([normals, -normals @ [[0.0], [0.0], [0.8]]], axis=1)


def test_a_hand_that_is_alone_in_the_image_is_no_wall():
    """Nothing is read behind it: most readings lie near some plane, which fills little of the image."""
    frame, _, model, place = wall_frame(0.0, 0.001)
    near = np.zeros(frame.depth.shape, dtype=bool)
    near[200:280, 260:420] = True  # what a palm and a forearm would be
    alone = replace(frame, depth=np.where(near | frame.mask, frame.depth, 0.0).astype(np.float32), mask=None)
    assert len(find_planes(frame, MaskSettings(), DepthModel(), 0.2))
    assert not len(find_planes(alone, MaskSettings(), DepthModel(), 0.1))
    assert object_mask(alone, model, start=place).sum() > 0.9 * frame.mask.sum()


def test_a_plane_that_cuts_through_what_is_seen_is_no_wall():
    """Many readings of a hand close to the camera lie near one plane or another, and it goes on behind them."""
    camera = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)
    u = (np.indices((120, 160))[1] - 80) / 80.0
    palm = Frame(0, camera=camera, depth=(0.6 + 0.1 * u + 0.05 * u * u).astype(np.float32))
    usual = MaskSettings()
    assert len(find_planes(palm, replace(usual, plane_most_behind=np.inf), DepthModel(), 0.1))
    assert not len(find_planes(palm, usual, DepthModel(), 0.1))


def test_what_hides_the_object_is_no_wall():
    """An arm's flat side before the object fills much of the image: what is asked for is behind it."""
    frame, _, model, place = wall_frame(0.5, 0.001)
    before, behind = (place[:3, 3] + np.array([0.0, 0.0, z]) for z in (0.0, 0.9))
    extent = 0.2
    assert len(find_planes(frame, MaskSettings(), DepthModel(), extent, before)) == 1
    assert not len(find_planes(frame, MaskSettings(), DepthModel(), extent, behind))
    # what a start, or else the contacts, say
    felt = Contacts(behind + 0.01 * np.eye(3))
    for one, start in ((frame, poses.make_pose(None, behind)), (replace(frame, contacts=felt), None)):
        assert not len(large_planes(one, model, usual_beliefs(), LookSettings(), start))
    assert len(large_planes(frame, model, usual_beliefs(), LookSettings(), place)) == 1
