"""Hands: kinematics against pytransform3d on the written file, files there and back, refusals, geometry."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from pytransform3d.urdf import UrdfTransformManager

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor, read_sensors
from scenes.robot.urdf import Joint, Mimic, Robot, make_shape, read_urdf
from scenes.synthesis.hands import FINGERS, PALM_HALF_THICKNESS, five_finger_hand


@pytest.fixture(scope="module")
def hand() -> Hand:
    return five_finger_hand()


@pytest.fixture(scope="module")
def folder(hand: Hand, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hand")
    hand.save(path)
    return path


@pytest.fixture(scope="module")
def oracle(folder: Path) -> UrdfTransformManager:
    manager = UrdfTransformManager()
    manager.load_urdf((folder / "hand.urdf").read_text(), mesh_path=str(folder))
    return manager


def joints_at(hand: Hand, share: list[float]) -> dict[str, float]:
    low, high = hand.limits.T
    return dict(zip(hand.joint_names, low + np.array(share) * (high - low)))


shares = st.lists(st.floats(0, 1), min_size=16, max_size=16)


@settings(max_examples=30, deadline=None)
@given(shares)
def test_kinematics_agree_with_another_library(hand, oracle, share):
    joints = joints_at(hand, share)
    for name, value in joints.items():
        oracle.set_joint(name, value)
    for finger in FINGERS:  # this library leaves coupled joints to its caller
        oracle.set_joint(f"{finger}_dip", joints[f"{finger}_pip"] * 2 / 3)
    ours = hand.forward_kinematics(joints)
    for link in hand.link_names:
        np.testing.assert_allclose(ours[link], oracle.get_transform(link, "palm"), atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(shares)
def test_batched_kinematics_and_couplings(hand, share):
    joints = joints_at(hand, share)
    batch = hand.link_poses(np.stack([hand.configuration(joints), np.zeros(16)]))
    single = hand.forward_kinematics(joints)
    np.testing.assert_array_equal(batch[0], np.array([single[name] for name in hand.link_names]))
    bent = hand.forward_kinematics(joints | {"index_dip": 0.1})
    assert np.allclose(bent["index_middle"], single["index_middle"])
    inside = np.linalg.inv(bent["index_middle"]) @ bent["index_distal"]
    assert np.isclose(np.arccos(np.clip((np.trace(inside[:3, :3]) - 1) / 2, -1, 1)), 0.1, atol=1e-6)


def test_every_vertex_moves_with_its_link(hand):
    joints = dict.fromkeys(hand.joint_names, 0.3)
    vertices, faces, face_link = hand.mesh(joints)
    straight, _, _ = hand.mesh({})
    moved, still = hand.forward_kinematics(joints), hand.forward_kinematics({})
    for number, name in enumerate(hand.link_names):
        own = np.unique(faces[face_link == number])
        local = poses.apply(poses.inverse(still[name]), straight[own])
        np.testing.assert_allclose(vertices[own], poses.apply(moved[name], local), atol=1e-12)


def test_missing_joints_are_zero(hand):
    a, b = hand.forward_kinematics({}), hand.forward_kinematics(dict.fromkeys(hand.joint_names, 0.0))
    for link in hand.link_names:
        np.testing.assert_array_equal(a[link], b[link])


def test_save_and_load(hand, folder):
    again = Hand.load(folder / "hand.urdf")
    assert again.name == hand.name
    assert again.link_names == hand.link_names
    assert again.joint_names == hand.joint_names
    np.testing.assert_array_equal(again.limits, hand.limits)
    joints = joints_at(hand, [0.3] * 16)
    for link, pose in hand.forward_kinematics(joints).items():
        np.testing.assert_allclose(again.forward_kinematics(joints)[link], pose, atol=1e-12)
    for name, sensor in hand.sensors.items():
        other = again.sensors[name]
        assert (other.link, other.kind, other.surface) == (sensor.link, sensor.kind, sensor.surface)
        np.testing.assert_array_equal(other.link_from_sensor, sensor.link_from_sensor)
    ours, theirs = hand.mesh(joints), again.mesh(joints)
    for i in range(len(hand.link_names)):
        a = trimesh.Trimesh(ours[0], ours[1][ours[2] == i])
        b = trimesh.Trimesh(theirs[0], theirs[1][theirs[2] == i])
        assert len(a.faces) == len(b.faces)
        assert b.is_watertight
        assert np.isclose(a.volume, b.volume, rtol=1e-9)
        np.testing.assert_allclose(a.bounds, b.bounds, atol=1e-12)
    assert Hand.load(folder / "hand.urdf", folder / "sensors.json").sensors.keys() == hand.sensors.keys()


def test_meshes_are_closed_small_and_outwards(hand):
    vertices, faces, link = hand.mesh({})
    assert link.shape == (len(faces),)
    for i in range(len(hand.link_names)):
        piece = trimesh.Trimesh(vertices, faces[link == i])
        assert piece.is_watertight
        assert piece.volume > 0
        assert len(piece.faces) <= 260


def test_size_is_human(hand):
    tips = {name: pose[:3, 3] for name, pose in hand.hand_from_sensor({}).items()}
    assert 0.17 < tips["middle_tip"][0] + hand.sensors["middle_tip"].radius < 0.21
    assert all(abs(tips[f"{f}_tip"][2]) < 1e-9 for f in FINGERS)
    assert tips["thumb_tip"][1] < -0.09
    forearm = hand.mesh({})[0]
    assert forearm[:, 0].min() < -0.25


def test_fingers_bend_towards_the_palm_normal_and_the_thumb_opposes(hand):
    bent = hand.hand_from_sensor({f"{f}_{j}": 0.9 for f in FINGERS for j in ("mcp", "pip")})
    for f in FINGERS:
        assert bent[f"{f}_tip"][2, 3] > PALM_HALF_THICKNESS + 0.02
    lifted = hand.hand_from_sensor({"thumb_opposition": np.pi / 2})["thumb_tip"][:3, 3]
    flexed = hand.hand_from_sensor({"thumb_opposition": np.pi / 2, "thumb_mcp": 0.8, "thumb_ip": 0.8})["thumb_tip"][
        :3, 3
    ]
    assert lifted[2] > 0.06
    assert flexed[0] > lifted[0] + 0.02


def test_samples_cover_every_link(hand):
    _, normals, link = hand.surface_samples(0.004)
    assert set(link) == set(range(len(hand.link_names)))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-9)
    vertices, faces, face_link = hand.mesh({})
    world = hand.points_on_surface({})
    index = hand.link_names.index("index_distal")
    piece = trimesh.Trimesh(vertices, faces[face_link == index])
    dense, _ = trimesh.sample.sample_surface(piece, 500, seed=0)
    gap = np.linalg.norm(dense[:, None] - world[link == index][None], axis=2).min(axis=1)
    assert gap.max() < 0.004
    assert np.abs(trimesh.proximity.signed_distance(piece, world[link == index])).max() < 1e-9
    with pytest.raises(InputError, match="above 0"):
        hand.surface_samples(0.0)


def test_samples_in_a_ball_and_few_of_them(hand, rng):
    joints = dict.fromkeys(hand.joint_names[:5], 0.2)
    every = hand.points_on_surface(joints)
    target = poses.make_pose(poses.exp_rotation(rng.normal(size=3)), rng.normal(size=3))
    placed = poses.apply(target, every)
    near = np.linalg.norm(placed - placed[40], axis=1) < 0.03
    assert 0 < near.sum() < len(near)
    np.testing.assert_allclose(hand.points_in_ball(joints, target, placed[40], 0.03), placed[near], atol=1e-12)
    np.testing.assert_allclose(hand.points_in_ball(joints, target, np.zeros(3), np.inf), placed, atol=1e-12)
    assert np.array_equal(hand.points_on_surface(joints, most=100), every[:: len(every) // 100])
    # what was asked last is not what is asked now
    assert not np.allclose(hand.points_on_surface({}), every)


def test_joints_for_another_hand(hand):
    with pytest.raises(InputError, match=r"hand 'five_finger_hand'.*'FFJ3'.*another hand"):
        hand.forward_kinematics({"FFJ3": 0.1})
    with pytest.raises(InputError, match=r"finite.*index_mcp.*nan"):
        hand.mesh({"index_mcp": float("nan")})


def test_beyond_the_limits_is_used_but_told(hand):
    upper = hand.limits[hand.joint_names.index("index_mcp"), 1]
    assert hand.limit_excess({"index_mcp": upper + np.deg2rad(3)}) == {}
    excess = hand.limit_excess({"index_mcp": upper + np.deg2rad(8), "thumb_ip": 0.0})
    assert excess == {"index_mcp": pytest.approx(np.deg2rad(8))}
    assert np.isfinite(hand.mesh({"index_mcp": upper + 1.0})[0]).all()


def test_a_sensor_needs_its_link():
    robot = Robot("box", "base", {"base": (make_shape("box", (0.1, 0.1, 0.1)),)}, ())
    with pytest.raises(InputError, match="expected a link of hand 'box', got 'nail'"):
        Hand(robot, {"a": Sensor("a", "nail", "point", np.eye(4))})


def test_prismatic_joints_and_chains_of_mimics(tmp_path):
    ball = make_shape("sphere", (0.01,))
    turn = np.eye(4)
    turn[:3, 3] = (0.0, 0.0, 0.1)
    y = np.array([0.0, 1.0, 0.0])
    joints = (
        Joint("slide", "prismatic", "a", "b", turn, y, 0.0, 0.05),
        Joint("turn", "continuous", "b", "c", turn, y, -np.inf, np.inf),
        Joint("double", "revolute", "c", "d", turn, y, -3.0, 3.0, Mimic("turn", 2.0, 0.1)),
        Joint("again", "revolute", "d", "e", turn, y, -3.0, 3.0, Mimic("double", -1.0, 0.2)),
    )
    hand = Hand(Robot("arm", "a", dict.fromkeys("abcde", (ball,)), joints))
    assert hand.joint_names == ["slide", "turn"]
    np.testing.assert_allclose(hand.joint_values({"slide": 0.02, "turn": 0.3}), [0.02, 0.3, 0.7, -0.5])
    again = Hand.load(hand.save(tmp_path))
    manager = UrdfTransformManager()
    manager.load_urdf((tmp_path / "hand.urdf").read_text())
    for name, value in {"slide": 0.02, "turn": 0.3, "double": 0.7, "again": -0.5}.items():
        manager.set_joint(name, value)
    np.testing.assert_allclose(
        again.forward_kinematics({"slide": 0.02, "turn": 0.3})["e"], manager.get_transform("e", "a"), atol=1e-12
    )


def _two_of_every_joint() -> Hand:
    """A tree with two joints of each kind, one of each kind by mimic, each turned against its parent."""
    ball, rng, names = make_shape("sphere", (0.01,)), np.random.default_rng(3), "abcdefghijk"
    joints = []
    kinds = ["prismatic", "revolute", "fixed", "continuous", "prismatic", "revolute", "continuous", "fixed"]
    for i, kind in enumerate(kinds):
        parent = names[i if i % 3 else max(0, i - 2)]  # branches, so that one depth holds several joints
        ends = (-np.inf, np.inf) if kind == "continuous" else (-0.4, 0.7)
        axis = poses.random_unit_vectors(1, rng)[0]
        joints.append(Joint(f"j{i}", kind, parent, names[i + 1], poses.exp(rng.normal(size=6)), axis, *ends))
    for parent, child, kind, master, factor in (("i", "j", "prismatic", "j1", -0.5), ("i", "k", "revolute", "j0", 2.0)):
        axis, follow = poses.random_unit_vectors(1, rng)[0], Mimic(master, factor, 0.05)
        joints.append(Joint(f"m{child}", kind, parent, child, poses.exp(rng.normal(size=6)), axis, -9.0, 9.0, follow))
    depth = {"a": 0}
    for joint in joints:
        depth[joint.child] = depth[joint.parent] + 1
    joints.sort(key=lambda joint: depth[joint.child])
    return Hand(Robot("tree", "a", dict.fromkeys(("a", *(j.child for j in joints)), (ball,)), tuple(joints)))


@pytest.mark.parametrize("batch", [(), (1,), (2,), (3,), (6,), (2, 3), (0,)])
def test_every_kind_of_joint_moves_alike_in_a_batch_and_alone(batch, tmp_path):
    hand = _two_of_every_joint()
    moving = np.random.default_rng(1).uniform(-0.4, 0.7, (*batch, len(hand.joint_names)))
    together = hand.link_poses(moving)
    assert together.shape == (*batch, len(hand.link_names), 4, 4)
    hand.save(tmp_path)
    manager = UrdfTransformManager()
    manager.load_urdf((tmp_path / "hand.urdf").read_text())
    for place in np.ndindex(*batch):
        joints = dict(zip(hand.joint_names, moving[place]))
        alone = hand.forward_kinematics(joints)
        np.testing.assert_array_equal(together[place], np.array(list(alone.values())))
        for name, value in joints.items():
            manager.set_joint(name, value)
        manager.set_joint("mj", 0.05 - 0.5 * joints["j1"])
        manager.set_joint("mk", 0.05 + 2.0 * joints["j0"])
        for link, pose in alone.items():
            np.testing.assert_allclose(pose, manager.get_transform(link, "a"), atol=1e-12)


BASE = '<robot name="r"><link name="a"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>{}</robot>'
LINK = '<link name="b"/>'
JOINT = '<joint name="j" type="{}"><parent link="{}"/><child link="{}"/>{}</joint>'
LIMIT = '<limit lower="0" upper="1"/>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot><link", "malformed"),
        ("<sdf/>", "<robot>"),
        ("<robot/>", "at least one link"),
        ('<robot><link name="a"/></robot>', "without any"),
        ('<robot><link/></robot>', "attribute 'name'"),
        (BASE.format('<link name="a"/>'), "'a'.*two"),
        (BASE.format(LINK), "one root link, got 2: a, b"),
        (BASE.format(LINK + JOINT.format("floating", "a", "b", "")), "'j'.*'floating'"),
        (BASE.format(LINK + JOINT.format("fixed", "a", "c", "")), "'c'"),
        (BASE.format(LINK + JOINT.format("revolute", "a", "b", "")), "<limit>"),
        (BASE.format(LINK + JOINT.format("revolute", "a", "b", '<limit lower="1" upper="0"/>')), "below upper"),
        (BASE.format(LINK + JOINT.format("revolute", "a", "b", LIMIT + '<axis xyz="0 0 0"/>')), "direction"),
        (BASE.format(LINK + JOINT.format("revolute", "a", "b", LIMIT + '<axis xyz="0 0"/>')), "3 numbers, got '0 0'"),
        (BASE.format(LINK + JOINT.format("fixed", "a", "b", '<origin rpy="1e200 0 0"/>')), "expected radians, got 1e"),
        (BASE.format(LINK + JOINT.format("fixed", "a", "b", '<origin xyz="0 55 0"/>')), "metres, got 55: mm read"),
        (BASE.format("").replace("0.01", "12"), "'a': expected a shape of 5 m at most, got 12 m: mm read as m"),
        (BASE.format(LINK + JOINT.format("revolute", "a", "b", LIMIT + '<mimic joint="x"/>')), "got 'x'"),
        (BASE.format(LINK + JOINT.format("revolute", "a", "b", LIMIT + '<mimic joint="j"/>')), "circle"),
        (BASE.format(LINK + JOINT.format("fixed", "a", "b", "") + JOINT.format("fixed", "b", "a", "")), "two"),
        (BASE.format(LINK + JOINT.format("fixed", "b", "a", "") + JOINT.format("fixed", "a", "b", "")).replace(
            'name="j" type="fixed"><parent link="a"', 'name="k" type="fixed"><parent link="a"'), "cycle"),
        (BASE.format(
            '<link name="b"><visual><geometry><mesh filename="package://p/m.stl"/></geometry></visual></link>'
            + JOINT.format("fixed", "a", "b", "")), r"package://p/m\.stl"),
        (BASE.format('<link name="b"><visual><geometry><cone/></geometry></visual></link>'), "'cone'"),
        (BASE.format('<link name="b"><visual><geometry><box size="1 0 1"/></geometry></visual></link>'), "above 0"),
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro/></robot>', "xacro"),
    ],
)  # fmt: skip
def test_urdf_refusals(tmp_path, text, message):
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        Hand.load(path)
    assert "bad.urdf" in str(error.value)
    assert "\n" not in str(error.value)


def test_mesh_files(tmp_path):
    with pytest.raises(InputError, match="found none"):
        Hand.load(tmp_path / "none.urdf")
    text = BASE.format("").replace('<sphere radius="0.01"/>', '<mesh filename="package://p/m.stl" scale="{}"/>')
    (tmp_path / "h.urdf").write_text(text.format("0.001 0.001 0.001"))
    (tmp_path / "m.stl").write_bytes(b"not a mesh")
    with pytest.raises(InputError, match=r"m\.stl"):
        Hand.load(tmp_path / "h.urdf")
    trimesh.creation.box(extents=(20, 30, 40)).export(tmp_path / "m.stl")
    vertices, faces, _ = Hand.load(tmp_path / "h.urdf").mesh({})
    np.testing.assert_allclose(np.ptp(vertices, axis=0), (0.02, 0.03, 0.04), atol=1e-9)
    assert len(vertices) == 8
    for scale, message in (("1 1 1", "got 40 m: mm read as m"), ("0 0.001 0.001", "other than 0, got '0 0.001")):
        (tmp_path / "h.urdf").write_text(text.format(scale))
        with pytest.raises(InputError, match=message):
            Hand.load(tmp_path / "h.urdf")
    (tmp_path / "h.urdf").write_text(text.format("-0.001 0.001 0.001"))
    vertices, faces, _ = Hand.load(tmp_path / "h.urdf").mesh({})
    assert trimesh.Trimesh(vertices, faces, process=False).volume > 0


GOOD = {"link": "a", "kind": "point", "link_from_sensor": np.eye(4).ravel().tolist()}


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ([], "object of sensors"),
        ({"s": 3}, "sensor 's'"),
        ({"s": GOOD | {"link": 3}}, "name of its link"),
        ({"s": GOOD | {"kind": "ultrasound"}}, "'ultrasound'"),
        ({"s": GOOD | {"link_from_sensor": [1, 2]}}, "16 numbers"),
        ({"s": GOOD | {"link_from_sensor": ["x"] * 16}}, "expected numbers"),
        ({"s": GOOD | {"link_from_sensor": (2 * np.eye(4)).ravel().tolist()}}, "last row"),
        ({"s": GOOD | {"kind": "array"}}, "taxels"),
        ({"s": GOOD | {"taxels": [[1, 2, 3]]}}, "x, y, z, nx"),
        ({"s": GOOD | {"surface": {"torus": {}}}}, "torus"),
        ({"s": GOOD | {"surface": {"sphere": {}}}}, "'radius'"),
        ({"s": GOOD | {"surface": {"sphere": {"radius": -1}}}}, "above 0"),
        ({"s": GOOD | {"surface": {"ellipsoid": {"radii": [1, 2]}}}}, "above 0"),
        ({"s": GOOD | {"surface": {"mesh": {"file": 3}}}}, "file name"),
        ({"s": GOOD | {"soft_layer": 3}}, "soft_layer"),
    ],
)
def test_sensor_refusals(tmp_path, entry, message):
    path = tmp_path / "sensors.json"
    path.write_text(json.dumps(entry))
    with pytest.raises(InputError, match=message) as error:
        read_sensors(path)
    assert "\n" not in str(error.value)


def test_sensor_of_a_link_that_is_not_there(tmp_path):
    (tmp_path / "h.urdf").write_text(BASE.format(""))
    (tmp_path / "sensors.json").write_text(json.dumps({"s": GOOD | {"link": "z"}}))
    with pytest.raises(InputError, match=r"sensors\.json: sensor 's'.*'z'"):
        Hand.load(tmp_path / "h.urdf")
    assert read_urdf(tmp_path / "h.urdf").root == "a"
