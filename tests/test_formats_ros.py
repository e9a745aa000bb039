"""Bags that rosbags writes, read as captures: nothing is lost, what is dropped is counted, damage is one line."""

from __future__ import annotations

import json

import bags
import cv2
import numpy as np
import pytest
from bags import HEIGHT, KINDS, MATRIX, SECOND, START, WIDTH, Messages, write_map

from fusion.cli.main import main
from scenes import poses
from scenes.captures import read_capture
from scenes.hands import Hand
from scenes.validation import validate

MS = SECOND // 1000
TOPICS = {
    "/depth": {"role": "depth"},
    "/depth/info": {"role": "camera_info"},
    "/color": {"role": "rgb"},
    "/mask": {"role": "mask"},
    "/joint_states": {"role": "joints", "names": {"alias": "FIRST"}},
    "/tip/wrench": {"role": "wrench", "sensor": "TIP"},
    "/tip/pressures": {"role": "tactile", "sensor": "PAD", "field": "cells", "scale": 1000.0},
    "/touches": {
        "role": "contacts",
        "points": "touches[].position",
        "normals": "touches[].normal",
        "forces": "touches[].force",
        "sensor_field": "touches[].finger",
        "sigma_point": 0.002,
    },
    "/tf": {"role": "tf"},
    "/tf_static": {"role": "tf_static"},
}
FRAMES = {"camera": "camera", "world": "base", "hand": "palm", "object": "thing"}


class Scene:
    """A recording of 5 depth images 100 ms apart with everything else about them, and its truth."""

    def __init__(self, kind: str, hand: Hand, depth: str = "16UC1") -> None:
        rng = np.random.default_rng(3)
        self.out = out = Messages(kind)
        self.hand = hand
        self.names = hand.joint_names[:4]
        self.wrench_sensor, self.array = sensors_of(hand)
        self.base_from_camera = poses.exp(0.3 * rng.normal(size=6))
        self.stamps = [START + 100 * MS * i + 123_456 for i in range(5)]
        self.counts, self.rgb, self.masks, self.joints, self.wrenches = [], [], [], [], []
        self.pressures, self.touches, self.hand_poses, self.things = [], [], [], []
        out.transform("/tf_static", START, "base", "camera", self.base_from_camera)
        for stamp in self.stamps:
            self.counts.append(np.where(rng.random((HEIGHT, WIDTH)) < 0.9, rng.integers(300, 900, (HEIGHT, WIDTH)), 0))
            self.rgb.append(rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8))
            self.masks.append(rng.random((HEIGHT, WIDTH)) < 0.3)
            self.joints.append({name: float(x) for name, x in zip(self.names, rng.random(4))})
            self.wrenches.append(rng.normal(size=(2, 3)))
            self.pressures.append(rng.integers(0, 50, self.array[1]) / 4.0)
            self.touches.append((0.1 * rng.normal(size=(2, 3)), poses.random_unit_vectors(2, rng), rng.random((2, 3))))
            self.hand_poses.append(poses.exp(0.5 * rng.normal(size=6)))
            self.things.append(poses.exp(0.5 * rng.normal(size=6)))
            self._depth(stamp, depth)
            out.camera_info("/depth/info", stamp)
            out.image("/color", stamp + 4 * MS, self.rgb[-1][:, :, ::-1], "bgr8", pad=5)
            out.image("/mask", stamp, np.where(self.masks[-1], 255, 0).astype(np.uint8), "mono8")
            published = {"alias" if name == self.names[0] else name: x for name, x in self.joints[-1].items()}
            out.joints("/joint_states", stamp + 2 * MS, published)
            out.joints("/joint_states", stamp + 50 * MS, dict.fromkeys(self.names, 9.0))
            out.wrench("/tip/wrench", stamp - 3 * MS, *self.wrenches[-1])
            out.pressures("/tip/pressures", stamp, self.pressures[-1])
            out.touches("/touches", stamp, "palm", *self.touches[-1], ["thumb", "index"])
            out.transform("/tf", stamp, "base", "palm", self.hand_poses[-1])
            out.transform("/tf", stamp, "base", "thing", self.things[-1])

    def _depth(self, stamp: int, kind: str) -> None:
        counts = self.counts[-1].astype(np.uint16)
        if kind == "16UC1":
            self.out.image("/depth", stamp, counts, "16UC1", pad=6)
        elif kind == "big":
            self.out.image("/depth", stamp, counts, "16UC1", big=True)
        elif kind == "32FC1":
            metres = (counts * 1e-3).astype(np.float32)
            metres[counts == 0] = np.nan
            self.out.image("/depth", stamp, metres, "32FC1")
        elif kind == "png":
            self.out.compressed("/depth", stamp, cv2.imencode(".png", counts)[1].tobytes(), "16UC1; png compressed ")
        else:
            self.out.compressed("/depth", stamp, bags.compressed_depth(counts), "16UC1; compressedDepth png")

    def map(self, folder, hand_folder, **rest):
        """The map of everything, written beside the hand's files."""
        topics = json.loads(json.dumps(TOPICS).replace("TIP", self.wrench_sensor).replace("PAD", self.array[0]))
        topics["/joint_states"]["names"]["alias"] = self.names[0]
        content = {
            "tolerance_s": 0.01,
            "object": {"model": "box.ply", "name": "box"},
            "hand": {"urdf": str(hand_folder / "hand.urdf"), "sensors": str(hand_folder / "sensors.json")},
            "world": "robot base",
            "frames": FRAMES,
            **rest,
        }
        return write_map(folder / "topics.json", content.pop("topics", topics), **content)


def sensors_of(hand: Hand) -> tuple[str, tuple[str, int]]:
    """A sensor's name, and the name and number of values of one for pressures."""
    first, second = list(hand.sensors)[:2]
    taxels = hand.sensors[second].taxels
    return first, (second, 6 if taxels is None else len(taxels))


@pytest.fixture(scope="session")
def hand_folder(tmp_path_factory, hand):
    folder = tmp_path_factory.mktemp("hand")
    hand.save(folder)
    return folder


@pytest.fixture
def box(tmp_path, hand_folder):
    """The object's mesh beside the map."""
    from scenes.formats.ply import write_ply
    from scenes.library import make

    model = make("box")
    write_ply(tmp_path / "box.ply", model.vertices, model.faces)
    return model


def refused(capsys, *argv: object) -> str:
    assert main([str(a) for a in argv]) == 2
    out, err = capsys.readouterr()
    assert err.startswith("palpate: ")
    assert err.count("\n") == 1, err
    assert out == ""
    return err


def check(scene: Scene, folder) -> None:
    """Everything that went into the bag came out, to the last bit or to 1e-12."""
    capture = read_capture(folder)
    assert capture.frame_ids == (0, 1, 2, 3, 4)
    assert capture.world == "robot base"
    assert capture.settings.notes["stamps_ns"] == {str(i): stamp for i, stamp in enumerate(scene.stamps)}
    assert [p for p in validate(folder) if "limits" not in p.message and "sizes that agree" not in p.message] == []
    for i, frame in enumerate(capture):
        assert np.array_equal(np.rint(frame.depth * 1e3).astype(int), scene.counts[i])
        np.testing.assert_array_equal(frame.camera.matrix, MATRIX)
        assert np.array_equal(frame.rgb, scene.rgb[i])
        assert np.array_equal(frame.mask, scene.masks[i])
        assert frame.joints == scene.joints[i]
        np.testing.assert_array_equal(frame.wrenches[0].force, scene.wrenches[i][0])
        np.testing.assert_array_equal(frame.wrenches[0].torque, scene.wrenches[i][1])
        np.testing.assert_array_equal(frame.tactile[scene.array[0]], 1000.0 * scene.pressures[i])
        close = {"rtol": 0, "atol": 1e-12}
        np.testing.assert_allclose(frame.camera_from_world, poses.inverse(scene.base_from_camera), **close)
        np.testing.assert_allclose(frame.world_from_hand, scene.hand_poses[i], **close)
        truth = poses.inverse(scene.base_from_camera) @ scene.things[i]
        np.testing.assert_allclose(frame.camera_from_object_truth, truth, **close)
        points, normals, forces = scene.touches[i]
        turn = scene.hand_poses[i][:3, :3]
        np.testing.assert_allclose(frame.contacts.points, poses.apply(scene.hand_poses[i], points), **close)
        np.testing.assert_allclose(frame.contacts.normals, normals @ turn.T, **close)
        np.testing.assert_allclose(frame.contacts.forces, forces @ turn.T, **close)
        assert frame.contacts.sensors == ["thumb", "index"]
        assert frame.contacts.sigma_point == pytest.approx(0.002)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_is_a_capture(tmp_path, hand, hand_folder, box, capsys, kind):
    scene = Scene(kind, hand)
    bag = scene.out.write(tmp_path / "bag")
    topics, out = scene.map(tmp_path, hand_folder), tmp_path / "c"
    assert main(["convert", str(bag), str(out), "--topics", str(topics), "--json", str(tmp_path / "j.json")]) == 0
    check(scene, out)
    raw = cv2.imread(str(out / "depth" / "000003.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(raw, scene.counts[3])
    assert read_capture(out).model.name == "box"
    # the joint messages half-way between two images, and nothing else
    said = json.loads((tmp_path / "j.json").read_text())
    assert said["dropped"] == [
        {"what": "/joint_states", "why": "nearest to no frame within 10 ms", "count": 5},
    ]
    silent = ", ".join(hand.joint_names[4:])
    assert (said["frames"], said["remarks"]) == (5, [f"joints of the hand on no topic, taken as 0: {silent}"])
    assert "dropped 5 of /joint_states" in capsys.readouterr().out


def test_a_single_mcap_file(tmp_path, hand, hand_folder, box):
    scene = Scene("mcap", hand)
    folder = scene.out.write(tmp_path / "bag")
    file = next(folder.glob("*.mcap"))
    assert main(["convert", str(file), str(tmp_path / "c"), "--topics", str(scene.map(tmp_path, hand_folder))]) == 0
    check(scene, tmp_path / "c")


@pytest.mark.parametrize("depth", ["big", "32FC1", "png", "compressedDepth"])
def test_depth_in_every_form(tmp_path, hand, hand_folder, box, depth):
    scene = Scene("mcap", hand, depth)
    bag = scene.out.write(tmp_path / "bag")
    assert main(["convert", str(bag), str(tmp_path / "c"), "--topics", str(scene.map(tmp_path, hand_folder))]) == 0
    check(scene, tmp_path / "c")


def plain(kind: str, count: int = 3) -> Messages:
    """Depth images 100 ms apart and their camera, nothing else."""
    out = Messages(kind)
    for i in range(count):
        stamp = START + 100 * MS * i
        out.image("/depth", stamp, np.full((HEIGHT, WIDTH), 500 + i, dtype=np.uint16), "16UC1")
        out.camera_info("/depth/info", stamp)
    return out


PLAIN = {"/depth": {"role": "depth"}, "/depth/info": {"role": "camera_info"}}


def converted(tmp_path, out: Messages, topics=None, **rest):
    """The capture of the messages and what --json says."""
    tmp_path.mkdir(exist_ok=True)
    bag = out.write(tmp_path / "bag")
    made = write_map(tmp_path / "topics.json", topics or PLAIN, **rest)
    argv = ["convert", bag, tmp_path / "c", "--topics", made, "--object", "box", "--json", tmp_path / "j.json"]
    assert main([str(a) for a in argv]) == 0
    return read_capture(tmp_path / "c"), json.loads((tmp_path / "j.json").read_text())


@pytest.mark.parametrize("kind", KINDS)
def test_counts_of_what_is_dropped_are_exact(tmp_path, kind, capsys):
    out = plain(kind, 6)
    out.image("/depth", START, np.full((HEIGHT, WIDTH), 7, dtype=np.uint16), "16UC1")  # a second one of that time
    rgb = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    for i, off in ((0, 15), (1, 19), (2, 21), (3, 40), (4, -20)):
        out.image("/color", START + (100 * i + off) * MS, rgb + i, "rgb8")
    for i in (0, 1, 2, 5):  # 3 and 4 have no transform near
        out.transform("/tf", START + (100 * i + 10) * MS, "base", "camera", np.eye(4))
    topics = PLAIN | {"/color": {"role": "rgb"}, "/tf": {"role": "tf"}}
    capture, said = converted(
        tmp_path, out, topics, world="robot base", frames={"world": "base"}, required=["rgb"], tolerance_s=0.02
    )
    assert said["dropped"] == [
        {"what": "/depth", "why": "a stamp that another image has", "count": 1},
        {"what": "/depth", "why": "no rgb within 20 ms", "count": 2},
        {"what": "/depth", "why": "no transform from base to camera within 20 ms", "count": 2},
        {"what": "/color", "why": "nearest to no frame within 20 ms", "count": 3},
    ]
    assert (said["frames"], len(capture)) == (2, 2)
    assert [int(frame.rgb[0, 0, 0]) for frame in capture] == [0, 1]
    assert "dropped 2 of /depth: no rgb within 20 ms" in capsys.readouterr().out


def test_what_is_not_required_is_remarked(tmp_path):
    out = plain("mcap", 3)
    out.image("/color", START, np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8), "rgb8")
    capture, said = converted(tmp_path, out, PLAIN | {"/color": {"role": "rgb"}})
    assert said["remarks"] == ["2 of 3 frames without rgb within 20 ms"]
    assert [frame.rgb is not None for frame in capture] == [True, False, False]


def test_transforms_between_samples(tmp_path):
    out = plain("mcap", 2)
    start, end = poses.exp([0.1, -0.2, 0.3, 0.1, 0.2, 0.3]), poses.exp([0.3, 0.1, -0.2, 0.2, -0.1, 0.4])
    out.transform("/tf", START + 90 * MS, "base", "camera", start)
    out.transform("/tf", START + 120 * MS, "base", "camera", end)
    topics = PLAIN | {"/tf": {"role": "tf"}}
    capture, said = converted(tmp_path, out, topics, world="robot base", frames={"world": "base"})
    assert said["dropped"][0]["count"] == 1
    middle = poses.inverse(capture[0].camera_from_world)
    np.testing.assert_allclose(middle[:3, 3], start[:3, 3] * 2 / 3 + end[:3, 3] / 3, atol=1e-12)
    turned = poses.log_rotation(start[:3, :3].T @ middle[:3, :3])
    np.testing.assert_allclose(turned, poses.log_rotation(start[:3, :3].T @ end[:3, :3]) / 3, atol=1e-12)


@pytest.mark.parametrize(
    ("encoding", "channels"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0])],
)
def test_colour_encodings(tmp_path, encoding, channels):
    out, rng = plain("ros1", 1), np.random.default_rng(0)
    rgb = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    out.image("/color", START, rgb[:, :, channels], encoding, pad=3)
    capture, _ = converted(tmp_path, out, PLAIN | {"/color": {"role": "rgb"}})
    assert np.array_equal(capture[0].rgb, rgb)


def test_grey_and_compressed_colour(tmp_path):
    rng = np.random.default_rng(0)
    rgb = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8), (0, 0), 5)
    topics = PLAIN | {"/color": {"role": "rgb"}}
    for name in ("mono8", "png", "jpeg"):
        out = plain("sqlite3", 1)
        if name == "mono8":
            out.image("/color", START, rgb[:, :, 0], "mono8")
        else:
            data = cv2.imencode(f".{name}", rgb[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
            out.compressed("/color", START, data, f"rgb8; {name} compressed bgr8")
        found = converted(tmp_path / name, out, topics)[0][0].rgb
        expected = np.repeat(rgb[:, :, :1], 3, axis=2) if name == "mono8" else rgb
        assert np.abs(found.astype(int) - expected).max() <= (8 if name == "jpeg" else 0)


def test_inverse_depth_and_depth_beyond_what_is_kept(tmp_path):
    rng = np.random.default_rng(1)
    metres = rng.uniform(0.4, 2.0, (HEIGHT, WIDTH)).astype(np.float32)
    metres[0] = 0.0
    out = Messages("ros1")
    out.camera_info("/depth/info", START)
    out.compressed("/depth", START, bags.compressed_metres(metres), "32FC1; compressedDepth png")
    found = converted(tmp_path / "a", out)[0][0].depth
    assert np.array_equal(found == 0, metres == 0)
    assert np.abs(found - metres).max() < 2.0**2 / (100 * 101) + 1e-4  # one count of the inverse depth at 2 m
    far = metres.copy()
    far[1, :5] = 6.6
    out = Messages("mcap")
    out.camera_info("/depth/info", START)
    out.image("/depth", START, far, "32FC1")
    capture, said = converted(tmp_path / "b", out)
    assert said["dropped"] == [{"what": "/depth", "why": "depth readings beyond 6.554 m", "count": 5}]
    assert np.abs(capture[0].depth - np.where(far > 6.55, 0, far)).max() <= 0.0500001e-3
    topics = {"/depth": {"role": "depth", "depth_scale": 0.25}, "/depth/info": {"role": "camera_info"}}
    capture, said = converted(tmp_path / "c", out, topics)
    assert said["dropped"] == []
    assert np.abs(capture[0].depth - far).max() <= 0.1250001e-3


def test_definitions_of_the_map_stand_in_for_those_of_the_bag(tmp_path, monkeypatch, capsys):
    from rosbags.rosbag2 import storage_sqlite3

    # bags of ROS 2 before Iron: the database has no table of definitions
    monkeypatch.setattr(storage_sqlite3.Sqlite3Writer, "add_msgtype", lambda self, connection: None)
    out = plain("sqlite3", 1)
    out.pressures("/pad", START, [1.0, 2.5])
    topics = PLAIN | {"/pad": {"role": "tactile", "sensor": "pad", "field": "cells"}}
    made = write_map(tmp_path / "without.json", topics)
    bag = out.write(tmp_path / "undefined")
    error = refused(capsys, "convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
    assert "/pad: expected the definition of palpate_msgs/msg/Pressures in the topic map, got none" in error
    capture, _ = converted(tmp_path, out, topics, definitions=bags.TYPES)
    assert capture[0].tactile["pad"].tolist() == [1.0, 2.5]


def test_distortion_needs_rectified_images(tmp_path, capsys):
    out = plain("ros1", 1)
    out.camera_info("/depth/info", START + 1, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    bag = out.write(tmp_path / "bag")
    made = write_map(tmp_path / "topics.json", PLAIN)
    argv = ("convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
    assert "expected images without distortion, got coefficients up to 0.1" in refused(capsys, *argv)
    write_map(made, {"/depth": {"role": "depth"}, "/depth/info": {"role": "camera_info", "rectified": True}})
    assert main([str(a) for a in argv]) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_truncated_bags(tmp_path, capsys, kind):
    out = plain(kind, 20)
    bag = out.write(tmp_path / "bag")
    file = bag if bag.is_file() else next(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
    whole = file.read_bytes()
    made = write_map(tmp_path / "topics.json", PLAIN)
    for share in (0.0, 0.3, 0.6, 0.95):
        file.write_bytes(whole[: int(share * len(whole))])
        message = refused(capsys, "convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
        assert str(bag) in message
        assert not (tmp_path / "c").exists()


def test_overwritten_bytes_are_one_line_or_a_capture(tmp_path, capsys):
    rng = np.random.default_rng(5)
    for kind in KINDS:
        bag = plain(kind, 6).write(tmp_path / kind)
        file = bag if bag.is_file() else next(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
        whole = np.frombuffer(file.read_bytes(), dtype=np.uint8)
        made = write_map(tmp_path / "topics.json", PLAIN)
        for _ in range(12):
            damaged = whole.copy()
            at = int(rng.integers(0, len(whole) - 40))
            damaged[at : at + 40] = rng.integers(0, 256, 40)
            file.write_bytes(damaged.tobytes())
            code = main(["convert", str(bag), str(tmp_path / "c"), "--topics", str(made), "--object", "box"])
            err = capsys.readouterr().err
            assert (code, err.count("\n")) in ((0, 0), (2, 1)), err


def test_malformed_bags_and_maps(tmp_path, capfd):
    # capfd: complaints of libraries written in C do not pass through Python
    def says(message, out, topics=None, **rest):
        folder = tmp_path / f"case{len(list(tmp_path.iterdir()))}"
        folder.mkdir()
        bag = out.write(folder / "bag")
        made = write_map(folder / "topics.json", topics or PLAIN, **rest)
        error = refused(capfd, "convert", bag, folder / "c", "--topics", made, "--object", "box")
        assert message in error, error
        assert not (folder / "c").exists()

    out = plain("mcap", 1)
    says(
        "expected the topic /colour of topics.json, got /depth, /depth/info", out, PLAIN | {"/colour": {"role": "rgb"}}
    )
    says(
        "expected CameraInfo for the role camera_info",
        out,
        {"/depth": {"role": "camera_info"}, "/depth/info": {"role": "depth"}},
    )
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
    bag = plain("mcap", 1).write(tmp_path / "bag")
    assert "expected --topics FILE, a topic map" in refused(capfd, "convert", bag, tmp_path / "c", "--object", "box")
    made = write_map(tmp_path / "topics.json", PLAIN)
    assert "say --object MESH" in refused(capfd, "convert", bag, tmp_path / "c", "--topics", made)
    (tmp_path / "empty").mkdir()
    assert "found neither" in refused(capfd, "convert", tmp_path / "empty", tmp_path / "c", "--topics", made)
    argv = ("convert", tmp_path / "empty", tmp_path / "c", "--topics", made, "--from", "ros", "--object", "box")
    assert "expected a readable ROS bag" in refused(capfd, *argv)


def test_without_rosbags_the_extra_is_named(tmp_path, capsys, monkeypatch):
    bag = plain("mcap", 1).write(tmp_path / "bag")
    made = write_map(tmp_path / "topics.json", PLAIN)
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    error = refused(capsys, "convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
    assert "pip install 'palpate[ros]'" in error
