"""Scenes of BOP data sets: the chosen object comes out with everything about it, and a capture goes there and back."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from commands import refused, run
from made_frames import CAMERA, plain_view, some_frame

from scenes.files.formats.ply import write_ply
from scenes.geometry import poses
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.frames import Contacts
from scenes.synthesis.library import make

SIZE = (48, 64)


class Dataset:
    """Two images of object 2 once and object 5 twice among eleven others, each image with a depth scale of its own."""

    def __init__(self, root: Path, placed: bool = True) -> None:
        rng = np.random.default_rng(4)
        self.root, self.scene = root, root / "test" / "000048"
        (root / "models").mkdir(parents=True)
        self.models = {2: make("cylinder"), 5: make("box")}
        info = {}
        for number, model in self.models.items():
            write_ply(root / "models" / f"obj_{number:06d}.ply", model.vertices * 1e3, model.faces)
            info[number] = {"diameter": model.diameter * 1e3}
        info[2]["symmetries_continuous"] = [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]
        self._json("../../models/models_info.json", info)
        self.numbers, self.scales = (3, 1000017), {3: 1.0, 1000017: 0.125}
        self.counts, self.rgb, self.masks, self.truths, self.worlds = {}, {}, {}, {}, {}
        cameras, truths, infos = {}, {}, {}
        for number in self.numbers:
            name = f"{number:06d}"
            self.counts[number] = rng.integers(0, 65536, SIZE).astype(np.uint16)
            self.rgb[number] = rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
            self._image(f"depth/{name}.png", self.counts[number])
            self._image(f"rgb/{name}.png", self.rgb[number][:, :, ::-1])
            ids = [7] * 10 + [2, 5, 5]
            rows, shares = [], []
            for row, number_of in enumerate(ids):
                pose = poses.make_pose(poses.random_rotations(1, rng)[0], [0.01 * row, 0.0, 0.7])
                mask = rng.random(SIZE) < 0.5
                self.masks[number, row], self.truths[number, row] = mask, pose
                self._image(f"mask_visib/{name}_{row:06d}.png", np.where(mask, 255, 0).astype(np.uint8))
                self._image(f"mask/{name}_{row:06d}.png", np.zeros(SIZE, np.uint8))
                rotation, shift = pose[:3, :3].ravel().tolist(), (pose[:3, 3] * 1e3).tolist()
                rows.append({"obj_id": number_of, "cam_R_m2c": rotation, "cam_t_m2c": shift})
                shares.append({"visib_fract": row / 16})
            world = self.worlds[number] = poses.exp(0.3 * rng.normal(size=6))
            camera = {"cam_K": CAMERA.matrix.ravel().tolist(), "depth_scale": self.scales[number]}
            if placed:
                camera["cam_R_w2c"] = world[:3, :3].ravel().tolist()
                camera["cam_t_w2c"] = (world[:3, 3] * 1e3).tolist()
            cameras[number], truths[number], infos[number] = camera, rows, shares
        for name, content in (("camera", cameras), ("gt", truths), ("gt_info", infos)):
            self._json(f"scene_{name}.json", content)

    def _json(self, name: str, content) -> None:
        self.scene.mkdir(parents=True, exist_ok=True)
        (self.scene / name).write_text(json.dumps(content))

    def _image(self, name: str, image) -> None:
        path = self.scene / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), image)

    def edit(self, name: str, change) -> None:
        content = json.loads((self.scene / name).read_text())
        change(content)
        self._json(name, content)


@pytest.fixture
def data(tmp_path):
    return Dataset(tmp_path / "set")


@pytest.mark.parametrize("instance", [0, 1])
def test_the_chosen_instance(data, tmp_path, instance):
    out = tmp_path / "c"
    assert run("convert", data.scene, out, "--object-id", 5, "--instance", instance, "--json", tmp_path / "j.json") == 0
    said = json.loads((tmp_path / "j.json").read_text())
    assert said == {"written": [str(out)], "frames": 2, "dropped": [], "remarks": []}
    capture = read_capture(out)
    assert capture.frame_ids == data.numbers
    assert capture.manifest.object_id == 5
    assert capture.manifest.notes["scene_id"] == 48
    assert capture.manifest.notes["visible_fraction"] == {str(n): (11 + instance) / 16 for n in data.numbers}
    for frame in capture:
        row = frame.index, 11 + instance
        counts = cv2.imread(str(out / "depth" / f"{frame.index:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(counts, data.counts[frame.index])
        np.testing.assert_allclose(frame.depth, counts * data.scales[frame.index] * 1e-3, rtol=1e-7)
        assert np.array_equal(frame.rgb, data.rgb[frame.index])
        assert np.array_equal(frame.mask, data.masks[row])
        np.testing.assert_allclose(frame.camera_from_object_truth, data.truths[row], atol=1e-12)
        np.testing.assert_allclose(frame.camera_from_world, data.worlds[frame.index], atol=1e-12)
        np.testing.assert_allclose(frame.camera.matrix, CAMERA.matrix, atol=1e-12)
    assert capture.model.diameter == pytest.approx(data.models[5].diameter)


def test_the_only_object_needs_no_choice_and_keeps_its_symmetry(data, tmp_path):
    assert run("convert", data.scene, tmp_path / "c", "--object-id", "2") == 0
    assert len(read_capture(tmp_path / "c").model.symmetries.axes) == 1
    data.edit(
        "scene_gt.json", lambda gt: gt.update({k: [r for r in rows if r["obj_id"] == 2] for k, rows in gt.items()})
    )
    for number in data.numbers:
        shutil.copy(data.scene / f"mask/{number:06d}_000010.png", data.scene / f"mask_visib/{number:06d}_000000.png")
    assert run("convert", data.scene, tmp_path / "d") == 0
    assert not read_capture(tmp_path / "d")[0].mask.any()


def test_grey_images_models_elsewhere_and_scenes_without_truth(data, tmp_path):
    (data.scene / "rgb").rename(data.scene / "gray")
    for path in (data.scene / "gray").iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        path.unlink()
        cv2.imwrite(str(path.with_suffix(".tif")), image)
    for name in ("scene_gt.json", "scene_gt_info.json"):
        (data.scene / name).unlink()
    (data.root / "models").rename(data.root / "cad")
    data.edit(
        "scene_camera.json", lambda c: [entry.pop("cam_R_w2c") and entry.pop("cam_t_w2c") for entry in c.values()]
    )
    assert run("convert", data.scene, tmp_path / "c", "--object-id", 5, "--models", data.root / "cad") == 0
    capture = read_capture(tmp_path / "c")
    frame = capture[0]
    assert (capture.world, frame.mask, frame.camera_from_object_truth) == ("camera", None, None)
    assert np.array_equal(frame.rgb[:, :, 0], frame.rgb[:, :, 2])
    mesh = data.root / "cad" / "obj_000002.ply"
    assert run("convert", data.scene, tmp_path / "d", "--object-id", 9, "--object", mesh, "--unit", "mm") == 0
    assert read_capture(tmp_path / "d").manifest.object_id == 9


def test_what_is_dropped(data, tmp_path, capsys):
    data.edit("scene_gt.json", lambda gt: gt["3"].pop(10))
    assert run("convert", data.scene, tmp_path / "c", "--object-id", 2, "--json", tmp_path / "j.json") == 0
    assert "dropped 1 of images: object 2 is not in scene_gt.json" in capsys.readouterr().out
    (data.scene / "depth" / "1000017.png").unlink()
    assert (
        run("convert", data.scene, tmp_path / "d", "--object-id", 5, "--instance", 0, "--json", tmp_path / "j.json")
        == 0
    )
    assert json.loads((tmp_path / "j.json").read_text())["dropped"] == [
        {"what": "images", "why": "no depth image", "count": 1}
    ]
    capsys.readouterr()
    message = refused(capsys, "convert", data.scene, tmp_path / "e", "--object-id", 2)
    assert (
        "got none: dropped 1 of images: object 2 is not in scene_gt.json; dropped 1 of images: no depth image"
        in message
    )


@pytest.mark.parametrize("folder", ["depth", "rgb"])
def test_images_without_a_camera_are_dropped_and_counted(data, tmp_path, folder):
    for number in (12, 5, 1000018):
        shutil.copy(data.scene / folder / "000003.png", data.scene / folder / f"{number:06d}.png")
    assert run("convert", data.scene, tmp_path / "c", "--object-id", 2, "--json", tmp_path / "j.json") == 0
    said = json.loads((tmp_path / "j.json").read_text())
    why = "no entry in scene_camera.json, the first is 000005"
    assert said["dropped"] == [{"what": "images", "why": why, "count": 3}]
    assert read_capture(tmp_path / "c").frame_ids == data.numbers


def test_malformed_scenes(data, tmp_path, capsys):
    def says(message, *argv):
        error = refused(capsys, "convert", data.scene, tmp_path / "c", *argv)
        assert message in error, error
        assert not (tmp_path / "c").exists()

    says("expected one object, got several: choose one of 2, 5, 7 with --object-id")
    says("expected an object of scene_gt.json (2, 5, 7), got --object-id 4", "--object-id", 4)
    says("got 2 in image 3: choose with --instance 0 to 1", "--object-id", 5)
    says("got none: dropped 2 of images: object 5", "--object-id", 5, "--instance", 2)
    says("expected obj_000007.ply in a folder models", "--object-id", 7, "--instance", 0)
    one = ("--object-id", 2)
    data.edit("scene_camera.json", lambda c: c["3"].update(depth_scale=0))
    says("scene_camera.json, frame 3: depth_scale: expected millimetres per count from 0.0001 to 1000, got 0", *one)
    data.edit("scene_camera.json", lambda c: c["3"].update(depth_scale=1))
    good = (data.scene / "scene_gt.json").read_text()
    data.edit("scene_gt.json", lambda gt: gt["3"][10].update(cam_R_m2c=[2, 0, 0, 0, 2, 0, 0, 0, 2]))
    says("scene_gt.json, frame 3: cam_R_m2c: expected a rotation matrix", *one)
    (data.scene / "scene_gt.json").write_text(good.replace('"cam_t_m2c": [', '"cam_t_m2c": [NaN, ', 100))
    says("cam_t_m2c: expected 3 finite numbers", *one)
    (data.scene / "scene_gt.json").write_text(good[:500])
    says("scene_gt.json: expected JSON", *one)
    (data.scene / "scene_gt.json").write_text(good)
    (data.scene / "depth" / "000003.png").write_bytes(b"\x89PNG")
    says("000003.png: expected a PNG image, got 4 bytes that are none", *one)
    cv2.imwrite(str(data.scene / "depth" / "000003.png"), np.zeros(SIZE, np.uint8))
    says("000003.png: expected a depth image of 16 bit, 1 channel, got 8 bit", *one)
    cv2.imwrite(str(data.scene / "depth" / "000003.png"), np.zeros((5, 5), np.uint16))
    says("frame 3: expected images of one size, got 5x5, 64x48, 64x48", *one)
    assert "expected one scene folder of the data set, such as" in refused(
        capsys, "convert", data.scene.parent, tmp_path / "c"
    )
    assert f"palpate convert {data.scene} OUT" in refused(capsys, "estimate", data.scene)
    assert "expected a capture (capture.json) for --to bop" in refused(
        capsys, "convert", data.scene, tmp_path / "c", "--to", "bop"
    )


@pytest.mark.parametrize("world", ["camera", "robot base"])
@pytest.mark.parametrize("masks", [True, False])
def test_there_and_back_is_the_same(tmp_path, world, masks):
    frames = [replace(some_frame(i, None, world), contacts=Contacts(np.zeros((0, 3)))) for i in (0, 7, 123456)]
    bare = {"cloud": None, "cloud_colours": None, "no_contact": None, "prior": None}
    frames = [replace(frame, **bare, mask=frame.mask if masks else None) for frame in frames]
    there, back = tmp_path / "there", tmp_path / "back"
    scales = {0: 0.1, 7: 0.05, 123456: 1.0}
    write_capture(there, frames, make("cylinder"), world=world, depth_scale=scales, object_id=13, notes={"scene_id": 4})
    assert run("convert", there, tmp_path / "set", "--to", "bop", "--json", tmp_path / "j.json") == 0
    assert json.loads((tmp_path / "j.json").read_text())["dropped"] == []
    assert run("convert", tmp_path / "set" / "test" / "000004", back) == 0
    for name in ("scene_camera.json", "scene_gt.json"):
        first, second = (json.loads((folder / name).read_text()) for folder in (there, back))
        assert first.keys() == second.keys()
        assert_close(first, second)
    a, b = read_capture(there), read_capture(back)
    for one, other in zip(a, b, strict=True):
        assert (one.index, one.camera) == (other.index, other.camera)
        assert np.array_equal(one.depth, other.depth)
        assert np.array_equal(one.rgb, other.rgb)
        assert (one.mask is None) == (other.mask is None) == (not masks)
        assert not masks or np.array_equal(one.mask, other.mask)
        np.testing.assert_allclose(one.camera_from_object_truth, other.camera_from_object_truth, atol=1e-12)
        np.testing.assert_allclose(one.camera_from_world, other.camera_from_world, atol=1e-12)
    assert (a.world, a.manifest.object_id, b.manifest.object_id) == (b.world, 13, 13)
    triangles = [m.vertices[m.faces] for m in (a.model, b.model)]
    np.testing.assert_allclose(*triangles, atol=1e-12)
    np.testing.assert_allclose(a.model.symmetries.axes[0].direction, b.model.symmetries.axes[0].direction)
    assert np.array_equal(a.model.symmetries.discrete, b.model.symmetries.discrete)


def assert_close(first, second) -> None:
    if isinstance(first, dict):
        for key in first:
            assert_close(first[key], second[key])
    elif isinstance(first, list):
        for one, other in zip(first, second, strict=True):
            assert_close(one, other)
    else:
        assert first == pytest.approx(second, abs=1e-9)


def test_export_counts_what_bop_has_no_place_for_and_describes_what_is_seen(tmp_path, capsys):
    frame = plain_view()
    half = np.zeros(frame.depth.shape, bool)
    half[:, : half.shape[1] // 2] = True
    hidden = replace(frame, index=1, mask=(frame.depth > 0) & half, prior=None)
    write_capture(tmp_path / "c", [frame, hidden], make("box"))
    out = tmp_path / "set"
    assert run("convert", tmp_path / "c", out, "--to", "bop", "--json", tmp_path / "j.json") == 0
    dropped = {(d["what"]): d["count"] for d in json.loads((tmp_path / "j.json").read_text())["dropped"]}
    assert dropped == {"contacts": 10, "priors": 1}
    info = json.loads((out / "test/000000/scene_gt_info.json").read_text())
    own = int((frame.depth > 0).sum())
    assert info["0"][0]["px_count_all"] == info["0"][0]["px_count_visib"] == info["0"][0]["px_count_valid"] == own
    assert info["0"][0]["visib_fract"] == 1.0
    assert info["1"][0]["visib_fract"] == pytest.approx(hidden.mask.sum() / own)
    v, u = np.nonzero(frame.depth > 0)
    box = [int(x) for x in (u.min(), v.min(), u.max() - u.min(), v.max() - v.min())]
    assert info["0"][0]["bbox_obj"] == info["0"][0]["bbox_visib"] == box
    targets = json.loads((out / "test_targets_bop19.json").read_text())
    assert targets[1] == {"im_id": 1, "inst_count": 1, "obj_id": 1, "scene_id": 0}
    capsys.readouterr()
    assert "found other files in it" in refused(capsys, "convert", tmp_path / "c", out, "--to", "bop")
    touch = replace(frame, camera=None, depth=None, cloud=frame.contacts.points)
    write_capture(tmp_path / "t", [touch], make("box"))
    assert "expected a frame with a camera" in refused(capsys, "convert", tmp_path / "t", tmp_path / "u", "--to", "bop")
    assert not (tmp_path / "u").exists()
