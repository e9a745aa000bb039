"""What one frame says near where the object is expected: looked at, felt, and held against the predicted picture.

The picture is that of `estimate` (fusion.estimation.search.pool), on the part of the image around the poses that are
asked about: a whole image costs more than a tracked frame may. Camera frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.search.pool import Pool
from fusion.estimation.settings import EstimateSettings
from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.occluders import Occluders, OccluderSettings
from fusion.tracking.memory.state import TrackState
from scenes.evidence.table import Evidence
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from touch.contacts import Felt, TouchSettings, feel
from vision.look.look import surfaces
from vision.look.looked import Looked
from vision.look.pixels import read_pixels
from vision.look.regions import region_around
from vision.picture.predictor import Predictor
from vision.sight import Sight

Array = NDArray[np.float64]

# Pixels among which things that go with the object are learned.
MOST_AROUND = 2000


@dataclass(frozen=True)
class Sensed:
    """One frame. viewed: with what the camera may tell; looked, seen: its pixels near the predicted pose, and their
    rows; felt: what the fingers say; pool: what the predicted picture and touch say of poses, None without an image;
    things: what was learned to go with the object without being it, and how; placed: what the fingers report is where
    an earlier frame's hand has put it, or nothing in this one could put it better; seen_from (4, 4): takes a pose to
    where the image, uncorrected, shows the object, as looks have found its scale and bias to be.
    """

    viewed: Frame
    looked: Looked
    seen: Evidence
    felt: Felt
    pool: Pool | None
    things: Occluders = field(default_factory=Occluders)
    how: OccluderSettings = field(default_factory=OccluderSettings)
    placed: bool = False
    seen_from: Array = field(default_factory=lambda: np.eye(4))

    @property
    def told_apart(self) -> bool:
        """Whether a mask or the hand's model says which pixels are not the object's."""
        return self.looked.told_apart or self.pool is None

    def rows_at(self, pose: Array, side: int) -> Evidence:
        """Vision's rows if the object is at pose (4, 4): pixels inside its predicted outline at its depth, so that
        what nobody has a model of is left out; side: rays along each side of the outline's box.
        """
        if self.pool is None:
            return self.seen
        rows = self.pool.evidence(pose, side)
        on = rows.on
        clean = on.copy()
        clean[on] = ~self.things.beside(pose, rows.points[on], self.how)
        # an object of which next to nothing else is seen keeps what it has
        return rows if clean.sum() < self.pool.settings.least_pixels else rows.take(clean | ~on)

    def around(self) -> Array:
        """(n, 3) points seen where the object is, and about it; none without an image."""
        frame, region = self.viewed, self.looked.region
        box = None if region is None or frame.camera is None else region.box(frame.camera)
        if frame.depth is None or frame.camera is None or box is None:
            return np.zeros((0, 3))
        return read_pixels(frame.depth, frame.camera, box, MOST_AROUND).points


def cropped(frame: Frame, box: tuple[int, int, int, int]) -> Frame:
    """The part u0, v0, u1, v1 (exclusive ends) of a frame's images, with the camera that has just this part."""
    u0, v0, u1, v1 = box
    c = frame.camera
    assert c is not None
    assert frame.depth is not None
    camera = Camera(c.fx, c.fy, c.cx - u0, c.cy - v0, u1 - u0, v1 - v0)
    depth = np.ascontiguousarray(frame.depth[v0:v1, u0:u1])
    mask = None if frame.mask is None else np.ascontiguousarray(frame.mask[v0:v1, u0:u1])
    return replace(frame, camera=camera, depth=depth, mask=mask, rgb=None)


def part_with_colours(sensed: Sensed) -> Frame:
    """The part of the frame that the picture of its poses is of, with its colours."""
    assert sensed.pool is not None
    frame, own = sensed.viewed, sensed.pool.predictor.camera
    assert frame.camera is not None
    assert frame.rgb is not None
    assert own is not None
    u, v = round(frame.camera.cx - own.cx), round(frame.camera.cy - own.cy)
    part = cropped(frame, (u, v, u + own.width, v + own.height))
    return replace(part, rgb=np.ascontiguousarray(frame.rgb[v : v + own.height, u : u + own.width]))


def feel_near(
    frame: Frame,
    looked: Looked | None,
    seen: Array | None,
    held: Array | None,
    beliefs: Beliefs,
    settings: TouchSettings,
) -> Felt:
    """What is felt, moved to where the hand is seen, or was last (seen: a correction (4, 4), None before it was), or
    where the object has had it (held).
    """
    told = held
    if looked is not None and looked.hand is not None:
        told = looked.hand.correct()
    elif seen is not None:
        told = seen
    elif told is None and looked is not None and not len(looked.pixels):
        told = np.eye(4)  # what a calibration may be off by is in the measurement then
    return feel(frame, told, beliefs, None if looked is None else looked.region, settings)


def pool_near(
    frame: Frame,
    model: ObjectModel,
    candidates: Array,
    looked: Looked,
    felt: Felt,
    beliefs: Beliefs,
    settings: EstimateSettings,
    room: float,
    pieces: bool = True,
) -> Pool | None:
    """What must be seen of poses (n, 4, 4) and of those up to `room` (m) from them; None without a depth image, or
    when all of it is outside the image. pieces: whether poses are to be ranked, which asks for the image's surfaces.
    """
    if frame.depth is None or frame.camera is None:
        return None
    box = region_around(model, candidates, room).box(frame.camera)
    if box is None:
        return None
    part = cropped(frame, box)
    contacts = len(felt.reported_contacts)
    unknown = pieces and not looked.told_apart and (contacts > 0 or len(candidates) > 1)
    labels = surfaces(part, looked.planes, beliefs, settings.look)[1] if unknown else None
    hand = looked.seen_hand
    predictor = Predictor(part, model, beliefs.depth, hand, settings.prediction, looked.planes, labels)
    sight = Sight(part, model, beliefs.depth, settings.sight)
    asks = settings.look.rows, settings.proposals, settings.modes, settings.pool
    rng = np.random.default_rng(0)  # nothing is drawn: starts come from the track
    return Pool(model, felt.rows, contacts, felt.fingers, None, predictor, sight, looked, beliefs.depth, rng, *asks)


def learn_things(
    model: ObjectModel, sensed: Sensed, state: TrackState, pose: Array, switched: bool, settings: TrackSettings
) -> None:
    """What goes with the object at pose (4, 4), where nothing tells it apart; of another pose all is learned anew."""
    if switched:
        state.things = Occluders()
        state.leads += 1
    if not sensed.told_apart:
        state.things = state.things.learned(model, pose, sensed.around(), settings.occluders)
