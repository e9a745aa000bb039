"""Whole recordings of an object in a hand, or behind other things, hidden by the asked share, with ground truth.

The camera frame is the world frame. The picture, the object and the true hand agree exactly; what the robot reports
(joints, hand pose, contacts, wrenches, pressures) passes through its errors: measured joints, then the error of the
camera-robot calibration, which moves hand and contacts alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.depth_cameras import DEPTH_CAMERAS
from scenes.recordings.frames import Contacts, EmptyRegions, Frame, GelImage, Wrench
from scenes.synthesis.grasping.hiding import Placement, place
from scenes.synthesis.noise import presets as noise_models
from scenes.synthesis.noise.presets import LastingErrors, NoisePreset
from scenes.synthesis.photography import photograph, smeared
from scenes.synthesis.settings import SynthesisSettings
from scenes.synthesis.staging.loose_fingers import object_renderer, random_contacts
from scenes.synthesis.staging.mesh_errors import believed
from scenes.synthesis.staging.mounts import hand_mesh
from scenes.synthesis.staging.pieces import Staging, staged
from scenes.synthesis.staging.prints import printed, with_print
from scenes.synthesis.staging.standing import STANDING, Stage
from scenes.threads import thread_count

if TYPE_CHECKING:
    from scenes.recordings.captures import Capture
    from scenes.robot.hands import Hand
    from scenes.synthesis.grasping.grasps import Grasp
    from scenes.synthesis.motion import MotionSettings, MotionStep

__all__ = ["OCCLUDERS", "TOUCH_KINDS", "SynthesisSettings", "synthesize", "synthesize_frames"]

Array = NDArray[np.float64]

TOUCH_KINDS = ("point", "wrench", "array", "gel", "empty")
OCCLUDERS = ("hand", "border", *STANDING)
CLUTTER = "clutter"
# The share that is hidden where nobody asks for one.
OCCLUSION = 0.6


def synthesize(
    folder: str | Path,
    model: ObjectModel,
    hand: Hand | None = None,
    frames: int = 1,
    occlusion: float | None = None,
    touch: tuple[str, ...] = ("point",),
    noise: str | NoisePreset = "lab",
    seed: int = 0,
    occluders: str | None = None,
    settings: SynthesisSettings | None = None,
    motion: str | None = None,
    taxels: str | Array = "fingertip",
    scene: str | Staging | None = None,
    mesh_error: str | None = None,
    placement: Placement | None = None,
) -> Capture:
    """Make frames as `synthesize_frames` does, write them as a capture, and read it back.

    mesh_error: the capture's model is not quite the object that is seen and felt (see staging.mesh_errors). placement:
    of several sequences, so that their grasp is planned once; None to draw this one's own. Raises InputError as
    `synthesize_frames`, CaptureError when the folder cannot be written.
    """
    from scenes.recordings.captures import read_capture, write_capture

    settings = settings or SynthesisSettings()
    recording = _Recording(model, hand, occlusion, touch, noise, seed, occluders, settings, taxels, scene)
    recording.placement = placement
    given = believed(model, mesh_error, seed)
    given = with_print(given) if recording.staging.printed else given
    named = noise_models.preset(noise).name
    notes = {"object": model.name, "occlusion": recording.occlusion, "noise": named, "touch": list(touch), "seed": seed}
    notes |= {"occluders": recording.occluders} if occluders else {}
    notes |= {"scene": recording.staging.name} if recording.staging.name else {}
    notes |= {"mesh_error": mesh_error} if mesh_error else {}
    made = (replace(frame, beliefs=_told(noise)) for frame in recording.frames(frames, motion))
    notes |= {"motion": recording.motion_notes} if motion else {}
    # of a hand that no frame has nobody tells
    told = recording.hand if recording.kind == "hand" and recording.staging.hand_known else None
    # a camera that moves is in a world that does not
    world = "robot base" if motion == "camera" else "camera"
    write_capture(folder, made, given, hand=told, world=world, depth_scale=settings.depth_unit * 1e3, notes=notes)
    return read_capture(folder)


def _told(noise: str | NoisePreset) -> Beliefs | None:
    """What a capture says of its camera: its name, where one can buy it; nobody tells which errors were drawn."""
    name = noise_models.preset(noise).name
    return Beliefs(depth=DEPTH_CAMERAS[name]) if name in DEPTH_CAMERAS else None


def synthesize_frames(
    model: ObjectModel,
    hand: Hand | None = None,
    frames: int = 1,
    occlusion: float | None = None,
    touch: tuple[str, ...] = ("point",),
    noise: str | NoisePreset = "lab",
    seed: int = 0,
    occluders: str | None = None,
    settings: SynthesisSettings | None = None,
    motion: str | None = None,
    taxels: str | Array = "fingertip",
    scene: str | Staging | None = None,
) -> list[Frame]:
    """Frames of one object; nothing touches the disk.

    Without a `motion` they are independent: another grasp, view and draw of the noise each, and frame i depends on seed
    and i only. With one ("carry", "turn", "slip", "slide", "regrasp", "leave", "close", "shake", "camera", "pick",
    "put"; see scenes.synthesis.motion) one grasp is recorded at 30 frames a second by one camera and robot with their
    lasting errors; the asked occlusion is that of the closed hand in the first frame, which alone has a prior.

    occlusion: share (0 to 1) of the object's own in-image pixels that something hides, held within 0.03; default 0.6,
    and 0 with occluders "none".
    occluders: "hand" (grasping, forearm included), "fingers" (loose ones that no frame tells of), "object" (a second
    one), "neighbours" (others that touch it, on a table), "border" (the image ends before the object does) or "none";
    by default the hand when there is one, else loose fingers. "+clutter" after it lets other things stand about. scene:
    pieces joined by "+" (see staging.pieces): "table", "wall", "adapter", "print", "unknown-hand". touch: "point" gives
    contacts, "wrench" wrenches of the fingertips, "array" pressures of taxels (`taxels`: "fingertip" of 12, "pad" of
    3 x 8, or (k, 6) of one's own), "empty" the regions where fingers feel nothing. Raises InputError for arguments out
    of range and for an occlusion that cannot be reached, with what could be.
    """
    settings = settings or SynthesisSettings()
    recording = _Recording(model, hand, occlusion, touch, noise, seed, occluders, settings, taxels, scene)
    return list(recording.frames(frames, motion))


class _Recording:
    """The arguments of `synthesize_frames`, checked, and what all frames share."""

    def __init__(
        self,
        model: ObjectModel,
        hand: Hand | None,
        occlusion: float | None,
        touch: tuple[str, ...],
        noise: str | NoisePreset,
        seed: int,
        occluders: str | None,
        settings: SynthesisSettings,
        taxels: str | Array,
        scene: str | Staging | None,
    ) -> None:
        self.model, self.hand, self.touch = model, hand, touch
        self.preset = noise_models.preset(noise)
        self.seed, self.settings = seed, settings
        self.occluders = occluders or ("hand" if hand is not None else "fingers")
        self.kind, _, extra = self.occluders.partition("+")
        self.clutter = extra == CLUTTER
        if extra not in ("", CLUTTER) or self.kind not in OCCLUDERS:
            names = ", ".join(OCCLUDERS)
            raise InputError(f"occluders: expected one of {names}, or with +{CLUTTER}, got {self.occluders!r}")
        self.staging = staged(scene)
        self.occlusion = (0.0 if self.kind == "none" else OCCLUSION) if occlusion is None else occlusion
        _check(hand, self.occlusion, touch, self.kind, self.staging)
        if "array" in touch and hand is not None and not any(s.kind == "array" for s in hand.sensors.values()):
            from scenes.robot.tactile import with_arrays

            self.hand = with_arrays(hand, taxels)
        if "gel" in touch and hand is not None and not any(s.kind == "gel" for s in hand.sensors.values()):
            from scenes.synthesis.gels import with_gels

            self.hand = with_gels(self.hand or hand, seed)
        self.renderer = object_renderer(model).copy()
        self.stage = Stage(self.renderer, model, settings, self.staging)
        self.motion_notes: dict[str, Any] = {}
        self.placement: Placement | None = None

    def frames(self, count: int, motion: str | None, settings: MotionSettings | None = None) -> Iterator[Frame]:
        """All frames, made as they are asked for."""
        if count < 1:
            raise InputError(f"frames: expected at least 1, got {count}")
        if motion is not None:
            return self._sequence(count, motion, settings)
        return self._independent(count)

    def _independent(self, count: int) -> Iterator[Frame]:
        children = np.random.SeedSequence(self.seed).spawn(count + 1)
        errors = self._lasting(np.random.default_rng(children[count])) if self.settings.one_robot else None
        for index, child in enumerate(children[:count]):
            rng = np.random.default_rng(child)
            if self.kind == "hand":
                assert self.hand is not None
                grasp, camera_from_hand = self._placed(rng)
                yield self._delivered(self._held(index, grasp, camera_from_hand, rng, errors))
            else:
                yield self._delivered(self._loose(index, rng, errors))

    def _delivered(self, frame: Frame) -> Frame:
        recorder = self.preset.recorder
        return frame if recorder is None else recorder.recorded(frame)

    def _placed(self, rng: np.random.Generator) -> tuple[Grasp, Array]:
        assert self.hand is not None
        mounted = self.staging.adapter
        return place(self.model, self.hand, self.occlusion, rng, self.renderer, self.settings, mounted)

    def _sequence(self, count: int, motion: str, settings: MotionSettings | None) -> Iterator[Frame]:
        from scenes.synthesis.motion import plan_motion

        if self.kind != "hand" or self.hand is None:
            raise InputError(f"motion: expected a hand that carries the object, got occluders {self.occluders!r}")
        plan, *children = np.random.SeedSequence(self.seed).spawn(count + 1)
        rng = np.random.default_rng(plan)
        shared = self.placement
        grasp, camera_from_hand = self._placed(rng) if shared is None else shared.placed(self._placed)
        camera = self.settings.camera
        steps, self.motion_notes = plan_motion(
            motion, count, grasp, camera_from_hand, self.hand, self.model, camera, rng, settings
        )
        scene = self._scene(grasp, camera_from_hand)
        corners = [self.renderer.vertices("hand", step.camera_from_hand) for step in steps[:: max(1, count // 20)]]
        around = self.stage.around(scene, rng, tuple(corners))
        if self.clutter:
            around |= self._stand_about({**scene, **around}, rng)
        return self._recorded(steps, children, self._drifting(count, rng), around, int(rng.integers(2**31)))

    def _drifting(self, count: int, rng: np.random.Generator) -> list[LastingErrors]:
        """The lasting errors of each frame."""
        errors = [self._lasting(rng)]
        while len(errors) < count:
            errors.append(errors[-1].drifted(self.preset.touch, rng))
        return errors

    def _recorded(
        self,
        steps: list[MotionStep],
        children: list[np.random.SeedSequence],
        errors: list[LastingErrors],
        around: dict[str, Array],
        forces_seed: int,
    ) -> Iterator[Frame]:
        """Frames of one posture of the hand do not depend on one another: each thread makes one."""

        def make(index: int) -> Frame:
            rng, step = np.random.default_rng(children[index]), steps[index]
            seen = {name: step.camera_from_world @ pose for name, pose in around.items()}
            frame = self._held(
                index, step.grasp, step.camera_from_hand, rng, errors[index], seen, forces_seed, step.smear
            )
            frame = self._delivered(in_world(frame, step.camera_from_world))
            return frame if index == 0 else replace(frame, prior=None)

        threads = thread_count()
        with ThreadPoolExecutor(threads) as pool:
            begin = 0
            while begin < len(steps):
                grasp = steps[begin].grasp
                self._scene(grasp, steps[begin].camera_from_hand)
                end = begin + 1
                while end < len(steps) and end - begin < 2 * threads and steps[end].grasp is grasp:
                    end += 1
                yield from pool.map(make, range(begin, end))
                begin = end

    def _lasting(self, rng: np.random.Generator) -> LastingErrors:
        hand = self.hand
        joints = [] if hand is None else hand.joint_names
        sensors = [] if hand is None else list(hand.sensors)
        return noise_models.draw_lasting_errors(self.preset, self.settings.camera, joints, sensors, rng)

    def _scene(self, grasp: Grasp, camera_from_hand: Array) -> dict[str, Array]:
        """camera_from_mesh of object and hand; the renderer's hand takes the grasp's posture."""
        assert self.hand is not None
        self.renderer.add("hand", *hand_mesh(self.hand, grasp.joints, self.staging.adapter))
        return {"object": camera_from_hand @ grasp.hand_from_object, "hand": camera_from_hand}

    def _stand_about(self, scene: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
        from scenes.synthesis.staging.clutter import stand_about

        return stand_about(self.renderer, scene, self.settings.camera, rng, self.settings)

    def _image(
        self,
        scene: dict[str, Array],
        rng: np.random.Generator,
        errors: LastingErrors | None,
        around: dict[str, Array] | None,
    ) -> dict[str, Any]:
        if around is None:
            around = self.stage.around(scene, rng)
            if self.clutter:
                around |= self._stand_about({**scene, **around}, rng)
        whole = {**scene, **around}
        image = photograph(whole, self.renderer, self.preset, rng, self.settings, errors)
        # ink is nearly clear in infra-red light, which cameras imitated from their optics deliver
        if self.staging.printed and "rgb" in image and isinstance(self.preset.depth, noise_models.DepthNoise):
            image["rgb"] = printed(image["rgb"], whole, self.renderer, self.settings.camera, self.model)
        return image

    def _held(
        self,
        index: int,
        grasp: Grasp,
        camera_from_hand: Array,
        rng: np.random.Generator,
        errors: LastingErrors | None = None,
        around: dict[str, Array] | None = None,
        forces_seed: int | None = None,
        smear: Array | None = None,
    ) -> Frame:
        from scenes.synthesis import touch as feel

        hand, preset, settings = self.hand, self.preset, self.settings
        assert hand is not None
        camera_from_object = camera_from_hand @ grasp.hand_from_object
        scene = {"object": camera_from_object, "hand": camera_from_hand}
        image = self._image(scene, rng, errors, around)
        if smear is not None:
            after = {name: smear @ pose for name, pose in scene.items()}
            image = smeared(image, self._image(after, rng, errors, around), rng)
        turning = feel.turning(hand, grasp.joints)
        if errors is None:
            joints = {**grasp.joints, **noise_models.observe_joints(turning, preset.robot, rng)}
            error = noise_models.camera_from_robot_error(preset.robot, rng)
        else:
            joints = {**grasp.joints, **{name: x + errors.joints.get(name, 0.0) for name, x in turning.items()}}
            error = errors.camera_from_robot
        world_from_hand = error @ camera_from_hand
        contacts, tactile, empty = Contacts(np.zeros((0, 3))), {}, None
        wrenches: tuple[Wrench, ...] = ()
        if "wrench" in self.touch or "array" in self.touch:
            same = rng if forces_seed is None else np.random.default_rng(forces_seed)
            forces = feel.press_forces(grasp, same, settings)
            if "wrench" in self.touch:
                wrenches = feel.wrenches(hand, grasp, forces, preset, rng, settings, errors)
            if "array" in self.touch:
                dead = None if forces_seed is None else feel.draw_dead(hand, preset, np.random.default_rng(forces_seed))
                tactile = feel.pressures(hand, self.model, grasp, forces, preset, rng, dead)
        if "point" in self.touch:
            own = np.random.default_rng([self.seed, index, 19])  # as with gels, below
            count, reach = settings.contacts_a_finger, settings.skin_reach
            skins = feel.felt_by_skins(self.model, grasp, count, reach, own)
            exact = feel.carried(hand, replace(grasp, contacts=skins), joints)
            contacts = noise_models.observe_contacts(exact, preset.touch, rng, errors).moved(world_from_hand)
        gels: dict[str, GelImage] = {}
        if "gel" in self.touch:
            from scenes.synthesis.gels import feel_gels

            # noise of its own: asking for gels changes nothing else of a frame
            own = np.random.default_rng([self.seed, index, 17])
            gels = feel_gels(hand, self.model, grasp.hand_from_object, grasp.joints, own)
        if "empty" in self.touch:
            empty = _moved(feel.empty_regions(hand, grasp, joints), world_from_hand)
        frame = Frame(
            index=index,
            where=f"synthetic {self.model.name}, frame {index}",
            camera=settings.camera,
            hand=hand,
            joints=joints,
            world_from_hand=world_from_hand,
            contacts=contacts,
            wrenches=wrenches,
            tactile=tactile,
            gels=gels,
            no_contact=empty,
            prior=self._prior(camera_from_object, rng),
            camera_from_object_truth=camera_from_object,
            hand_from_object_truth=grasp.hand_from_object,
            **image,
        )
        if self.staging.hand_known:
            return frame
        return replace(frame, hand=None, joints=None, world_from_hand=None, hand_from_object_truth=None)

    def _loose(self, index: int, rng: np.random.Generator, errors: LastingErrors | None) -> Frame:
        model, settings = self.model, self.settings
        scene = self.stage.stand(self.kind, self.occlusion, rng)
        image = self._image(scene, rng, errors, None)
        shift = noise_models.camera_from_robot_error(self.preset.robot, rng)
        shift = shift if errors is None else errors.camera_from_robot
        count = settings.loose_contacts if "point" in self.touch else 0
        exact = random_contacts(model, count, rng).moved(scene["object"])
        return Frame(
            index=index,
            where=f"synthetic {model.name}, frame {index}",
            camera=settings.camera,
            contacts=noise_models.observe_contacts(exact, self.preset.touch, rng, errors).moved(shift),
            prior=self._prior(scene["object"], rng),
            camera_from_object_truth=scene["object"],
            **image,
        )

    def _prior(self, truth: Array, rng: np.random.Generator) -> Array:
        settings = self.settings
        return poses.displaced(truth, settings.prior_angle, settings.prior_distance, self.model.centroid, rng)


def in_world(frame: Frame, camera_from_world: Array) -> Frame:
    """A frame whose world was its camera, told in a world from which the camera has moved (4, 4)."""
    if np.array_equal(camera_from_world, np.eye(4)):
        return frame
    world = poses.inverse(camera_from_world)
    return replace(
        frame,
        camera_from_world=camera_from_world,
        world_from_hand=None if frame.world_from_hand is None else world @ frame.world_from_hand,
        contacts=frame.contacts.moved(world),
        no_contact=_moved(frame.no_contact, world),
    )


def _moved(regions: EmptyRegions | None, world_from_hand: Array) -> EmptyRegions | None:
    if regions is None:
        return None
    return replace(regions, points=poses.apply(world_from_hand, regions.points))


def _check(hand: Hand | None, occlusion: float, touch: tuple[str, ...], kind: str, staging: Staging) -> None:
    if kind == "hand" and hand is None:
        raise InputError("occluders: expected a hand to hide the object with, got none")
    if not 0.0 <= occlusion <= 0.97:
        raise InputError(f"occlusion: expected a share from 0 to 0.97, got {occlusion}")
    if kind == "none" and occlusion:
        raise InputError(f"occlusion: expected 0 without occluders, got {occlusion}: nothing hides the object")
    unknown = [name for name in touch if name not in TOUCH_KINDS]
    if unknown:
        raise InputError(f"touch: expected kinds among {', '.join(TOUCH_KINDS)}, got {unknown[0]!r}")
    if kind == "neighbours" and not staging.table:
        raise InputError("occluders: expected a scene with a table for neighbours to stand on, got none")
    if kind != "hand" and (staging.adapter or not staging.hand_known):
        piece = "adapter" if staging.adapter else "unknown-hand"
        raise InputError(f"scene: expected a hand that grasps for {piece!r}, got occluders {kind!r}")
    needs = [name for name in touch if name != "point"]
    if needs and (hand is None or kind != "hand" or not staging.hand_known):
        raise InputError(f"touch: expected a hand whose fingertips measure for {needs[0]!r}, got none")
