"""Scenes as they are: tables, walls, neighbours, grippers, unknown hands, mounts, prints, meshes that are not right."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.recordings.captures import read_capture
from scenes.synthesis import library
from scenes.synthesis.grasping.gripping import plan_grip
from scenes.synthesis.gripper import GripperShape, parallel_gripper
from scenes.synthesis.noise.presets import PRESETS
from scenes.synthesis.recording import SynthesisSettings, synthesize, synthesize_frames
from scenes.synthesis.staging import mesh_errors, tables
from scenes.synthesis.staging.pieces import PIECES, Staging, staged

# A quarter of VGA: what is held here does not need more.
SMALL = SynthesisSettings(camera=Camera(285.0, 285.0, 159.5, 119.5, 320, 240), mask=True)
EXACT = PRESETS["none"]


def made(name, occlusion=0.3, hand=None, seed=3, noise=EXACT, **how):
    return synthesize_frames(library.make(name), hand, 1, occlusion, noise=noise, seed=seed, settings=SMALL, **how)[0]


def hidden(frame, model):
    alone, _ = Renderer({"object": (model.vertices, model.faces)}).own_pixels(
        frame.camera, {"object": frame.camera_from_object_truth}, "object"
    )
    return 1.0 - frame.mask.sum() / alone


def ground(frame, model):
    """The table's plane from the depth pixels far from the object: unit normal to the camera, and offset."""
    points = frame.camera.back_project(frame.depth, frame.depth > 0)
    centre = poses.apply(frame.camera_from_object_truth, model.centroid[None])[0]
    away = np.linalg.norm(points - centre, axis=1)
    best, normal, offset = 0, None, None
    rng = np.random.default_rng(0)
    near = points[away < 0.4]
    for _ in range(200):
        a, b, c = near[rng.choice(len(near), 3, replace=False)]
        n = np.cross(b - a, c - a)
        if np.linalg.norm(n) < 1e-9:
            continue
        n /= np.linalg.norm(n)
        count = (np.abs((near - a) @ n) < 1e-3).sum()
        if count > best:
            best, normal, offset = count, n * -np.sign(n @ a), a @ n * -np.sign(n @ a)
    return normal, offset


@pytest.mark.parametrize("name", ["mug", "drill", "l_block", "cylinder"])
def test_an_object_at_rest_stands_steadily(name):
    model = library.make(name)
    for seed in range(4):
        pose = tables.at_rest(model, np.random.default_rng(seed))
        z = poses.apply(pose, model.vertices)[:, 2]
        assert z.min() == pytest.approx(0.0, abs=1e-9)
        # the centre of mass is above the inside of what touches: in every direction some of it is farther out
        foot = poses.apply(pose, model.vertices)[z < tables.SUPPORT][:, :2]
        angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
        assert (foot @ np.stack([np.cos(angle), np.sin(angle)])).max(axis=0).min() > 0


def test_a_table_is_seen_from_above_and_carries_the_object():
    model = library.make("box")
    for seed in (1, 2):
        frame = made("box", 0.0, occluders="none", scene="table+wall", seed=seed)
        normal, offset = ground(frame, model)
        slope = np.arcsin(-normal[2])  # between the optical axis and the plane
        assert np.deg2rad(29) < slope < np.deg2rad(61)
        height = poses.apply(frame.camera_from_object_truth, model.vertices) @ normal - offset
        assert abs(height.min()) < 1e-3
        assert (frame.depth > 0).mean() > 0.5
        assert frame.hand is None


@pytest.mark.parametrize("asked", [0.0, 0.3])
def test_neighbours_hide_the_asked_share_and_touch_without_entering(asked):
    model = library.make("box")
    frame = made("box", asked, occluders="neighbours", scene="table", seed=4)
    assert hidden(frame, model) == pytest.approx(asked, abs=0.03)
    normal, offset = ground(frame, model)
    points = frame.camera.back_project(frame.depth, ~frame.mask & (frame.depth > 0))
    others = points[points @ normal - offset > 0.005]
    distance = model.field.distance(poses.apply(poses.inverse(frame.camera_from_object_truth), others))
    assert len(others) > 100
    assert distance.min() > -0.001
    assert distance.min() < 0.03


def test_a_gripper_closes_on_two_faces():
    hand, shape = parallel_gripper(), GripperShape()
    for name in ("box", "hammer", "drill"):
        model = library.make(name)
        grip = plan_grip(hand, model, seed=2)
        (half,) = grip.joints.values()
        assert 0 < half <= shape.travel
        on_object = poses.apply(poses.inverse(grip.hand_from_object), grip.contacts.points)
        assert np.abs(model.field.distance(on_object)).max() < 5e-4
        assert grip.contacts.normals[0, 1] > 0.9
        assert grip.contacts.normals[1, 1] < -0.9
        assert np.abs(np.abs(grip.contacts.points[:, 1]) - half).max() < 1e-3
        surface = poses.apply(poses.inverse(grip.hand_from_object), hand.points_on_surface(grip.joints))
        assert model.field.distance(surface).min() > -1.5e-3
        again = plan_grip(hand, model, seed=2)
        assert np.array_equal(again.hand_from_object, grip.hand_from_object)
    wide = np.array([0.2, 0.2, 0.2])
    cube = trimesh.creation.box(wide)
    from scenes.geometry.objects import ObjectModel

    with pytest.raises(InputError, match="fits between the pads"):
        plan_grip(hand, ObjectModel.from_mesh(np.array(cube.vertices), np.array(cube.faces), "crate"), seed=0)


def test_a_frame_with_a_gripper_knows_its_hand():
    frame = made("hammer", 0.2, parallel_gripper(), noise="lab", scene="table")
    assert frame.hand.name == "parallel_gripper"
    assert set(frame.contacts.sensors) == {"left_pad", "right_pad"}
    assert hidden(frame, library.make("hammer")) == pytest.approx(0.2, abs=0.03)


def test_an_unknown_hand_is_in_the_picture_only(hand):
    known, unknown = (made("drill", 0.5, hand, scene=scene) for scene in ("", "unknown-hand"))
    assert np.array_equal(known.depth, unknown.depth)
    assert known.hand is not None
    assert unknown.hand is None
    assert unknown.joints is None
    assert unknown.world_from_hand is None
    assert unknown.hand_from_object_truth is None
    assert np.array_equal(known.contacts.points, unknown.contacts.points)
    with pytest.raises(InputError, match="a hand whose fingertips measure"):
        made("drill", 0.5, hand, scene="unknown-hand", touch=("wrench",))


def test_an_adapter_is_seen_but_not_modelled(hand):
    frame = made("box", 0.4, hand, scene="adapter")
    assert hidden(frame, library.make("box")) == pytest.approx(0.4, abs=0.03)
    vertices, faces, _ = hand.mesh(frame.joints)
    modelled = Renderer(
        {"hand": (vertices, faces), "object": (library.make("box").vertices, library.make("box").faces)}
    )
    seen = modelled.render(frame.camera, {"hand": frame.world_from_hand, "object": frame.camera_from_object_truth})
    nearer = (frame.depth > 0) & (frame.depth < np.where(seen.depth > 0, seen.depth, np.inf) - 0.005)
    points = frame.camera.back_project(frame.depth, nearer)
    local = poses.apply(poses.inverse(frame.world_from_hand), points)
    mounts = (np.abs(local[:, 0]) < 0.1) & (local[:, 2] < -0.01) & (local[:, 2] > -0.1)
    assert mounts.sum() > 50


def test_a_print_colours_the_object_and_nothing_else():
    plain, inked = (made("box", 0.0, occluders="none", scene=scene) for scene in ("table", "table+print"))
    assert np.array_equal(plain.depth, inked.depth)
    changed = (plain.rgb != inked.rgb).any(axis=2)
    assert changed[plain.mask].mean() > 0.8
    assert not changed[~plain.mask].any()
    assert len(np.unique(inked.rgb[plain.mask] // 32, axis=0)) > 4


@pytest.mark.parametrize("name", ["mug", "box", "drill"])
def test_meshes_with_errors_share_the_frame(name):
    model = library.make(name)
    fat, scaled, scan = (mesh_errors.believed(model, error) for error in ("fat", "scaled", "scan"))
    points, _ = model.sample_surface(2000, seed=1)
    assert np.abs(fat.field.distance(points) + mesh_errors.FAT).mean() < 2e-4
    assert scaled.diameter == pytest.approx(1.01 * model.diameter)
    off = np.abs(scan.field.distance(points))
    assert 0.0007 < off.mean() < 0.003
    assert off.max() < 0.015
    # the true pose is the best one: no small motion brings the scan nearer by more than its bumps
    surface, _ = scan.sample_surface(4000, seed=2)
    rest = np.abs(model.field.distance(surface)).mean()
    for axis in range(3):
        for shift in (-0.003, 0.003):
            assert np.abs(model.field.distance(surface + shift * np.eye(3)[axis])).mean() > 0.8 * rest
    assert mesh_errors.believed(model, None) is model
    again = mesh_errors.believed(model, "scan")
    assert np.array_equal(again.vertices, scan.vertices)
    assert scan.symmetries is model.symmetries
    with pytest.raises(InputError, match="scaled"):
        mesh_errors.believed(model, "thin")


def test_a_capture_holds_what_the_estimator_is_told(tmp_path, hand):
    model = library.make("box")
    small = replace(SMALL, mask=False)
    capture = synthesize(
        tmp_path / "c", model, hand, 1, 0.3, seed=3, settings=small, scene="unknown-hand+print", mesh_error="scaled"
    )
    assert capture.model.diameter == pytest.approx(1.01 * model.diameter, rel=1e-4)
    notes = read_capture(tmp_path / "c").manifest.notes
    assert (notes["scene"], notes["mesh_error"]) == ("print+unknown-hand", "scaled")
    assert capture[0].hand is None


def test_bad_scenes_are_refused_in_one_line():
    assert staged("table + wall") == Staging(table=True, wall=True)
    assert staged(staged("print+table").name) == Staging(table=True, printed=True)
    assert all(staged(piece).name == piece for piece in PIECES)
    for scene, occluders, says in (
        ("desk", "none", "adapter"),
        ("", "neighbours", "a scene with a table"),
        ("adapter", "none", "a hand that grasps for 'adapter'"),
        ("unknown-hand", "fingers", "a hand that grasps for 'unknown-hand'"),
    ):
        with pytest.raises(InputError, match=says):
            made("box", None, occluders=occluders, scene=scene)


@pytest.mark.parametrize("name", [*library.tool_names(), *library.held_out_names()])
def test_objects_beside_the_library_are_closed(name):
    model = library.make(name)
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    assert mesh.is_watertight
    assert mesh.body_count == 1
    assert model.mended == ()
    assert mesh.euler_number == (0 if name in ("kettle", "wrench") else 2)
    assert 0.1 < model.diameter < 0.35
    assert name not in library.names()
