"""A scene as binary glTF: the object at its poses, the cloud, the hand, the contacts. Metres, y upwards."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.files.whole import replace_file
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# A viewer in a browser turns this many points without stutter.
MOST_POINTS = 50_000
CONTACT_RADIUS = 0.002
COLOURS = {"object": (206, 116, 58, 255), "truth": (96, 160, 96, 110), "hand": (222, 186, 164, 160)}
CLOUD_COLOUR = (138, 142, 146)
CONTACT_COLOUR = (40, 160, 60, 255)


def write_glb(
    path: Path,
    model: ObjectModel,
    found: Mapping[int, Array],
    frame: Frame,
    world_from_camera: Mapping[int, Array],
    truths: Mapping[int, Array] | None = None,
    world: str = "camera",
) -> None:
    """Write the object at camera_from_object (4, 4) of each frame, and what `frame` senses: cloud, hand, contacts.

    Nodes: object_FRAME, truth_FRAME, cloud, hand, contact_N, under one root that turns the world upright.
    """
    import trimesh

    scene = trimesh.Scene()
    # a camera's y points down, a robot's z up
    root = poses.make_pose(poses.exp_rotation([np.pi if world == "camera" else -np.pi / 2, 0.0, 0.0]))
    for name, trajectory in (("object", found), ("truth", truths or {})):
        mesh = _mesh(model.vertices, model.faces, COLOURS[name])
        for number, pose in trajectory.items():
            node = f"{name}_{number:06d}"
            place = root @ world_from_camera[number] @ pose
            scene.add_geometry(mesh, geom_name=name, node_name=node, transform=place)
    cloud, colours = _cloud(frame)
    if len(cloud):
        points = trimesh.PointCloud(poses.apply(root, cloud), colors=colours)
        scene.add_geometry(points, geom_name="cloud", node_name="cloud")
    if frame.hand is not None and frame.joints is not None and frame.world_from_hand is not None:
        vertices, faces, _ = frame.hand.mesh(frame.joints)
        hand = _mesh(vertices, faces, COLOURS["hand"])
        scene.add_geometry(hand, geom_name="hand", node_name="hand", transform=root @ frame.world_from_hand)
    for number, point in enumerate(frame.contacts.points):
        ball = trimesh.creation.icosphere(subdivisions=2, radius=CONTACT_RADIUS)
        ball.visual.face_colors = CONTACT_COLOUR
        place = root @ poses.make_pose(translation=point)
        scene.add_geometry(ball, geom_name=f"contact_{number}", node_name=f"contact_{number}", transform=place)
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, scene.export(file_type="glb"))


def _mesh(vertices: Array, faces: NDArray[np.int64], colour: tuple[int, ...]):  # type: ignore[no-untyped-def]
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(
            baseColorFactor=colour, metallicFactor=0.0, alphaMode="OPAQUE" if colour[3] == 255 else "BLEND"
        )
    )
    return mesh


def _cloud(frame: Frame) -> tuple[Array, NDArray[np.uint8]]:
    """World points of the depth image and the cloud, evenly thinned, and their colours."""
    points, shades = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8)
    if frame.camera is not None and frame.depth is not None:
        read = np.isfinite(frame.depth) & (frame.depth > 0)
        points = poses.apply(poses.inverse(frame.camera_from_world), frame.camera.back_project(frame.depth))
        shades = np.full((len(points), 3), CLOUD_COLOUR, dtype=np.uint8) if frame.rgb is None else frame.rgb[read]
    if frame.cloud is not None:
        extra = frame.cloud_colours
        if extra is None:
            extra = np.full((len(frame.cloud), 3), CLOUD_COLOUR, dtype=np.uint8)
        points, shades = np.concatenate([points, frame.cloud]), np.concatenate([shades, extra])
    step = -(-len(points) // MOST_POINTS) or 1
    return points[::step], shades[::step]
