"""Generated objects of everyday size, by name: closed meshes in metres with the symmetries they were built with.

The z axis points up as the thing stands (the pencil's along its length, the drill's chuck along x). Origins are where
the formula is simple, not at the centroid. Bodies of revolution are declared symmetric about z although they have
facets: with 96 facets a turn the difference is below 0.1 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scenes.errors import unknown
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.geometry.symmetries import Axis, Symmetries
from scenes.synthesis import held_out, shapes

Array = NDArray[np.float64]
Built = tuple[shapes.Mesh, Symmetries]

_MAKERS: dict[str, Callable[[], Built]] = {}
# Long thin ones, of which little fills the box around their outline.
_TOOLS: dict[str, Callable[[], Built]] = {}


def names() -> list[str]:
    """Every object that anything may be tried on, sorted."""
    return sorted(_MAKERS)


def held_out_names() -> list[str]:
    """Objects that `make` knows too, but that benchmarks only report (docs/evaluation.md), sorted."""
    return sorted(held_out.MAKERS)


def tool_names() -> list[str]:
    """Long thin tools that `make` knows too: of scenes' clutter they are no part, sorted."""
    return sorted(_TOOLS)


@cache
def make(name: str) -> ObjectModel:
    """The named object; built once per process. Raises InputError, listing the names, for any other name."""
    if name in held_out.MAKERS:
        return ObjectModel.from_mesh(*held_out.MAKERS[name](), name=name)
    if name not in _MAKERS and name not in _TOOLS:
        raise unknown("object", name, [*names(), *tool_names(), *held_out_names()])
    (vertices, faces), symmetries = (_MAKERS.get(name) or _TOOLS[name])()
    return ObjectModel.from_mesh(vertices, faces, name=name, symmetries=symmetries)


def _register(maker: Callable[[], Built]) -> Callable[[], Built]:
    _MAKERS[maker.__name__.strip("_")] = maker
    return maker


def _register_tool(maker: Callable[[], Built]) -> Callable[[], Built]:
    _TOOLS[maker.__name__] = maker
    return maker


def _about_z(count: int) -> Array:
    """(count, 4, 4) equal turns about z, the identity first."""
    angles = 2 * np.pi * np.arange(count) / count
    return np.array([poses.make_pose(poses.exp_rotation([0.0, 0.0, angle])) for angle in angles])


def _curve(points: list[tuple[float, float]], steps: int) -> list[tuple[float, float]]:
    """A smooth wall through (radius, z) points in mm: monotone cubic of the path length, `steps` rings, in metres."""
    from scipy.interpolate import PchipInterpolator

    array = np.array(points) * 1e-3
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(array, axis=0), axis=1))])
    sampled = PchipInterpolator(length, array)(np.linspace(0.0, length[-1], steps))
    return [(float(r), float(z)) for r, z in sampled]


@_register
def box() -> Built:
    """A carton 140 x 90 x 55 mm: three half turns."""
    half = np.array([0.070, 0.045])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    turns = [np.eye(4)] + [poses.make_pose(poses.exp_rotation(np.pi * axis)) for axis in np.eye(3)]
    return shapes.extrude(corners, 0.055), Symmetries(np.array(turns))


@_register
def cylinder() -> Built:
    """A plain can, 66 mm across and 115 mm high; upside down it looks the same."""
    profile = [(0.0, -0.0575), (0.033, -0.0575), (0.033, 0.0575), (0.0, 0.0575)]
    return shapes.revolve(profile), Symmetries.about_axis([0, 0, 1], flip=True)


@_register
def sphere() -> Built:
    """A ball of 70 mm: no rotation can ever be seen or felt."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.035)
    axes = tuple(Axis(np.zeros(3), axis) for axis in np.eye(3))
    return (np.array(ball.vertices), np.array(ball.faces)), Symmetries(axes=axes)


@_register
def bottle() -> Built:
    """A closed bottle, 68 mm across and 220 mm high."""
    wall = _curve([(31, 0), (34, 4), (34, 60), (33, 100), (34, 130), (28, 160), (14, 190), (13, 198)], 36)
    cap = _curve([(15, 198.5), (15, 218), (14, 220)], 5)
    return shapes.revolve([(0.0, 0.0), *wall, *cap, (0.0, 0.220)]), Symmetries.about_axis([0, 0, 1])


@_register
def wine_glass() -> Built:
    """Hollow bowl with a 2 mm wall, 8 mm stem and a foot; 205 mm high, 76 mm across."""
    foot = [
        (0.034, 0.0),
        (0.035, 0.0015),
        *_curve([(34, 3), (18, 5), (7, 9), (4, 16), (4, 80), (7, 92), (14, 100)], 26),
    ]
    outer = _curve([(20, 104), (33, 120), (38, 145), (37, 170), (33, 204)], 20)
    rim = [(0.0325, 0.205), (0.0315, 0.205)]
    inner = _curve([(31, 204), (35, 170), (36, 145), (31, 121), (18.5, 106), (6, 99)], 22)
    return shapes.revolve([(0.0, 0.0), *foot, *outer, *rim, *inner, (0.0, 0.098)]), Symmetries.about_axis([0, 0, 1])


@_register
def light_bulb() -> Built:
    """Screw cap and glass: 60 mm across, 108 mm high."""
    turns = np.linspace(0, 1, 33)
    thread = [(0.0125 + 0.0007 * np.sin(2 * np.pi * 4 * t), 0.006 + 0.020 * t) for t in turns]
    glass = _curve([(13.5, 27), (15, 38), (22, 52), (29, 68), (30, 78), (27, 92), (18, 103), (8, 107.3)], 30)
    return (
        shapes.revolve([(0.0, 0.0), (0.006, 0.001), (0.011, 0.005), *thread, *glass, (0.0, 0.108)]),
        Symmetries.about_axis([0, 0, 1]),
    )


@_register
def pencil() -> Built:
    """Hexagonal, 8 mm across its corners, 175 mm long, sharpened to a flat of 1 mm."""
    angle = np.pi / 3 * np.arange(6)
    hexagon = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    mesh = shapes.loft([0.004 * hexagon, 0.004 * hexagon, 0.0005 * hexagon], [0.0, 0.153, 0.175])
    return mesh, Symmetries(_about_z(6))


@_register
def l_block() -> Built:
    """An angle of two unequal arms, 90 x 65 x 32 mm."""
    outline = [(0.0, 0.0), (0.090, 0.0), (0.090, 0.028), (0.022, 0.028), (0.022, 0.065), (0.0, 0.065)]
    return shapes.extrude(outline, 0.032), Symmetries.none()


@_register
def mug() -> Built:
    """80 mm across, 95 mm high, wall and floor 4 mm, a round handle along +x."""
    middle, height, wall = 0.038, 0.093, 0.004

    def surface(p: Array) -> Array:
        radius = np.hypot(p[:, 0], p[:, 1])
        z = p[:, 2] - wall / 2
        floor = np.hypot(np.maximum(radius - middle, 0.0), z)
        side = np.hypot(radius - middle, z - np.clip(z, 0.0, height - wall / 2))
        cup = np.minimum(floor, side) - wall / 2
        # An arc of an ellipse in the xz plane, flattened along y; cut where the cup's wall begins
        ring = np.hypot((p[:, 0] - 0.036) / 1.05, p[:, 2] - 0.048) - 0.0275
        handle = np.hypot(ring, p[:, 1] / 1.3) - 0.0048
        return shapes.smooth_union([cup, np.maximum(handle, middle - radius)], 0.004)

    mesh = shapes.mesh_implicit(surface, [-0.0453, -0.0453, -0.0053], [0.078, 0.0465, 0.1015], 0.0022)
    return mesh, Symmetries.none()


@_register
def drill() -> Built:
    """A small cordless drill: housing and chuck along +x, grip, trigger, battery foot; 175 x 185 mm."""

    def surface(p: Array) -> Array:
        housing = shapes.rounded_cylinder(p, [-0.062, 0, 0], [0.048, 0, 0], 0.027, 0.009)
        collar = shapes.rounded_cylinder(p, [0.040, 0, 0], [0.066, 0, 0], 0.021, 0.004)
        chuck = shapes.capsule(p, [0.066, 0, 0], [0.091, 0, 0], 0.015, 0.009)
        grip = shapes.capsule(p, [-0.026, 0, -0.020], [-0.040, 0, -0.120], 0.0185, 0.0165)
        trigger = shapes.rounded_box(p, [-0.004, 0, -0.042], [0.010, 0.007, 0.013], 0.005)
        foot = shapes.rounded_box(p, [-0.032, 0, -0.141], [0.044, 0.029, 0.018], 0.007)
        # The forward/reverse slide sticks out on one side: no mirror plane, as on the real thing
        slide = shapes.rounded_box(p, [-0.016, 0.019, -0.032], [0.009, 0.007, 0.004], 0.003)
        body = shapes.smooth_union([housing, collar, chuck], 0.006)
        handle = shapes.smooth_union([grip, foot], 0.012)
        return shapes.smooth_union([body, handle, trigger, slide], 0.008)

    mesh = shapes.mesh_implicit(surface, [-0.0841, -0.0377, -0.1687], [0.112, 0.039, 0.037], 0.0031)
    return mesh, Symmetries.none()


@_register
def hammer() -> Built:
    """A claw hammer of 240 mm, head 105 mm."""

    def surface(p: Array) -> Array:
        grip = shapes.capsule(p / [1.25, 1.0, 1.0], [0, 0, 0.012], [0, 0, 0.105], 0.0125, 0.0115)
        shaft = shapes.capsule(p, [0, 0, 0.10], [0, 0, 0.215], 0.0085)
        poll = shapes.rounded_cylinder(p, [0.010, 0, 0.225], [0.052, 0, 0.225], 0.0135, 0.003)
        cheek = shapes.rounded_box(p, [0.0, 0, 0.225], [0.016, 0.0115, 0.014], 0.005)
        # The claw curves down and thins out
        drop = 6.0 * np.minimum(p[:, 0] + 0.012, 0.0) ** 2
        bent = p + np.stack([np.zeros_like(drop), np.zeros_like(drop), drop], axis=1)
        claw = 0.8 * shapes.capsule(bent / [1.0, 2.0, 1.0], [-0.010, 0, 0.228], [-0.048, 0, 0.228], 0.0075, 0.0035)
        return shapes.smooth_union([grip, shaft, poll, cheek, claw], 0.006)

    mesh = shapes.mesh_implicit(surface, [-0.060, -0.025, -0.010], [0.064, 0.025, 0.252], 0.0026)
    return mesh, Symmetries.none()


@_register
def bust() -> Built:
    """A head with its face turned a little over sloping shoulders on a flat base; 165 mm high, rough with hair."""

    def surface(p: Array) -> Array:
        turned = (p - [0.0, 0.0, 0.105]) @ poses.exp_rotation([0.05, -0.08, 0.35])
        skull = shapes.ellipsoid(turned, [0.0, -0.004, 0.012], [0.033, 0.040, 0.043])
        jaw = shapes.ellipsoid(turned, [0.0, 0.012, -0.018], [0.024, 0.027, 0.026])
        nose = shapes.capsule(turned, [0.0, 0.034, 0.010], [0.0, 0.043, -0.008], 0.004, 0.006)
        brow = shapes.capsule(turned, [-0.016, 0.031, 0.014], [0.016, 0.031, 0.014], 0.005)
        ears = np.minimum(
            shapes.ellipsoid(turned, [-0.035, -0.002, 0.0], [0.005, 0.009, 0.013]),
            shapes.ellipsoid(turned, [0.035, -0.002, 0.0], [0.005, 0.009, 0.013]),
        )
        bun = shapes.ellipsoid(turned, [0.006, -0.043, 0.020], [0.017, 0.014, 0.016])
        waves = 0.0008 * np.sin(420 * turned[:, 0]) * np.sin(360 * turned[:, 2] + 100 * turned[:, 1])
        hair = np.minimum(skull, bun) + waves * np.clip((0.03 - turned[:, 1]) / 0.02, 0, 1)
        neck = shapes.capsule(p, [0.0, 0.002, 0.03], [0.0, 0.0, 0.09], 0.021, 0.018)
        chest = shapes.ellipsoid(p, [0.0, -0.004, 0.016], [0.060, 0.033, 0.036])
        plinth = shapes.rounded_box(p, [0.0, -0.002, 0.008], [0.030, 0.026, 0.008], 0.003)
        face = shapes.smooth_union([hair, jaw, nose, brow, ears], 0.010)
        whole = shapes.smooth_union([face, neck, chest], 0.020)
        return np.minimum(np.maximum(whole, 0.008 - p[:, 2]), plinth)

    mesh = shapes.mesh_implicit(surface, [-0.068, -0.076, -0.007], [0.068, 0.060, 0.174], 0.0026)
    return mesh, Symmetries.none()


@_register_tool
def hook() -> Built:
    """A pipe 17 mm across, bent back upon itself at one end: 325 mm long, the hook 80 mm wide."""

    def surface(p: Array) -> Array:
        stem = shapes.capsule(p, [0, 0, 0.009], [0, 0, 0.280], 0.0085)
        # half a circle of 32 mm about (0.032, 0, 0.28)
        x, z = p[:, 0] - 0.032, np.maximum(p[:, 2] - 0.280, 0.0)
        arc = np.hypot(np.hypot(x, z) - 0.032, p[:, 1]) - 0.0085
        bend = np.maximum(arc, 0.280 - p[:, 2])
        tip = shapes.capsule(p, [0.064, 0, 0.280], [0.064, 0, 0.240], 0.0085)
        return shapes.smooth_union([stem, bend, tip], 0.003)

    mesh = shapes.mesh_implicit(surface, [-0.013, -0.013, -0.004], [0.078, 0.013, 0.326], 0.0024)
    return mesh, Symmetries.none()


@_register_tool
def rake() -> Built:
    """A hand rake: a stick of 300 mm that thins out, a bar of 105 mm that reaches farther to one side, four teeth."""

    def surface(p: Array) -> Array:
        stick = shapes.capsule(p, [0, 0, 0.012], [0, 0, 0.300], 0.0115, 0.0065)
        bar = shapes.capsule(p, [-0.039, 0, 0.300], [0.064, 0, 0.300], 0.0063)
        teeth = [shapes.capsule(p, [x, 0, 0.300], [x, 0.034, 0.308], 0.0047) for x in (-0.039, -0.004, 0.031, 0.064)]
        return shapes.smooth_union([stick, bar, *teeth], 0.003)

    mesh = shapes.mesh_implicit(surface, [-0.050, -0.016, -0.004], [0.075, 0.043, 0.3165], 0.0025)
    return mesh, Symmetries.none()
