"""Public gel recordings, made small in their layouts: grasps of DIGITs, FeelSight logs, Object-in-Hand bags."""

from __future__ import annotations

import os
import pickle
import shutil

import cv2
import numpy as np
import pytest
from bags import HEIGHT, MS, START, WIDTH, Messages
from commands import refused, run

from scenes.errors import CaptureError
from scenes.files.formats.off import write_off
from scenes.files.formats.pickles import read_plain
from scenes.geometry import poses
from scenes.recordings.captures import read_capture
from scenes.recordings.checking.validation import validate
from scenes.robot.digit import digit_gel, model_from_sensor
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.urdf import Joint, Robot
from scenes.synthesis.library import make

# ---- grasps of DIGITs


@pytest.fixture
def grasp(tmp_path, rng):
    """One grasp of two sensors on a box."""
    folder = tmp_path / "thing" / "triplet_1"
    folder.mkdir(parents=True)
    background = rng.integers(20, 200, (64, 48, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "background.png"), background)
    turns = [np.array([0.0, 0.0, 0.4]), np.array([0.3, -0.2, 0.1])]
    lines, points = [], []
    for number, turn in enumerate(turns):
        angle = np.linalg.norm(turn)
        lines.append(" ".join(map(repr, map(float, [0.1 * number, 0.2, 0.3, *(turn / angle), angle]))))
        points.append([0.1 * number, 0.2, 0.31])
        cv2.imwrite(str(folder / f"Image_heatmap_{number}.png"), np.roll(background, 5, axis=0))
    (folder / "poses_sensors.txt").write_text("\n".join(lines) + "\n")
    write_off(folder / "sensors.off", np.array(points), np.zeros((0, 3), dtype=np.int64))
    model = make("box")
    write_off(tmp_path / "thing" / "model.off", model.vertices, model.faces)
    return folder, turns, points


def test_grasps_of_digits_convert(grasp, tmp_path):
    folder, turns, points = grasp
    assert run("convert", folder, tmp_path / "c") == 0
    frame = read_capture(tmp_path / "c")[0]
    assert list(frame.gels) == ["digit0", "digit1"]
    np.testing.assert_allclose(frame.contacts.points, points)
    for number, turn in enumerate(turns):
        expected = poses.make_pose(poses.exp_rotation(turn), (0.1 * number, 0.2, 0.3)) @ model_from_sensor()
        found = frame.hand.hand_from_sensor({})[f"digit{number}"]
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert validate(tmp_path / "c") == []
    shutil.copytree(folder, folder.parent / "triplet_2")
    assert run("convert", tmp_path, tmp_path / "all", "--from", "digit") == 0
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == ["thing_triplet_1", "thing_triplet_2"]


def test_damaged_grasps_are_one_line(grasp, tmp_path, capsys):
    folder, _, _ = grasp

    def said(name, text):
        path = folder / name
        old = path.read_bytes()
        path.write_bytes(text)
        line = refused(capsys, "convert", folder, tmp_path / "c")
        path.write_bytes(old)
        return line

    assert "expected a PNG image" in said("Image_heatmap_1.png", b"x")
    assert "line 1: expected" in said("poses_sensors.txt", b"1 2 3\n")
    assert "expected an axis of length 1, got 2" in said("poses_sensors.txt", b"0 0 0 2 0 0 1\n")
    assert "expected 2 points, got 1" in said("sensors.off", b"OFF\n1 0 0\n0 0 0\n")
    assert "expected an image for each of 3 poses" in said("poses_sensors.txt", b"0 0 0 1 0 0 1\n" * 3)
    cv2.imwrite(str(folder / "Image_heatmap_1.png"), np.zeros((8, 8, 3), np.uint8))
    assert "expected an image of 48x64 pixels" in refused(capsys, "convert", folder, tmp_path / "c")
    (tmp_path / "background.png").unlink()
    assert "expected the untouched skin's image" in refused(capsys, "convert", folder, tmp_path / "c")


# ---- FeelSight


def fingered_hand() -> Hand:
    """16 joints, a DIGIT on the last link, named like the log's finger."""
    robot = make_chain()
    gel = digit_gel((48, 64))
    return Hand(robot, {"index": Sensor("index", "link15", "gel", np.eye(4), gel=gel)})


def make_chain(names=tuple(f"joint{i}" for i in range(16))) -> Robot:
    from scenes.synthesis.hands import five_finger_hand

    shape = five_finger_hand().robot.links["palm"]
    links = {"base": shape, **{f"link{i}": () for i in range(16)}}
    joints = tuple(
        Joint(
            *(names[i], "revolute", "base" if i == 0 else f"link{i - 1}", f"link{i}"),
            *(poses.make_pose(None, (0.01, 0.0, 0.0)), np.array([0.0, 0.0, 1.0]), -2.0, 2.0),
        )
        for i in range(16)
    )
    return Robot("chain", "base", links, joints)


def feelsight_data(turned=False):
    """What data.pkl holds, for two images and one camera or two."""
    world_from_camera = poses.make_pose(poses.exp_rotation((np.pi, 0.0, 0.0)), (0.0, 0.0, 0.6))
    if turned:
        world_from_camera = world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0])
    intrinsics = {"fx": 80.0, "fy": 80.0, "cx": 31.5, "cy": 23.5, "w": 64, "h": 48}
    return {
        "object": {"pose": [poses.make_pose(None, (0.01 * i, 0.0, 0.02)) for i in range(2)]},
        "allegro": {"base_pose": np.eye(4), "joint_state": np.full((2, 16), 0.1)},
        "realsense": {"front": {"intrinsics": intrinsics, "pose": world_from_camera}},
        "digit_info": {"intrinsics": {"fx": 50.0}, "cam_dist": -0.022, "depth_scale": 20_000.0},
    }


@pytest.fixture
def log(tmp_path, rng):
    folder = tmp_path / "077_cube" / "00"
    camera = folder / "realsense" / "front"
    for name in ("image", "seg"):
        (camera / name).mkdir(parents=True)
    finger = folder / "allegro" / "index"
    for name in ("image", "depth", "mask"):
        (finger / name).mkdir(parents=True)
    for number in range(2):
        cv2.imwrite(str(camera / "image" / f"{number}.jpg"), rng.integers(0, 256, (48, 64, 3), dtype=np.uint8))
        segments = np.zeros((48, 64), np.uint8)
        segments[8:24, 8:40] = 255
        segments[32:40, 8:40] = 127
        cv2.imwrite(str(camera / "seg" / f"{number}.jpg"), segments)
        pressed = np.zeros((64, 48), np.uint8)
        pressed[24:40, 16:32] = 20
        cv2.imwrite(str(finger / "depth" / f"{number}.jpg"), pressed)
        cv2.imwrite(str(finger / "mask" / f"{number}.jpg"), np.where(pressed > 0, 255, 0).astype(np.uint8))
        cv2.imwrite(str(finger / "image" / f"{number}.jpg"), np.full((64, 48, 3), 90, np.uint8))
    np.savez(camera / "depth.npz", depth=np.full((2, 48, 64), 580, np.uint16), depth_scale=0.001)
    (folder / "data.pkl").write_bytes(pickle.dumps(feelsight_data()))
    return folder


def test_joints_go_by_the_numbers_in_their_names(log, tmp_path, capsys):
    """A left hand's URDF lists the ring finger first; the log has the index finger first, as the numbers have."""
    order = (*range(8, 12), *range(4, 8), *range(4), *range(12, 16))
    hand = Hand(make_chain([f"joint_{k}.0" for k in order]), fingered_hand().sensors)
    data = feelsight_data()
    data["allegro"]["joint_state"] = np.tile(0.01 * np.arange(16), (2, 1))
    data["realsense"]["front"]["intrinsics"]["k1"] = 0.05
    (log / "data.pkl").write_bytes(pickle.dumps(data))
    assert run("convert", log, tmp_path / "c", "--object", "box", "--hand", hand.save(tmp_path / "hand")) == 0
    joints = read_capture(tmp_path / "c")[0].joints
    assert all(joints[f"joint_{k}.0"] == pytest.approx(0.01 * k) for k in range(16))
    assert "camera front has a distortion, which is not undone" in "".join(capsys.readouterr())


def test_a_feelsight_log_converts(log, tmp_path):
    hand = fingered_hand()
    urdf = hand.save(tmp_path / "hand")
    assert run("convert", log, tmp_path / "c", "--object", "box", "--hand", urdf) == 0
    capture = read_capture(tmp_path / "c")
    assert len(capture) == 2
    frame = capture[1]
    np.testing.assert_allclose(frame.depth, 0.58, atol=1e-4)
    assert frame.mask[10:22, 10:38].all()
    assert not frame.mask[34:38, 10:38].any()
    assert frame.camera.fx == pytest.approx(80.0)
    world = poses.inverse(frame.camera_from_world) @ frame.camera_from_object_truth
    np.testing.assert_allclose(world[:3, 3], (0.01, 0.0, 0.02), atol=1e-6)
    assert frame.joints["joint3"] == pytest.approx(0.1)
    # 20 counts of 20,000 a metre in the middle, where the skin has no sag to speak of
    assert 900 < frame.gels["index"][32, 24] < 1010
    assert frame.gels["index"][2, 2] == 0
    assert validate(tmp_path / "c") == []


def test_without_a_hand_the_fingers_are_counted(log, tmp_path, capsys):
    assert run("convert", log, tmp_path / "c", "--object", "box") == 0
    assert "dropped 2 of allegro/index: no --hand with a gel of that name" in capsys.readouterr().out
    assert read_capture(tmp_path / "c")[0].gels == {}


def test_cameras_that_look_along_minus_z_are_turned(log, tmp_path, capsys):
    (log / "data.pkl").write_bytes(pickle.dumps(feelsight_data(turned=True)))
    assert run("convert", log, tmp_path / "c", "--object", "box") == 0
    assert "looks along its -z" in capsys.readouterr().out
    assert read_capture(tmp_path / "c")[0].camera_from_object_truth[2, 3] == pytest.approx(0.58)


def test_several_cameras_are_several_captures(log, tmp_path):
    shutil.copytree(log / "realsense" / "front", log / "realsense" / "side")
    data = feelsight_data()
    data["realsense"]["side"] = data["realsense"]["front"]
    (log / "data.pkl").write_bytes(pickle.dumps(data))
    assert run("convert", log, tmp_path / "c", "--object", "box") == 0
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == ["front", "side"]


def test_images_of_which_something_is_unknown_keep_the_rest(log, tmp_path, capsys):
    """A logger writes None or NaN where the object was not tracked, and folders of cameras that it does not know."""
    data = feelsight_data()
    data["object"]["pose"][1] = np.full((4, 4), np.nan)
    data["allegro"]["joint_state"] = [list(np.full(16, 0.1)), None]
    data["realsense"]["front"]["intrinsics"].update(w=None, h=None)
    (log / "data.pkl").write_bytes(pickle.dumps(data))
    (log / "realsense" / "back").mkdir()
    np.savez(
        log / "realsense" / "front" / "depth.npz", depth=np.full((2, 48, 64, 1), 2320, np.uint16), depth_scale=0.00025
    )
    urdf = fingered_hand().save(tmp_path / "hand")
    assert run("convert", log, tmp_path / "c", "--object", "box", "--hand", urdf) == 0
    assert "dropped 1 of realsense/back: nothing about it in data.pkl" in capsys.readouterr().out
    first, second = read_capture(tmp_path / "c")
    assert first.camera_from_object_truth is not None
    assert second.camera_from_object_truth is None
    assert [len(frame.gels) for frame in (first, second)] == [1, 0]
    np.testing.assert_allclose(first.depth, 0.58, atol=1e-4)
    assert validate(tmp_path / "c") == []


def test_a_gel_mask_of_another_size_is_one_line(log, tmp_path, capsys):
    cv2.imwrite(str(log / "allegro" / "index" / "mask" / "1.jpg"), np.zeros((32, 24), np.uint8))
    urdf = fingered_hand().save(tmp_path / "hand")
    line = refused(capsys, "convert", log, tmp_path / "c", "--object", "box", "--hand", urdf)
    assert "mask/1.jpg: expected an image of 48x64 pixels" in line


def test_a_pickle_that_names_one_list_a_billion_times_is_refused_at_once(tmp_path):
    nested = [1, 2]
    for _ in range(5):
        nested = [nested] * 10
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps({"a": nested}))
    content = read_plain(path)["a"]
    assert content[0] is content[9]
    for _ in range(30):
        nested = [nested] * 10
    path.write_bytes(pickle.dumps({"a": nested}))
    with pytest.raises(CaptureError, match="it names more than 20 million values"):
        read_plain(path)


class Hostile:
    def __reduce__(self):
        return os.system, ("touch /tmp/palpate-was-here",)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (pickle.dumps({"object": Hostile()}), "it asks for posix.system"),
        (pickle.dumps(np.array([Hostile], dtype=object)), "containers only"),
        (pickle.dumps(feelsight_data())[:100], "expected a"),
        (b"", "expected a whole pickle"),
        (b"\x80\x05cnumpy\nndarray\n(I1000000000\ntR.", "expected a"),
        (b"cnumpy\ndtype\n(S'O8'\ntR.", "expected a type of numbers"),
        (pickle.dumps([1]), "expected a dict, got list"),
        (pickle.dumps({**feelsight_data(), "object": {"pose": [np.zeros((4, 4))]}}), "object.pose"),
        (pickle.dumps({**feelsight_data(), "allegro": {"joint_state": np.zeros((2, 5))}}), "expected (n, 16) joints"),
        (pickle.dumps({**feelsight_data(), "realsense": {}}), "expected fx, fy, cx, cy"),
        (pickle.dumps({**feelsight_data(), "digit_info": {"depth_scale": 0}}), "expected a number above 0"),
        (pickle.dumps({**feelsight_data(), "object": {"pose": [None, None]}}), "object.pose: expected finite numbers"),
    ],
)
def test_hostile_and_damaged_logs_are_one_line(log, tmp_path, capsys, content, message):
    (log / "data.pkl").write_bytes(content)
    line = refused(capsys, "convert", log, tmp_path / "c", "--object", "box")
    assert message in line
    assert not os.path.exists("/tmp/palpate-was-here")
    assert not (tmp_path / "c").exists()


def test_damaged_depth_is_one_line(log, tmp_path, capsys):
    path = log / "realsense" / "front" / "depth.npz"
    np.savez(path, depth=np.full((2, 48, 64), 9.0, dtype=np.float32), depth_scale=1e9)
    assert "expected depths of 0.05 to 5.0 m" in refused(capsys, "convert", log, tmp_path / "c", "--object", "box")
    np.savez(path, depth=np.array([None]), depth_scale=1.0)
    assert "expected arrays depth and depth_scale" in refused(capsys, "convert", log, tmp_path / "c", "--object", "box")
    path.write_bytes(b"PK")
    assert "expected arrays depth" in refused(capsys, "convert", log, tmp_path / "c", "--object", "box")


@pytest.mark.parametrize("protocol", range(6))
def test_plain_pickles_are_read(tmp_path, protocol):
    path = tmp_path / "x.pkl"
    content = {"a": np.asfortranarray(np.arange(6.0).reshape(2, 3)), "b": [np.float32(2.5), (1, "x", None, {3})]}
    path.write_bytes(pickle.dumps(content, protocol))
    read = read_plain(path)
    np.testing.assert_array_equal(read["a"], content["a"])
    assert read["b"] == content["b"]
    path.write_bytes(pickle.dumps({"a": tmp_path}, protocol))
    with pytest.raises(CaptureError, match="it asks for"):
        read_plain(path)


# ---- Object-in-Hand


CONTACT_TYPES = {
    "tams_biotac/msg/Contact": ("std_msgs/Header header\ngeometry_msgs/Point position\ngeometry_msgs/Wrench wrench\n"),
    "tams_biotac/msg/ContactArray": "std_msgs/Header header\ntams_biotac/Contact[] contacts\n",
}


def pose_yaml(pose) -> str:
    w, x, y, z = (float(v) for v in poses.to_quaternion(pose[:3, :3]))
    a, b, c = (float(v) for v in pose[:3, 3])
    place = f"pose:\n  position:\n    x: {a}\n    y: {b}\n    z: {c}\n"
    return place + f"  orientation:\n    x: {x}\n    y: {y}\n    z: {z}\n    w: {w}\n"


@pytest.fixture(params=["with a header", "without"])
def bag(tmp_path, rng, request):
    """Two images of an object with a marker, and two contacts in two fingertips' frames, beside one without a place and
    an arm's joints; the array's own header is empty, or there is none.
    """
    from rosbags.typesys import get_types_from_msg

    out = Messages("ros1")
    found = {}
    bare = request.param == "without"
    for name, text in CONTACT_TYPES.items():
        text = text.removeprefix("std_msgs/Header header\n") if bare and name.endswith("Array") else text
        found.update(get_types_from_msg(text, name))
    out.store.register(found)
    truth = {
        name: poses.exp(0.3 * rng.normal(size=6)) for name in ("tracker", "marker", "object", "camera", "th", "ff")
    }
    for i in range(2):
        stamp = START + 100 * MS * i
        frame = "camera_color_optical_frame"
        counts = np.full((HEIGHT, WIDTH), 600, dtype=np.uint16)
        out.image("/camera/aligned_depth_to_color/image_raw", stamp, counts, "16UC1", frame=frame)
        colours = np.full((HEIGHT, WIDTH, 3), 80, np.uint8)
        out.image("/camera/color/image_raw", stamp, colours, "bgr8", frame=frame)
        out.joints("/joint_states", stamp, {"rh_FFJ1": 0.1})
        out.joints("/joint_states", stamp + MS, {"r_elbow_flex_joint": -1.0})
        w, x, y, z = (float(v) for v in poses.to_quaternion(truth["marker"][:3, :3]))
        marker = out.make(
            "geometry_msgs/msg/Pose",
            position=out.vector(truth["marker"][:3, 3], "Point"),
            orientation=out.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )
        name = "geometry_msgs/msg/PoseArray"
        out.add("/pose_array", name, stamp, out.make(name, header=out.header(stamp), poses=[marker]))
        nothing = out.make("geometry_msgs/msg/Wrench", force=out.vector(np.zeros(3)), torque=out.vector(np.zeros(3)))
        touched = [
            out.make(
                "tams_biotac/msg/Contact",
                header=out.header(stamp, f"rh_{finger}_biotac_link"),
                position=out.vector(np.zeros(3) if finger == "rf" else [0.001, 0.002, 0.003], "Point"),
                wrench=nothing,
            )
            for finger in ("th", "rf", "ff")
        ]
        name = "tams_biotac/msg/ContactArray"
        own = {} if bare else {"header": out.header(0)}
        out.add("/hand/rh/contacts", name, stamp, out.make(name, **own, contacts=touched))
        for finger in ("th", "ff"):
            out.transform("/tf", stamp, "base_footprint", f"rh_{finger}_biotac_link", truth[finger])
    (tmp_path / "cup").mkdir()
    config = tmp_path / "cup" / "config"
    config.mkdir()
    (config / "camera_transmitter.yaml").write_text(pose_yaml(truth["tracker"]))
    (config / "sensor1_object_cup.yaml").write_text(pose_yaml(truth["object"]))
    w, x, y, z = (float(v) for v in poses.to_quaternion(truth["camera"][:3, :3]))
    a, b, c = (float(v) for v in truth["camera"][:3, 3])
    text = f"transformation:\n  x: {a}\n  y: {b}\n  z: {c}\n  qx: {x}\n  qy: {y}\n  qz: {z}\n  qw: {w}\n"
    (config / "basefootprint_camera.yaml").write_text(text)
    return out.write(tmp_path / "cup" / "bag"), truth, config


ARGUMENTS = ("--topics", "object-in-hand", "--object", "box", "--intrinsics", "80,80,32,24")


def test_object_in_hand_converts_by_its_ready_map(bag, tmp_path, capsys):
    path, truth, _ = bag
    assert run("convert", path, tmp_path / "c", *ARGUMENTS) == 0
    said = capsys.readouterr().out
    assert "dropped 2 of /hand/rh/contacts: contacts at 0 0 0, which stands for no known place" in said
    frame = read_capture(tmp_path / "c")[0]
    assert frame.camera.fx == 80.0
    np.testing.assert_allclose(frame.depth, 0.6, atol=1e-4)
    expected = truth["tracker"] @ truth["marker"] @ truth["object"]
    np.testing.assert_allclose(frame.camera_from_object_truth, expected, atol=1e-6)
    assert frame.contacts.sensors == ["rh_th_biotac_link", "rh_ff_biotac_link"]
    for point, finger in zip(frame.contacts.points, ("th", "ff")):
        pose = poses.inverse(truth["camera"]) @ truth[finger]
        np.testing.assert_allclose(point, poses.apply(pose, np.array([[0.001, 0.002, 0.003]]))[0], atol=1e-6)


def test_what_an_object_in_hand_bag_lacks_is_named(bag, tmp_path, capsys):
    path, _, config = bag
    line = refused(capsys, "convert", path, tmp_path / "c", *ARGUMENTS[:4])
    assert "expected --intrinsics FX,FY,CX,CY" in line
    (config / "camera_transmitter.yaml").write_text("pose: 3\n")
    assert "expected x, y, z and a quaternion" in refused(capsys, "convert", path, tmp_path / "c", *ARGUMENTS)
    (config / "camera_transmitter.yaml").unlink()
    assert run("convert", path, tmp_path / "d", *ARGUMENTS) == 0
    capsys.readouterr()
    assert read_capture(tmp_path / "d")[0].camera_from_object_truth is None
    (config / "basefootprint_camera.yaml").unlink()
    assert "TF does not know where the camera is" in refused(capsys, "convert", path, tmp_path / "e", *ARGUMENTS)
