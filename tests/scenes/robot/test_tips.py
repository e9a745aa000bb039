"""Fingertips of all shapes: what they are, grasps with them by an independent library, wrenches back to contacts."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.robot.fingers import find_fingers
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor, read_sensors, surface_hull, write_sensors
from scenes.robot.tips import ROUNDING, nearest, tip_of
from scenes.synthesis.grasping.grasps import plan_grasp
from scenes.synthesis.hands import HandShape, five_finger_hand
from scenes.synthesis.library import make
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames
from touch.wrenches.intrinsic import wrench_contacts

KINDS = ("ellipsoid", "cylinder", "mesh")


def sensor(kind: str, values: dict) -> Sensor:
    return Sensor("tip", "link", "wrench", np.eye(4), {kind: values})


def solid(kind: str, values: dict) -> trimesh.Trimesh:
    """The nominal shape, finely meshed."""
    if kind == "ellipsoid":
        ball = trimesh.creation.icosphere(subdivisions=5)
        return trimesh.Trimesh(ball.vertices * values["radii"], ball.faces, process=False)
    if kind == "cylinder":
        return trimesh.creation.cylinder(values["radius"], values["length"], sections=720)
    return trimesh.Trimesh(*surface_hull({kind: values}, "tip"), process=False)


def distance_to(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    kind = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    return igl.signed_distance(points, np.array(mesh.vertices), np.array(mesh.faces), sign_type=kind)[0]


def surface(kind: str) -> dict:
    hand = five_finger_hand(HandShape(tip=kind))
    return hand.sensors["index_tip"].surface[kind]


@pytest.mark.parametrize("kind", KINDS)
def test_the_core_lies_a_rounding_inside(kind):
    values = surface(kind)
    tip = tip_of(sensor(kind, values))
    inside = -distance_to(solid(kind, values), tip.samples(500))
    assert inside.min() > ROUNDING - 2e-5
    assert np.median(inside) < ROUNDING + 3e-5
    assert 0.006 < tip.radius < tip.extent < 0.02


@pytest.mark.parametrize("kind", KINDS)
def test_the_nearest_point_to_a_plane_is_the_support(kind):
    tip = tip_of(sensor(kind, surface(kind)))
    dense = tip.samples(60_000)
    rng = np.random.default_rng(2)
    for normal in poses.random_unit_vectors(12, rng):
        start = tip.samples(1200)
        start = start[np.argmin(start @ normal)]
        _, least = nearest(tip, lambda p, n=normal: p @ n + 0.02, start)
        assert least < (dense @ normal).min() + 0.02 + 2e-5


@pytest.mark.parametrize(("kind", "name"), [("ellipsoid", "bottle"), ("cylinder", "cylinder"), ("mesh", "mug")])
def test_grasps_touch_with_the_tip_and_enter_nothing(kind, name):
    hand, model = five_finger_hand(HandShape(tip=kind, sensor_kind="wrench")), make(name)
    grasp = plan_grasp(hand, model, seed=2)
    assert len(grasp.contacts) >= 3
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    object_from_hand = poses.inverse(grasp.hand_from_object)
    samples = hand.points_on_surface(grasp.joints, 0.004)
    assert distance_to(mesh, poses.apply(object_from_hand, samples)).min() > -1e-4
    points = poses.apply(object_from_hand, grasp.contacts.points)
    assert np.abs(distance_to(mesh, points)).max() < 1e-4
    frames = hand.hand_from_sensor(grasp.joints)
    for point, normal, tip in zip(grasp.contacts.points, grasp.contacts.normals, grasp.contacts.sensors):
        shape = solid(kind, hand.sensors[tip].surface[kind])
        local = poses.apply(poses.inverse(frames[tip]), point[None])
        # edges are rounded: a corner of three planes stands out by 0.73 roundings
        assert -1e-4 - 0.75 * ROUNDING < distance_to(shape, local)[0] < 1e-4
        assert distance_to(shape, local + 1e-3 * normal @ frames[tip][:3, :3])[0] < 0


@pytest.mark.parametrize("kind", KINDS)
def test_wrenches_of_simulated_grasps_tell_where_the_contact_is(kind):
    hand, model = five_finger_hand(HandShape(tip=kind, sensor_kind="wrench")), make("bottle")
    settings = SynthesisSettings(rgb=False, torsion_radius=0.0)
    frame = synthesize_frames(model, hand, 1, 0.4, ("wrench", "point"), "none", 3, settings=settings)[0]
    felt = wrench_contacts(frame)
    assert len(frame.wrenches) >= 3
    assert len(felt) >= len(frame.wrenches) - (kind != "ellipsoid")  # friction at an edge may fit neither side
    where = dict(zip(frame.contacts.sensors, frame.contacts.points))
    error = [np.linalg.norm(point - where[name]) for name, point in zip(felt.sensors, felt.points)]
    assert np.median(error) < 3e-4
    assert max(error) < (5e-4 if kind == "ellipsoid" else 3e-3)


def test_meshes_of_tips_travel_with_the_hand(tmp_path):
    hand = five_finger_hand(HandShape(tip="mesh"))
    again = Hand.load(hand.save(tmp_path / "hand"))
    (tmp_path / "hand").rename(tmp_path / "moved")
    moved = Hand.load(tmp_path / "moved" / "hand.urdf")
    for other in (again, moved):
        if other is again:
            continue
        tips = [find_fingers(h)[0].tip for h in (hand, other)]
        np.testing.assert_allclose(tips[0].samples(100), tips[1].samples(100), atol=1e-7)


def test_a_mesh_is_found_beside_its_file_and_must_be_a_solid(tmp_path):
    trimesh.creation.box(extents=(0.01, 0.012, 0.014)).export(tmp_path / "pad.stl")
    (tmp_path / "sensors.json").write_text(
        '{"s": {"link": "a", "kind": "wrench", "surface": {"mesh": {"file": "pad.stl"}}}}'
    )
    tip = tip_of(read_sensors(tmp_path / "sensors.json")["s"])
    assert tip.radius == pytest.approx(0.0066, abs=0.001)
    write_sensors(tmp_path / "other" / "sensors.json", read_sensors(tmp_path / "sensors.json"))
    assert tip_of(read_sensors(tmp_path / "other" / "sensors.json")["s"]).radius == pytest.approx(tip.radius)
    (tmp_path / "pad.stl").write_bytes(b"solid nothing")
    with pytest.raises(InputError, match="'s': expected a solid mesh"):
        tip_of(read_sensors(tmp_path / "sensors.json")["s"])
    (tmp_path / "pad.stl").unlink()
    with pytest.raises(InputError, match=r"'s': expected the mesh of its surface, found no file .*pad\.stl"):
        tip_of(read_sensors(tmp_path / "sensors.json")["s"])
    with pytest.raises(InputError, match="sphere, ellipsoid, cylinder, mesh, got 'cube'"):
        five_finger_hand(HandShape(tip="cube"))
