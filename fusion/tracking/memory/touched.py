"""What the fingers have felt of a held object, carried on with the hand.

A frame searched by itself sees one instant. Where no finger touches in it, or a forearm that nobody has a model of
looks like the object, it finds the object far from where fingers have held it until now: what they felt is evidence,
too, though not of this frame. Hand frame as reported, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.posterior.verdict import VerdictSettings
from fusion.tracking.motion import HandState, fingertips
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Touched:
    """The contacts of the last frame that had some and whose answer explained them. points (n, 3); limits (n,): how far
    from the surface each may be; hold (4, 4) hand_from_object: of that answer; by: the hand that felt them.
    """

    points: Array
    limits: Array
    hold: Array
    by: HandState

    @staticmethod
    def of(
        model: ObjectModel,
        contacts: Contacts,
        hand: HandState,
        camera_from_hand: Array,
        pose: Array,
        settings: VerdictSettings,
    ) -> Touched | None:
        """From contacts, at least one, and an answer (4, 4), camera frame, and where the hand is (4, 4); None where
        the answer does not explain them. hand: as reported.
        """
        back = se3.inverse(camera_from_hand)
        limits = np.maximum(settings.outlier_sigmas * contacts.sigma_point, settings.outlier_distance)
        felt = Touched(se3.apply(back, contacts.points), limits, back @ pose, hand)
        return None if felt.is_let_go(model, pose, pose, camera_from_hand, settings) else felt

    def has_opened(self, model: ObjectModel, frame: Frame) -> bool:
        """Whether the fingers have since left where they held the object: none would reach it there now."""
        moved = fingertips(self.by, frame)
        if moved is None or len(moved[0]) != len(self.points):
            return False
        off = model.field.distance(se3.apply(se3.inverse(self.hold), self.points + moved[1]))
        return bool((off > self.limits).all())

    def is_let_go(
        self, model: ObjectModel, other: Array, pose: Array, camera_from_hand: Array, settings: VerdictSettings
    ) -> bool:
        """Whether an object at `other` (4, 4) would not be what the fingers felt: most contacts are off its surface,
        by more than the object at `pose` (4, 4) has moved in the hand since.
        """
        there = se3.difference(se3.inverse(camera_from_hand) @ pose, self.hold, model.centroid)
        since = float(np.linalg.norm(there[:3]) * model.radius + np.linalg.norm(there[3:]))
        local = se3.apply(se3.inverse(other) @ camera_from_hand, self.points)
        explained = np.abs(model.field.distance(local)) <= self.limits + since
        return bool(explained.mean() < settings.least_contacts)
