"""Frames made by hand: what is meant is taken, the rest is refused in one line that says what was expected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_frames import CAMERA, VIEW, plain_view, some_frame

from fusion import estimate
from scenes import Frame
from scenes.errors import CaptureError, InputError, PalpateError
from scenes.geometry import poses
from scenes.recordings.frames import Contacts, EmptyRegions, Wrench
from scenes.robot.hands import Hand
from scenes.robot.urdf import Robot, mesh_shape
from scenes.synthesis.library import make

DEPTH = np.full((48, 64), 0.5, np.float32)


def test_numbers_of_a_message_are_numbers():
    """A message counts in uint32, in which a difference of two frames overflows."""
    assert type(Frame(np.uint32(7)).index) is int


def test_nothing_is_unknown_of_a_hand_without_joints(drill):
    """A tool in one piece, say: it had been left out where nobody wrote that it has no joints."""
    tool = Hand(Robot("tool", "rod", {"rod": (mesh_shape(drill.vertices, drill.faces),)}, ()), {})
    assert Frame(0, hand=tool, world_from_hand=np.eye(4)).joints == {}
    assert not Frame(0, hand=tool, world_from_hand=np.eye(4)).hand_lacks
    assert Frame(0, hand=tool).hand_lacks == "pose"


def test_what_is_meant_is_taken():
    frame = Frame(
        3,
        camera=CAMERA,
        depth=DEPTH.astype(np.float64),
        mask=np.where(np.arange(64) < 9, 255, 0).astype(np.uint8) * np.ones((48, 1), np.uint8),
        contacts=[[0.0, 0.0, 0.5], [0.01, 0.0, 0.5]],
        cloud=[(0, 0, 1), (0, 1, 1)],
        prior=np.eye(4, dtype=np.float32).tolist(),
        tactile={"tip": [1, 2, 3]},
        wrenches=[Wrench("tip", np.zeros(3), np.zeros(3))],
        joints={"a": np.float32(0.5)},
    )
    assert frame.depth.dtype == np.float32
    assert frame.mask.dtype == bool
    assert frame.mask.sum() == 9 * 48
    assert isinstance(frame.contacts, Contacts)
    np.testing.assert_array_equal(frame.contacts.points, [[0.0, 0.0, 0.5], [0.01, 0.0, 0.5]])
    assert frame.cloud.shape == (2, 3)
    assert frame.prior.dtype == frame.cloud.dtype == frame.tactile["tip"].dtype == np.float64
    assert isinstance(frame.wrenches, tuple)
    assert frame.joints == {"a": 0.5}
    for value, count in ((np.zeros((48, 64)), 0), (np.ones((48, 64), int), 48 * 64)):
        assert Frame(0, camera=CAMERA, mask=value).mask.sum() == count
    assert len(Frame(0, contacts=None).contacts) == 0
    assert len(Frame(0, contacts=np.zeros((0, 3))).contacts) == 0


def test_what_is_right_keeps_its_bits():
    first = some_frame(0)
    again = replace(first, index=1)
    for name in ("camera_from_world", "depth", "rgb", "mask", "cloud", "prior", "camera_from_object_truth"):
        assert getattr(again, name) is getattr(first, name), name


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"depth": (500 * DEPTH).astype(np.uint16)}, "got uint16 up to 250: looks like millimetres: divide by 1000"),
        ({"depth": DEPTH.astype(int)}, "expected metres, got int64 up to 0: expected floating point"),
        ({"depth": DEPTH[:24]}, "depth: expected 64x48 pixels like the camera, got 64x24"),
        ({"depth": DEPTH[..., None]}, r"shape \(h, w\), got shape \(48, 64, 1\)"),
        ({"depth": "depth.png"}, "depth: expected an image of metres, shape .*, got str"),
        ({"depth": DEPTH, "rgb": np.zeros((96, 128, 3), np.uint8)}, "rgb: .* like the camera, got 128x96"),
        ({"depth": DEPTH, "camera": None}, r"camera: expected Camera \(Camera.from_matrix.*got NoneType"),
        ({"camera": CAMERA.matrix}, r"expected Camera .*got an array of float64, shape \(3, 3\)"),
        ({"rgb": np.zeros((48, 64), np.uint8)}, "rgb: expected uint8 of shape"),
        ({"rgb": np.zeros((48, 64, 3))}, "rgb: expected uint8 .*got float64"),
        ({"mask": np.arange(48 * 64).reshape(48, 64) % 3}, "0 and one other value, got 0, 1, 2: mask == number"),
        ({"mask": np.full((48, 64), np.nan)}, "mask: expected bool, or 0 and one other value"),
        ({"mask": np.ones((48, 63), bool)}, "mask: expected 64x48 pixels like the camera, got 63x48"),
        ({"contacts": np.zeros((4, 6))}, r"contacts: expected points of shape \(n, 3\).*Contacts\(points, normals\)"),
        ({"contacts": [[0.0, np.nan, 0.0]]}, "contacts: expected finite points, got row 0"),
        ({"contacts": "contacts.csv"}, "contacts: expected points as real numbers"),
        ({"cloud": np.zeros((48, 64, 3))}, r"cloud: expected points of shape \(n, 3\).*reshape\(-1, 3\)"),
        ({"cloud": np.zeros((4, 3)), "cloud_colours": np.zeros((3, 3), np.uint8)}, "like the cloud"),
        ({"prior": np.eye(3)}, r"prior: expected a 4x4 transform, got shape \(3, 3\)"),
        ({"prior": poses.make_pose(None, [1.0, 2.0, 3.0]).T}, "prior: expected the last row .*is it transposed?"),
        ({"world_from_hand": np.diag([1e3, 1e3, 1e3, 1])}, "world_from_hand: expected a rotation"),
        ({"world_from_hand": np.diag([1.0, 1, -1, 1])}, "mirrored"),
        ({"camera_from_world": np.full((4, 4), np.nan)}, "camera_from_world: expected finite numbers"),
        ({"joints": [0.1, 0.2]}, r"joints: expected positions by joint name, got list: dict\(zip"),
        ({"joints": {"a": [0.1]}}, "one number for each joint name"),
        ({"hand": "hand.urdf"}, r"hand: expected Hand \(Hand.load\(urdf\)\), got str"),
        ({"tactile": {"tip": np.zeros((4, 4))}}, "tactile 'tip': expected one pressure a taxel"),
        ({"tactile": [1.0]}, "tactile: expected pressures by sensor name"),
        ({"gels": [np.zeros((4, 4), np.uint16)]}, "gels: expected images by sensor name"),
        ({"gels": {"pad": np.zeros((4, 4))}}, "gels 'pad': expected uint16 micrometres"),
        ({"no_contact": np.zeros((3, 3))}, "no_contact: expected EmptyRegions"),
        ({"wrenches": {"tip": 3}}, "wrenches: expected list"),
        ({"wrenches": [np.zeros(6)]}, "wrenches: expected Wrench"),
    ],
)
def test_the_rest_is_refused_in_one_line(parts, message):
    with pytest.raises(InputError, match=message) as error:
        Frame(7, **({"camera": CAMERA} | parts))
    assert str(error.value).startswith("frame 7: ")
    assert "\n" not in str(error.value)


def test_units_are_suspected_at_the_door():
    frame, model = replace(plain_view(), camera_from_object_truth=None), make("box")
    with pytest.raises(CaptureError, match="looks like millimetres: divide by 1000"):
        estimate(replace(frame, depth=1e3 * frame.depth, prior=None, contacts=None), model)
    with pytest.raises(CaptureError, match=r"contacts spread over .*mm read as m\?"):
        estimate(replace(frame, contacts=1e3 * frame.contacts.points, prior=None), model)
    with pytest.raises(PalpateError, match="prior"):
        estimate(frame, model, prior=np.eye(3))


def test_a_frame_of_plain_arrays_is_estimated_like_a_recorded_one():
    frame, model = plain_view(), make("box")
    plain = Frame(
        0,
        camera=VIEW,
        depth=frame.depth.astype(np.float64),
        mask=np.where(frame.depth > 0, 255, 0).astype(np.uint8),
        contacts=frame.contacts.points,
        prior=frame.prior,
    )
    answer = estimate(plain, model)
    assert answer.verdict == "ok"
    moved = poses.difference(answer.pose, frame.camera_from_object_truth, model.centroid)
    nearest = model.symmetries.nearest(answer.pose, frame.camera_from_object_truth)
    moved = poses.difference(nearest, frame.camera_from_object_truth, model.centroid)
    assert np.linalg.norm(moved[3:]) < 1e-3


def test_contacts_are_moved_as_if_made_anew(rng):
    normals = rng.normal(size=(4, 3))
    normals[2] = np.nan
    given = Contacts(
        rng.normal(size=(4, 3)), normals, [1e-3, 2e-3, 3e-3, 4e-3], None, list("abca"), rng.normal(size=(4, 3))
    )
    pose = poses.make_pose(poses.exp_rotation(rng.normal(size=3)), rng.normal(size=3))
    moved, turn = given.moved(pose), pose[:3, :3].T
    anew = Contacts(
        given.points @ turn + pose[:3, 3], given.normals @ turn, given.sigma_point, given.sigma_normal, given.sensors,
        given.forces @ turn, given.sigma_known,
    )  # fmt: skip
    assert vars(moved).keys() == vars(anew).keys()
    for name, value in vars(anew).items():
        np.testing.assert_array_equal(getattr(moved, name), value)
    with pytest.raises(InputError, match="contacts: moved: expected a rotation, got columns off"):
        given.moved(np.diag([1e200, 1.0, 1.0, 1.0]))
    none = Contacts.none()
    none.sensors.append("a")  # nobody else's
    assert not len(Contacts.none())
    assert not Contacts.none().sensors
    assert not Contacts.none().moved(pose).sensors
    together = Contacts.concatenate([none.take([]), Contacts.none()])
    assert not len(together)
    assert together.sigma_known


@pytest.mark.parametrize(
    ("points", "radius", "sensors", "message"),
    [
        ([[0.0, 0.0, np.nan]], [0.01], ["a"], "no_contact: expected finite points, got row 0"),
        ([[0.0, 0.0, 0.1]], [-0.01], ["a"], "no_contact: expected radii of 0 m at least, got -0.01"),
        ([[0.0, 0.0, 0.1]], [np.nan], ["a"], "no_contact: expected radii of 0 m at least"),
        ([[0.0, 0.0, 0.1]], [0.01, 0.01], ["a"], "no_contact: expected points (n, 3) and a radius (n,)"),
        ([[0.0, 0.0, 0.1]], [0.01], [], "no_contact: expected 1 sensor names, got 0"),
        ([["x", "y", "z"]], [0.01], ["a"], "no_contact: expected points as real numbers"),
    ],
)
def test_empty_regions_that_are_none_are_refused(points, radius, sensors, message):
    with pytest.raises(InputError) as error:
        EmptyRegions(points, radius, sensors)
    assert message in str(error.value)
    assert EmptyRegions([[0.0, 0.0, 0.1]], [0.01], ["a"]).points.dtype == np.float64


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (("a", np.zeros(2), np.zeros(3)), r"wrench of a: expected force of shape \(3,\), got \(2,\)"),
        (("a", None, np.zeros(3)), "wrench of a: expected force of shape"),
        (("a", np.zeros(3), [0.0, np.nan, 0.0]), "wrench of a: expected a finite torque, got"),
        ((3, np.zeros(3), np.zeros(3)), "wrench: expected words as sensor names, got 3"),
    ],
)
def test_wrenches_that_are_none_are_refused(parts, message):
    with pytest.raises(InputError, match=message):
        Wrench(*parts)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.diag([1e3, 1e3, 1e3, 1.0]), "contacts: moved: expected a rotation, got columns off"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "contacts: moved: expected a rotation, got a mirrored one"),
        (np.eye(3), r"contacts: moved: expected a 4x4 transform, got shape \(3, 3\)"),
    ],
)
def test_contacts_are_moved_by_rigid_transforms_alone(pose, message):
    contacts = Contacts(np.eye(3))
    with pytest.raises(InputError, match=message):
        contacts.moved(pose)
    np.testing.assert_array_equal(contacts.moved(np.eye(4).tolist()).points, np.eye(3))
