"""Frames that several test files share: one of random numbers with every part, one exact view of an object, and
those of an object that is carried.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer, shade
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Contacts, EmptyRegions, Frame, Wrench
from scenes.robot.hands import Hand
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make

CAMERA = Camera(80.0, 82.0, 31.5, 23.5, 64, 48)
VIEW = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
# Frames of a recording by `recording`, when nobody says how many.
CARRIED = 12


def touching(hand, sensor: str, place: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """world_from_hand, turned like a pose, that brings the sensor of a nearly open hand to a place."""
    at = (turned @ hand.hand_from_sensor(dict.fromkeys(hand.joint_names, 0.1))[sensor])[:3, 3]
    return poses.make_pose(translation=place - at) @ turned


def hand_with_array(count: int = 4, name: str = "") -> Hand:
    """The five-finger hand of which the sensor of that name, else the second, has `count` taxels in a row."""
    plain = five_finger_hand()
    name = name or list(plain.sensors)[1]
    taxels = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (count, 1))
    taxels[:, 0] = 0.002 * np.arange(count)
    return Hand(plain.robot, {**plain.sensors, name: replace(plain.sensors[name], kind="array", taxels=taxels)})


def some_frame(index: int, hand=None, world: str = "camera") -> Frame:
    rng = np.random.default_rng(index)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.01, -0.02, 0.6])
    camera_from_world = np.eye(4) if world == "camera" else poses.exp(0.2 * rng.normal(size=6))
    centre = poses.apply(poses.inverse(camera_from_world), truth[None, :3, 3])[0]
    normals = poses.random_unit_vectors(3, rng)
    normals[1] = np.nan
    depth = np.where(rng.random((48, 64)) < 0.9, 0.6 + 0.05 * rng.random((48, 64)), 0.0)
    names = ["a", "a", "b"] if hand is None else list(hand.sensors)[:3]
    arrays = [] if hand is None else [name for name in names if hand.sensors[name].taxels is not None]
    return Frame(
        index=index,
        camera=CAMERA,
        camera_from_world=camera_from_world,
        depth=depth.astype(np.float32),
        rgb=rng.integers(0, 256, (48, 64, 3), dtype=np.uint8),
        mask=rng.random((48, 64)) < 0.3,
        cloud=centre + 0.05 * rng.normal(size=(50, 3)),
        cloud_colours=rng.integers(0, 256, (50, 3), dtype=np.uint8),
        hand=hand,
        joints=None if hand is None else dict.fromkeys(hand.joint_names, 0.1),
        world_from_hand=None if hand is None else touching(hand, names[0], centre, poses.exp(rng.normal(size=6))),
        contacts=Contacts(
            centre + 0.03 * rng.normal(size=(3, 3)), normals, [1e-3, 2e-3, 3e-3], 0.1, names, rng.normal(size=(3, 3))
        ),
        no_contact=EmptyRegions(rng.normal(size=(2, 3)), np.array([0.01, 0.02]), ["a", "b"]),
        wrenches=() if hand is None else (Wrench(names[0], rng.normal(size=3), rng.normal(size=3)),),
        tactile={name: rng.random(4) for name in arrays},
        prior=poses.displaced(truth, 0.3, 0.03, np.zeros(3), rng),
        camera_from_object_truth=truth,
    )


def plain_view(name: str = "box", seed: int = 0) -> Frame:
    """An object in front of nothing: exact depth, five exact contacts, a start 8 degrees and 10 mm off."""
    rng = np.random.default_rng(seed)
    model = make(name)
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.0, 0.5])
    points, normals = model.sample_surface(5, seed)
    return Frame(
        index=0,
        camera=VIEW,
        depth=Renderer({"object": (model.vertices, model.faces)}).render(VIEW, {"object": pose}).depth,
        contacts=Contacts(poses.apply(pose, points), normals @ pose[:3, :3].T, 1e-3, 0.05),
        prior=poses.displaced(pose, np.deg2rad(8), 0.010, model.centroid, rng),
        camera_from_object_truth=pose,
    )


def coloured(name, back=(138, 142, 146)):
    """A plain view with a colour image of it, and the model."""
    frame, model = plain_view(name), make(name)
    meshes = {"object": (model.vertices, model.faces)}
    seen = Renderer(meshes).render(frame.camera, {"object": frame.camera_from_object_truth})
    rgb = shade(seen, {"object": (206, 116, 58)})
    rgb[~seen.mask("object")] = back
    noise = np.random.default_rng(3).normal(0.0, 4.0, rgb.shape)
    return replace(frame, rgb=np.clip(rgb + noise, 0, 255).astype(np.uint8)), model


def recording(model, count=CARRIED, slip=None, seed=0, step=(0.01, 0.02, 0.0, 0.003, 0.001, 0.001)):
    """Frames of an object carried by a hand that the camera does not see: depth, contacts and the hand's pose.

    slip: {frame: delta (6,)} by which the object moves in the hand before that frame.
    """
    rng = np.random.default_rng(seed)
    renderer = Renderer({"object": (model.vertices, model.faces)})
    hold = poses.make_pose(poses.random_rotations(1, rng)[0], [0.01, 0.02, 0.08])
    camera_from_hand = poses.make_pose(poses.random_rotations(1, rng)[0], None)
    camera_from_hand[:3, 3] = [-0.02, 0.0, 0.55] - camera_from_hand[:3, :3] @ (hold @ [*model.centroid, 1.0])[:3]
    chosen, normals = model.sample_surface(5, seed=seed)
    frames = []
    for index in range(count):
        hold = poses.perturb(hold, (slip or {}).get(index, np.zeros(6)), model.centroid)
        truth = camera_from_hand @ hold
        depth = renderer.render(VIEW, {"object": truth}).depth.astype(np.float32)
        depth = np.where(np.isfinite(depth) & (depth > 0), depth + 0.001 * rng.normal(size=depth.shape), 0.0)
        points = chosen + 0.0007 * rng.normal(size=chosen.shape)
        contacts = Contacts(points, normals, 0.0009, 0.09).moved(truth)
        prior = poses.displaced(truth, np.deg2rad(8), 0.01, model.centroid, rng) if index == 0 else None
        frames.append(
            Frame(
                index, f"frame {index}", VIEW, depth=depth.astype(np.float32), world_from_hand=camera_from_hand,
                contacts=contacts, prior=prior, camera_from_object_truth=truth,
            )
        )  # fmt: skip
        middle = (truth @ [*model.centroid, 1.0])[:3]
        turn = poses.exp_rotation(step[:3])
        camera_from_hand = poses.make_pose(turn, middle + step[3:] - turn @ middle) @ camera_from_hand
    return frames


def off_by(answer, frame, model):
    """Degrees and millimetres, modulo symmetry."""
    truth = frame.camera_from_object_truth
    delta = poses.difference(model.symmetries.nearest(answer.pose, truth), truth, model.centroid)
    return np.rad2deg(np.linalg.norm(delta[:3])), 1e3 * np.linalg.norm(delta[3:])
