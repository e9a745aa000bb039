"""What a camera would have to see of a pose: shares, costs, pixels and emptiness against rendered scenes."""

from dataclasses import replace

import numpy as np
import predicted_twin
import pytest
import trimesh
from made_frames import plain_view

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.depth_cameras import DEPTH_CAMERAS
from scenes.recordings.frames import Frame
from scenes.synthesis import library
from vision.look.look import look
from vision.picture import columns, kernels, scoring_kernels
from vision.picture.predictor import Predictor
from vision.picture.settings import PredictionSettings

AWAY = poses.make_pose(None, [0.0, 0.0, 0.03])


def predictor(frame, model, **known):
    return Predictor(frame, model, DepthModel(), **known)


@pytest.mark.parametrize("name", ["box", "mug", "drill"])
def test_the_true_pose_is_seen_and_others_are_not(name):
    frame, model = plain_view(name), library.make(name)
    truth = frame.camera_from_object_truth
    behind, before = AWAY @ truth, poses.inverse(AWAY) @ truth
    found = predictor(frame, model).predict(np.array([truth, behind, before]))
    assert found.agree[0] > 0.97
    assert found.seen[0] > 0.95
    assert found.past[0] < 0.03
    assert found.hidden[0] < 0.01
    # farther than it is, the object would be hidden by itself; nearer, the camera looks through it
    assert found.hidden[1] > 0.3
    assert found.past[2] > 0.3
    assert (found.count > 60).all()


def test_rays_meet_what_a_renderer_draws():
    frame, model = plain_view("mug"), library.make("mug")
    pose = frame.camera_from_object_truth
    view = predictor(frame, model).view(pose[None], 24)
    drawn = Renderer({"object": (model.vertices, model.faces)}).render(frame.camera, {"object": pose}).depth
    hit = view.has(columns.HIT)[0]
    u, v = view.at(np.flatnonzero(hit)).T
    np.testing.assert_allclose(view.expected[0, hit], drawn[v, u], atol=2e-6)


def test_of_few_poses_only_those_are_predicted_that_were_not(rng, monkeypatch):
    frame, model = plain_view("drill"), library.make("drill")
    truth, found = frame.camera_from_object_truth, predictor(frame, model)
    some = np.array([poses.displaced(truth, 0.1, 0.01, model.centroid, rng) for _ in range(5)])
    alone = [predictor(frame, model).costs(one[None])[0] for one in some]
    cast, asked = found._cast, []
    monkeypatch.setattr(found, "_cast", lambda many, side: asked.append(len(many)) or cast(many, side))
    for chosen in ([0, 2], [2, 1, 0], [3, 1, 4], [4, 3], [2]):
        np.testing.assert_array_equal(found.costs(some[chosen]), np.array(alone)[chosen])
    assert asked == [2, 1, 2]
    # as many as are ever solved together
    many = np.array([poses.displaced(truth, 0.1, 0.01, model.centroid, rng) for _ in range(13)])
    assert np.array_equal(found.costs(many), found.costs(many))
    assert asked == [2, 1, 2, 13]


@pytest.mark.parametrize("known", ["nothing", "hand", "mask", "plane", "camera"])
def test_the_kernels_say_what_plain_arrays_say(lab_frame, drill, rng, known):
    truth = lab_frame.camera_from_object_truth
    seen = look(replace(lab_frame, mask=None), drill, start=truth)
    # a wall through the object, so that pixels fall on either side of it
    normal = np.array([0.1, 0.2, -1.0]) / np.linalg.norm([0.1, 0.2, -1.0])
    near = -float(normal @ truth[:3, 3])
    wall = np.array([[*normal, near - 0.03, 1.0, np.inf], [*normal[[1, 0, 2]], near, 1.5, 0.0]])
    given = {"hand": seen.seen_hand} if known == "hand" else {"planes": wall} if known == "plane" else {}
    camera = DEPTH_CAMERAS["l515"] if known == "camera" else DepthModel()
    found = Predictor(lab_frame if known == "mask" else replace(lab_frame, mask=None), drill, camera, **given)
    around = [poses.displaced(truth, 0.3, 0.03, drill.centroid, rng) for _ in range(8)]
    far = [poses.make_pose(None, place) for place in ([0.0, 0.0, -0.5], [0.3, 0.0, 0.5], [0.0, 0.0, 0.02])]
    candidates = np.array([truth, *around, *far])
    for side in (7, 16):
        got = found.predict(candidates, side)
        expected = [predicted_twin.predicted(found, pose, side) for pose in candidates]
        np.testing.assert_allclose(predicted_twin.as_predicted(got), expected, atol=1e-9)
        beside = np.array([predicted_twin.beside_the_mask(found, pose) for pose in candidates])
        twin = predicted_twin.cost(found, candidates, got) + beside
        np.testing.assert_allclose(found.costs(candidates, side), twin, atol=1e-9)
        assert (beside.max() > 0.0) == (known == "mask")


def rod(bent=0.0):
    """A rod of 300 mm, 16 mm wide; with an arm at its end that reaches so far to the side."""
    if not bent:
        mesh = trimesh.creation.box((0.016, 0.016, 0.3))
        return ObjectModel.from_mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    corners = np.array([[0, 0], [0.016, 0], [0.016, 0.284], [bent, 0.284], [bent, 0.3], [0, 0.3]])
    caps = np.array([[0, 1, 2], [0, 2, 5], [2, 3, 4], [2, 4, 5]])
    ends = [np.insert(corners, 1, y, axis=1) for y in (0.0, 0.016)]
    sides = [[[k, k + 6, (k + 1) % 6], [(k + 1) % 6, k + 6, (k + 1) % 6 + 6]] for k in range(6)]
    faces = np.concatenate([caps, caps[:, ::-1] + 6, np.reshape(sides, (-1, 3))])
    return ObjectModel.from_mesh(np.concatenate(ends), faces)


def drawn(model, pose):
    """A frame that shows only the object at a pose."""
    camera = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
    depth = Renderer({"object": (model.vertices, model.faces)}).render(camera, {"object": pose}).depth
    return Frame(0, camera=camera, depth=depth)


@pytest.mark.parametrize("bent", [0.0, 0.1])
@pytest.mark.parametrize("degrees", [0.0, 31.0, 43.0, 76.0, 90.0, 137.0])
def test_as_many_rays_meet_a_stick_however_it_lies_in_the_image(rng, bent, degrees):
    model = rod(bent)
    turn = poses.exp_rotation([0.0, 0.0, np.deg2rad(degrees)]) @ poses.exp_rotation([np.deg2rad(80.0), 0.0, 0.0])
    pose = poses.make_pose(turn, [0.0, 0.0, 0.7])
    frame = drawn(model, pose)
    found = predictor(frame, model)
    # more rays are cast at what fills little of its box
    assert found.side == 16 if not bent else 18 < found.side <= 32
    here = found.predict(pose[None])
    assert here.count[0] > 80
    assert here.agree[0] > 0.85
    assert here.area[0] == pytest.approx((frame.depth > 0).sum(), rel=0.15)
    assert found.sketch(pose[None]).count[0] > 35
    around = np.array([poses.displaced(pose, 0.2, 0.02, model.centroid, rng) for _ in range(6)])
    for candidates in (np.concatenate([pose[None], around]), around[:1]):
        got = found.predict(candidates)
        expected = [predicted_twin.predicted(found, one, found.side) for one in candidates]
        np.testing.assert_allclose(predicted_twin.as_predicted(got), expected, atol=1e-9)


def test_a_surface_that_goes_through_the_object_is_another_thing(lab_frame, drill):
    """What hides the object ends in a step of depth; where the surface that agrees runs on to hide it, it is not it."""
    frame, model = plain_view("box"), library.make("box")
    truth = frame.camera_from_object_truth
    middle = poses.apply(truth, model.centroid[None])[0]
    turned = poses.make_pose(poses.exp_rotation([0.0, np.deg2rad(12.0), 0.0]), np.zeros(3))
    turned[:3, 3] = middle - turned[:3, :3] @ middle + 0.015 * middle / np.linalg.norm(middle)
    candidates = np.array([truth, turned @ truth])
    whole = np.zeros([-(-size // PredictionSettings().piece_step) for size in frame.depth.shape], dtype=np.int64)
    unknown, known = predictor(frame, model, pieces=whole), predictor(frame, model)
    found = unknown.predict(candidates)
    assert found.within[0] == 0.0
    assert found.within[1] > 0.15
    # it costs that, where nobody says what hides the object
    for looking in (unknown, known):
        got = looking.predict(candidates)
        np.testing.assert_allclose(looking.costs(candidates), predicted_twin.cost(looking, candidates, got), atol=1e-9)
    # fingers stand in front of what they hide
    held = predictor(replace(lab_frame, mask=None), drill).predict(lab_frame.camera_from_object_truth[None])
    assert held.hidden[0] > 0.4
    assert held.within[0] < 0.07


def test_the_cost_rises_with_distance_from_the_truth(rng):
    frame, model = plain_view("drill"), library.make("drill")
    truth = frame.camera_from_object_truth
    near = [poses.displaced(truth, np.deg2rad(4), 0.008, model.centroid, rng) for _ in range(12)]
    far = [poses.displaced(truth, np.deg2rad(20), 0.04, model.centroid, rng) for _ in range(12)]
    costs = predictor(frame, model).costs(np.array([truth, *near, *far]))
    assert costs[0] < costs[1:].min()
    assert np.median(costs[1:13]) < np.median(costs[13:])


def test_what_the_known_hand_hides_is_no_wonder(lab_frame, drill):
    truth = lab_frame.camera_from_object_truth[None]
    seen = look(replace(lab_frame, mask=None), drill, start=truth[0])
    known = predictor(lab_frame, drill, hand=seen.seen_hand).predict(truth)
    unknown = predictor(lab_frame, drill).predict(truth)
    assert known.behind_hand[0] > 0.4
    assert known.hidden[0] < 0.15
    assert unknown.behind_hand[0] == 0.0
    assert unknown.hidden[0] > 0.4


def on_a_table(model):
    """A box on a table that fills the image, seen at a slant, its lower face on the table; the table's plane."""
    camera = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
    tilt = poses.make_pose(poses.exp_rotation([np.deg2rad(130.0), 0.0, 0.0]), [0.0, 0.02, 0.6])
    low = float(model.vertices[:, 2].min())
    pose = tilt @ poses.make_pose(None, [0.0, 0.0, -low])
    table = ([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], [[0, 1, 2], [0, 2, 3]])
    drawn = Renderer({"object": (model.vertices, model.faces), "table": table})
    depth = drawn.render(camera, {"object": pose, "table": tilt}).depth
    normal = tilt[:3, 2] * np.sign(-tilt[:3, 2] @ tilt[:3, 3])
    return Frame(0, camera=camera, depth=depth), pose, np.array([[*normal, -normal @ tilt[:3, 3], 1.0, np.inf]])


def test_an_outline_counts_by_its_size_not_only_by_its_share():
    """A bottle's end that nothing hides says less than its side; an object of a few pixels says little, and so does
    what is predicted where the camera reads nothing.
    """
    frame, model = plain_view("bottle"), library.make("bottle")
    wall = replace(frame, depth=np.where(frame.depth > 0, frame.depth, 3.0).astype(np.float32))
    looking = predictor(wall, model)
    axis = np.argmax(np.ptp(model.vertices, axis=0))
    middle = poses.apply(frame.camera_from_object_truth, model.centroid[None])[0]
    ray = middle / np.linalg.norm(middle)
    side, end = np.eye(4), np.eye(4)
    for pose, toward in ((side, np.cross(ray, [0.0, 1.0, 0.0])), (end, ray)):
        pose[:3, :3] = turning(np.eye(3)[axis], toward / np.linalg.norm(toward))
        pose[:3, 3] = middle - pose[:3, :3] @ model.centroid
    far = poses.make_pose(None, 11.0 * middle) @ side
    where = np.array([side, end, far])
    picture = looking.predict(where)
    size = predicted_twin.size(looking, where, picture)
    np.testing.assert_allclose(looking.costs(where), predicted_twin.cost(looking, where, picture), atol=1e-9)
    assert size[0] > 1.5 * size[1] > 0.0
    assert size[2] == PredictionSettings().least_cells
    # as many pixels as a renderer draws
    drawn = Renderer({"object": (model.vertices, model.faces)})
    for pose, area in zip(where[:2], picture.area):
        assert area == pytest.approx((drawn.render(frame.camera, {"object": pose}).depth > 0).sum(), rel=0.1)
    away = poses.make_pose(None, [0.03, 0.0, 0.0]) @ side
    before_nothing = predictor(frame, model).predict(away[None]).area[0]
    assert before_nothing < 0.8 * looking.predict(away[None]).area[0]


def test_far_off_where_noise_is_as_large_as_the_object_agreement_tells_little():
    """The wall of a room agrees with whatever is laid onto it; the thing on the table does not owe it that."""
    model = library.make("box")
    near, far = (poses.make_pose(poses.exp_rotation([0.4, 0.3, 0.0]), [0.0, 0.0, z]) for z in (0.7, 4.5))
    frame = drawn(model, near)
    before_wall = replace(frame, depth=np.where(frame.depth > 0, frame.depth, 4.5).astype(np.float32))
    found = predictor(before_wall, model)
    beside = poses.make_pose(None, [0.9, 0.0, 0.0]) @ far
    picture = found.predict(np.array([near, beside]))
    assert picture.agree[1] > 0.9
    cost = found.costs(np.array([near, beside]))
    assert cost[0] < cost[1] - 15.0
    assert found.glimpse(near[None])[0] < found.glimpse(beside[None])[0] - 5.0
    # up to a metre a place is a place
    assert found._as_told(near[None], np.array([-7.0]))[0] == -7.0


def test_a_corner_that_reaches_into_the_image_earns_what_a_corner_does():
    model = library.make("box")
    whole = poses.make_pose(None, [0.0, 0.0, 0.6])
    frame = drawn(model, whole)
    found = predictor(frame, model)
    width = frame.camera.width
    # so far to the right that a tenth of it is left in the image
    right = (width - 1 - frame.camera.cx) / frame.camera.fx * 0.6 + 0.4 * np.ptp(model.vertices[:, 0])
    corner = poses.make_pose(None, [right, 0.0, 0.6])
    seen = drawn(model, corner)
    cut = predictor(seen, model).predict(corner[None])
    assert 0.02 < 1.0 - cut.hidden[0] < 0.3
    share = 1.0 - cut.hidden[0]
    for sketched in (cut, predictor(seen, model).sketch(corner[None])):
        assert sketched.ends[0] + sketched.dark[0] < 1.5 * share
    assert found.predict(whole[None]).ends[0] + found.predict(whole[None]).dark[0] > 0.9


def turning(a, b):
    """(3, 3) the smallest turn of direction a onto b."""
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis)
    return poses.exp_rotation((axis / max(sine, 1e-12) * np.arctan2(sine, a @ b))[None])[0]


def test_nothing_is_under_the_table_and_a_table_is_no_object():
    model = library.make("box")
    frame, pose, plane = on_a_table(model)
    sunk = poses.make_pose(None, -0.03 * plane[0, :3]) @ pose
    beside = poses.make_pose(None, [0.2, 0.0, 0.0]) @ sunk
    blind, told = predictor(frame, model), predictor(frame, model, planes=plane)
    assert told.predict(pose[None]).agree[0] > 0.9
    # flush with the table, beside the box: a smooth surface at the right depth, and not the object's
    assert told.predict(beside[None]).agree[0] < 0.2
    assert told.costs(beside[None])[0] > blind.costs(beside[None])[0]
    assert told.costs(pose[None])[0] < told.costs(np.array([sunk, beside])).min()


def test_where_the_hand_is_unknown_a_surface_counts_only_where_it_ends_as_the_object_does():
    """Whatever is smooth fits a face of a box; but the object ends in steps of depth, and so must what is seen."""
    frame, model = plain_view("box"), library.make("box")
    truth = frame.camera_from_object_truth[None]
    box = predictor(frame, model)
    assert not box._hand[0].size
    # the same face, going on in all directions
    depth = frame.depth.copy()
    rows, columns = np.nonzero(depth)
    flat = np.stack([columns, rows, np.ones(len(rows))], axis=1)
    plane = np.linalg.lstsq(flat, 1.0 / depth[rows, columns], rcond=None)[0]
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    wall = 1.0 / np.maximum(plane[0] * u + plane[1] * v + plane[2], 0.2)
    on_a_wall = predictor(replace(frame, depth=np.where(depth > 0, depth, wall).astype(np.float32)), model)
    here, there = box.predict(truth), on_a_wall.predict(truth)
    assert here.agree[0] == pytest.approx(there.agree[0], abs=0.02)
    assert here.ends[0] + here.dark[0] > 0.9
    assert there.ends[0] + there.dark[0] < 0.5
    assert there.outline[0] > 0.1
    assert on_a_wall.costs(truth)[0] > box.costs(truth)[0] + 20.0


def test_what_is_of_another_form_scatters(rng):
    """A pose laid onto a surface of about its size agrees with it, and is off now to one side, now to the other."""
    frame, model = plain_view("mug"), library.make("mug")
    truth = frame.camera_from_object_truth
    found = predictor(frame, model)
    bent = frame.depth + np.where(frame.depth > 0, 0.005 * np.sin(np.arange(frame.depth.shape[1]) / 6.0), 0.0)
    other = predictor(replace(frame, depth=bent.astype(np.float32)), model)
    assert found.predict(truth[None]).scatter[0] < 0.1
    assert other.predict(truth[None]).scatter[0] > 0.8
    # being off as a whole is none: that is a bias of the camera
    off = predictor(replace(frame, depth=np.where(frame.depth > 0, frame.depth + 0.004, 0.0).astype(np.float32)), model)
    assert off.predict(truth[None]).scatter[0] < 0.2


def test_pixels_inside_the_outline_lie_on_the_surface(lab_frame, drill):
    truth = lab_frame.camera_from_object_truth
    pixels = predictor(lab_frame, drill).shown(truth, 40)
    assert len(pixels) > 100
    local = poses.apply(poses.inverse(truth), pixels.points)
    assert np.median(np.abs(drill.field.distance(local))) < 0.004
    assert lab_frame.mask[pixels.uv[:, 1], pixels.uv[:, 0]].mean() > 0.9


@pytest.mark.parametrize("place", [[5.0, 0.0, 0.5], [0.0, 0.0, -0.5], [0.0, 0.0, 0.02]])
def test_poses_that_no_camera_sees_cost_a_number(place):
    frame, model = plain_view("box"), library.make("box")
    pose = poses.make_pose(None, place)
    found = predictor(frame, model)
    assert np.isfinite(found.costs(pose[None])).all()
    assert found.costs(pose[None])[0] > found.costs(frame.camera_from_object_truth[None])[0]
    assert len(found.shown(pose, 40)) == 0


def test_without_an_image_every_pose_costs_nothing(drill):
    from scenes.recordings.frames import Frame

    found = predictor(Frame(0), drill)
    assert not found.sees
    assert (found.costs(np.eye(4)[None]) == 0.0).all()


def test_an_empty_image_neither_sees_nor_contradicts():
    frame, model = plain_view("box"), library.make("box")
    empty = replace(frame, depth=np.zeros_like(frame.depth))
    shares = predictor(empty, model).predict(frame.camera_from_object_truth[None])
    assert shares.agree[0] == shares.past[0] == shares.hidden[0] == 0.0


def test_what_is_of_parts_that_go_on_is_what_plain_arrays_say(rng):
    poses_n, side, apart, labels, parts = 4, 6, 3, 5, 3
    pieces = rng.integers(-1, labels, size=(20, 30))
    sizes = rng.uniform(0.0, 4000.0, size=parts)
    u, v = rng.integers(-5, 95, size=(2, poses_n, side**2))
    step = rng.normal(size=(poses_n, 4)) * 8.0
    fade, total = rng.random(poses_n * side**2), rng.uniform(5.0, 40.0, size=poses_n)
    state = rng.integers(0, 4, size=poses_n * side**2).astype(np.uint8)
    fade[state & columns.HIT == 0] = 0.0
    beside, lost = 0.15, np.zeros(poses_n)
    scoring_kernels.part_pieces(pieces, apart, sizes, u, v, step, fade, state, total, beside, lost)
    label = pieces[np.clip(v // apart, 0, 19), np.clip(u // apart, 0, 29)]
    for n in range(poses_n):
        rays = slice(n * side**2, (n + 1) * side**2)
        area = abs(np.linalg.det(step[n].reshape(2, 2)))
        expected = 0.0
        for part in range(parts):
            mine = label[n] == part
            met = (state[rays][mine] & columns.HIT).sum()
            outside = max((1.0 - beside) * sizes[part] - met * area, 0.0) / max(total[n] * area, 1.0)
            expected += min(outside, fade[rays][mine].sum() / total[n])
        assert lost[n] == pytest.approx(expected, abs=1e-12)


def test_what_is_at_and_beside_each_pixel_is_as_by_numpy(rng):
    depth = rng.uniform(0.4, 0.6, (12, 17))
    depth[rng.uniform(size=depth.shape) < 0.7] = np.inf
    least, most = np.full(depth.shape, np.inf), np.full(depth.shape, -np.inf)
    kernels.spread(depth, least, most)
    wide = np.pad(depth, 1, constant_values=np.inf)
    around = np.stack([wide[j : j + 12, i : i + 17] for j in range(3) for i in range(3)])
    assert np.array_equal(least, around.min(axis=0))
    assert np.array_equal(most, np.where(np.isfinite(around), around, -np.inf).max(axis=0))


@pytest.mark.parametrize("known", [True, False])
def test_what_is_in_front_of_a_place_is_as_by_numpy(lab_frame, drill, rng, known):
    hand = look(lab_frame, drill).hand if known else None
    predictor = Predictor(lab_frame, drill, DepthModel(), hand)
    camera, s, belief = lab_frame.camera, predictor.settings, predictor.belief
    places = rng.uniform(-20.0, 1.0, (4000, 2)) + rng.uniform(size=(4000, 2)) * [camera.width + 40, camera.height + 40]
    places[:3] = np.nan
    u, v = np.round(places).astype(np.int64).T
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    seen = lab_frame.depth[v, u].astype(np.float64)
    beyond = np.where(rng.random(4000) < 0.5, seen + rng.normal(0.0, 0.02, 4000), rng.uniform(0.3, 1.2, 4000))
    smooth = np.hypot(belief.independent_sigma(beyond), belief.bias_sigma)
    hidden = (seen > 0.0) & (seen < beyond - s.tolerance * np.hypot(smooth, belief.scale_sigma * beyond))
    if known:
        drawn = predictor.known[0][2]
        hidden |= drawn[v // s.hand_step, u // s.hand_step] < beyond + s.hand_margin
    found = predictor.hides(places, beyond)
    np.testing.assert_array_equal(found, hidden | ~inside)
    assert 0 < found[inside].sum() < inside.sum()


def test_a_face_runs_on_over_a_straight_side_at_which_the_rays_end():
    """A box drawn into a board of which it is a part: the grid over its outline has no ray beyond its sides."""
    box, camera = library.make("box"), Camera(300.0, 300.0, 159.5, 119.5, 320, 240)
    pose = poses.make_pose(None, [0.0, 0.0, 0.5 + box.vertices[:, 2].max()])
    # the board ends where the box does on its left, and below it
    left, low = camera.fx * box.vertices[:, 0].min() / 0.5 + camera.cx, camera.fy * box.vertices[:, 1].max() / 0.5
    depth = np.full((240, 320), 1.0, dtype=np.float32)
    depth[: round(low + camera.cy) + 1, round(left) :] = 0.5
    found = predictor(Frame(0, camera=camera, depth=depth), box).predict(pose[None])
    assert found.agree[0] > 0.9
    assert found.running[0] > 0.35
    assert 0.3 < found.ends[0] < 0.65
    depth[:] = 1.0
    right, high = left + 2.0 * (camera.cx - left), camera.cy - low
    depth[round(high) : round(low + camera.cy) + 1, round(left) : round(right) + 1] = 0.5
    assert predictor(Frame(0, camera=camera, depth=depth), box).predict(pose[None]).running[0] < 0.05
