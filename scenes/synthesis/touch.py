"""What the touch sensors of a hand feel in a grasp: contacts, wrenches, pressures, and where nothing is.

The grasp is exact; what is reported passes through the sensors' errors. Hand frame; metres, newtons, pascals.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, EmptyRegions, Wrench
from scenes.robot import tactile
from scenes.robot.fingers import find_fingers
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.grasps import Grasp
from scenes.synthesis.noise import presets as noise_models
from scenes.synthesis.noise.presets import LastingErrors, NoisePreset
from scenes.synthesis.settings import SynthesisSettings

Array = NDArray[np.float64]

# Grid on which the inside of a link is looked at for balls that fit (m), balls kept, and the smallest (m).
BALL_GRID = 0.002
BALLS_PER_LINK = 4
SMALLEST_BALL = 0.003
# Points of the surface among which those that a skin feels are drawn, and the cosine of the angle to the fingertip's
# own contact up to which it bends around a thing.
SKIN_POINTS = 30_000
SKIN_FACES = 0.6


def turning(hand: Hand, joints: dict[str, float]) -> dict[str, float]:
    """The joints measured in radians: sliding ones are left out of the angular noise."""
    sliding = {joint.name for joint in hand.robot.joints if joint.kind == "prismatic"}
    return {name: value for name, value in joints.items() if name not in sliding}


def felt_by_skins(model: ObjectModel, grasp: Grasp, count: int, reach: float, rng: np.random.Generator) -> Contacts:
    """The exact contacts of fingertips whose skin feels up to `count` of them each, hand frame: the grasp's own, and
    random points of the surface within `reach` (m) of it that face as it does; fewer where there are none.
    """
    if count == 1 or not len(grasp.contacts):
        return grasp.contacts
    points, normals = model.sample_surface(SKIN_POINTS)
    points = poses.apply(grasp.hand_from_object, points)
    normals = normals @ grasp.hand_from_object[:3, :3].T
    parts = []
    for row, (middle, facing) in enumerate(zip(grasp.contacts.points, grasp.contacts.normals, strict=True)):
        near = np.linalg.norm(points - middle, axis=1) < reach
        there = np.flatnonzero(near & (np.abs(normals @ facing) > SKIN_FACES))
        there = rng.permutation(there)[: count - 1]
        alike = np.sign(normals[there] @ facing)[:, None] * normals[there]
        parts.append(grasp.contacts.take([row]))
        parts.append(Contacts(points[there], alike, sensors=[grasp.contacts.sensors[row]] * len(there)))
    return Contacts.concatenate(parts)


def carried(hand: Hand, grasp: Grasp, measured: dict[str, float]) -> Contacts:
    """The exact contacts where the measured joints would put them: each is fixed to its sensor's link. Hand frame."""
    true_poses = hand.forward_kinematics(grasp.joints)
    seen_poses = hand.forward_kinematics(measured)
    parts = []
    for row, name in enumerate(grasp.contacts.sensors):
        link = hand.sensors[name].link
        parts.append(grasp.contacts.take([row]).moved(seen_poses[link] @ poses.inverse(true_poses[link])))
    return Contacts.concatenate(parts)


def press_forces(grasp: Grasp, rng: np.random.Generator, settings: SynthesisSettings) -> Array:
    """(n, 4) for each contact: normal force (N), then the friction force's direction and size as a vector (N)."""
    out = np.zeros((len(grasp.contacts), 4))
    for row, normal in enumerate(grasp.contacts.normals):
        pressing = rng.uniform(*settings.force)
        across = np.cross(normal, poses.random_unit_vectors(1, rng)[0])
        across /= np.linalg.norm(across)
        out[row, 0] = pressing
        out[row, 1:] = rng.uniform(0.0, settings.friction_used) * settings.friction * pressing * across
    return out


def wrenches(
    hand: Hand,
    grasp: Grasp,
    forces: Array,
    preset: NoisePreset,
    rng: np.random.Generator,
    settings: SynthesisSettings,
    errors: LastingErrors | None = None,
) -> tuple[Wrench, ...]:
    """What the fingertips' force/torque sensors feel: the force of the object on the fingertip, sensor frame.

    It pushes into the fingertip, along the object's outward normal, with friction inside the cone; torque = p x f
    about the sensor's origin, plus the soft finger's torque about the normal. Several contacts of one sensor add up.
    forces: of `press_forces`.
    """
    frames = hand.hand_from_sensor(grasp.joints)
    total: dict[str, Array] = {}
    for row, name in enumerate(grasp.contacts.sensors):
        local = grasp.contacts.take([row]).moved(poses.inverse(frames[name]))
        point, normal = local.points[0], local.normals[0]
        force = forces[row, 0] * normal + frames[name][:3, :3].T @ forces[row, 1:]
        # what is left of the friction may twist the fingertip (limit surface of a soft finger)
        left = np.sqrt(max((settings.friction * forces[row, 0]) ** 2 - float(forces[row, 1:] @ forces[row, 1:]), 0.0))
        twist = rng.uniform(-1.0, 1.0) * left * settings.torsion_radius
        wrench = np.concatenate([force, np.cross(point, force) + twist * normal])
        total[name] = total.get(name, np.zeros(6)) + wrench
    out = []
    for name, wrench in total.items():
        measured = noise_models.observe_wrench(name, wrench, preset.touch, rng, errors)
        out.append(Wrench(name, measured[:3], measured[3:]))
    return tuple(out)


def pressures(
    hand: Hand,
    model: ObjectModel,
    grasp: Grasp,
    forces: Array,
    preset: NoisePreset,
    rng: np.random.Generator,
    dead: dict[str, NDArray[np.bool_]] | None = None,
) -> dict[str, Array]:
    """Readings (k,) Pa of every taxel array; one that touches nothing reads its noise.

    dead: sensor -> (k,) taxels that are broken; without it they are drawn anew.
    """
    frames = hand.hand_from_sensor(grasp.joints)
    link_rows = {hand.sensors[name].link: row for row, name in enumerate(grasp.contacts.sensors)}
    object_from_hand = poses.inverse(grasp.hand_from_object)
    broken = draw_dead(hand, preset, rng) if dead is None else dead
    out = {}
    for name, sensor in hand.sensors.items():
        if sensor.kind != "array" or sensor.taxels is None:
            continue
        layer = tactile.SoftLayer.from_json(sensor.soft_layer, f"sensor {name!r}")
        felt = np.zeros(len(sensor.taxels))
        row = link_rows.get(sensor.link)
        if row is not None:
            normal = object_from_hand[:3, :3] @ grasp.contacts.normals[row]
            felt, _ = tactile.press(model, object_from_hand @ frames[name], sensor, normal, float(forces[row, 0]))
        out[name] = tactile.read_out(felt, layer, preset.touch.taxel, broken.get(name), rng)
    return out


def draw_dead(hand: Hand, preset: NoisePreset, rng: np.random.Generator) -> dict[str, NDArray[np.bool_]]:
    """Which taxels of which array are broken."""
    return {
        name: rng.random(len(sensor.taxels)) < preset.touch.dead
        for name, sensor in hand.sensors.items()
        if sensor.kind == "array" and sensor.taxels is not None
    }


def empty_regions(hand: Hand, grasp: Grasp, measured: dict[str, float]) -> EmptyRegions | None:
    """Balls inside the links of fingers that feel nothing: the object is not there. Hand frame; None when all touch."""
    frames = hand.forward_kinematics(measured)
    points, radii, names = [], [], []
    for finger in find_fingers(hand):
        if finger.sensor in grasp.contacts.sensors:
            continue
        for row in finger.links:
            centres, sizes = inner_balls(hand, row)
            points.append(poses.apply(frames[hand.link_names[row]], centres))
            radii.append(sizes)
            names += [finger.sensor] * len(sizes)
    if not names:
        return None
    return EmptyRegions(np.concatenate(points), np.concatenate(radii), names)


@lru_cache(maxsize=256)
def inner_balls(hand: Hand, row: int) -> tuple[Array, Array]:
    """Centres (k, 3) in the link's frame and radii (k,) of a few balls that together fill most of a link."""
    from scenes._open3d import open3d

    o3d = open3d()
    centres, radii = [], []
    for shape in hand.robot.links[hand.link_names[row]]:
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            o3d.core.Tensor(shape.vertices.astype(np.float32)), o3d.core.Tensor(shape.faces.astype(np.uint32))
        )
        low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
        steps = [np.arange(a, b, max(BALL_GRID, (b - a) / 60)) for a, b in zip(low, high)]
        grid = np.stack([g.ravel() for g in np.meshgrid(*steps, indexing="ij")], axis=1)
        room = -scene.compute_signed_distance(o3d.core.Tensor(grid.astype(np.float32))).numpy().astype(np.float64)
        for _ in range(BALLS_PER_LINK):
            best = int(np.argmax(room))
            if room[best] < SMALLEST_BALL:
                break
            centres.append(grid[best])
            radii.append(room[best])
            room[np.linalg.norm(grid - grid[best], axis=1) < room[best]] = 0.0
    return np.array(centres).reshape(-1, 3), np.array(radii)
