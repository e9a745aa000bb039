"""What the robot reports, as of the time of the image beside it, where the two are known to be apart.

Images that are late show where hand and object were. So a track that knows by how much (`memory.lateness`) lives in the
time of the images: the robot's reports are taken as of then, between the last ones, and the answer is moved on to the
frame's own time as the hand has since. Where images are ahead of the reports, these are moved on, and the answer is of
the images' time: the newest that was sensed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.answer import TrackedEstimate
from fusion.tracking.filter import block, moved_modes
from fusion.tracking.memory.lateness import LONGEST
from fusion.tracking.memory.state import TrackState
from scenes.evidence.align import terms
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.look.hand.hand import HandTold, camera_from_hand
from vision.look.warm import Looker

Array = NDArray[np.float64]


def as_of_image(frame: Frame, state: TrackState) -> tuple[Frame, Array | None]:
    """The frame with the robot's reports as of its image, and the motion (4, 4) camera_from_camera, as reported, by
    which the answer is to be moved on to the frame's own time; None where it stays. The state remembers the reports.
    """
    now = camera_from_hand(frame)
    if now is None:
        return frame, None
    late = state.lateness.reported(frame.index, now)
    then = late.reported_at(frame.index - late.used) if late.used else None
    if then is None:
        state.lateness = replace(late, used=0.0)
        return frame, None
    state.lateness = late
    back = then @ se3.inverse(now)
    # all that the robot reports is placed in the world; a cloud is what the camera saw, and stays where it is
    placed = back @ frame.camera_from_world
    cloud = frame.cloud
    if cloud is not None:
        cloud = se3.apply(se3.inverse(placed) @ frame.camera_from_world, np.asarray(cloud, dtype=np.float64))
    return replace(frame, camera_from_world=placed, cloud=cloud), se3.inverse(back) if late.used > 0.0 else None


def moved_on(
    answer: TrackedEstimate, on: Array | None, state: TrackState, seen: Array | None, notes: tuple[str, ...] = ()
) -> TrackedEstimate:
    """An answer of an image's time after the motion `on` (4, 4), as reported, of what the hand holds, with more notes;
    seen (4, 4): camera_from_camera of what the robot reports, None where no image has shown it. What the hand does not
    hold stays where it is.
    """
    if notes:
        answer = replace(answer, notes=tuple(dict.fromkeys((*answer.notes, *notes))))
    if on is None or state.hand is None:
        return answer
    seen = state.corrected(seen)
    motion = on if seen is None else seen @ on @ se3.inverse(seen)
    turn = block(motion[:3, :3])
    return replace(
        answer,
        pose=motion @ answer.pose,
        covariance=turn @ answer.covariance @ turn.T,
        modes=moved_modes(answer.modes, motion),
        as_seen=answer.pose if answer.as_seen is None else answer.as_seen,
    )


def learn_delay(
    model: ObjectModel, frame: Frame, rows: Evidence, pose: Array, looker: Looker, state: TrackState
) -> None:
    """Of a frame looked at in full, where no image has shown a hand that is known: what the hand holds tells, too, as
    far as it stays in the palm. rows: the image's; pose (4, 4): where all that was sensed has it.
    """
    hand, late = camera_from_hand(frame), state.lateness
    if looker.told is not None or hand is None or not len(rows) or frame.index < state.index or state.held.stays:
        return
    hold = se3.inverse(hand) @ pose if late.hold is None else late.hold
    if state.held.rests(model, pose):  # what the hand does not hold lags behind it for ever
        state.lateness = replace(late, hold=hold)
        return
    carried = hand @ hold
    pose = model.symmetries.nearest(pose, carried)
    centre = se3.apply(carried, model.centroid[None])[0]
    _, gradient, hessian = terms(model, rows, pose)
    # of the image alone: contacts are of the robot's time
    pull = hessian @ se3.difference(pose, carried, model.centroid) - gradient
    state.lateness = replace(late, hold=hold).looked(HandTold(np.eye(4), centre, hessian, pull), centre)


def put_down(state: TrackState) -> None:
    """Forget what an object has told of a delay that the hand does not hold and that has been at rest for longer than
    images are late: it is taken up anew, elsewhere in the hand, and would seem to lag behind what was told of it.
    """
    if state.held.stays and state.rest.still > LONGEST:
        state.lateness = state.lateness.of_hand
