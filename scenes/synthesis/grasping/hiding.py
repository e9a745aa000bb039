"""A grasp, and a camera to see it from, with the object hidden by just so much."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.objects import ObjectModel
from scenes.robot.fingers import find_fingers
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.grasps import Grasp, plan_grasp
from scenes.synthesis.grasping.gripping import has_flat_pads, plan_grip
from scenes.synthesis.grasping.placement import is_gripper
from scenes.synthesis.settings import SynthesisSettings
from scenes.synthesis.staging.mounts import hand_mesh
from scenes.synthesis.staging.views import find_view

Array = NDArray[np.float64]

# Below this hidden share the later grasps tried are those of three fingers (no unit).
FEW_FINGERS_BELOW = 0.35
# Draws of a placement that several sequences share, before all of them are refused.
MOST_DRAWS = 3


class Placement:
    """A grasp and a view of it, found once for several sequences of one object, hand, hidden share, scene and settings:
    to plan a grasp takes longer than to make a sequence's frames. Its draws are its own, so that all else is drawn anew
    in each sequence.
    """

    def __init__(self, seed: int) -> None:
        """seed: of its draws."""
        self.seed = seed
        self._found: tuple[Grasp, Array] | None = None
        self._left = MOST_DRAWS
        self._refusal = InputError("a placement: nothing was drawn")

    def placed(self, find: Callable[[np.random.Generator], tuple[Grasp, Array]]) -> tuple[Grasp, Array]:
        """What find makes of the draws, or has made of them before. Raises its InputError, each time, where none of a
        few draws hides as much as is asked.
        """
        while self._found is None and self._left:
            self._draw(find)
        if self._found is None:
            raise self._refusal
        return self._found

    def _draw(self, find: Callable[[np.random.Generator], tuple[Grasp, Array]]) -> None:
        try:
            self._found = find(np.random.default_rng([self.seed, self._left]))
        except InputError as error:
            self._refusal, self._left = error, self._left - 1


def place(
    model: ObjectModel,
    hand: Hand,
    occlusion: float,
    rng: np.random.Generator,
    renderer: Renderer,
    settings: SynthesisSettings,
    mounted: bool = False,
) -> tuple[Grasp, Array]:
    """A grasp and camera_from_hand (4, 4) at which the hand hides the asked share of the object's own pixels.

    renderer: holds the mesh "object"; gets the hand's, with the parts that its model lacks when mounted. Raises
    InputError when nothing tried hides as much, with the range that was reached.
    """
    reached: list[float] = []
    held: list[Grasp] = []
    refusal: InputError | None = None

    def look(grasp: Grasp, foreground: float, climbs: int) -> Array | None:
        renderer.add("hand", *hand_mesh(hand, grasp.joints, mounted))
        scene = {"object": grasp.hand_from_object, "hand": np.eye(4)}
        target = poses.apply(grasp.hand_from_object, model.centroid[None])[0]
        views = replace(settings.views, foreground=foreground, climbs=climbs)
        view, shares = find_view(
            renderer, scene, "object", target, model.radius, occlusion, settings.camera, rng, views
        )
        reached.extend(shares)
        return view

    for attempt in range(settings.grasps):
        # Whole-hand grasps touch with most fingers; those of few fingers hide less
        few = occlusion < FEW_FINGERS_BELOW and attempt >= settings.grasps // 2
        drawn = int(rng.integers(2**31))
        try:
            if has_flat_pads(hand):
                held.append(plan_grip(hand, model, drawn))
            else:
                kind = "tripod" if few and not is_gripper(find_fingers(hand)) else "power"
                held.append(plan_grasp(hand, model, drawn, kind))
        except InputError as error:
            refusal = error
            continue
        # Planning costs more than looking: after a few grasps, the same ones from closer along the arm
        last = len(held) % settings.relax_after == 0 or attempt == settings.grasps - 1
        trials = [(held[-1], settings.foregrounds[0])]
        if last:
            trials += [(g, f) for f in settings.foregrounds[1:] for g in held[-settings.relax_after :]]
        for grasp, foreground in trials:
            view = look(grasp, foreground, 0)
            if view is not None:
                return grasp, view
    # Chance met no view: walk to one, with the camera as far from the hand as will do
    for foreground in settings.climb_foregrounds:
        for grasp in held:
            view = look(grasp, foreground, settings.views.climbs)
            if view is not None:
                return grasp, view
    if not reached and refusal is not None:
        raise refusal
    span = f"{min(reached):.2f} to {max(reached):.2f}" if reached else "none"
    raise InputError(
        f"occlusion: expected a share of {model.name!r} that hand {hand.name!r} can hide, got {occlusion:.2f};"
        f" {len(held)} grasps reached {span}"
    )
