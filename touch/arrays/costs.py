"""Costs of poses from array readings: covariance matching and distance as published (T1 algorithms 5.2 and 5.3), and
the likelihood of the pressures themselves.

The forward model predicts what each taxel feels from the lattice and the soft layer: how far the object reaches into
the layer's columns, blurred as the layer blurs. An array whose finger is bent a millimetre differently from what its
joints say would outvote all others by fractions of a millimetre, so each array's own pose error is estimated beside the
object's pose, within what such errors usually are: the pattern counts by what it says of shape, its place by what
kinematics are worth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.robot.tactile import DEEPEST
from scenes.threads import run_chunks
from touch.arrays import kernels, pressure_kernels
from touch.arrays.cloud import CloudSettings, surface_cloud
from touch.arrays.descriptor import Descriptor, describe, tangent_frame
from touch.arrays.readings import NOISE, Reading

Array = NDArray[np.float64]


COSTS = ("covariance", "distance", "forward")


@dataclass(frozen=True)
class MatchingSettings:
    """Design parameters of T1 algorithm 5.2, which the thesis names without values. Values by judgement."""

    # epsilon (m): contacts farther than this from the surface are not matched (T1: 30 mm).
    epsilon: float = 0.030
    # h1 (no unit): metres of cost for each metre that a contact without points is away from the surface. At 1 a pose
    # that misses a contact could be had for less than one that meets it badly.
    h1: float = 2.0
    # h2 (no unit): metres of cost for each metre that a point of the patch lies behind the contact plane. It is summed
    # over the patch's points, some forty: a patch that lies 1 mm too deep costs 0.4 mm.
    h2: float = 0.01
    # h3 (1/m): a standard deviation s that is wrong by ds makes a variance wrong by 2 s ds. A pad of 25 mm has s of 7
    # mm: at 1 / (2 s) = 70 a wrong deviation counts like a wrong distance, and shape is to count three times that.
    h3: float = 200.0
    # Points within this height (m) of the skin are in the sensing area ("a small height"): as far as a start may be
    # off. Within the layer's own 2 mm a pose that is a centimetre off has no points to compare, and its cost no slope.
    height: float = 0.010
    cloud: CloudSettings = field(default_factory=CloudSettings)


@dataclass(frozen=True)
class ForwardSettings:
    """What is believed of pressures and of where the arrays are. Values by judgement."""

    # Error of an indentation: a share of it (gain of a taxel), noise of the pressure (Pa), and what the elastic
    # foundation and the lattice leave out (m).
    gain: float = 0.2
    noise: float = NOISE
    model: float = 2e-4
    # Pose error of each array per axis (rad, m): three joints of half a degree, and where it sits on its link.
    turn: float = float(np.deg2rad(1.0))
    move: float = 0.001
    # Residuals beyond this many sigmas count less and less: dead taxels read nothing.
    gate: float = 4.0


class ArrayProblem:
    """Readings of one grasp and one object, packed for the kernels. Poses are readings_frame_from_object (b, 4, 4)."""

    def __init__(
        self,
        model: ObjectModel,
        readings: Sequence[Reading],
        matching: MatchingSettings | None = None,
        forward: ForwardSettings | None = None,
    ) -> None:
        """Readings in one frame; those that feel nothing count in the forward model alone. InputError for none."""
        if not readings:
            raise InputError("arrays: expected at least one reading, got none")
        self.model = model
        self.readings = tuple(readings)
        self.matching, self.likelihood = matching or MatchingSettings(), forward or ForwardSettings()
        self.touching = tuple(r for r in readings if r.active.any())

    @cached_property
    def descriptors(self) -> tuple[Descriptor, ...]:
        """Of the readings that feel something."""
        return tuple(describe(reading) for reading in self.touching)

    def covariance(self, candidates: Array) -> Array:
        """T1 algorithm 5.2: costs (b,), metres."""
        return self._costs(candidates, kernels.covariance_costs, self._matching_arguments)

    def distance(self, candidates: Array) -> Array:
        """T1 algorithm 5.3: costs (b,), m^2."""
        return self._costs(candidates, kernels.distance_costs, self._distance_arguments)

    def forward(self, candidates: Array) -> Array:
        """Negative log likelihood (b,) of the pressures, up to a constant."""
        return self.forward_terms(candidates, False)[0]

    def forward_each(self, candidates: Array) -> Array:
        """The same of each reading by itself (b, k), which sum to `forward`."""
        *taxels, first, depths, blurs, levers, turn, move, gate = self._forward_arguments
        out = np.zeros((len(self.readings), len(candidates)))
        for k, costs in enumerate(out):
            alone = first[k : k + 2], depths[k : k + 1], blurs[k : k + 1], levers[k : k + 1]
            self._likelihood((*taxels, *alone, turn, move, gate), candidates, False, costs)
        return out.T

    def forward_terms(self, candidates: Array, derivatives: bool = True) -> tuple[Array, Array, Array]:
        """The same with gradients (b, 6) and Gauss-Newton Hessians (b, 6, 6) in the chart of poses.perturb."""
        out = np.zeros(len(candidates))
        return out, *self._likelihood(self._forward_arguments, candidates, derivatives, out)

    def _likelihood(self, arguments: tuple, candidates: Array, derivatives: bool, out: Array) -> tuple[Array, Array]:
        """Fills out (b,) by the kernel's arguments; gradients (b, 6) and Hessians (b, 6, 6), zeros if not asked for."""
        count = len(candidates)
        gradients, hessians = np.zeros((count, 6)), np.zeros((count, 6, 6))
        rotations, translations = _split(candidates)
        field = self.model.field

        def work(part: slice) -> None:
            pressure_kernels.forward_costs(  # type: ignore[call-arg]
                field.values,
                field.origin,
                field.spacing,
                self.model.centroid,
                *arguments,
                rotations[part],
                translations[part],
                derivatives,
                out[part],
                gradients[part],
                hessians[part],
            )

        run_chunks(work, count, smallest=20)
        return gradients, hessians

    def cost(self, name: str) -> Callable[[Array], Array]:
        """One of COSTS: poses (b, 4, 4) to costs (b,)."""
        costs = dict(zip(COSTS, (self.covariance, self.distance, self.forward)))
        if name not in costs:
            raise InputError(f"arrays: expected a cost of {', '.join(COSTS)}, got {name!r}")
        return costs[name]

    def scalar(self, cost: str) -> Callable[[Array, Array], float]:
        """The cost of one pose as a function of rotations (1, 3, 3) and translations (1, 3), for searches that ask one
        by one: as little as possible between them and the kernel.
        """
        field, out = self.model.field, np.zeros(1)
        lattice = (field.values, field.origin, field.spacing)
        if cost == "forward":
            none = (False, out, np.zeros((1, 6)), np.zeros((1, 6, 6)))
            arguments, kernel = self._forward_arguments, pressure_kernels.forward_costs

            def likelihood(rotations: Array, translations: Array) -> float:
                kernel(*lattice, self.model.centroid, *arguments, rotations, translations, *none)  # type: ignore[call-arg]
                return float(out[0])

            return likelihood
        matched = cost == "covariance"
        arguments = self._matching_arguments if matched else self._distance_arguments
        one = kernels.covariance_costs if matched else kernels.distance_costs

        def published(rotations: Array, translations: Array) -> float:
            one(*lattice, *arguments, rotations, translations, out)  # type: ignore[call-arg]
            return float(out[0])

        return published

    def predicted(self, pose: Array) -> list[Array]:
        """Pressures (k,) Pa that each reading's taxels would report at a pose (4, 4), before noise."""
        places, normals, feet, shares, _, _, _, first, depths, blurs, levers = self._forward_arguments[:11]
        out = np.zeros(len(places))
        owner = np.repeat(np.arange(len(self.readings)), np.diff(first))
        field = self.model.field
        pressure_kernels.predictions(
            field.values, field.origin, field.spacing, places, normals, feet, shares, depths, blurs,
            np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3]), levers, owner, out,
        )  # fmt: skip
        felt = []
        for k, reading in enumerate(self.readings):
            layer = reading.layer
            pressure = layer.stiffness * np.maximum(out[first[k] : first[k + 1]], 0.0)
            felt.append(np.where(pressure < layer.threshold, 0.0, np.minimum(pressure, layer.saturation)))
        return felt

    def _costs(self, candidates: Array, kernel, arguments: tuple) -> Array:  # type: ignore[no-untyped-def]
        out = np.zeros(len(candidates))
        if not self.touching:
            return out
        rotations, translations = _split(candidates)
        field = self.model.field

        def work(part: slice) -> None:
            kernel(
                field.values, field.origin, field.spacing, *arguments, rotations[part], translations[part], out[part]
            )

        run_chunks(work, len(out), smallest=50)
        return out

    @cached_property
    def _matching_arguments(self) -> tuple:
        settings, described = self.matching, self.descriptors
        boxes, skins = zip(*(_sensing_box(r, d, settings.height) for r, d in zip(self.touching, described)))
        return (
            *surface_cloud(self.model, settings.cloud).arguments,
            np.array([d.frame_from_tangent[:3, :3] for d in described]),
            np.array([d.frame_from_tangent[:3, 3] for d in described]),
            np.array([d.centroid for d in described]),
            np.array([d.covariance for d in described]),
            np.array([d.basis[:, 2] for d in described]),
            np.array(boxes),
            np.array(skins),
            np.array([settings.epsilon, settings.h1, settings.h2, settings.h3]),
        )

    @cached_property
    def _distance_arguments(self) -> tuple:
        points = [r.surface_points[r.active] for r in self.touching]
        first = np.concatenate([[0], np.cumsum([len(p) for p in points])]).astype(np.int64)
        return np.ascontiguousarray(np.concatenate(points)), first

    @cached_property
    def _forward_arguments(self) -> tuple:
        believed, parts = self.likelihood, [_columns(reading) for reading in self.readings]
        felt, status, sigmas = zip(*(_indentations(reading, believed) for reading in self.readings))
        taxels = np.concatenate([reading.taxels for reading in self.readings])
        first = np.concatenate([[0], np.cumsum([len(r.taxels) for r in self.readings])]).astype(np.int64)
        return (
            np.ascontiguousarray(taxels[:, :3]),
            np.ascontiguousarray(taxels[:, 3:]),
            np.ascontiguousarray(np.concatenate(parts)),
            SHARES,
            np.concatenate(felt),
            np.concatenate(status),
            np.concatenate(sigmas),
            first,
            np.array([DEEPEST * r.layer.thickness for r in self.readings]),
            np.array([REACH * r.layer.blur for r in self.readings]),
            np.array([tangent_frame(r)[:3, 3] for r in self.readings]),
            believed.turn,
            believed.move,
            believed.gate,
        )


# Where a Gaussian blur of sigma 1 is sampled along the skin: degree 5 (Stroud 1971, E2 r2 5-1).
REACH = 2.0
SHARES = np.array([0.5] + [1.0 / 12.0] * 6)


def _columns(reading: Reading) -> Array:
    """(k, 7, 3) feet of the layer's columns under each taxel: its own, and six around it on the skin."""
    layer, places, normals = reading.layer, reading.taxels[:, :3], reading.taxels[:, 3:]
    depth, reach = DEEPEST * layer.thickness, REACH * layer.blur
    # sides by the sensor's own axes: which columns are followed must not depend on the readings' frame
    axes = reading.frame_from_sensor[:3, :3]
    side = np.cross(normals, axes.T[np.argmin(np.abs(normals @ axes).round(9), axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(normals, side)
    turns = 2 * np.pi * np.arange(6) / 6
    around = [reach * (np.cos(t) * side + np.sin(t) * up) for t in turns]
    points = np.stack([places, *(places + a for a in around)], axis=1)
    out = np.repeat(normals[:, None], 7, axis=1)
    if reading.radius is not None:
        points, out = _onto_fingertip(reading, points)
    # the pressing direction is the taxel's own; only the feet follow the skin
    return points - depth * out


def _onto_fingertip(reading: Reading, points: Array) -> tuple[Array, Array]:
    """Points (k, j, 3) brought onto a ball with a cylinder behind it, and the skin's normals there."""
    frame, radius = reading.frame_from_sensor, float(reading.radius or 0.0)
    local = se3.apply(se3.inverse(frame), points.reshape(-1, 3))
    axis = np.minimum(local[:, :1], 0.0) * [1.0, 0.0, 0.0]
    out = local - axis
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)
    skin = se3.apply(frame, axis + radius * out)
    return skin.reshape(points.shape), (out @ frame[:3, :3].T).reshape(points.shape)


def _indentations(reading: Reading, believed: ForwardSettings) -> tuple[Array, NDArray[np.int64], Array]:
    """Felt indentations (k,) m, the kind of each reading (see pressure_kernels.forward_costs), and sigmas (k,) m."""
    layer, active = reading.layer, reading.active
    least = layer.threshold / layer.stiffness
    felt = np.where(active, np.minimum(reading.indentation, layer.saturation / layer.stiffness), least)
    felt[reading.unknown] = DEEPEST * layer.thickness  # no object presses deeper
    status = np.where(active, np.where(reading.pressure >= 0.999 * layer.saturation, 2, 1), 0).astype(np.int64)
    sigma = np.sqrt((believed.gain * felt) ** 2 + (believed.noise / layer.stiffness) ** 2 + believed.model**2)
    return felt, status, sigma


def _sensing_box(reading: Reading, descriptor: Descriptor, height: float) -> tuple[Array, Array]:
    """Limits (6,) in the tangent frame, half a pitch beyond the taxels, and the skin's height there as a quadric (6,)
    with the height within which points count.
    """
    local = se3.apply(se3.inverse(descriptor.frame_from_tangent), reading.taxels[:, :3])
    # what a finger's far side feels is no part of this patch
    facing = reading.taxels[:, 3:] @ descriptor.frame_from_tangent[:3, 2] > 0.3
    local = local[facing] if facing.any() else local
    x, y, z = local.T
    margin = 0.5 * reading.pitch
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    # damped a little: a single row of taxels leaves the quadric across it open
    damping = 1e-9 * np.eye(6) * [1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3]
    scale = np.array([1.0, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4])
    scaled = basis / scale
    skin = np.linalg.solve(scaled.T @ scaled + damping * len(x), scaled.T @ z) / scale
    limits = [x.min() - margin, x.max() + margin, y.min() - margin, y.max() + margin]
    corners = np.array([[a, b] for a in limits[:2] for b in limits[2:]])
    floors = np.concatenate([basis @ skin, *(_quadric(skin, c) for c in corners)])
    limits += [floors.min() - height, floors.max() + height]
    return np.array(limits), np.concatenate([skin, [height]])


def _quadric(skin: Array, place: Array) -> Array:
    x, y = place
    return np.array([np.array([1.0, x, y, x * x, x * y, y * y]) @ skin])


def _split(candidates: Array) -> tuple[Array, Array]:
    candidates = np.asarray(candidates, dtype=np.float64).reshape(-1, 4, 4)
    if not np.isfinite(candidates).all():
        raise InputError("arrays: expected finite poses")
    return np.ascontiguousarray(candidates[:, :3, :3]), np.ascontiguousarray(candidates[:, :3, 3])
