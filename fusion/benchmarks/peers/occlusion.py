"""Both senses, one and ICP on frames of a grasping hand that hides 80 % of the object, at several budgets.

Frames are made as those of `bench occlusion`: a hand of known joints, a start 16 degrees and 33 mm off, no mask. Every
method finds the object's pixels itself: ICP by the usual crop about the start or by our segmentation, whose time is
part of its own. Errors are ADD-S (mm), a success is one below 5 mm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.families.making import frames_of, objects_of
from fusion.benchmarks.families.table import Family
from fusion.benchmarks.peers.clouds import BUDGETS, SUCCESS_MM, surface_bound_mm, with_effort
from fusion.benchmarks.peers.pareto import Method, Point, measure, swept
from scenes.evidence import table as evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.published.icp import CloudIcpSettings, icp

Array = NDArray[np.float64]

HIDDEN = 0.8
# Points of the camera this near the true surface (m) are what it saw of the object.
NEAR = 0.004


@dataclass(frozen=True)
class Case:
    """A frame with truth and start."""

    model: ObjectModel
    frame: Frame


Peer = Method[Case, Array]


def hidden(family: Family) -> float:
    """The family's hidden share nearest to HIDDEN; NaN of recordings."""
    return min(family.levels, key=lambda level: abs(level - HIDDEN))


def cases(
    family: Family, count: int, seed: int, quick: bool = False, asked: tuple[str, ...] | None = None
) -> list[Case]:
    """`count` frames of each object, or of the asked ones among them, where grasps can hide so much."""
    names = objects_of(family, asked)[: 2 if quick else None]
    return [Case(made.model, made.frame) for made in frames_of(family, hidden(family), count, seed, names)]


def peers(quick: bool = False) -> Sequence[Peer]:
    """ICP three ways and our senses at their budgets; when in a hurry the smallest of each."""
    return swept([*_ours(), *_icp()], quick)


def _ours() -> Iterator[Peer]:
    from fusion.estimation.estimate import estimate

    for name, use in (("fused", ("vision", "touch")), ("vision", ("vision",)), ("touch", ("touch",))):
        for pixels, starts in BUDGETS:
            settings = with_effort(pixels, starts)
            yield Method(
                name,
                f"{pixels} pixels, {starts} starts" if name != "touch" else f"{starts} starts",
                lambda case, seed, use=use, settings=settings: (  # type: ignore[misc]
                    estimate(case.frame, case.model, use=use, seed=seed, settings=settings).pose
                ),
            )


def _icp() -> Iterator[Peer]:
    from fusion.truth.compare import with_contacts
    from vision.look.look import object_points
    from vision.look.points import crop_points

    def cropped(case: Case, start: Array) -> Array:
        return crop_points(case.frame, case.model, start)

    def segmented(case: Case, start: Array) -> Array:
        return object_points(case.frame, case.model, start)

    def touched(case: Case, start: Array) -> Array:
        return with_contacts(segmented(case, start), case.frame)

    def peer(name: str, points: Callable[[Case, Array], Array], most: int) -> Peer:
        settings = CloudIcpSettings(most_points=most)

        def solve(case: Case, seed: int) -> Array:
            assert case.frame.prior is not None
            return icp(points(case, case.frame.prior), case.model, case.frame.prior, settings).pose

        return Method(name, f"{most} points", solve)

    for name, points in (("ICP", cropped), ("ICP, segmented", segmented), ("ICP with contacts", touched)):
        for most in (300, 2000, 8000):
            yield peer(name, points, most)


def front(
    chosen: Sequence[Peer], done_on: Sequence[Case], seed: int, progress: Callable[..., Iterator[Any]], what: str
) -> list[Point]:
    """Every method on every frame."""
    from fusion.truth.errors import Judge

    judges = {case.model.name: Judge(case.model) for case in done_on}

    def judged(case: Case, pose: Array) -> tuple[float, bool]:
        assert case.frame.camera_from_object_truth is not None
        error = 1e3 * judges[case.model.name].errors(pose, case.frame.camera_from_object_truth).add_s
        return error, error < SUCCESS_MM

    for case in done_on:
        case.model.field  # noqa: B018
    return measure(chosen, done_on, lambda case: case.model.name, judged, seed, progress, what)


def bound_mm(done_on: Sequence[Case]) -> float:
    """Median distance (mm) between surfaces that no unbiased method on both senses can be below: Cramér-Rao, with
    independent noise of pixels and contacts. A bound for `clean`; `lab` has errors that all pixels share.
    """
    from scenes.recordings.beliefs import DepthModel
    from vision.look.points import all_points

    found = []
    for case in done_on:
        truth = case.frame.camera_from_object_truth
        assert truth is not None
        seen = all_points(case.frame)
        local = se3.apply(se3.inverse(truth), seen)
        seen = seen[np.linalg.norm(local - case.model.centroid, axis=1) < case.model.radius + NEAR]
        seen = seen[np.abs(case.model.field.distance(se3.apply(se3.inverse(truth), seen))) < NEAR]
        sigma = np.maximum(1e-5, DepthModel().independent_sigma(seen[:, 2]))
        felt = evidence.from_contacts(case.frame.contacts.moved(case.frame.camera_from_world))
        found.append((case.model, evidence.stack(evidence.make(seen, sigma, evidence.VISION), felt), truth))
    return surface_bound_mm(found)
