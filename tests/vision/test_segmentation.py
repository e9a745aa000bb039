"""Which pixels are the object's: rows, free space, counts, and frames that hold nothing."""

from dataclasses import replace

import igl
import numpy as np
import pytest

from scenes.evidence import table as evidence
from scenes.evidence.table import VISION
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from vision.look.look import LookSettings, look, object_points
from vision.look.looked import RowSettings, free_space_rows, surface_rows
from vision.look.points import all_points, crop_points
from vision.look.regions import find_region
from vision.starts import pixel_starts

SETTINGS, ROWS = LookSettings(), RowSettings()
NOTHING = Contacts(np.zeros((0, 3)))


def exact_distance(model, truth, points):
    return igl.signed_distance(
        np.ascontiguousarray(poses.apply(poses.inverse(truth), points)), model.vertices, model.faces
    )[0]


def test_every_pixel_is_counted_once(lab_frame, drill):
    lab_frame = replace(lab_frame, mask=None)
    found = look(lab_frame, drill, start=lab_frame.prior)
    assert found.dropped["hand pixels"] == len(found.of_hand)
    assert len(found.of_hand) > 100
    assert len(found.pixels) > 100
    assert len(found.pixels) + len(found.of_hand) <= SETTINGS.most_inside
    assert len(found.others) <= SETTINGS.most_others
    mine = {tuple(uv) for uv in found.pixels.uv}
    assert not mine & {tuple(uv) for uv in found.of_hand.uv}
    for part in (found.pixels, found.of_hand):
        assert (np.linalg.norm(part.points - found.region.centre, axis=1) < found.region.radius).all()


def test_what_is_left_is_mostly_the_object(exact_frame, drill):
    found = look(replace(exact_frame, mask=None), drill, start=exact_frame.prior)
    assert found.told_apart
    own = exact_frame.mask[found.pixels.uv[:, 1], found.pixels.uv[:, 0]]
    assert own.mean() > 0.6
    hand = exact_frame.mask[found.of_hand.uv[:, 1], found.of_hand.uv[:, 0]]
    assert hand.mean() < 0.3
    assert np.abs(exact_distance(drill, exact_frame.camera_from_object_truth, found.pixels.points[own])).max() < 3e-4


def test_a_mask_leaves_the_object_alone(exact_frame, drill):
    frame = replace(exact_frame, hand=None, joints=None, world_from_hand=None)
    found = look(frame, drill, start=frame.prior)
    assert frame.mask[found.pixels.uv[:, 1], found.pixels.uv[:, 0]].all()
    assert found.told_apart
    assert np.array_equal(object_points(frame, drill, frame.prior), found.pixels.points)


def test_rows_of_pixels_face_the_camera(lab_frame, drill):
    found = look(lab_frame, drill, start=lab_frame.prior)
    rows = surface_rows(found, DepthModel(), RowSettings(most=200))
    assert 0 < len(rows) <= 200
    assert (rows.sense == VISION).all()
    assert (rows.rows[:, evidence.FACING] == 1).all()
    rays = rows.rows[:, evidence.NORMAL]
    assert np.allclose(rays, rows.points / np.linalg.norm(rows.points, axis=1, keepdims=True))
    assert ((rows.rows[:, evidence.WEIGHT] > 0) & (rows.rows[:, evidence.WEIGHT] <= 1)).all()
    assert (rows.rows[:, evidence.SIGMA] > DepthModel().axial_floor).all()
    # twice as many rows say hardly more: neighbours share their bias
    more = surface_rows(found, DepthModel(), RowSettings(most=400))
    information = [(r.rows[:, evidence.WEIGHT] / r.rows[:, evidence.SIGMA] ** 2).sum() for r in (rows, more)]
    assert information[1] < 1.6 * information[0]


@pytest.mark.parametrize("hand_known", [True, False])
def test_free_space_is_never_inside_the_true_object(exact_frame, drill, hand_known):
    frame = replace(exact_frame, mask=None)
    if not hand_known:
        frame = replace(frame, hand=None, joints=None, world_from_hand=None)
    rows = free_space_rows(look(frame, drill, start=frame.prior), ROWS)
    assert len(rows) > 100
    assert (exact_distance(drill, frame.camera_from_object_truth, rows.points) > 0).all()
    assert (rows.rows[:, evidence.GATE_ABOVE] == 0).all()


def test_free_space_of_an_object_alone_before_a_wall():
    model = library.make("mug")
    camera_from_object = poses.make_pose(poses.exp_rotation([1.0, 0.5, 0.2]), [0.02, -0.01, 0.5])
    from scenes.geometry.cameras import Camera

    camera = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
    picture = Renderer({"object": (model.vertices, model.faces)}).render(camera, {"object": camera_from_object})
    depth = np.where(picture.depth > 0, picture.depth, 0.9).astype(np.float32)
    frame = Frame(0, camera=camera, depth=depth)
    found = look(frame, model, start=camera_from_object)
    rows = free_space_rows(found, ROWS)
    assert len(rows) > 100
    assert (exact_distance(model, camera_from_object, rows.points) > 0).all()
    assert not found.told_apart


def test_free_space_ends_at_the_camera(lab_frame, drill):
    start = np.eye(4)
    start[:3, 3] = -drill.centroid
    rows = free_space_rows(look(lab_frame, drill, start=start), ROWS)
    assert (rows.points[:, 2] > 0.0).all()


# ---- frames with little or nothing in them ----


def test_empty_depth_gives_nothing(lab_frame, drill):
    for depth in (np.zeros((480, 640), np.float32), np.full((480, 640), np.nan, np.float32)):
        frame = replace(lab_frame, depth=depth)
        found = look(frame, drill, start=frame.prior)
        assert len(found.pixels) == len(found.of_hand) == len(found.others) == 0
        assert len(surface_rows(found, DepthModel(), RowSettings(most=100))) == 0
        assert len(free_space_rows(found, ROWS)) == 0
        assert all_points(frame).shape == (0, 3)


def test_some_pixels_without_a_number(lab_frame, drill):
    depth = lab_frame.depth.copy()
    depth[::2] = np.nan
    found = look(replace(lab_frame, depth=depth), drill, start=lab_frame.prior)
    assert len(found.pixels) > 0
    assert np.isfinite(found.pixels.points).all()
    assert (found.pixels.uv[:, 1] % 2 == 1).all()


def test_a_region_outside_the_image_is_told(lab_frame, drill):
    for away in ([10.0, 0.0, 0.5], [0.0, 0.0, -1.0]):
        found = look(lab_frame, drill, start=poses.make_pose(None, away))
        assert found.dropped == {"region outside the image": 1}
        assert len(found.pixels) == 0
        assert len(free_space_rows(found, ROWS)) == 0


def test_no_camera_no_pixels(lab_frame, drill):
    found = look(replace(lab_frame, depth=None), drill, start=lab_frame.prior)
    assert len(found.pixels) == 0
    assert len(surface_rows(found, DepthModel(), RowSettings(most=100))) == 0


def test_the_region_comes_from_what_there_is(lab_frame, drill):
    truth = lab_frame.camera_from_object_truth
    middle = poses.apply(truth, drill.centroid[None])[0]
    by_start = find_region(lab_frame, drill, truth, SETTINGS.slack, lab_frame.mask)
    assert np.allclose(by_start.centre, middle)
    for frame in (
        replace(lab_frame, contacts=NOTHING),  # the mask
        replace(lab_frame, mask=None),  # the contacts
    ):
        region = find_region(frame, drill, None, SETTINGS.slack, frame.mask)
        assert np.linalg.norm(region.centre - middle) < region.radius
    region = find_region(replace(lab_frame, mask=None, contacts=NOTHING), drill, None, SETTINGS.slack)  # the fingertips
    assert np.linalg.norm(region.centre - middle) < region.radius
    lab_frame = replace(lab_frame, hand=None, joints=None, world_from_hand=None)
    assert find_region(replace(lab_frame, mask=None, contacts=NOTHING), drill, None, SETTINGS.slack) is None
    empty = replace(lab_frame, mask=np.zeros((480, 640), bool), contacts=NOTHING)
    assert find_region(empty, drill, None, SETTINGS.slack, empty.mask) is None


def test_a_mask_that_is_seen_through_is_looked_for_in_front(lab_frame, drill):
    # of glass, wire or filled holes most readings of a mask are what is behind
    middle = poses.apply(lab_frame.camera_from_object_truth, drill.centroid[None])[0]
    depth, read = lab_frame.depth.copy(), np.argwhere(lab_frame.mask & (lab_frame.depth > 0))
    behind = read[np.arange(len(read)) % 3 > 0]
    depth[tuple(behind.T)] += 1.0
    frame = replace(lab_frame, depth=depth, contacts=NOTHING, hand=None, joints=None, world_from_hand=None)
    found = look(frame, drill)
    assert np.linalg.norm(found.region.centre - middle) < drill.radius
    assert len(found.pixels) > 100
    assert (np.linalg.norm(found.pixels.points - middle, axis=1) < found.region.radius).all()
    # a few readings in front, as of a mask that leaks onto an arm, are not the object's
    depth = lab_frame.depth.copy()
    depth[tuple(read[::8].T)] -= 0.35
    found = look(replace(frame, depth=depth), drill)
    assert np.linalg.norm(found.region.centre - middle) < drill.radius


def test_without_any_hint_the_whole_image_is_looked_at(lab_frame, drill):
    frame = replace(lab_frame, mask=None, contacts=NOTHING, hand=None, joints=None, world_from_hand=None)
    found = look(frame, drill, start=None)
    assert found.region is None
    assert len(found.pixels) == SETTINGS.most_inside
    assert not found.told_apart


def test_a_cloud_in_the_world_frame(rng):
    model = library.make("box")
    camera_from_world = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    cloud, _ = model.sample_surface(300, seed=0)
    cloud[5] = np.nan
    frame = Frame(0, cloud=cloud, camera_from_world=camera_from_world)
    start = camera_from_world.copy()
    found = look(frame, model, start=start)
    assert found.is_cloud
    assert found.dropped == {"cloud points not finite": 1}
    assert len(found.pixels) == 299
    rows = surface_rows(found, DepthModel(), RowSettings(most=100))
    assert 90 <= len(rows) <= 100
    assert np.abs(exact_distance(model, camera_from_world, rows.points)).max() < 1e-6
    assert (rows.rows[:, evidence.FACING] == 0).all()
    assert len(free_space_rows(found, ROWS)) == 0
    assert len(crop_points(frame, model, start)) == 299


def test_starts_put_a_seen_point_on_the_surface_and_the_object_behind_it(lab_frame, drill, rng):
    found = look(lab_frame, drill, start=lab_frame.prior)
    starts = pixel_starts(drill, found.pixels.points, 200, rng)
    assert starts.shape == (200, 4, 4)
    rotation = starts[:, :3, :3]
    assert np.allclose(np.swapaxes(rotation, 1, 2) @ rotation, np.eye(3), atol=1e-9)
    placed = starts[1::2]
    for pose in placed[:30]:
        local = poses.apply(poses.inverse(pose), found.pixels.points)
        assert np.abs(drill.surface.closest(local)[0]).min() < 1e-6
    middles = poses.apply(starts, drill.centroid[None])[:, 0]
    assert np.median(middles[:, 2]) > np.median(found.pixels.points[:, 2])
