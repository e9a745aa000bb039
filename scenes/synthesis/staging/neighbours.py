"""Other objects on the table that touch the object and stand before it, so that it is hidden by just so much.

Table frame, z up, metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library
from scenes.synthesis.staging.tables import at_rest

Array = NDArray[np.float64]

# Things tried before the object, and halvings of where one of them stands.
TRIES, HALVINGS = 14, 14
# Halvings of the way until two things touch: of half a metre to 0.1 mm. They touch at this distance (m).
CLOSING, TOUCHING = 14, 5e-4
# Surface samples with which one thing is held against another's lattice.
SAMPLES = 1500
# Chosen for what they are before others: thin or round things hide little or do not lie still.
LEFT_OUT = ("pencil", "sphere", "wine_glass")


def touching(
    renderer: Renderer,
    model: ObjectModel,
    camera_from_table: Array,
    table_from_object: Array,
    wanted: float,
    camera: Camera,
    rng: np.random.Generator,
    accepted: float = 0.01,
) -> dict[str, Array]:
    """Up to two things before the object and one behind or beside it, all at rest and touching it; adds the meshes
    "clutter0" ... and returns their camera_from_mesh.

    Raises InputError when none hides `wanted` of the object's own pixels.
    """
    camera_in_table = poses.inverse(camera_from_table)[:3, 3]
    ahead = float(np.arctan2(camera_in_table[1], camera_in_table[0]))
    scene: dict[str, Array] = {"object": camera_from_table @ table_from_object}
    best = 0.0
    placed = 0

    def hidden(name: str, pose: Array) -> float:
        with_it = {**scene, name: camera_from_table @ pose}
        return 1.0 - renderer.visible_fraction(camera, with_it, "object")

    for _ in range(TRIES if wanted > accepted else 0):
        name, other, rest = _drawn(renderer, model, placed, rng)
        side = float(rng.choice([-1.0, 1.0]))

        def stands(turn: float, other: ObjectModel = other, rest: Array = rest, side: float = side) -> Array:
            return _against(model, table_from_object, other, rest, ahead + side * turn)

        most = hidden(name, stands(0.0))
        best = max(best, most)
        if most < wanted - accepted:
            if placed == 0 and most > 0.4 * wanted:  # it stays, a second one hides the rest
                scene[name], placed = camera_from_table @ stands(np.deg2rad(25.0)), 1
            continue
        low, high = 0.0, np.deg2rad(110.0)
        turn, found = 0.0, most
        for _ in range(HALVINGS):
            if abs(found - wanted) <= accepted:
                break
            turn = (low + high) / 2
            found = hidden(name, stands(turn))
            low, high = (turn, high) if found > wanted else (low, turn)
        if abs(found - wanted) <= 2 * accepted and not _meets(scene, renderer, name, camera_from_table @ stands(turn)):
            scene[name], placed, wanted = camera_from_table @ stands(turn), placed + 1, found
            break
    else:
        if wanted > accepted:
            raise InputError(
                f"occlusion: expected a share that neighbours on a table can hide, up to {best:.2f}, got {wanted:.2f}"
            )
    for _ in range(TRIES):  # one more behind, which hides nothing
        name, other, rest = _drawn(renderer, model, placed, rng)
        pose = _against(model, table_from_object, other, rest, ahead + np.pi + rng.uniform(-1.2, 1.2))
        if hidden(name, pose) <= wanted + accepted and not _meets(scene, renderer, name, camera_from_table @ pose):
            scene[name] = camera_from_table @ pose
            break
    return {key: pose for key, pose in scene.items() if key != "object"}


def _drawn(
    renderer: Renderer, model: ObjectModel, number: int, rng: np.random.Generator
) -> tuple[str, ObjectModel, Array]:
    """The mesh's name, another object, and table_from_other at rest."""
    names = [name for name in library.names() if name not in (model.name, *LEFT_OUT)]
    other = library.make(str(rng.choice(names)))
    name = f"clutter{number}"
    renderer.add(name, other.vertices, other.faces)
    return name, other, at_rest(other, rng)


def _against(model: ObjectModel, table_from_object: Array, other: ObjectModel, rest: Array, turn: float) -> Array:
    """table_from_other: pushed along the table towards the object from the direction `turn` (rad) until they touch."""
    way = np.array([np.cos(turn), np.sin(turn), 0.0])
    samples, _ = other.sample_surface(SAMPLES, seed=0)
    object_from_table = poses.inverse(table_from_object)
    points = poses.apply(object_from_table @ rest, samples)
    step = object_from_table[:3, :3] @ way
    near, far = 0.0, model.radius + other.radius + 0.01
    for _ in range(CLOSING):
        middle = (near + far) / 2
        gap = float(model.field.distance(points + middle * step).min())
        near, far = (near, middle) if gap > TOUCHING else (middle, far)
    pose = rest.copy()
    pose[:3, 3] += far * way
    return pose


def _meets(scene: dict[str, Array], renderer: Renderer, name: str, pose: Array) -> bool:
    """Whether the boxes of this and of another neighbour, camera axes, overlap."""
    own = renderer.vertices(name, pose)
    for other, place in scene.items():
        if other in ("object", name):
            continue
        points = renderer.vertices(other, place)
        if (points.min(axis=0) < own.max(axis=0)).all() and (points.max(axis=0) > own.min(axis=0)).all():
            return True
    return False
