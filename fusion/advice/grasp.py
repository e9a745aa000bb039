"""How well the hand holds the object at the estimated pose, how sure that is, and where one more finger would help.

The fingers stay where they are felt; the object under them is as uncertain as the posterior says, and with it the
centre of mass, the places that are touched and the normals there. Object frame, metres; wrenches as in
touch.grasp_quality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.advice.next_touch import best_apart, gains, hand_around, nearest_finger
from fusion.estimation.answer import Estimate
from fusion.estimation.posterior.samples import sample_poses
from scenes.errors import InputError
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from touch.contacts import feel, placed
from touch.grasp_quality import Quality, WrenchSettings, grasp_quality, margin, on_surface, primitive_wrenches

Array = NDArray[np.float64]

NORMALS = ("sensed", "mesh")
# Places for another finger that are named, the best first.
SHOWN = 3


# Sides of a friction pyramid: 16 lose 2 % of the tangential force at worst. Of 340 hulls a frame each takes some six
# times as long as of 8, of 24 forty times: over a minute.
MOST_EDGES = 16


@dataclass(frozen=True)
class GraspAdviceSettings:
    """What is asked of a grasp. Values by judgement."""

    wrenches: WrenchSettings = field(default_factory=WrenchSettings)
    # Whose normals count where a contact has one: "sensed" by the finger, or the "mesh"'s at the place that is touched.
    normals: str = "sensed"
    # Poses drawn from the posterior; the ends of a 90 % interval from 100 are good to some 3 % of the ranks.
    samples: int = 100
    # Places of the surface that another finger is tried at; 0: none.
    places: int = 240
    # A fingertip (m): a ball of this radius must find room on the surface, beside the object's other parts and hand.
    tip: float = 0.008
    # Share of the tip's radius that may overlap: curvature of the place itself and the lattice's error.
    overlap: float = 0.25
    # Best places are this far apart, as a share of the object's radius.
    apart: float = 0.2

    def __post_init__(self) -> None:
        """Refuse what cannot be asked."""
        if self.normals not in NORMALS:
            raise InputError(f"normals: expected one of {', '.join(NORMALS)}, got {self.normals!r}")
        if self.samples < 0 or self.places < 0:
            raise InputError(f"grasp: expected samples and places from 0, got {self.samples} and {self.places}")
        if self.wrenches.edges > MOST_EDGES:
            sides = f"3 to {MOST_EDGES} sides, got {self.wrenches.edges}"
            raise InputError(f"edges: expected a friction pyramid of {sides}")


@dataclass(frozen=True)
class PosteriorSpread:
    """Median and 5 % and 95 % quantiles over the posterior."""

    median: float
    low: float
    high: float

    @staticmethod
    def of(values: Sequence[float]) -> PosteriorSpread:
        """From samples; zeros for none."""
        low, median, high = np.quantile(values, (0.05, 0.5, 0.95)) if len(values) else (0.0, 0.0, 0.0)
        return PosteriorSpread(float(median), float(low), float(high))

    def to_json(self) -> dict[str, float]:
        """Its entry of grasp.json."""
        return {"median": self.median, "p05": self.low, "p95": self.high}


@dataclass(frozen=True)
class Place:
    """Where another finger would help: point and outward normal (3,) object frame; gain of the margin (N), the margin
    and whether the grasp would be closed with it; nats that touching there tells about the pose; nearest free finger.
    """

    point: Array
    normal: Array
    gain: float
    margin: float
    information: float
    finger: str | None = None
    finger_distance: float | None = None

    @property
    def told(self) -> str:
        """What the finger would do to the grasp, for a person. Without closure epsilon is 0, and the gain is of the
        margin, which is below 0 then: how far it is from closing.
        """
        before = self.margin - self.gain
        if before > 0.0:
            return f"ε {self.margin:.3f} ({self.gain:+.3f})"
        if self.margin > 0.0:
            return f"closes the grasp: ε {self.margin:.3f} (margin {before:.3f} without it)"
        return f"does not close the grasp: margin {self.margin:.3f} ({before:.3f} without it)"

    def to_json(self) -> dict[str, Any]:
        """Its entry of grasp.json."""
        return {
            "object_point": [float(x) for x in self.point],
            "object_normal": [float(x) for x in self.normal],
            "epsilon_gain": self.gain,
            "epsilon_with": max(0.0, self.margin),
            "force_closure_with": self.margin > 0.0,
            "information_nats": self.information,
            "finger": self.finger,
            "finger_distance_mm": None if self.finger_distance is None else 1e3 * self.finger_distance,
        }


@dataclass(frozen=True)
class GraspMap:
    """points (n, 3), normals (n, 3) object frame; gain (n,) N of the margin, NaN where no fingertip can be."""

    points: Array
    normals: Array
    gain: Array


@dataclass(frozen=True)
class GraspAnswer:
    """One frame's grasp: quality at the estimate, over the posterior, and where another finger would help.

    sensors: of the contacts that count; left_out: of those that do not belong to the estimate. points, normals (n, 3):
    those that count, on the surface, object frame. verdict: of the pose. notes: in words, what is felt and not used.
    """

    frame: int
    verdict: str
    quality: Quality
    sensors: tuple[str, ...]
    left_out: tuple[str, ...]
    points: Array
    normals: Array
    length: float
    closure_probability: float
    epsilon: PosteriorSpread
    volume: PosteriorSpread
    samples: int
    places: tuple[Place, ...] = ()
    map: GraspMap | None = None
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Its entry of grasp.json; volumes in N^6, torques divided by length_mm."""
        quality = self.quality
        return {
            "frame": self.frame,
            "pose_verdict": self.verdict,
            "force_closure": quality.closure,
            "why": quality.why,
            "epsilon": quality.epsilon,
            "volume": quality.volume,
            "margin": quality.margin,
            "weakest_wrench": None if quality.weakest is None else [float(x) for x in quality.weakest],
            "length_mm": 1e3 * self.length,
            "posterior": {
                "samples": self.samples,
                "force_closure_probability": self.closure_probability,
                "epsilon": self.epsilon.to_json(),
                "volume": self.volume.to_json(),
            },
            "contacts": [
                {"sensor": s, "object_point": p.tolist(), "object_normal": n.tolist()}
                for s, p, n in zip(self.sensors, self.points, self.normals)
            ],
            "left_out": list(self.left_out),
            "notes": list(self.notes),
            "places": [place.to_json() for place in self.places],
        }


def assess(
    model: ObjectModel, answer: Estimate, frame: Frame, seed: int = 0, settings: GraspAdviceSettings | None = None
) -> GraspAnswer:
    """The grasp of a frame at its answer; a frame that feels nothing has the verdict that nothing holds."""
    settings = settings or GraspAdviceSettings()
    contacts, left_out = held_contacts(frame, answer, settings)
    points, normals = _touched(model, contacts, answer.pose, settings)
    length = model.radius
    quality = grasp_quality(points, normals, model.centroid, length, settings.wrenches)
    sampled = []
    for pose in sample_poses(model, answer, settings.samples if len(contacts) else 0, seed):
        where, out = _touched(model, contacts, pose, settings)
        sampled.append(grasp_quality(where, out, model.centroid, length, settings.wrenches))
    drawn, sampled = len(sampled), sampled or [quality]
    map_, places = _where_next(model, answer, frame, points, normals, length, settings)
    return GraspAnswer(
        frame=frame.index,
        verdict=answer.verdict,
        quality=quality,
        sensors=tuple(contacts.sensors),
        left_out=left_out,
        points=points,
        normals=normals,
        length=length,
        closure_probability=float(np.mean([q.closure for q in sampled])),
        epsilon=PosteriorSpread.of([q.epsilon for q in sampled]),
        volume=PosteriorSpread.of([q.volume for q in sampled]),
        samples=drawn,
        places=places,
        map=map_,
        notes=placed(frame)[1],
    )


def held_contacts(frame: Frame, answer: Estimate, settings: GraspAdviceSettings) -> tuple[Contacts, tuple[str, ...]]:
    """The contacts (camera frame, the calibration corrected as the answer has it) that the answer explains, and the
    sensors of the others.
    """
    contacts = feel(frame, np.eye(4)).reported_contacts
    if answer.hand_from_object is not None and frame.world_from_hand is not None:
        reported = frame.camera_from_world @ frame.world_from_hand
        contacts = contacts.moved(answer.pose @ se3.inverse(answer.hand_from_object) @ se3.inverse(reported))
    told = answer.contacts if len(answer.contacts) == len(contacts) else ()
    good = np.array([not residual.outlier for residual in told], dtype=bool) if told else np.ones(len(contacts), bool)
    left_out = tuple(contacts.sensors[i] for i in np.flatnonzero(~good))
    return contacts.take(good), left_out


def _touched(model: ObjectModel, contacts: Contacts, pose: Array, settings: GraspAdviceSettings) -> tuple[Array, Array]:
    """Places (n, 3) on the object at pose that contacts (camera frame) touch, and outward normals, object frame."""
    local = contacts.moved(se3.inverse(pose))
    foot, outward = on_surface(model, local.points, local.normals)
    if settings.normals == "sensed" and len(local):
        outward = np.where(local.has_normal[:, None], np.nan_to_num(local.normals), outward)
    return foot, outward


def _where_next(
    model: ObjectModel,
    answer: Estimate,
    frame: Frame,
    points: Array,
    normals: Array,
    length: float,
    settings: GraspAdviceSettings,
) -> tuple[GraspMap | None, tuple[Place, ...]]:
    """The gain of one more contact over the surface, and the three best places."""
    if not settings.places:
        return None, ()
    places, outward = model.sample_surface(settings.places, seed=0)
    tips, hand = hand_around(frame, answer)
    open_ = _room(model, places, outward, se3.apply(se3.inverse(answer.pose), hand), settings)

    def margin_of(extra: Array, way: Array) -> float:
        both = np.concatenate([points, extra]), np.concatenate([normals, way])
        return margin(primitive_wrenches(*both, model.centroid, length, settings.wrenches), settings.wrenches)

    now = margin_of(np.zeros((0, 3)), np.zeros((0, 3)))
    with_it = np.full(len(places), np.nan)
    for i in np.flatnonzero(open_).tolist():
        with_it[i] = margin_of(places[i : i + 1], outward[i : i + 1])
    gain = with_it - now
    useful = np.where(np.nan_to_num(gain, nan=-np.inf) > settings.wrenches.smallest, gain, -np.inf)
    chosen = best_apart(places, useful, SHOWN, settings.apart * model.radius)
    told = gains(model, answer, places[chosen], outward[chosen])[0] if chosen else np.zeros(0)
    found = []
    for i, nats in zip(chosen, told):
        finger, away = nearest_finger(tips, se3.apply(answer.pose, places[i : i + 1])[0])
        where, way = places[i].copy(), outward[i].copy()
        found.append(Place(where, way, float(gain[i]), float(with_it[i]), float(nats), finger, away))
    return GraspMap(places.copy(), outward.copy(), gain), tuple(found)


def _room(
    model: ObjectModel, places: Array, outward: Array, hand: Array, settings: GraspAdviceSettings
) -> NDArray[np.bool_]:
    """(n,) whether a fingertip fits at places (n, 3), between the object's other parts and the hand's points (object
    frame).
    """
    tip = settings.tip
    middle = places + tip * outward
    free = model.field.distance(middle) > (1.0 - settings.overlap) * tip
    if len(hand):
        from scipy.spatial import cKDTree

        free &= cKDTree(hand).query(middle)[0] > tip
    return np.asarray(free)
