"""NaN, infinity, denormals, nothing, one row, a million rows, single precision and other layouts, at every door.

What is no number is refused with one line or dropped and counted; it never becomes a pose of NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cases.registry import Cases, apart, at_most, is_rigid, is_sound, need, refuses, survives
from scenes.errors import PalpateError
from scenes.evidence import table as evidence
from scenes.evidence.align import Prior, align, costs
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from touch.localization import localize
from touch.recognition import identify

Array = NDArray[np.float64]

CASES = Cases()

TRUTH = se3.make_pose(se3.exp_rotation(np.array([0.3, 0.2, -0.9])), [0.05, -0.1, 0.55])
# What a broken driver, an overflow or a division by zero leaves behind.
BAD = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e155)
SMALL = (5e-324, 1e-310, 1e-200, -0.0)


def _model() -> ObjectModel:
    return library.make("l_block")


def _contacts(count: int = 20) -> Contacts:
    return Contacts(*_model().sample_surface(count, seed=9), 1e-3, 0.1).moved(TRUTH)


@cache
def view() -> Frame:
    """One depth image of 160 x 120 of the drill before a wall, without noise, with prior and truth."""
    from scenes.geometry.appearance.rendering import Renderer
    from scenes.geometry.cameras import Camera

    model = library.make("drill")
    camera = Camera(140.0, 140.0, 79.5, 59.5, 160, 120)
    pose = se3.make_pose(se3.exp_rotation(np.array([2.0, 0.4, 0.3])), np.array([0.0, 0.0, 0.6]))
    wall = np.array([[-2.0, -2, 1.2], [2, -2, 1.2], [2, 2, 1.2], [-2, 2, 1.2]]), np.array([[0, 2, 1], [0, 3, 2]])
    scene = Renderer({"object": (model.vertices, model.faces), "wall": wall})
    seen = scene.render(camera, {"object": pose, "wall": np.eye(4)})
    start = se3.displaced(pose, np.deg2rad(8), 0.01, model.centroid, np.random.default_rng(0))
    return Frame(0, camera=camera, depth=seen.depth, prior=start, camera_from_object_truth=pose)


@CASES("values", "")
def contacts_that_are_no_numbers() -> float:
    """Points that are not finite or beyond all measure, sigmas of 0 or below: refused where they come in."""
    good = _contacts(5)
    for value in BAD:
        points = good.points.copy()
        points[2, 1] = value
        refuses(partial(Contacts, points), f"point of {value}")
        refuses(partial(evidence.make, points, 1e-3, evidence.TOUCH), f"evidence of {value}")
    for value in (0.0, -1e-3, np.inf, -np.inf, 1e308, 5e-324, 1e-200):
        refuses(partial(Contacts, good.points, None, value), f"sigma of {value}")
        refuses(partial(evidence.make, good.points, value, evidence.TOUCH), f"evidence's sigma of {value}")
        refuses(
            partial(Contacts, good.points, good.normals, 1e-3, value),
            f"sigma of the normal of {value}",
        )
    for column in ("weight", "gate_above", "gate_below", "offset"):
        for value in (np.nan, np.inf, -np.inf):
            options: dict[str, Any] = {column: value}
            rows = survives(partial(evidence.make, good.points, 1e-3, evidence.TOUCH, **options), column)
            if rows is not None:
                refuses(partial(align, _model(), rows, TRUTH[None]), f"{column} of {value}")
    return 0.0


@CASES("values", "worst residual, m")
def normals_that_are_none() -> float:
    """Normals of NaN, infinity, zero or 1e308 count as unknown or are used; the answer is sound either way."""
    good = _contacts(12)
    for value in (np.nan, np.inf, 0.0, 1e308, 1e-320):
        normals = good.normals.copy()
        normals[3] = value
        contacts = survives(partial(Contacts, good.points, normals, 1e-3, 0.1), f"normal of {value}")
        if contacts is None:
            continue
        known = contacts.normals[contacts.has_normal]
        at_most(np.abs(np.linalg.norm(known, axis=1) - 1), 1e-9, f"length of a normal from {value}")
        is_sound(localize(_model(), contacts, seed=0), f"normal of {value}")
    return 0.0


@CASES("values", "")
def poses_that_are_none() -> float:
    """Priors and starts that are not finite, not rigid, mirrored or of the wrong shape."""
    from fusion.estimation.estimate import estimate

    model, frame = _model(), Frame(0, contacts=_contacts(8))
    for value in BAD:
        for place in ((0, 0), (1, 3), (3, 0)):
            pose = np.eye(4)
            pose[place] = value
            refuses(partial(estimate, frame, model, prior=pose), f"prior with {value} at {place}")
    wrong: tuple[Array, ...] = (
        np.eye(3),
        np.zeros((4, 4)),
        2 * np.eye(4),
        np.diag([1.0, 1, -1, 1]),
        np.zeros((2, 4, 4)),
    )
    for pose in wrong:
        refuses(partial(estimate, frame, model, prior=pose), f"prior of shape {pose.shape}")
    information = np.eye(6)
    information[2, 2] = np.nan
    refuses(lambda: localize(model, _contacts(8), prior=Prior(np.eye(4), information)), "information of NaN")
    refuses(lambda: align(model, evidence.from_contacts(_contacts(4)), np.full((1, 4, 4), np.nan)), "start of NaN")
    for sigma in (0.0, -1.0, np.nan):
        refuses(partial(Prior.isotropic, np.eye(4), sigma, 0.01), f"prior's sigma {sigma}")
    return 0.0


@CASES("values", "")
def settings_that_are_none() -> float:
    """Tolerances, budgets, senses and methods that mean nothing."""
    from fusion.estimation.estimate import estimate

    model, frame = _model(), Frame(0, contacts=_contacts(8))
    calls: dict[str, Callable[[], object]] = {
        "tolerance of NaN": lambda: estimate(frame, model, tolerance=(np.nan, 0.1)),
        "tolerance of one": lambda: estimate(frame, model, tolerance=(0.1,)),  # type: ignore[arg-type]
        "negative tolerance": lambda: estimate(frame, model, tolerance=(-1.0, 0.1)),
        "budget of NaN": lambda: estimate(frame, model, budget_ms=np.nan),
        "negative budget": lambda: estimate(frame, model, budget_ms=-1.0),
        "no sense": lambda: estimate(frame, model, use=()),
        "unknown sense": lambda: estimate(frame, model, use=("smell",)),
        "unknown method": lambda: localize(model, _contacts(8), method="guess"),
        "no candidate": lambda: identify([], _contacts(8)),
        "one candidate twice": lambda: identify([model, model], _contacts(8)),
    }
    for what, call in calls.items():
        refuses(call, what)
    return 0.0


@CASES("values", "")
def nothing_at_all() -> float:
    """No contact, no pixel, no row: lost or refused, never a guess."""
    from fusion.estimation.estimate import estimate

    model = _model()
    refuses(lambda: localize(model, Contacts(np.zeros((0, 3)))), "localize without contacts")
    refuses(lambda: identify([model], Contacts(np.zeros((0, 3)))), "identify without contacts")
    empty = estimate(Frame(0), model)
    is_sound(empty)
    need(empty.verdict == "lost", f"verdict {empty.verdict} from an empty frame")
    believed = estimate(Frame(0), model, prior=TRUTH)
    is_sound(believed)
    need(believed.verdict == "lost" and np.allclose(believed.pose, TRUTH), "a prior alone is the prior, and lost")
    dark = replace(view(), depth=np.zeros_like(view().depth))
    answer = survives(lambda: estimate(dark, library.make("drill")), "an image of zeros")
    if answer is not None:
        is_sound(answer)
        need(answer.verdict == "lost", f"verdict {answer.verdict} from an image of zeros")
    found = align(model, evidence.empty(), TRUTH[None])
    need(np.array_equal(found.poses[0], TRUTH) or np.allclose(found.poses[0], TRUTH, atol=1e-12), "no row moved a pose")
    need(align(model, evidence.from_contacts(_contacts(3)), np.zeros((0, 4, 4))).poses.shape == (0, 4, 4), "no start")
    return 0.0


@CASES("values", "worst residual, m")
def one_row() -> float:
    """One contact, with and without a normal: met, ambiguous, wide."""
    model = _model()
    worst = 0.0
    for normals in (None, _contacts(1).normals):
        contacts = Contacts(_contacts(1).points, normals, 1e-3, 0.1)
        found = localize(model, contacts, seed=0)
        is_sound(found)
        need(found.verdict == "ambiguous", f"verdict {found.verdict} from one contact")
        worst = max(worst, at_most(found.index, 1e-3, "residual"))
    return worst


@CASES("values", "seconds of processor time", slow=True)
def a_million_rows() -> float:
    """10^6 rows in one alignment, and 10^5 contacts through localize: in bounded time, sound."""
    import time

    model = _model()
    begin = time.process_time()
    points, normals = model.sample_surface(1_000_000, seed=1)
    rows = evidence.make(points, 1e-3, evidence.VISION, weight=1e-3, gate_above=3.0)
    rng = np.random.default_rng(0)
    starts = np.array([se3.displaced(np.eye(4), 0.1, 0.005, model.centroid, rng) for _ in range(4)])
    found = align(model, rows, starts)
    is_rigid(found.poses)
    need((found.costs <= costs(model, rows, starts)).all(), "the cost rose")
    at_most(apart(model, found.poses[int(np.argmin(found.costs))], np.eye(4))[1], 1e-3, "displacement")
    is_sound(localize(model, Contacts(points[:100_000], normals[:100_000], 1e-3, 0.1), seed=0))
    return time.process_time() - begin


@CASES("values", "displacement from single precision, m")
def single_precision_and_other_layouts() -> float:
    """float32, lists, Fortran order, strided views, big-endian, read-only: the answer is that of float64."""
    model = _model()
    good = _contacts(20)
    reference = localize(model, good, seed=0).pose
    points, normals = good.points, good.normals
    frozen = points.copy()
    frozen.setflags(write=False)
    wide = np.zeros((20, 9))
    wide[:, ::3] = points
    forms: dict[str, tuple[Any, Any, float]] = {
        "lists": (points.tolist(), normals.tolist(), 0.0),
        "Fortran order": (np.asfortranarray(points), np.asfortranarray(normals), 0.0),
        "a strided view": (wide[:, ::3], normals, 0.0),
        "reversed twice": (points[::-1][::-1], normals, 0.0),
        "big-endian": (points.astype(">f8"), normals.astype(">f8"), 0.0),
        "read-only": (frozen, normals, 0.0),
        "float32": (points.astype(np.float32), normals.astype(np.float32), 1e-5),
        "longdouble": (points.astype(np.longdouble), normals, 0.0),
    }
    worst = 0.0
    for what, (p, n, limit) in forms.items():
        found = localize(model, Contacts(p, n, np.float32(1e-3), [0.1] * 20), seed=0)
        is_sound(found, what)
        # a single-precision sigma of 1 mm differs in its eighth digit
        worst = max(worst, at_most(np.abs(found.pose - reference), max(limit, 1e-6), what))
    vertices = ObjectModel.from_mesh(model.vertices.astype(np.float32), model.faces.astype(np.int32), "single")
    at_most(abs(vertices.volume / model.volume - 1), 1e-5, "a mesh in single precision")
    unsigned = ObjectModel.from_mesh(model.vertices.tolist(), model.faces.astype(np.uint32), "unsigned")
    at_most(abs(unsigned.volume / model.volume - 1), 1e-12, "unsigned vertex numbers")
    return worst


@CASES("values", "")
def wrong_shapes() -> float:
    """Two coordinates, a cube of numbers, too few names or normals."""
    points = _contacts(4).points
    calls: dict[str, Callable[[], object]] = {
        "two coordinates": lambda: Contacts(points[:, :2]),
        "a cube": lambda: Contacts(np.zeros((2, 2, 3))),
        "five numbers": lambda: Contacts(np.zeros(5)),
        "text": lambda: Contacts([["a", "b", "c"]]),
        "ragged": lambda: Contacts([[0.0, 0.0, 0.0], [1.0, 1.0]]),
        "complex": lambda: Contacts(points * 1j),
        "three normals for four": lambda: Contacts(points, np.eye(3)),
        "three sigmas for four": lambda: Contacts(points, None, [1e-3] * 3),
        "three names for four": lambda: Contacts(points, sensors=["a"] * 3),
        "evidence of two coordinates": lambda: evidence.make(points[:, :2], 1e-3, evidence.TOUCH),
    }
    for what, call in calls.items():
        refuses(call, what)
    return 0.0


def _noisy(value: float) -> NDArray[np.float32]:
    depth = np.array(view().depth)
    rng = np.random.default_rng(1)
    depth[rng.random(depth.shape) < 0.15] = value
    return depth


@CASES("values", "displacement, m", over=(np.nan, np.inf, -np.inf, -1.0, 0.0, 5e-324, 1e-30, 3e38))
def depth_pixels_of(value: float) -> float:
    """15 % of the pixels are that: dropped, and the drill is found as before."""
    from fusion.estimation.estimate import estimate

    model = library.make("drill")
    frame = replace(view(), depth=_noisy(value))
    answer = estimate(frame, model)
    is_sound(answer)
    assert frame.camera_from_object_truth is not None
    need(answer.verdict != "lost", "lost")
    return at_most(apart(model, answer.pose, frame.camera_from_object_truth)[1], 3e-3, "displacement")


@CASES("values", "")
def images_of_one_value() -> float:
    """A whole image of NaN, of infinity, of a wall at the lens: lost or ambiguous, never ok, never a crash."""
    from fusion.estimation.estimate import estimate

    model = library.make("drill")
    for value in (np.nan, np.inf, -1.0, 1e-30, 3e38, 1e-3, 0.6):
        for prior in (view().prior, None):
            frame = replace(view(), depth=np.full((120, 160), value, dtype=np.float32), prior=prior)
            answer = survives(partial(estimate, frame, model), f"image of {value}")
            if answer is not None:
                is_sound(answer, f"image of {value}")
                need(answer.verdict != "ok", f"ok from an image of {value}")
    return 0.0


@CASES("values", "displacement, m")
def clouds_with_bad_rows() -> float:
    """A cloud with NaN, infinite and absurdly far rows gives the answer of its good ones, or is refused."""
    from fusion.estimation.estimate import estimate

    model = library.make("drill")
    points, _ = model.sample_surface(3000, seed=2)
    cloud = se3.apply(TRUTH, points)
    start = se3.displaced(TRUTH, np.deg2rad(5), 0.005, model.centroid, np.random.default_rng(0))
    worst = 0.0
    for value in (np.nan, np.inf, 1e3, 1e30, 1e308):
        bad = cloud.copy()
        bad[::7, 1] = value
        try:
            answer = estimate(Frame(0, cloud=bad, prior=start), model)
        except PalpateError:
            continue
        is_sound(answer, f"rows of {value}")
        worst = max(worst, at_most(apart(model, answer.pose, TRUTH)[1], 3e-3, f"rows of {value}"))
    return worst


@CASES("values", "worst residual, m")
def denormals() -> float:
    """Coordinates, normals and forces of 5e-324: as good as zero."""
    model = _model()
    worst = 0.0
    for value in SMALL:
        contacts = _contacts(10)
        points = se3.apply(se3.inverse(TRUTH), contacts.points)
        points[0] = value
        found = localize(model, Contacts(points, None, 1e-3), seed=0)
        worst = max(worst, is_sound(found, f"{value}"))
    return worst
