"""Registration peers on what a camera sees of an object, from a rough start and from none, each at several budgets.

A view: an object alone before a depth camera, its depth with the `clean` preset's noise, and a share of its pixels cut
away along a line through the image, as something in front would. All methods get the same pixels; starts are 16 degrees
and 33 mm off. Errors are ADD-S (mm), a success is one below 5 mm.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.pareto import Point
from scenes import evidence, library
from scenes import poses as se3
from scenes._open3d import open3d
from scenes.alignment.batch import terms
from scenes.cameras import Camera
from scenes.frames import Frame
from scenes.objects import ObjectModel
from vision import baselines
from vision.baselines import BaselineSettings
from vision.registration import IcpSettings, icp

Array = NDArray[np.float64]
Register = Callable[[Frame, Array, ObjectModel, int], Array]

OBJECTS = ("drill", "mug", "hammer", "bust", "l_block", "bottle")
HIDDEN = (0.0, 0.3, 0.6)
CAMERA = Camera(615.0, 615.0, 319.5, 239.5, 640, 480)
START = (float(np.deg2rad(16.0)), 0.033)
SUCCESS_MM = 5.0


@dataclass(frozen=True)
class View:
    """frame with depth, mask, truth and start; points (n, 3) of the object, camera frame, metres."""

    model: ObjectModel
    frame: Frame
    points: Array


@dataclass(frozen=True)
class Peer:
    """A method at one budget. with_start: whether it begins at the frame's prior."""

    method: str
    budget: str
    with_start: bool
    register: Register


def views(count: int, seed: int) -> Iterator[View]:
    """`count` views of each object at each hidden share, in an order that mixes them."""
    for i in range(count):
        for j, name in enumerate(OBJECTS):
            for k, hidden in enumerate(HIDDEN):
                yield _view(library.make(name), hidden, np.random.default_rng([seed, i, j, k]))


def _view(model: ObjectModel, hidden: float, rng: np.random.Generator) -> View:
    from scenes.noise import observe_depth, preset
    from scenes.rendering import Renderer

    middle = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.5, 0.8)])
    rotation = se3.random_rotations(1, rng)[0]
    truth = se3.make_pose(rotation, middle - rotation @ model.centroid)
    seen = Renderer({"object": (model.vertices, model.faces)}).render(CAMERA, {"object": truth})
    depth = observe_depth(seen, CAMERA, preset("clean").depth, rng)
    mask = (depth > 0) & seen.mask("object")
    v, u = np.nonzero(mask)
    along = np.stack([u, v], axis=1) @ se3.random_unit_vectors(1, rng)[0, :2]
    cut = along < np.quantile(along, hidden) if hidden else np.zeros(len(u), dtype=bool)
    mask[v[cut], u[cut]] = False
    depth = np.where(mask, depth, 0.0).astype(np.float32)
    start = se3.displaced(truth, *START, model.centroid, rng)
    frame = Frame(0, camera=CAMERA, depth=depth, mask=mask, prior=start, camera_from_object_truth=truth)
    return View(model, frame, CAMERA.back_project(depth, mask))


def available() -> tuple[bool, str]:
    """Whether small_gicp is there, and what to say when it is not."""
    there = "small_gicp" in baselines.available()
    return there, "" if there else "not installed (pip install 'palpate[peers]')"


def peers(quick: bool) -> list[Peer]:
    """Every method at its budgets, the usual one among them; the two smallest of each when in a hurry."""
    found = [*_ours(), *_icp(), *_open3d_gicp(), *_global()]
    if available()[0]:
        found += _small_gicp()
    if not quick:
        return found
    first: dict[tuple[str, bool], list[Peer]] = {}
    for peer in found:
        first.setdefault((peer.method, peer.with_start), []).append(peer)
    return [peer for group in first.values() for peer in group[:2]]


def _ours() -> Iterator[Peer]:
    from fusion.estimation import estimate
    from fusion.stages import EstimateSettings

    def register(settings: EstimateSettings, with_start: bool) -> Register:
        def run(frame: Frame, points: Array, model: ObjectModel, seed: int) -> Array:
            seen = frame if with_start else replace(frame, prior=None)
            return estimate(seen, model, use=("vision",), seed=seed, settings=settings).pose

        return run

    usual = EstimateSettings()
    for with_start in (True, False):
        for pixels in (60, 120, 250, 500, 1000):
            share = min(1.0, pixels / usual.pixels)
            starts_near = max(20, round(usual.starts_near * share))
            settings = replace(usual, pixels=pixels, starts_near=starts_near)
            budget = f"{pixels} pixels, {starts_near} starts" if with_start else f"{pixels} pixels"
            yield Peer("palpate", budget, with_start, register(settings, with_start))


def _icp() -> Iterator[Peer]:
    def register(settings: IcpSettings) -> Register:
        return lambda frame, points, model, seed: icp(points, model, _start(frame), settings).pose

    for most in (100, 300, 1000, 2000, 8000):
        yield Peer("Open3D ICP", f"{most} points", True, register(IcpSettings(most_points=most)))


def _start(frame: Frame) -> Array:
    assert frame.prior is not None
    return frame.prior


def _open3d_gicp() -> Iterator[Peer]:
    def register(most: int) -> Register:
        return lambda frame, points, model, seed: open3d_gicp(points, model, _start(frame), most)

    for most in (300, 1000, 2000):
        yield Peer("Open3D GICP", f"{most} points", True, register(most))


def open3d_gicp(points: Array, model: ObjectModel, start: Array, most: int = 2000, samples: int = 20_000) -> Array:
    """Open3D's generalised ICP (Segal et al., RSS 2009) over the distances of the ICP baseline; (4, 4)."""
    o3d = open3d()
    registration = o3d.pipelines.registration
    picked = points[(np.arange(min(most, len(points))) * len(points)) // min(most, len(points))]
    source = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(picked))
    source.estimate_covariances()
    pose = se3.inverse(start)
    for distance in IcpSettings().distances:
        found = registration.registration_generalized_icp(
            source,
            _target(model, samples),
            distance,
            pose,
            registration.TransformationEstimationForGeneralizedICP(),
            registration.ICPConvergenceCriteria(1e-6, 1e-6, 40),
        )
        if np.isfinite(found.transformation).all():
            pose = np.array(found.transformation)
    rotation = se3.project_to_rotation(pose[None, :3, :3])[0]
    return se3.inverse(se3.make_pose(rotation, pose[:3, 3]))


@cache
def _target(model: ObjectModel, samples: int) -> Any:
    """The model's samples as an Open3D cloud with covariances, made once an object."""
    o3d = open3d()
    target = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(model.sample_surface(samples, seed=0)[0]))
    target.estimate_covariances()
    return target


def _baseline(method: str, settings: BaselineSettings) -> Register:
    def run(frame: Frame, points: Array, model: ObjectModel, seed: int) -> Array:
        return baselines.register(method, points, model, frame.prior, seed, settings)

    return run


def _small_gicp() -> Iterator[Peer]:
    for millimetres in (12, 6, 3, 2):
        settings = BaselineSettings(gicp_voxel=1e-3 * millimetres)
        yield Peer("small_gicp", f"voxels of {millimetres} mm", True, _baseline("small_gicp", settings))


def _global() -> Iterator[Peer]:
    for iterations in (1000, 5000, 50_000, 400_000):
        settings = BaselineSettings(ransac_iterations=iterations)
        yield Peer("FPFH + RANSAC + ICP", f"{iterations} iterations", False, _baseline("fpfh_ransac", settings))
    for iterations in (16, 64, 256):
        settings = BaselineSettings(fgr_iterations=iterations)
        yield Peer("FGR + ICP", f"{iterations} iterations", False, _baseline("fgr", settings))
    for every, refined in ((20, 1), (10, 3), (5, 5), (2, 10)):
        settings = BaselineSettings(ppf_reference=1.0 / every, ppf_refined=refined)
        budget = f"every {every}th point, {refined} refined"
        yield Peer("cv2.ppf_match_3d + ICP", budget, False, _baseline("ppf", settings))


def measure(chosen: Sequence[Peer], shown: Sequence[View], seed: int, progress: Callable[..., Any]) -> list[Point]:
    """Every peer on every view; the first on each object is done twice, to prepare what is made once an object."""
    from fusion.judging import Judge

    judges: dict[str, Judge] = {}
    points = []
    for peer in progress(chosen, len(chosen), "clouds"):
        prepared: set[str] = set()
        ms, errors = [], []
        for view in shown:
            name = view.model.name
            judge = judges.setdefault(name, Judge(view.model))
            if name not in prepared:
                view.model.field  # noqa: B018
                peer.register(view.frame, view.points, view.model, seed)
                prepared.add(name)
            begin = time.perf_counter()
            pose = peer.register(view.frame, view.points, view.model, seed)
            ms.append(1e3 * (time.perf_counter() - begin))
            truth = view.frame.camera_from_object_truth
            assert truth is not None
            errors.append(1e3 * judge.errors(pose, truth, None).add_s)
        error = np.array(errors)
        points.append(Point(peer.method, peer.budget, np.array(ms), error, error < SUCCESS_MM))
    return points


def bound_mm(shown: Sequence[View]) -> float:
    """Median over the views of the mean distance (mm) between surfaces that no unbiased method can be below.

    Cramer-Rao: the Gauss-Newton information at the truth of every pixel by itself, with the camera's independent noise;
    under its inverse, how far points of the surface leave the surface, which is what ADD-S measures.
    """
    from vision.clouds import DepthModel

    values = []
    for view in shown:
        truth = view.frame.camera_from_object_truth
        assert truth is not None
        sigma = np.maximum(1e-5, DepthModel().independent_sigma(view.points[:, 2]))
        information = terms(view.model, evidence.make(view.points, sigma, evidence.VISION), truth)[2]
        values.append(1e3 * surface_distance(view.model, information, truth))
    return float(np.median(values))


def surface_distance(model: ObjectModel, information: Array, pose: Array) -> float:
    """Mean distance (m) of points of the object at pose (4, 4) from its true surface, under a Gaussian error of that
    information (6, 6).
    """
    from scenes.alignment.modes import covariance_of

    points, normals = model.sample_surface(2000, seed=0)
    arms = se3.apply(pose, points) - se3.apply(pose, model.centroid[None])
    moved = np.concatenate([-se3.skew(arms), np.tile(np.eye(3), (len(arms), 1, 1))], axis=2)
    along = np.einsum("ni,nij->nj", normals @ pose[:3, :3].T, moved)
    variance = np.einsum("ni,ij,nj->n", along, covariance_of(model, information), along)
    return float(np.sqrt(2.0 / np.pi * np.maximum(variance, 0.0)).mean())
