"""Scenes without a hand that grasps: the object alone, behind loose things, over the border, or on a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.objects import ObjectModel
from scenes.synthesis.photography import add_background
from scenes.synthesis.settings import SynthesisSettings
from scenes.synthesis.staging import clutter, tables
from scenes.synthesis.staging.loose_fingers import lay_fingers
from scenes.synthesis.staging.neighbours import touching
from scenes.synthesis.staging.pieces import Staging
from scenes.synthesis.staging.views import draw_views

Array = NDArray[np.float64]

# What hides an object that no hand holds; "neighbours" stand on a table.
STANDING = ("fingers", "object", "neighbours", "none")


@dataclass(frozen=True)
class Stage:
    """What stands before and around an object: the mesh "object" of the renderer, and of the settings the camera."""

    renderer: Renderer
    model: ObjectModel
    settings: SynthesisSettings
    staging: Staging

    def stand(self, kind: str, share: float, rng: np.random.Generator) -> dict[str, Array]:
        """camera_from_mesh of the object, of what hides `share` of it, and of the table when there is one.

        Raises InputError when no view of those tried can be hidden so.
        """
        settings, camera = self.settings, self.settings.camera
        if kind == "border":
            return {"object": clutter.beyond_border(self.renderer, self.model, share, rng, settings)}
        refusal: InputError | None = None
        views = draw_views(settings.grasps, camera, self.model.radius, rng, settings.views)
        for view in views:
            try:
                if self.staging.table:
                    return self._on_table(kind, share, rng)
                return self._hidden(kind, share, view.camera_from_scene(self.model.centroid), rng)
            except InputError as error:  # noqa: PERF203  (the next view may do)
                refusal = error
        raise refusal or InputError("occlusion: expected at least one view to be tried")

    def _hidden(self, kind: str, share: float, pose: Array, rng: np.random.Generator) -> dict[str, Array]:
        camera = self.settings.camera
        if kind == "none" or (kind == "object" and share <= 0):
            return {"object": pose}
        if kind == "object":
            hider = clutter.second_object(self.renderer, self.model, pose, share, camera, rng)
            return {"object": pose, "clutter0": hider}
        return {
            "object": pose,
            **lay_fingers(self.renderer, "object", pose, share, camera, rng, self.settings.fingers),
        }

    def _on_table(self, kind: str, share: float, rng: np.random.Generator) -> dict[str, Array]:
        model, camera, table = self.model, self.settings.camera, self.settings.table
        table_from_object = tables.at_rest(model, rng)
        middle = poses.apply(table_from_object, model.centroid[None])[0]
        view = tables.camera_above(middle, model.radius, camera, rng, self.settings.views, table)
        pose = view @ table_from_object
        if kind == "neighbours":
            hiders = touching(self.renderer, model, view, table_from_object, share, camera, rng)
            scene = {"object": pose, **hiders}
        else:
            scene = self._hidden(kind, share, pose, rng)
        return {**scene, **self._room(view, rng)}

    def _room(self, camera_from_table: Array, rng: np.random.Generator) -> dict[str, Array]:
        table = self.settings.table
        room = tables.add_table(self.renderer, camera_from_table, rng, table)
        return {**room, **(tables.add_wall(self.renderer, camera_from_table, rng, table) if self.staging.wall else {})}

    def around(
        self, scene: dict[str, Array], rng: np.random.Generator, others: tuple[Array, ...] = ()
    ) -> dict[str, Array]:
        """camera_from_mesh of the ground of a scene that has none: a table below it, or a wall somewhere behind.

        others: points (n, 3), camera frame, that must be before it too (where things will move).
        """
        if "background" in scene or not (self.settings.background or self.staging.table):
            return {}
        if not self.staging.table:
            return {"background": add_background(self.model, scene, self.renderer, rng, self.settings, others)}
        points = np.concatenate([*(self.renderer.vertices(name, pose) for name, pose in scene.items()), *others])
        centre = poses.apply(scene["object"], self.model.centroid[None])[0]
        return self._room(tables.table_below(points, centre, rng, self.settings.table), rng)
