"""Grasps: nothing goes into anything (by an independent library), contacts lie on the surface, seeds, refusals."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from held import check_grasp

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.robot.fingers import Clearance, close, find_fingers, reach_bounds
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.grasps import has_force_closure, plan_grasp
from scenes.synthesis.grasping.placement import PlacementSettings, facing_pairs, open_hand, pinch_table
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make

DATA = Path(os.environ.get("PALPATE_DATA") or Path(__file__).resolve().parents[3].parent / "shared" / "data")


@pytest.fixture(scope="module")
def hand() -> Hand:
    return five_finger_hand()


@pytest.mark.parametrize("name", ["box", "bottle", "mug", "drill", "bust", "wine_glass", "sphere"])
def test_power_grasps(hand, name):
    model = make(name)
    grasp = plan_grasp(hand, model, seed=3)
    check_grasp(hand, model, grasp, 3)
    assert grasp.force_closure


@pytest.mark.parametrize(
    ("name", "kind"), [("pencil", "pinch"), ("pencil", "tripod"), ("mug", "tripod"), ("box", "pinch")]
)
def test_precision_grasps(hand, name, kind):
    model = make(name)
    grasp = plan_grasp(hand, model, seed=1, kind=kind)
    wanted = {"pinch": {"thumb_tip", "index_tip"}, "tripod": {"thumb_tip", "index_tip", "middle_tip"}}[kind]
    assert set(grasp.contacts.sensors) == wanted
    check_grasp(hand, model, grasp, len(wanted))


def test_same_seed_same_bits_and_other_seed_other_grasp(hand):
    model = make("cylinder")
    a, b, c = (plan_grasp(hand, model, seed=s) for s in (5, 5, 6))
    assert a.joints == b.joints
    np.testing.assert_array_equal(a.hand_from_object, b.hand_from_object)
    np.testing.assert_array_equal(a.contacts.points, b.contacts.points)
    assert not np.allclose(a.hand_from_object, c.hand_from_object)


@pytest.mark.parametrize("name", ["mustard_bottle", "power_drill", "banana"])
def test_scanned_objects(hand, name):
    path = DATA / "ycb" / f"{name}.ply"
    if not path.is_file():
        pytest.skip(f"no {path.name} in the optional data folder")
    model = ObjectModel.load(path)
    check_grasp(hand, model, plan_grasp(hand, model, seed=0), 3)


def test_a_saved_hand_grasps_too(hand, tmp_path):
    again = Hand.load(hand.save(tmp_path))
    model = make("cylinder")
    check_grasp(again, model, plan_grasp(again, model, seed=2), 3)


def test_refusals(hand):
    model = make("cylinder")
    with pytest.raises(InputError, match="power, tripod, pinch, got 'hook'"):
        plan_grasp(hand, model, kind="hook")
    crate = trimesh.creation.box(extents=(0.4, 0.45, 0.5))
    crate_model = ObjectModel.from_mesh(np.array(crate.vertices), np.array(crate.faces), name="crate")
    for kind in ("power", "pinch"):
        with pytest.raises(InputError, match=r"can hold in a .*'crate' of 4\d\d x 4\d\d x 5\d\d mm"):
            plan_grasp(hand, crate_model, kind=kind)
    with pytest.raises(InputError, match=r"two or more fingers.*got a hand without sensors"):
        plan_grasp(Hand(hand.robot), model)


def test_fingers_are_found(hand):
    fingers = {f.sensor: f for f in find_fingers(hand)}
    assert list(fingers) == ["index_tip", "middle_tip", "ring_tip", "little_tip", "thumb_tip"]
    assert [hand.joint_names[j] for j in fingers["index_tip"].closing] == ["index_mcp", "index_pip"]
    assert [hand.joint_names[j] for j in fingers["thumb_tip"].closing] == ["thumb_cmc", "thumb_mcp", "thumb_ip"]


def test_no_point_outruns_the_bound(hand):
    rng = np.random.default_rng(0)
    low, high = hand.limits.T
    bounds = reach_bounds(hand)
    points, _, link = hand.surface_samples()
    for _ in range(20):
        q = rng.uniform(low, high)
        step = 1e-6 * rng.normal(size=len(q))
        a, b = hand.link_poses(np.stack([q, q + step]))
        moved = np.einsum("nij,nj->ni", (b - a)[link][:, :3, :3], points) + (b - a)[link][:, :3, 3]
        assert (np.linalg.norm(moved, axis=1) <= (np.abs(step) @ bounds.T)[link] + 1e-12).all()


def test_closing_stops_at_the_surface_and_never_before(hand):
    ball = make("sphere")
    clearance = Clearance(hand, ball, 0.005)
    placed = poses.make_pose(None, (0.11, -0.005, 0.055) - ball.centroid)[None]
    start = open_hand(hand, 1, np.random.default_rng(0), PlacementSettings())
    speed = np.zeros_like(start)
    speed[:, [j for f in find_fingers(hand) for j in f.closing]] = 1.0
    q, links, tips = close(clearance, placed, start, speed, haste=1.0)
    assert links.min() > 0
    assert (q >= start - 1e-12).all()
    again_links, again_tips = clearance.links_and_tips(q, placed)
    np.testing.assert_allclose(again_links, links)
    np.testing.assert_allclose(again_tips, tips)
    for finger in find_fingers(hand):
        blocked = links[0, list(finger.links)].min() < 2.5e-4
        at_limit = np.allclose(q[0, list(finger.closing)], hand.limits[list(finger.closing), 1])
        assert blocked or at_limit


def test_force_closure_by_hand():
    ball = make("sphere")
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    radius = ball.radius
    assert has_force_closure(ball.centroid + radius * corners, corners, ball, 0.5)
    assert not has_force_closure(ball.centroid + radius * corners, corners, ball, 0.0)
    cap = corners * 0.2 + np.array([0, 0, 1.0])
    cap /= np.linalg.norm(cap, axis=1, keepdims=True)
    assert not has_force_closure(ball.centroid + radius * cap, cap, ball, 0.5)
    pair = np.array([[0, 0, 1.0], [0, 0, -1.0]])
    assert has_force_closure(ball.centroid + radius * pair, pair, ball, 0.5)
    assert not has_force_closure(ball.centroid + radius * pair[:1], pair[:1], ball, 0.5)


def test_facing_pairs_of_a_box():
    box = make("box")
    first, second = facing_pairs(box, np.random.default_rng(0), PlacementSettings())
    width = np.linalg.norm(second - first, axis=1)
    assert len(first) > 20
    assert width.max() < 0.075  # only the sides 55 mm apart are near enough
    assert width.min() > 0.05


def test_pinch_table_faces(hand):
    table = pinch_table(hand, ("thumb_tip", "index_tip"))
    tips = [hand.hand_from_sensor(dict(zip(hand.joint_names, q))) for q in table.q[:20]]
    for i, tip in enumerate(tips):
        np.testing.assert_allclose(tip["thumb_tip"][:3, 3], table.thumb[i], atol=1e-12)
        distance = np.linalg.norm(tip["thumb_tip"][:3, 3] - tip["index_tip"][:3, 3])
        assert np.isclose(distance - 0.016, table.gap[i])
