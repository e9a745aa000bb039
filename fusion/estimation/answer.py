"""What an estimate says: the pose, how sure it is, what it cannot know, and how it got there."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.modes import Mode

Array = NDArray[np.float64]

__all__ = ["ContactResidual", "Contribution", "Estimate", "Mode", "Stage"]

VERDICTS = ("ok", "ambiguous", "lost")


@dataclass(frozen=True)
class Stage:
    """One line of the trace: what ran or was skipped, why, how long, on how many rows of evidence."""

    name: str
    ran: bool
    why: str
    ms: float = 0.0
    rows: int = 0


@dataclass(frozen=True)
class ContactResidual:
    """How one contact agrees: distance to the surface (mm, signed, outside positive), angle between the sensed
    and the model's normal (degrees, NaN without a normal), whether it does not belong; the contact's own standard
    deviation (mm, NaN where the reader of a result does not know it); what part of its finger's contacts it is.
    """

    sensor: str
    residual_mm: float
    normal_deg: float
    outlier: bool
    sigma_mm: float = float("nan")
    of_finger: float = 1.0


@dataclass(frozen=True)
class Contribution:
    """What one source of evidence ("vision", "touch" or "prior") added: rows it gave, and the answer's worst standard
    deviations (m, rad) with everything, which are those of its covariance, and without it.
    """

    source: str
    rows: int
    position_with: float
    position_without: float
    rotation_with: float
    rotation_without: float

    def to_json(self) -> dict[str, Any]:
        """Its entry of result.json."""
        return {
            "source": self.source,
            "rows": self.rows,
            "sigma_position_mm": 1e3 * self.position_with,
            "sigma_position_mm_without": 1e3 * self.position_without,
            "sigma_rotation_deg": float(np.rad2deg(self.rotation_with)),
            "sigma_rotation_deg_without": float(np.rad2deg(self.rotation_without)),
        }


@dataclass(frozen=True, eq=False)
class Estimate:
    """The answer for one frame. All poses are camera_from_object unless named otherwise (4x4, metres).

    modes: the answer first, which is the likeliest of those that were solved with everything; then the others by cost.
    covariance (6, 6) about the centroid, (turn, move): of the first mode when the verdict is `ok`, or of all that are
    one answer with it within the tolerance where it does not hold most of these; otherwise of all that may be the case,
    other modes and none of them included. Each mode has its own. Errors have longer tails than a
    Gaussian's, near enough those of a Student distribution of three degrees of freedom with that covariance, whose 95 %
    region is 1.2 times as wide as a Gaussian's. confidence: probability that the pose's ADD-S is below sure_within (m),
    see fusion.estimation.posterior.confidence; observed: what it was read from, empty when nothing was sensed.
    print_share: of all ways round that the shape allows, the share that what is printed on the object gives this one;
    NaN where no print was read. searched: where the search ended, from which the pose was solved with all that the
    senses share; None where nothing was searched. as_seen (4, 4): where the depth image, uncorrected, shows the object
    if it is at `pose`, which is there where no image was solved for; None where nothing was searched.
    """

    frame: int
    pose: Array
    covariance: Array
    modes: tuple[Mode, ...]
    verdict: str
    unobservable: tuple[str, ...] = ()
    hand_from_object: Array | None = None
    visible_fraction: float = float("nan")
    trace: tuple[Stage, ...] = ()
    contacts: tuple[ContactResidual, ...] = ()
    pixel_rms_mm: float = float("nan")
    notes: tuple[str, ...] = ()
    dropped: dict[str, int] = field(default_factory=dict)
    start: Array | None = None
    contributions: tuple[Contribution, ...] = ()
    confidence: float = float("nan")
    sure_within: float = float("nan")
    observed: dict[str, float] = field(default_factory=dict)
    print_share: float = float("nan")
    searched: Array | None = None
    as_seen: Array | None = None

    def __repr__(self) -> str:
        """In one line; the fields have the rest."""
        place, sure = np.array2string(self.pose[:3, 3], precision=3, suppress_small=True), ""
        if np.isfinite(self.confidence):
            sure = f", {100 * self.confidence:.0f} % sure to {1e3 * self.sure_within:.3g} mm"
        return f"{type(self).__name__}(frame {self.frame}: {self.verdict}{sure}, at {place} m, {len(self.modes)} modes)"

    @property
    def time_ms(self) -> float:
        """Milliseconds spent in all stages."""
        return float(sum(stage.ms for stage in self.trace))

    def to_json(self) -> dict[str, Any]:
        """The frame's entry of result.json."""

        def number(value: float) -> float | None:
            return float(value) if np.isfinite(value) else None

        def rows(array: Array | None) -> list[list[float]] | None:
            return None if array is None else [[float(x) for x in row] for row in array]

        return {
            "frame": self.frame,
            "verdict": self.verdict,
            "camera_from_object": rows(self.pose),
            "hand_from_object": rows(self.hand_from_object),
            "covariance": rows(self.covariance),
            "modes": [
                {"pose": rows(m.pose), "weight": m.weight, "cost": number(m.cost), "covariance": rows(m.covariance)}
                for m in self.modes
            ],
            "unobservable": list(self.unobservable),
            "confidence": number(self.confidence),
            "sure_within_mm": number(1e3 * self.sure_within),
            "print_share": number(self.print_share),
            "visible_fraction": number(self.visible_fraction),
            "time_ms": self.time_ms,
            "trace": [{"stage": s.name, "ran": s.ran, "why": s.why, "ms": s.ms, "rows": s.rows} for s in self.trace],
            "contacts": [
                {
                    "sensor": c.sensor,
                    "residual_mm": number(c.residual_mm),
                    "normal_deg": number(c.normal_deg),
                    "outlier": c.outlier,
                }
                for c in self.contacts
            ],
            "contributions": [c.to_json() for c in self.contributions],
            "pixel_rms_mm": number(self.pixel_rms_mm),
            "notes": list(self.notes),
            "dropped": dict(self.dropped),
        }
