"""Every command of docs/formats.md works, with the page's own topic map and camera, on recordings like those."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import docs_commands
import numpy as np
import pytest
from bags import HEIGHT, SECOND, START, WIDTH, Messages
from image_folders import images, sequence
from made_frames import hand_with_array, plain_view

from fusion.cli.main import main
from scenes.files.formats.off import write_off
from scenes.files.formats.ply import write_ply
from scenes.geometry import poses
from scenes.recordings.bop import read_poses
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.checking.validation import validate
from scenes.synthesis.library import make

PAGE = Path(__file__).resolve().parents[3] / "docs" / "formats.md"
MS = SECOND // 1000


def bop(folder: Path) -> None:
    """A data set whose scene 48 has object 15 (a box) once and object 5 twice in each image."""
    frames = [replace(plain_view(seed=i), index=3 * i) for i in range(2)]
    write_capture(folder / "source", frames, make("box"), object_id=15, notes={"scene_id": 48})
    assert main(["convert", str(folder / "source"), str(folder / "data/ycbv"), "--to", "bop"]) == 0
    path = folder / "data/ycbv/test/000048/scene_gt.json"
    truths = json.loads(path.read_text())
    for rows in truths.values():
        rows += [{**rows[0], "obj_id": 5}, {**rows[0], "obj_id": 5}]
    path.write_text(json.dumps(truths))
    models = folder / "data/ycbv/models"
    shutil.copy(models / "obj_000015.ply", models / "obj_000005.ply")
    info = json.loads((models / "models_info.json").read_text())
    (models / "models_info.json").write_text(json.dumps({**info, "5": info["15"]}))


def bag(kind: str, topics: dict, path: Path) -> Path:
    """Three images with everything that the page's map names."""
    out, rng, names = Messages(kind), np.random.default_rng(0), list(topics["topics"])
    depth, info, rgb, joints, wrench, pressures, touches, tf, tf_static = names
    frames = topics["frames"]
    out.transform(tf_static, START, frames["world"], frames["camera"], poses.exp([0.1, 0.2, 0, 0.3, 0, 1]))
    for i in range(3):
        stamp = START + 33 * MS * i
        out.image(depth, stamp, rng.integers(300, 900, (HEIGHT, WIDTH)).astype(np.uint16), "16UC1", frames["camera"])
        out.camera_info(info, stamp)
        picture = cv2.imencode(".jpg", rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8))[1].tobytes()
        out.compressed(rgb, stamp + MS, picture, "rgb8; jpeg compressed bgr8", frames["camera"])
        out.joints(joints, stamp, {"thumb_1": 0.1, "index_abduction": 0.0})
        out.wrench(wrench, stamp, rng.normal(size=3), rng.normal(size=3))
        out.pressures(pressures, stamp, rng.random(6))
        out.touches(touches, stamp, frames["hand"], [[0.0, 0.0, 0.01 * i]], [[0, 0, 1]], [[0, 0, 0]], ["index"])
        out.transform(tf, stamp, frames["world"], frames["hand"], poses.exp([0, 0, 0.1 * i, 0, 0, 0.5]))
        out.transform(tf, stamp, frames["world"], frames["object"], poses.exp([0, 0, 0.1 * i, 0.02, 0, 0.55]))
    return out.write(path)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with every recording that the page speaks of."""
    folder, model = tmp_path_factory.mktemp("docs"), make("box")
    bop(folder)
    write_ply(folder / "drill.ply", model.vertices, model.faces)
    stamps = [f"15811204241{i:08d}" for i in range(3)]
    sequence(folder / "data/bleach0", stamps)
    _export(model, folder)
    given = docs_commands.files(PAGE)
    (folder / "topics.json").write_text(given["topics.json"])
    hand = hand_with_array(6, "index_tip")
    hand.save(folder / "hand")
    (folder / "recordings").mkdir()
    topics = json.loads(given["topics.json"])
    bag("ros1", topics, folder / "recordings/grasp")
    bag("sqlite3", topics, folder / "recordings/grasp_ros2")
    mcap = bag("mcap", topics, folder / "recordings/mcap")
    shutil.copy(next(mcap.glob("*.mcap")), folder / "recordings/grasp.mcap")
    _touch(folder, model)
    for name in ("photos", "photos_with_camera"):
        images(folder / name)
    (folder / "photos_with_camera/camera.json").write_text(given["camera.json"])
    return folder


def _export(model, folder: Path) -> None:
    import trimesh

    trimesh.Trimesh(model.vertices, model.faces, process=False).export(folder / "data/bleach.obj")


def _touch(folder: Path, model) -> None:
    points = model.sample_surface(40, 0)[0]
    for name in ("config", "models", "measurements"):
        (folder / "data/tactile" / name).mkdir(parents=True)
    write_off(folder / "data/tactile/models/box.off", model.vertices, model.faces)
    write_off(folder / "data/tactile/measurements/measBox15.off", points[:20])
    (folder / "data/tactile/config/configBox15.ini").write_text(
        "modelFile ../../models/box.off\nmeasurementsFile ../../measurements/measBox15.off\nnumMeas 15\n"
    )
    (folder / "data/domino").mkdir()
    write_off(folder / "data/domino/cloud.off", points)
    write_off(folder / "data/domino/contacts.off", points[:3])
    write_off(folder / "data/domino/model.off", model.vertices, model.faces)


def test_every_command_of_the_page_works(place, monkeypatch, capsys):
    monkeypatch.chdir(place)
    (place / "out").mkdir()
    typed = docs_commands.commands(PAGE)
    assert len(typed) >= 20
    for argv in typed:
        assert main(argv) == 0, (argv, capsys.readouterr().err)
    captures = sorted(path.name for path in (place / "captures").iterdir())
    assert len(captures) == 12
    for name in captures:
        capture = read_capture(place / "captures" / name)
        assert len(capture) > 0
        told = [p.message for p in validate(capture.path)]
        # stand-ins for the page's images are smaller
        assert [line for line in told if "sizes that agree" not in line and "principal point" not in line] == []
    assert read_capture(place / "captures/can").manifest.object_id == 5
    rows = read_poses(place / "out/drill/poses.csv")
    assert [(row.scene_id, row.im_id, row.obj_id) for row in rows] == [(48, 0, 15), (48, 3, 15)]
    counts = json.loads((place / "out/counts.json").read_text())
    assert (counts["frames"], counts["dropped"], len(counts["remarks"])) == (3, [], 1)
    grasps = [read_capture(place / "captures" / name) for name in ("grasp", "grasp_ros2", "grasp_mcap")]
    for frame in (capture[2] for capture in grasps):
        assert (frame.joints["thumb_opposition"], len(frame.contacts), len(frame.wrenches)) == (0.1, 1, 1)
        assert np.array_equal(frame.depth, grasps[0][2].depth)
        np.testing.assert_allclose(frame.contacts.points, grasps[0][2].contacts.points, atol=1e-12)


def test_the_page_names_every_format_and_option():
    from fusion.cli.commands.data.convert import SOURCES, TARGETS
    from fusion.cli.parser import build_parser
    from scenes.formats.ros.topics import FRAMES, KEYS, REQUIRABLE, ROLES

    text = PAGE.read_text(encoding="utf-8")
    for name in (
        *SOURCES,
        *TARGETS,
        *ROLES,
        *FRAMES,
        *REQUIRABLE,
        *(key for key in KEYS if key not in ("format", "version")),
    ):
        assert f"`{name}" in text, name
    options = {key.rstrip("!") for keys in ROLES.values() for key in keys}
    for name in options:
        assert f"`{name}" in text, name
    command = next(a for a in build_parser()._actions if a.dest == "command").choices["convert"]
    for option in command._option_string_actions:
        if option not in ("-h", "--help", "--seed", "-v", "--verbose", "-q", "--quiet"):
            assert option in text, option


def test_the_page_names_every_file_and_column_of_a_capture():
    from scenes.recordings.captures import CSV_FILES

    text = PAGE.read_text(encoding="utf-8")
    for name, columns in CSV_FILES.items():
        row = next(line for line in text.splitlines() if line.startswith(f"| `{name}`"))
        if name != "hand_poses.csv":
            assert ",".join(column.name for column in columns) in row
    for part in ("capture.json", "scene_camera.json", "scene_gt.json", "prior.json", "depth/", "rgb/", "clouds/"):
        assert f"| `{part}" in text
