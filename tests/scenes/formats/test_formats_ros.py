"""Bags that rosbags writes, with everything that a capture can hold: nothing is lost on the way."""

from __future__ import annotations

import json

import bags
import cv2
import numpy as np
import pytest
from bags import HEIGHT, KINDS, MATRIX, MS, START, WIDTH, Messages, write_map
from commands import run
from made_frames import hand_with_array

from scenes.geometry import poses
from scenes.recordings.captures import read_capture
from scenes.recordings.checking.validation import validate
from scenes.robot.hands import Hand

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
def hand():
    return hand_with_array(6)


@pytest.fixture(scope="session")
def hand_folder(tmp_path_factory, hand):
    folder = tmp_path_factory.mktemp("hand")
    hand.save(folder)
    return folder


@pytest.fixture
def box(tmp_path, hand_folder):
    """The object's mesh beside the map."""
    from scenes.files.formats.ply import write_ply
    from scenes.synthesis.library import make

    model = make("box")
    write_ply(tmp_path / "box.ply", model.vertices, model.faces)
    return model


def check(scene: Scene, folder) -> None:
    """Everything that went into the bag came out, to the last bit or to 1e-12."""
    capture = read_capture(folder)
    assert capture.frame_ids == (0, 1, 2, 3, 4)
    assert capture.world == "robot base"
    assert capture.manifest.notes["stamps_ns"] == {str(i): stamp for i, stamp in enumerate(scene.stamps)}
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
    assert run("convert", bag, out, "--topics", topics, "--json", tmp_path / "j.json") == 0
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
    assert run("convert", file, tmp_path / "c", "--topics", scene.map(tmp_path, hand_folder)) == 0
    check(scene, tmp_path / "c")


@pytest.mark.parametrize("depth", ["big", "32FC1", "png", "compressedDepth"])
def test_depth_in_every_form(tmp_path, hand, hand_folder, box, depth):
    scene = Scene("mcap", hand, depth)
    bag = scene.out.write(tmp_path / "bag")
    assert run("convert", bag, tmp_path / "c", "--topics", scene.map(tmp_path, hand_folder)) == 0
    check(scene, tmp_path / "c")
