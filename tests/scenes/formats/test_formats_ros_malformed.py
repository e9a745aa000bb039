"""Bags and topic maps that no capture is made of: each is refused with one line that says why."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from bags import HEIGHT, PLAIN, SECOND, START, WIDTH, Messages, plain, write_map
from commands import refused


@pytest.fixture
def says(tmp_path, capfd):
    """Convert the messages by a map: refused with that message, and nothing is left."""

    # capfd: complaints of libraries written in C do not pass through Python
    def check(message, out, topics=None, **rest):
        folder = tmp_path / f"case{len(list(tmp_path.iterdir()))}"
        folder.mkdir()
        bag = out.write(folder / "bag")
        made = write_map(folder / "topics.json", topics or PLAIN, **rest)
        error = refused(capfd, "convert", bag, folder / "c", "--topics", made, "--object", "box")
        assert message in error, error
        assert not (folder / "c").exists()

    return check


def test_topics_that_are_not_there_or_of_another_type(says):
    out = plain("mcap", 1)
    says(
        "expected the topic /colour of topics.json, got /depth, /depth/info", out, PLAIN | {"/colour": {"role": "rgb"}}
    )
    says(
        "expected CameraInfo for the role camera_info",
        out,
        {"/depth": {"role": "camera_info"}, "/depth/info": {"role": "depth"}},
    )


def test_images(says):
    wrong = Messages("ros1")
    wrong.camera_info("/depth/info", START)
    wrong.image("/depth", START, np.zeros((HEIGHT, WIDTH), dtype=np.uint8), "mono8")
    says("expected the encoding 16UC1, mono16, 32FC1, got 'mono8'", wrong)
    bayer = plain("mcap", 1)
    bayer.image("/color", START, np.zeros((HEIGHT, WIDTH), dtype=np.uint8), "bayer_rggb8")
    says("got 'bayer_rggb8'", bayer, PLAIN | {"/color": {"role": "rgb"}})
    png = cv2.imencode(".png", np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH))[1].tobytes()
    for data in (png[:-20], png[:80] + b"xxxx" + png[84:], b"", b"\xff\xd8\xff"):
        cut = Messages("mcap")
        cut.camera_info("/depth/info", START)
        cut.compressed("/depth", START, data, "16UC1; png compressed")
        says("expected a compressed image ('16UC1; png compressed')", cut)
    other = plain("mcap", 1)
    other.image("/color", START, np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8), "rgb8", frame="color_camera")
    says(
        "expected images of the depth image's frame 'camera', got 'color_camera'",
        other,
        PLAIN | {"/color": {"role": "rgb"}},
    )
    small = plain("mcap", 1)
    small.image("/color", START, np.zeros((8, 8, 3), dtype=np.uint8), "rgb8")
    says("expected rgb of 64x48 like the depth image, got 8x8", small, PLAIN | {"/color": {"role": "rgb"}})
    size = Messages("mcap")
    size.image("/depth", START, np.ones((HEIGHT, WIDTH), dtype=np.uint16), "16UC1")
    size.camera_info("/depth/info", START, size=(32, 24))
    says("expected camera_info of 64x48 like the depth image, got 32x24", size)


def test_transforms(says):
    tf = PLAIN | {"/tf": {"role": "tf"}}
    base = {"world": "robot base", "frames": {"world": "base"}}
    for quaternion, message in (
        ((np.nan, 0, 0, 0), "/tf, base to camera: expected finite numbers"),
        ((0.0, 0.0, 0.0, 0.0), "expected a unit quaternion, got length 0"),
    ):
        turned = plain("ros1", 1)
        turned.transform("/tf", START, "base", "camera", np.eye(4), quaternion)
        says(message, turned, tf, **base)
    apart = plain("mcap", 1)
    apart.transform("/tf", START, "map", "camera", np.eye(4))
    says("TF: expected the frame base, got camera, map", apart, tf, **base)
    apart.transform("/tf", START, "base", "palm", np.eye(4))
    says("separate trees", apart, tf, **base)
    late = plain("mcap", 2)
    late.transform("/tf", START + SECOND, "base", "camera", np.eye(4))
    says(
        "expected at least one frame, got none: dropped 2 of /depth: no transform from base to camera", late, tf, **base
    )


def test_what_the_hand_says(says):
    joints = plain("mcap", 1)
    joints.joints("/joints", START, {"a": float("nan")})
    says("/joints: expected finite positions, got one of a", joints, PLAIN | {"/joints": {"role": "joints"}})
    touch = plain("mcap", 1)
    touch.pressures("/pad", START, [1.0])
    pad = {"role": "tactile", "sensor": "pad", "field": "taxels"}
    says("there is no 'taxels' among header, cells", touch, PLAIN | {"/pad": pad})
    felt = plain("mcap", 1)
    felt.touches("/t", START, "camera", [[np.nan, 0, 0]], [[0, 0, 1]], [[0, 0, 0]], ["x"])
    says(
        "/t: contacts: expected finite points",
        felt,
        PLAIN | {"/t": {"role": "contacts", "points": "touches[].position"}},
    )
    says("expected vectors", felt, PLAIN | {"/t": {"role": "contacts", "points": "touches[].finger"}})


def test_topic_maps(says):
    for topics, rest, message in (
        ({"/depth": {"role": "depth"}}, {}, "expected one topic with the role camera_info, got none"),
        (PLAIN | {"/d2": {"role": "depth"}}, {}, "expected one topic with the role depth, got /depth, /d2"),
        (PLAIN | {"/x": {"role": "smell"}}, {}, "/x: a role of depth, camera_info"),
        (PLAIN | {"/x": {"role": "rgb", "colour": 1}}, {}, "keys for the role rgb of registered, got colour"),
        (PLAIN | {"/x": {"role": "tactile", "sensor": "a"}}, {}, "/x: field for the role tactile"),
        (PLAIN | {"/x": {"role": "wrench", "sensor": "a"}}, {}, "a hand with sensors for /x"),
        (PLAIN, {"tolerance_s": -1}, "tolerance_s of 0 or more seconds, got -1"),
        (PLAIN, {"world": "robot base"}, "frames.world"),
        (PLAIN, {"frames": {"wrist": "w"}}, "frames with names for some of camera, world"),
        (PLAIN, {"hand": {"urdf": "no.urdf"}, "frames": {"hand": "palm"}}, "no.urdf, got none there"),
        (PLAIN, {"required": ["luck"]}, "required to list some of rgb"),
        (PLAIN, {"topic": {}}, "expected the keys format, version"),
        (PLAIN, {"definitions": {"Tactile": "x"}}, "message types like my_msgs/msg/Tactile"),
        (PLAIN, {"definitions": {"a/msg/B": "float64["}}, "expected ROS message definitions"),
    ):
        says(message, plain("mcap", 1), topics, **rest)


def test_commands(tmp_path, capfd):
    bag = plain("mcap", 1).write(tmp_path / "bag")
    assert "expected --topics FILE, a topic map" in refused(capfd, "convert", bag, tmp_path / "c", "--object", "box")
    made = write_map(tmp_path / "topics.json", PLAIN)
    assert "say --object MESH" in refused(capfd, "convert", bag, tmp_path / "c", "--topics", made)
    (tmp_path / "empty").mkdir()
    assert "found neither" in refused(capfd, "convert", tmp_path / "empty", tmp_path / "c", "--topics", made)
    argv = ("convert", tmp_path / "empty", tmp_path / "c", "--topics", made, "--from", "ros", "--object", "box")
    assert "expected a readable ROS bag" in refused(capfd, *argv)
