"""Registration peers on what a camera sees of an object, from a rough start and from none, each at several budgets.

A view: an object alone before a depth camera, its depth with the `clean` preset's noise, and a share of its pixels cut
away along a line through the image, as something in front would. All methods get the same pixels; starts are 16 degrees
and 33 mm off. Errors are ADD-S (mm), a success is one below 5 mm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.peers.pareto import Method, Point, least_error, measure, swept
from fusion.estimation.settings import EstimateSettings
from scenes._open3d import open3d
from scenes.evidence import table as evidence
from scenes.evidence.align import terms
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from scenes.synthesis import library
from vision.published import registration as baselines
from vision.published.icp import CloudIcpSettings, icp
from vision.published.registration import BaselineSettings

Array = NDArray[np.float64]
Register = Callable[[Frame, Array, ObjectModel, int], Array]
Peer = Method["View", Array]

OBJECTS = ("drill", "mug", "hammer", "bottle")
HIDDEN = (0.0, 0.3, 0.6)
CAMERA = Camera(615.0, 615.0, 319.5, 239.5, 640, 480)
START = (float(np.deg2rad(16.0)), 0.033)
SUCCESS_MM = 5.0
# Views of a method that takes seconds: one of every object at every hidden share.
SLOW = len(OBJECTS) * len(HIDDEN)
# Our pixels, and starts near a given one; 500 and 320 are usual.
BUDGETS = ((60, 38), (120, 77), (250, 160), (500, 320), (1000, 640))


@dataclass(frozen=True)
class View:
    """frame with depth, mask, truth and start; points (n, 3) of the object, camera frame, metres."""

    model: ObjectModel
    frame: Frame
    points: Array


def views(count: int, seed: int) -> Iterator[View]:
    """`count` views of each object at each hidden share, in an order that mixes them."""
    for i in range(count):
        for j, name in enumerate(OBJECTS):
            for k, hidden in enumerate(HIDDEN):
                yield _view(library.make(name), hidden, np.random.default_rng([seed, i, j, k]))


def _view(model: ObjectModel, hidden: float, rng: np.random.Generator) -> View:
    from scenes.geometry.appearance.rendering import Renderer
    from scenes.synthesis.noise.presets import observe_depth

    middle = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.5, 0.8)])
    rotation = se3.random_rotations(1, rng)[0]
    truth = se3.make_pose(rotation, middle - rotation @ model.centroid)
    seen = Renderer({"object": (model.vertices, model.faces)}).render(CAMERA, {"object": truth})
    depth = observe_depth(seen, CAMERA, "clean", rng)
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


def peers(with_start: bool, quick: bool = False) -> Sequence[Peer]:
    """Every method at its budgets, the usual one among them; when in a hurry the smallest of each, and no point pairs:
    these prepare an object for half a minute.
    """
    if not with_start:
        pairs = () if quick else _point_pairs()
        return swept([*_ours(False), *_features(), *pairs], quick)
    small = _small_gicp() if available()[0] else ()
    return swept([*_ours(True), *_icp(), *_open3d_gicp(), *small], quick)


def _peer(name: str, budget: str, register: Register, most: int | None = None) -> Peer:
    return Method(name, budget, lambda view, seed: register(view.frame, view.points, view.model, seed), most)


def with_effort(pixels: int, starts: int) -> EstimateSettings:
    """An estimate of so many object pixels and starts around a prior."""
    usual = EstimateSettings()
    rows = replace(usual.look.rows, most=pixels)
    return replace(usual, look=replace(usual.look, rows=rows), proposals=replace(usual.proposals, starts_near=starts))


def _ours(with_start: bool) -> Iterator[Peer]:
    from fusion.estimation.estimate import estimate

    def register(settings: EstimateSettings) -> Register:
        def run(frame: Frame, points: Array, model: ObjectModel, seed: int) -> Array:
            seen = frame if with_start else replace(frame, prior=None)
            return estimate(seen, model, use=("vision",), seed=seed, settings=settings).pose

        return run

    for pixels, starts in BUDGETS:
        budget = f"{pixels} pixels, {starts} starts" if with_start else f"{pixels} pixels"
        yield _peer("palpate", budget, register(with_effort(pixels, starts)))


def _icp() -> Iterator[Peer]:
    def register(settings: CloudIcpSettings) -> Register:
        return lambda frame, points, model, seed: icp(points, model, _start(frame), settings).pose

    for most in (100, 300, 1000, 2000, 8000):
        yield _peer("Open3D ICP", f"{most} points", register(CloudIcpSettings(most_points=most)))


def _start(frame: Frame) -> Array:
    assert frame.prior is not None
    return frame.prior


def _open3d_gicp() -> Iterator[Peer]:
    def register(most: int) -> Register:
        return lambda frame, points, model, seed: open3d_gicp(points, model, _start(frame), most)

    for most in (300, 1000, 2000):
        yield _peer("Open3D GICP", f"{most} points", register(most))


def open3d_gicp(points: Array, model: ObjectModel, start: Array, most: int = 2000, samples: int = 20_000) -> Array:
    """Open3D's generalised ICP (Segal et al., RSS 2009) over the distances of the ICP baseline; (4, 4)."""
    o3d = open3d()
    registration = o3d.pipelines.registration
    picked = points[(np.arange(min(most, len(points))) * len(points)) // min(most, len(points))]
    source = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(picked))
    source.estimate_covariances()
    pose = se3.inverse(start)
    for distance in CloudIcpSettings().distances:
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
    rotation = se3.nearest_rotation(pose[None, :3, :3])[0]
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
        yield _peer("small_gicp", f"voxels of {millimetres} mm", _baseline("small_gicp", settings))


def _features() -> Iterator[Peer]:
    for iterations in (1000, 5000, 50_000, 400_000):
        settings = BaselineSettings(ransac_iterations=iterations)
        yield _peer("FPFH + RANSAC + ICP", f"{iterations} iterations", _baseline("fpfh_ransac", settings))
    for iterations in (16, 64, 256):
        settings = BaselineSettings(fgr_iterations=iterations)
        yield _peer("FGR + ICP", f"{iterations} iterations", _baseline("fgr", settings))


def _point_pairs() -> Iterator[Peer]:
    for every, refined in ((20, 1), (10, 3), (5, 5)):
        settings = BaselineSettings(ppf_reference=1.0 / every, ppf_refined=refined)
        budget = f"every {every}th point, {refined} refined"
        yield _peer("cv2.ppf_match_3d + ICP", budget, _baseline("ppf", settings), SLOW)


def front(
    chosen: Sequence[Peer], shown: Sequence[View], seed: int, progress: Callable[..., Iterator[Any]], what: str
) -> list[Point]:
    """Every peer on every view."""
    from fusion.truth.errors import Judge

    judges = {view.model.name: Judge(view.model) for view in shown}

    def judged(view: View, pose: Array) -> tuple[float, bool]:
        view.model.field  # noqa: B018
        assert view.frame.camera_from_object_truth is not None
        error = 1e3 * judges[view.model.name].errors(pose, view.frame.camera_from_object_truth).add_s
        return error, error < SUCCESS_MM

    return measure(chosen, shown, lambda view: view.model.name, judged, seed, progress, what)


def bound_mm(shown: Sequence[View]) -> float:
    """Median distance (mm) between surfaces that no unbiased method can be below: Cramér-Rao.

    The Gauss-Newton information at the truth of every pixel by itself, with the camera's independent noise.
    """
    from scenes.recordings.beliefs import DepthModel

    found = []
    for view in shown:
        truth = view.frame.camera_from_object_truth
        assert truth is not None
        sigma = np.maximum(1e-5, DepthModel().independent_sigma(view.points[:, 2]))
        found.append((view.model, evidence.make(view.points, sigma, evidence.VISION), truth))
    return surface_bound_mm(found)


def surface_bound_mm(found: Sequence[tuple[ObjectModel, evidence.Evidence, Array]]) -> float:
    """The same of objects, what was sensed of each, and true poses: how far points of the surface leave the surface,
    which is what ADD-S measures.
    """
    from scenes.evidence.modes import covariance_of

    along, covariances = [], []
    for model, rows, truth in found:
        points, normals = model.sample_surface(2000, seed=0)
        arms = se3.apply(truth, points) - se3.apply(truth, model.centroid[None])
        moved = np.concatenate([-se3.skew(arms), np.tile(np.eye(3), (len(arms), 1, 1))], axis=2)
        along.append(np.einsum("ni,nij->nj", normals @ truth[:3, :3].T, moved))
        covariances.append(covariance_of(model, terms(model, rows, truth)[2]))
    return least_error(covariances, lambda case, delta: np.abs(delta @ along[case].T).mean(axis=1))
