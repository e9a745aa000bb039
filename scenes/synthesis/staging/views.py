"""Where to put a camera so that an object is hidden by just so much. Poses are camera_from_scene, metres."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ViewSettings:
    """How views are drawn and when one is good. Values by judgement."""

    # Camera to object (m): where table-top depth cameras work.
    nearest: float = 0.45
    farthest: float = 0.75
    # Views drawn before giving up; a hand leaves few directions for extreme shares.
    draws: int = 160
    # Hidden share: a drawn or bisected view this near to the asked one is taken, and one within `accepted` is
    # kept as the best found (no unit).
    aimed: float = 0.01
    accepted: float = 0.025
    # Views drawn between attempts to bisect, and how many of those.
    batch: int = 40
    bisections: int = 12
    # Halvings between a view that hides too little and one that hides too much.
    halvings: int = 14
    # When all views drawn hide too little, or all too much: steps of a random walk from each of the nearest ones to
    # the asked share, and its first stride (rad, and as a share of the range of distances), which shrinks on failure.
    climbs: int = 2
    climb_steps: int = 40
    climb_stride: float = 0.25
    # Scale of the image in which views are compared; the share is then held in full resolution.
    coarse: float = 0.2
    # The object is placed off the image centre by at most this share of the room that is left (no unit).
    off_centre: float = 0.6
    # Views in which the object alone covers fewer pixels than this (full resolution) are not taken.
    smallest_area: int = 300
    # What hides the object may come no nearer to the camera than this share of the object's distance: cameras do not
    # look along a forearm from behind the elbow.
    foreground: float = 0.7


@dataclass(frozen=True)
class View:
    """Parameters of a camera that looks at a target: direction (3,) from target to camera, distance (m), roll (rad)
    and where in the image the target appears, as tangents (2,) of the angles from the optical axis.
    """

    direction: Array
    distance: float
    roll: float
    tangent: Array

    def camera_from_scene(self, target: Array) -> Array:
        """(4, 4) pose of the scene in the camera."""
        forward = -self.direction
        right = _crossed(np.eye(3)[np.argmin(np.abs(forward))], forward)
        right /= np.sqrt(right.dot(right))
        axes = np.stack([right, _crossed(forward, right), forward])
        rotation = poses.exp_rotation([0.0, 0.0, self.roll]) @ axes
        place = np.array([*self.tangent, 1.0]) * self.distance
        return poses.make_pose(rotation, place - rotation @ target)


def _crossed(first: Array, second: Array) -> Array:
    """The cross product of (3,) and (3,): of two vectors NumPy takes ten times as long."""
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def look_at(direction: Array, target: Array, distance: float, roll: float = 0.0) -> Array:
    """camera_from_scene (4, 4) of a camera at target + distance * direction that looks at the target."""
    unit = np.asarray(direction, dtype=np.float64)
    return View(unit / np.linalg.norm(unit), distance, roll, np.zeros(2)).camera_from_scene(np.asarray(target))


def draw_views(
    count: int, camera: Camera, radius: float, rng: np.random.Generator, settings: ViewSettings
) -> list[View]:
    """Views in uniform directions at which a ball of `radius` metres around the target stays inside the image."""
    directions = poses.random_unit_vectors(count, rng)
    distances = rng.uniform(settings.nearest, settings.farthest, count)
    rolls = rng.uniform(-np.pi, np.pi, count)
    places = rng.uniform(-1.0, 1.0, (count, 2))
    half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
    middle = np.array([(camera.width - 1) / 2 - camera.cx, (camera.height - 1) / 2 - camera.cy])
    middle = middle / np.array([camera.fx, camera.fy])
    room = np.maximum(half - radius / distances[:, None], 0.0)
    tangents = middle + settings.off_centre * places * room
    return [View(*row) for row in zip(directions, distances, rolls, tangents)]


def find_view(
    renderer: Renderer,
    scene: Mapping[str, Array],
    name: str,
    target: Array,
    radius: float,
    wanted: float,
    camera: Camera,
    rng: np.random.Generator,
    settings: ViewSettings | None = None,
) -> tuple[Array | None, list[float]]:
    """A camera from which the share of `name`'s own pixels hidden by the other meshes is `wanted`.

    scene: scene_from_mesh (4, 4) of every mesh of the renderer to be seen; target (3,) scene frame and radius (m): a
    ball around the object. Returns (camera_from_scene, shares reached): None instead of the pose when no view comes
    within the settings' `accepted`. Views are drawn at random; between one that hides less and one that hides more
    the share changes continuously with the direction, so bisection reaches any share in between.
    """
    settings = settings or ViewSettings()
    coarse = camera.scaled(settings.coarse)

    others = [renderer.vertices(key, value) for key, value in scene.items() if key != name]
    cover = np.concatenate([np.asarray(target, dtype=np.float64)[None], *others])

    def hidden(view: View, lens: Camera) -> float:
        pose = view.camera_from_scene(target)
        if float((cover @ pose[2, :3] + pose[2, 3]).min()) < settings.foreground * view.distance:
            return float("nan")
        alone, seen = renderer.own_pixels(lens, {key: pose @ value for key, value in scene.items()}, name)
        smallest = settings.smallest_area * (settings.coarse**2 if lens is coarse else 1.0)
        return 1.0 - seen / alone if alone >= max(smallest, 1.0) else float("nan")

    below: list[tuple[View, float]] = []
    above: list[tuple[View, float]] = []
    best: tuple[float, View] | None = None
    tries = settings.bisections
    for number, view in enumerate(draw_views(settings.draws, camera, radius, rng, settings), start=1):
        share = hidden(view, coarse)
        if np.isfinite(share):
            (below if share <= wanted else above).append((view, share))
            if abs(share - wanted) <= settings.accepted:
                exact = hidden(view, camera)
                if abs(exact - wanted) <= settings.aimed:
                    return view.camera_from_scene(target), [s for _, s in below + above]
                if np.isfinite(exact) and (best is None or abs(exact - wanted) < best[0]):
                    best = abs(exact - wanted), view
        if number == settings.draws and bool(below) != bool(above):
            found = _climb(below + above, wanted, lambda v: hidden(v, coarse), rng, settings)
            for pair in found:
                (below if pair[1] <= wanted else above).append(pair)
        elif number % settings.batch:
            continue
        if not below or not above:
            continue
        while tries > 0:
            tries -= 1
            # A short way between the two is likely to stay among views that are allowed
            rare, common = (below, above) if len(below) < len(above) else (above, below)
            end = rare[int(rng.integers(len(rare)))]
            other = max(common, key=lambda pair: float(pair[0].direction @ end[0].direction))
            low, high = (end, other) if rare is below else (other, end)
            view, exact = _bisect(low[0], high[0], wanted, lambda v: hidden(v, camera), settings)
            if abs(exact - wanted) <= settings.aimed:
                return view.camera_from_scene(target), [s for _, s in below + above]
            if len(rare) < 2 or tries % 4 == 0:
                break
    reached = [s for _, s in below + above]
    if best is not None and best[0] <= settings.accepted:
        return best[1].camera_from_scene(target), reached
    return None, reached


def _climb(
    found: list[tuple[View, float]],
    wanted: float,
    hidden: Callable[[View], float],
    rng: np.random.Generator,
    settings: ViewSettings,
) -> list[tuple[View, float]]:
    """From the nearest of `found` towards the asked share; every step forward, up to the first beyond it."""
    steps: list[tuple[View, float]] = []
    for view, share in sorted(found, key=lambda pair: abs(pair[1] - wanted))[: settings.climbs]:
        stride, here, start = settings.climb_stride, share, share
        for _ in range(settings.climb_steps):
            direction = view.direction + stride * rng.normal(size=3)
            distance = view.distance + stride * rng.normal() * (settings.farthest - settings.nearest)
            distance = float(np.clip(distance, settings.nearest, settings.farthest))
            tangent = view.tangent * min(1.0, distance / view.distance)  # nearer, the object needs more of the image
            trial = View(direction / np.linalg.norm(direction), distance, view.roll, tangent)
            share = hidden(trial)
            if not np.isfinite(share) or (share - here) * (wanted - start) <= 0:
                stride *= 0.93
                continue
            view, here = trial, share
            steps.append((view, here))
            if (here - wanted) * (start - wanted) < 0:
                return steps
    return steps


def _bisect(
    low: View, high: View, wanted: float, hidden: Callable[[View], float], settings: ViewSettings
) -> tuple[View, float]:
    """Between a view that hides less and one that hides more; ends at the first within `aimed`."""
    view, share = low, float("nan")
    for _ in range(settings.halvings):
        middle = low.direction + high.direction
        length = np.linalg.norm(middle)
        if length < 1e-6:
            break
        # The roll goes the short way round
        turn = (high.roll - low.roll + np.pi) % (2 * np.pi) - np.pi
        view = View(
            middle / length,
            (low.distance + high.distance) / 2,
            low.roll + turn / 2,
            (low.tangent + high.tangent) / 2,
        )
        share = hidden(view)
        if not np.isfinite(share) or abs(share - wanted) <= settings.aimed:
            break
        low, high = (view, high) if share <= wanted else (low, view)
    return view, share
