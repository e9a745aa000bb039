"""Whole recordings of an object in a hand (or behind loose fingers), hidden by the asked share, with ground truth.

The camera frame is the world frame. The picture, the object and the true hand agree exactly; what the robot reports
(joints, hand pose, contacts, wrenches) passes through its errors: measured joints, then the error of the
camera-robot calibration, which moves hand and contacts alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenes import noise as noise_models
from scenes import poses
from scenes.cameras import Camera
from scenes.errors import InputError
from scenes.frames import Contacts, Frame, Wrench
from scenes.loose_fingers import LooseFingerSettings, lay_fingers, random_contacts
from scenes.noise import NoisePreset
from scenes.objects import ObjectModel
from scenes.rendering import Renderer, shade
from scenes.viewpoints import ViewSettings, draw_views, find_view

if TYPE_CHECKING:
    from scenes.captures import Capture
    from scenes.grasping import Grasp
    from scenes.hands import Hand

Array = NDArray[np.float64]

TOUCH_KINDS = ("point", "wrench", "array")
OCCLUDERS = ("hand", "fingers", "none")
# Below this hidden share the later grasps tried are those of three fingers (no unit).
FEW_FINGERS_BELOW = 0.35
COLOURS = {"object": (206, 116, 58), "hand": (222, 186, 164), "background": (138, 142, 146)}
FINGER_COLOUR = (196, 160, 140)


@dataclass(frozen=True)
class SynthesisSettings:
    """What is the same in every frame. Metres, radians, newtons."""

    # A VGA structured-light camera.
    camera: Camera = field(default_factory=lambda: Camera(570.0, 570.0, 319.5, 239.5, 640, 480))
    views: ViewSettings = field(default_factory=ViewSettings)
    fingers: LooseFingerSettings = field(default_factory=LooseFingerSettings)
    # Grasps tried, each with its own views, before the asked occlusion is called out of reach.
    grasps: int = 9
    # What hides the object may come this near to the camera (shares of the object's distance, see ViewSettings): the
    # later ones only after `relax_after` grasps did not reach the asked occlusion with the first.
    foregrounds: tuple[float, ...] = (0.7, 0.5, 0.1)
    relax_after: int = 3
    # A wall or table: distance behind the object's centre (m), and largest angle from facing the camera.
    background: bool = True
    background_distance: tuple[float, float] = (0.3, 1.0)
    background_tilt: float = float(np.deg2rad(35.0))
    # The prior is the truth turned and moved by exactly this much (T1 section 4.3).
    prior_angle: float = float(np.deg2rad(16.0))
    prior_distance: float = 0.033
    # Contacts drawn on the object when there is no hand.
    loose_contacts: int = 5
    # Forces of a grasp (N), friction coefficient, and the share of the friction cone that is used.
    force: tuple[float, float] = (1.0, 5.0)
    friction: float = 0.5
    friction_used: float = 0.8
    # Depth images are stored in steps of this (m); frames in memory are rounded alike.
    depth_unit: float = 1e-4
    # Write the true visible pixels as the object's mask, and a colour image.
    mask: bool = False
    rgb: bool = True


def synthesize(
    folder: str | Path,
    model: ObjectModel,
    hand: Hand | None = None,
    frames: int = 1,
    occlusion: float = 0.6,
    touch: tuple[str, ...] = ("point",),
    noise: str | NoisePreset = "lab",
    seed: int = 0,
    occluders: str | None = None,
    settings: SynthesisSettings | None = None,
) -> Capture:
    """Make frames as `synthesize_frames` does, write them as a capture, and read it back.

    Raises InputError as `synthesize_frames`, CaptureError when the folder cannot be written.
    """
    from scenes.captures import read_capture, write_capture

    settings = settings or SynthesisSettings()
    made = synthesize_frames(model, hand, frames, occlusion, touch, noise, seed, occluders, settings)
    named = noise_models.preset(noise).name
    notes = {"object": model.name, "occlusion": occlusion, "noise": named, "touch": list(touch), "seed": seed}
    write_capture(folder, made, model, hand=hand, depth_scale=settings.depth_unit * 1e3, notes=notes)
    return read_capture(folder)


def synthesize_frames(
    model: ObjectModel,
    hand: Hand | None = None,
    frames: int = 1,
    occlusion: float = 0.6,
    touch: tuple[str, ...] = ("point",),
    noise: str | NoisePreset = "lab",
    seed: int = 0,
    occluders: str | None = None,
    settings: SynthesisSettings | None = None,
) -> list[Frame]:
    """Independent frames of one object: another grasp, view and draw of the noise each. Nothing touches the disk.

    occlusion: share (0 to 1) of the object's own in-image pixels that something hides, held within 0.03.
    occluders: "hand" (grasping, forearm included), "fingers" (loose ones that no frame tells of) or "none"; by default
    the hand when there is one, else loose fingers. touch: "point" gives contacts, "wrench" wrenches of spherical
    fingertips. Frame i depends on seed and i only. Raises InputError for arguments out of range and for an occlusion
    that cannot be reached, with what could be.
    """
    settings = settings or SynthesisSettings()
    preset = noise_models.preset(noise)
    kind = occluders or ("hand" if hand is not None else "fingers")
    _check(hand, frames, occlusion, touch, kind)
    renderer = Renderer({"object": (model.vertices, model.faces)})
    made = []
    for index, child in enumerate(np.random.SeedSequence(seed).spawn(frames)):
        rng = np.random.default_rng(child)
        where = f"synthetic {model.name}, frame {index}"
        if kind == "hand":
            assert hand is not None
            frame = _hand_frame(index, where, model, hand, occlusion, touch, preset, rng, renderer, settings)
        else:
            share = occlusion if kind == "fingers" else 0.0
            frame = _loose_frame(index, where, model, share, touch, preset, rng, renderer, settings)
        made.append(frame)
    return made


def _check(hand: Hand | None, frames: int, occlusion: float, touch: tuple[str, ...], kind: str) -> None:
    if kind not in OCCLUDERS:
        raise InputError(f"occluders: expected one of {', '.join(OCCLUDERS)}, got {kind!r}")
    if kind == "hand" and hand is None:
        raise InputError("occluders: expected a hand to hide the object with, got none")
    if frames < 1:
        raise InputError(f"frames: expected at least 1, got {frames}")
    if not 0.0 <= occlusion <= 0.97:
        raise InputError(f"occlusion: expected a share from 0 to 0.97, got {occlusion}")
    unknown = [name for name in touch if name not in TOUCH_KINDS]
    if unknown:
        raise InputError(f"touch: expected kinds among {', '.join(TOUCH_KINDS)}, got {unknown[0]!r}")
    if "array" in touch:
        raise InputError("touch: expected point or wrench, got 'array': tactile arrays cannot be synthesised yet")
    if "wrench" in touch and hand is None:
        raise InputError("touch: expected a hand whose fingertips measure wrenches, got none")


def _hand_frame(
    index: int,
    where: str,
    model: ObjectModel,
    hand: Hand,
    occlusion: float,
    touch: tuple[str, ...],
    preset: NoisePreset,
    rng: np.random.Generator,
    renderer: Renderer,
    settings: SynthesisSettings,
) -> Frame:
    grasp, camera_from_hand = _place(model, hand, occlusion, rng, renderer, settings)
    camera_from_object = camera_from_hand @ grasp.hand_from_object
    scene = {"object": camera_from_object, "hand": camera_from_hand}
    image = _photograph(model, scene, renderer, preset, rng, settings)

    joints = noise_models.observe_joints(_turning(hand, grasp.joints), preset.robot, rng)
    joints = {**grasp.joints, **joints}
    error = noise_models.camera_from_robot_error(preset.robot, rng)
    world_from_hand = error @ camera_from_hand
    contacts = _carried(hand, grasp, joints)
    wrenches: tuple[Wrench, ...] = ()
    if "wrench" in touch:
        wrenches = _wrenches(hand, grasp, preset, rng, settings)
    if "point" in touch:
        contacts = noise_models.observe_contacts(contacts, preset.touch, rng).moved(world_from_hand)
    else:
        contacts = Contacts(np.zeros((0, 3)))
    return Frame(
        index=index,
        where=where,
        camera=settings.camera,
        hand=hand,
        joints=joints,
        world_from_hand=world_from_hand,
        contacts=contacts,
        wrenches=wrenches,
        prior=_prior(model, camera_from_object, rng, settings),
        camera_from_object_truth=camera_from_object,
        **image,
    )


def _place(
    model: ObjectModel,
    hand: Hand,
    occlusion: float,
    rng: np.random.Generator,
    renderer: Renderer,
    settings: SynthesisSettings,
) -> tuple[Grasp, Array]:
    """A grasp and camera_from_hand at which the hand hides the asked share of the object."""
    from scenes.grasping import plan_grasp

    reached: list[float] = []
    held: list[Grasp] = []
    refusal: InputError | None = None
    for attempt in range(settings.grasps):
        # Whole-hand grasps touch with most fingers; those of few fingers hide less
        kind = "tripod" if occlusion < FEW_FINGERS_BELOW and attempt >= settings.grasps // 2 else "power"
        try:
            held.append(plan_grasp(hand, model, seed=int(rng.integers(2**31)), kind=kind))
        except InputError as error:
            refusal = error
            continue
        # Planning costs more than looking: after a few grasps, the same ones from closer along the arm
        last = len(held) % settings.relax_after == 0 or attempt == settings.grasps - 1
        trials = [(held[-1], settings.foregrounds[0])]
        if last:
            trials += [(g, f) for f in settings.foregrounds[1:] for g in held[-settings.relax_after :]]
        for grasp, foreground in trials:
            vertices, faces, _ = hand.mesh(grasp.joints)
            renderer.add("hand", vertices, faces)
            scene = {"object": grasp.hand_from_object, "hand": np.eye(4)}
            target = poses.apply(grasp.hand_from_object, model.centroid[None])[0]
            views = replace(settings.views, foreground=foreground)
            view, shares = find_view(
                renderer, scene, "object", target, model.radius, occlusion, settings.camera, rng, views
            )
            if view is not None:
                return grasp, view
            reached += shares
    if not reached and refusal is not None:
        raise refusal
    span = f"{min(reached):.2f} to {max(reached):.2f}" if reached else "none"
    raise InputError(
        f"occlusion: expected a share of {model.name!r} that hand {hand.name!r} can hide, got {occlusion:.2f};"
        f" {len(held)} grasps reached {span}"
    )


def _turning(hand: Hand, joints: dict[str, float]) -> dict[str, float]:
    """The joints measured in radians: sliding ones are left out of the angular noise."""
    sliding = {joint.name for joint in hand.robot.joints if joint.kind == "prismatic"}
    return {name: value for name, value in joints.items() if name not in sliding}


def _carried(hand: Hand, grasp: Grasp, measured: dict[str, float]) -> Contacts:
    """The exact contacts where the measured joints would put them: each is fixed to its sensor's link. Hand frame."""
    true_poses = hand.forward_kinematics(grasp.joints)
    seen_poses = hand.forward_kinematics(measured)
    parts = []
    for row, name in enumerate(grasp.contacts.sensors):
        link = hand.sensors[name].link
        parts.append(grasp.contacts.take([row]).moved(seen_poses[link] @ poses.inverse(true_poses[link])))
    return Contacts.concatenate(parts)


def _wrenches(
    hand: Hand, grasp: Grasp, preset: NoisePreset, rng: np.random.Generator, settings: SynthesisSettings
) -> tuple[Wrench, ...]:
    """What the fingertips' force/torque sensors feel: the force of the object on the fingertip, sensor frame.

    It pushes into the fingertip, along the object's outward normal, with friction inside the cone; torque = p x f
    about the sensor's origin. A sensor with several contacts feels their sum.
    """
    frames = hand.hand_from_sensor(grasp.joints)
    total: dict[str, Array] = {}
    for row, name in enumerate(grasp.contacts.sensors):
        local = grasp.contacts.take([row]).moved(poses.inverse(frames[name]))
        point, normal = local.points[0], local.normals[0]
        pressing = rng.uniform(*settings.force)
        across = np.cross(normal, poses.random_unit_vectors(1, rng)[0])
        across /= np.linalg.norm(across)
        slip = rng.uniform(0.0, settings.friction_used) * settings.friction * pressing
        force = pressing * normal + slip * across
        wrench = np.concatenate([force, np.cross(point, force)])
        total[name] = total.get(name, np.zeros(6)) + wrench
    out = []
    for name, wrench in total.items():
        sigma = preset.touch.wrench * np.repeat([np.abs(wrench[:3]).max(), np.abs(wrench[3:]).max()], 3)
        measured = wrench + sigma * rng.normal(size=6)
        out.append(Wrench(name, measured[:3], measured[3:]))
    return tuple(out)


def _loose_frame(
    index: int,
    where: str,
    model: ObjectModel,
    occlusion: float,
    touch: tuple[str, ...],
    preset: NoisePreset,
    rng: np.random.Generator,
    renderer: Renderer,
    settings: SynthesisSettings,
) -> Frame:
    refusal: InputError | None = None
    for view in draw_views(settings.grasps, settings.camera, model.radius, rng, settings.views):
        camera_from_object = view.camera_from_scene(model.centroid)
        try:
            fingers = lay_fingers(
                renderer, "object", camera_from_object, occlusion, settings.camera, rng, settings.fingers
            )
            break
        except InputError as error:
            refusal = error
    else:
        raise refusal or InputError("occlusion: expected at least one view to be tried")
    scene = {"object": camera_from_object, **fingers}
    image = _photograph(model, scene, renderer, preset, rng, settings)
    shift = noise_models.camera_from_robot_error(preset.robot, rng)
    count = settings.loose_contacts if "point" in touch else 0
    exact = random_contacts(model, count, rng).moved(camera_from_object)
    return Frame(
        index=index,
        where=where,
        camera=settings.camera,
        contacts=noise_models.observe_contacts(exact, preset.touch, rng).moved(shift),
        prior=_prior(model, camera_from_object, rng, settings),
        camera_from_object_truth=camera_from_object,
        **image,
    )


def _prior(model: ObjectModel, truth: Array, rng: np.random.Generator, settings: SynthesisSettings) -> Array:
    return poses.displaced(truth, settings.prior_angle, settings.prior_distance, model.centroid, rng)


def _photograph(
    model: ObjectModel,
    scene: dict[str, Array],
    renderer: Renderer,
    preset: NoisePreset,
    rng: np.random.Generator,
    settings: SynthesisSettings,
) -> dict[str, Any]:
    """depth, and rgb and mask when asked for, of a scene of camera_from_mesh poses."""
    seen = dict(scene)
    if settings.background:
        seen["background"] = _background(model, scene, renderer, rng, settings)
    rendering = renderer.render(settings.camera, seen)
    depth = noise_models.observe_depth(rendering, settings.camera, preset, rng)
    depth = np.where(depth < settings.depth_unit * np.iinfo(np.uint16).max, depth, 0.0)  # what 16 bits can hold
    image: dict[str, Any] = {"depth": (np.rint(depth / settings.depth_unit) * settings.depth_unit).astype(np.float32)}
    if settings.mask:
        image["mask"] = rendering.mask("object")
    if settings.rgb:
        image["rgb"] = shade(rendering, {name: COLOURS.get(name, FINGER_COLOUR) for name in seen})
    return image


def _background(
    model: ObjectModel,
    scene: dict[str, Array],
    renderer: Renderer,
    rng: np.random.Generator,
    settings: SynthesisSettings,
) -> Array:
    """Add a wide wall behind object and hand; returns its camera_from_mesh."""
    centre = poses.apply(scene["object"], model.centroid[None])[0]
    turn = rng.uniform(0.0, 2 * np.pi)
    tilt = settings.background_tilt * np.sqrt(rng.uniform())
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    # Far enough for nothing to stick into it
    behind = min(float((renderer.vertices(name, pose) @ normal).min()) for name, pose in scene.items())
    gap = rng.uniform(*settings.background_distance)
    level = min(float(centre @ normal) - gap * float(np.cos(tilt)), behind - 0.01)
    place = centre * (level / float(centre @ normal))
    right = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    right /= np.linalg.norm(right)
    size = 30.0  # m: fills the image at any tilt allowed
    corners = size * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    renderer.add("background", corners, [[0, 1, 2], [0, 2, 3]])
    return poses.make_pose(np.stack([right, np.cross(normal, right), normal], axis=1), place)
