"""Valid files of every kind that is read, and the readers: what `stability_cases_files` damages and reads again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenes.files.formats import images, off, ply, tables
from scenes.files.problems import refuse
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings import bop
from scenes.recordings.captures import contacts_of, read_capture, write_capture
from scenes.recordings.checking.validation import validate
from scenes.recordings.frames import Contacts, EmptyRegions, Frame, Wrench
from scenes.recordings.manifest import read_manifest, read_model
from scenes.robot.hands import Hand
from scenes.robot.sensors import read_sensors, surface_hull
from scenes.robot.urdf import read_urdf
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand


@dataclass(frozen=True)
class Reader:
    """name; file, relative to the folder of valid files; read(path of the damaged file, in a folder like that one)."""

    name: str
    file: str
    read: Callable[[Path], Any]


def _table(columns: tuple[tables.CsvColumn, ...]) -> Callable[[Path], Any]:
    return lambda path: tables.read_table(path, columns, refuse)


def _contacts(path: Path) -> None:
    rows = tables.read_table(path, tables.CONTACTS, refuse)
    for frame in sorted(set(rows.frames().tolist()))[:5]:
        contacts_of(rows.of_frame(frame))


def _cameras(path: Path) -> None:
    for entry in bop.read_frames(path, refuse).values():
        bop.camera(bop.camera_entry(entry), None)


def _truths(path: Path) -> None:
    for entry in bop.read_frames(path, refuse).values():
        bop.truth_entry(entry, 1)


def _sensors(path: Path) -> None:
    for sensor in read_sensors(path).values():
        if sensor.surface is not None and "mesh" in sensor.surface:
            surface_hull(sensor.surface, sensor.name)


def _loose(path: Path) -> None:
    from fusion.cli.commands.answers.localize import read_contacts

    read_contacts(path, 0 if path.suffix == ".csv" else None)


def _covariances(path: Path) -> None:
    from fusion.results.files import read_covariances

    read_covariances(path)


def _every_frame(path: Path) -> None:
    """The whole capture that holds the file; every problem of it, too."""
    folder = next(parent for parent in path.parents if (parent / "capture.json").is_file())
    validate(folder)
    capture = read_capture(folder)
    for frame in capture:
        _ = frame.contacts, frame.cloud
    _ = capture.model, capture.hand


READERS = (
    Reader("capture.json", "capture/capture.json", lambda path: read_manifest(path.parent, refuse)),
    Reader("scene_camera.json", "capture/scene_camera.json", _cameras),
    Reader("scene_gt.json", "capture/scene_gt.json", _truths),
    Reader("prior.json", "capture/prior.json", lambda path: bop.read_priors(path, refuse)),
    Reader(
        "models_info.json",
        "capture/models/models_info.json",
        lambda path: read_model(path.parents[1], read_manifest(path.parents[1], refuse)),
    ),
    Reader("contacts.csv", "capture/contacts.csv", _contacts),
    Reader("joints.csv", "capture/joints.csv", _table(tables.JOINTS)),
    Reader("hand_poses.csv", "capture/hand_poses.csv", _table(tables.HAND_POSES)),
    Reader("no_contact.csv", "capture/no_contact.csv", _table(tables.NO_CONTACT)),
    Reader("wrenches.csv", "capture/wrenches.csv", _table(tables.WRENCHES)),
    Reader("loose contacts.csv", "loose.csv", _loose),
    Reader("contacts as OFF", "points.off", _loose),
    Reader("OFF", "mesh.off", off.read_off),
    Reader("OFF mesh", "mesh.off", ObjectModel.load),
    Reader("COFF cloud", "cloud.off", ply.read_cloud),
    Reader("PLY mesh", "mesh.ply", ObjectModel.load),
    Reader("PLY mesh as text", "text.ply", ObjectModel.load),
    Reader("PLY cloud", "cloud.ply", ply.read_cloud),
    Reader("OBJ mesh", "mesh.obj", ObjectModel.load),
    Reader("STL mesh", "mesh.stl", ObjectModel.load),
    Reader("STL mesh as text", "text.stl", ObjectModel.load),
    Reader("URDF", "hand/hand.urdf", read_urdf),
    Reader("URDF with sensors", "hand/hand.urdf", Hand.load),
    Reader("sensors.json", "hand/sensors.json", _sensors),
    Reader("depth PNG", "capture/depth/000000.png", lambda path: images.read_depth(path, 0.1)),
    Reader("colour PNG", "capture/rgb/000000.png", images.read_rgb),
    Reader("mask PNG", "capture/mask_visib/000000_000000.png", images.read_mask),
    Reader("poses.csv", "poses.csv", bop.read_poses),
    Reader("result.json", "result.json", _covariances),
)
# Files of a capture that are damaged one at a time while the whole capture is read and validated.
IN_CAPTURE = (
    *dict.fromkeys(reader.file for reader in READERS if reader.file.startswith("capture/")),
    "capture/hand/hand.urdf",
    "capture/hand/sensors.json",
    "capture/models/obj_000001.ply",
    "capture/clouds/000000.ply",
)
WHOLE = tuple(Reader(f"capture with {file.partition('/')[2]}", file, _every_frame) for file in IN_CAPTURE)


def write_valid(folder: Path) -> None:
    """Valid files of every kind in a new folder."""
    import json

    import trimesh

    model, hand = library.make("box"), five_finger_hand()
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    points, normals = model.sample_surface(6, seed=0)
    pose = se3.make_pose(translation=[0.0, 0.0, 0.5])
    from scenes.geometry.cameras import Camera

    depth = np.zeros((12, 16), dtype=np.float32)
    depth[3:9, 4:12] = 0.45
    names = list(hand.sensors)
    frame = Frame(
        0,
        camera=Camera(20.0, 20.0, 7.5, 5.5, 16, 12),
        depth=depth,
        rgb=rng.integers(0, 255, size=(12, 16, 3)).astype(np.uint8),
        mask=depth > 0,
        cloud=se3.apply(pose, points),
        cloud_colours=rng.integers(0, 255, size=(6, 3)).astype(np.uint8),
        hand=hand,
        joints=dict.fromkeys(hand.joint_names, 0.1),
        world_from_hand=pose,
        contacts=Contacts(points, normals, 1e-3, 0.1, [names[0]] * 6).moved(pose),
        no_contact=EmptyRegions(points[:2], np.full(2, 0.004), [names[0]] * 2),
        wrenches=(Wrench(names[0], np.array([0.0, 0.0, -1.0]), np.zeros(3)),),
        prior=pose,
        camera_from_object_truth=pose,
    )
    write_capture(folder / "capture", [frame], model, hand=hand, world="robot base")
    hand.save(folder / "hand")
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    ply.write_ply(folder / "mesh.ply", model.vertices, model.faces)
    ply.write_ply(folder / "cloud.ply", points, colours=frame.cloud_colours)
    (folder / "text.ply").write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding="ascii"))
    off.write_off(folder / "mesh.off", model.vertices, model.faces)
    off.write_off(folder / "cloud.off", points, colours=frame.cloud_colours)
    off.write_off(folder / "points.off", points)
    for name in ("mesh.obj", "mesh.stl"):
        mesh.export(folder / name)
    mesh.export(folder / "text.stl", file_type="stl_ascii")
    rows = [(0, "a", *point, *normal, *[np.nan] * 5) for point, normal in zip(points, normals)]
    tables.write_table(folder / "loose.csv", tables.LOOSE_CONTACTS, rows)
    bop.write_poses(folder / "poses.csv", [bop.PoseRow(0, i, 1, 1.0, pose, 0.1) for i in range(3)])
    covariance = np.eye(6).tolist()
    result = {"version": 1, "frames": [{"frame": i, "covariance": covariance} for i in range(3)]}
    (folder / "result.json").write_text(json.dumps(result), encoding="utf-8")
