"""An object that nothing is known to carry, and that has been at rest.

Where nobody has a model of the hand, one that comes to an object at rest, or goes from it, takes pixels of its own for
the object's along: frame after frame a fit follows it by a little. So what has been at rest is believed to be where it
was, until the picture of a frame is better with it elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.memory.held import shift
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Frames in which an object has stayed within STILL (m, of its surface at most) rests; one that is found beyond AWAY (m)
# from there has moved or is taken along.
FRAMES, STILL, AWAY = 3, 0.004, 0.005
# Nats by which the picture of a frame must be better where it is found than where it was at rest: what rests goes on
# resting with 95 %.
MOVES = 3.0
# Share (no unit) of the object that must agree with an image for it to tell so beside a hand that may push it: of a
# tool's tip, 8 % of it, no picture told that it had been pushed by 10 mm. By judgement.
TELLS = 0.3


@dataclass(frozen=True)
class Rest:
    """pose (4, 4) camera_from_object in a camera of camera_from_world `world` (4, 4), None before; still: frames since,
    in all of which it was there; now (4, 4): camera_from_world of the last frame; enough: frames in which it must have
    been there, none where a hand is known to be clear of it.
    """

    pose: Array | None = None
    world: Array | None = None
    still: int = 0
    now: Array | None = None
    enough: int = FRAMES

    def followed(self, model: ObjectModel, pose: Array | None, world: Array, clear: bool = False) -> Rest:
        """Before a frame whose camera_from_world is `world` (4, 4); pose (4, 4): of the frame before, None where a hand
        carries it or nothing is known of it; clear: a hand that is known is clear of it.
        """
        enough = 0 if clear else FRAMES
        if pose is None or self.now is None:
            return Rest(now=world, enough=enough)
        there = self.at(self.now)
        if there is not None and apart(model, there, pose) <= STILL:
            return replace(self, still=self.still + 1, now=world, enough=enough)
        if there is not None and self.still >= enough and apart(model, there, pose) <= AWAY:
            return replace(self, now=world, enough=enough)
        return Rest(pose, self.now, 0, world, enough)

    def at(self, world: Array | None = None) -> Array | None:
        """(4, 4) where it was, in the camera of the last frame or of another camera_from_world (4, 4)."""
        world = self.now if world is None else world
        if self.pose is None or self.world is None or world is None:
            return None
        return world @ se3.inverse(self.world) @ self.pose

    def left(self, model: ObjectModel, pose: Array) -> Array | None:
        """(4, 4) where it rested, in the last frame's camera, where a pose (4, 4) is elsewhere; None where it is there,
        and where it has not been at rest.
        """
        there = self.at() if self.still >= self.enough else None
        return there if there is not None and apart(model, there, pose) > AWAY else None


def apart(model: ObjectModel, pose: Array, other: Array) -> float:
    """How far (m) two poses (4, 4) have the object's surface apart, at most, whichever of its twins they are."""
    return shift(model, model.symmetries.nearest(other, pose), pose)
